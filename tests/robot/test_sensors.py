"""The inputs of one robot, their ages, and when the robot must not move on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from swarmd.core.codec import Decoder, encode
from swarmd.core.events import DriverInput, OdometryInput
from swarmd.core.messages import Health, Reason, State
from swarmd.core.values import ZERO, Neighbor, Odometry, Pose, Scan, Twist
from swarmd.robot.inbox import MAX_INBOX_BYTES, MESSAGE_OVERHEAD
from swarmd.robot.message_limits import EVENT_BURST
from swarmd.robot.protection.compatibility import body_of
from swarmd.robot.protection.settings import Mode
from swarmd.robot.sensors import Sensors
from swarmd.robot.timeouts import AGE_UPDATE_PERIOD, NEIGHBOR_TIMEOUT, ODOMETRY_TIMEOUT
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import empty_scan
from tests.support.platforms import with_mode
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, standing_state, started


@pytest.fixture
def senses() -> Sensors:
    return Sensors(load_platform("waffle_pi"))


def test_neighbors_age_in_steps_and_time_out(senses: Sensors) -> None:
    senses.on_neighbors((Neighbor("b", 0.25, distance=1.0),), 10.0)
    ages = [senses.neighbors(10.0 + past)[0].age for past in (0.0, 0.4, 0.6, 1.7, 2.9)]
    assert ages == [
        0.25,
        0.25,
        0.25 + AGE_UPDATE_PERIOD,
        0.25 + 3 * AGE_UPDATE_PERIOD,
        0.25 + 5 * AGE_UPDATE_PERIOD,
    ]
    assert senses.neighbors(11.0)[0].distance == 1.0
    last = 10.0 + NEIGHBOR_TIMEOUT
    assert senses.on_message("b", "w", 1, last)
    assert not senses.on_message("b", "w", 1, last + 0.01)
    assert senses.neighbors(last + 0.01) == ()


def test_robots_out_of_reach_are_no_neighbors_of_the_pattern(senses: Sensors) -> None:
    near, far = Neighbor("b", 0.0, 1.0), Neighbor("c", 0.0, 5.0, in_reach=False)
    for given in ((near, far), (near, far), (near,)):
        senses.on_neighbors(given, 10.0)
        assert senses.neighbors(10.0) == (near,)
        assert senses.on_message("b", "voter/opinion", 1, 10.0)
        assert not senses.on_message("c", "voter/opinion", 1, 10.0)


def test_protection_regards_robots_that_are_out_of_reach() -> None:
    jackal = Sensors(load_platform("jackal"))
    jackal.on_peers({"b": body_of(load_platform("burger"))})
    jackal.on_neighbors((Neighbor("b", 0.0, 2.0, 0.0, in_reach=False),), 10.0)
    assert jackal.neighbors(10.0) == ()
    assert len(jackal.peers.told(10.0)) == 1


def test_messages_arrive_once_and_the_oldest_are_dropped(senses: Sensors) -> None:
    senses.on_neighbors((Neighbor("b", 0.0),), 0.0)
    word = b"x" * 800
    fit = MAX_INBOX_BYTES // (MESSAGE_OVERHEAD + 800 + 4)  # a version byte and 3 of MessagePack
    for number in range(fit + 3):
        assert senses.on_message("b", f"w{number}", word, 0.5)
    got = senses.inputs(0.75, 0.1).messages
    assert [message.channel for message in got] == [f"w{k}" for k in range(3, fit + 3)]
    assert {message.age for message in got} == {0.25}
    assert senses.inbox.overflowed == 3
    assert senses.inputs(0.75, 0.1).messages == ()


def test_odometry_with_an_old_stamp_becomes_stale(senses: Sensors) -> None:
    senses.on_driver(True, "up", 0.0)
    platform = load_platform("waffle_pi")
    for tick in range(13):
        now = tick * 0.05
        senses.on_odometry(Odometry(1.0, Pose(), Twist()), now)
        senses.on_scan(empty_scan(platform, tick, now), now)
        late = now > ODOMETRY_TIMEOUT + 1e-9
        assert senses.hold(now) is (Reason.STALE_ODOMETRY if late else None)


@pytest.mark.parametrize("mode", ["barrier", "potential_field", "stop_zone"])
def test_zeros_beside_near_rays_count_as_near_unless_in_barrier(mode: Mode) -> None:
    platform = with_mode(load_platform("burger"), mode)
    senses, ranges = Sensors(platform), np.full(360, 2.0)
    ranges[100] = 0.15
    senses.on_scan(structs.replace(empty_scan(platform, 0, 0.0), ranges=ranges), 0.0)
    ranges = ranges.copy()
    ranges[97:104] = 0.0
    senses.on_scan(structs.replace(empty_scan(platform, 1, 0.2), ranges=ranges), 0.2)
    assert senses.scan is not None
    assert np.isneginf(senses.scan.ranges[97:104]).all() == (mode != "barrier")


@pytest.mark.parametrize("has_claim", [True, False])
def test_rays_count_as_old_as_the_oldest_while_their_order_is_not_known(has_claim: bool) -> None:
    """A Waffle Pi without its sweep: latency 0.1 s, and half of a scan of 0.2 s."""
    platform = load_platform("waffle_pi")
    scan = replace(platform.scan, sweep=None, is_sweep_unknown=True)
    senses = Sensors(replace(platform, scan=scan))
    count = len(scan.bearings)
    ages = np.linspace(0.2, 0.0, count) if has_claim else None
    for tick in range(60):  # it turns at 1 rad/s
        now = 0.05 * tick
        senses.on_odometry(Odometry(now, Pose(0.0, 0.0, now), Twist(0.0, 1.0)), now)
    assert senses.on_scan(structs.replace(empty_scan(platform, 1, 2.8), ages=ages), 3.0)
    assert senses.scan is not None
    assert senses.scan.newest_age == 0.1
    np.testing.assert_allclose(senses.scan.bearings, scan.bearings)
    assert senses.scan.ages is not None
    np.testing.assert_allclose(senses.scan.ages, np.full(count, 0.1), atol=1e-3)


def test_step_gets_the_last_scan_and_odometry(senses: Sensors) -> None:
    odometry = Odometry(1.0, Pose(1.0, 2.0, 0.5), Twist(0.1))
    senses.on_odometry(odometry, 10.0)
    senses.on_scan(empty_scan(load_platform("waffle_pi"), 7, 10.0), 10.0)
    first, second = senses.inputs(10.1, 0.1), senses.inputs(10.2, 0.1)
    assert first.odometry is second.odometry is odometry
    assert first.scan is second.scan is senses.scan
    assert (first.is_new_scan, second.is_new_scan) == (True, False)


def test_lost_rays_keep_their_obstacle_while_the_robot_turns(senses: Sensors) -> None:
    platform, ranges = load_platform("waffle_pi"), np.full(360, 2.0)
    ranges[95:106] = 1.0
    for now, yaw_deg in ((0.0, 0.0), (0.2, 30.0)):
        senses.on_odometry(Odometry(now, Pose(yaw=math.radians(yaw_deg)), Twist()), now)
        senses.on_scan(
            structs.replace(empty_scan(platform, round(now * 5), now), ranges=ranges), now
        )
        ranges = np.where(np.abs(np.arange(360) - 70) <= 5, np.nan, 2.5)
    assert senses.scan is not None
    assert senses.scan.ranges[65:76] == pytest.approx(np.full(11, 1.0))


@pytest.mark.parametrize(
    "odometry",
    [
        Odometry(1.0, Pose(), Twist(angular=math.inf)),
        Odometry(1.0, Pose(math.nan), Twist()),
        Odometry(1.0, Pose(yaw=-math.inf), Twist()),
        Odometry(math.nan, Pose(), Twist()),
        Odometry(-math.inf, Pose(), Twist()),
        Odometry(1.0, Pose(yaw=1e308), Twist()),
        Odometry(1.0, Pose(x=-1e308), Twist()),
        Odometry(1.0, Pose(), Twist(linear=1e308)),
    ],
)
def test_odometry_that_is_not_valid_is_ignored(senses: Sensors, odometry: Odometry) -> None:
    first = Odometry(0.0, Pose(), Twist())
    senses.on_odometry(first, 10.0)
    senses.on_odometry(odometry, 10.2)
    assert senses.odometry is first
    assert senses.context(10.2).odometry_age == pytest.approx(0.2)


def test_yaws_without_a_difference_end_no_robot() -> None:
    robot = RobotHarness("burger")
    robot.advance(1.0)
    for number, yaw in enumerate((1e308, -1e308, 1e308)):
        stamp = robot.now + number
        robot.robot.step(OdometryInput(Odometry(stamp, Pose(yaw=yaw), Twist())), stamp)
    assert robot.robot.motion(robot.now) is not None


def test_scans_of_one_instant_leave_a_rate_that_a_status_can_hold() -> None:
    senses = Sensors(load_platform("waffle_pi"))
    for number in range(12):
        stamp = 10.0 + 0.1 * number
        assert senses.on_scan(empty_scan(load_platform("waffle_pi"), number, stamp), 20.0)
    decoder = Decoder(Health)
    health = Health(scan_rate=senses.scan_rate(20.0))
    assert decoder(encode(health)) == health


def test_clocks_that_are_set_are_events() -> None:
    robot = RobotHarness("burger")
    robot.advance(2.0)
    robot.odometry = None
    before = len(robot.status.events)
    for number in range(1, 8):
        robot.advance(0.1)
        stamp = robot.now + 100.0 * number
        robot.robot.step(OdometryInput(Odometry(stamp, Pose(), Twist())), robot.now)
    texts = [event.text for event in robot.status.events[before:]]
    assert texts == EVENT_BURST * [
        "stamps of odometry or scan jumped: the scan delay is measured anew"
    ]


def test_missing_scan_holds_and_then_stops() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.scans = lambda seq, now: None
    harness.advance(1.0)
    harness.ask("run", pattern="forward")
    harness.advance(1.0)
    assert standing_state(harness) == (State.RUNNING, Reason.NO_SCAN)
    harness.advance(1.2)
    assert standing_state(harness) == (State.STOPPED, Reason.NO_SCAN)
    assert all(twist.is_zero for _, twist in harness.commands)


@pytest.mark.parametrize(
    ("is_sector", "reason"), [(False, Reason.STALE_SCAN), (True, Reason.INVALID_SCAN)]
)
def test_lost_scan_or_sector_zeroes_at_its_deadline(is_sector: bool, reason: Reason) -> None:
    harness = started()
    age = harness.status.decision.scan_age
    assert age is not None
    limit = harness.now - age + harness.platform.scan.stale_after
    lost = harness.nan_scan(0.0, sector=(0.0, 0.5))
    harness.scans = lost if is_sector else lambda seq, now: None
    harness.commands.clear()
    harness.advance(1.5)
    moving = [at for at, twist in harness.commands if not twist.is_zero]
    stood = [at for at, twist in harness.commands if twist.is_zero]
    assert limit - 0.051 < max(moving) <= limit
    assert limit - 1e-9 < min(stood) <= limit + 0.001
    assert harness.status.reason is reason
    harness.advance(1.6)
    assert standing_state(harness) == (State.STOPPED, reason)


@pytest.mark.parametrize("fault", ["all_nan", "lengths", "empty", "frozen"])
def test_invalid_scans_stop_the_robot(fault: str) -> None:
    harness = started()
    scan, nothing = empty_scan(harness.platform, 10_000, 5.0), np.empty(0)
    bad = {
        "all_nan": structs.replace(scan, ranges=np.full(360, np.nan)),
        "lengths": structs.replace(scan, ranges=scan.ranges[:-7]),
        "empty": structs.replace(scan, ranges=nothing, bearings=nothing),
    }

    def scans(seq: int, now: float) -> Scan:
        return structs.replace(bad[fault], seq=seq, stamp=now) if fault in bad else scan

    harness.scans = scans
    harness.advance(2.0)
    reason = Reason.FROZEN_SCAN if fault == "frozen" else Reason.INVALID_SCAN
    assert harness.status.reason is reason
    assert harness.twist.is_zero
    harness.advance(1.6)
    assert standing_state(harness) == (State.STOPPED, reason)


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ({"stamp": math.nan}, "nan"),
        ({"stamp": math.inf}, "inf"),
        ({"stamp": 5.0}, "stands at 5 s"),
        ({"pose": Pose(1e256, 0.0, 0.0)}, "1e+256"),
        ({"pose": Pose(0.0, math.nan, 0.0)}, "nan"),
        ({"pose": Pose(0.0, 0.0, -math.inf)}, "-inf"),
        ({"twist": Twist(0.0, 2e9)}, "2e+09"),
        ({"twist": Twist(0.0, 0.0, math.nan)}, "nan"),
        (None, ""),
    ],
    ids=str,
)
def test_odometry_that_does_not_count_holds_the_robot_with_the_value(
    fault: dict[str, Any] | None, told: str
) -> None:
    """docs/trouble.md, `stale_odometry`."""
    harness = started()
    harness.odometry = Twist(0.1)
    harness.advance(1.0)
    harness.odometry = None
    good = Odometry(harness.now, harness.pose, Twist(0.1))
    for step in range(12):
        harness.advance(0.05)
        if fault is not None:
            stamped = structs.replace(good, stamp=good.stamp + 0.05 * (step + 1))
            harness.step(OdometryInput(structs.replace(stamped, **fault)))
    assert harness.status.reason is Reason.STALE_ODOMETRY
    assert told in harness.status.detail
    assert harness.twist.is_zero
    harness.odometry = Twist(0.1)
    harness.advance(0.3)
    assert harness.status.reason is not Reason.STALE_ODOMETRY
    assert not harness.twist.is_zero


OPEN, WALL = (math.inf, 2.0), (2.0, 2.0)  # m, what a lidar returns ahead and behind
NOTHING = (math.inf, math.inf)


@pytest.mark.parametrize(
    ("hold", "lasts"), [(Reason.SCAN_CONFLICT, 5.0), (Reason.BASE_CONFLICT, 0.4)]
)
@pytest.mark.parametrize(
    ("before", "after", "reason"),
    [
        pytest.param([OPEN], OPEN, None, id="no wall ahead"),
        pytest.param([NOTHING], NOTHING, None, id="an open field"),
        pytest.param([WALL, OPEN], OPEN, Reason.INVALID_SCAN, id="blind ahead before"),
        pytest.param([WALL], NOTHING, Reason.INVALID_SCAN, id="blind meanwhile"),
    ],
)
def test_a_second_lidar_that_has_gone_leaves_what_the_own_has_shown(
    before: list[tuple[float, float]],
    after: tuple[float, float],
    reason: Reason | None,
    hold: Reason,
    lasts: float,
) -> None:
    """The second lidar returns walls all around, 3.8 s before the driver knows of it."""
    harness = started()
    spec, shown = harness.platform.scan, list[tuple[float, float]]()

    def scans(seq: int, now: float) -> Scan:
        ranges = np.where(np.cos(spec.bearings) > 0.0, *shown[seq % len(shown)])
        return structs.replace(empty_scan(harness.platform, seq, now), ranges=ranges + 1e-6 * seq)

    harness.scans = scans
    for shown[:] in [[one] for one in before]:
        harness.odometry = Twist(0.1) if shown == before[:1] else ZERO
        harness.advance(9.0)
    harness.odometry = ZERO
    shown[:] = [before[-1], WALL, WALL, WALL]
    harness.advance(3.8)
    harness.step(DriverInput(True, "two lidars", hold=hold))
    harness.advance(lasts)
    assert harness.twist.is_zero
    shown[:] = [after]
    harness.step(DriverInput(True, "there"))
    harness.advance(1.0)
    harness.applied("run", pattern="forward")
    harness.odometry = Twist(0.1)
    harness.advance(1.5)
    assert harness.status.reason is reason
    assert harness.twist.is_zero == (reason is not None)


@pytest.mark.parametrize(
    ("topic", "clock", "reason"),
    [
        ("scan", lambda now: 0.0, Reason.FROZEN_STAMP),
        ("scan", lambda now: now - 5.0, Reason.CLOCK_SET),
        ("scan", lambda now: now - 3.0, Reason.CLOCK_SET),
        ("odometry", lambda now: now + 30.0, Reason.CLOCK_SET),
    ],
)
def test_stamps_that_stand_still_and_a_clock_that_was_set_are_reasons_of_their_own(
    topic: str, clock: Callable[[float], float], reason: Reason
) -> None:
    harness = started()

    def scans(seq: int, now: float) -> Scan:
        scan = empty_scan(harness.platform, seq, clock(now) if topic == "scan" else now)
        return structs.replace(scan, ranges=np.full(len(scan.ranges), 2.0 + 1e-4 * seq))

    harness.advance(6.0)  # the delay of the scans is known
    held, harness.scans = set[Reason | None](), scans
    for tick in range(80):
        if topic == "odometry":
            harness.odometry = None
            harness.step(OdometryInput(Odometry(clock(harness.now), Pose(0.01 * tick), Twist())))
        harness.advance(0.05)
        held.add(harness.status.reason)
    assert held - {None, Reason.NO_REQUESTED_COMMAND} == {reason}
    assert standing_state(harness) == (State.STOPPED, reason)


@pytest.mark.parametrize("fault", ["lost scans", "unknown rays", "other rays"])
def test_small_faults_of_a_sensor_do_not_stop(fault: str) -> None:
    harness = started()

    def faulty(seq: int, now: float) -> Scan | None:
        scan = empty_scan(harness.platform, seq, now)
        if fault == "lost scans":
            return None if seq % 3 == 0 else scan
        n = 350 + 5 * (seq % 4)
        bearings = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
        ranges = np.full(n, 2.0 + 1e-6 * seq)
        return structs.replace(scan, ranges=ranges, bearings=bearings, ages=None)

    harness.scans = harness.nan_scan(0.1) if fault == "unknown rays" else faulty
    harness.commands.clear()
    harness.advance(10.0)
    assert all(twist == Twist(0.2) for _, twist in harness.commands)


def test_returned_driver_does_not_start_a_stopped_robot() -> None:
    harness = started()
    harness.step(DriverInput(False, "cable"))
    assert harness.twist.is_zero
    assert harness.status.reason is Reason.DRIVER_LOST
    harness.advance(2.2)
    assert standing_state(harness) == (State.STOPPED, Reason.DRIVER_LOST)
    harness.step(DriverInput(True, "there"))
    harness.advance(2.0)
    assert harness.twist.is_zero


def test_protection_acts_only_while_running() -> None:
    harness = started()
    harness.scans = lambda seq, now: structs.replace(
        empty_scan(harness.platform, seq, now),
        ranges=np.where(np.abs(np.arange(360) - 180) > 150, 0.3, np.inf),
    )
    harness.advance(0.5)
    assert harness.twist.linear < 0.0
    assert harness.status.decision.is_active
    harness.ask("stop")
    harness.advance(1.0)
    assert harness.twist.is_zero


def test_context_is_made_once_for_a_time_and_new_for_new_inputs() -> None:
    platform = load_platform("waffle_pi")
    sensors = Sensors(platform)
    first = sensors.context(1.0)
    assert sensors.context(1.0) is first
    sensors.on_odometry(Odometry(1.0, Pose(), Twist()), 1.0)
    second = sensors.context(1.0)
    assert (second.odometry_age, first.odometry_age) == (0.0, None)
    sensors.on_scan(empty_scan(platform, 1, 1.0), 1.0)
    assert sensors.context(1.0).scan_age == 0.0
    assert sensors.context(1.1).scan_age == pytest.approx(0.1)
