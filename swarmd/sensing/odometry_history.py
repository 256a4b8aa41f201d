"""The last readings of odometry, and the motion of the sensor between two times."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.angles import TURN
from swarmd.core.buffers import view_of
from swarmd.core.values import (
    HISTORY,
    MAX_COORDINATE,
    MAX_EXTRAPOLATION,
    MAX_SPEED,
    MAX_STEP,
    Odometry,
)
from swarmd.sensing.scan_delay import ScanDelay

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import NAN, cos, fabs, hypot, isfinite, remainder, sin
else:
    from swarmd.core.cython_shadow import NAN, cos, fabs, hypot, isfinite, remainder, sin

_READINGS = cython.declare(cython.Py_ssize_t, HISTORY)
_MAX_EXTRAPOLATION = cython.declare(cython.double, MAX_EXTRAPOLATION)
_MAX_STEP = cython.declare(cython.double, MAX_STEP)
_MAX_SPEED = cython.declare(cython.double, MAX_SPEED)
_MAX_COORDINATE = cython.declare(cython.double, MAX_COORDINATE)
_MIN_STEP = cython.declare(cython.double, 1e-9)  # s between two poses of a path
# m and rad during one scan: a robot that moves less is at rest, and its scan is not changed.
_AT_REST = cython.declare(cython.double, 5e-4)
# Columns of a reading. The stamp is the first, so `r[start]` is the stamp of a reading at `start`.
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
    _delay: ScanDelay | None
    _readings: cython.double[::1]  # a ring buffer: _COLUMNS numbers each
    _newest: cython.Py_ssize_t  # the number of the newest reading in the buffer
    _count: cython.Py_ssize_t  # readings in use
    _x: cython.double  # the pose that `_set_pose` sets
    _y: cython.double
    _yaw: cython.double
    path: cython.double[:, ::1]  # see `set_path`
    motion: cython.double[::1]  # see `set_motion`

    def __init__(self, delay: ScanDelay | None = None) -> None:
        """`delay` gets each reading whose stamp is new."""
        self._delay = delay
        self.latest, self._readings = NAN, array("d", (_COLUMNS * _READINGS) * [0.0])
        self.path, self.motion = view_of(np.empty((_READINGS + 2, 4))), array("d", 3 * [0.0])

    def take(self, odometry: Odometry, now: cython.double) -> bool | None:
        """Store a reading that arrived at `now` s; True for a new stamp, False for the last stamp.

        None, and nothing is stored, if a value is not finite or too large. A copy of the newest
        stored reading is not stored again. All earlier readings are dropped if the stamp does not
        rise, or if the pose jumps: by more than MAX_STEP plus MAX_SPEED times the seconds since the
        newest stamp.
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

        # 1. A new stamp also updates the measured delay of scans.
        is_new: cython.bint = stamp != self.latest
        if is_new and self._delay is not None:
            self._delay.read(stamp, yaw, angular, pose, now)

        # 2. A copy changes nothing; a jump drops the earlier readings. The same bound holds for m
        # and for rad.
        r: cython.double[::1] = self._readings
        start: cython.Py_ssize_t = self._place(0)
        if self._count:
            is_same_pose: cython.bint = (
                x == r[start + _X] and y == r[start + _Y] and yaw == r[start + _YAW]
            )
            is_same_twist: cython.bint = (
                linear == r[start + _LINEAR]
                and angular == r[start + _ANGULAR]
                and lateral == r[start + _LATERAL]
            )
            if not is_new and is_same_pose and is_same_twist:
                return False
            jump: cython.double = hypot(x - r[start + _X], y - r[start + _Y])
            jump = max(jump, fabs(remainder(yaw - r[start + _YAW], TURN)))
            if stamp <= r[start] or jump > _MAX_STEP + _MAX_SPEED * (stamp - r[start]):
                self._count = 0

        # 3. Overwrites the oldest reading.
        self._newest = (self._newest + 1) % _READINGS
        self._count = min(self._count + 1, _READINGS)
        start = self._place(0)
        r[start + _STAMP] = self.latest = stamp
        r[start + _X], r[start + _Y] = x, y
        r[start + _YAW] = yaw
        r[start + _LINEAR], r[start + _ANGULAR] = linear, angular
        r[start + _LATERAL] = lateral
        return is_new

    @cython.cfunc
    def _place(self, before: cython.Py_ssize_t) -> cython.Py_ssize_t:
        """The index at which the reading begins that is `before` readings before the last one."""
        return _COLUMNS * ((self._newest - before + _READINGS) % _READINGS)

    @cython.cfunc
    def covers(self, stamp: cython.double) -> cython.bint:
        """True if the readings reach back to a time."""
        if self._count == 0:
            return False
        return stamp >= self._readings[self._place(self._count - 1)] - _MAX_EXTRAPOLATION

    @cython.cfunc
    def _set_pose(self, stamp: cython.double) -> cython.int:
        """Set `_x`, `_y` and `_yaw` to the pose at a stamp of odometry.

        Interpolates between two readings, or extrapolates from the newest reading for
        _MAX_EXTRAPOLATION s at most. Before the oldest reading, extrapolates back from that
        reading. There must be a reading.
        """
        r: cython.double[::1] = self._readings
        k: cython.Py_ssize_t
        earlier: cython.Py_ssize_t
        later: cython.Py_ssize_t = self._place(0)

        # 1. Interpolates between the last reading that is not after the stamp, and the next.
        for k in range(self._count):
            earlier = self._place(k)
            if r[earlier] <= stamp:
                if k == 0:
                    break  # the stamp is after all readings
                fraction = (stamp - r[earlier]) / (r[later] - r[earlier])
                turned = remainder(r[later + _YAW] - r[earlier + _YAW], TURN)
                self._x = r[earlier + _X] + fraction * (r[later + _X] - r[earlier + _X])
                self._y = r[earlier + _Y] + fraction * (r[later + _Y] - r[earlier + _Y])
                self._yaw = r[earlier + _YAW] + fraction * turned
                return 0
            later = earlier

        # 2. Extrapolates at a constant twist, along the chord of the arc. `later` is now the newest
        # reading if the stamp is after all readings, and the oldest if the stamp is before all.
        seconds: cython.double = min(stamp - r[later], _MAX_EXTRAPOLATION)
        turn: cython.double = r[later + _ANGULAR] * seconds
        cos_chord: cython.double = cos(r[later + _YAW] + 0.5 * turn)
        sin_chord: cython.double = sin(r[later + _YAW] + 0.5 * turn)
        ahead: cython.double = r[later + _LINEAR] * seconds
        left: cython.double = r[later + _LATERAL] * seconds
        self._x = r[later + _X] + cos_chord * ahead - sin_chord * left
        self._y = r[later + _Y] + sin_chord * ahead + cos_chord * left
        self._yaw = r[later + _YAW] + turn

    @cython.cfunc
    def set_path(self, end: cython.double, seconds: cython.double) -> cython.Py_ssize_t:
        """Set `path`, the motion in the `seconds` before the stamp `end`; the number of its rows.

        Each row of `path` has the s before `end`, and x and y in m and yaw in rad relative to the
        pose at `end`. The rows: `end`, each reading in between, and the begin. 0 rows if the robot
        is at rest, if the readings do not reach back that far, or if `seconds` is 0.
        """
        if seconds == 0.0 or not self.covers(end - seconds):
            return 0
        r: cython.double[::1] = self._readings
        rows: cython.Py_ssize_t = 1
        i: cython.Py_ssize_t
        start: cython.Py_ssize_t
        self._set_pose(end)
        self._set_row(0, 0.0, self._x, self._y, self._yaw)
        # From the newest reading back; readings after `end` are skipped.
        for i in range(self._count):
            start = self._place(i)
            if end - r[start] >= seconds - _MIN_STEP:
                break
            if end - r[start] > _MIN_STEP:
                self._set_row(rows, end - r[start], r[start + _X], r[start + _Y], r[start + _YAW])
                rows += 1
        self._set_pose(end - seconds)
        self._set_row(rows, seconds, self._x, self._y, self._yaw)
        rows += 1
        return rows if self._makes_relative(rows) else 0  # false: at rest on the whole path

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

    @cython.cfunc
    def _makes_relative(self, rows: cython.Py_ssize_t) -> cython.bint:
        """Make the poses of the path relative to the first one; false if all are at rest."""
        path: cython.double[:, ::1] = self.path
        x: cython.double = path[0, 1]
        y: cython.double = path[0, 2]
        yaw: cython.double = path[0, 3]
        cos_yaw: cython.double = cos(yaw)
        sin_yaw: cython.double = sin(yaw)
        turned: cython.double = 0.0
        moves: cython.bint = False
        i: cython.Py_ssize_t
        for i in range(rows):
            dx, dy = path[i, 1] - x, path[i, 2] - y
            turned += remainder(path[i, 3] - yaw - turned, TURN)
            path[i, 1], path[i, 2] = cos_yaw * dx + sin_yaw * dy, cos_yaw * dy - sin_yaw * dx
            path[i, 3] = turned
            if max(fabs(path[i, 1]), fabs(path[i, 2]), fabs(turned)) > _AT_REST:
                moves = True
        return moves

    @cython.cfunc
    def set_motion(self, stamp: cython.double, end: cython.double) -> cython.int:
        """Set `motion`: x, y, yaw of the pose at a stamp, relative to the pose at `end`."""
        self._set_pose(end)
        x: cython.double = self._x
        y: cython.double = self._y
        yaw: cython.double = self._yaw
        self._set_pose(stamp)
        dx: cython.double = self._x - x
        dy: cython.double = self._y - y
        cos_yaw: cython.double = cos(yaw)
        sin_yaw: cython.double = sin(yaw)
        self.motion[0], self.motion[1] = cos_yaw * dx + sin_yaw * dy, cos_yaw * dy - sin_yaw * dx
        self.motion[2] = self._yaw - yaw
