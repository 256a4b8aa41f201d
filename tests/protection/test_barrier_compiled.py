"""Mode `barrier` decides alike compiled and interpreted, for every input."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.kernels import load_kernel
from swarmd.core.values import ZERO, Limits, Odometry, Platform, Pose, Scan, TouchZone, Twist
from swarmd.protection import barrier as interpreted
from swarmd.protection.decision import DecisionContext, ModeDecision, ToldObstacle
from swarmd.protection.footprint import Footprint, ScanGeometry
from swarmd.settings.platforms import load_platform
from swarmd.settings.settings import platform_names
from swarmd.testing.scans import scan_from
from tests.support.decision_corpus import Stream, decided, platform_of, read
from tests.support.examples import examples
from tests.support.filter_sim import under_barrier

compiled = load_kernel("swarmd.protection.barrier")
needs_compiled = pytest.mark.skipif(compiled is interpreted, reason="the kernels are not compiled")

AGREEMENT = 1e-12
GIVEN = [load_platform(name) for name in sorted(platform_names())]
PLATFORMS = [under_barrier(one) for one in GIVEN if one.protection["barrier"] is not None]
BY_NAME = {platform.name: platform for platform in PLATFORMS}
BURGER, WAFFLE, JACKAL = (BY_NAME[name] for name in ("burger", "waffle_pi", "jackal"))
SIDEWAYS = Limits(0.22, 2.84, 0.2)
HEXAGON = np.array([[0.1, -0.1], [0.2, 0.0], [0.1, 0.1], [-0.1, 0.12], [-0.2, 0.0], [-0.1, -0.1]])
REPORTING = replace(JACKAL.scan, near="reported")
VARIANTS = [
    *PLATFORMS,
    under_barrier(BURGER, responsibility="reciprocal"),
    under_barrier(WAFFLE, responsibility="reciprocal", unseen_extent=0.0, surface_speed=0.3),
    under_barrier(WAFFLE, keep_out=0.5),
    under_barrier(JACKAL, keep_out=None, envelope_within=0.2),
    under_barrier(replace(JACKAL, scan=REPORTING), unseen_extent=0.0),
    under_barrier(replace(BURGER, limits=SIDEWAYS)),
    under_barrier(replace(JACKAL, limits=SIDEWAYS, footprint=HEXAGON), keep_out=0.9),
    under_barrier(BURGER, others_speed=0.001, surface_speed=5.0, unseen_extent=0.0),
]


class Face(NamedTuple):
    """Returns of neighbouring rays: the first and the number of rays in shares, m and slope."""

    first: float
    width: float
    beyond: float  # m beyond range_min; negative: too close to measure
    slope: float


class Seen(NamedTuple):
    """A scan arrives: what it shows, its age, s of the sensor's sweep (0: none), s of delay."""

    faces: list[Face]
    age: float
    sweep: float = 0.0
    delay: float = 0.0


class Moved(NamedTuple):
    """A reading of odometry arrives: its stamp relative to the time, shares, and m of a jump."""

    late: float
    ahead: float
    turn: float
    aside: float
    jump: float = 0.0


class Asked(NamedTuple):
    """A decision is asked for: time since the last one, requests as shares, zone, odometry's age.

    The odometry is the latest, the one before it, or none. `told`: obstacles from others.
    """

    after: float
    requests: list[tuple[float, float, float]]
    touch: TouchZone | None
    age: float | None
    which: int | None
    told: tuple[ToldObstacle, ...] = ()


SHARE = st.one_of(st.floats(-1, 1), st.sampled_from([-1.0, 0.0, 1.0]))
FACE = st.builds(
    Face,
    st.floats(0, 1),
    st.one_of(st.just(0.0), st.floats(0, 0.3)),
    st.one_of(st.floats(0, 0.3), st.floats(0, 2.5), st.just(-1.0)),
    st.sampled_from([0.0, 0.0, 0.01, -0.02]),
)
SEEN = st.builds(
    Seen,
    st.lists(FACE, max_size=6),
    st.sampled_from([0.0, 0.0, 0.0, 0.1, 0.35]),
    st.sampled_from([0.0, 0.0, 0.05, 0.2, 0.7]),
    st.sampled_from([0.0, 0.0, 0.1]),
)
LATE, JUMP = st.sampled_from([0.0, 0.0, 0.02, 0.2, 5.0]), st.sampled_from([0.0, 0.0, 0.0, 3.0])
MOVED = st.builds(Moved, LATE, SHARE, SHARE, SHARE, JUMP)
TOUCH = st.one_of(
    st.none(),
    st.none(),
    st.builds(TouchZone, st.floats(-3.2, 3.2), st.floats(0.05, 1.04), st.floats(0.01, 0.3)),
)
TOLD = st.builds(
    ToldObstacle,
    st.floats(-1, 1),
    st.floats(-1, 1),
    st.floats(0, 0.4),
    st.sampled_from([0.0, 0.1, 0.1, 0.4]),
)
ASKED = st.builds(
    Asked,
    st.sampled_from([0.0, 0.001, 0.05, 0.05, 0.3]),
    st.lists(st.tuples(SHARE, SHARE, SHARE), min_size=1, max_size=3),
    TOUCH,
    st.sampled_from([None, 0.0, 0.0, 0.03, 0.4]),
    st.sampled_from([-1, -1, -1, -2, None]),
    st.one_of(st.just(()), st.just(()), st.lists(TOLD, max_size=3).map(tuple)),
)
EVENTS = st.lists(st.one_of(SEEN, MOVED, ASKED, ASKED), max_size=10)


