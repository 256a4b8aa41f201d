"""Attraction: one step at a time, and seven robots in the plane."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import groupby
from types import MappingProxyType

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

from swarmd.core.values import Array, Inputs, Neighbor, Scalar, Scan, Twist, Value
from swarmd.patterns.attraction import Attraction
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_of
from tests.support.flatland import Course, Flatland

WAFFLE = load_platform("waffle_pi")
BESIDE = Disc(0.72, 0.0)
"""A robot at the distance at which the pull ends."""
PLATFORMS = ("burger", "waffle_pi")


class TestAttraction(PatternContract):
    pattern = Attraction


class TestAttractionOfThePaper(PatternContract):
    pattern = Attraction
    # Alone it spins to one side, which no mirror would.
    params = {"law": "paper", "angular_if_alone": 0.0}  # noqa: RUF012 - read only


def steps(
    *scans: Scan, seed: int = 0, heard: int = 0, params: Mapping[str, Value] = MappingProxyType({})
) -> Iterator[tuple[Twist, Scalar]]:
    """Requested command and state at 10 Hz, one step a scan, with `heard` neighbours."""
    pattern = Subject(Attraction, WAFFLE, params).make(seed)
    neighbors = tuple(Neighbor(f"robot-{i + 2}", 0.1) for i in range(heard))
    for index, scan in enumerate(scans):
        outputs = pattern.step(Inputs(0.1 * index, 0.1, scan, neighbors=neighbors))
        assert outputs.twist is not None
        yield outputs.twist, outputs.report["state"]


def requested(scan: Scan, *, count: int = 2, seed: int = 0, **params: Value) -> Twist:
    """The requested command after so many steps on one scan."""
    return list(steps(*[scan] * count, seed=seed, params=params))[-1][0]


def state(scan: Scan, *, count: int = 2, heard: int = 0) -> Scalar:
    """The state after so many steps on one scan."""
    return list(steps(*[scan] * count, heard=heard))[-1][1]


def states_on(scan: Scan, seconds: float, *, heard: int = 0) -> list[Scalar]:
    """The states that follow each other on one scan."""
    states = [state for _, state in steps(*[scan] * round(10 * seconds), heard=heard)]
    return [state for state, _ in groupby(states)]


def gather(platform: str, poses: Array, *, room: float, seconds: float, seed: int) -> Course:
    kind = load_platform(platform)
    subject = Subject(Attraction, kind, {})
    patterns = [subject.make(1000 * seed + i) for i in range(len(poses))]
    return Flatland(kind, patterns, poses, room=room, seed=seed).run(seconds)


def scattered(count: int, room: float, seed: int) -> Array:
    """Random poses 0.45 m from the walls and 0.7 m from each other."""
    rng = np.random.default_rng(seed)
    half = 0.5 * room - 0.45
    poses: list[list[float]] = []
    while len(poses) < count:
        pose = [*rng.uniform(-half, half, 2).tolist(), float(rng.uniform(-math.pi, math.pi))]
        if all(math.dist(pose[:2], other[:2]) > 0.7 for other in poses):
            poses.append(pose)
    return np.array(poses)


def cluster_count(poses: Array, link: float = 1.0) -> int:
    """Single linkage over the distances between centres."""
    apart = np.hypot(*(poses[:, None, :2] - poses[:, :2]).T)
    return int(connected_components(apart <= link, directed=False)[0])


def spread(poses: Array) -> float:
    """Mean distance to the centroid."""
    return float(np.hypot(*(poses[:, :2] - poses[:, :2].mean(axis=0)).T).mean())


def test_drives_towards_a_robot_ahead() -> None:
    twist = requested(scan_of(WAFFLE, [Disc(2.0, 0.0)]))
    assert twist.linear > 0.25
    assert abs(twist.angular) < 0.1


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_turns_towards_a_robot_at_its_side_without_driving(side: float) -> None:
    twist = requested(scan_of(WAFFLE, [Disc(0.0, 2.0 * side)]))
    assert twist.linear == pytest.approx(0.0, abs=0.01)
    assert twist.angular * side > 1.0


def test_slows_down_as_it_comes_near() -> None:
    speeds = [requested(scan_of(WAFFLE, [Disc(x, 0.0)])).linear for x in (2.0, 0.95, 0.85)]
    assert speeds[0] > speeds[1] > speeds[2] > 0.0


def test_comes_to_rest_at_its_spacing() -> None:
    # Its nearest point is 0.62 m from the axle; the spacing is 0.613 m.
    scan = scan_of(WAFFLE, [BESIDE])
    assert requested(scan) == Twist()
    assert state(scan) == "settled"


def test_reverses_from_an_obstacle_that_comes_too_near() -> None:
    twist = requested(scan_of(WAFFLE, [Disc(0.6, 0.0), Disc(-2.5, 0.0)]))
    # Half of 0.26 m/s at most.
    assert -0.131 <= twist.linear < -0.05


def test_starts_at_a_stronger_pull_than_it_stops_at() -> None:
    # The pull of a robot whose near side is 0.67 m from the axle: 0.19, between the two.
    far, between = scan_of(WAFFLE, [Disc(2.0, 0.0)]), scan_of(WAFFLE, [Disc(0.77, 0.0)])
    assert state(between) == "settled"
    assert list(steps(far, between))[-1][1] == "gather"


def test_rests_between_two_robots_at_equal_distance() -> None:
    assert requested(scan_of(WAFFLE, [Disc(1.5, 0.0), Disc(-1.5, 0.0)], noise=0.01)) == Twist()


@pytest.mark.parametrize("room", [3.0, 4.0, 5.0])
def test_walls_do_not_attract(room: float) -> None:
    """One robot far to the left outweighs four walls, wherever those are."""
    pose = scan_of(WAFFLE, room=room)
    assert state(pose) == "search"
    twist = requested(scan_of(WAFFLE, [Disc(0.0, 0.5 * room - 0.25, 0.06)], room=room))
    assert twist.angular > 0.5


def test_does_not_press_against_the_wall_while_it_searches() -> None:
    near = scan_of(WAFFLE, room=1.3)
    assert all(requested(near, count=n).linear < 0.05 for n in range(1, 20))


def test_keeps_away_from_a_wall_beside_it_while_it_searches() -> None:
    left = scan_of(WAFFLE, [Disc(0.0, 50.5, 50.0)])
    assert all(requested(left, count=1, seed=seed).angular < 0.0 for seed in range(10))


def test_a_wall_segment_between_two_robots_is_not_a_robot() -> None:
    gate = [Disc(0.69, 0.2, 0.1), Disc(0.69, -0.2, 0.1)]
    behind = scan_of(WAFFLE, gate, room=4.0)
    assert requested(behind) == requested(scan_of(WAFFLE, gate)) == Twist()


def test_a_wall_segment_within_range_is_not_a_robot() -> None:
    # The wall's foot is 10 mm nearer than the reach, so that only 0.5 m of it are seen.
    wall = [Disc(1002.43, 0.0, 1000.0)]
    scan = scan_of(WAFFLE, wall)
    assert state(scan_of(WAFFLE, [Disc(2.43, 0.0, 0.1)])) == "gather"
    assert [s for _, s in steps(scan, scan, params={"range": 2.5})] == ["search", "search"]


def test_with_few_in_sight_it_rolls_then_leads_then_rests() -> None:
    beside = scan_of(WAFFLE, [BESIDE])
    looks = ["roll", "settled"] * 5 + ["lead", "settled"] * 2
    assert states_on(beside, 300.0) == ["settled", *looks]


def test_its_rest_time_doubles_with_each_try() -> None:
    beside = scan_of(WAFFLE, [BESIDE])
    states = [state for _, state in steps(*[beside] * 1200)]
    rests = [len(list(run)) for state, run in groupby(states) if state == "settled"]
    np.testing.assert_allclose(rests[:4], [5, 10, 20, 40], atol=3)


def test_a_robot_that_sees_all_others_does_not_search() -> None:
    beside = scan_of(WAFFLE, [BESIDE])
    assert states_on(beside, 60.0, heard=1) == ["settled"]
    assert "lead" in states_on(beside, 90.0, heard=2)


def test_it_leads_away_from_the_others() -> None:
    beside = scan_of(WAFFLE, [BESIDE])
    leading = [twist for twist, state in steps(*[beside] * 900) if state == "lead"]
    assert len(leading) > 50
    # It faces the other one and turns round before it drives.
    assert np.mean([abs(twist.angular) for twist in leading]) > 1.0
    assert max(twist.linear for twist in leading) < 0.02


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_rolls_around_the_nearest_and_away_from_the_second(side: float) -> None:
    second = Disc(0.76 * math.cos(1.0), side * 0.76 * math.sin(1.0))
    far = Disc(1.9 * math.cos(0.5), side * 1.9 * math.sin(0.5))
    scan = scan_of(WAFFLE, [BESIDE, second, far])
    rolling = [twist for twist, state in steps(*[scan] * 40) if state == "roll"]
    assert len(rolling) > 20
    assert all(side * twist.angular < -0.5 for twist in rolling)


def test_three_adjacent_robots_are_enough() -> None:
    # One far off draws it between two of them.
    angles = (-1.0, 0.0, 1.0)
    rim = [Disc(0.72 * math.cos(a), 0.72 * math.sin(a)) for a in angles]
    far = Disc(1.9 * math.cos(0.5), 1.9 * math.sin(0.5))
    assert "roll" not in states_on(scan_of(WAFFLE, [*rim, far]), 60.0, heard=6)
    assert "roll" in states_on(scan_of(WAFFLE, [rim[1], rim[2], far]), 60.0, heard=6)


def test_leaves_a_line_early_if_messages_come_from_more_robots() -> None:
    line = scan_of(WAFFLE, [Disc(0.0, 1.2), Disc(0.0, -1.0)])
    assert "roll" in states_on(line, 1.0, heard=6)
    assert "roll" not in states_on(line, 1.0, heard=2)
    corner = scan_of(WAFFLE, [Disc(0.0, 1.2), Disc(1.0, 0.0)])
    assert "roll" not in states_on(corner, 1.0, heard=6)


def test_changed_parameters_apply_to_the_present_scan() -> None:
    scan = scan_of(WAFFLE, [Disc(1.0, 0.0)])
    pattern = Subject(Attraction, WAFFLE, {}).make()
    first = pattern.step(Inputs(0.0, 0.0, scan)).report["state"]
    pattern.update(Subject(Attraction, WAFFLE, {"object_width": 0.05}).make().params)
    assert [first, pattern.step(Inputs(0.1, 0.1, scan)).report["state"]] == ["gather", "search"]


@pytest.mark.parametrize("platform", PLATFORMS)
@pytest.mark.parametrize("seed", range(3))
def test_seven_scattered_robots_gather_and_come_to_rest(platform: str, seed: int) -> None:
    course = gather(platform, scattered(7, 6.0, seed), room=6.0, seconds=60.0, seed=seed)
    assert cluster_count(course.poses[-1]) == 1
    assert spread(course.poses[-1]) < 0.5 * spread(course.poses[0])
    kind = load_platform(platform)
    assert np.abs(course.speeds[-200:]).mean() <= 0.2 * kind.limits.linear
    # The spacing leaves protection inactive: it needs six rays, not one shortened by noise.
    threshold = float(kind.protection["threshold"])
    assert (course.nearest[-200:] < threshold).mean() < 0.1
    assert (course.nearest < threshold).mean() < 0.1


@pytest.mark.parametrize("platform", PLATFORMS)
def test_a_row_folds_up_into_a_cluster(platform: str) -> None:
    row = np.array([[0.0, i, 0.0] for i in range(7)])
    course = gather(platform, row, room=18.0, seconds=60.0, seed=0)
    assert cluster_count(course.poses[-1]) == 1
    # 1.71 m in the row; at best some 0.5 m at this spacing.
    assert spread(course.poses[-1]) < 0.9


def test_a_single_robot_keeps_clear_of_the_walls() -> None:
    course = gather("waffle_pi", scattered(1, 4.0, 1), room=4.0, seconds=120.0, seed=1)
    assert course.nearest.min() > 0.5
    assert np.abs(course.speeds).mean() > 0.1
