"""Openings in walls: where they are found, and the same compiled and interpreted."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray

from swarmd.core.values import Pose, Scan
from swarmd.robot.steering.openings import Openings
from tests.support.examples import examples
from tests.support.kernel_forms import both_forms, compares_forms

BEARINGS = np.radians(np.arange(-180.0, 180.0))
HALF, BODY = 0.18, 0.09  # m, of a door in the middle of a wall at x = 0, and of a robot
NEAR = Pose(-0.8, 0.1, 0.2)
MOVES = st.floats(-0.3, 0.3)


def scan(
    pose: Pose,
    noise: float = 0.0,
    lost: float = 0.0,
    seed: int = 0,
    half: float = HALF,
    wall: tuple[float, float] = (2.0, 2.0),
) -> Scan:
    """What a lidar sees of a wall with a door, and of what is 3 m away.

    `half`: m, of the door. `wall`: m from the middle of the door to the left and right end.
    """
    rng = np.random.default_rng(seed)
    angles = BEARINGS + pose.yaw
    with np.errstate(divide="ignore"):
        ranges = -pose.x / np.cos(angles)
    y = pose.y + ranges * np.sin(angles)
    is_wall = (ranges > 0.0) & (np.abs(y) > half) & (y < wall[0]) & (y > -wall[1])
    ranges = np.where(is_wall, np.minimum(ranges, 3.0), 3.0) + rng.normal(0.0, noise, len(angles))
    ranges[rng.random(len(angles)) < lost] = np.inf
    return Scan(0, 0.0, ranges, BEARINGS, 0.1, 3.5)


def known(openings: Openings) -> list[tuple[float, ...]]:
    return [
        (
            one.x,
            one.y,
            one.angle,
            one.half,
            *one.ends(1.0),
            one.left,
            one.right,
            one.hits,
            one.seen_at,
        )
        for one in openings.known
    ]


def test_a_door_is_measured() -> None:
    openings = Openings(BODY)
    openings.observe(scan(NEAR), (0.0, 0.0), NEAR, 0.0, (), None)
    ((x, y, angle, half, first, last, left, right, hits, at),) = known(openings)
    assert (x, y) == pytest.approx((0.0, 0.0), abs=0.02)  # a ray is 1.4 cm from the next one
    assert abs(np.cos(angle)) == pytest.approx(1.0, abs=1e-3)
    assert half == pytest.approx(HALF, abs=0.02)
    assert (first, last) == pytest.approx((0.0, 0.0), abs=0.02)
    assert (left, right) == pytest.approx((2.0, 2.0), abs=0.15)
    assert (hits, at) == (1, 0.0)


@pytest.mark.parametrize(
    ("body", "tracks"),
    [(0.2, ()), (BODY, ((0.0, HALF + 0.02, 0.1), (0.0, -HALF - 0.02, 0.1)))],
    ids=["too narrow", "between two moving objects"],
)
def test_other_gaps_are_no_openings(body: float, tracks: tuple[tuple[float, ...], ...]) -> None:
    openings = Openings(body)
    openings.observe(scan(NEAR), (0.0, 0.0), NEAR, 0.0, tracks, None)
    assert known(openings) == []


@pytest.mark.parametrize(
    ("half", "wall", "count"),
    [
        (0.115, (2.0, 2.0), 0),  # 1.5 times the width of the robot is 0.27 m
        (0.155, (2.0, 2.0), 1),
        (0.46, (2.0, 2.0), 1),
        (0.54, (2.0, 2.0), 0),
        (HALF, (HALF + 0.3, HALF + 0.3), 1),
        (HALF, (HALF + 0.1, HALF + 0.3), 0),
        (HALF, (HALF + 0.3, HALF + 0.1), 0),
    ],
)
def test_the_bounds_of_an_opening(half: float, wall: tuple[float, float], count: int) -> None:
    openings = Openings(BODY)
    pose = Pose(-0.8)
    openings.observe(scan(pose, half=half, wall=wall), (0.0, 0.0), pose, 0.0, (), None)
    assert len(known(openings)) == count


@pytest.mark.parametrize(("sightings", "seconds"), [(1, 5.0), (2, 120.0)])
def test_how_long_an_opening_is_remembered(sightings: int, seconds: float) -> None:
    for after, count in ((0.8 * seconds, 1), (1.2 * seconds, 0)):
        openings = Openings(BODY)
        for _ in range(sightings):
            openings.observe(scan(NEAR), (0.0, 0.0), NEAR, 0.0, (), None)
        openings.observe(scan(Pose(-5.0)), (0.0, 0.0), NEAR, after, (), None)
        assert len(known(openings)) == count


@pytest.mark.parametrize(
    ("told", "half", "count"),
    [
        (Pose(-0.8, 0.08), HALF, 1),
        (Pose(-0.8, 0.2), HALF, 2),
        (Pose(-0.65), HALF, 1),
        (Pose(-0.5), HALF, 2),
        (Pose(-0.8 * math.cos(0.3), -0.8 * math.sin(0.3), 0.3), HALF, 1),
        (Pose(-0.8 * math.cos(0.5), -0.8 * math.sin(0.5), 0.5), HALF, 2),
        (Pose(-0.8), HALF + 0.05, 1),
        (Pose(-0.8), HALF + 0.12, 2),
    ],
    ids=["8 cm", "20 cm", "15 cm on", "30 cm on", "0.3 rad", "0.5 rad", "wider", "much wider"],
)
def test_which_sightings_are_of_one_opening(told: Pose, half: float, count: int) -> None:
    """The second sighting is told from another pose, or shows another width."""
    openings, pose = Openings(BODY), Pose(-0.8)
    openings.observe(scan(pose), (0.0, 0.0), pose, 0.0, (), None)
    openings.observe(scan(pose, half=half), (0.0, 0.0), told, 0.1, (), None)
    assert len(known(openings)) == count


def test_an_opening_is_seen_within_2_5_m() -> None:
    for x, count in ((-2.2, 1), (-2.6, 0)):
        openings, pose = Openings(BODY), Pose(x)
        openings.observe(scan(pose, half=0.3), (0.0, 0.0), pose, 0.0, (), None)
        assert len(known(openings)) == count


def test_an_opening_that_is_not_seen_again_is_forgotten_unless_it_is_kept() -> None:
    openings = Openings(BODY)
    openings.observe(scan(NEAR), (0.0, 0.0), NEAR, 0.0, (), None)
    (one,) = openings.known
    nothing = scan(Pose(-5.0))
    openings.observe(nothing, (0.0, 0.0), NEAR, 100.0, (), one)
    assert openings.known == [one]
    openings.observe(nothing, (0.0, 0.0), NEAR, 100.0, (), None)
    assert openings.known == []


@pytest.mark.parametrize(
    "order",
    [np.roll(np.arange(360), 100), np.random.default_rng(1).permutation(360)],
    ids=["rotated", "in any order"],
)
def test_the_order_of_rays_does_not_matter(order: NDArray[np.intp]) -> None:
    in_order, other = Openings(BODY), Openings(BODY)
    seen = scan(NEAR, noise=0.01, lost=0.1)
    in_order.observe(seen, (0.0, 0.0), NEAR, 0.0, (), None)
    mixed = replace(seen, ranges=seen.ranges[order], bearings=seen.bearings[order])
    other.observe(mixed, (0.0, 0.0), NEAR, 0.0, (), None)
    assert known(other) == known(in_order) != []


@pytest.mark.parametrize("form", both_forms("swarmd.robot.steering.openings"))
@given(
    points=st.lists(st.tuples(MOVES, MOVES), max_size=12), along=MOVES, aside=MOVES, heading=MOVES
)
@example(  # of two gaps the one whose middle, 0.09, is nearer to 0.02 than -0.075
    points=[(0.0, -0.14), (0.0, -0.01), (0.0, 0.19)], along=0.0, aside=0.0, heading=0.0
)
@settings(max_examples=examples(30))
def test_the_middle_of_a_gap(
    form: Any, points: list[tuple[float, float]], along: float, aside: float, heading: float
) -> None:
    table = np.array(points).reshape(-1, 2)
    x, y = table.T
    cos, sin = math.cos(heading), math.sin(heading)
    is_in = np.abs(along + cos * x - sin * y) < 0.2
    sides = np.sort((aside + sin * x + cos * y)[is_in])
    middles = 0.5 * (sides[1:] + sides[:-1])[np.abs(np.diff(sides) - 0.2) < 0.08]
    middles = middles[np.abs(middles) < 0.15]
    expected = middles[np.abs(middles - 0.02).argmin()] if len(middles) else None
    place = along, aside, heading
    assert form.gap_middle(table, place, (-0.2, 0.2), (0.2, 0.08), (0.02, 0.15)) == expected


@compares_forms
@given(
    st.lists(st.tuples(MOVES, MOVES, MOVES), min_size=1, max_size=5),
    st.floats(0.0, 0.03),
    st.floats(0.0, 0.3),
    st.lists(st.tuples(MOVES, MOVES, st.floats(0.05, 0.2)), max_size=3),
)
@settings(max_examples=examples(30))
def test_any_scans_give_the_same_compiled_and_interpreted(
    moves: list[tuple[float, float, float]],
    noise: float,
    lost: float,
    tracks: list[tuple[float, float, float]],
) -> None:
    both = [kernel.Openings(BODY) for kernel in both_forms("swarmd.robot.steering.openings")]
    for seed, (dx, dy, turn) in enumerate(moves):
        pose = Pose(NEAR.x + dx, NEAR.y + dy, NEAR.yaw + turn)
        for one in both:
            one.observe(
                scan(pose, noise, lost, seed), (-0.03, 0.0), pose, 0.2 * seed, tuple(tracks), None
            )
        assert known(both[0]) == known(both[1])