class Pair:
    """Both paths of mode `barrier`, for one robot with the same inputs."""

    def __init__(self, platform: Platform) -> None:
        self.platform, self.geometry = platform, ScanGeometry(platform.scan)
        self.paths = interpreted.Barrier(platform), compiled.Barrier(platform)
        self.outline = Footprint(platform.footprint)
        self.now, self.pose, self.seq, self.command = 5.0, Pose(1.0, -2.0, 3.0), 0, ZERO
        self.readings = [Odometry(self.now, self.pose, ZERO)]
        self.decisions: list[ModeDecision] = []

    def take(self, event: Seen | Moved | Asked) -> None:
        """Let something happen, and hold both results together."""
        if isinstance(event, Seen):
            self._see(event)
        elif isinstance(event, Moved):
            self._move(event)
        else:
            self._ask(event)

    def _see(self, seen: Seen) -> None:
        self.seq += 1
        scan = scan_of(self.platform, seen.faces, self.seq)
        if seen.sweep:
            ages = seen.sweep * np.linspace(1.0, 0.0, len(scan.ranges))
            scan = replace(scan, ages=ages)
        context = DecisionContext(self.now, seen.age, self.readings[-1], 0.0, seen.delay)
        expected = self.outline.min_gap(scan, self.geometry)
        for path in self.paths:
            path.observe(scan, self.geometry, context)
            assert path.min_gap == (
                None if expected is None else pytest.approx(expected, abs=1e-12)
            )

    def _move(self, moved: Moved) -> None:
        limits = self.platform.limits
        twist = Twist(
            moved.ahead * limits.linear, moved.turn * limits.angular, moved.aside * limits.lateral
        )
        self.now += 0.02
        x, y, yaw = self.pose.x, self.pose.y + moved.jump, self.pose.yaw + 0.05 * twist.angular
        self.pose = Pose(
            x + 0.05 * twist.linear * math.cos(yaw), y + 0.05 * twist.linear * math.sin(yaw), yaw
        )
        self.readings.append(Odometry(self.now - moved.late, self.pose, twist))

    def _ask(self, asked: Asked) -> None:
        self.now += asked.after
        odometry = None
        if asked.which is not None:
            odometry = self.readings[max(asked.which, -len(self.readings))]
        told, near = asked.told[:1], asked.told[1:]  # from others, and from a ring
        context = DecisionContext(self.now, asked.after, odometry, asked.age, told=told, near=near)
        limits = self.platform.limits
        for v, w, aside in asked.requests:
            requested = Twist(v * limits.linear, w * limits.angular, aside * limits.lateral)
            for _ in range(2):  # the second time from memory
                one, other = (
                    path.decide(requested, context, command=self.command, touch=asked.touch)
                    for path in self.paths
                )
                assert_same(one, other)
            self.command = limits.clip(one.twist)
            self.decisions.append(one)


def scan_of(platform: Platform, faces: list[Face], seq: int) -> Scan:
    """A scan of the platform's rays with these faces."""
    count = len(platform.scan.bearings)
    ranges = np.full(count, math.inf)
    for face in faces:
        rays = np.arange(1 + int(face.width * count)) + int(face.first * count)
        away = platform.scan.range_min + face.beyond + face.slope * np.arange(len(rays))
        away = np.where(away < platform.scan.range_min, -math.inf, away)
        ranges[rays % count] = np.minimum(ranges[rays % count], away)
    return scan_from(platform, ranges, platform.scan.bearings, seq=seq)


