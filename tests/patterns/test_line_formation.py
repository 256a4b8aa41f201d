"""Line formation: one step at a time, what it needs, and its arithmetic."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.values import Array, Inputs, Neighbor, Odometry, Platform, Pose, Scan, Twist, Value
from swarmd.kit.behavior import Pattern
from swarmd.kit.factory import assemble
from swarmd.kit.formation_geometry import NeighborTracker, place_on_line, robot_centers
from swarmd.kit.formation_pattern import FormationParams
from swarmd.patterns.line_formation import LineFormation
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_of

BURGER = load_platform("burger")
HEARING = frozenset({"neighbors", "neighbors.distance", "neighbors.bearing"})
SENSING = replace(BURGER, provides=BURGER.provides | HEARING)
EMPTY = scan_of(BURGER)


class TestLineFormation(PatternContract):
    pattern = LineFormation


class _ByBearing(LineFormation):
    """The same where range and bearing are provided; mirrored scans do not mirror neighbours."""

    needs = LineFormation.needs | HEARING
    is_symmetric = False


class TestLineFormationByBearing(PatternContract):
    pattern = _ByBearing


def make(platform: Platform = SENSING, **params: Value) -> Pattern[FormationParams]:
    return Subject(LineFormation, platform, params).make()


def seen(*places: tuple[float, float]) -> tuple[Neighbor, ...]:
    """Neighbours at these places in m in the base frame."""
    return tuple(
        Neighbor(f"r{index}", 0.1, math.hypot(x, y), math.atan2(y, x))
        for index, (x, y) in enumerate(places)
    )


def step(
    pattern: Pattern[FormationParams],
    neighbors: Sequence[Neighbor] = (),
    *,
    scan: Scan = EMPTY,
    now: float = 0.0,
    pose: Pose | None = None,
) -> tuple[Twist, str]:
    """The requested command and the state."""
    odometry = Odometry(now, pose or Pose(), Twist())
    outputs = pattern.step(
        Inputs(now, 0.1, scan, is_new_scan=True, odometry=odometry, neighbors=tuple(neighbors))
    )
    assert outputs.twist is not None
    return outputs.twist, str(outputs.report["state"])


@pytest.mark.parametrize("turn", [0.0, 1.0, 2.5])
def test_a_robot_in_its_place_stays(turn: float) -> None:
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


def test_robots_that_see_the_same_agree() -> None:
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


def test_it_turns_and_drives_to_its_place() -> None:
    twist, state = step(make(), seen((-1.0, 0.0), (2.0, 0.0)))
    assert state == "form"
    assert twist.linear > 0.1
    twist, _ = step(make(), seen((-1.1, 0.5), (1.1, 0.5)))
    assert twist.angular > 0.1
    twist, _ = step(make(), seen((-1.1, -0.5), (1.1, -0.5)))
    assert twist.angular < -0.1


def test_the_nearer_its_place_the_slower() -> None:
    far, near = (step(make(), seen((-1.1, 0.0), (1.1 + x, 0.0)))[0] for x in (1.2, 0.4))
    assert far.linear > near.linear > 0.0


def test_it_rests_while_its_place_is_within_the_tolerance() -> None:
    pattern = make(tolerance=0.1)
    assert step(pattern, seen((-1.1, 0.0), (1.1, 0.0))) == (Twist(), "settled")
    # The middle between its neighbours is 0.09 m off.
    for now in range(1, 60):
        found = step(pattern, seen((-1.1, 0.0), (1.28, 0.0)), now=float(now))
    assert found == (Twist(), "settled")
    for now in range(60, 120):
        twist, state = step(pattern, seen((-1.1, 0.0), (1.55, 0.0)), now=float(now))
    assert state == "form"
    assert twist.linear > 0.0


def test_alone_it_stands() -> None:
    assert step(make()) == (Twist(), "alone")
    assert step(make(), [Neighbor("r1", 0.0)]) == (Twist(), "alone")
    assert step(make(), [Neighbor("r1", 0.0, math.nan, 0.0)]) == (Twist(), "alone")
    assert step(make(range=2.0), seen((3.0, 0.0))) == (Twist(), "alone")
    assert step(make(BURGER)) == (Twist(), "alone")


def test_a_robot_that_is_no_longer_sensed_is_dropped() -> None:
    pattern = make()
    step(pattern, seen((-1.1, 0.0), (1.1, 0.0), (2.2, 3.0)))
    for now in range(1, 40):
        found = step(pattern, seen((-1.1, 0.0), (1.1, 0.0)), now=float(now))
    assert found[1] == "settled"


def test_it_keeps_clear_of_obstacles_in_its_way() -> None:
    free, _ = step(make(), seen((-1.1, 0.0), (2.9, 0.0)))
    blocked, _ = step(make(), seen((-1.1, 0.0), (2.9, 0.0)), scan=scan_of(BURGER, [Disc(0.7, 0.0)]))
    assert free.linear > 0.2
    assert blocked.linear < 0.05


def test_needs_follow_from_sensing() -> None:
    assert make().needs == LineFormation.needs | {"neighbors.distance", "neighbors.bearing"}
    assert make(BURGER).needs == LineFormation.needs
    assert make(sensing="lidar").needs == LineFormation.needs
    with pytest.raises(PluginError, match=r"neighbors\.bearing, neighbors\.distance"):
        assemble(
            "line_formation",
            (("test", {"sensing": "neighbors"}),),
            find=lambda name: LineFormation,
            robot="r0",
            platform=BURGER,
            rng=np.random.default_rng(0),
        )


def test_sensing_cannot_change_to_missing_hardware() -> None:
    pattern = make(BURGER)
    good = pattern.params
    with pytest.raises(ConfigError, match=r"neighbors\.bearing"):
        pattern.update(msgspec.structs.replace(good, sensing="neighbors"))
    assert pattern.params is good


@pytest.mark.parametrize(
    ("params", "subject"),
    [
        ({"spacing": 0.5}, "spacing"),
        ({"spacing": 0.5, "clearance": 0.3}, "the protection of burger"),
        ({"spacing": 0.7, "clearance": 0.8}, "the clearance"),
    ],
)
def test_a_spacing_that_is_too_small_is_refused(params: dict[str, Value], subject: str) -> None:
    with pytest.raises(ConfigError, match=subject):
        Subject(LineFormation, SENSING, params).make()


@pytest.mark.parametrize("place", [(1.0, 0.0), (0.0, 1.5), (-1.2, -0.7)])
def test_the_lidar_finds_the_centers_of_robots(place: tuple[float, float]) -> None:
    scan = scan_of(BURGER, [Disc(*place, 0.09)])
    found = robot_centers(scan, reach=3.5, width=0.5, offset=BURGER.scan.offset)
    np.testing.assert_allclose(found, [place], atol=0.02)


def test_the_lidar_ignores_walls_and_objects_out_of_range() -> None:
    scan = scan_of(BURGER, [Disc(1.0, 0.0), Disc(0.0, 2.5)], room=5.5)
    found = robot_centers(scan, reach=2.0, width=0.5, offset=BURGER.scan.offset)
    np.testing.assert_allclose(found, [(1.0, 0.0)], atol=0.03)
    assert (
        len(robot_centers(scan_of(BURGER, room=3.0), reach=3.5, width=0.5, offset=(0.0, 0.0))) == 0
    )


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_center_of_a_half_hidden_robot_is_found(side: float) -> None:
    behind = (2.2, side * 0.14)
    scan = scan_of(BURGER, [Disc(1.1, 0.0, 0.09), Disc(*behind, 0.09)])
    found = robot_centers(scan, reach=3.5, width=0.5, offset=BURGER.scan.offset)
    assert len(found) == 2
    far = found[np.argmax(found[:, 0])]
    np.testing.assert_allclose(far, behind, atol=0.05)


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


def test_its_place_is_one_spacing_from_the_others() -> None:
    others = np.array([(1.0, 0.0), (2.0, 0.0)])
    pattern = make(spacing=1.5)
    assert isinstance(pattern, LineFormation)
    np.testing.assert_allclose(pattern.place(others), np.array((-0.5, 0.0)), atol=1e-9)


def test_tracker_averages_noise_and_follows_motion() -> None:
    tracker, rng = NeighborTracker(), np.random.default_rng(1)
    for _ in range(40):
        off = rng.normal(0.0, 0.03, 2)
        found = tracker.update(seen((2.0 + off[0], off[1])), Pose(), 10.0, 0.0)
    np.testing.assert_allclose(found, [(2.0, 0.0)], atol=0.03)
    moved = tracker.update(seen((3.0, 0.0)), Pose(), 10.0, 0.0)
    np.testing.assert_allclose(moved, [(3.0, 0.0)], atol=1e-9)


def test_a_robot_seen_in_pieces_is_merged() -> None:
    scan = scan_of(BURGER, [Disc(1.0, 0.0, 0.09), Disc(0.0, 1.5, 0.09)])
    ranges = scan.ranges.copy()
    ranges[np.abs(scan.bearings - math.radians(1.0)) < 0.005] += 0.2
    pieces = replace(scan, ranges=ranges)
    found = robot_centers(pieces, reach=3.5, width=0.45, offset=BURGER.scan.offset)
    assert len(found) == 2
    np.testing.assert_allclose(found[np.argmax(found[:, 0])], (1.0, 0.0), atol=0.06)


def test_an_object_hidden_on_both_sides_is_not_a_robot() -> None:
    between = [Disc(1.0, 0.25, 0.09), Disc(1.0, -0.25, 0.09), Disc(2.3, 0.0, 0.4)]
    found = robot_centers(scan_of(BURGER, between), reach=3.5, width=0.8, offset=BURGER.scan.offset)
    np.testing.assert_allclose(np.sort(found[:, 1]), (-0.25, 0.25), atol=0.03)
