"""Keeping clear and steering."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from msgspec import structs

from swarmd.core.values import Array, Twist
from swarmd.kit.steering import (
    NearPoints,
    RobotsInSight,
    from_base,
    keep_clear,
    near_points,
    steer,
    to_middle,
)
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import Disc, scan_of

WAFFLE = load_platform("waffle_pi")

NOTHING = np.empty((0, 2))
UNIT = st.floats(-1.0, 1.0)
BEARING = st.floats(-math.pi, math.pi)


def command(x: float, y: float, points: Array = NOTHING, *, may_back: bool = False) -> Twist:
    return steer(
        np.array([x, y]), 0.2, 2.0, points=points, spacing=0.5, brake=0.5, may_back=may_back
    )


def test_points_are_moved_from_the_sensor_to_the_base() -> None:
    points = from_base(np.array([[1.0, 0.0], [1.0, math.pi], [1.0, math.pi / 2]]), (-0.5, 0.0))
    expected = [[0.5, 0.0], [1.5, math.pi], [math.hypot(0.5, 1.0), math.atan2(1.0, -0.5)]]
    np.testing.assert_allclose(points, expected)
    left = from_base(np.array([[1.0, math.pi / 2]]), (0.0, 0.5))
    np.testing.assert_allclose(left, [[1.5, math.pi / 2]])


@pytest.mark.parametrize(("distance", "speed"), [(2.0, 1.0), (1.0, 1.0), (0.75, 0.5), (0.5, 0.0)])
def test_the_speed_towards_a_point_falls_to_zero_at_the_spacing(
    distance: float, speed: float
) -> None:
    points = np.array([[distance, 0.0]])
    cleared = keep_clear(np.array([1.0, 0.0]), points, spacing=0.5, brake=0.5)
    np.testing.assert_allclose(cleared, [speed, 0.0], atol=1e-12)


def test_nearer_than_the_spacing_it_is_pushed_away() -> None:
    cleared = keep_clear(np.zeros(2), np.array([[0.4, math.pi / 2]]), spacing=0.5, brake=0.5)
    np.testing.assert_allclose(cleared, [0.0, -0.2], atol=1e-12)


def test_motion_past_a_point_is_not_limited() -> None:
    cleared = keep_clear(np.array([1.0, 1.0]), np.array([[0.5, 0.0]]), spacing=0.5, brake=0.5)
    np.testing.assert_allclose(cleared, [0.0, 1.0], atol=1e-12)


@given(x=UNIT, y=UNIT, bearings=st.lists(BEARING, min_size=1, max_size=6))
def test_the_nearest_point_is_obeyed_exactly(x: float, y: float, bearings: list[float]) -> None:
    points = np.array([[0.3 + 0.1 * i, b] for i, b in enumerate(bearings)])
    cleared = keep_clear(np.array([x, y]), points, spacing=0.5, brake=0.5)
    towards = cleared @ [math.cos(bearings[0]), math.sin(bearings[0])]
    assert towards <= -0.4 + 1e-9


def test_ahead_it_drives_straight_at_the_vectors_speed() -> None:
    assert command(0.5, 0.0) == Twist(linear=0.1)
    assert command(3.0, 0.0) == Twist(linear=0.2)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_aside_it_turns_without_driving(side: float) -> None:
    twist = command(0.0, side)
    assert twist.linear == pytest.approx(0.0, abs=1e-12)
    assert twist.angular == 2.0 * side


def test_behind_it_turns_in_place() -> None:
    assert command(-1.0, 0.1) == Twist(angular=2.0)


def test_behind_it_reverses_at_half_speed_with_may_back() -> None:
    assert command(-1.0, 0.0, may_back=True) == Twist(linear=-0.1)
    assert command(-1.0, 0.1, may_back=True).angular < 0.0


def test_a_point_ahead_limits_speed_while_it_turns() -> None:
    # The vector leads past the point, but the robot still heads for it.
    ahead = np.array([[0.5, 0.0]])
    twist = command(0.7, 0.7, ahead)
    assert twist.linear == 0.0
    assert twist.angular > 0.0


@pytest.mark.parametrize("vector", [(0.0, 0.0), (math.nan, 0.0), (0.0, math.inf)])
def test_no_direction_is_no_motion(vector: tuple[float, float]) -> None:
    assert command(*vector) == Twist()


def test_no_distance_to_brake_and_an_infinite_bearing_are_errors() -> None:
    near = NearPoints([(0.4, 0.0)])
    with pytest.raises(ZeroDivisionError):
        near.keep_clear(1.0, 0.0, spacing=0.5, brake=0.0)
    with pytest.raises(ZeroDivisionError):
        near.steer(1.0, 0.0, 0.2, 2.0, spacing=0.5, brake=0.0)
    with pytest.raises(ValueError, match="infinite"):
        NearPoints([(0.4, math.inf)])


def test_near_points_know_the_nearest_range() -> None:
    assert NearPoints(()).nearest == math.inf
    assert NearPoints([(0.4, 1.0), (0.3, 2.0), (0.5, 0.0)]).nearest == 0.3


@given(x=UNIT, y=UNIT, bearings=st.lists(BEARING, max_size=6))
def test_near_points_serve_several_steps(x: float, y: float, bearings: list[float]) -> None:
    points = np.array([[0.4 + 0.1 * i, b] for i, b in enumerate(bearings)]).reshape(-1, 2)
    near = NearPoints(points.tolist())
    for _ in range(2):
        vector = near.keep_clear(x, y, spacing=0.5, brake=0.5)
        assert list(vector) == list(keep_clear(np.array([x, y]), points, spacing=0.5, brake=0.5))
        twist = near.steer(*vector, 0.2, 2.0, spacing=0.5, brake=0.5)
        assert twist == command(*vector, points)


def test_the_middle_of_a_room_is_where_its_walls_are_farther() -> None:
    # The right wall is 0.5 m away, the left one 3.5 m: no return counts as the range of 3.5 m.
    right = scan_of(WAFFLE, [Disc(0.0, -100.5, 100.0)])
    x, y = to_middle(right, [])
    assert abs(x) < 0.05
    assert y > 0.5
    assert to_middle(scan_of(WAFFLE), []) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_robots_do_not_move_the_middle() -> None:
    near = scan_of(WAFFLE, [Disc(0.5, 0.0, 0.1)])
    assert math.hypot(*to_middle(near, [(0.4, 0.0, 0.2)])) < 0.02 < math.hypot(*to_middle(near, []))


@given(seed=st.integers(0, 2**16), robots=st.integers(0, 3))
def test_the_middle_is_the_mean_of_the_free_rays(seed: int, robots: int) -> None:
    rng = np.random.default_rng(seed)
    scan = scan_of(WAFFLE, room=5.0, seq=seed, noise=0.05)
    ranges = np.where(rng.random(360) < 0.1, math.nan, scan.ranges)
    ranges[::17], ranges[::19] = math.inf, -math.inf
    hidden = [(*rng.uniform((0.1, -3.0), (3.0, 3.0)), 0.3) for _ in range(robots)]
    free = [
        (min(max(away, scan.range_min), scan.range_max), bearing)
        for away, bearing in zip(ranges.tolist(), scan.bearings.tolist(), strict=True)
        if not math.isnan(away)
        # 0.05 rad beside the edges of a robot.
        and all(
            abs(math.remainder(bearing - at, math.tau)) > math.atan2(0.15, near) + 0.05
            for near, at, _ in hidden
        )
    ]
    mean = math.fsum(away for away, _ in free) / len(free)
    wanted = [
        math.fsum((away - mean) * part(bearing) for away, bearing in free) / len(free)
        for part in (math.cos, math.sin)
    ]
    found = to_middle(structs.replace(scan, ranges=ranges), hidden)
    assert found == pytest.approx(wanted, abs=1e-12)


def test_a_scan_of_unknown_rays_has_no_middle() -> None:
    scan = scan_of(WAFFLE)
    blind = structs.replace(scan, ranges=np.full_like(scan.ranges, math.nan))
    assert to_middle(blind, []) == (0.0, 0.0)


def test_near_points_of_a_scan_are_seen_from_the_base() -> None:
    # A disc of 0.1 m, 0.5 m before a lidar that stands 0.064 m behind the axle.
    scan = scan_of(WAFFLE, [Disc(0.5 + WAFFLE.scan.offset[0], 0.0)])
    assert WAFFLE.scan.offset == (-0.064, 0.0)
    near = near_points(scan, within=1.0, offset=WAFFLE.scan.offset)
    assert near.nearest == pytest.approx(0.5 - 0.1 - 0.064, abs=1e-3)
    assert near_points(scan, within=0.3, offset=WAFFLE.scan.offset).nearest == math.inf
    assert near_points(None, within=1.0, offset=(0.0, 0.0)).nearest == math.inf


def in_sight(*polar: tuple[float, float]) -> RobotsInSight:
    """Robots of 0.1 m that no other hides, seen from a lidar at the axle."""
    return RobotsInSight([(*one, 0.1, 9, True) for one in polar], 0.3, 3.0, (0.0, 0.0))


def test_robots_in_sight_are_narrow_and_near_and_whole_ones_have_a_place() -> None:
    robot, partly = (1.0, 0.0, 0.3, 9, True), (2.0, 1.0, 0.2, 9, False)
    wide, far = (1.0, 2.0, 0.31, 9, True), (3.1, 2.0, 0.1, 9, True)
    found = RobotsInSight([robot, partly, wide, far], 0.3, 3.0, (0.5, 1.0))
    assert found.objects == [robot, partly]
    assert found.polar == [pytest.approx((math.hypot(1.5, 1.0), math.atan2(1.0, 1.5)))]


def test_robots_ahead_and_behind_lie_on_one_line() -> None:
    line = in_sight((1.0, 0.3), (0.4, 0.3 - math.pi)).arrangement(0.5)
    assert line == pytest.approx((1, 2.0))
    across = in_sight((1.0, 0.0), (0.4, math.pi / 2)).arrangement(0.4)
    assert across == pytest.approx((0, 0.0), abs=1e-12)
    assert in_sight().arrangement(1.0) == (0, 0.0)


def test_the_pull_of_robots_grows_beyond_all_bounds_near_the_reach() -> None:
    # (1.5 - 0.5) / (0.25 * (1 - 1.5 / 2)) ahead; within 0.5 m none; beyond 1.9 m that of 1.9 m.
    robots = in_sight((1.5, 0.0), (0.5, 1.0), (2.5, math.pi / 2))
    assert robots.pull(0.5, 0.25, 2.0) == pytest.approx((16.0, 2.0 / (0.25 * 0.05)))
    for brake, reach in ((0.0, 2.0), (0.25, 0.0)):
        with pytest.raises(ZeroDivisionError):
            robots.pull(0.5, brake, reach)


@given(x=UNIT, y=UNIT, distance=st.floats(0.5, 2.5), bearing=BEARING)
@example(x=-1.0, y=0.5, distance=1.9, bearing=0.3)
def test_a_vector_leads_no_farther_than_the_reach(
    x: float, y: float, distance: float, bearing: float
) -> None:
    kept = in_sight((distance, bearing)).keep_in_sight(x, y, reach=2.0, brake=0.5)
    ahead, left = math.cos(bearing), math.sin(bearing)
    away = -(x * ahead + y * left)
    most = max(2.0 - distance, 0.0) / 0.5
    assert -(kept[0] * ahead + kept[1] * left) == pytest.approx(min(away, most), abs=1e-12)
    assert kept[0] * left - kept[1] * ahead == pytest.approx(x * left - y * ahead, abs=1e-12)
    with pytest.raises(ZeroDivisionError):
        in_sight((1.0, 0.0)).keep_in_sight(x, y, reach=2.0, brake=0.0)