def assert_same(one: ModeDecision, other: ModeDecision) -> None:
    """Commands, activity and reported constraints agree to within rounding."""
    assert one.is_active == other.is_active
    assert numbers(one) == pytest.approx(numbers(other), abs=AGREEMENT, rel=0.0, nan_ok=True)


def numbers(decision: ModeDecision) -> list[float]:
    """The command and the rows of a decision."""
    twist = decision.twist
    found = [twist.linear, twist.angular, twist.lateral]
    for row in decision.rows:
        found += [row.bearing, row.gap, row.cap]
    return found


@needs_compiled
@settings(max_examples=examples(600))
@given(st.sampled_from(VARIANTS), SEEN, EVENTS)
def test_both_paths_decide_alike(
    platform: Platform, seen: Seen, events: list[Seen | Moved | Asked]
) -> None:
    pair = Pair(platform)
    for event in (seen, Asked(0.01, [(1.0, 0.3, 0.2)], None, 0.0, -1), *events):
        pair.take(event)


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", ["stamp", "x", "yaw", "linear"])
def test_odometry_that_is_not_finite_lets_no_command_pass(place: str, number: float) -> None:
    """Protection gives zero for a command that is not finite."""
    values = {"stamp": 5.0, "x": 0.0, "yaw": 0.0, "linear": 0.0, place: number}
    pair = Pair(WAFFLE)
    pose = Pose(values["x"], 0.0, values["yaw"])
    pair.readings = [Odometry(values["stamp"], pose, Twist(values["linear"]))]
    pair.take(Seen([Face(0.0, 0.1, 0.2, 0.0)], 0.0))
    pair.take(Asked(0.01, [(1.0, 0.0, 0.0)], None, 0.0, -1))
    twist = pair.decisions[-1].twist
    assert twist.is_zero or not twist.is_finite


def test_contact_stays_one_after_the_robot_has_moved_away() -> None:
    """Its cap is 0 although there is room by then."""
    pair = Pair(VARIANTS[-1])
    pair.take(Seen([Face(0.0, 0.02, -1.0, 0.0)], 0.0))
    for _ in range(12):
        pair.take(Moved(0.0, -1.0, 0.0, 0.0))
    pair.take(Asked(0.01, [(1.0, 0.3, 0.0), (1.0, -0.3, 0.0)], None, 0.0, -1))
    assert all(decision.is_active for decision in pair.decisions)


def test_both_paths_report_a_told_obstacle_that_limits_by_the_stop_alone() -> None:
    """Two returns are farther from the robot, which turns and drives the other way."""
    rng, reported = np.random.default_rng(0), 0
    for _ in range(60):
        pair = Pair(BURGER)
        twist = Twist(float(rng.uniform(-0.22, 0.22)), float(rng.uniform(-2.0, 2.0)))
        pair.readings, pair.command = [Odometry(pair.now, Pose(), twist)], twist
        places, beyond = rng.uniform(0.0, 1.0, 2), rng.uniform(0.2, 0.5, 2)
        faces = [Face(*one, 0.0) for one in zip(places, (0.0, 0.0), beyond, strict=True)]
        pair.take(Seen(faces, 0.0))
        bearing, away = rng.uniform(-3.0, 3.0), rng.uniform(0.25, 0.4)
        told = ToldObstacle(away * math.cos(bearing), away * math.sin(bearing), 0.1, 0.1)
        requests = [tuple(rng.uniform(-1.0, 1.0, 3).tolist()) for _ in range(3)]
        pair.take(Asked(0.0, requests, None, 0.0, -1, (told,)))
        rows = [decision.rows for decision in pair.decisions if len(decision.rows) == 1]
        reported += sum(abs(row.bearing - bearing) < 0.3 for (row,) in rows)
    assert reported > 10


@pytest.mark.parametrize("x", [0.0, -0.0, 1e-17, -1e-17])
@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.0, -3.0])
def test_an_obstacle_told_at_the_axle_is_reported_ahead(x: float, yaw: float) -> None:
    """Its direction is not defined: the signs of zeros and rounding must not decide."""
    pair = Pair(WAFFLE)
    pair.pose = Pose(1.0, -2.0, yaw)
    pair.readings = [Odometry(pair.now, pair.pose, ZERO)]
    pair.take(Seen([], 0.0))
    for _ in range(3):
        pair.take(Moved(0.0, 0.0, 0.0, 0.0))
    told = (ToldObstacle(x, -x, 0.0, 0.0),)
    slow = [(0.04, 0.0, 0.0), (-0.04, 0.002, 0.0)]  # below the speed in contact
    pair.take(Asked(0.01, slow, None, 0.0, -1, told))
    assert {row.bearing for decision in pair.decisions for row in decision.rows} == {0.0}


