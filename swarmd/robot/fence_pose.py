"""Decides which poses in a shared frame the fence of a robot may use, and when the robot is held.

1. Two poses agree if the robot has moved from the first to the second by its odometry, to within
   the error bounds of both poses and of odometry.
2. A pose is used once CONFIRMATIONS poses in a row agree, over at least CONFIRM_TIME.
3. A pose that does not agree with the pose in use is a jump: the robot has no usable pose until new
   poses agree by rule 2, or a pose agrees with the pose in use again.
4. With `without_pose: hold` of the fence, the robot is held while it has no usable pose, and once
   the pose in use is older than the timeout (`until`).

Pure. Units: m, rad, s on the robot's clock.
"""

from __future__ import annotations

import math
from collections import deque

from msgspec import Struct

from swarmd.core.values import Odometry, Pose, SharedPose
from swarmd.protection.decision import Anchor
from swarmd.protection.fence_settings import FenceSettings
from swarmd.protection.settings import ODOMETRY_SHARE
from swarmd.sensing.odometry_history import HISTORY, MAX_EXTRAPOLATION

CONFIRMATIONS = 3
"""Poses in a row, after the first pose of a new place, that agree each with the pose before."""
CONFIRM_TIME = 0.2
"""Seconds that the last of these poses is newer than the first pose, at least."""
FORGET_TIME = 5.0
"""Seconds after which a pose in use is no longer compared with new poses."""
_SLACK = 0.02, 0.02  # m and rad that two poses may differ by, beside their errors


class _Fix(Struct, frozen=True):
    """A measured pose with the odometry at the same time."""

    shared: SharedPose  # the measured pose, in the frame of the fence
    odometry: Pose  # the pose by odometry at the same time
    error: float  # m, the bound of the error of `shared`
    yaw_error: float  # rad, the bound of the error of the yaw of `shared`
    at: float  # s, the time of the pose
    way: float  # m driven since the start of the daemon; the error of odometry grows with it
    turned: float  # rad turned since the start, both senses counted


