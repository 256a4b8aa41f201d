"""Simulated bases: delay of commands, caps, servos whose tyres slip, and odometry.

A kernel (see `swarmd/core/kernels.py`): `world.py` and `odometer.py` use it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import wrap
from swarmd.core.cython_shadow import (
    Block,
    Doubles,
    Indices,
    Table,
    cos,
    fabs,
    hypot,
    isfinite,
    sin,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmd.core.values import Array, Platform

from swarmd.sim.world.bodies import inertia, value

_GRAVITY = 9.81
_FRICTION = 0.8
_AHEAD = "linear_acceleration"
_DRAWS = 32


def _clipped(value: float, limit: float) -> float:
    """`value` within +- `limit`; `limit` is at least 0."""
    if fabs(value) <= limit:
        return value
    return limit if value > 0.0 else -limit


@cython.cclass
class Bases:
    """The bases of n robots: delay, acceleration caps and servos.

    Reads and writes positions, velocities and forces in MuJoCo's own memory.

    A servo gives the force that reaches the commanded velocity within one step, up to the friction
    of the tyres (Coulomb, isotropic). MuJoCo's velocity actuators are not used: a stiff actuator
    with a force limit chatters by 0.04 m/s at rest, and a soft actuator lags.
    """

    # Positions and velocities of all bodies when `drive` was called.
    before: tuple[Array, Array]
    # (n, 3) the linear, angular and lateral velocities that the servos aim at, in the base frame.
    driven: Array
    # (n, 2) m/s along the world's x and y, added to the velocity; callers may write the array.
    drift: Array
    # (n, 3) inertia along the world's x, y and yaw: the mass in kg twice, the moment in kg m2.
    inert: Array
    # The delay of commands in steps.
    delay_steps: int
    _n: int
    _dt: float
    _qpos: Doubles
    _qvel: Doubles
    _applied: Doubles
    _qpos_before: Doubles
    _qvel_before: Doubles
    _delay_line: Block  # the commands of the last steps, a ring buffer
    _command: Table
    _step: int
    _is_capped: bool
    _caps: Doubles  # (3,) the most that the capped command changes in a step
    _capped: Table  # (n, 3) the delayed command, limited in its change
    _limits: Table
    _max_steps: Table  # m/s or rad/s that a base gains in a step at most
    _inert: Table
    _grip: Doubles  # N, the friction of the tyres
    _grip_torque: Doubles  # N m
    _driven: Table
    # (n,) the share of the velocity error that a base removes in a step; below 1 if the base lags.
    _shares: Doubles
    _drift: Table

    def __init__(
        self, actuation: Any, platforms: Sequence[Platform], memory: tuple[Array, ...], dt: float
    ) -> None:
        """Start n robots at rest.

        `actuation`: delay in s, and caps (upper limits) of acceleration; None: no cap. `platforms`
        (n,) in the order of rows; the robots are the first bodies of `memory`. `memory`: positions,
        velocities and forces of all bodies, which this class reads and writes. The delay is rounded
        to whole steps of `dt` s.
        """
        n = len(platforms)
        self._n = n
        self._dt = dt
        self._qpos, self._qvel, self._applied = (one.data for one in memory)
        self.before = memory[0].copy(), memory[1].copy()
        self._qpos_before, self._qvel_before = (one.data for one in self.before)
        self._begin_commands(actuation, platforms)
        self._begin_servos(platforms)
        self.driven = np.zeros((n, 3))
        self.drift = np.zeros((n, 2))
        self._driven = self.driven.data
        self._drift = self.drift.data

    def _begin_commands(self, actuation: Any, platforms: Sequence[Platform]) -> None:
        """Set delay, caps and limits of the commands: linear, angular, lateral. Returns 0."""
        n = len(platforms)
        self.delay_steps = round(actuation.delay / self._dt)
        self._delay_line = np.zeros((self.delay_steps + 1, n, 3)).data
        self._command, self._capped = (np.zeros((n, 3)).data for _ in range(2))
        linear = actuation.linear_acceleration
        angular = actuation.angular_acceleration
        self._is_capped = linear is not None or angular is not None
        caps = [math.inf if cap is None else cap * self._dt for cap in (linear, angular, linear)]
        self._caps = np.array(caps).data
        limits = [(p.limits.linear, p.limits.angular, p.limits.lateral) for p in platforms]
        self._limits = np.array(limits, np.float64).reshape(n, 3).data

    def _begin_servos(self, platforms: Sequence[Platform]) -> None:
        """Set inertia, motors and tyres of the bases. Returns 0."""
        n = len(platforms)
        mass = np.array([value(platform, "mass") for platform in platforms], np.float64)
        moment = np.array([inertia(platform) for platform in platforms], np.float64)
        self.inert = np.stack((mass, mass, moment), axis=-1)
        self._inert = self.inert.data
        # What the motors can do.
        accelerations = [_accelerations(platform) for platform in platforms]
        self._max_steps = (np.array(accelerations, np.float64).reshape(n, 3) * self._dt).data
        self._shares = np.array([_share(p, self._dt) for p in platforms], np.float64).data
        # What the tyres transmit.
        grip = _FRICTION * _GRAVITY * mass
        half_axles = [value(platform, "wheel_separation") / 2.0 for platform in platforms]
        self._grip = grip.data
        self._grip_torque = (grip * np.array(half_axles, np.float64)).data

    def put(self, twists: Any) -> None:
        """Set the commands (n, 3) linear, angular, lateral in each base frame.

        They are clipped to each platform's limits, as firmware does; non-finite values become 0.
        """
        commands: Table = np.array(twists, np.float64, order="C").data
        for row in range(self._n):
            for k in range(3):
                self._command[row, k] = commands[row, k]

    def drive(self) -> None:
        """Set the forces for the next step, and keep the present state; call once a step."""
        for i in range(len(self._qpos)):
            self._qpos_before[i] = self._qpos[i]
            self._qvel_before[i] = self._qvel[i]
        for row in range(self._n):
            self._aim(row)
            self._push(row)
        self._step += 1

    def _aim(self, row: int) -> None:
        """Set the velocities that the servos of base `row` aim at in this step. Returns 0."""
        # The places of the ring buffer: the place after the newest has the oldest command, which
        # was given `delay_steps` ago. Without a delay the buffer has one place.
        newest = self._step % self._delay_line.shape[0]
        oldest = (self._step + 1) % self._delay_line.shape[0]
        for k in range(3):
            self._delay_line[newest, row, k] = self._command[row, k]
        for k in range(3):
            target = self._delay_line[oldest, row, k]
            # Clipping to the limits comes before the cap: a ramp towards a speed beyond the limits
            # would lag when the command reverses.
            target = _clipped(target if isfinite(target) else 0.0, self._limits[row, k])
            if self._is_capped:
                self._capped[row, k] += _clipped(target - self._capped[row, k], self._caps[k])
                target = _clipped(self._capped[row, k], self._limits[row, k])
            # The base follows as fast as its motors can.
            self._driven[row, k] += _clipped(
                (target - self._driven[row, k]) * self._shares[row], self._max_steps[row, k]
            )

    def _push(self, row: int) -> None:
        """Set the force and the torque of base `row`, by which its velocity becomes `driven`.

        Both remove the error of the velocity within the step, up to the grip of the tyres.
        Returns 0.
        """
        linear = self._driven[row, 0]
        lateral = self._driven[row, 2]
        # A base that turns drives an arc. The chord of this step's arc has the heading half a step
        # ahead.
        yaw = self._qpos[3 * row + 2] + self._driven[row, 1] * (self._dt / 2.0)
        c = cos(yaw)
        s = sin(yaw)
        # The error in m/s in the world frame; only bodies that hover have a drift.
        error_x = c * linear - s * lateral + self._drift[row, 0] - self._qvel[3 * row]
        error_y = s * linear + c * lateral + self._drift[row, 1] - self._qvel[3 * row + 1]
        force_x = error_x * self._inert[row, 0] / self._dt
        force_y = error_y * self._inert[row, 1] / self._dt
        force = hypot(force_x, force_y)
        grip_share = min(1.0, self._grip[row] / max(force, 1e-12))
        self._applied[3 * row] = force_x * grip_share
        self._applied[3 * row + 1] = force_y * grip_share
        self._applied[3 * row + 2] = _clipped(
            (self._driven[row, 1] - self._qvel[3 * row + 2]) * self._inert[row, 2] / self._dt,
            self._grip_torque[row],
        )


def _accelerations(platform: Platform) -> tuple[Any, ...]:
    """Of each axis; sideways as ahead, unless `body` has a `lateral_acceleration`."""
    sideways = "lateral_acceleration" if "lateral_acceleration" in platform.body else _AHEAD
    return tuple(value(platform, key) for key in (_AHEAD, "angular_acceleration", sideways))


def _share(platform: Platform, dt: float) -> Any:
    """1; less for a base that follows commands as a first-order lag of `body.response_time` s."""
    time = platform.body.get("response_time", 0.0)
    return 1.0 - math.exp(-dt / time) if time > 0.0 else 1.0


@cython.cclass
class Wheels:
    """Odometry of n bases with errors.

    The random numbers of slip are drawn for _DRAWS readings at once: a draw for each reading would
    take half of the time of a reading.
    """

    _measured: Block  # (n, 3, 3) the matrices of `odometer.measurement`
    _truth: Table  # (n, 3) true poses at the last reading
    _reported: Table  # (n, 3) poses that the last reading reported, not wrapped
    _slip: float  # standard deviation
    _rngs: list[np.random.Generator]
    _blocks: list[Array]  # of each base the row of `_draws`, into which its generator writes
    _draws: Block  # (n, _DRAWS, 2) standard normal numbers
    _used: Indices  # (n,) how many pairs of `_draws` are used
    _slips: cython.double[2]  # factors near 1 on linear and angular motion of the present reading

    def __init__(
        self,
        measured: Array,
        truth: Array,
        reported: Array,
        slip: float,
        rngs: list[np.random.Generator],
    ) -> None:
        """`truth`, `reported` (n, 3): true and reported poses at the start, which `read` replaces.

        `measured` (n, 3, 3): from true to measured motion. `slip`: the standard deviation of the
        slip, which the generators `rngs` (n,) draw.
        """
        self._measured = measured.data
        self._truth = truth.data
        self._reported = reported.data
        draws = np.empty((len(rngs), _DRAWS, 2))
        self._slip = slip
        self._rngs = rngs
        self._blocks = list(draws)
        self._draws = draws.data
        self._used = np.full(len(rngs), _DRAWS, np.intp).data  # the first reading draws

    def read(
        self, rows: Indices, poses: Table, twists: Table, reported: Table, measured: Table
    ) -> None:
        """Fill `reported` and `measured` (m, 3): odometry's poses and twists of robots `rows` (m,).

        `poses` and `twists` (n, 3): the true poses in the world frame and the true twists of all
        robots. Before the twist, a row of `measured` holds the motion since the last reading.
        """
        if not cython.compiled:
            arrays = (np.asarray(one).data for one in (rows, poses, twists, reported, measured))
            rows, poses, twists, reported, measured = arrays
        for index in range(len(rows)):
            row = rows[index]
            self._draw_slips(row)
            self._measure_motion(row, index, poses, measured)
            self._add_motion(row, measured[index, 0], measured[index, 1], measured[index, 2])
            for k in range(3):
                self._truth[row, k] = poses[row, k]
                reported[index, k] = self._reported[row, k]
            reported[index, 2] = wrap(reported[index, 2])
            # The motion is in the reported pose now: the twist takes its place in `measured`.
            self._measure(row, index, twists[row, 0], twists[row, 1], twists[row, 2], measured)

    def _measure_motion(self, row: int, index: int, poses: Table, measured: Table) -> None:
        """Measure the motion of base `row` since the last reading. Returns 0.

        Sets row `index` of `measured` to the linear motion in m, the turn in rad and the lateral
        motion in m. The true motion is taken for a straight line along the mean heading.
        """
        x = poses[row, 0] - self._truth[row, 0]
        y = poses[row, 1] - self._truth[row, 1]
        turn = poses[row, 2] - self._truth[row, 2]
        mid_yaw = self._truth[row, 2] + turn / 2.0
        c = cos(mid_yaw)
        s = sin(mid_yaw)
        self._measure(row, index, c * x + s * y, turn, c * y - s * x, measured)

    def _add_motion(self, row: int, linear: float, turn: float, lateral: float) -> None:
        """Add a measured motion in m and rad to the reported pose of base `row`. Returns 0."""
        mid_yaw = self._reported[row, 2] + turn / 2.0
        c = cos(mid_yaw)
        s = sin(mid_yaw)
        self._reported[row, 0] += c * linear - s * lateral
        self._reported[row, 1] += s * linear + c * lateral
        self._reported[row, 2] += turn

    def _draw_slips(self, row: int) -> None:
        """Set `_slips` for a reading of base `row`; returns 0."""
        if self._used[row] == _DRAWS:
            self._rngs[row].standard_normal(out=self._blocks[row])
            self._used[row] = 0
        for k in range(2):
            self._slips[k] = 1.0 + self._slip * self._draws[row, self._used[row], k]
        self._used[row] += 1

    def _measure(
        self, row: int, index: int, linear: float, angular: float, lateral: float, measured: Table
    ) -> None:
        """Set row `index` of `measured` as the wheels of robot `row` measure a motion or twist."""
        m = self._measured
        measured[index, 0] = (linear * m[row, 0, 0] + angular * m[row, 1, 0]) * self._slips[0]
        measured[index, 1] = (linear * m[row, 0, 1] + angular * m[row, 1, 1]) * self._slips[1]
        measured[index, 2] = lateral * m[row, 2, 2]
