"""Places in lines and circles, robots in a scan, and tracked neighbours."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.values import Array, Neighbor, Pose
from swarmd.kit.formation_geometry import (
    NeighborTracker,
    place_on_circle,
    place_on_line,
    radius_of,
    robot_centers,
)
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import Disc, scan_of

BURGER = load_platform("burger")
OFFSET = BURGER.scan.offset


@pytest.mark.parametrize("turn", [0.0, 1.0, 2.5])
def test_a_robot_in_its_place_on_a_line_stays(turn: float) -> None:
    along = np.array([math.cos(turn), math.sin(turn)])
    for own in range(4):
        others = np.array([(k - own) * 1.1 * along for k in range(4) if k != own])
        np.testing.assert_allclose(place_on_line(others, 1.1), np.zeros(2), atol=1e-12)


def test_its_place_is_on_the_line_of_least_squares() -> None:
    # Beside the middle of a line along x, 0.3 m to its right: all but it stand on y = 0.3.
    others = np.array([(x, 0.3) for x in (-2.0, -1.0, 1.0, 2.0)])
    place = place_on_line(others, 1.0)
    np.testing.assert_allclose(place, (0.0, 0.24), atol=1e-12)


def test_between_two_it_goes_to_the_middle_and_at_an_end_to_its_spacing() -> None:
    np.testing.assert_allclose(place_on_line(np.array([(-1.0, 0.0), (1.6, 0.0)]), 1.0), (0.2, 0.0))
    # Of a gap that is too wide each closes one half.
    np.testing.assert_allclose(place_on_line(np.array([(2.0, 0.0)]), 1.0), (0.5, 0.0))
    np.testing.assert_allclose(place_on_line(np.array([(0.0, -0.6)]), 1.0), (0.0, 0.2), atol=1e-12)


def test_robots_that_see_the_same_agree_on_a_line() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-2.0, 2.0, (6, 2))
    placed = np.array([p + place_on_line(np.delete(points, i, 0) - p, 1.1)
                       for i, p in enumerate(points)])  # fmt: skip
    middle = placed.mean(axis=0)
    np.testing.assert_allclose(middle, points.mean(axis=0), atol=1e-9)
    away = np.sort((placed - middle) @ _direction(placed))
    np.testing.assert_allclose(np.diff(away), np.full(5, 1.1), atol=1e-9)


def _direction(points: Array) -> Array:
    """(2,) a unit vector along points in a line."""
    along: Array = np.linalg.svd(points - points.mean(axis=0))[2][0]
    return along


def polygon(count: int, radius: float, first: float = 0.4) -> Array:
    angles = first + 2.0 * math.pi / count * np.arange(count)
    return radius * np.stack((np.cos(angles), np.sin(angles)), axis=-1)


def seen_from(points: Array, robot: int) -> Array:
    """The others as seen from one of points (n, 2)."""
    others: Array = np.delete(points, robot, axis=0) - points[robot]
    return others


@pytest.mark.parametrize("count", [2, 3, 6, 8])
def test_a_robot_in_its_place_on_a_circle_stays(count: int) -> None:
    points = polygon(count, radius_of(1.1, count))
    assert np.hypot(*(points[1] - points[0])) == pytest.approx(1.1)
    for own in range(count):
        place = place_on_circle(seen_from(points, own), radius_of(1.1, count))
        np.testing.assert_allclose(place, np.zeros(2), atol=1e-9)


@pytest.mark.parametrize("robot", [0, 2])
def test_it_corrects_the_radius_of_the_circle(robot: int) -> None:
    points = polygon(5, 1.0)
    outwards = points[robot] / np.hypot(*points[robot])
    larger = place_on_circle(seen_from(points, robot), 1.3)
    np.testing.assert_allclose(larger, 0.3 * outwards, atol=1e-9)
    smaller = place_on_circle(seen_from(points, robot), 0.8)
    np.testing.assert_allclose(smaller, -0.2 * outwards, atol=1e-9)


def test_robots_that_see_the_same_agree_on_a_circle() -> None:
    points = np.random.default_rng(5).uniform(-2.0, 2.0, (7, 2))
    radius = radius_of(1.1, 7)
    placed = np.array([p + place_on_circle(seen_from(points, i), radius)
                       for i, p in enumerate(points)])  # fmt: skip
    away = placed - points.mean(axis=0)
    np.testing.assert_allclose(np.hypot(*away.T), np.full(7, radius), atol=1e-9)
    angles = np.sort(np.arctan2(away[:, 1], away[:, 0]))
    np.testing.assert_allclose(np.diff(angles), np.full(6, 2.0 * math.pi / 7.0), atol=1e-9)


@pytest.mark.parametrize("place", [(1.0, 0.0), (0.0, 1.5), (-1.2, -0.7)])
def test_the_lidar_finds_the_centers_of_robots(place: tuple[float, float]) -> None:
    scan = scan_of(BURGER, [Disc(*place, 0.09)])
    found = robot_centers(scan, reach=3.5, width=0.5, offset=OFFSET)
    np.testing.assert_allclose(found, [place], atol=0.02)


def test_the_lidar_ignores_walls_and_objects_out_of_range() -> None:
    scan = scan_of(BURGER, [Disc(1.0, 0.0), Disc(0.0, 2.5)], room=5.5)
    found = robot_centers(scan, reach=2.0, width=0.5, offset=OFFSET)
    np.testing.assert_allclose(found, [(1.0, 0.0)], atol=0.03)
    assert (
        len(robot_centers(scan_of(BURGER, room=3.0), reach=3.5, width=0.5, offset=(0.0, 0.0))) == 0
    )


def test_a_wall_as_far_as_the_robots_that_count_is_no_robot() -> None:
    """Cut off at 0.6 m, the nearest part of the wall would be as narrow as a robot."""
    scan = scan_of(BURGER, room=6.0, pose=Pose(0.0, -2.44))
    found = robot_centers(scan, reach=0.6, width=0.5, offset=(0.0, 0.0))
    assert len(found) == 0


@pytest.mark.parametrize("turn", [math.pi - 0.03, 0.0, math.pi + 0.03])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_center_of_a_half_hidden_robot_is_found(side: float, turn: float) -> None:
    # The third is nearer than the one behind, but aside of it, and hides nothing.
    places = np.array([1.1, 2.2 + side * 0.14j, side * 1.0j]) * np.exp(1j * turn)
    discs = [Disc(place.real, place.imag, 0.09) for place in places.tolist()]
    found = robot_centers(scan_of(BURGER, discs), reach=3.5, width=0.5, offset=OFFSET)
    assert len(found) == 3
    far = found[np.argmax(np.hypot(*found.T))]
    np.testing.assert_allclose(far, (places[1].real, places[1].imag), atol=0.05)


def test_a_robot_seen_in_pieces_is_merged() -> None:
    scan = scan_of(BURGER, [Disc(1.0, 0.0, 0.09), Disc(0.0, 1.5, 0.09)])
    ranges = scan.ranges.copy()
    ranges[np.abs(scan.bearings - math.radians(1.0)) < 0.005] += 0.2
    pieces = replace(scan, ranges=ranges)
    found = robot_centers(pieces, reach=3.5, width=0.45, offset=OFFSET)
    assert len(found) == 2
    np.testing.assert_allclose(found[np.argmax(found[:, 0])], (1.0, 0.0), atol=0.06)


def test_an_object_hidden_on_both_sides_is_not_a_robot() -> None:
    between = [Disc(1.0, 0.25, 0.09), Disc(1.0, -0.25, 0.09), Disc(2.3, 0.0, 0.4)]
    found = robot_centers(scan_of(BURGER, between), reach=3.5, width=0.8, offset=OFFSET)
    np.testing.assert_allclose(np.sort(found[:, 1]), (-0.25, 0.25), atol=0.03)


def seen(*places: tuple[float, float]) -> tuple[Neighbor, ...]:
    """Neighbours at these places in m in the base frame."""
    return tuple(
        Neighbor(f"r{index}", 0.1, math.hypot(x, y), math.atan2(y, x))
        for index, (x, y) in enumerate(places)
    )


def test_tracked_positions_stay_while_the_robot_moves() -> None:
    tracker = NeighborTracker()
    once = tracker.update(seen((1.0, 0.0)), Pose(), 10.0, 0.0)
    np.testing.assert_allclose(once, [(1.0, 0.0)])
    turned = tracker.update(seen((1.0, 0.0)), Pose(0.0, 0.0, math.pi / 2.0), 10.0, 0.1)
    np.testing.assert_allclose(turned, [(0.0, -1.0)], atol=1e-12)
    driven = tracker.update(seen((1.0, 0.0)), Pose(0.5, 0.0, 0.0), 10.0, 0.2)
    np.testing.assert_allclose(driven, [(0.5, 0.0)], atol=1e-12)


def test_a_neighbour_unsensed_for_a_moment_keeps_its_position() -> None:
    tracker, (there,) = NeighborTracker(), seen((1.0, 0.0))
    unsensed = (Neighbor(there.id, 0.1),)
    tracker.update((there,), Pose(), 10.0, 0.0)
    for now, count in ((0.5, 1), (2.0, 1), (2.1, 0), (2.2, 0)):
        assert len(tracker.update(unsensed, Pose(), 10.0, now)) == count
    assert not len(tracker.update((), Pose(), 10.0, 0.1))


def test_tracker_averages_noise_and_follows_motion() -> None:
    tracker, rng = NeighborTracker(), np.random.default_rng(1)
    for _ in range(40):
        off = rng.normal(0.0, 0.03, 2)
        found = tracker.update(seen((2.0 + off[0], off[1])), Pose(), 10.0, 0.0)
    np.testing.assert_allclose(found, [(2.0, 0.0)], atol=0.03)
    moved = tracker.update(seen((3.0, 0.0)), Pose(), 10.0, 0.0)
    np.testing.assert_allclose(moved, [(3.0, 0.0)], atol=1e-9)
