"""A pattern that may touch, in closed loop: in its sector, at its speed, and nowhere else."""

from __future__ import annotations

import math

import pytest

from swarmd.core.values import Pose, TouchZone, Twist
from swarmd.protection.decision import Permit
from swarmd.settings.settings import load_platform
from tests.support.filter_sim import FilterSim, box, under_barrier

BURGER = under_barrier(load_platform("burger"))
NEGLIGIBLE_SPEED = 0.05
AHEAD = Permit(touch=TouchZone(0.0, math.radians(20.0), NEGLIGIBLE_SPEED))


def test_it_touches_what_is_in_its_sector_and_no_faster_than_it_may() -> None:
    ride = FilterSim(BURGER, [box(0.2, 0.12, Pose(0.5))]).run(Twist(0.22), 12.0, AHEAD)
    assert ride.touch is not None
    assert ride.touch.speed == pytest.approx(NEGLIGIBLE_SPEED, abs=0.002)


def test_what_comes_into_its_sector_is_met_no_faster() -> None:
    comes = box(0.2, 0.12, Pose(0.9), velocity=(-0.2, 0.0))
    ride = FilterSim(BURGER, [comes]).run(Twist(0.22), 12.0, AHEAD)
    assert ride.touch is not None
    assert ride.touch.speed <= NEGLIGIBLE_SPEED + 0.002


@pytest.mark.parametrize("way", [math.pi, 2.0, -2.0])
def test_what_is_elsewhere_is_protected_as_ever(way: float) -> None:
    wall = box(0.1, 4.0, Pose(0.7 * math.cos(way), 0.7 * math.sin(way), way))
    ride = FilterSim(BURGER, [wall]).run(Twist(-0.22), 8.0, AHEAD)
    assert ride.touch is None
    assert ride.min_gap >= 0.05


def test_it_does_not_swing_its_side_into_anything() -> None:
    wall = box(4.0, 0.1, Pose(0.0, 0.089 + 0.16 + 0.05))
    for turn in (2.84, -2.84):
        ride = FilterSim(BURGER, [wall]).run(Twist(0.0, turn), 4.0, AHEAD)
        assert ride.touch is None


def test_without_the_permit_it_does_not_touch() -> None:
    ride = FilterSim(BURGER, [box(0.2, 0.12, Pose(0.5))]).run(Twist(0.22), 8.0)
    assert ride.touch is None