def test_other_odometry_at_the_same_time_is_another_situation() -> None:
    pair, asked = Pair(WAFFLE), Asked(0.0, [(1.0, 0.0, 0.0)], None, 0.0, -1)
    pair.take(Seen([Face(0.0, 0.1, 0.45, 0.0)], 0.0))
    pair.take(asked)
    pair.readings.append(Odometry(pair.now + 0.01, Pose(1.05, -2.0, 3.05), Twist(0.1)))
    pair.take(asked)
    assert pair.decisions[0].twist != pair.decisions[1].twist


def test_equal_told_obstacles_at_the_same_time_are_the_same_situation() -> None:
    """The command that takes effect first has changed, and is not looked at again."""
    pair, told = Pair(BURGER), {"x": 0.0, "y": 0.0, "radius": 0.0, "age": 0.0}
    pair.take(Seen([], 0.0))
    for _ in range(2):
        pair.take(Asked(0.0, [(-1.0, 1.0, 0.0)], None, 0.0, -1, (ToldObstacle(**told),)))
    assert pair.decisions[0] == pair.decisions[1]
    assert pair.decisions[0].is_active


@pytest.mark.parametrize("age", [0.0, 0.05, 0.6])
def test_scan_is_placed_alike_between_readings_and_after_the_last(age: float) -> None:
    """The yaw passes from pi to -pi between the readings."""
    pair = Pair(WAFFLE)
    pair.take(Asked(0.0, [(1.0, 0.0, 0.0)], None, 0.0, -1))
    for stamp, yaw in ((4.7, 3.1), (5.0, -3.1)):
        odometry = Odometry(stamp + 1.0, Pose(0.0, 0.0, yaw), Twist(0.2, 0.3))
        context = DecisionContext(6.0, 0.0, odometry, age)
        scan = scan_of(WAFFLE, [Face(0.0, 0.1, 0.4, 0.0)], 1)
        for path in pair.paths:
            path.observe(scan, pair.geometry, context)
    pair.readings.append(odometry)
    pair.now = 6.0
    pair.take(Asked(0.05, [(1.0, 0.0, 0.0), (0.5, 1.0, 0.0)], None, 0.0, -1))


@pytest.mark.parametrize("kind", [np.float32, np.int64])
def test_ranges_may_be_of_any_number_type(kind: type) -> None:
    pair = Pair(JACKAL)
    scan = scan_from(JACKAL, np.full(360, 1, kind), JACKAL.scan.bearings)
    context = DecisionContext(pair.now, 0.0, pair.readings[-1], 0.0)
    for path in pair.paths:
        path.observe(scan, pair.geometry, context)
    pair.take(Asked(0.01, [(1.0, 0.3, 0.0)], None, 0.0, -1))
    assert pair.decisions[-1].is_active


@pytest.mark.parametrize("module", [interpreted, compiled])
def test_a_scan_with_more_ranges_than_rays_is_refused_and_frees_no_way(module: Any) -> None:
    barrier, geometry = module.Barrier(BURGER), ScanGeometry(BURGER.scan)
    context, bearings = DecisionContext(1.0, 0.0), np.zeros(1)
    scan = Scan(1, 1.0, np.array([0.2]), bearings, 0.1, 3.5)
    barrier.observe(scan, geometry, context)
    for ranges, ages in ((np.full(2, np.inf), None), (np.array([np.inf]), np.zeros(2))):
        with pytest.raises(IndexError):
            barrier.observe(replace(scan, ranges=ranges, ages=ages), geometry, context)
    decision = barrier.decide(Twist(0.22), context, command=ZERO, touch=None)
    assert decision.is_active
    assert decision.twist.linear < 0.22


@pytest.mark.parametrize("stream", read(), ids=lambda stream: stream.scene)
def test_recorded_decisions_are_made_again(stream: Stream) -> None:
    """Robots in crowds and among rammers; studies/record_decisions.py wrote the file."""
    platform = platform_of(stream)
    one = decided(stream, interpreted.Barrier(platform))
    other = decided(stream, compiled.Barrier(platform))
    for (event, expected), (_, found) in zip(one, other, strict=True):
        assert_same(expected, found)
        assert event.twist is not None
        assert event.is_active == expected.is_active
        assert numbers(expected)[:3] == pytest.approx(
            numbers(ModeDecision(event.twist, is_active=True))[:3]
        )
