"""The forces on simulated bases, compiled: what `base_dynamics.py` does with numpy, same bits."""

import cython
import numpy as np
from cython.cimports.libc.math import cos, fabs, hypot, isfinite, sin

if not cython.compiled:
    raise ImportError("swarmd.sim.world.base_kernel is not compiled")


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
