"""Fresh rays of mode `barrier`: what segments of a turn show, and what stays without them.

The judge is tests/support/segment_history.py, where each ray has a time and each disc a place.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from swarmd.core.values import ZERO, Array, Odometry, Pose, Scan, Twist
from swarmd.protection.decision import DecisionContext
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


class Ring:
    """A robot that stands in a ring of returns, which then are gone: rays find FAR.

    Rays and returns have the degrees by which the lidar, which turns clockwise, has turned.
    """

    def __init__(self) -> None:
        self.spec = segment_history.PLATFORM.scan
        self.barrier = interpreted(
            segment_history.PLATFORM, others_speed=OTHERS_SPEED, unseen_extent=0.0
        )
        self._odometry = Odometry(STAMP, Pose(), ZERO)

    def see(self, *, turns: int = 0, contact: int | None = None) -> None:
        """A whole turn, whose newest ray was measured `turns` after STAMP."""
        ranges, now = np.full(360, RING), STAMP + turns * TURN
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
        lost: range = range(0),
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
        odometry_age = max(now - self._odometry.stamp, 0.0)
        context = DecisionContext(now, now - STAMP, self._odometry, odometry_age)
        self.barrier.observe_segment(ScanSegment(ranges, bearings, ages, 0.0, gap), context)
        return now

    def _bearings(self, first: int, end: int) -> Array:
        return -np.radians(np.arange(first, end))

    def left(self) -> set[int]:
        """The degrees of the returns of the ring that are left."""
        points, lidar = self.barrier._feasible.near.points, self.spec.offset
        places = [(points.x[i] - lidar[0], points.y[i] - lidar[1]) for i in range(points.count)]
        turned = {
            round(math.degrees(-math.atan2(y, x))) % 360
            for x, y in places
            if abs(math.hypot(x, y) - RING) < 1e-9
        }
        return turned


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
        for slack in (0.0, 0.03):
            aside = moved(degrees, now, slack)
            is_passed = first + aside < degrees < last - aside
            is_passed = is_passed and not (np.abs(kept - degrees) <= aside).any()
            if slack == 0.0 and not is_passed:
                assert degrees in left
            if slack > 0.0 and is_passed:
                assert degrees not in left


NONE = np.empty(0)
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
    for turns in range(2):
        ring.see(turns=turns)
        for number in range(7):
            ring.segment(number, turns=turns)
        assert not {*range(300)} & ring.left()
        assert {*range(310, 360)} <= ring.left()


@pytest.mark.parametrize("aside", [-0.12, 0.12])
def test_a_robot_that_moves_knows_what_its_sweep_has_passed(aside: float) -> None:
    """The directions to a return differ at the first and at the last ray."""
    ring = Ring()
    ring.see()
    for number in range(3):
        stamp = STAMP + TURN / 8 * (number + 1)
        pose = Pose(0.0, aside / 3 * (number + 1))
        ring.segment(number, odometry=Odometry(stamp, pose, ZERO))
    assert {*range(140, 360)} <= ring.left()
    assert not {*range(15, 100)} & ring.left()


def test_after_a_missing_segment_its_neighbours_stay() -> None:
    ring = Ring()
    ring.see()
    now = ring.segment(1, gap=math.inf)
    assert_left(ring, now, 45.0, 89.0, NONE)
    now = ring.segment(3, gap=math.inf)
    assert {*range(90, 136)} <= ring.left()
    assert not {155, 156} & ring.left()


def test_a_wide_run_of_lost_rays_keeps_what_may_hide_in_it() -> None:
    ring = Ring()
    ring.see()
    ring.segment(0)
    now = ring.segment(1, lost=range(55, 65))
    assert_left(ring, now, UNGUARDED, 89.0, np.arange(55.0, 65.0))


def test_a_lost_packet_keeps_its_own_returns_alone() -> None:
    ring = Ring()
    ring.see()
    ring.segment(0)
    ring.segment(1, lost=range(50, 56))
    assert {*range(50, 56)} <= ring.left()
    assert not ({*range(40, 48), *range(58, 65)} & ring.left())


def test_contacts_and_standing_returns_stay() -> None:
    ring = Ring()
    ring.see(contact=10)
    near = ring.barrier._feasible.near
    near._walls = SimpleNamespace(has_standing=True)
    contacts = int((np.array(near.points.gap[: near.points.count]) == 0.0).sum())
    standing = next(
        i
        for i in range(near.points.count)
        if abs(near.points.y[i] + RING * math.sin(math.radians(20))) < 1e-9
    )
    near.points.others[standing] = 0.01
    ring.segment(0)
    assert contacts == near.contacts == 1
    assert near.points.gap[: near.points.count].count(0.0) == 1
    assert 20 in ring.left()
    assert 23 not in ring.left()


def test_rays_that_hit_a_standing_wall_tell_nothing() -> None:
    """A fresh return is charged more than the wall at the same place."""
    ring = Ring()
    ring.see()
    near = ring.barrier._feasible.near
    near._walls = SimpleNamespace(has_standing=True)
    for i in range(near.points.count):
        near.points.others[i] = 0.01
    before = near.points.count
    ring.segment(0, distance=RING + 0.02)
    assert near.points.count == before
    ring.segment(1, distance=RING - 0.2)  # before the wall
    assert near.points.count == before + 45


def test_after_a_reset_of_odometry_segments_wait_for_a_turn() -> None:
    ring = Ring()
    ring.see()
    ring.segment(0, odometry=Odometry(STAMP - 5.0, Pose(), ZERO))
    assert len(ring.left()) == 360
