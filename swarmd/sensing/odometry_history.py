"""The last readings of odometry, and the motion of the sensor between two times."""

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
# Columns of a reading.
_COLUMNS = cython.declare(cython.Py_ssize_t, 7)
_STAMP = cython.declare(cython.Py_ssize_t, 0)
_X = cython.declare(cython.Py_ssize_t, 1)
_Y = cython.declare(cython.Py_ssize_t, 2)
_YAW = cython.declare(cython.Py_ssize_t, 3)
_LINEAR = cython.declare(cython.Py_ssize_t, 4)
_ANGULAR = cython.declare(cython.Py_ssize_t, 5)
_LATERAL = cython.declare(cython.Py_ssize_t, 6)


@cython.cclass
class OdometryHistory:
    """The last readings of odometry, which give the motion of the sensor.

    `latest` in s is the stamp of the last reading; NaN without a reading.
    """

    latest = cython.declare(cython.double, visibility="readonly")
    _delay: ScanDelay
    _readings: cython.double[::1]  # the last ones, in turn
    _last: cython.Py_ssize_t  # the number of the last reading among them
    _known: cython.Py_ssize_t  # how many there are
    _x: cython.double  # the pose that `_set_pose` sets
    _y: cython.double
    _yaw: cython.double
    path: cython.double[:, ::1]  # see `set_path`
    way: cython.double[::1]  # see `set_way`

    def __init__(self, delay: ScanDelay | None = None) -> None:
        """`delay` gets each reading whose stamp is new."""
        self._delay = delay
        self.latest, self._readings = NAN, array("d", (_COLUMNS * _READINGS) * [0.0])
        self.path, self.way = memoryview(np.empty((_READINGS + 2, 4))), array("d", 3 * [0.0])

    def take(self, odometry: Odometry, now: cython.double) -> bool | None:
        """Take in a reading that arrived at `now`; True if its stamp is new, None if it is invalid.

        If the stamp of a new reading does not rise, or its pose jumps, all earlier readings are
        dropped.
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
        at: cython.Py_ssize_t = self._place(0)
        if self._known:
            if (
                not is_new
                and (x == r[at + _X] and y == r[at + _Y] and yaw == r[at + _YAW])
                and (linear == r[at + _LINEAR] and angular == r[at + _ANGULAR])
                and lateral == r[at + _LATERAL]
            ):
                return False
            apart: cython.double = hypot(x - r[at + _X], y - r[at + _Y])
            apart = max(apart, fabs(remainder(yaw - r[at + _YAW], TURN)))
            if stamp <= r[at] or apart > _MAX_STEP + _MAX_SPEED * (stamp - r[at]):
                self._known = 0
        self._last = (self._last + 1) % _READINGS
        self._known = min(self._known + 1, _READINGS)
        at = self._place(0)
        r[at + _STAMP] = self.latest = stamp
        r[at + _X], r[at + _Y] = x, y
        r[at + _YAW] = yaw
        r[at + _LINEAR], r[at + _ANGULAR] = linear, angular
        r[at + _LATERAL] = lateral
        return is_new

    @cython.cfunc
    def _place(self, before: cython.Py_ssize_t) -> cython.Py_ssize_t:
        """The index at which the reading begins that is `before` readings before the last one."""
        return _COLUMNS * ((self._last - before + _READINGS) % _READINGS)

    @cython.cfunc
    def covers(self, at: cython.double) -> cython.bint:
        """True if the readings reach back to a time."""
        if self._known == 0:
            return False
        return at >= self._readings[self._place(self._known - 1)] - _MAX_EXTRAPOLATION

    @cython.cfunc
    def _set_pose(self, at: cython.double) -> cython.int:
        """Set the pose at a time: interpolated between two readings, or extrapolated.

        There must be a reading.
        """
        r: cython.double[::1] = self._readings
        k: cython.Py_ssize_t
        early: cython.Py_ssize_t
        late: cython.Py_ssize_t = self._place(0)
        for k in range(self._known):
            early = self._place(k)
            if r[early] <= at:
                if k == 0:
                    break
                share = (at - r[early]) / (r[late] - r[early])
                turned = remainder(r[late + _YAW] - r[early + _YAW], TURN)
                self._x = r[early + _X] + share * (r[late + _X] - r[early + _X])
                self._y = r[early + _Y] + share * (r[late + _Y] - r[early + _Y])
                self._yaw = r[early + _YAW] + share * turned
                return 0
            late = early
        # At a constant twist, along the chord of its arc.
        seconds: cython.double = min(at - r[late], _MAX_EXTRAPOLATION)
        turn: cython.double = r[late + _ANGULAR] * seconds
        c: cython.double = cos(r[late + _YAW] + 0.5 * turn)
        s: cython.double = sin(r[late + _YAW] + 0.5 * turn)
        ahead: cython.double = r[late + _LINEAR] * seconds
        left: cython.double = r[late + _LATERAL] * seconds
        self._x = r[late + _X] + c * ahead - s * left
        self._y = r[late + _Y] + s * ahead + c * left
        self._yaw = r[late + _YAW] + turn
        return 0

    @cython.cfunc
    def set_path(self, at: cython.double, seconds: cython.double) -> cython.Py_ssize_t:
        """Set `path`, the motion of the last `seconds` before the time `at`; the number of rows.

        Each row of `path` has s before `at`, and x and y in m and yaw in rad relative to the pose
        at `at`. 0 rows at rest, if the readings do not reach back that far, or if `seconds` is 0.
        """
        if seconds == 0.0 or not self.covers(at - seconds):
            return 0
        r: cython.double[::1] = self._readings
        rows: cython.Py_ssize_t = 1
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        self._set_pose(at)
        self._set_row(0, 0.0, self._x, self._y, self._yaw)
        for i in range(self._known):
            k = self._place(i)
            if at - r[k] >= seconds - _MIN_STEP:
                break
            if at - r[k] > _MIN_STEP:
                self._set_row(rows, at - r[k], r[k + _X], r[k + _Y], r[k + _YAW])
                rows += 1
        self._set_pose(at - seconds)
        self._set_row(rows, seconds, self._x, self._y, self._yaw)
        rows += 1
        return rows if self._makes_relative(rows) else 0

    @cython.cfunc
    def _set_row(
        self,
        row: cython.Py_ssize_t,
        before: cython.double,
        x: cython.double,
        y: cython.double,
        yaw: cython.double,
    ) -> cython.int:
        p: cython.double[:, ::1] = self.path
        p[row, 0], p[row, 1] = before, x
        p[row, 2], p[row, 3] = y, yaw
        return 0

    @cython.cfunc
    def _makes_relative(self, rows: cython.Py_ssize_t) -> cython.bint:
        """Make the poses of the path relative to the first one; false if all are at rest."""
        p: cython.double[:, ::1] = self.path
        x: cython.double = p[0, 1]
        y: cython.double = p[0, 2]
        yaw: cython.double = p[0, 3]
        c: cython.double = cos(yaw)
        s: cython.double = sin(yaw)
        turned: cython.double = 0.0
        moves: cython.bint = False
        i: cython.Py_ssize_t
        for i in range(rows):
            dx, dy = p[i, 1] - x, p[i, 2] - y
            turned += remainder(p[i, 3] - yaw - turned, TURN)
            p[i, 1], p[i, 2] = c * dx + s * dy, c * dy - s * dx
            p[i, 3] = turned
            if max(fabs(p[i, 1]), fabs(p[i, 2]), fabs(turned)) > _AT_REST:
                moves = True
        return moves

    @cython.cfunc
    def set_way(self, at: cython.double, end: cython.double) -> cython.int:
        """Set x, y and yaw of the pose at a time, relative to that at an `end`."""
        self._set_pose(end)
        x: cython.double = self._x
        y: cython.double = self._y
        yaw: cython.double = self._yaw
        self._set_pose(at)
        dx: cython.double = self._x - x
        dy: cython.double = self._y - y
        c: cython.double = cos(yaw)
        s: cython.double = sin(yaw)
        self.way[0], self.way[1] = c * dx + s * dy, c * dy - s * dx
        self.way[2] = self._yaw - yaw
        return 0
