"""Fresh rays of mode `barrier`: what segments of a turn show, and what stays without them.

The judge is tests/support/segment_history.py, where each ray has a time and each disc a place.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from swarmd.core.values import ZERO, Array, Odometry, Pose, Scan, Twist
from swarmd.protection.decision import DecisionContext, ModeDecision
from swarmd.protection.footprint import ScanGeometry
from swarmd.sensing.segments import ScanSegment
from tests.support import segment_history
from tests.support.barrier_parts import KERNEL, interpreted
from tests.support.filter_sim import under_barrier
from tests.support.kernel_forms import both_forms, compares_forms
from tests.support.segment_history import OTHERS_SPEED, TRANSPORT, TURN, SegmentHistory, Watched

SECONDS = 3.0
LOOKS = 0.02  # s between two looks
SETTLED = 1.0  # s: odometry and turns have come
# m: the distance between two rays of a degree, the error of odometry between two readings, and the
# way of a disc from one ray to the next
TOLERANCE = 0.005
SEEN_WITHIN = 0.012  # m from a return in which the lidar measured the same place


def watched(*, takes_segments: bool = True) -> Watched:
    barrier = interpreted(segment_history.PLATFORM, others_speed=OTHERS_SPEED, unseen_extent=0.0)
    return Watched(barrier, takes_segments=takes_segments)


def histories(seed: int, lost: float, *, takes_segments: bool = True) -> list[tuple[float, Array]]:
    """The time in s and the near returns (k, 3) at each look."""
    lidar, barrier = SegmentHistory(seed, SECONDS), watched(takes_segments=takes_segments)
    looks, found = iter(np.arange(SETTLED, SECONDS - TURN, LOOKS)), []
    look = next(looks)
    for arrival in lidar.arrivals(lost):
        while arrival.at > look:
            found.append((look, barrier.returns(lidar)))
            look = next(looks, math.inf)
        barrier.take(arrival)
    assert bool(barrier.taken) is takes_segments
    return found


@pytest.mark.parametrize("lost", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_no_return_is_younger_than_a_measurement_of_its_place(seed: int, lost: float) -> None:
    lidar, barrier = SegmentHistory(seed, SECONDS), watched()
    for arrival in lidar.arrivals(lost):
        barrier.take(arrival)
        if arrival.at < SETTLED:
            continue
        measured = np.concatenate(lidar.measured)
        for x, y, at in barrier.returns(lidar)[:: 1 if arrival.kind == "segment" else 9]:
            is_there = np.hypot(measured[:, 1] - x, measured[:, 2] - y) < SEEN_WITHIN
            is_there &= measured[:, 0] <= arrival.at
            assert is_there.any()
            assert at <= measured[is_there, 0].max() + TRANSPORT
    assert barrier.taken


@pytest.mark.parametrize("lost", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_each_disc_is_behind_a_return_or_as_near_as_its_age_allows(seed: int, lost: float) -> None:
    lidar = SegmentHistory(seed, SECONDS)
    for now, returns in histories(seed, lost):
        for place, radius in zip(lidar.discs(now), lidar.radii, strict=True):
            if np.hypot(*(place - lidar.lidar(now))) - radius < 0.8:
                assert uncovered(lidar.lidar(now), place, radius, returns, now) <= TOLERANCE


def uncovered(start: Array, place: Array, radius: float, returns: Array, now: float) -> float:
    """m by which the nearest place of a disc lies before all returns and what they may have moved.

    A return covers what is within its way at OTHERS_SPEED, and what is behind it.
    """
    nearest = place + radius * (start - place) / np.hypot(*(start - place))
    ray = nearest - start
    share = np.clip((returns[:, :2] - start) @ ray / (ray @ ray), 0.0, 1.0)
    off = np.hypot(*(returns[:, :2] - start - share[:, None] * ray).T)
    return float((off - OTHERS_SPEED * (now - returns[:, 2])).min(initial=math.inf))


def test_returns_are_a_third_younger_than_with_whole_turns_alone() -> None:
    ages = {
        takes: np.mean(
            [now - returns[:, 2].mean() for now, returns in histories(3, 0.0, takes_segments=takes)]
        )
        for takes in (True, False)
    }
    assert ages[True] < 0.67 * ages[False]


def test_without_segments_the_returns_of_a_turn_stay_until_the_next() -> None:
    """So the judge sees a difference."""
    with_segments, without = histories(4, 0.0), histories(4, 0.0, takes_segments=False)
    assert any(len(a) != len(b) for (_, a), (_, b) in zip(with_segments, without, strict=True))


@compares_forms
def test_decisions_after_segments_are_the_same_compiled_and_interpreted() -> None:
    lidar = SegmentHistory(5, 2.0)
    settings = under_barrier(segment_history.PLATFORM, others_speed=OTHERS_SPEED)
    forms = [Watched(kernel.Barrier(settings)) for kernel in both_forms(KERNEL)]
    decided = 0
    for arrival in lidar.arrivals(0.2):
        for form in forms:
            form.take(arrival)
        if arrival.at > SETTLED:
            for requested in (Twist(0.22), Twist(-0.22, 1.0), Twist(0.1, -2.0)):
                one, other = (form.decide(requested, arrival.at + 0.01) for form in forms)
                assert one == other
                decided += one.is_active
    assert decided


FAR = 2.0  # m, the ranges of a segment after those of a ring at RING
RING = 0.5
STAMP = 10.0


def with_scan(**changes: Any) -> Any:
    """An interpreted barrier of a platform with another lidar."""
    platform = segment_history.PLATFORM
    platform = replace(platform, scan=replace(platform.scan, **changes))
    return interpreted(platform, others_speed=OTHERS_SPEED, unseen_extent=0.0)


class Ring:
    """A robot that stands in a ring of returns, which then are gone: rays find FAR.

    Rays and returns have the degrees by which the lidar, which turns clockwise, has turned.
    """

    def __init__(self, barrier: Any = None, *, radius: float = RING, ahead: int = 0) -> None:
        """`barrier`: None for an interpreted barrier. `ahead`: the degrees of the ray ahead."""
        self.spec = segment_history.PLATFORM.scan
        self.barrier = barrier or with_scan()
        self._radius, self._ahead = radius, ahead
        self._odometry = Odometry(STAMP, Pose(), ZERO)

    def see(self, *, turns: int = 0, contact: int | None = None) -> None:
        """A whole turn, whose newest ray was measured `turns` after STAMP."""
        ranges, now = np.full(360, self._radius), STAMP + turns * TURN
        if contact is not None:
            ranges[contact] = -math.inf
        ages = TURN / 360 * np.arange(359, -1, -1.0)
        limits = self.spec.range_min, self.spec.range_max
        scan = Scan(turns, now - TURN, ranges, self._bearings(0, 360), *limits, ages, 0.0)
        context = DecisionContext(now, 0.0, self._odometry, now - STAMP)
        self.barrier.observe(scan, ScanGeometry(self.spec), context)

    def segment(
        self,
        number: int,
        *,
        gap: float = 0.0,
        distance: float = FAR,
        lost: Iterable[int] = (),
        turns: int = 0,
        odometry: Odometry | None = None,
    ) -> float:
        """A segment of 45 rays; the time of its newest ray."""
        ranges = np.full(45, distance)
        ranges[[ray - 45 * number for ray in lost]] = 0.0
        ages = TURN / 360 * np.arange(44, -1, -1.0)
        now = STAMP + turns * TURN + TURN / 360 * 45 * (number + 1)
        self._odometry = odometry or self._odometry
        bearings = self._bearings(45 * number, 45 * (number + 1))
        segment = ScanSegment(ranges, bearings, ages, 0.0, gap)
        self.barrier.observe_segment(segment, self._context(now))
        return now

    def decide(self, requested: Twist, now: float) -> ModeDecision:
        """The decision at `now` for a robot that stands."""
        decision: ModeDecision = self.barrier.decide(requested, self._context(now), ZERO, None)
        return decision

    def _context(self, now: float) -> DecisionContext:
        odometry_age = max(now - self._odometry.stamp, 0.0)
        return DecisionContext(now, now - STAMP, self._odometry, odometry_age)

    def _bearings(self, first: int, end: int) -> Array:
        return np.radians(self._ahead - np.arange(first, end))

    @property
    def near(self) -> Any:
        """The near obstacles of an interpreted barrier."""
        return self.barrier._feasible.near

    def stand(self, degrees: Iterable[int]) -> None:
        """Let returns of the ring be on a wall that stands."""
        self.near._walls = SimpleNamespace(has_standing=True)
        for i, turned in self._degrees().items():
            if turned in degrees:
                self.near.points.others[i] = 0.01

    def left(self) -> set[int]:
        """The degrees of the returns of the ring that are left."""
        return {*self._degrees().values()}

    def _degrees(self) -> dict[int, int]:
        """The degrees of the returns of the ring, by their index among the near obstacles."""
        points, lidar = self.near.points, self.spec.offset
        places = [(points.x[i] - lidar[0], points.y[i] - lidar[1]) for i in range(points.count)]
        return {
            i: round(math.degrees(-math.atan2(y, x))) % 360
            for i, (x, y) in enumerate(places)
            if abs(math.hypot(x, y) - self._radius) < 1e-9
        }


def moved(degrees: int, now: float, slack: float) -> float:
    """The degrees that an obstacle of the ring may have moved aside, with `slack` m."""
    age = now - (STAMP - TURN / 360 * (359 - degrees))
    return math.degrees(math.asin((OTHERS_SPEED * age + slack) / RING))


def assert_left(ring: Ring, now: float, first: float, last: float, kept: Array) -> None:
    """Returns that the sweep from `first` to `last` degrees has passed are dropped, and no other.

    `kept`: degrees at which rays tell nothing, whose neighbours stay, too.
    """
    left = ring.left()
    for degrees in range(360):
        for slack in SLACKS:
            aside = moved(degrees, now, slack)
            is_passed = first + aside < degrees < last - aside
            is_passed = is_passed and not (np.abs(kept - degrees) <= aside).any()
            if slack == SLACKS[0] and not is_passed:
                assert degrees in left
            if slack == SLACKS[1] and is_passed:
                assert degrees not in left


NONE = np.empty(0)
SLACKS = 0.015, 0.025  # m below and above the slack of a disc, 0.02 m
UNGUARDED = -90.0  # before the first ray, whose neighbours are fresh, too


def test_a_return_is_dropped_once_the_sweep_has_passed_all_that_it_may_have_become() -> None:
    ring = Ring()
    ring.see()
    now = ring.segment(0)
    assert_left(ring, now, UNGUARDED, 44.0, NONE)
    now = ring.segment(1)
    assert_left(ring, now, UNGUARDED, 89.0, NONE)
    assert ring.left()
    ring.see(turns=1)
    assert len(ring.left()) == 360


def test_each_turn_begins_a_sweep() -> None:
    ring = Ring()
    ring.see()
    ring.segment(0, lost=range(10, 30))
    for turns in range(1, 3):
        ring.see(turns=turns)
        for number in range(7):
            ring.segment(number, turns=turns)
        assert not {*range(300)} & ring.left()
        assert {*range(310, 360)} <= ring.left()


@pytest.mark.parametrize(
    ("way", "segments", "kept", "dropped"),
    [
        ((0.0, -0.12), 3, range(140, 360), range(15, 100)),
        ((0.0, 0.12), 3, range(140, 360), range(15, 100)),
        ((0.12, 0.0), 2, range(70, 360), range(10, 60)),  # the last ray does not reach 85 to 88
    ],
)
def test_a_robot_that_moves_knows_what_its_sweep_has_passed(
    way: tuple[float, float], segments: int, kept: range, dropped: range
) -> None:
    """The directions to a return differ at the first and at the last ray."""
    ring = Ring()
    ring.see()
    for number in range(segments):
        stamp, share = STAMP + TURN / 8 * (number + 1), (number + 1) / segments
        pose = Pose(way[0] * share, way[1] * share)
        ring.segment(number, odometry=Odometry(stamp, pose, ZERO))
    assert {*kept} <= ring.left()
    assert not {*dropped} & ring.left()


def test_after_a_missing_segment_its_neighbours_stay() -> None:
    ring = Ring()
    ring.see()
    now = ring.segment(1, gap=math.inf)
    assert_left(ring, now, 45.0, 89.0, NONE)
    now = ring.segment(3, gap=math.inf)
    assert {*range(90, 136)} <= ring.left()
    assert not {155, 156} & ring.left()


@pytest.mark.parametrize("count", [7, 10])
def test_a_wide_run_of_lost_rays_keeps_what_may_hide_in_it(count: int) -> None:
    ring = Ring()
    ring.see()
    ring.segment(0)
    lost = range(55, 55 + count)
    now = ring.segment(1, lost=lost)
    assert_left(ring, now, UNGUARDED, 89.0, np.array(lost))


def test_lost_rays_before_the_first_return_keep_what_may_hide_in_them() -> None:
    ring = Ring()
    for turns in range(2):
        ring.see(turns=turns)
        ring.segment(0, turns=turns, lost=range(4))
        assert {*range(10)} <= ring.left()
        assert not {*range(15, 30)} & ring.left()


def test_a_lost_packet_keeps_its_own_returns_alone() -> None:
    """And those within 0.01 m of its rays; the returns of the ring are 0.0087 m apart."""
    ring = Ring()
    ring.see()
    ring.segment(0)
    ring.segment(1, lost=[*range(50, 56), *range(62, 66)])
    assert {*range(40, 70)} & ring.left() == {*range(49, 57), *range(61, 67)}


@pytest.mark.parametrize(
    ("distance", "range_min"),
    [(0.0, 0.05), (0.0, 0.0), (0.04, 0.05), (3.6, 0.05), (math.inf, 0.05), (math.nan, 0.05)],
)
def test_rays_without_a_range_that_the_lidar_measures_tell_nothing(
    distance: float, range_min: float
) -> None:
    ring = Ring(with_scan(range_min=range_min))
    ring.see()
    ring.segment(0, distance=distance)
    assert len(ring.left()) == ring.near.points.count == 360


def test_contacts_and_standing_returns_stay() -> None:
    ring = Ring()
    ring.see(contact=10)
    ring.stand([20])
    near = ring.near
    contacts = int((np.array(near.points.gap[: near.points.count]) == 0.0).sum())
    ring.segment(0)
    assert contacts == near.contacts == 1
    assert near.points.gap[: near.points.count].count(0.0) == 1
    assert 20 in ring.left()
    assert 23 not in ring.left()


def test_rays_that_hit_a_standing_wall_tell_nothing() -> None:
    """A fresh return is charged more than the wall at the same place."""
    ring = Ring()
    ring.see()
    ring.stand(range(360))
    ring.segment(0, distance=RING + 0.09)
    assert ring.near.points.count == 360
    ring.segment(1, distance=RING - 0.11)  # before the wall
    assert ring.near.points.count == 360 + 45


def test_rays_beside_a_standing_wall_count() -> None:
    """Those from 30 degrees on are farther than 0.1 m from the wall."""
    ring = Ring()
    ring.see()
    ring.stand(range(20))
    ring.segment(0, distance=RING + 0.03)
    assert ring.near.points.count - len(ring.left()) == 15


@pytest.mark.parametrize(("radius", "are_left"), [(0.065, True), (0.075, False)])
def test_returns_as_near_as_hidden_obstacles_stay(radius: float, are_left: bool) -> None:
    """The lidar measures 0.05 m at least; 0.02 m are the slack."""
    barrier = interpreted(segment_history.PLATFORM, others_speed=0.01, unseen_extent=0.0)
    ring = Ring(barrier, radius=radius)
    ring.see()
    for number in range(3):
        ring.segment(number)
    assert bool({*range(60, 70)} & ring.left()) is are_left


def test_returns_that_may_have_reached_the_lidar_stay() -> None:
    ring = Ring(radius=0.09)
    ring.see()
    for number in range(3):
        ring.segment(number)
    assert {*range(30)} <= ring.left()


def test_the_returns_of_a_segment_have_the_place_gap_and_age_of_their_rays() -> None:
    """The robot drives 0.1 m ahead during the segment."""
    ring, distance = Ring(), 0.4
    ring.see()
    ring.segment(0, distance=distance, odometry=Odometry(STAMP + TURN / 8, Pose(0.1), ZERO))
    points = ring.near.points
    rows = [
        (-points.age[i], points.x[i], points.y[i], points.gap[i])
        for i in range(points.count)
        if points.age[i] < 0.0
    ]
    share, bearings = np.arange(1, 46) / 45, -np.radians(np.arange(45))
    x, y = ring.spec.offset[0] + distance * np.cos(bearings), distance * np.sin(bearings)
    front, left = segment_history.PLATFORM.footprint.max(axis=0)
    gaps = np.hypot(np.maximum(x - front, 0.0), np.maximum(np.abs(y) - left, 0.0))
    expected = np.column_stack((share * TURN / 8, x + 0.1 * share, y, gaps))
    assert np.array(sorted(rows)) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("distance", "count", "is_near"), [(FAR, 0, False), (0.9, 45, False), (0.5, 45, True)]
)
def test_near_returns_of_a_segment_constrain_the_robot(
    distance: float, count: int, is_near: bool
) -> None:
    ring = Ring(radius=1.0)
    ring.see()
    ring.segment(0, distance=distance)
    assert ring.near.points.count - len(ring.left()) == count
    assert ring.near.is_near is is_near


def test_the_returns_of_a_sweep_stay() -> None:
    ring = Ring()
    ring.see()
    for number in range(3):
        ring.segment(number, distance=0.4)
        points = ring.near.points
        assert sum(points.age[i] < 0.0 for i in range(points.count)) == 45 * (number + 1)


@pytest.mark.parametrize(("gap", "is_continued"), [(0.03, True), (0.04, False)])
def test_a_gap_in_which_obstacles_move_little_does_not_end_the_sweep(
    gap: float, is_continued: bool
) -> None:
    ring = Ring()
    ring.see()
    ring.segment(0)
    ring.segment(1, gap=gap)
    assert (40 not in ring.left()) is is_continued


def test_a_sweep_of_nearly_a_turn_drops_no_more() -> None:
    ring = Ring()
    ring.see()
    for number in range(7):
        ring.segment(number)
    left = ring.left()
    ring.segment(7)
    assert ring.left() == left


def test_a_turn_of_the_robot_against_the_sweep_adds_no_turn_to_the_sweep() -> None:
    ring = Ring()
    ring.see()
    ring.segment(0)
    ring.segment(0, odometry=Odometry(STAMP + 0.02, Pose(0.0, 0.0, 1e-9), ZERO))
    ring.segment(1)
    assert 60 not in ring.left()


def test_segments_before_the_first_turn_are_ignored() -> None:
    ring = Ring()
    ring.segment(0, distance=0.06)
    assert ring.near.points.count == 0


def test_segments_of_a_lidar_without_a_sweep_are_ignored() -> None:
    ring = Ring(with_scan(sweep=None))
    ring.see()
    ring.segment(0)
    assert len(ring.left()) == 360


def test_after_a_reset_of_odometry_segments_wait_for_a_turn() -> None:
    ring = Ring()
    ring.see()
    ring.segment(0, odometry=Odometry(STAMP - 5.0, Pose(), ZERO))
    assert len(ring.left()) == 360


@compares_forms
@pytest.mark.parametrize(
    "segments",
    [
        [{"number": 0}, {"number": 1}],
        [{"number": 1, "gap": math.inf}, {"number": 3, "gap": math.inf}],
        [{"number": 0}, {"number": 1, "lost": range(50, 56)}],
        [{"number": 0}, {"number": 1, "lost": range(55, 65)}],
        [{"number": 0}, {"number": 1, "odometry": Odometry(STAMP + 0.05, Pose(0.1), ZERO)}],
        [{"number": 0, "odometry": Odometry(STAMP - 5.0, Pose(), ZERO)}],
    ],
)
def test_both_forms_decide_alike_after_each_segment(segments: list[dict[str, Any]]) -> None:
    settings = under_barrier(segment_history.PLATFORM, others_speed=OTHERS_SPEED, unseen_extent=0.0)
    speeds = []
    for ahead in range(0, 100, 10):
        rings = [
            Ring(kernel.Barrier(settings), radius=0.3, ahead=ahead) for kernel in both_forms(KERNEL)
        ]
        for ring in rings:
            ring.see()
        for segment in segments:
            decisions = [ring.decide(Twist(0.22), ring.segment(**segment)) for ring in rings]
            assert decisions[0] == decisions[1]
            speeds.append(decisions[0].twist.linear)
    assert min(speeds) < 0.2
