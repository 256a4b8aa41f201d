"""The report of a check of a ROS robot, without links; the drivers' tests have real links."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.finding import Finding
from swarmd.core.messages import Reason
from swarmd.core.values import Array, Scan, Value
from swarmd.drivers.ros import messages
from swarmd.drivers.ros.diagnosis import DriverCheck, Graph, Middleware, has_enough
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros.foreign_commands import ROS2_ACTIONS, ForeignCommands
from swarmd.drivers.ros.options import Ros1Options, TopicOptions, read_options
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros.topic_stats import TopicStats
from swarmd.drivers.ros1.adapter import ForeignMessage, MasterState
from swarmd.drivers.ros1.master_graph import MasterGraph, Ros1
from swarmd.drivers.ros1.serialization import type_name
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.drivers.ros2.rmw_zenoh import RmwZenoh
from swarmd.settings.platforms import load_platform
from tests.support.range_ring import with_ring

BURGER = load_platform("burger")
SPEC = BURGER.scan
RANGES = np.full(360, 1.0)
STEADY = [(0.2 * i, 50.0 + 0.2 * i) for i in range(6)]
both = pytest.mark.parametrize("middleware", [Ros1(), Ros2Dds()], ids=["ros1", "ros2"])


def received(
    scans: Iterable[tuple[float, float]] = STEADY,
    odometries: int = 5,
    *,
    ranges: Array = RANGES,
    noise: float = 0.001,
    **options: Any,
) -> Subscriptions:
    """Scans with these arrivals and stamps, each `noise` m farther than the one before."""
    made = Subscriptions(TopicOptions(**options), BURGER)
    for seq, (now, stamp) in enumerate(scans):
        made.topics["scan"].record(now, stamp)
        given = SPEC.bearings, SPEC.range_min, SPEC.range_max
        made.contents["scan"].take(Scan(seq, stamp, ranges + noise * seq, *given))
    for count in range(odometries):
        made.topics["odometry"].record(0.1 * count, 0.1 * count)
    return made


def found(
    middleware: Middleware,
    subscriptions: Subscriptions,
    graph: Iterable[Endpoint] = (),
    *,
    has_subscriber: bool = True,
    foreign: ForeignCommands | None = None,
    command_types: Sequence[type] = (messages.Twist,),
    **others: Any,
) -> dict[str, Finding]:
    report = DriverCheck(
        graph=Graph(middleware=middleware, endpoints=list(graph)),
        endpoint="here",
        subscriptions=subscriptions,
        spec=BURGER.scan,
        cmd_vel="/cmd_vel",
        command_types=command_types,
        foreign=foreign or ForeignCommands(TopicOptions(), ROS2_ACTIONS),
        has_subscriber=has_subscriber,
        now=0.0,
        **others,
    )
    return {finding.subject: finding for finding in report.findings()}


def end(middleware: Middleware, kind: type, topic: str, *, is_publisher: bool) -> Endpoint:
    return Endpoint(is_publisher, topic, middleware.type_name(kind), node="/node")


@both
def test_a_robot_whose_topics_arrive_has_no_faults(middleware: Middleware) -> None:
    well = found(middleware, received())
    assert all(finding.is_well for finding in well.values())
    told = "360 rays, 100 % with a return, the nearest at 1.00 m, scans differ"
    assert f"5.0 Hz, {told}, stamps advanced by 1.0 s in 1.0 s" in well["scan"].text


@both
@pytest.mark.parametrize(
    ("ranges", "noise", "part"),
    [
        (0.0 * RANGES, 0.0, "360 ranges are 0; look at"),
        (np.inf * RANGES, 0.0, "none of 360 rays has a return within 3.5 m; hold"),
        (RANGES, 0.0, "scans are identical"),
    ],
    ids=["zeros", "no return", "identical"],
)
def test_scans_that_no_sensor_measures_are_a_fault(
    middleware: Middleware, ranges: Array, noise: float, part: str
) -> None:
    scan = found(middleware, received(ranges=ranges, noise=noise))["scan"]
    assert not scan.is_well
    assert "/scan: " in scan.text
    assert part in scan.text


@both
@pytest.mark.parametrize(
    ("ratio", "part", "is_well"),
    [
        (0.4, "0.40 of real time", False),  # a slow simulator: scans come at 2 Hz
        (1.0, "1.00 of real time", True),
        (3.0, "3.00 of real time, so that the robot reacts 3.0 times", True),
    ],
)
def test_the_clock_of_the_stamps_has_its_ratio_and_no_rate_is_to_be_corrected(
    middleware: Middleware, ratio: float, part: str, is_well: bool
) -> None:
    scans = [(0.2 * i / ratio, 50.0 + 0.2 * i) for i in range(6)]
    lines = found(middleware, received(scans))
    assert part in lines["scan values"].text
    assert list(lines).index("scan values") < list(lines).index("scan")
    assert lines["scan"].is_well is is_well
    assert is_well or part in lines["scan"].text
    assert "correct" not in lines["scan"].text


@both
@pytest.mark.parametrize("code", [-1.0, np.nan])
def test_unknown_rays_are_named_and_no_setting_hides_them(
    middleware: Middleware, code: float
) -> None:
    ranges = np.where(np.arange(360) < 100, code, 1.0 + 0.001 * np.arange(360))
    text = found(middleware, received(ranges=ranges, noise=0.0))["scan"].text
    assert f"{code:g} 28 % (unknown" in text
    assert "correct" not in text
    assert "noisy" not in text


@both
def test_a_lidar_and_a_ring_have_a_line_each(middleware: Middleware) -> None:
    """A ring that is too slow for its own section, and a lidar that is frozen, are told apart."""
    options = TopicOptions(ranges={"a": 0.0, "b": 90.0})
    subscriptions = Subscriptions(options, with_ring(BURGER))
    for seq, (now, stamp) in enumerate(STEADY):
        for topic in ("scan", "ranges.a", "ranges.b"):
            subscriptions.topics[topic].record(now, stamp)
        given = SPEC.bearings, SPEC.range_min, SPEC.range_max
        subscriptions.contents["scan"].take(Scan(seq, stamp, RANGES, *given))
        near = np.array([0.5 + 0.01 * seq, np.inf])
        ring = Scan(seq, stamp, near, np.array([0.0, 1.6]), 0.05, 1.0)
        subscriptions.contents["ranges"].take(ring)
    lines = found(middleware, subscriptions)
    assert "frozen_scan" in lines["scan"].text
    assert not lines["ranges.a"].is_well
    assert "the platform's ranges.rate is 20" in lines["ranges.a"].text
    assert lines["ranges"].is_well


def test_silent_topic_names_the_domain_that_has_it() -> None:
    middleware = RmwZenoh(0, "/cmd_vel")
    elsewhere = Endpoint(True, "/scan", middleware.type_name(messages.LaserScan), domain=7)
    graph = Graph(middleware=middleware, endpoints=[elsewhere])
    text = graph.silence(received([]).topics["scan"])
    assert "in 7;" in text
    assert "driver_options.domain" in text


def test_an_unreachable_hub_is_the_only_finding() -> None:
    assert list(found(Ros1(), received(), connection_fault="refused")) == ["connection"]


@both
@pytest.mark.parametrize(
    ("scans", "subject"),
    [
        ([(0.2 * i, 5.0) for i in range(6)], "stamp 5;"),
        ([(0.2 * i, 1763711479.5) for i in range(6)], "stamp 1763711479.5;"),
        ([(0.5 * i, 0.5 * i) for i in range(6)], "2.0 Hz"),
        ([], "no topic"),
    ],
)
def test_scans_that_cannot_be_relied_on_are_a_fault(
    middleware: Middleware, scans: list[tuple[float, float]], subject: str
) -> None:
    scan = found(middleware, received(scans))["scan"]
    assert not scan.is_well
    assert subject in scan.text


@pytest.mark.parametrize(("period", "is_well"), [(0.38, True), (0.42, False)])
def test_scans_below_half_the_rate_of_the_platform_are_too_slow(
    period: float, is_well: bool
) -> None:
    scans = [(period * i, period * i) for i in range(6)]
    assert found(Ros2Dds(), received(scans))["scan"].is_well is is_well


@pytest.mark.parametrize(("unseen", "is_well"), [(0, True), (30, False), (360, False)])
def test_a_scan_that_leaves_too_much_unseen_is_a_fault(unseen: int, is_well: bool) -> None:
    ranges = RANGES.copy()
    ranges[:unseen] = np.nan
    assert found(Ros1(), received(ranges=ranges))["scan"].is_well is is_well


@both
def test_an_optional_topic_without_messages_is_reported_and_no_fault(
    middleware: Middleware,
) -> None:
    subscriptions = received(battery="battery_state")
    battery = found(middleware, subscriptions)["battery"]
    assert battery.is_well
    assert "/battery_state" in battery.text


@both
def test_a_topic_that_was_silent_since_its_last_change_is_told_apart(
    middleware: Middleware,
) -> None:
    kind = Subscriptions(TopicOptions(), BURGER).topics["scan"].message_type
    for stale_after, subject in (("never", "not latched"), (1.0, "silent")):
        entry = {"topic": "dock", "type": "sensor_msgs/LaserScan", "field": "range_max"}
        read = read_options(
            Ros1Options, {"readings": {"x": {**entry, "stale_after": stale_after}}}, "ros1", "r"
        )
        stats = Subscriptions(read, BURGER).topics["readings.x"]
        ends = [end(middleware, kind, "/dock", is_publisher=True)]
        assert subject in Graph(middleware=middleware, endpoints=ends).silence(stats)


@both
@pytest.mark.parametrize(
    ("nodes", "subject"),
    [(1, "its clock was set"), (2, "its clock was set"), (0, "two publish it")],
)
def test_a_clock_that_was_set_is_no_second_publisher(
    middleware: Middleware, nodes: int, subject: str
) -> None:
    """Of one node that is known only the check fails: no run ends for a second source."""
    setback = [(0.0, 50.0), (0.2, 50.2), (0.4, 49.0), (0.6, 49.2), (0.8, 48.0)]
    ends = [end(middleware, messages.LaserScan, "/scan", is_publisher=True)] * nodes
    subscriptions = received(setback)
    scan = found(middleware, subscriptions, ends)["scan"]
    assert not scan.is_well
    assert subject in scan.text
    graph = Graph(middleware=middleware, endpoints=ends)
    conflict = graph.conflict(subscriptions.topics.values(), SPEC)
    assert (conflict is None) is bool(nodes), "only the check fails where one node is known"


@both
@pytest.mark.parametrize(
    "pairs",
    [
        pytest.param([(0.0, 50.0), (0.2, 50.2), (0.4, 49.0), (0.6, 49.2), (0.8, 48.0)], id="back"),
        pytest.param([(0.1 * k, 50.0 + 0.1 * k) for k in range(20)], id="too often"),
    ],
)
def test_signs_of_a_second_publisher_end_soon_after_its_last_message(
    middleware: Middleware, pairs: list[tuple[float, float]]
) -> None:
    topics = received(pairs).topics.values()

    def reason(now: float) -> Reason | None:
        conflict = Graph(middleware=middleware, endpoints=[], now=now).conflict(topics, SPEC)
        return None if conflict is None else conflict.reason

    last = pairs[-1][0]
    assert reason(last + 1.0) is Reason.SCAN_CONFLICT
    assert reason(last + 3.0) is None


@both
@pytest.mark.parametrize(
    ("topic", "period", "messages_a_stamp", "is_well"),
    [
        ("scan", 0.2, 2, True),
        ("scan", 0.2, 3, False),
        ("scan", 0.2, 5, False),  # stamps without nanoseconds
        ("scan", 0.025, 3, True),
        ("odometry", 0.04, 5, True),
        ("odometry", 0.04, 25, False),
    ],
)
def test_a_stamp_of_several_messages_is_a_fault_if_too_few_count(
    middleware: Middleware, topic: str, period: float, messages_a_stamp: int, is_well: bool
) -> None:
    subscriptions = received([] if topic == "scan" else STEADY, 0 if topic == "odometry" else 5)
    if topic == "scan":
        times = [(period * i, period * (i // messages_a_stamp)) for i in range(16)]
        subscriptions = received(times)
    for i in range(64 if topic == "odometry" else 0):
        stamp = period * messages_a_stamp * (i // messages_a_stamp)
        subscriptions.topics["odometry"].record(period * i, stamp)
    line = found(middleware, subscriptions)[topic]
    assert is_well or not line.is_well
    assert ("have one stamp" in line.text) is not is_well


@both
def test_messages_that_cannot_be_read_are_a_fault(middleware: Middleware) -> None:
    subscriptions = received()
    subscriptions.topics["scan"].record_fault(1.0, "12 bytes")
    scan = found(middleware, subscriptions)["scan"]
    assert not scan.is_well
    assert "12 bytes" in scan.text


@both
def test_the_topics_of_the_expected_type_are_named(middleware: Middleware) -> None:
    ends = [
        end(middleware, messages.LaserScan, topic, is_publisher=True) for topic in ("/b", "/a/scan")
    ]
    assert "/a/scan, /b" in found(middleware, received([]), ends)["scan"].text


@both
def test_a_topic_of_another_type_is_a_fault(middleware: Middleware) -> None:
    ends = [end(middleware, messages.Imu, "/scan", is_publisher=True)]
    scan = found(middleware, received([]), ends)["scan"]
    assert not scan.is_well
    assert middleware.type_name(messages.Imu) in scan.text


@both
def test_two_publishers_of_a_needed_topic_are_a_fault(middleware: Middleware) -> None:
    one = end(middleware, messages.LaserScan, "/scan", is_publisher=True)
    other = dataclasses.replace(one, node="/other")
    text = found(middleware, received(), [one, other])["scan"].text
    assert text.startswith("2 nodes publish /scan: /node, /other; ")
    assert found(middleware, received(), [one, one])["scan"].is_well, "listed twice"


@both
def test_commands_of_another_node_are_a_fault_and_a_publisher_is_named(
    middleware: Middleware,
) -> None:
    heard = ForeignCommands(TopicOptions(), ROS2_ACTIONS)
    heard.take_command("/cmd_vel", bytes(52), (), 0.0)
    assert not found(middleware, received(), foreign=heard)["last_word"].is_well
    others: dict[str, Any] = {"foreign_publishers": ["/teleop"]}
    silent = found(middleware, received(), **others)["last_word"]
    assert silent.is_well
    assert "/teleop" in silent.text
    exclusive = found(middleware, received(), is_exclusive=True, **others)["last_word"]
    assert not exclusive.is_well
    assert "/teleop" in exclusive.text


@both
def test_a_multiplexer_that_takes_the_commands_is_named(middleware: Middleware) -> None:
    base = end(middleware, messages.Twist, "/cmd_vel", is_publisher=False)
    mux = dataclasses.replace(base, node="/twist_mux")
    assert "mux" not in found(middleware, received(), [base])["last_word"].text
    some: tuple[dict[str, Any], ...] = ({}, {"foreign_publishers": ["/teleop"]})
    for more in some:
        line = found(middleware, received(), [mux], **more)["last_word"]
        assert line.is_well
        assert "/twist_mux" in line.text
        assert "priority" in line.text


@both
@pytest.mark.parametrize(
    ("kind", "topic", "has_subscriber", "subject"),
    [
        (messages.Twist, "/cmd_vel", False, ""),
        (messages.TwistStamped, "/cmd_vel", True, "cmd_vel_type: twist_stamped"),
        (messages.Imu, "/cmd_vel", True, "cmd_vel_type"),
        (messages.Twist, "/a/cmd_vel", False, "/a/cmd_vel"),
        (None, "", False, "start the base"),
        (None, "", True, ""),
    ],
)
def test_a_base_that_gets_no_command_is_a_fault(
    middleware: Middleware, kind: type | None, topic: str, has_subscriber: bool, subject: str
) -> None:
    ends = [end(middleware, kind, topic, is_publisher=False)] if kind else []
    finding = found(middleware, received(), ends, has_subscriber=has_subscriber)["cmd_vel"]
    assert finding.is_well is not bool(subject)
    assert subject in finding.text


STAMPED_TOO = (messages.Twist, messages.TwistStamped)


@both
@pytest.mark.parametrize("kind", STAMPED_TOO)
def test_the_type_of_commands_is_that_of_the_base(middleware: Middleware, kind: type) -> None:
    base = dataclasses.replace(
        end(middleware, kind, "/cmd_vel", is_publisher=False), quality="best effort"
    )
    other = end(middleware, messages.Twist, "/cmd_vel_stamped", is_publisher=False)
    line = found(middleware, received(), [base, other], command_types=STAMPED_TOO)["cmd_vel"]
    assert line.is_well
    assert f"({middleware.type_name(kind)}, best effort)" in line.text


@both
@pytest.mark.parametrize(
    ("kinds", "has_subscriber", "words"),
    [
        (STAMPED_TOO, True, "is not clear: /node wants"),
        ((messages.Imu,), True, "wants"),
        ((), True, "nothing announces the type"),
        ((), False, "no node subscribes"),
    ],
)
def test_without_one_type_that_the_base_wants_there_is_no_command(
    middleware: Middleware, kinds: Sequence[type], has_subscriber: bool, words: str
) -> None:
    ends = [end(middleware, kind, "/cmd_vel", is_publisher=False) for kind in kinds]
    graph = Graph(middleware=middleware, endpoints=ends)
    assert graph.command_type("/cmd_vel", STAMPED_TOO) is None
    text = graph.no_subscriber("/cmd_vel", STAMPED_TOO, has_subscriber=has_subscriber)
    assert words in text
    assert "cmd_vel" in text


def test_a_check_has_enough_after_a_second_and_5_messages_a_needed_topic() -> None:
    assert has_enough(received(), 1.0)
    assert not has_enough(received(), 0.99)
    assert not has_enough(received(STEADY[:4]), 5.0)


# The graph of a ROS 1 master

MASTER = MasterState(
    master=True,
    publishers={"/scan": ["/lidar"], "/odom": ["/base"]},
    types={"/scan": "sensor_msgs/LaserScan", "/odom": "nav_msgs/Odometry"},
    listeners=["/base"],
    connected=1,
)


def master_graph(state: MasterState = MASTER, **options: Value) -> MasterGraph:
    read = read_options(Ros1Options, options, "ros1", "r")
    made = MasterGraph(read, Subscriptions(read, BURGER).topics)
    made.state = state
    return made


def silence(made: MasterGraph) -> str:
    return made.graph().silence(TopicStats("scan", "scan", "/scan", messages.LaserScan))


@pytest.mark.parametrize(
    ("state", "subject"),
    [
        (MASTER, "/scan is announced but silent"),
        (replace(MASTER, types={}), "/scan is announced but silent"),
        (replace(MASTER, publishers={}), "no /scan"),
        (replace(MASTER, types={"/scan": "sensor_msgs/PointCloud"}), "sensor_msgs/PointCloud"),
        (
            replace(
                MASTER, publishers={"/scan": []}, candidates={"sensor_msgs/LaserScan": ["/a", "/b"]}
            ),
            "/a, /b",
        ),
    ],
)
def test_a_topic_without_messages_is_explained_by_the_master(
    state: MasterState, subject: str
) -> None:
    assert subject in silence(master_graph(state))


def test_another_md5_sum_of_the_same_name_is_another_type() -> None:
    made, kind = master_graph(), type_name(messages.LaserScan)
    made.on_foreign(ForeignMessage("/scan", "/lidar", kind, "0" * 32))
    assert "0" * 32 in silence(made)
    made.on_state(MASTER)
    assert "0" * 32 not in silence(made)


@pytest.mark.parametrize(
    ("kind", "fault"),
    [("", ""), ("*", ""), ("geometry_msgs/Twist", ""), ("geometry_msgs/TwistStamped", "wants")],
)
def test_a_listener_whose_type_is_unknown_counts_as_right(kind: str, fault: str) -> None:
    state = replace(MASTER, connected=0, wants={"/base": kind})
    graph = master_graph(state, cmd_vel_type="twist").graph()
    text = graph.no_subscriber("/cmd_vel", [messages.Twist], has_subscriber=True)
    assert bool(text) is bool(fault)
    assert fault in text


def test_another_publisher_of_commands_blocks_unless_it_is_permitted() -> None:
    others = replace(MASTER, others=["/teleop"])
    assert master_graph(others).blocks
    assert not master_graph(others, shared_cmd_vel=True).blocks
    assert not master_graph().blocks


# Statistics of one topic


@pytest.fixture
def stats() -> TopicStats:
    return TopicStats("scan", "scan", "/scan", messages.LaserScan)


def test_a_fault_is_recent_for_2_s(stats: TopicStats) -> None:
    stats.record_fault(0.5, "rubbish")
    stats.record_fault(1.0, "other rubbish")  # of a series the first: a text that varies is no news
    assert (stats.recent_fault(2.99), stats.recent_fault(3.0)) == ("rubbish", "")


def test_stamps_advance_only_if_the_last_is_later(stats: TopicStats) -> None:
    for stamp in (5.0, 5.0):
        stats.record(stamp, stamp)
    assert stats.stamps_advance(), "too few to decide"
    stats.record(6.0, 5.0)
    assert not stats.stamps_advance()
    stats.record(7.0, 5.5)
    assert stats.stamps_advance()


@pytest.mark.parametrize(("seconds", "go_back"), [(9.0, True), (11.0, False)])
def test_stamps_that_go_back_twice_within_10_s_are_those_of_two_publishers(
    stats: TopicStats, seconds: float, go_back: bool
) -> None:
    for now, stamp in ((0.0, 5.0), (1.0, 4.0), (1.0 + seconds, 3.0)):
        stats.record(now, stamp)
    assert stats.stamps_go_back() is go_back
