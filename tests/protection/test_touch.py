"""Closed loop: a pattern with a touch zone touches in its sector, at its speed, nowhere else."""

from __future__ import annotations

import math

import pytest

from swarmd.core.values import Pose, TouchZone, Twist
from swarmd.protection.decision import Permit
from swarmd.settings.settings import load_platform
from tests.support.filter_sim import FilterSim, box, under_barrier

BURGER = under_barrier(load_platform("burger"))
TOUCH_SPEED = 0.05
AHEAD = Permit(touch=TouchZone(0.0, math.radians(20.0), TOUCH_SPEED))


def test_touches_in_its_sector_at_its_speed() -> None:
    run = FilterSim(BURGER, [box(0.2, 0.12, Pose(0.5))]).run(Twist(0.22), 12.0, AHEAD)
    assert run.touch is not None
    assert run.touch.speed == pytest.approx(TOUCH_SPEED, abs=0.002)


def test_moving_obstacle_in_the_sector_is_met_at_its_speed() -> None:
    comes = box(0.2, 0.12, Pose(0.9), velocity=(-0.2, 0.0))
    run = FilterSim(BURGER, [comes]).run(Twist(0.22), 12.0, AHEAD)
    assert run.touch is not None
    assert run.touch.speed <= TOUCH_SPEED + 0.002


@pytest.mark.parametrize("way", [math.pi, 2.0, -2.0])
def test_obstacles_outside_the_sector_are_not_touched(way: float) -> None:
    wall = box(0.1, 4.0, Pose(0.7 * math.cos(way), 0.7 * math.sin(way), way))
    run = FilterSim(BURGER, [wall]).run(Twist(-0.22), 8.0, AHEAD)
    assert run.touch is None
    assert run.min_gap >= 0.05


def test_side_does_not_swing_into_a_wall() -> None:
    wall = box(4.0, 0.1, Pose(0.0, 0.089 + 0.16 + 0.05))
    for turn in (2.84, -2.84):
        run = FilterSim(BURGER, [wall]).run(Twist(0.0, turn), 4.0, AHEAD)
        assert run.touch is None


def test_no_touch_without_the_permit() -> None:
    run = FilterSim(BURGER, [box(0.2, 0.12, Pose(0.5))]).run(Twist(0.22), 8.0)
    assert run.touch is None
