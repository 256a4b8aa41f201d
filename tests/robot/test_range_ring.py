"""A ring of range sensors beside the lidar: it holds the robot, and protection sees its returns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.events import RangesInput
from swarmd.core.messages import Reason, State
from swarmd.core.values import ZERO, Odometry, Platform, Pose, Scan, Twist
from swarmd.robot.protection.decision import Decision
from swarmd.robot.protection.footprint import ScanGeometry
from swarmd.robot.protection.modes import make_mode, narrowest_passage
from swarmd.robot.protection.settings import Mode
from swarmd.robot.robot import Robot
from swarmd.robot.sensors import Sensors
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import empty_scan, scan_from
from tests.support.examples import examples
from tests.support.platforms import with_mode
from tests.support.protection import Protection
from tests.support.range_ring import RING_DEG, ring_scan, ring_spec, with_ring
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, standing_state

BURGER = with_ring("burger")
MODES: tuple[Mode, ...] = ("barrier", "stop_zone", "potential_field")
AHEAD = Twist(0.2)
NOTHING: Mapping[float, float] = {}


class Rig:
    """Sensors and protection of one robot at rest, with fresh odometry and empty scans."""

    def __init__(self, platform: Platform) -> None:
        self.platform, self.seq = platform, 0
        self.sensors, self.protection = Sensors(platform), Protection(platform)
        self.sensors.on_driver(True, "up", 0.0)

    def lidar(self, now: float, scan: Scan | None = None) -> None:
        self.seq += 1
        seen = scan or empty_scan(self.platform, self.seq, now, 3.0)
        assert self.sensors.on_scan(seen, now)
        assert self.sensors.scan is not None
        self.protection.observe(self.sensors.scan, self.sensors.context(now))

    def odometry(self, now: float) -> None:
        self.sensors.on_odometry(Odometry(now, Pose(), ZERO), now)

    def ring(self, now: float, returns: Mapping[float, float]) -> None:
        self.seq += 1
        self.sensors.on_ranges(ring_scan(self.seq, now, returns, self.platform.ranges), now)

    def decide(self, now: float, requested: Twist = AHEAD) -> Decision:
        context, hold = self.sensors.context(now), self.sensors.hold(now)
        return self.protection.decide(requested, context, is_running=True, hold=hold)


def seen_by_ring(mode: Mode, returns: Mapping[float, float], now: float = 5.0) -> Rig:
    rig = Rig(with_mode(BURGER, mode))
    rig.odometry(now)
    rig.lidar(now)
    rig.ring(now, returns)
    return rig


@pytest.mark.parametrize("mode", MODES)
def test_an_obstacle_that_only_the_ring_sees_stops_the_robot(mode: Mode) -> None:
    free = seen_by_ring(mode, NOTHING).decide(5.01)
    assert free.safe == AHEAD
    decision = seen_by_ring(mode, {0.0: 0.09}).decide(5.01)
    assert decision.safe.linear <= 0.0
    assert decision.is_active
    assert decision.min_gap == pytest.approx(0.09 - 0.038)


@pytest.mark.parametrize("mode", MODES)
def test_an_obstacle_too_close_to_measure_stops_the_robot(mode: Mode) -> None:
    decision = seen_by_ring(mode, {0.0: -math.inf}).decide(5.01)
    assert decision.safe.linear <= 0.0
    assert decision.min_gap == pytest.approx(ring_spec().range_min - 0.038)


@pytest.mark.parametrize("mode", MODES)
def test_an_obstacle_is_where_its_sensor_looks(mode: Mode) -> None:
    """Behind a robot that drives ahead: the barrier and the field let it go."""
    decision = seen_by_ring(mode, {180.0: 0.15}).decide(5.01)
    assert (decision.safe.linear > 0.0) == (mode != "stop_zone")
    back = seen_by_ring(mode, {180.0: 0.15}).decide(5.01, Twist(-0.2))
    assert back.safe.linear >= 0.0


def test_the_offset_of_the_ring_is_its_own() -> None:
    spec = ring_spec(offset=(-0.05, 0.0))
    rig = Rig(with_ring("burger", spec))
    rig.odometry(5.0)
    rig.lidar(5.0)
    rig.ring(5.0, {0.0: 0.4})
    ((near,),) = [rig.sensors.context(5.0).near]
    assert (near.x, near.y) == pytest.approx((0.35, 0.0))
    assert near.radius == BURGER.protection["barrier"]["unseen_extent"]
    assert near.age == pytest.approx(spec.latency + 0.5 / spec.rate)


def test_a_field_of_both_weighs_them_equally() -> None:
    platform = with_mode(BURGER, "potential_field")
    rig = Rig(platform)
    behind = np.full(360, np.inf)
    behind[150:211] = 0.3
    rig.odometry(5.0)
    rig.lidar(5.0, scan_from(platform, behind, platform.scan.bearings, seq=1))
    rig.ring(5.0, NOTHING)
    assert rig.decide(5.01, ZERO).safe.linear > 0.0
    rig.ring(5.05, {0.0: 0.2})
    assert abs(rig.decide(5.06, ZERO).safe.linear) < 0.01 * platform.limits.linear


def test_a_robot_with_a_ring_creeps_past_nothing() -> None:
    """A return of the ring is a disc, whose side that may touch the robot is not known."""
    widths = []
    for platform in (load_platform("burger"), BURGER):
        passage = narrowest_passage(make_mode(platform))
        assert passage is not None
        widths.append(passage.door)
    assert widths[1] > widths[0] + 0.01


def test_a_ring_without_a_scan_or_with_a_stale_one_holds() -> None:
    rig, spec = Rig(BURGER), BURGER.ranges
    assert spec is not None
    rig.odometry(5.0)
    rig.lidar(5.0)
    assert rig.sensors.hold(5.0) is Reason.NO_SCAN
    rig.ring(5.0, NOTHING)
    assert rig.sensors.hold(5.0) is None
    assert rig.sensors.stale_at() == pytest.approx(5.0 + spec.stale_after)
    assert rig.sensors.hold_due_at(5.0) <= 5.0 + spec.stale_after
    late = 5.0 + spec.stale_after + 0.01
    rig.odometry(late)
    rig.lidar(late)
    assert rig.sensors.hold(late) is Reason.STALE_SCAN
    assert rig.decide(late).safe.is_zero
    rig.ring(late, NOTHING)
    assert rig.sensors.hold(late) is None


@pytest.mark.parametrize(
    ("ranges", "reason"),
    [
        ([math.nan] * 6, Reason.INVALID_SCAN),
        ([0.5] * 5, Reason.INVALID_SCAN),
        ([], Reason.INVALID_SCAN),
        ("same sequence", Reason.FROZEN_SCAN),
    ],
)
def test_a_ring_without_valid_values_holds(ranges: list[float] | str, reason: Reason) -> None:
    rig = seen_by_ring("barrier", NOTHING)
    for tick in range(1, 12):
        now = 5.0 + 0.05 * tick
        rig.odometry(now)
        rig.lidar(now)
        scan = ring_scan(100 + tick, now, NOTHING)
        if isinstance(ranges, str):
            scan = msgspec.structs.replace(scan, seq=1)
        else:
            scan = msgspec.structs.replace(scan, ranges=np.array(ranges))
        rig.sensors.on_ranges(scan, now)
    assert rig.sensors.hold(now) is reason


def test_a_ring_may_see_something_and_then_nothing() -> None:
    """A lidar whose returns vanish at once is blind; six sensors see nothing most of the time."""
    rig = seen_by_ring("barrier", {0.0: 0.5, 30.0: 0.6})
    for tick in range(1, 10):
        now = 5.0 + 0.1 * tick
        rig.odometry(now)
        rig.lidar(now)
        rig.ring(now, NOTHING)
        assert rig.sensors.hold(now) is None


def test_scans_of_a_ring_that_the_platform_does_not_have_do_nothing() -> None:
    rig = Rig(load_platform("burger"))
    rig.odometry(5.0)
    rig.lidar(5.0)
    rig.sensors.on_ranges(ring_scan(1, 5.0, {0.0: 0.08}), 5.0)
    assert rig.sensors.hold(5.0) is None
    assert rig.decide(5.01).safe == AHEAD
    assert rig.sensors.inputs(5.0, 0.1).ranges is None


def test_a_pattern_gets_the_scan_of_the_ring() -> None:
    rig = seen_by_ring("barrier", {30.0: 0.7})
    seen = rig.sensors.inputs(5.0, 0.1).ranges
    assert seen is not None
    assert seen.ranges.tolist() == [0.7 if deg == 30.0 else math.inf for deg in RING_DEG]
    assert seen.range_max == 1.0


def test_a_ring_that_falls_silent_stops_a_running_robot_at_its_deadline() -> None:
    harness = RobotHarness("burger", PATTERNS, make=_robot_with_ring)
    begin = harness.now
    silent_from = begin + 3.0

    def ring(now: float) -> None:
        if now < silent_from:
            harness.step(RangesInput(ring_scan(round(100 * now), now, NOTHING)), now)

    def scans(seq: int, now: float) -> Scan:
        ring(now)
        return empty_scan(harness.platform, seq, now)

    harness.scans = scans
    harness.advance(1.0)
    harness.applied("run", pattern="forward")
    harness.advance(1.9)
    assert not harness.twist.is_zero
    harness.commands.clear()
    harness.advance(1.5)
    stood = min(at for at, twist in harness.commands if twist.is_zero)
    limit = silent_from + ring_spec().stale_after
    assert stood <= limit + 0.001
    assert harness.status.reason is Reason.STALE_SCAN
    harness.advance(2.0)
    assert standing_state(harness) == (State.STOPPED, Reason.STALE_SCAN)


def _robot_with_ring(id, platform, *args, **kwargs):  # type: ignore[no-untyped-def]
    return Robot(id, with_ring(platform), *args, **kwargs)


@pytest.mark.parametrize("speed", [0.05, 0.12, 0.22])
@pytest.mark.parametrize("mode", ["barrier", "stop_zone"])
def test_a_driving_robot_stops_before_what_only_the_ring_sees(mode: Mode, speed: float) -> None:
    """It brakes no better than assumed, and each value of the ring is 70 ms old on arrival."""
    spec = replace(ring_spec(), latency=0.045)
    rig, front = Rig(with_mode(with_ring("burger", spec), mode)), 0.038
    post, dt, braking, command = 1.2, 0.01, 1.0, ZERO
    x, v, past = 0.6, 0.0, [0.6] * 7
    for step in range(1200):
        now = 5.0 + dt * step
        past = [*past[1:], x]
        rig.sensors.on_odometry(Odometry(now, Pose(x), Twist(v)), now)
        if step % 20 == 0:
            rig.lidar(now)
        if step % 5 == 0:
            away = post - past[0]
            rig.ring(now, {0.0: away} if away <= spec.range_max else NOTHING)
            command = rig.decide(now, Twist(speed)).safe
        v += min(max(command.linear - v, -braking * dt), braking * dt)
        x += v * dt
    assert x > 0.9, "it has come near"
    assert abs(v) < 0.02
    assert post - x - front > 0.0


# Histories


class Seen(NamedTuple):
    """The lidar's returns by ray, m beyond range_min; -1: too close to measure."""

    returns: list[tuple[int, float]]