class FencePose:
    """The pose of one robot in the frame of its fence."""

    def __init__(self, settings: FenceSettings, timeout: float) -> None:
        """`timeout`: the age in s beyond which a pose is not used."""
        self._frame, self._timeout = settings.frame, timeout
        self._holds = settings.without_pose == "hold"
        self._readings: deque[Odometry] = deque(maxlen=HISTORY)
        self._way = self._turned = 0.0
        self._used: _Fix | None = None  # the last pose in use; after a jump kept for comparison
        # Of a place not in use: the first and the last of the poses in a row that agree.
        self._new: _Fix | None = None
        self._newest: _Fix | None = None
        self._agreeing = 0  # poses after `_new` that agree each with the pose before
        self._is_used = False  # True if the last pose agreed with `_used`
        self._fault = f"no pose in the frame {self._frame!r} has arrived"

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading. After a jump of odometry nothing is known."""
        if self._readings:
            last = self._readings[-1]
            if odometry.stamp == last.stamp:
                return
            if odometry.stamp < last.stamp or odometry.jumps_from(last):
                self._readings.clear()
                self._forget("odometry jumped")
            else:
                here, there = odometry.pose, last.pose
                self._way += math.hypot(here.x - there.x, here.y - there.y)
                self._turned += abs(math.remainder(here.yaw - there.yaw, 2.0 * math.pi))
        self._readings.append(odometry)

    def on_pose(
        self,
        pose: SharedPose,
        at: float,
        errors: tuple[float, float],
        odometry_at: float,
    ) -> None:
        """Take in the own pose at the time `at`; use it if it agrees with earlier poses.

        `errors`: the bounds of the errors of position (m) and yaw (rad). `odometry_at`: when the
        newest reading of odometry arrived.
        """
        if pose.frame != self._frame:
            self._forget(f"the fence is in the frame {self._frame!r}, the pose in {pose.frame!r}")
            return
        odometry = self._odometry_at(at, odometry_at)
        if odometry is not None:
            error, yaw_error = errors
            # The way at the time `at` is not kept: the present way is greater by the motion during
            # the delay of the pose. Later errors of odometry are too small by ODOMETRY_SHARE of
            # that motion.
            way, turned = self._way, self._turned
            self._take(_Fix(pose, odometry, error, yaw_error, at, way, turned))

    def _odometry_at(self, at: float, newest_at: float) -> Pose | None:
        """The pose by odometry at the time `at`; None if no kept reading is that old.

        `newest_at`: when the newest reading arrived. Both times in s on the robot's clock.
        """
        if not self._readings:
            return None
        stamp = self._readings[-1].stamp + at - newest_at  # `at` on the clock of the stamps
        if stamp < self._readings[0].stamp - MAX_EXTRAPOLATION:
            return None
        return _pose_at(self._readings, stamp)

    def _take(self, fix: _Fix) -> None:
        """Use `fix`, or keep `fix` until enough poses of its place agree (rules 2 and 3)."""
        if self._used is not None and fix.at - self._used.at > FORGET_TIME:
            self._used = None
        if self._used is not None and _agree(self._used, fix):
            self._use(fix)
        elif self._new is not None and self._newest is not None and _agree(self._newest, fix):
            self._newest, self._agreeing = fix, self._agreeing + 1
            if self._agreeing >= CONFIRMATIONS and fix.at - self._new.at >= CONFIRM_TIME:
                self._use(fix)
        else:
            self._begin_new_place(fix)

    def _begin_new_place(self, fix: _Fix) -> None:
        """Count agreeing poses from `fix` on: the first pose, or the first after a jump."""
        self._fault = "waits until poses agree"
        if self._used is not None:
            distance, _ = _difference(self._used, fix)
            self._fault = f"the pose jumped by {distance:.2f} m; {self._fault}"
        self._new = self._newest = fix
        self._agreeing, self._is_used = 0, False

    def _use(self, fix: _Fix) -> None:
        self._used, self._new, self._newest = fix, None, None
        self._agreeing, self._is_used, self._fault = 0, True, ""

    def _forget(self, fault: str) -> None:
        self._used = self._new = self._newest = None
        self._agreeing, self._is_used, self._fault = 0, False, fault

    @property
    def until(self) -> float:
        """The time until which the robot may drive; -inf without a usable pose; inf if always."""
        return self.known_until if self._holds else math.inf

    @property
    def known_until(self) -> float:
        """The time until which there is an anchor; -inf without a usable pose."""
        return self._used.at + self._timeout if self._is_used and self._used else -math.inf

    def anchor(self, now: float) -> Anchor | None:
        """The pose in use with its odometry; None without a fresh pose."""
        fix = self._used
        if fix is None or now > self.known_until:
            return None
        way, turned = self._way - fix.way, self._turned - fix.turned
        return Anchor(fix.shared.pose, fix.odometry, fix.error, fix.yaw_error, way, turned)

    def text(self, now: float) -> str:
        """Why there is no anchor; empty with one."""
        if now <= self.known_until:
            return ""
        if self._used is not None and self._is_used:
            return f"the last pose is {now - self._used.at:.1f} s old"
        return self._fault


def _pose_at(readings: deque[Odometry], stamp: float) -> Pose:
    """The pose by odometry at a stamp: interpolated, or extrapolated at a constant twist."""
    later = readings[-1]
    for reading in reversed(readings):
        if reading.stamp <= stamp:
            if reading is later:
                break
            part = (stamp - reading.stamp) / (later.stamp - reading.stamp)
            a, b = reading.pose, later.pose
            turn = math.remainder(b.yaw - a.yaw, 2.0 * math.pi)
            x, y = a.x + part * (b.x - a.x), a.y + part * (b.y - a.y)
            return Pose(x, y, a.yaw + part * turn)
        later = reading
    seconds = max(min(stamp - later.stamp, MAX_EXTRAPOLATION), -MAX_EXTRAPOLATION)
    pose, twist = later.pose, later.twist
    turn = twist.angular * seconds
    cos, sin = math.cos(pose.yaw + 0.5 * turn), math.sin(pose.yaw + 0.5 * turn)
    ahead, left = twist.linear * seconds, twist.lateral * seconds
    return Pose(
        pose.x + cos * ahead - sin * left, pose.y + sin * ahead + cos * left, pose.yaw + turn
    )


def _difference(earlier: _Fix, later: _Fix) -> tuple[float, float]:
    """m and rad by which a pose differs from that of an earlier pose and odometry."""
    turned = earlier.shared.pose.yaw - earlier.odometry.yaw
    cos, sin = math.cos(turned), math.sin(turned)
    dx = later.odometry.x - earlier.odometry.x
    dy = later.odometry.y - earlier.odometry.y
    x = earlier.shared.pose.x + cos * dx - sin * dy
    y = earlier.shared.pose.y + sin * dx + cos * dy
    pose = later.shared.pose
    turn = math.remainder(pose.yaw - later.odometry.yaw - turned, 2.0 * math.pi)
    return math.hypot(pose.x - x, pose.y - y), abs(turn)


def _agree(earlier: _Fix, later: _Fix) -> bool:
    """True if errors explain the difference of two poses; False for NaN."""
    far, turn = _difference(earlier, later)
    way, turned = later.way - earlier.way, later.turned - earlier.turned
    most = earlier.error + later.error + (earlier.yaw_error + ODOMETRY_SHARE * turned) * way
    most += ODOMETRY_SHARE * way + _SLACK[0]
    most_turn = earlier.yaw_error + later.yaw_error + ODOMETRY_SHARE * turned + _SLACK[1]
    return far <= most and turn <= most_turn
