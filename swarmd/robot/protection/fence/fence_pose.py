"""Decides which poses in a shared frame the fence of a robot may use, and when the robot is held.

1. Two poses agree if the robot has moved from the first to the second by its odometry, to within
   the error bounds of both poses and of odometry.
2. A pose is used once CONFIRMATIONS poses in a row agree, over at least CONFIRM_TIME.
3. A pose in use agrees with the newest pose in use, and with those kept of the time before: a pose
   that stands still or drifts agrees with the newest one for long. One of them may contradict.
4. A pose that does not agree with the newest pose in use is a jump: the robot has no usable pose
   until new poses agree by rule 2, or a pose agrees with the poses in use again.
5. A pose that agrees with the newest pose in use alone is a drift, and so is a second jump within
   FORGET_TIME. After a drift rule 2 uses no pose for FORGET_TIME. A hold of this length ends the
   run, so that a robot does not leave its fence in short moves, each of which agrees.
6. With `without_pose: hold` of the fence, the robot is held while it has no usable pose, and once
   the pose in use is older than the timeout (`until`).

docs/evidence/assumptions.md has the rates of drift that are found.

Pure. Units: m, rad, s on the robot's clock.
"""

from __future__ import annotations

import math
from collections import deque

from msgspec import Struct

from swarmd.core.odometry_trail import ANEW, NEXT, OdometryTrail
from swarmd.core.values import Odometry, Pose, SharedPose
from swarmd.robot.protection.decision import Anchor
from swarmd.robot.protection.fence.fence_settings import FenceSettings
from swarmd.robot.protection.settings import ODOMETRY_SHARE

CONFIRMATIONS = 3
"""Poses in a row, after the first pose of a new place, that agree each with the pose before."""
CONFIRM_TIME = 0.2
"""Seconds that the last of these poses is newer than the first pose, at least."""
FORGET_TIME = 5.0
"""Seconds after which poses in use are no longer compared with new poses, and a drift is over."""
COMPARED_TIME = 5.0
COMPARED_WAY = 0.5
LONGEST_TIME = 10.0
"""s, m and s: a pose is compared with the poses in use of the last COMPARED_TIME, and with those of
the last COMPARED_WAY within LONGEST_TIME: a robot that creeps finds a drift late."""
_SPACING = 0.5
"""Seconds between the poses in use that are kept for comparison."""
_SLACK = 0.02, 0.02  # m and rad that two poses may differ by, beside their errors
_BEND = 0.1
"""rad by which odometry turns on 1 m of way, since the wheels differ: 1.5 % of their diameter on a
base 0.16 m wide, three standard deviations of the simulated bases."""


class _Fix(Struct, frozen=True):
    """A measured pose with the odometry at the same time."""

    shared: SharedPose  # the measured pose, in the frame of the fence
    odometry: Pose  # the pose by odometry at the same time
    error: float  # m, the bound of the error of `shared`
    yaw_error: float  # rad, the bound of the error of the yaw of `shared`
    at: float  # s, the time of the pose
    way: float  # m driven since the start of the daemon; the error of odometry grows with it
    turned: float  # rad turned since the start, both senses counted


class _Trail:
    """Poses in a row that agree, each with the pose before and with those kept."""

    def __init__(self, first: _Fix) -> None:
        self.newest = first
        self._first = first
        self.followers = 0  # poses after the first
        self._kept: deque[_Fix] = deque()  # older than the newest pose, _SPACING apart

    def contradicted(self, fix: _Fix) -> _Fix | None:
        """The newest pose with which `fix` does not agree; None if it agrees.

        A single one may contradict, since it may be false by less than the bounds; the newest pose
        only if two others agree.
        """
        others = [one for one in (*self._kept, self.newest) if not _agree(one, fix)]
        if len(others) == 1 and (others[0] is not self.newest or len(self._kept) > 1):
            return None
        return others[-1] if others else None

    def add(self, fix: _Fix) -> None:
        """Take in the next pose, which agrees."""
        if not self._kept or self.newest.at - self._kept[-1].at >= _SPACING:
            self._kept.append(self.newest)
        self.newest = fix
        self.followers += 1
        while self._is_over(self._kept[0]):
            self._kept.popleft()

    def _is_over(self, old: _Fix) -> bool:
        """True for a kept pose that is too old for a comparison, and from too far away."""
        seconds = self.newest.at - old.at
        way = self.newest.way - old.way
        return seconds > LONGEST_TIME or (seconds > COMPARED_TIME and way > COMPARED_WAY)

    def is_confirmed(self, seconds: float) -> bool:
        """True if enough poses agree, over `seconds` at least (rule 2)."""
        return self.followers >= CONFIRMATIONS and self.newest.at - self._first.at >= seconds


