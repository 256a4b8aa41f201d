"""Notices a robot that protection alone has kept in place for some time. Pure: times are handed in.

Such a robot asks for motion, has free floor ahead or behind, and does not move. The status then
says for how long, and the texts of the operator say why and what to do.
"""

from __future__ import annotations

import math

from swarmd.core.messages import Reason
from swarmd.core.values import Platform, Pose, Scan
from swarmd.robot.protection.decision import Decision
from swarmd.robot.protection.footprint import ScanGeometry

HELD_TIME = 10.0
"""s for which a robot must stand before it says so."""
_STANDS = 0.02  # m by odometry: a robot that creeps moves 7 to 15 cm in HELD_TIME
_TURNS = 0.2  # rad: a robot that turns further is looking for a way out
_FLOOR = 0.3  # m ahead or behind that count as free floor
_BESIDE = (
    0.03  # m of the width of the robot at each side, which noise of a wall beside it may enter
)


class StandingWatch:
    """Follows the decisions of one robot, which `update` takes about once a second."""

    def __init__(self, platform: Platform) -> None:
        self._geometry = ScanGeometry(platform.scan)
        x, y = platform.footprint.T
        self._rear = float(x.min())
        self._front = float(x.max())
        self._right = float(y.min()) + _BESIDE
        self._left = float(y.max()) - _BESIDE
        self._since = math.inf  # s; inf: protection does not hold the robot
        self._pose: Pose | None = None  # by odometry, at the time `_since`
        self._has_floor = False

    def update(self, decision: Decision, pose: Pose | None, scan: Scan | None, now: float) -> bool:
        """Take in a decision; True if it shows that the robot has been held for HELD_TIME.

        True once for each time that the robot is held.

        Args:
            decision: the present one. Steering that waits for others is no hold of protection.
            pose: by odometry; None before the first reading.
            scan: the last conditioned scan; None before the first.
            now: s on the robot's clock.
        """
        is_held = decision.reason is Reason.PROTECTION and decision.avoided is None
        if not is_held or pose is None or scan is None:
            self._since = math.inf
            self._pose = None
            self._has_floor = False
            return False
        if self._pose is None or _has_moved(self._pose, pose):
            self._since = now
            self._pose = pose
            self._has_floor = False
            return False
        if now - self._since < HELD_TIME:
            return False
        had_floor = self._has_floor
        self._has_floor = self._is_free(scan)
        return self._has_floor and not had_floor

    def held_for(self, now: float) -> float | None:
        """For how many s the robot is held with free floor; None while it is not, or not known."""
        return now - self._since if self._has_floor else None

    def _is_free(self, scan: Scan) -> bool:
        """Whether no return lies within _FLOOR ahead of the robot, or none behind it."""
        x, y = self._geometry.points(scan).T
        is_in_lane = (self._right < y) & (y < self._left)
        is_ahead = is_in_lane & (x > 0.0) & (x < self._front + _FLOOR)
        is_behind = is_in_lane & (x <= 0.0) & (x > self._rear - _FLOOR)
        return not (is_ahead.any() and is_behind.any())


def _has_moved(start: Pose, pose: Pose) -> bool:
    way = math.hypot(pose.x - start.x, pose.y - start.y)
    return way > _STANDS or abs(math.remainder(pose.yaw - start.yaw, 2.0 * math.pi)) > _TURNS
