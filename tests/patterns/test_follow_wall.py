"""Wall following: one robot in the corner of a room."""

from __future__ import annotations

import math

import pytest

from swarmd.core.values import Inputs, Pose
from swarmd.patterns.follow_wall.pattern import FollowWall
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import scan_of

BURGER = load_platform("burger")


class TestFollowWall(PatternContract):
    pattern = FollowWall


@pytest.mark.parametrize("near", [0.2, 0.3, 0.36])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_robot_that_others_pushed_to_its_wall_leaves_the_corner(near: float, side: float) -> None:
    """It keeps 0.5 m from a wall; here it drives `near` m beside a wall into a corner of a room of
    6 x 6 m, and does what it requests, 40 s at most, until it drives along the next wall."""
    pattern = Subject(FollowWall, BURGER, {"side": "left" if side > 0 else "right"}).make()
    x, y, yaw = 2.0, side * (3.0 - near), 0.0
    for k in range(400):
        scan = scan_of(BURGER, [], pose=Pose(x, y, yaw), room=6.0, seq=k)
        twist = pattern.step(Inputs(0.1 * k, 0.1, scan, True)).twist
        assert twist is not None
        yaw += 0.1 * twist.angular
        x += 0.1 * twist.linear * math.cos(yaw)
        y += 0.1 * twist.linear * math.sin(yaw)
        if side * y < 1.0:
            break
    assert side * y < 1.0
