"""The forces on simulated bases and their odometry, compiled.

What `base_dynamics.py` and `odometer.py` do with numpy, with the same bits.
"""

import math

import cython
import numpy as np
from cython.cimports.libc.math import cos, fabs, fmod, hypot, isfinite, sin

if not cython.compiled:
    raise ImportError("swarmd.sim.world.base_kernel is not compiled")

_PI = cython.declare(cython.double, math.pi)


@cython.cfunc
@cython.exceptval(check=False)
def _clipped(value: cython.double, limit: cython.double) -> cython.double:
    """`value` within +- `limit`; `limit` is at least 0."""
    if fabs(value) <= limit:
        return value
    return limit if value > 0.0 else -limit


@cython.cclass
class Servos:
    """Delay, acceleration caps and velocity servos of n bases, on MuJoCo's own memory."""

    _n: cython.Py_ssize_t
    _dt: cython.double
    _qpos: cython.double[::1]
    _qvel: cython.double[::1]
    _applied: cython.double[::1]
    _qpos_before: cython.double[::1]
    _qvel_before: cython.double[::1]
    _line: cython.double[:, :, ::1]  # the commands of the last steps
    _command: cython.double[:, ::1]
    _step: cython.Py_ssize_t
    _is_capped: cython.bint
    _caps: cython.double[::1]
    _capped: cython.double[:, ::1]
    _limits: cython.double[:, ::1]
    _gains: cython.double[:, ::1]
    _inert: cython.double[:, ::1]
    _grip: cython.double[::1]
    _spin: cython.double[::1]
    _driven: cython.double[:, ::1]

    def __init__(self, actuators, drives, dt, memory, before):
        n = len(drives.limits)
        self._n, self._dt = n, dt
        self._qpos, self._qvel, self._applied = memory
        self._qpos_before, self._qvel_before = before
        self._line = np.zeros((actuators.delay_steps + 1, n, 3))
        self._command = np.zeros((n, 3))
        self._is_capped, self._caps = actuators.is_capped, actuators.gains
        self._capped = np.zeros((n, 3))
        self._limits, self._gains = drives.limits, drives.gains
        self._inert, self._grip, self._spin = drives.inert, drives.grip, drives.spin
        self._driven = np.zeros((n, 3))

    def put(self, commands: cython.double[:, ::1]):
        """Set the commands (n, 3) linear, angular, lateral."""
        row: cython.Py_ssize_t
        k: cython.Py_ssize_t
        for row in range(self._n):
            for k in range(3):
                self._command[row, k] = commands[row, k]

    def drive(self):
        """Set the forces for the next step, and keep the state before it."""
        i: cython.Py_ssize_t
        row: cython.Py_ssize_t
        k: cython.Py_ssize_t
        now: cython.Py_ssize_t = self._step % self._line.shape[0]
        oldest: cython.Py_ssize_t = (self._step + 1) % self._line.shape[0]
        target: cython.double
        yaw: cython.double
        c: cython.double
        s: cython.double
        linear: cython.double
        lateral: cython.double
        x: cython.double
        y: cython.double
        size: cython.double
        share: cython.double
        self._step += 1
        for i in range(self._qpos.shape[0]):
            self._qpos_before[i], self._qvel_before[i] = self._qpos[i], self._qvel[i]
        for row in range(self._n):
            for k in range(3):
                self._line[now, row, k] = self._command[row, k]
            for k in range(3):
                target = self._line[oldest, row, k]
                target = _clipped(target if isfinite(target) else 0.0, self._limits[row, k])
                if self._is_capped:
                    self._capped[row, k] += _clipped(target - self._capped[row, k], self._caps[k])
                    target = _clipped(self._capped[row, k], self._limits[row, k])
                self._driven[row, k] += _clipped(target - self._driven[row, k], self._gains[row, k])
            linear, lateral = self._driven[row, 0], self._driven[row, 2]
            # Half a step ahead, the heading at which this step's displacement is a chord.
            yaw = self._qpos[3 * row + 2] + self._driven[row, 1] * (self._dt / 2.0)
            c, s = cos(yaw), sin(yaw)
            x = c * linear - s * lateral - self._qvel[3 * row]
            y = s * linear + c * lateral - self._qvel[3 * row + 1]
            x = x * self._inert[row, 0] / self._dt
            y = y * self._inert[row, 1] / self._dt
            size = hypot(x, y)
            share = min(1.0, self._grip[row] / max(size, 1e-12))
            self._applied[3 * row] = x * share
            self._applied[3 * row + 1] = y * share
            self._applied[3 * row + 2] = _clipped(
                (self._driven[row, 1] - self._qvel[3 * row + 2]) * self._inert[row, 2] / self._dt,
                self._spin[row],
            )


