"""Flocking: one step at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from swarmd.core.values import Array, Inputs, Odometry, Pose, Scan, Twist, Value
from swarmd.patterns.flocking.pattern import Flocking
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, mirrored, scan_from, scan_of

BURGER = load_platform("burger")
# The spacing is to a surface, these discs have a radius of 0.1 m.
AT_REST = 0.75 + 0.1


class TestFlocking(PatternContract):
    pattern = Flocking


class TestFlockingOfThePaper(PatternContract):
    pattern = Flocking
    params = {"law": "paper"}  # noqa: RUF012 - read only


def requested(scan: Scan, *, seed: int = 0, **params: Value) -> Twist:
    """The first requested command on a scan."""
    pattern = Subject(Flocking, BURGER, params).make(seed)
    twist = pattern.step(Inputs(now=0.0, dt=0.0, scan=scan, is_new_scan=True)).twist
    assert twist is not None
    return twist


def of(*robots: tuple[float, float], room: float | None = None) -> Scan:
    """Robots at range in m and bearing in degrees from the lidar."""
    x, y = BURGER.scan.offset
    rays = [(r, math.radians(b)) for r, b in robots]
    where = [(x + r * math.cos(b), y + r * math.sin(b)) for r, b in rays]
    return scan_of(BURGER, [Disc(x, y) for x, y in where], room=room)


def test_cruises_straight_on_alone() -> None:
    twist = requested(of())
    assert twist.linear == pytest.approx(0.6 * 0.22)
    assert twist.angular == 0.0


def test_a_spring_at_rest_neither_pulls_nor_pushes() -> None:
    for bearing in (0.0, 90.0, 180.0):
        twist = requested(of((AT_REST, bearing)))
        assert twist.linear == pytest.approx(0.132, abs=0.02)
        assert twist.angular == pytest.approx(0.0, abs=0.05)


def test_far_robots_attract_and_near_ones_repel() -> None:
    assert requested(of((1.2, 0.0))).linear == pytest.approx(0.22)
    assert requested(of((0.5, 0.0))).linear == pytest.approx(-0.4 * 0.22)
    assert requested(of((1.2, 180.0))).linear < 0.0
    assert requested(of((0.5, 180.0))).linear == pytest.approx(0.22)


@pytest.mark.parametrize("side", [-90.0, 90.0])
def test_turns_to_far_robots_and_away_from_near_ones(side: float) -> None:
    assert requested(of((1.5, side))).angular * side > 0.0
    assert requested(of((0.5, side))).angular * side < 0.0


def test_a_spring_turns_it_at_the_rate_of_swing_when_it_is_drawn_out() -> None:
    assert requested(of((2.0, 90.0))).angular == pytest.approx(0.5, abs=0.03)
    assert requested(of((2.0, 90.0)), swing=0.3).angular == pytest.approx(0.3, abs=0.02)


def test_only_the_nearest_count() -> None:
    near = [(AT_REST, 30.0), (AT_REST, 150.0), (AT_REST, -90.0)]
    assert requested(of(*near, (2.5, 90.0))).angular == pytest.approx(0.0, abs=0.1)
    assert requested(of(*near, (2.5, 90.0)), ties=4).angular > 0.4


@pytest.mark.parametrize("bearing", [40.0, -40.0])
def test_turns_away_from_a_wall_and_slows_down(bearing: float) -> None:
    ahead = math.radians(bearing)
    wall = scan_from(BURGER, *_wall(1.0, ahead))
    twist = requested(wall)
    assert twist.angular * bearing < 0.0
    assert twist.linear < 0.05


def test_a_wall_beyond_its_distance_has_no_effect() -> None:
    far = requested(scan_from(BURGER, *_wall(1.7, 0.5)))
    assert far.linear == pytest.approx(0.132)
    assert far.angular == 0.0


def _wall(distance: float, bearing: float) -> tuple[Array, Array]:
    """Ranges and bearings of a wall that is long, its foot in this direction."""
    bearings = np.radians(np.arange(360.0))
    across = np.cos(bearings - bearing)
    ranges = np.where(across > 0.0, distance / np.maximum(across, 1e-9), math.inf)
    return np.where(ranges > BURGER.scan.range_max, math.inf, ranges), bearings


def aligned(speed: float, side: float, *, turned: float = 0.0, **params: Value) -> float:
    """The turn rate after a second in which one that is ahead at first moves to a side.

    The robot stands meanwhile, or turns on the spot by that many rad.
    """
    pattern = Subject(Flocking, BURGER, params).make()
    twist = Twist()
    for k in range(11):
        now, yaw = 0.1 * k, 0.1 * k * turned
        pose = Pose(0.0, 0.0, yaw)
        scan = scan_of(BURGER, [Disc(AT_REST, side * speed * now)], pose=pose, seq=k)
        odometry = Odometry(now, pose, Twist())
        found = pattern.step(Inputs(now, 0.1, scan, True, odometry)).twist
        assert found is not None
        twist = found
    return twist.angular


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_turns_to_the_direction_of_the_others(side: float) -> None:
    still = aligned(0.0, side)
    assert still == pytest.approx(0.0, abs=0.05)
    assert (aligned(0.22, side, swing=0.0) - still) * side > 0.8
    assert aligned(0.22, side, swing=0.0, align=0.0) == 0.0


@pytest.mark.parametrize("turned", [-0.3, 0.3])
def test_its_own_turn_is_not_motion_of_others(turned: float) -> None:
    assert aligned(0.0, 1.0, turned=turned, swing=0.0) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("seed", range(5))
def test_mirrored_scan_gives_the_mirrored_command(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scan = of(*[(float(rng.uniform(0.5, 2.0)), 70.0 * i) for i in range(5)], room=4.0)
    here, there = requested(scan), requested(mirrored(scan))
    assert there.linear == pytest.approx(here.linear, abs=1e-6)
    assert there.angular == pytest.approx(-here.angular, abs=1e-6)


@pytest.mark.parametrize(
    ("arcs", "turn", "goes_on"),
    [
        ([], 0.0, True),
        # Near and ahead, wider than 4 degrees: away from the nearest, in place.
        ([(0.4, 10.0, 6)], -0.2, False),
        ([(0.4, -10.0, 6)], 0.2, False),
        # Near and aside, 2 to 17 degrees: a robot.
        ([(0.4, 90.0, 2)], -0.2, True),
        ([(0.4, 90.0, 17)], -0.2, True),
        ([(0.4, -90.0, 10)], 0.2, True),
        ([(0.4, 90.0, 1)], 0.0, True),
        ([(0.4, 90.0, 18)], 0.0, True),
        # Far and aside, fewer than 4 degrees: a robot to turn to.
        ([(2.0, 90.0, 3)], 0.2, True),
        ([(2.0, -90.0, 3)], -0.2, True),
        ([(2.0, 90.0, 4)], 0.0, True),
        ([(2.0, 90.0, 3), (2.0, -90.0, 2)], 0.2, True),
        ([(2.0, 90.0, 3), (2.0, -90.0, 3)], 0.0, True),
        # Neither near nor far.
        ([(1.0, 90.0, 3)], 0.0, True),
        ([(2.0, 180.0, 3)], 0.0, True),
    ],
)
@pytest.mark.parametrize("rays", [360, 720])
def test_the_states_of_the_paper(
    arcs: Sequence[tuple[float, float, int]], turn: float, goes_on: bool, rays: int
) -> None:
    twist = requested(_arcs(arcs, rays), law="paper")
    assert twist == Twist(linear=0.22 if goes_on else 0.0, angular=turn)


@pytest.mark.parametrize("arc", [(3.0, 180.0, 3), (0.4, 0.0, 3)])
def test_the_law_of_the_paper_turns_either_way_for_ahead_and_behind(
    arc: tuple[float, float, int],
) -> None:
    turns = [requested(_arcs([arc], 360), law="paper", seed=seed) for seed in range(10)]
    assert {twist.angular for twist in turns} == {0.2, -0.2}
    assert {twist.linear for twist in turns} == {0.0 if arc[1] else 0.22}


def test_the_law_of_the_paper_keeps_its_direction_of_turning() -> None:
    pattern = Subject(Flocking, BURGER, {"law": "paper"}).make(1)
    scan = _arcs([(3.0, 180.0, 3)], 360)
    steps = [pattern.step(Inputs(0.1 * k, 0.1, scan, True)).twist for k in range(20)]
    assert len({twist.angular for twist in steps if twist is not None}) == 1


def test_the_law_of_the_paper_uses_each_new_scan() -> None:
    pattern = Subject(Flocking, BURGER, {"law": "paper"}).make()
    turns = []
    for k, side in enumerate((90.0, -90.0, 90.0)):
        twist = pattern.step(Inputs(0.2 * k, 0.2, _arcs([(2.0, side, 3)], 360), True)).twist
        assert twist is not None
        turns.append(twist.angular)
    assert turns == [0.2, -0.2, 0.2]


def _arcs(arcs: Sequence[tuple[float, float, int]], rays: int) -> Scan:
    """A scan that sees nothing but arcs: range in m, middle and width in degrees."""
    degrees = (np.arange(rays) + 0.5) * 360.0 / rays
    ranges = np.full(rays, math.inf)
    for distance, middle, width in arcs:
        off = np.abs((degrees - middle + 180.0) % 360.0 - 180.0)
        # Of rays that are as far aside, as many as fit.
        chosen = np.argsort(off, kind="stable")[: width * rays // 360]
        ranges[chosen] = distance
    return scan_from(BURGER, ranges, np.radians(degrees))