class Near(NamedTuple):
    """The ring's returns, by number of the sensor, in m; -1: too close to measure."""

    returns: list[tuple[int, float]]


class Drive(NamedTuple):
    """s in which the robot obeys its last command."""

    seconds: float


class Ask(NamedTuple):
    """A request, as shares of the limits."""

    linear: float
    angular: float


SHARE = st.one_of(st.floats(-1, 1), st.sampled_from([-1.0, 0.0, 1.0]))
AWAY = st.one_of(st.floats(0, 0.4), st.floats(0, 2.0), st.just(-1.0))
EVENTS = st.lists(
    st.one_of(
        st.builds(Seen, st.lists(st.tuples(st.integers(0, 359), AWAY), max_size=5)),
        st.builds(Near, st.lists(st.tuples(st.integers(0, 5), AWAY), max_size=4)),
        st.builds(Drive, st.sampled_from([0.01, 0.05, 0.1])),
        st.builds(Ask, SHARE, SHARE),
    ),
    min_size=4,
    max_size=16,
)
_VARIANTS: tuple[tuple[str, Mode, tuple[float, float]], ...] = (
    ("burger", "barrier", (0.0, 0.0)),
    ("waffle_pi", "barrier", (-0.05, 0.0)),
    ("jackal", "barrier", (0.1, 0.05)),
    ("burger", "stop_zone", (0.0, 0.0)),
)
VARIANTS = [
    with_ring(with_mode(load_platform(name), mode), ring_spec(offset))
    for name, mode, offset in _VARIANTS
]


