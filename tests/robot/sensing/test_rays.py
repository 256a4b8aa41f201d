"""Rays: nearest, sectors, closest points, gaps and objects."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.values import Scan
from swarmd.robot.sensing.rays import Gap, Ray, closest_points, clusters, gaps, nearest, sectors
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import Disc, busy_scans, odd_scans, reordered, scan_from, scan_of

INF, NAN = math.inf, math.nan
# Its lidar sits 32 mm behind the axle.
BURGER = load_platform("burger")
DEGREE = math.radians(1.0)


def scan(ranges: list[float], degrees: list[float]) -> Scan:
    return scan_from(BURGER, np.array(ranges), np.radians(degrees))


def test_nearest_is_the_shortest_known_ray() -> None:
    ray = nearest(scan([2.0, NAN, 1.0, INF, 3.0], [0, 10, 270, 30, 40]))
    assert ray == pytest.approx(Ray(1.0, -math.pi / 2))


def test_nearest_looks_only_in_the_sector() -> None:
    some = scan([1.0, 2.0, 3.0], [90, 5, 355])
    assert nearest(some, half_width=math.radians(30)) == pytest.approx(Ray(2.0, 5 * DEGREE))
    assert nearest(some, bearing=math.pi, half_width=math.radians(30)) is None


def test_nearest_looks_across_the_end_of_the_circle() -> None:
    some = scan([1.0, 2.0], [-179, 170])
    assert nearest(some, bearing=math.pi, half_width=math.radians(5)) == pytest.approx(
        Ray(1.0, -179 * DEGREE)
    )


def test_nearest_of_a_near_ray_is_range_min() -> None:
    assert nearest(scan([-INF, 1.0], [20, 0])) == pytest.approx(Ray(0.12, 20 * DEGREE))


@pytest.mark.parametrize("ranges", [[], [INF], [NAN, NAN]])
def test_nearest_without_a_return_is_none(ranges: list[float]) -> None:
    assert nearest(scan(ranges, [0.0] * len(ranges))) is None
    assert nearest(None) is None


def test_sectors_count_from_ahead_to_the_left() -> None:
    some = scan([1.0, 2.0, 3.0, 4.0, 5.0], [0, 90, 180, 270, 44])
    assert sectors(some, 4).tolist() == [1.0, 2.0, 3.0, 4.0]


def test_sector_without_a_known_ray_is_infinite() -> None:
    assert sectors(scan([1.0, NAN], [0, 90]), 4).tolist() == [1.0, INF, INF, INF]
    assert sectors(None, 3).tolist() == [INF, INF, INF]


def test_wall_and_robot_have_one_closest_point_each() -> None:
    room = scan_of(BURGER, [Disc(0.0, 0.8, 0.1)], room=4.0, noise=0.005)
    points = closest_points(room, within=2.5)
    found = sorted((round(r, 1), round(math.degrees(b), -1) % 360) for r, b in points.tolist())
    assert found == [(0.7, 90.0), (2.0, 0.0), (2.0, 180.0), (2.0, 270.0)]


def test_far_obstacle_has_no_closest_point() -> None:
    assert closest_points(scan([1.0, 2.0], [0, 90]), within=0.9).shape == (0, 2)
    assert closest_points(None, within=1.0).shape == (0, 2)


def test_nearest_ray_is_always_a_closest_point() -> None:
    for some in busy_scans(BURGER, 50):
        ray = nearest(some)
        assert ray is not None
        points = closest_points(some, within=4.0)
        assert [ray.range, ray.bearing] in points.tolist()


def test_gaps_come_widest_first() -> None:
    ranges = np.full(360, 1.0)
    ranges[350:] = ranges[:21] = 3.0
    ranges[100:111] = INF
    found = gaps(scan_from(BURGER, ranges, np.radians(np.arange(360.0))), beyond=2.0)
    expected = [Gap(5 * DEGREE, 30 * DEGREE), Gap(105 * DEGREE, 10 * DEGREE)]
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("ranges", "expected"),
    [([NAN, 1.0], []), ([0.5], []), ([], []), ([INF, 5.0], [Gap(0.0, 2.0 * math.pi)])],
)
def test_gaps_of_few_rays(ranges: list[float], expected: list[Gap]) -> None:
    assert gaps(scan(ranges, [0.0, 90.0][: len(ranges)]), beyond=2.0) == expected


def test_nothing_is_found_before_the_first_scan() -> None:
    assert gaps(None, beyond=2.0) == []
    assert len(clusters(None, within=1.0)) == 0


def test_objects_have_range_bearing_width_and_rays() -> None:
    found = clusters(scan_of(BURGER, [Disc(0.968, 1.0, 0.2), Disc(-1.532, 0.0, 0.1)]), within=3.0)
    order = np.argsort(found.bearings % (2 * math.pi))
    assert len(found) == 2
    np.testing.assert_allclose(found.ranges[order], [math.sqrt(2.0) - 0.2, 1.4], atol=0.01)
    np.testing.assert_allclose(
        found.bearings[order] % (2 * math.pi), [math.pi / 4, math.pi], atol=0.01
    )
    # Rays never meet the very edges; at 1 degree that costs up to a ray on each side.
    np.testing.assert_allclose(found.widths[order], [0.4, 0.2], atol=0.05)
    assert found.is_free.all()


def test_object_across_the_first_ray_is_one() -> None:
    assert len(clusters(scan_of(BURGER, [Disc(1.0, 0.0, 0.2)]), within=3.0)) == 1


def test_room_is_one_object() -> None:
    found = clusters(scan_of(BURGER, room=3.0, noise=0.01), within=10.0)
    assert len(found) == 1
    assert found.counts.tolist() == [360]


@pytest.mark.parametrize("open_rays", [0, 1, 5, 20])
def test_room_with_a_narrow_door_is_wide(open_rays: int) -> None:
    room = scan_of(BURGER, room=3.0)
    room.ranges[:open_rays] = INF
    assert clusters(room, within=10.0).widths.tolist() == [pytest.approx(9.0, abs=1.0)]


def test_wall_at_a_flat_angle_is_one_object() -> None:
    # 0.3 m beside a wall, neighbouring rays are up to 0.4 m apart on it.
    beside = scan_of(BURGER, [Disc(0.0, 500.3, 500.0)])
    assert len(clusters(beside, within=2.5)) == 1


def test_robot_before_a_wall_is_free_and_the_wall_is_not() -> None:
    found = clusters(scan_of(BURGER, [Disc(1.0, 0.0, 0.1)], room=4.0), within=4.0)
    widths = found.widths[found.is_free]
    assert len(found) == 2
    assert widths.tolist() == [pytest.approx(0.2, abs=0.05)]


def test_half_hidden_robot_is_not_free() -> None:
    found = clusters(scan_of(BURGER, [Disc(1.0, 0.0, 0.1), Disc(1.6, 0.2, 0.1)]), within=3.0)
    assert found.is_free[np.argsort(found.ranges)].tolist() == [True, False]


def test_few_unknown_rays_do_not_split_an_object() -> None:
    whole = scan_of(BURGER, [Disc(0.6, 0.0, 0.2)])
    whole.ranges[[3, 4]] = NAN
    assert len(clusters(whole, within=3.0)) == 1


@pytest.mark.parametrize("name", odd_scans(BURGER))
def test_odd_scans_are_read_without_error(name: str) -> None:
    odd = odd_scans(BURGER)[name]
    assert not np.isnan(sectors(odd, 24)).any()
    assert np.isfinite(closest_points(odd, within=2.0)).all()
    assert all(math.isfinite(gap.width) for gap in gaps(odd, beyond=1.0))
    found = clusters(odd, within=2.0)
    assert np.isfinite(found.ranges).all()
    assert np.isfinite(found.widths).all()
    assert int(found.counts.sum()) == np.count_nonzero(np.maximum(odd.ranges, 0.12) <= 2.0)


def test_order_of_rays_does_not_matter() -> None:
    rng = np.random.default_rng(0)
    for some in busy_scans(BURGER, 20):
        other = reordered(some, rng)
        here, there = clusters(some, within=3.0), clusters(other, within=3.0)
        assert sorted(here.ranges.tolist()) == sorted(there.ranges.tolist())
        assert nearest(some).range == nearest(other).range  # type: ignore[union-attr]
        np.testing.assert_array_equal(sectors(some, 24), sectors(other, 24))