@cython.cclass
class Wheels:
    """Odometry of n bases: `measured` (n, 3, 3), and the poses (n, 3) that `read` brings on."""

    _measured: cython.double[:, :, ::1]
    _truth: cython.double[:, ::1]
    _reported: cython.double[:, ::1]

    def __init__(self, measured, truth, reported):
        self._measured, self._truth, self._reported = measured, truth, reported

    def read(
        self,
        rows: cython.Py_ssize_t[::1],
        poses: cython.double[:, ::1],
        twists: cython.double[:, ::1],
        slips: cython.double[:, ::1],
        reported: cython.double[:, ::1],
        measured: cython.double[:, ::1],
    ):
        """Fill `reported` and `measured` (m, 3), poses and twists of robots `rows` (m,)."""
        place: cython.Py_ssize_t
        row: cython.Py_ssize_t
        k: cython.Py_ssize_t
        x: cython.double
        y: cython.double
        turn: cython.double
        middle: cython.double
        c: cython.double
        s: cython.double
        linear: cython.double
        lateral: cython.double
        for place in range(rows.shape[0]):
            row = rows[place]
            x, y = poses[row, 0] - self._truth[row, 0], poses[row, 1] - self._truth[row, 1]
            turn = poses[row, 2] - self._truth[row, 2]
            middle = self._truth[row, 2] + turn / 2.0
            c, s = cos(middle), sin(middle)
            self._measure(row, place, c * x + s * y, turn, c * y - s * x, slips, measured)
            linear, turn, lateral = measured[place, 0], measured[place, 1], measured[place, 2]
            middle = self._reported[row, 2] + turn / 2.0
            c, s = cos(middle), sin(middle)
            self._reported[row, 0] += c * linear - s * lateral
            self._reported[row, 1] += s * linear + c * lateral
            self._reported[row, 2] += turn
            for k in range(3):
                self._truth[row, k] = poses[row, k]
                reported[place, k] = self._reported[row, k]
            reported[place, 2] = _wrapped(reported[place, 2])
            self._measure(
                row, place, twists[row, 0], twists[row, 1], twists[row, 2], slips, measured
            )

    @cython.cfunc
    def _measure(
        self,
        row: cython.Py_ssize_t,
        place: cython.Py_ssize_t,
        linear: cython.double,
        angular: cython.double,
        lateral: cython.double,
        slips: cython.double[:, ::1],
        measured: cython.double[:, ::1],
    ) -> cython.int:
        m: cython.double[:, :, ::1] = self._measured
        measured[place, 0] = (linear * m[row, 0, 0] + angular * m[row, 1, 0]) * slips[place, 0]
        measured[place, 1] = (linear * m[row, 0, 1] + angular * m[row, 1, 1]) * slips[place, 1]
        measured[place, 2] = lateral * m[row, 2, 2]
        return 0


@cython.cfunc
@cython.exceptval(check=False)
def _wrapped(yaw: cython.double) -> cython.double:
    wrapped: cython.double = fmod(yaw + _PI, 2.0 * _PI)
    if wrapped < 0.0:
        wrapped += 2.0 * _PI
    return wrapped - _PI