class History:
    """One robot whose safe command is judged by each source alone.

    `lidar` gets the lidar's scans and no ring, `ring` empty scans and the ring's returns as
    obstacles that others tell of.
    """

    def __init__(self, platform: Platform) -> None:
        self.platform, self.geometry = platform, ScanGeometry(platform.scan)
        lidar = replace(platform, ranges=None)
        self.both, self.lidar, self.ring = (make_mode(one) for one in (platform, lidar, platform))
        self.is_barrier = platform.protection["mode"] == "barrier"
        self.sensors = Sensors(platform)
        self.now, self.seq, self.pose, self.command = 5.0, 0, Pose(), ZERO
        self.take(Near([]))
        self.take(Drive(0.01))
        self.take(Seen([]))

    def take(self, event: Seen | Near | Drive | Ask) -> None:
        self.seq += 1
        if isinstance(event, Seen):
            self._see(event)
        elif isinstance(event, Near):
            away = {RING_DEG[k]: -math.inf if m < 0.0 else 0.05 + m for k, m in event.returns}
            self.sensors.on_ranges(
                ring_scan(self.seq, self.now, away, self.platform.ranges), self.now
            )
        elif isinstance(event, Drive):
            self._drive(event.seconds)
        else:
            self._ask(event)

    def _see(self, event: Seen) -> None:
        spec = self.platform.scan
        ranges = np.full(len(spec.bearings), math.inf)
        for ray, away in event.returns:
            ranges[ray] = -math.inf if away < 0.0 else spec.range_min + away
        self.now += 1e-4
        scan = scan_from(self.platform, ranges, spec.bearings, seq=self.seq)
        context = msgspec.structs.replace(self.sensors.context(self.now), scan_age=0.0)
        self.scanned_at = self.now
        self.both.observe(scan, self.geometry, context)
        self.lidar.observe(scan, self.geometry, msgspec.structs.replace(context, near=()))
        nothing = msgspec.structs.replace(scan, ranges=np.full(len(ranges), math.inf))
        self.ring.observe(nothing, self.geometry, context)

    def _drive(self, seconds: float) -> None:
        self.now += seconds
        yaw = self.pose.yaw + seconds * self.command.angular
        way = seconds * self.command.linear
        self.pose = Pose(self.pose.x + way * math.cos(yaw), self.pose.y + way * math.sin(yaw), yaw)
        self.sensors.on_odometry(Odometry(self.now, self.pose, self.command), self.now)

    def _ask(self, event: Ask) -> None:
        limits = self.platform.limits
        self.now += 1e-3  # a situation keeps the command for which it was computed first
        requested = Twist(event.linear * limits.linear, event.angular * limits.angular)
        context = msgspec.structs.replace(
            self.sensors.context(self.now), scan_age=self.now - self.scanned_at
        )
        safe = limits.clip(
            self.both.decide(requested, context, command=self.command, touch=None).twist
        )
        ring = {"near": (), "told": context.near} if self.is_barrier else {}
        for mode, told in (
            (self.lidar, msgspec.structs.replace(context, near=())),
            (self.ring, msgspec.structs.replace(context, **ring)),
        ):
            permitted = mode.decide(safe, told, command=self.command, touch=None).twist
            if not self.is_barrier:
                alone = mode.decide(requested, told, command=self.command, touch=None).twist
                assert abs(safe.linear) <= abs(alone.linear) + 1e-9
                assert abs(safe.angular) <= abs(alone.angular) + 1e-9
            else:
                assert permitted.linear == pytest.approx(safe.linear, abs=1e-6)
                assert permitted.angular == pytest.approx(safe.angular, abs=1e-6)
        self.command = safe


@settings(max_examples=examples(300), deadline=None)
@given(st.sampled_from(VARIANTS), EVENTS)
def test_a_safe_command_is_permitted_by_each_source_alone(
    platform: Platform, events: list[Seen | Near | Drive | Ask]
) -> None:
    history = History(platform)
    for event in (*events, Ask(1.0, 0.2)):
        history.take(event)
