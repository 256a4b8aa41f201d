"""How much odometry is kept, and how far it is extrapolated."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.values import MAX_COORDINATE, MAX_SPEED, MAX_STEP, Odometry
from swarmd.sensing.angles import TURN
from swarmd.sensing.scan_delay import ScanDelay

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import NAN, cos, fabs, hypot, isfinite, remainder, sin
else:
    from swarmd.core.cython_shadow import NAN, cos, fabs, hypot, isfinite, remainder, sin

MAX_EXTRAPOLATION = 0.15
"""Seconds for which the last measured twist is extrapolated: three odometry periods."""

HISTORY = 40
"""Readings that are kept."""

_READINGS = cython.declare(cython.Py_ssize_t, HISTORY)
_MAX_EXTRAPOLATION = cython.declare(cython.double, MAX_EXTRAPOLATION)
_MAX_STEP = cython.declare(cython.double, MAX_STEP)
_MAX_SPEED = cython.declare(cython.double, MAX_SPEED)
_MAX_COORDINATE = cython.declare(cython.double, MAX_COORDINATE)
_MIN_STEP = cython.declare(cython.double, 1e-9)  # s between two poses of a path
# m and rad during one scan: a robot that moves less is at rest, and its scan is not changed.
_AT_REST = cython.declare(cython.double, 5e-4)


@cython.cclass
class OdometryHistory:
    """The last readings of odometry, for all that needs the motion of the sensor.

    `latest`: the stamp in s of the last reading; NaN without one.
    """

    latest = cython.declare(cython.double, visibility="readonly")
    _delay: ScanDelay
    # The last readings: stamp, x, y, yaw, linear, angular, lateral.
    _readings: cython.double[::1]
    _last: cython.Py_ssize_t
    _known: cython.Py_ssize_t
    _x: cython.double  # the pose that `_find` found
    _y: cython.double
    _yaw: cython.double
    path: cython.double[:, ::1]
    way: cython.double[::1]

    def __init__(self, delay: ScanDelay | None = None) -> None:
        """`delay` gets each reading whose stamp is new."""
        self._delay = delay
        self.latest, self._readings = NAN, array("d", (7 * _READINGS) * [0.0])
        self.path, self.way = memoryview(np.empty((_READINGS + 2, 4))), array("d", 3 * [0.0])

    def take(self, odometry: Odometry, now: cython.double) -> bool | None:
        """Take in a reading at `now`; true if its stamp is new, None if it is not valid.

        A new reading whose stamp does not rise, or whose pose jumps, ends the history before it.
        """
        pose, twist = odometry.pose, odometry.twist
        stamp: cython.double = odometry.stamp
        x: cython.double = pose.x
        y: cython.double = pose.y
        yaw: cython.double = pose.yaw
        linear: cython.double = twist.linear
        angular: cython.double = twist.angular
        lateral: cython.double = twist.lateral
        if not (  # see Odometry.is_valid, which takes longer
            isfinite(stamp)
            and fabs(x) <= _MAX_COORDINATE
            and fabs(y) <= _MAX_COORDINATE
            and fabs(yaw) <= _MAX_COORDINATE
            and fabs(linear) <= _MAX_COORDINATE
            and fabs(angular) <= _MAX_COORDINATE
            and fabs(lateral) <= _MAX_COORDINATE
        ):
            return None
        is_new: cython.bint = stamp != self.latest
        if is_new and self._delay is not None:
            self._delay.read(stamp, yaw, angular, pose, now)
        r: cython.double[::1] = self._readings
        at: cython.Py_ssize_t = 7 * self._last
        if self._known:
            if (
                not is_new
                and (x == r[at + 1] and y == r[at + 2] and yaw == r[at + 3])
                and (linear == r[at + 4] and angular == r[at + 5] and lateral == r[at + 6])
            ):
                return False
            apart: cython.double = hypot(x - r[at + 1], y - r[at + 2])
            apart = max(apart, fabs(remainder(yaw - r[at + 3], TURN)))
            if stamp <= r[at] or apart > _MAX_STEP + _MAX_SPEED * (stamp - r[at]):
                self._known = 0
        self._last = (self._last + 1) % _READINGS
        self._known = min(self._known + 1, _READINGS)
        at = 7 * self._last
        r[at], r[at + 1], r[at + 2], r[at + 3] = stamp, x, y, yaw
        r[at + 4], r[at + 5], r[at + 6] = linear, angular, lateral
        self.latest = stamp
        return is_new

    @cython.cfunc
    def covers(self, at: cython.double) -> cython.bint:
        """True if the readings reach back to a time."""
        first: cython.Py_ssize_t = (self._last + 1 - self._known + _READINGS) % _READINGS
        return self._known > 0 and at >= self._readings[7 * first] - _MAX_EXTRAPOLATION

    @cython.cfunc
    def _find(self, at: cython.double) -> cython.int:
        """Find the pose at a time, of one reading at least: between two, or extrapolated."""
        r: cython.double[::1] = self._readings
        k: cython.Py_ssize_t
        early: cython.Py_ssize_t
        late: cython.Py_ssize_t = 7 * self._last
        for k in range(self._known):
            early = 7 * ((self._last - k + _READINGS) % _READINGS)
            if r[early] <= at:
                if k == 0:
                    break
                share = (at - r[early]) / (r[late] - r[early])
                self._x = r[early + 1] + share * (r[late + 1] - r[early + 1])
                self._y = r[early + 2] + share * (r[late + 2] - r[early + 2])
                self._yaw = r[early + 3] + share * remainder(r[late + 3] - r[early + 3], TURN)
                return 0
            late = early
        # At a constant twist, along the chord of its arc.
        share = min(at - r[late], _MAX_EXTRAPOLATION)
        turn: cython.double = r[late + 5] * share
        c: cython.double = cos(r[late + 3] + 0.5 * turn)
        s: cython.double = sin(r[late + 3] + 0.5 * turn)
        ahead: cython.double = r[late + 4] * share
        left: cython.double = r[late + 6] * share
        self._x = r[late + 1] + c * ahead - s * left
        self._y = r[late + 2] + s * ahead + c * left
        self._yaw = r[late + 3] + turn
        return 0

    @cython.cfunc
    def set_path(self, at: cython.double, seconds: cython.double) -> cython.Py_ssize_t:
        """Set the path from the pose at a time back to that `seconds` earlier; its rows.

        0 at rest, without readings that reach back that far, and for no time.
        """
        if seconds == 0.0 or not self.covers(at - seconds):
            return 0
        r: cython.double[::1] = self._readings
        p: cython.double[:, ::1] = self.path
        rows: cython.Py_ssize_t = 1
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        self._find(at)
        p[0, 1], p[0, 2], p[0, 3] = self._x, self._y, self._yaw
        for i in range(self._known):
            k = 7 * ((self._last - i + _READINGS) % _READINGS)
            if at - r[k] >= seconds - _MIN_STEP:
                break
            if at - r[k] > _MIN_STEP:
                p[rows, 0], p[rows, 1], p[rows, 2], p[rows, 3] = (
                    at - r[k],
                    r[k + 1],
                    r[k + 2],
                    r[k + 3],
                )
                rows += 1
        self._find(at - seconds)
        p[rows, 0], p[rows, 1], p[rows, 2], p[rows, 3] = seconds, self._x, self._y, self._yaw
        rows += 1
        x: cython.double = p[0, 1]
        y: cython.double = p[0, 2]
        yaw: cython.double = p[0, 3]
        c: cython.double = cos(yaw)
        s: cython.double = sin(yaw)
        turned: cython.double = 0.0
        moves: cython.bint = False
        p[0, 0] = 0.0
        for i in range(rows):
            dx, dy = p[i, 1] - x, p[i, 2] - y
            turned += remainder(p[i, 3] - yaw - turned, TURN)
            p[i, 1], p[i, 2], p[i, 3] = c * dx + s * dy, c * dy - s * dx, turned
            if max(fabs(p[i, 1]), fabs(p[i, 2]), fabs(turned)) > _AT_REST:
                moves = True
        return rows if moves else 0

    @cython.cfunc
    def set_way(self, at: cython.double, end: cython.double) -> cython.int:
        """Set the way to the pose at a time from that at its `end`."""
        self._find(end)
        x: cython.double = self._x
        y: cython.double = self._y
        yaw: cython.double = self._yaw
        self._find(at)
        dx: cython.double = self._x - x
        dy: cython.double = self._y - y
        c: cython.double = cos(yaw)
        s: cython.double = sin(yaw)
        self.way[0], self.way[1] = c * dx + s * dy, c * dy - s * dx
        self.way[2] = self._yaw - yaw
        return 0
