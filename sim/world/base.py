"""Simulated bases: delay of commands, caps, servos whose tyres slip, and odometry.

A kernel (see `swarmd/core/kernels.py`): `world.py` and `odometer.py` use it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import cos, fabs, fmod, hypot, isfinite, sin
else:
    from swarmd.core.cython_shadow import cos, fabs, fmod, hypot, isfinite, sin

from swarmd.sim.world.bodies import inertia, value

_GRAVITY = 9.81
_FRICTION = 0.8
_AHEAD = "linear_acceleration"
_PI = cython.declare(cython.double, math.pi)
_DRAWS = cython.declare(cython.Py_ssize_t, 32)


@cython.cfunc
@cython.exceptval(check=False)
def _clipped(value: cython.double, limit: cython.double) -> cython.double:
    """`value` within +- `limit`; `limit` is at least 0."""
    if fabs(value) <= limit:
        return value
    return limit if value > 0.0 else -limit


@cython.auto_pickle(False)
@cython.cclass
class Bases:
    """The bases of n robots: delay, acceleration caps and servos.

    Reads and writes positions, velocities and forces in MuJoCo's own memory. `before`: positions
    and velocities of all bodies when `drive` was called. `driven` (n, 3): the linear, angular and
    lateral velocities that the servos aim at. `drift` (n, 2): m/s along the world's x and y, added
    to the velocity; a caller may write it. `inert` (n, 3): mass in kg twice, and inertia in kg m2.
    `delay_steps`: the delay of commands in steps.

    A servo gives the force that reaches the commanded velocity within one step, up to the friction
    of the tyres (Coulomb, isotropic). MuJoCo's velocity actuators are not used: a stiff actuator
    with a force limit chatters by 0.04 m/s at rest, and a soft actuator lags.
    """

    before = cython.declare(object, visibility="readonly")
    driven = cython.declare(object, visibility="readonly")
    drift = cython.declare(object, visibility="readonly")
    inert = cython.declare(object, visibility="readonly")
    delay_steps = cython.declare(cython.Py_ssize_t, visibility="readonly")
    _n: cython.Py_ssize_t
    _dt: cython.double
    _qpos: cython.double[::1]
    _qvel: cython.double[::1]
    _applied: cython.double[::1]
    _qpos_before: cython.double[::1]
    _qvel_before: cython.double[::1]
    _delay_line: cython.double[:, :, ::1]  # the commands of the last steps, a ring buffer
    _command: cython.double[:, ::1]
    _step: cython.Py_ssize_t
    _is_capped: cython.bint
    _caps: cython.double[::1]  # (3,) change of the capped command in a step, at most
    _capped: cython.double[:, ::1]
    _limits: cython.double[:, ::1]
    _max_steps: cython.double[:, ::1]  # m/s or rad/s that a base gains in a step at most
    _inert: cython.double[:, ::1]
    _grip: cython.double[::1]  # N, the friction of the tyres
    _grip_torque: cython.double[::1]  # N m
    _driven: cython.double[:, ::1]
    _shares: cython.double[::1]  # of the error of the velocity that a base takes off in a step
    _drift: cython.double[:, ::1]

    def __init__(self, actuation, platforms, memory, dt):
        """Start n robots at rest.

        `actuation`: delay in s, and caps (upper limits) of acceleration; None: no cap. `platforms`
        (n,) in the order of rows; the robots are the first bodies of `memory`. `memory`: positions,
        velocities and forces of all bodies, which this class reads and writes. The delay is rounded
        to whole steps of `dt` s.
        """
        n: cython.Py_ssize_t = len(platforms)
        self._n, self._dt = n, dt
        self._qpos, self._qvel, self._applied = map(memoryview, memory)
        self.before = memory[0].copy(), memory[1].copy()
        self._qpos_before, self._qvel_before = map(memoryview, self.before)
        # Delay and caps of the commands: linear, angular, lateral.
        self.delay_steps = round(actuation.delay / dt)
        self._delay_line = memoryview(np.zeros((self.delay_steps + 1, n, 3)))
        self._command, self._capped = (memoryview(np.zeros((n, 3))) for _ in range(2))
        linear, angular = actuation.linear_acceleration, actuation.angular_acceleration
        self._is_capped = linear is not None or angular is not None
        caps = [math.inf if cap is None else cap * dt for cap in (linear, angular, linear)]
        self._caps = memoryview(np.array(caps))
        limits = [(p.limits.linear, p.limits.angular, p.limits.lateral) for p in platforms]
        self._limits = memoryview(np.array(limits, np.float64).reshape(n, 3))
        # Inertia; the greatest change of each velocity per step by the motors; the greatest force
        # in N (`grip`) and torque in N m that the tyres transmit.
        accelerations = [_accelerations(platform) for platform in platforms]
        self._max_steps = memoryview(np.array(accelerations, np.float64).reshape(n, 3) * dt)
        mass = np.array([value(platform, "mass") for platform in platforms], np.float64)
        turning = np.array([inertia(platform) for platform in platforms], np.float64)
        self.inert = np.stack((mass, mass, turning), axis=-1)
        self._inert = memoryview(self.inert)
        grip = _FRICTION * _GRAVITY * mass
        half_axles = [value(platform, "wheel_separation") / 2.0 for platform in platforms]
        self._grip = memoryview(grip)
        self._grip_torque = memoryview(grip * np.array(half_axles, np.float64))
        # The velocities that the servos aim at, and the wind's drift in m/s.
        self.driven, self.drift = np.zeros((n, 3)), np.zeros((n, 2))
        self._driven, self._drift = memoryview(self.driven), memoryview(self.drift)
        # The share of the velocity error that a base removes in a step; below 1 if the base lags.
        self._shares = memoryview(np.array([_share(p, dt) for p in platforms], np.float64))

    def put(self, twists):
        """Set the commands (n, 3) linear, angular, lateral in each base frame.

        They are clipped to each platform's limits, as firmware does; non-finite values become 0.
        """
        commands: cython.double[:, ::1] = memoryview(np.array(twists, np.float64, order="C"))
        row: cython.Py_ssize_t
        k: cython.Py_ssize_t
        for row in range(self._n):
            for k in range(3):
                self._command[row, k] = commands[row, k]

    def drive(self):
        """Set the forces for the next step, and keep the present state; call once a step."""
        i: cython.Py_ssize_t
        row: cython.Py_ssize_t
        k: cython.Py_ssize_t
        # The places in the ring buffer of the present command, and of that `delay_steps` before.
        newest: cython.Py_ssize_t = self._step % self._delay_line.shape[0]
        oldest: cython.Py_ssize_t = (self._step + 1) % self._delay_line.shape[0]
        target: cython.double
        yaw: cython.double
        c: cython.double
        s: cython.double
        linear: cython.double
        lateral: cython.double
        x: cython.double
        y: cython.double
        size: cython.double
        grip_share: cython.double
        self._step += 1
        for i in range(self._qpos.shape[0]):
            self._qpos_before[i], self._qvel_before[i] = self._qpos[i], self._qvel[i]
        for row in range(self._n):
            # 1. The velocity to drive to: the delayed command, clipped to the limits, then capped
            # in its change per step, and followed as fast as the motors can. Clipping comes before
            # the cap: a ramp towards a speed beyond the limits would lag when the command reverses.
            for k in range(3):
                self._delay_line[newest, row, k] = self._command[row, k]
            for k in range(3):
                target = self._delay_line[oldest, row, k]
                target = _clipped(target if isfinite(target) else 0.0, self._limits[row, k])
                if self._is_capped:
                    self._capped[row, k] += _clipped(target - self._capped[row, k], self._caps[k])
                    target = _clipped(self._capped[row, k], self._limits[row, k])
                self._driven[row, k] += _clipped(
                    (target - self._driven[row, k]) * self._shares[row], self._max_steps[row, k]
                )
            linear, lateral = self._driven[row, 0], self._driven[row, 2]
            # 2. The error of the velocity (x, y) in the world frame. A base that turns drives an
            # arc, and the chord of this step's arc has the heading half a step ahead. The drift of
            # a hovering body is added.
            yaw = self._qpos[3 * row + 2] + self._driven[row, 1] * (self._dt / 2.0)
            c, s = cos(yaw), sin(yaw)
            x = c * linear - s * lateral + self._drift[row, 0] - self._qvel[3 * row]
            y = s * linear + c * lateral + self._drift[row, 1] - self._qvel[3 * row + 1]
            # 3. The force (x, y) in N that removes the error within the step, up to the grip of the
            # tyres; and the torque in N m.
            x = x * self._inert[row, 0] / self._dt
            y = y * self._inert[row, 1] / self._dt
            size = hypot(x, y)
            grip_share = min(1.0, self._grip[row] / max(size, 1e-12))
            self._applied[3 * row] = x * grip_share
            self._applied[3 * row + 1] = y * grip_share
            self._applied[3 * row + 2] = _clipped(
                (self._driven[row, 1] - self._qvel[3 * row + 2]) * self._inert[row, 2] / self._dt,
                self._grip_torque[row],
            )


def _accelerations(platform):
    """Of each axis; sideways as ahead, unless `body` has a `lateral_acceleration`."""
    sideways = "lateral_acceleration" if "lateral_acceleration" in platform.body else _AHEAD
    return tuple(value(platform, key) for key in (_AHEAD, "angular_acceleration", sideways))


def _share(platform, dt):
    """1; less for a base that follows commands as a first-order lag of `body.response_time` s."""
    time = platform.body.get("response_time", 0.0)
    return 1.0 - math.exp(-dt / time) if time > 0.0 else 1.0


@cython.auto_pickle(False)
@cython.cclass
class Wheels:
    """Odometry of n bases with errors; `measured` (n, 3, 3): the matrices of `measurement`.

    `truth`, `reported` (n, 3): the true and the reported poses at the last reading, which `read`
    replaces. `slip`: the standard deviation of slip, which `rngs` (n,) draw for _DRAWS readings at
    once: a draw for each reading would take half of the time of a reading.
    """

    _measured: cython.double[:, :, ::1]
    _truth: cython.double[:, ::1]
    _reported: cython.double[:, ::1]
    _slip: cython.double
    _rngs: list
    _blocks: list  # (_DRAWS, 2) of each base: random numbers, of which `_used` are used
    _draws: cython.double[:, :, ::1]
    _used: cython.Py_ssize_t[::1]
    _slips: cython.double[2]  # factors near 1 on linear and angular motion of the present reading

    def __init__(self, measured, truth, reported, slip, rngs):
        self._measured = memoryview(measured)
        self._truth, self._reported = memoryview(truth), memoryview(reported)
        draws = np.empty((len(rngs), _DRAWS, 2))
        self._slip, self._rngs = slip, rngs
        self._blocks = list(draws)
        self._draws = memoryview(draws)
        self._used = memoryview(np.full(len(rngs), _DRAWS, np.intp))  # the first reading draws

    def read(
        self,
        rows: cython.Py_ssize_t[::1],
        poses: cython.double[:, ::1],
        twists: cython.double[:, ::1],
        reported: cython.double[:, ::1],
        measured: cython.double[:, ::1],
    ):
        """Fill `reported` and `measured` (m, 3): odometry's poses and twists of `rows` (m,).

        `poses` and `twists` (n, 3): the true poses in the world frame and the true twists of all
        robots.
        """
        if not cython.compiled:
            rows, poses, twists = memoryview(rows), memoryview(poses), memoryview(twists)
            reported, measured = memoryview(reported), memoryview(measured)
        index: cython.Py_ssize_t
        row: cython.Py_ssize_t
        k: cython.Py_ssize_t
        x: cython.double
        y: cython.double
        turn: cython.double
        mid_yaw: cython.double
        c: cython.double
        s: cython.double
        linear: cython.double
        lateral: cython.double
        for index in range(rows.shape[0]):
            row = rows[index]
            self._draw_slips(row)
            # 1. The true motion since the last reading, along the mean heading.
            x, y = poses[row, 0] - self._truth[row, 0], poses[row, 1] - self._truth[row, 1]
            turn = poses[row, 2] - self._truth[row, 2]
            mid_yaw = self._truth[row, 2] + turn / 2.0
            c, s = cos(mid_yaw), sin(mid_yaw)
            # 2. The motion that the wheels measure (from linear, angular and lateral motion in the
            # base frame), added to the reported pose. `measured` holds the measured motion until
            # step 3 replaces it by the twist.
            self._measure(row, index, c * x + s * y, turn, c * y - s * x, measured)
            linear, turn, lateral = measured[index, 0], measured[index, 1], measured[index, 2]
            mid_yaw = self._reported[row, 2] + turn / 2.0
            c, s = cos(mid_yaw), sin(mid_yaw)
            self._reported[row, 0] += c * linear - s * lateral
            self._reported[row, 1] += s * linear + c * lateral
            self._reported[row, 2] += turn
            for k in range(3):
                self._truth[row, k] = poses[row, k]
                reported[index, k] = self._reported[row, k]
            reported[index, 2] = _wrapped(reported[index, 2])
            # 3. The measured twist.
            self._measure(row, index, twists[row, 0], twists[row, 1], twists[row, 2], measured)

    @cython.cfunc
    def _draw_slips(self, row: cython.Py_ssize_t) -> cython.int:
        """Set `_slips` for a reading of base `row`; returns 0."""
        k: cython.Py_ssize_t
        if self._used[row] == _DRAWS:
            self._rngs[row].standard_normal(out=self._blocks[row])
            self._used[row] = 0
        for k in range(2):
            self._slips[k] = 1.0 + self._slip * self._draws[row, self._used[row], k]
        self._used[row] += 1
        return 0

    @cython.cfunc
    def _measure(
        self,
        row: cython.Py_ssize_t,
        index: cython.Py_ssize_t,
        linear: cython.double,
        angular: cython.double,
        lateral: cython.double,
        measured: cython.double[:, ::1],
    ) -> cython.int:
        """Set row `index` of `measured` as the wheels of robot `row` measure a motion or twist."""
        m: cython.double[:, :, ::1] = self._measured
        measured[index, 0] = (linear * m[row, 0, 0] + angular * m[row, 1, 0]) * self._slips[0]
        measured[index, 1] = (linear * m[row, 0, 1] + angular * m[row, 1, 1]) * self._slips[1]
        measured[index, 2] = lateral * m[row, 2, 2]
        return 0


@cython.cfunc
@cython.exceptval(check=False)
def _wrapped(yaw: cython.double) -> cython.double:
    wrapped: cython.double = fmod(yaw + _PI, 2.0 * _PI)
    if wrapped < 0.0:
        wrapped += 2.0 * _PI
    return wrapped - _PI