def _fresh(trail: _Trail | None, now: float) -> _Trail | None:
    """The trail; None after FORGET_TIME without a further pose."""
    return None if trail is None or now - trail.newest.at > FORGET_TIME else trail


class FencePose:
    """The pose of one robot in the frame of its fence."""

    def __init__(self, settings: FenceSettings, timeout: float) -> None:
        """`timeout`: the age in s beyond which a pose is not used."""
        self._frame = settings.frame
        self._timeout = timeout
        self._holds = settings.without_pose == "hold"
        self._odometry = OdometryTrail()
        self._last: Odometry | None = None  # the newest reading of it
        self._way = 0.0
        self._turned = 0.0
        self._used: _Trail | None = None  # the poses in use; after a jump kept for comparison
        self._new: _Trail | None = None  # poses in a row that agree, of a place not in use
        self._is_used = False  # True if the last pose agreed with `_used`
        self._jumped_at = -math.inf  # the time of the last jump that was confirmed
        self._needed_time = CONFIRM_TIME  # s over which the poses of `_new` must agree
        self._fault = f"no pose in the frame {self._frame!r} has arrived"

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading. After a jump of odometry nothing is known."""
        taken = self._odometry.take(odometry)
        if taken == ANEW:
            self._forget("odometry jumped")
        elif taken == NEXT and self._last is not None:
            here = odometry.pose
            there = self._last.pose
            self._way += math.hypot(here.x - there.x, here.y - there.y)
            self._turned += abs(math.remainder(here.yaw - there.yaw, 2.0 * math.pi))
        if taken >= NEXT:
            self._last = odometry

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
            way = self._way
            turned = self._turned
            self._take(_Fix(pose, odometry, error, yaw_error, at, way, turned))

    def _odometry_at(self, at: float, newest_at: float) -> Pose | None:
        """The pose by odometry at the time `at`; None if no kept reading is that old.

        `newest_at`: when the newest reading arrived. Both times in s on the robot's clock.
        """
        if self._last is None:
            return None
        stamp = self._last.stamp + at - newest_at  # `at` on the clock of the stamps
        return self._odometry.pose_at(stamp) if self._odometry.covers(stamp) else None

    def _take(self, fix: _Fix) -> None:
        """Use `fix`, or keep `fix` until enough poses of its place agree (rules 2 to 5)."""
        used = self._used = _fresh(self._used, fix.at)
        new = self._new = _fresh(self._new, fix.at)
        if used is not None and used.contradicted(fix) is None:
            used.add(fix)
            self._use(used)
        elif new is not None and new.contradicted(fix) is None:
            new.add(fix)
            if new.is_confirmed(self._needed_time):
                self._jumped_at = self._jumped_at if used is None else fix.at
                self._use(new)
        else:
            self._begin_new_place(fix)

    def _begin_new_place(self, fix: _Fix) -> None:
        """Count agreeing poses from `fix` on: the first, or the first after a jump or a drift."""
        last = self._used if self._is_used else self._new
        other = None if last is None else last.contradicted(fix)
        is_jump = last is not None and other is last.newest
        is_jump_again = self._is_used and fix.at - self._jumped_at < FORGET_TIME
        if other is not None and (is_jump_again or not is_jump):
            self._needed_time = FORGET_TIME
            self._fault = (
                f"{_contradiction(other, fix)}; waits until poses agree for {FORGET_TIME:g} s"
            )
        elif self._needed_time == CONFIRM_TIME:
            self._fault = "waits until poses agree"
            if self._used is not None:
                distance, _ = _difference(self._used.newest, fix)
                self._fault = f"the pose jumped by {distance:.2f} m; {self._fault}"
        self._new = _Trail(fix)
        self._is_used = False

    def _use(self, trail: _Trail) -> None:
        self._used = trail
        self._new = None
        self._needed_time = CONFIRM_TIME
        self._is_used = True
        self._fault = ""

    def _forget(self, fault: str) -> None:
        self._used = None
        self._new = None
        self._is_used = False
        self._fault = fault

    @property
    def until(self) -> float:
        """The time until which the robot may drive; -inf without a usable pose; inf if always."""
        return self.known_until if self._holds else math.inf

    @property
    def known_until(self) -> float:
        """The time until which there is an anchor; -inf without a usable pose."""
        return self._used.newest.at + self._timeout if self._is_used and self._used else -math.inf

    def anchor(self, now: float) -> Anchor | None:
        """The pose in use with its odometry; None without a fresh pose."""
        if self._used is None or now > self.known_until:
            return None
        fix = self._used.newest
        way = self._way - fix.way
        turned = self._turned - fix.turned
        return Anchor(fix.shared.pose, fix.odometry, fix.error, fix.yaw_error, way, turned)

    def text(self, now: float) -> str:
        """Why there is no anchor; empty with one."""
        if now <= self.known_until:
            return ""
        if self._used is not None and self._is_used:
            return f"the last pose is {now - self._used.newest.at:.1f} s old"
        return self._fault


def _difference(earlier: _Fix, later: _Fix) -> tuple[float, float]:
    """m and rad by which a pose differs from that of an earlier pose and odometry."""
    turned = earlier.shared.pose.yaw - earlier.odometry.yaw
    cos = math.cos(turned)
    sin = math.sin(turned)
    dx = later.odometry.x - earlier.odometry.x
    dy = later.odometry.y - earlier.odometry.y
    x = earlier.shared.pose.x + cos * dx - sin * dy
    y = earlier.shared.pose.y + sin * dx + cos * dy
    pose = later.shared.pose
    turn = math.remainder(pose.yaw - later.odometry.yaw - turned, 2.0 * math.pi)
    return math.hypot(pose.x - x, pose.y - y), abs(turn)


def _explained(earlier: _Fix, later: _Fix) -> tuple[float, float]:
    """m and rad by which two poses may differ: errors of both poses and of odometry, and slack."""
    way = later.way - earlier.way
    turned = later.turned - earlier.turned
    here = later.odometry
    there = earlier.odometry
    most = earlier.error + later.error + _SLACK[0]
    most += earlier.yaw_error * math.hypot(here.x - there.x, here.y - there.y)
    most += (ODOMETRY_SHARE * (1.0 + turned) + 0.5 * _BEND * way) * way
    most_turn = earlier.yaw_error + later.yaw_error + _SLACK[1]
    most_turn += ODOMETRY_SHARE * turned + _BEND * way
    return most, most_turn


def _agree(earlier: _Fix, later: _Fix) -> bool:
    """True if errors explain the difference of two poses; False for NaN."""
    (far, turn) = _difference(earlier, later)
    (most, most_turn) = _explained(earlier, later)
    return far <= most and turn <= most_turn


def _contradiction(earlier: _Fix, later: _Fix) -> str:
    """The difference of two poses, and what errors explain, in words."""
    (far, turn) = _difference(earlier, later)
    (most, most_turn) = _explained(earlier, later)
    return (
        f"in {later.at - earlier.at:.1f} s the pose moved otherwise than odometry by {far:.2f} m"
        f" and {math.degrees(turn):.0f} deg, errors explain {most:.2f} m and"
        f" {math.degrees(most_turn):.0f} deg"
    )
