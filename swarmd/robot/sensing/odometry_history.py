"""The last readings of odometry, and the motion of the sensor between two times."""

from __future__ import annotations

from array import array

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import TURN
from swarmd.core.buffers import view_of
from swarmd.core.cython_shadow import Doubles, Table, cos, fabs, hypot, remainder, sin
from swarmd.core.odometry_trail import (
    ANEW,
    R_ANGULAR,
    R_LATERAL,
    R_LINEAR,
    R_X,
    R_Y,
    R_YAW,
    REFUSED,
    OdometryTrail,
)
from swarmd.core.values import HISTORY, Odometry
from swarmd.robot.sensing.scan_delay import ScanDelay

_MIN_STEP = 1e-9  # s between two poses of a path
# m and rad during one scan: a robot that moves less is at rest, and its scan is not changed.
_AT_REST = 5e-4
# m and rad between two readings that the twist need not explain, and times by which the motion may
# exceed the twist; s of a gap in which the twist explains motion. As drivers/ros/carried_pose.py.
_SHIFT_WAY = 0.1
_SHIFT_TURN = 0.2
_TWIST_EXCESS = 1.5
_MAX_GAP = 0.5
# s in which a shift fades, and faded shifts that are more than one correction (following.py).
_SHIFT_TIME = 30.0
_SHIFTS = 1.5


@cython.cclass
class OdometryHistory:
    """The last readings of odometry, which give the motion of the sensor.

    `has_shifted`: the pose of the last reading differs from the pose before by more than a base
    moves, as after a reset or a correction: no motion between both is known.
    """

    has_shifted: bool
    _shifts: float
    _delay: ScanDelay | None
    trail: OdometryTrail
    path: Table  # see `set_path`
    motion: Doubles  # see `set_motion`

    def __init__(self, delay: ScanDelay | None = None) -> None:
        """`delay` gets each reading whose stamp is new."""
        self._delay = delay
        self._shifts = 0.0
        self.trail = OdometryTrail()
        self.path = view_of(np.empty((HISTORY + 2, 4)))
        self.motion = array("d", 3 * [0.0])

    def take(self, odometry: Odometry, now: float) -> bool | None:
        """Store a reading that arrived at `now` s; True for a new stamp, False for the last stamp.

        None, and nothing is stored, if a value is not finite or too large.
        """
        stamp = odometry.stamp
        is_new = stamp != self.trail.latest
        is_shift = self._is_shift(odometry)
        passed = stamp - self.trail.latest if self.trail.count else 0.0
        taken = self.trail.take(odometry, True)
        if taken == REFUSED:
            return None
        is_shift = is_shift or taken == ANEW
        self._shifts *= min(max(1.0 - passed / _SHIFT_TIME, 0.0), 1.0)
        self._shifts += 1.0 if is_shift else 0.0
        # Shifts again and again are no corrections: they must not silence what compares rays.
        self.has_shifted = is_shift and self._shifts <= _SHIFTS
        if is_new and self._delay is not None:
            pose = odometry.pose
            twist = odometry.twist
            self._delay.read(stamp, pose.yaw, twist.angular, pose, now)
        return is_new

    def _is_shift(self, odometry: Odometry) -> bool:
        """True if the twist does not explain how the pose differs from the newest reading."""
        trail: OdometryTrail = self.trail
        if trail.count == 0:
            return False
        r = trail.readings
        last = trail.place(0)
        pose = odometry.pose
        twist = odometry.twist
        x = pose.x
        y = pose.y
        yaw = pose.yaw
        linear = twist.linear
        lateral = twist.lateral
        angular = twist.angular
        seconds = min(odometry.stamp - r[last], _MAX_GAP)
        speed = max(hypot(linear, lateral), hypot(r[last + R_LINEAR], r[last + R_LATERAL]))
        rate = max(fabs(angular), fabs(r[last + R_ANGULAR]))
        way = hypot(x - r[last + R_X], y - r[last + R_Y])
        turn = fabs(remainder(yaw - r[last + R_YAW], TURN))
        return (
            way > _SHIFT_WAY + _TWIST_EXCESS * speed * seconds
            or turn > _SHIFT_TURN + _TWIST_EXCESS * rate * seconds
        )

    @property
    def latest(self) -> float:
        """The newest stamp in s; NaN without a reading."""
        return self.trail.latest

    def covers(self, stamp: float) -> bool:
        """True if the readings reach back to a time."""
        return self.trail.covers(stamp)

    def set_path(self, end: float, seconds: float) -> int:
        """Set `path`, the motion in the `seconds` before the stamp `end`; the number of its rows.

        Each row of `path` has the s before `end`, and x and y in m and yaw in rad relative to the
        pose at `end`. The rows: `end`, each reading in between, and the begin. 0 rows if the robot
        is at rest, if the readings do not reach back that far, or if `seconds` is 0.
        """
        trail: OdometryTrail = self.trail
        if seconds == 0.0 or not trail.covers(end - seconds):
            return 0
        r = trail.readings
        rows = 1
        trail.set_pose(end)
        self._set_row(0, 0.0, trail.x, trail.y, trail.yaw)
        # From the newest reading back; readings after `end` are skipped.
        for i in range(trail.count):
            start = trail.place(i)
            if end - r[start] >= seconds - _MIN_STEP:
                break
            if end - r[start] > _MIN_STEP:
                self._set_row(
                    rows, end - r[start], r[start + R_X], r[start + R_Y], r[start + R_YAW]
                )
                rows += 1
        trail.set_pose(end - seconds)
        self._set_row(rows, seconds, trail.x, trail.y, trail.yaw)
        rows += 1
        return rows if self._makes_relative(rows) else 0  # false: at rest on the whole path

    def _set_row(self, row: int, before: float, x: float, y: float, yaw: float) -> None:
        p = self.path
        p[row, 0] = before
        p[row, 1] = x
        p[row, 2] = y
        p[row, 3] = yaw

    def _makes_relative(self, rows: int) -> bool:
        """Make the poses of the path relative to the first one; false if all are at rest."""
        path = self.path
        x = path[0, 1]
        y = path[0, 2]
        yaw = path[0, 3]
        cos_yaw = cos(yaw)
        sin_yaw = sin(yaw)
        turned = 0.0
        moves = False
        for i in range(rows):
            dx = path[i, 1] - x
            dy = path[i, 2] - y
            turned += remainder(path[i, 3] - yaw - turned, TURN)
            path[i, 1] = cos_yaw * dx + sin_yaw * dy
            path[i, 2] = cos_yaw * dy - sin_yaw * dx
            path[i, 3] = turned
            if max(fabs(path[i, 1]), fabs(path[i, 2]), fabs(turned)) > _AT_REST:
                moves = True
        return moves

    def set_motion(self, stamp: float, end: float) -> None:
        """Set `motion`: x, y, yaw of the pose at a stamp, relative to the pose at `end`."""
        trail: OdometryTrail = self.trail
        trail.set_pose(end)
        x = trail.x
        y = trail.y
        yaw = trail.yaw
        trail.set_pose(stamp)
        dx = trail.x - x
        dy = trail.y - y
        cos_yaw = cos(yaw)
        sin_yaw = sin(yaw)
        self.motion[0] = cos_yaw * dx + sin_yaw * dy
        self.motion[1] = cos_yaw * dy - sin_yaw * dx
        self.motion[2] = trail.yaw - yaw
