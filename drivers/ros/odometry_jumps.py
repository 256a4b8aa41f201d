"""Jumps of the pose that odometry reports: farther than any base moves between two readings. Pure.

A reset of odometry and the correction of an estimator are such jumps. The text of a jump is for a
check and for the driver's state; protection notes repeated jumps by itself
(`swarmd/robot/protection/following.py`).
"""

from __future__ import annotations

import math

from swarmd.core.values import MAX_SPEED, MAX_STEP, Odometry

JUMP_TIME = 30.0
"""Seconds for which a jump is told."""


class OdometryJumps:
    """Finds jumps in the readings of one topic."""

    def __init__(self) -> None:
        """No reading yet."""
        self._last: Odometry | None = None
        self._jumped_at = -math.inf
        self._text = ""

    def take(self, odometry: Odometry, now: float) -> str:
        """Take in a reading that arrived at `now` s; how the pose jumped lately, empty if not.

        A reading with an earlier stamp than the last one begins anew: `TopicStats` tells of it.
        """
        last = self._last
        self._last = odometry
        if last is not None and odometry.stamp >= last.stamp:
            seconds = odometry.stamp - last.stamp
            here = odometry.pose
            there = last.pose
            way = math.dist((here.x, here.y), (there.x, there.y))
            turn = abs(math.remainder(here.yaw - there.yaw, math.tau))
            if max(way, turn) > MAX_STEP + MAX_SPEED * seconds:
                self._jumped_at = now
                self._text = (
                    f"its pose jumped by {way:.4g} m and {math.degrees(turn):.0f} deg in"
                    f" {seconds:.3g} s, which no base does: it was reset, an estimator corrected"
                    " it, or two publish it"
                )
        return self._text if now - self._jumped_at < JUMP_TIME else ""
