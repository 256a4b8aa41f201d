"""The limits of the pages on safety and of docs/configuration.md are those of the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from swarmd.core.clock import STALL_TIMEOUT
from swarmd.core.values import MAX_EXTRAPOLATION, MAX_SPEED, MAX_STEP, MAX_TOLD_DISTANCE
from swarmd.robot import timeouts
from swarmd.robot.hazard_holds import CLEAR_TIME
from swarmd.robot.own_pose import FASTEST_POSE, POSE_TIMEOUT
from swarmd.robot.peers import TOLD_TIMEOUT
from swarmd.robot.protection.binding_range import REACTION_TIME
from swarmd.robot.protection.fence import fence_pose
from swarmd.robot.protection.settings import ODOMETRY_SHARE

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("failures.md", "mixed_swarms.md", "evidence/assumptions.md", "configuration.md")
TEXTS = [(DOCS / name).read_text() for name in PAGES]
PAGE = re.sub(r"\s+", " ", " ".join(TEXTS))
LIMITS = {
    "after 2 s, as with any hold, the run ends": (timeouts.MAX_HOLD_TIME, 2.0),
    "0.5 s after the last report": (CLEAR_TIME, 0.5),
    "odometry older than 0.5 s stops the robot": (timeouts.ODOMETRY_TIMEOUT, 0.5),
    "Odometry older than 0.15 s widens": (MAX_EXTRAPOLATION, 0.15),
    "by more than 0.5 m and 10 m/s": ((MAX_STEP, MAX_SPEED), (0.5, 10.0)),
    "1 s after the step began the daemon replaces the host | 0.3 s": (
        (timeouts.STEP_TIMEOUT, timeouts.MIN_EXPIRY),
        (1.0, 0.3),
    ),
    "the daemon stalls for at most 1 s": (STALL_TIMEOUT, 1.0),
    "responds within 50 ms": (REACTION_TIME, 0.05),
    "After 1 s a place expires": (TOLD_TIMEOUT, 1.0),
    "A distance below 0 or above 10 km is ignored": (MAX_TOLD_DISTANCE, 10_000.0),
    "0.5 s after the last pose": (POSE_TIMEOUT, 0.5),
    "the fastest pose is at most 0.1 s late": (FASTEST_POSE, 0.1),
    "at most 5 % of way and turn between poses": (ODOMETRY_SHARE, 0.05),
    "four poses in a row agree with odometry, over at least 0.2 s": (
        (fence_pose.CONFIRMATIONS, fence_pose.CONFIRM_TIME),
        (3, 0.2),
    ),
}


@pytest.mark.parametrize("sentence", LIMITS)
def test_a_limit_of_the_page_is_that_of_the_code(sentence: str) -> None:
    limit, wanted = LIMITS[sentence]
    assert sentence in PAGE
    assert limit == wanted
