"""Attraction: one step at a time, and seven robots on paper."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from swarmd.patterns.attraction import Attraction
from swarmd.settings import load_platform
from swarmd.testing.flatland import Course, Flatland
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_from, scan_of
from swarmd.values import Array, Inputs, Scan, Twist, Value

WAFFLE = load_platform("waffle_pi")
PLATFORMS = ("burger", "waffle_pi")


class TestAttraction(PatternContract):
    pattern = Attraction


class TestAttractionOfThePaper(PatternContract):
    pattern = Attraction
    # Alone it spins to one side, which no mirror would.
    params = {"law": "paper", "angular_if_alone": 0.0}  # noqa: RUF012 - read only


def wish(scan: Scan, *, steps: int = 2, **params: Value) -> Twist:
    """The wish after some steps at 10 Hz on one scan."""
    pattern = Subject(Attraction, WAFFLE, params).make()
    inputs = (Inputs(now=0.1 * i, dt=0.1, scan=scan) for i in range(steps))
    twist = [pattern.step(i) for i in inputs][-1].twist
    assert twist is not None
    return twist


def state(scan: Scan, *, steps: int = 2, **params: Value) -> object:
    pattern = Subject(Attraction, WAFFLE, params).make()
    inputs = (Inputs(now=0.1 * i, dt=0.1, scan=scan) for i in range(steps))
    return [pattern.step(i) for i in inputs][-1].report["state"]


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
    left = set(range(len(poses)))
    count = 0
    while left:
        count += 1
        grown = [left.pop()]
        while grown:
            here = poses[grown.pop(), :2]
            near = {i for i in left if math.dist(here, poses[i, :2]) <= link}
            left -= near
            grown.extend(near)
    return count


def spread(poses: Array) -> float:
    """Mean distance to the centroid."""
    return float(np.hypot(*(poses[:, :2] - poses[:, :2].mean(axis=0)).T).mean())


def test_drives_towards_a_robot_ahead() -> None:
    twist = wish(scan_of(WAFFLE, [Disc(2.0, 0.0)]))
    assert twist.linear > 0.25
    assert abs(twist.angular) < 0.1


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_turns_towards_a_robot_beside_without_driving(side: float) -> None:
    twist = wish(scan_of(WAFFLE, [Disc(0.0, 2.0 * side)]))
    assert twist.linear == pytest.approx(0.0, abs=0.01)
    assert twist.angular * side > 1.0


def test_turns_round_for_a_robot_behind_instead_of_backing() -> None:
    twist = wish(scan_of(WAFFLE, [Disc(-2.0, 0.1)]))
    assert twist.linear == 0.0
    assert abs(twist.angular) > 1.0


def test_slows_down_as_it_comes_near() -> None:
    speeds = [wish(scan_of(WAFFLE, [Disc(x, 0.0)])).linear for x in (2.0, 1.2, 1.05)]
    assert speeds[0] > speeds[1] > speeds[2] > 0.0


def test_stands_at_its_spacing() -> None:
    # The nearest point of a disc at 0.85 m is 0.75 m from the axle; the spacing is 0.714 m.
    scan = scan_of(WAFFLE, [Disc(0.85, 0.0)])
    assert wish(scan) == Twist()
    assert state(scan) == "settled"


def test_gives_way_to_what_comes_too_near_by_backing() -> None:
    scan = scan_of(WAFFLE, [Disc(0.6, 0.0), Disc(-2.5, 0.0)])
    assert wish(scan, steps=3).linear <= 0.0


def test_stands_between_two_robots_at_equal_distance() -> None:
    assert wish(scan_of(WAFFLE, [Disc(1.5, 0.0), Disc(-1.5, 0.0)], noise=0.01)) == Twist()


@pytest.mark.parametrize("room", [3.0, 4.0, 5.0])
def test_is_not_drawn_to_walls(room: float) -> None:
    """One robot far to the left outweighs four walls, wherever those are."""
    pose = scan_of(WAFFLE, room=room)
    assert state(pose) == "search"
    twist = wish(scan_of(WAFFLE, [Disc(0.0, 0.5 * room - 0.25, 0.06)], room=room))
    assert twist.angular > 0.5


def test_the_law_of_the_paper_is_drawn_to_the_wall() -> None:
    """What the settling law is for: seven robots ahead lose against a wall behind."""
    discs = [Disc(1.8, y, 0.05) for y in (-0.6, -0.2, 0.2, 0.6)]
    scan = scan_of(WAFFLE, discs, room=3.9)
    assert wish(scan, law="paper").linear < 0.0
    assert wish(scan).linear >= 0.0


def test_searches_when_it_sees_nobody() -> None:
    free = scan_of(WAFFLE)
    assert state(free) == "search"
    assert wish(free).linear > 0.2


def test_does_not_press_against_the_wall_while_it_searches() -> None:
    near = scan_of(WAFFLE, room=1.3)
    assert all(wish(near, steps=n).linear < 0.05 for n in range(1, 20))


def test_steps_aside_when_it_has_stood_long_with_few_in_sight() -> None:
    beside = scan_of(WAFFLE, [Disc(0.85, 0.0)])
    assert state(beside, steps=28) == "settled"
    assert state(beside, steps=40) == "sidestep"
    assert state(beside, steps=75) == "settled"


def test_stands_still_for_good_among_many() -> None:
    ring = [Disc(0.85 * math.cos(a), 0.85 * math.sin(a)) for a in (0.0, 2.0, 4.0)]
    scan = scan_of(WAFFLE, ring)
    assert all(state(scan, steps=n) == "settled" for n in (2, 40, 200))


@pytest.mark.parametrize(
    ("ranges", "bearings"),
    [
        ([1.0, 1.0, 1.0], [0.5, 0.4, 0.3]),
        ([1.5, 0.5, 1.9], [3.0, -1.0, 0.2]),
        ([1.5, 1.5], [math.pi / 2, math.pi / 2]),
    ],
)
def test_the_law_of_the_paper_is_its_equations(
    ranges: Sequence[float], bearings: Sequence[float]
) -> None:
    # Weights r / 2 m, the bias of -1 along x, full speed along the sum.
    x = sum(r / 2.0 * math.cos(b) for r, b in zip(ranges, bearings, strict=True)) - 1.0
    y = sum(r / 2.0 * math.sin(b) for r, b in zip(ranges, bearings, strict=True))
    length = math.hypot(x, y)
    twist = wish(scan_from(WAFFLE, np.array(ranges), np.array(bearings)), law="paper")
    assert twist.linear == pytest.approx(0.26 * x / length)
    assert twist.angular == pytest.approx(1.82 * math.asin(y / length))


def test_the_law_of_the_paper_spins_when_alone() -> None:
    one_ray = scan_from(WAFFLE, np.array([1.0, math.inf]), np.array([0.0, 1.0]))
    assert wish(one_ray, law="paper") == Twist(angular=1.0)


@pytest.mark.parametrize("platform", PLATFORMS)
@pytest.mark.parametrize("seed", range(3))
def test_seven_scattered_robots_gather_and_come_to_rest(platform: str, seed: int) -> None:
    course = gather(platform, scattered(7, 6.0, seed), room=6.0, seconds=60.0, seed=seed)
    assert cluster_count(course.poses[-1]) == 1
    assert spread(course.poses[-1]) < 0.5 * spread(course.poses[0])
    limit = load_platform(platform).limits.linear
    assert np.abs(course.speeds[-200:]).mean() <= 0.2 * limit


@pytest.mark.parametrize("platform", PLATFORMS)
def test_a_row_folds_up_into_a_cluster(platform: str) -> None:
    row = np.array([[0.0, i, 0.0] for i in range(7)])
    course = gather(platform, row, room=18.0, seconds=60.0, seed=0)
    assert cluster_count(course.poses[-1]) == 1
    # 1.71 m in the row; at best some 0.6 m at this spacing.
    assert spread(course.poses[-1]) < 0.9


@pytest.mark.parametrize("platform", PLATFORMS)
def test_the_spacing_leaves_protection_inactive(platform: str) -> None:
    course = gather(platform, scattered(7, 6.0, 5), room=6.0, seconds=60.0, seed=5)
    threshold = float(load_platform(platform).protection["threshold"])
    assert course.nearest[-200:].min() > threshold
    assert (course.nearest < threshold).mean() < 0.02


def test_a_single_robot_keeps_clear_of_the_walls() -> None:
    course = gather("waffle_pi", scattered(1, 4.0, 1), room=4.0, seconds=120.0, seed=1)
    assert course.nearest.min() > 0.5
    assert np.abs(course.speeds).mean() > 0.1
