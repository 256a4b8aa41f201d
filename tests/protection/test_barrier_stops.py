"""Closed loop: the barrier stops in time. Each test fails without one mechanism."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import Platform, Pose, Twist
from swarmd.settings.settings import load_platform
from tests.support.filter_sim import FilterSim, box, pole, round_corners, under_barrier

BURGER, WAFFLE = under_barrier(load_platform("burger")), under_barrier(load_platform("waffle_pi"))
MARGIN = 0.03
ROUNDING = 0.005  # m, for slanted rays and the length of a tick
NO_FAULT = 0.02  # m/s: a slower contact is not a fault of the robot


def still(platform: Platform) -> Platform:
    """Obstacles are assumed to stand and to be fully visible; the envelope is off."""
    return under_barrier(platform, others_speed=0.001, surface_speed=5.0, unseen_extent=0.0)


def extent(platform: Platform, way: int) -> float:
    """How far the outline reaches ahead (way 1) or back (-1) of the axle."""
    return float((way * platform.footprint[:, 0]).max())


@pytest.mark.parametrize("platform", [BURGER, WAFFLE], ids=lambda platform: platform.name)
@pytest.mark.parametrize("way", [1, -1], ids=["ahead", "reversing"])
@pytest.mark.parametrize("distance", [0.05, 0.4, 1.1])
def test_stops_at_a_wall_with_the_margin_left(
    platform: Platform, way: int, distance: float
) -> None:
    wall = box(0.1, 4.0, Pose(way * (extent(platform, way) + distance + 0.05)))
    run = FilterSim(still(platform), [wall]).run(Twist(way * platform.limits.linear), 8.0)
    assert run.min_gap == pytest.approx(MARGIN + 0.0005, abs=ROUNDING)
    assert abs(run.twists[-1].linear) < 0.001


@pytest.mark.parametrize("late", [0.2, 0.4])
def test_late_scan_is_shifted_by_the_motion_since(late: float) -> None:
    """At full speed a Waffle Pi drives 0.10 m within 0.4 s: three margins."""
    platform = replace(still(WAFFLE), scan=replace(WAFFLE.scan, latency=late))
    wall = box(0.1, 4.0, Pose(1.2))
    run = FilterSim(platform, [wall]).run(Twist(0.26), 8.0)
    assert run.min_gap == pytest.approx(MARGIN, abs=ROUNDING)


def test_late_scan_is_rotated_by_the_turn_since() -> None:
    """At 1.8 rad/s a scan is rotated by 40 degrees when it takes effect."""
    platform = replace(still(WAFFLE), scan=replace(WAFFLE.scan, latency=0.4))
    for phase in (0.0, 0.05, 0.1, 0.15):
        sim = FilterSim(platform, [pole(0.03, Pose(0.05, 0.27))], phase=phase)
        assert sim.run(lambda t: Twist(0.0, 1.8 * math.sin(3.0 * t)), 5.0).touch is None


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("platform", [BURGER, WAFFLE], ids=lambda platform: platform.name)
def test_corner_does_not_swing_into_an_obstacle_beside(platform: Platform, side: float) -> None:
    half = float(platform.footprint[:, 1].max())
    wall = box(4.0, 0.1, Pose(0.0, side * (half + 0.035 + 0.05)))
    for way in (1.0, -1.0):
        run = FilterSim(still(platform), [wall]).run(Twist(0.0, way * platform.limits.angular), 3.0)
        assert run.min_gap >= MARGIN - ROUNDING


@pytest.mark.parametrize("bearing", [0.0, 0.6, -0.9, 2.6, math.pi])
@pytest.mark.parametrize("platform", [BURGER, WAFFLE], ids=lambda platform: platform.name)
def test_rammed_robot_does_not_close_on_the_other(platform: Platform, bearing: float) -> None:
    speed = platform.protection["barrier"]["others_speed"]
    way = math.cos(bearing), math.sin(bearing)
    front = box(0.2, 3.0, Pose(1.6 * way[0], 1.6 * way[1], bearing),
                velocity=(-speed * way[0], -speed * way[1]))  # fmt: skip
    requested = Twist(math.copysign(platform.limits.linear, way[0]))
    run = FilterSim(platform, [front], noise=0.01).run(requested, 9.0)
    assert run.touch is not None
    assert run.touch.speed <= NO_FAULT


def test_reciprocal_robot_uses_at_most_half_of_the_gap() -> None:
    """A wall does not give way, so the robot approaches it by half of the rest at each tick."""
    told = under_barrier(BURGER, responsibility="reciprocal", margin=0.08)
    run = FilterSim(told, [box(0.1, 4.0, Pose(1.0))]).run(Twist(0.22), 8.0)
    assert 0.08 + 0.06 - ROUNDING <= run.min_gap <= 0.20


def test_standing_obstacle_may_start_to_move() -> None:
    """A box starts to approach when the gap just suffices for a robot that stands."""
    starts = box(0.2, 0.3, Pose(0.6), velocity=(-0.30, 0.0), begin=2.0)
    run = FilterSim(BURGER, [starts]).run(Twist(0.22), 5.0)
    assert run.touch is not None
    assert run.touch.speed <= NO_FAULT


def test_unseen_extent_of_another_robot_is_not_touched() -> None:
    """A level lidar sees only the lidar housing of a Burger."""
    corners = BURGER.footprint - BURGER.scan.offset
    told = under_barrier(BURGER, others_speed=0.001, surface_speed=5.0)
    for yaw in (0.0, 0.8, math.pi / 2, 2.2, math.pi):
        other = replace(
            pole(0.055, Pose(0.6, 0.0, yaw)), corners=corners, seen=round_corners(0.055)
        )
        run = FilterSim(told, [other]).run(Twist(0.22), 5.0)
        assert run.min_gap >= MARGIN - ROUNDING


def test_frozen_lidar_stops_the_robot_in_time() -> None:
    sim = FilterSim(BURGER, [box(0.1, 4.0, Pose(3.3))])
    assert sim.run(Twist(0.22), 1.0).twists[-1].linear == pytest.approx(0.22)
    sim.has_lidar = False
    run = sim.run(Twist(0.22), 1.5)
    stands = next(t for t, twist in zip(run.times, run.twists, strict=True) if twist.linear == 0.0)
    ages = BURGER.scan.latency + 1.0 / BURGER.scan.rate  # the last scan may be that new
    assert stands <= 1.0 + ages + BURGER.scan.stale_after + 0.05 + 0.04 + 0.22
    assert run.decisions[-1][1].reason is Reason.STALE_SCAN


@pytest.mark.parametrize("at", [0.4, 0.9, 1.4, 1.9, 2.4])
def test_lost_odometry_stops_the_robot_with_the_margin_left(at: float) -> None:
    sim = FilterSim(still(BURGER), [box(0.1, 4.0, Pose(0.6))])
    sim.run(Twist(0.22), at)
    sim.has_odometry = False
    run = sim.run(Twist(0.22), 2.0)
    assert run.min_gap >= MARGIN - ROUNDING
    assert run.decisions[-1][1].reason is Reason.STALE_ODOMETRY


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("distance", [1.0, 1.1, 1.2, 1.3, 1.4])
def test_spinning_robot_stops_before_its_corner_can_hit(side: float, distance: float) -> None:
    """A corner 0.135 m from the axle moves at 0.38 m/s in the fastest turn of a Burger.

    A linear constraint does not see the corner swing out during the stop; the stop check does.
    """
    comes = box(0.3, 0.2, Pose(-0.03, side * distance), velocity=(0.0, side * -0.30))
    run = FilterSim(BURGER, [comes]).run(Twist(0.0, 2.84), 6.0)
    assert run.touch is not None
    assert run.touch.speed <= NO_FAULT
    assert max(abs(twist.angular) for twist in run.twists) > 1.5
