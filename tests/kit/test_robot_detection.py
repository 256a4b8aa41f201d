"""Which objects of a scan may be robots."""

from __future__ import annotations

import math

import pytest

from swarmd.kit.robot_detection import robots_near
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import Disc, scan_of

BURGER = load_platform("burger")
AHEAD = Disc(0.8, 0.0)
LEFT = Disc(0.0, 0.5)
FAR = Disc(-2.0, 0.0)


def test_robots_come_nearest_first_as_range_and_bearing() -> None:
    found = robots_near(scan_of(BURGER, [AHEAD, LEFT, FAR]), BURGER, within=1.0)
    assert [ray.range for ray in found] == pytest.approx([0.4, 0.732], abs=0.01)
    assert found[0].bearing == pytest.approx(math.pi / 2, abs=0.1)
    assert found[1].bearing == pytest.approx(0.0, abs=0.02)


def test_a_sector_leaves_out_the_robots_beside_it() -> None:
    scan = scan_of(BURGER, [AHEAD, LEFT, FAR])
    assert len(robots_near(scan, BURGER, within=3.0, half_width=1.0)) == 1
    assert len(robots_near(scan, BURGER, within=3.0, bearing=math.pi, half_width=0.5)) == 1


@pytest.mark.parametrize("distance", [0.4, 0.79, 0.95, 0.999])
def test_a_wall_is_no_robot_at_any_distance(distance: float) -> None:
    scan = scan_of(BURGER, [Disc(distance + 50.0, 0.0, 50.0)])
    assert robots_near(scan, BURGER, within=1.0) == []


def test_a_robot_behind_another_and_one_at_a_wall_are_left_out() -> None:
    hidden = scan_of(BURGER, [Disc(0.4, 0.0), Disc(0.7, 0.12)])
    assert len(robots_near(hidden, BURGER, within=1.0)) == 1
    at_wall = scan_of(BURGER, [Disc(0.9, 0.0), Disc(51.0, 0.0, 50.0)])
    assert robots_near(at_wall, BURGER, within=1.5) == []


def test_without_a_scan_there_are_no_robots() -> None:
    assert robots_near(None, BURGER, within=1.0) == []
    assert robots_near(scan_of(BURGER), BURGER, within=1.0) == []
