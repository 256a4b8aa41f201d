"""The nodes that a bridge lists: pure histories of them, and a stand-in hub that lists its own."""

from __future__ import annotations

import asyncio
import json
import random
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import pytest
import zenoh

from swarmd.core.messages import Reason
from swarmd.core.values import Twist
from swarmd.drivers.ros.diagnosis import Conflict, Graph
from swarmd.drivers.ros.endpoints import Endpoint, with_nodes
from swarmd.drivers.ros.messages import Twist as TwistMessage
from swarmd.drivers.ros.messages import TwistStamped
from swarmd.drivers.ros.options import TopicOptions
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros2.admin_space import (
    MAX_AGE,
    MAX_FIRST,
    NAMING_TIME,
    PERIOD,
    WATCH_PERIOD,
    NodeList,
)
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import DriverHarness
from tests.drivers.ros2.harness import check, drive, reported
from tests.drivers.ros2.robots import BridgedRobot, open_session
from tests.support.stories import story

pytestmark = pytest.mark.long

LASER, TWIST = "sensor_msgs/msg/LaserScan", "geometry_msgs/msg/Twist"
ODOMETRY = "nav_msgs/msg/Odometry"
BASE = {"publishers": [], "subscribers": [{"name": "/cmd_vel", "type": TWIST}]}
LIDAR = {"publishers": [{"name": "/scan", "type": LASER}], "subscribers": []}
BURGER = load_platform("burger")
DDS_LEASE = 10.0

Answers = dict[str, bytes]


def answers(
    *nodes: tuple[str, Mapping[str, object]], zid: str = "ab", namespace: str = "/"
) -> Answers:
    """What bridge `zid` answers; nodes such as `("01/base", BASE)`."""
    config = {"namespace": namespace, "nodename": "zenoh_bridge_ros2dds", "domain": 0}
    return {
        f"@/{zid}/ros2/config": json.dumps(config).encode(),
        **{f"@/{zid}/ros2/node/{key}": json.dumps(node).encode() for key, node in nodes},
    }


def conflict(
    listed: NodeList,
    now: float,
    zids: Collection[str] = ("ab",),
    ends: Collection[str] = ("MP", "MS"),
    **options: object,
) -> Conflict | None:
    """What a robot is held for whose scan (MP) and commands (MS) these bridges announce."""
    scheme = Ros2Dds()
    tokens = [
        f"@/{zid}/@ros2_lv/{token}"
        for zid in zids
        for token in (
            "MP/scan/sensor_msgs§msg§LaserScan/:::1,5",
            "MS/cmd_vel/geometry_msgs§msg§Twist/:::1,5",
        )
        if token[:2] in ends
    ]
    announced = [end for end in map(scheme.parse_token, tokens) if end is not None]
    read = TopicOptions(**options)  # type: ignore[arg-type]  # of the test's own keywords
    graph = Graph(
        middleware=scheme,
        endpoints=with_nodes(announced, listed.endpoints, now),
        strays=listed.strays,
        options=read,
        now=now,
    )
    return graph.conflict(Subscriptions(read, BURGER).topics.values(), BURGER.scan)


def reason(listed: NodeList, now: float) -> Reason | None:
    """The reason of `conflict`; None without a conflict."""
    found = conflict(listed, now)
    return None if found is None else found.reason


def listed_once(given: Answers, now: float = 0.0) -> NodeList:
    made = NodeList()
    made.take(given, {"ab"}, now)
    return made


@pytest.mark.parametrize(
    ("given", "wanted", "words"),
    [
        ([("01/base", BASE)], None, ""),
        ([("01/base", BASE), ("01/lidar", LIDAR)], None, ""),
        ([("01/base", BASE), ("02/other", BASE)], Reason.BASE_CONFLICT, "/base, /other"),
        ([("01/r1/base", BASE), ("02/r2/base", BASE)], Reason.BASE_CONFLICT, "/r1/base, /r2/base"),
        ([("01/base", BASE), ("02/base", BASE)], Reason.BASE_CONFLICT, "named /base"),
        ([("01/base", BASE), ("02/a", LIDAR), ("03/b", LIDAR)], Reason.SCAN_CONFLICT, "/a, /b"),
        *(
            ([("01/base", BASE), (f"02/{name}", BASE)], None, "")
            for name in (
                "rosbag2_recorder",
                "r1/rosbag2_recorder_3",
                "_ros2cli_1234",
                "rviz2",
                "rqt_gui_py_node_77",
                "foxglove_bridge",
                "zenoh_bridge_ros2dds",
                "r1/zenoh_bridge_ros2dds",
            )
        ),
    ],
)
def test_two_nodes_that_take_commands_or_publish_scans_are_a_conflict(
    given: list[tuple[str, Mapping[str, object]]], wanted: Reason | None, words: str
) -> None:
    found = conflict(listed_once(answers(*given)), 0.0)
    assert (found and found.reason) == wanted
    assert words in (found.text if found else "")


@pytest.mark.parametrize("given", [("/estimator",), ("estim*",), ("x", "estimator")])
def test_a_node_that_is_named_as_a_listener_is_no_second_base(given: tuple[str, ...]) -> None:
    both = listed_once(answers(("01/base", BASE), ("02/estimator", BASE)))
    assert reason(both, 0.0) is Reason.BASE_CONFLICT
    assert conflict(both, 0.0, cmd_vel_listeners=given) is None


@pytest.mark.parametrize(
    ("first", "second", "end", "wanted"),
    [
        (("01/base", BASE), ("01/base", BASE), "MS", None),
        (("01/base", BASE), ("02/base2", BASE), "MS", Reason.BASE_CONFLICT),
        (("01/l", LIDAR), ("01/l", LIDAR), "MP", Reason.SCAN_CONFLICT),
        (None, None, "MS", Reason.BASE_CONFLICT),
    ],
    ids=["one base", "two bases", "scans that both hand on", "without lists"],
)
def test_two_bridges_of_one_domain(
    first: tuple[str, Any] | None, second: Any, end: str, wanted: Reason | None
) -> None:
    made = NodeList()
    if first is not None:
        made.take({**answers(first), **answers(second, zid="cd")}, (), 0.0)
    found = conflict(made, 0.0, ("ab", "cd"), [end])
    assert (found and found.reason) == wanted
    assert end == "MS" or "2 bridges" in (found.text if found else "")


def test_bases_behind_two_bridges_with_namespaces_are_two_robots() -> None:
    """Each lists `/cmd_vel`; only the first bridge's is this robot's."""
    made = NodeList()
    first = answers(("01/base", BASE), namespace="/tb3_01")
    made.take({**first, **answers(("02/base", BASE), zid="cd", namespace="/tb3_02")}, (), 0.0)
    assert {end.topic for end in made.endpoints} == {"/tb3_01/cmd_vel", "/tb3_02/cmd_vel"}


def test_a_node_without_an_announcement_is_not_routed() -> None:
    """As after the end of one of two nodes of a name: the bridge withdraws both."""
    listed = listed_once(answers(("01/base", BASE))).endpoints
    graph = Graph(middleware=Ros2Dds(), endpoints=with_nodes([], listed, 0.0))
    assert not graph.bases("/cmd_vel")
    twist = TopicOptions().command_types
    text = graph.no_subscriber("/cmd_vel", twist, has_subscriber=False)
    assert text.startswith("/base takes /cmd_vel, but zenoh-bridge-ros2dds does not hand it on")


def test_a_base_of_another_type_than_the_route_gets_no_commands() -> None:
    """The bridge keeps the type of the first node, and its bytes would move a base of that type."""
    stamped = {"publishers": [], "subscribers": [{"name": "/cmd_vel", "type": f"{TWIST}Stamped"}]}
    token = "@/ab/@ros2_lv/MS/cmd_vel/geometry_msgs§msg§Twist/:::1,5"
    route = Ros2Dds().parse_token(token)
    assert route is not None

    def fault(*nodes: tuple[str, Mapping[str, object]], **options: object) -> tuple[str, bool]:
        ends = with_nodes([route], listed_once(answers(*nodes)).endpoints, 0.0)
        graph = Graph(middleware=Ros2Dds(), endpoints=ends)
        types = TopicOptions(**options).command_types  # type: ignore[arg-type]
        text = graph.no_subscriber("/cmd_vel", types, has_subscriber=True)
        return text, graph.command_type("/cmd_vel", types) is not None

    for kind in ("auto", "twist_stamped"):
        text, _ = fault(("02/other", stamped), cmd_vel_type=kind)
        assert text.startswith("/other takes /cmd_vel, but zenoh-bridge-ros2dds does not hand it")
    assert fault(("02/other", stamped))[1] is False
    assert "is not clear" in fault(("01/base", BASE), ("02/other", stamped))[0]
    assert fault(("01/base", BASE)) == ("", True)


def test_a_list_that_is_older_than_an_announcement_does_not_tell_its_type() -> None:
    """A base that returns with another type would read a stamped command as 1e180 m/s."""
    stamped = "geometry_msgs/msg/TwistStamped"
    base = Endpoint(False, "/cmd_vel", TWIST, zid="ab", since=5.0)
    listed = [Endpoint(False, "/cmd_vel", stamped, zid="ab", node="/base", process="01")]
    types: dict[float, type | None] = {}
    for listed_at in (4.9, 5.0):
        graph = Graph(middleware=Ros2Dds(), endpoints=with_nodes([base], listed, listed_at))
        types[listed_at] = graph.command_type("/cmd_vel", (TwistMessage, TwistStamped))
    assert types == {4.9: TwistMessage, 5.0: None}


JUNK = (b"", b"\xff", b"[]", b"{}", b'{"subscribers": [{"name": 1}]}', b"[" * 9999, b'"\xff"')


@pytest.mark.parametrize("junk", JUNK)
def test_junk_is_left_out(junk: bytes) -> None:
    whole = answers(("01/base", BASE))
    made = listed_once({**whole, "@/ab/ros2/node/02/base": junk, "@": junk, "@/ros2": junk})
    assert len(made.endpoints) == 1
    assert not listed_once({**whole, "@/ab/ros2/config": junk}).endpoints


# Readers in DDS without a node


def in_dds(*readers: str, process: str = "", kind: str = "reader", is_ros: bool = True) -> Answers:
    """What bridge `ab` answers of the participants in DDS that read the commands."""
    told = {"topic_name": "rt/cmd_vel", "type_name": "geometry_msgs::msg::dds_::Twist_", "qos": {}}
    qos: dict[str, object] = {"properties": {"__ProcessName": process} if process else {}}
    about = {"qos": {**qos, "user_data": list(b"enclave=/;")} if is_ros else qos}
    root = "@/ab/ros2/dds"
    return {
        **{f"{root}/{one}/{kind}/{one}04/rt/cmd_vel": json.dumps(told).encode() for one in readers},
        **{f"{root}/{one}": json.dumps(about).encode() for one in readers},
    }


def with_readers(given: Answers, named_for: float = NAMING_TIME) -> NodeList:
    """A list after two equal answers."""
    made = listed_once(given)
    made.take(given, {"ab"}, named_for)
    return made


BRIDGE = ("02/zenoh_bridge_ros2dds", BASE)


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ({**answers(("01/base", BASE)), **in_dds("01", "02")}, "/dds_reader"),
        (
            {**answers(("01/base", BASE)), **in_dds("01", "02", process="mover")},
            "/dds_reader_mover",
        ),
        ({**answers(("01/base", BASE), BRIDGE), **in_dds("01", "02")}, "/zenoh_bridge_ros2dds"),
        ({**answers(("01/base", BASE), ("02/b", LIDAR)), **in_dds("01", "02")}, "/dds_reader"),
    ],
    ids=["no process", "a process", "another bridge", "a node that takes no commands"],
)
def test_a_reader_of_commands_that_is_no_nodes_is_a_conflict_unless_it_is_named_as_a_listener(
    given: Answers, name: str
) -> None:
    found = conflict(with_readers(given), NAMING_TIME)
    assert found is not None
    assert found.reason is Reason.BASE_CONFLICT
    assert found.text.startswith(f"{name} takes /cmd_vel: ")
    for listener in (name, name.removeprefix("/"), "dds_reader*"):
        held = conflict(with_readers(given), NAMING_TIME, cmd_vel_listeners=(listener,))
        assert (held is None) is (listener in name or "reader" in name)


@pytest.mark.parametrize(
    "given",
    [
        in_dds("01"),
        in_dds("01", "02", kind="writer"),
        {key.replace("cmd_vel", "b/cmd_vel"): told.replace(b"cmd_vel", b"b/cmd_vel")
         for key, told in in_dds("02").items()},
        {key: b"[]" for key in in_dds("02")},
        in_dds("01\n", "02", process="a\nb", kind="writer"),
    ],
    ids=["the base's own", "a writer", "another topic", "junk", "names with a line"],
)  # fmt: skip
def test_what_else_is_in_dds_is_no_conflict(given: Answers) -> None:
    made = with_readers({**answers(("01/base", BASE)), **given})
    assert conflict(made, NAMING_TIME) is None


def test_a_reader_has_time_to_get_the_name_of_its_node() -> None:
    """A node's reader is found in DDS before the node is listed, and may outlive it."""
    base, recorder = ("01/base", BASE), ("02/rosbag2_recorder", BASE)
    made = listed_once({**answers(base), **in_dds("01")})
    made.take({**answers(base), **in_dds("01")}, {"ab"}, 0.5)
    assert not made.is_awaited({"ab"})
    steps = [
        (answers(base), True),
        (answers(base), True),
        (answers(base, recorder), False),
        (answers(base), True),
    ]
    for count, (listed, is_naming) in enumerate(steps):
        now = 9.0 + 0.9 * NAMING_TIME * count
        made.take({**listed, **in_dds("01", "02")}, {"ab"}, now)
        assert made.is_naming is made.is_awaited({"ab"}) is is_naming
        assert conflict(made, now) is None
    made.take({**answers(base), **in_dds("01", "02")}, {"ab"}, now + NAMING_TIME)
    assert reason(made, now + NAMING_TIME) is Reason.BASE_CONFLICT


def test_a_reader_in_a_process_that_is_not_of_ros_has_no_time() -> None:
    base, others = answers(("01/base", BASE)), in_dds("02", is_ros=False)
    made = listed_once({**base, **others})
    assert reason(made, 0.0) is Reason.BASE_CONFLICT
    made.take({**base, **in_dds("01"), "@/ab/ros2/dds/02": b"{}"}, {"ab"}, 1.0)
    assert conflict(made, 1.0) is None


def test_a_reader_that_is_still_unnamed_as_the_bridge_falls_silent_is_a_conflict() -> None:
    made = listed_once({**answers(("01/base", BASE)), **in_dds("01", "02")})
    assert conflict(made, 0.0) is None
    made.take(None, {"ab"}, NAMING_TIME)
    assert reason(made, NAMING_TIME) is Reason.BASE_CONFLICT


NOT_OF_ROS = "", "zenoh_bridge_ros2dds"


class Readers:
    """Who reads the commands of a base in DDS: tools, bases, other bridges, programs without ROS.

    Each has a reader from its start on. A node is listed up to 0.3 s later, and its reader stays up
    to 0.3 s after it.
    """

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.now, self.count = 0.0, 0
        self.there: dict[str, tuple[str, float, float, float]] = {}  # name, reader, node, end

    def step(self) -> None:
        self.now += WATCH_PERIOD
        self.there = {one: seen for one, seen in self.there.items() if self.now < seen[3]}
        if self.random.random() < 0.15:
            self.count += 1
            name = self.random.choice(("rviz2", "other", "", "zenoh_bridge_ros2dds", "_ros2cli_7"))
            listed = self.now + self.random.uniform(0.0, 0.3)
            lasts = self.random.choice((0.4, 3.0, 10.0))
            self.there[f"1{self.count}"] = name, self.now, listed, self.now + lasts

    def answers(self) -> Answers:
        nodes = [
            (f"{one}/{name}", BASE)
            for one, (name, _, listed, end) in self.there.items()
            if name and listed <= self.now < end - 0.3
        ]
        plain = [one for one, (name, *_) in self.there.items() if name in NOT_OF_ROS]
        of_ros = set(self.there) - set(plain)
        ends = {**in_dds("01", *of_ros), **in_dds(*plain, is_ros=False)}
        return {**answers(("01/base", BASE), *nodes), **ends}

    def holds(self) -> bool:
        """Whether another program or bridge reads, or the node of another base is known."""
        return any(
            name in NOT_OF_ROS or (name == "other" and listed <= self.now < end - 0.3)
            for name, _, listed, end in self.there.values()
        )

    def may_hold(self) -> bool:
        return any(name in (*NOT_OF_ROS, "other") for name, *_ in self.there.values())


def test_in_any_history_nothing_moves_while_an_unknown_reader_is_known_and_no_tool_holds() -> None:
    held, free = 0, 0
    for readers in map(Readers, range(12)):
        made = NodeList()
        for _ in range(200):
            readers.step()
            made.take(readers.answers(), {"ab"}, readers.now)
            found = conflict(made, readers.now)
            if readers.holds():
                held += 1
                assert found is not None
                assert found.reason is Reason.BASE_CONFLICT
            elif not readers.may_hold():
                free += 1
                assert found is None
    assert held > 400
    assert free > 400


def test_names_add_no_second_line() -> None:
    odd = {"publishers": [], "subscribers": [{"name": "/cmd_vel\nok", "type": TWIST}]}
    assert not listed_once(answers(("01/base", odd), ("02/b\nase", BASE))).endpoints


# When the first list counts


def test_a_list_is_awaited_until_two_in_a_row_are_alike() -> None:
    made, one = NodeList(), answers(("01/base", BASE))
    assert made.is_awaited({"ab"})
    made.take(one, {"ab"}, 0.0)
    assert made.is_awaited({"ab"})
    made.take(one, {"ab"}, 0.5)
    assert not made.is_awaited({"ab"})
    made.take(answers(("01/base", BASE), ("02/base", BASE)), {"ab"}, 2.5)
    assert not made.is_awaited({"ab"}), "it was whole once"
    assert made.is_awaited({"ab", "cd"}), "another bridge has come"


@pytest.mark.parametrize("given", [None, {}])
def test_a_bridge_that_lists_no_nodes_is_not_awaited_for_ever(given: Answers | None) -> None:
    made = NodeList()
    for count in range(MAX_FIRST):
        assert made.is_awaited({"ab"})
        made.take(given, {"ab"}, 0.1 * count)
    assert not made.is_awaited({"ab"})
    assert not made.namespaces


def test_an_answer_that_timed_out_changes_nothing_until_it_is_too_old() -> None:
    made = listed_once(answers(("01/base", BASE), ("02/other", BASE)))
    made.take(None, {"ab"}, MAX_AGE)
    assert len(made.endpoints) == 2
    made.take(None, {"ab"}, MAX_AGE + 0.1)
    assert not made.endpoints


def test_a_bridge_that_answers_too_late_keeps_its_nodes_and_no_others() -> None:
    made, slow = NodeList(), answers(("02/other", BASE), zid="cd")
    made.take({**answers(("01/base", BASE)), **slow}, {"ab", "cd"}, 0.0)
    made.take(answers(("01/base", BASE), ("03/third", BASE)), {"ab", "cd"}, 2.0, {"cd"})
    assert {end.node for end in made.endpoints} == {"/base", "/other", "/third"}
    made.take(answers(("01/base", BASE)), {"ab", "cd"}, MAX_AGE, {"cd"})
    assert {end.node for end in made.endpoints} == {"/base", "/other"}
    made.take(answers(("01/base", BASE)), {"ab", "cd"}, MAX_AGE + 0.1, {"cd"})
    assert {end.node for end in made.endpoints} == {"/base"}


# Histories


class Domain:
    """A DDS domain of bases: they start, end in order, or crash and are listed for 10 s more."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.now = 0.0
        self.count = 0
        self.alive: dict[str, str] = {}  # participant to name
        self.dead: dict[str, tuple[str, float]] = {}  # participant to name and time of its crash

    def step(self) -> None:
        self.now += PERIOD
        kind = self.random.random()
        if kind < 0.25 and len(self.alive) < 3:
            self.count += 1
            self.alive[f"{self.count:02}"] = self.random.choice(("base", "other", "rviz2"))
        elif kind < 0.4 and self.alive:
            del self.alive[self.random.choice(list(self.alive))]
        elif kind < 0.6 and self.alive:
            gone = self.random.choice(list(self.alive))
            self.dead[gone] = self.alive.pop(gone), self.now
        self.dead = {
            gone: (name, at) for gone, (name, at) in self.dead.items() if self.now - at < DDS_LEASE
        }

    def answers(self) -> Answers:
        listed = {**self.alive, **{gone: name for gone, (name, _) in self.dead.items()}}
        shuffled = self.random.sample(sorted(listed), len(listed))
        return answers(*((f"{one}/{listed[one]}", BASE) for one in shuffled))

    def bases(self, *, with_dead: bool) -> int:
        names = [*self.alive.values()]
        names += [name for name, _ in self.dead.values()] if with_dead else []
        return sum(name != "rviz2" for name in names)


def histories() -> Iterator[Domain]:
    return map(Domain, range(40))


def test_in_any_history_two_living_bases_are_held_and_one_that_stands_alone_is_not() -> None:
    held, free = 0, 0
    for domain in histories():
        made = NodeList()
        for _ in range(60):
            domain.step()
            made.take(domain.answers(), {"ab"}, domain.now)
            found = conflict(made, domain.now)
            if domain.bases(with_dead=False) > 1:
                held += 1
                assert found is not None
                assert found.reason is Reason.BASE_CONFLICT
            elif domain.bases(with_dead=True) <= 1:
                free += 1
                assert found is None
    assert held > 100
    assert free > 100


def test_in_any_history_nodes_of_one_name_live_if_both_outlast_the_lease() -> None:
    """A crash and two robots look alike at first; only of two that lived together that is said."""
    living, unknown = 0, 0
    for domain in histories():
        made, together_at = NodeList(), -DDS_LEASE
        for _ in range(60):
            domain.step()
            made.take(domain.answers(), {"ab"}, domain.now)
            found = conflict(made, domain.now)
            names = [name for name in domain.alive.values() if name != "rviz2"]
            together_at = domain.now if len(names) > 1 else together_at
            if found is None or "named" not in found.text:
                continue
            if "living" in found.text:
                living += 1
                assert domain.now - together_at <= DDS_LEASE
            else:
                unknown += 1
    assert living > 10
    assert unknown > 10


# A hub that lists its nodes


def alone(robot: BridgedRobot) -> None:
    """One base with its lidar, announced and listed."""
    robot.announce("MP", "scan", LASER)
    robot.announce("MS", "cmd_vel", TWIST)
    robot.list_nodes()
    robot.list_node("01", "base", {"/scan": LASER, "/odom": ODOMETRY}, {"/cmd_vel": TWIST})


async def only_zero_arrives(harness: DriverHarness) -> None:
    """Command motion until the robot is held, and a second longer."""
    taken: list[Twist] = []

    def is_held() -> bool:
        harness.driver.send(Twist(0.1), 1, 1)
        taken.extend(harness.rig.commands())
        return harness.sink.is_up and harness.sink.hold is Reason.BASE_CONFLICT

    await harness.until(is_held, publishing=True)
    for _ in range(20):
        harness.rig.publish()
        is_held()
        await asyncio.sleep(0.05)
    await harness.until(is_held, publishing=True)  # also where a busy machine lost the base for 1 s
    assert all(twist.is_zero for twist in taken)


def list_base(robot: BridgedRobot) -> str:
    return robot.list_node("02", "base", {}, {"/cmd_vel": TWIST})


def list_reader(robot: BridgedRobot) -> str:
    return robot.list_reader("02")


SECONDS = pytest.mark.parametrize(
    ("add", "text"),
    [(list_base, "2 nodes named /base take /cmd_vel"), (list_reader, "/dds_reader takes /cmd_vel")],
)


@SECONDS
@story(BridgedRobot, connected=False)
async def test_no_motion_reaches_two_bases_that_are_there_from_the_start(
    harness: DriverHarness, robot: BridgedRobot, add: Callable[[BridgedRobot], str], text: str
) -> None:
    alone(robot)
    add(robot)
    await only_zero_arrives(harness)
    assert reported(harness, text, is_up=True)


@SECONDS
@story(BridgedRobot, connected=False)
async def test_a_second_base_holds_a_robot_that_drives_and_its_end_frees_it(
    harness: DriverHarness, robot: BridgedRobot, add: Callable[[BridgedRobot], str], text: str
) -> None:
    alone(robot)
    await harness.connect()
    await drive(harness)
    key = add(robot)
    await harness.until(lambda: harness.sink.hold is Reason.BASE_CONFLICT, publishing=True)
    robot.commands()
    assert (await harness.command(Twist(0.1))).is_zero
    del robot.listed[key]
    await harness.until(lambda: harness.sink.hold is None, publishing=True)

    def is_moving() -> bool:
        harness.driver.send(Twist(0.1), 4, 4)
        return any(not twist.is_zero for twist in robot.commands())

    await harness.until(is_moving, publishing=True)


@story(BridgedRobot, connected=False)
async def test_a_reader_that_gets_its_node_in_time_holds_nothing(
    harness: DriverHarness, robot: BridgedRobot
) -> None:
    alone(robot)
    await harness.connect()
    await drive(harness)
    robot.list_reader("02")
    await asyncio.sleep(0.2)
    robot.list_node("02", "rviz2", {}, {"/cmd_vel": TWIST})
    for _ in range(40):
        robot.publish()
        await asyncio.sleep(0.05)
    assert harness.sink.hold is None
    assert all("takes /cmd_vel" not in text for _, text in harness.sink.states)


def test_a_recorder_holds_nothing_and_the_check_names_it() -> None:
    robot = BridgedRobot()
    alone(robot)
    robot.list_node("02", "rosbag2_recorder", {}, {"/cmd_vel": TWIST})
    found = check(robot, robot.publish)
    assert found["cmd_vel"].is_well
    assert "/base (/rosbag2_recorder only listens)" in found["cmd_vel"].text
    assert "nodes" not in found


def test_a_recorder_alone_is_no_base() -> None:
    robot = BridgedRobot()
    robot.announce("MS", "cmd_vel", TWIST)
    robot.list_nodes()
    robot.list_node("02", "rosbag2_recorder", {}, {"/cmd_vel": TWIST})
    found = check(robot, robot.publish)
    assert not found["cmd_vel"].is_well
    assert "only /rosbag2_recorder takes /cmd_vel" in found["cmd_vel"].text


def test_check_fails_for_two_bases_and_names_them_and_the_remedy() -> None:
    robot = BridgedRobot()
    alone(robot)
    robot.list_node("02", "other", {"/scan": LASER}, {"/cmd_vel": TWIST})
    found = check(robot, robot.publish)
    for subject in ("cmd_vel", "scan"):
        assert not found[subject].is_well
        for word in ("/base, /other", "namespace", "domain"):
            assert word in found[subject].text


@story(BridgedRobot, connected=False)
async def test_a_bridge_that_does_not_list_its_nodes_drives(
    harness: DriverHarness, robot: BridgedRobot
) -> None:
    robot.announce("MS", "cmd_vel", TWIST)
    await harness.connect()
    await drive(harness)


def test_a_check_tells_that_a_bridge_does_not_list_its_nodes() -> None:
    robot = BridgedRobot()
    robot.announce("MS", "cmd_vel", TWIST)
    found = check(robot, robot.publish)["nodes"]
    assert (found.is_well, found.is_measured) == (True, False)


@story(BridgedRobot, connected=False)
async def test_a_bridge_that_is_slow_to_answer_is_waited_for_and_not_for_ever(
    harness: DriverHarness, robot: BridgedRobot
) -> None:
    robot.announce("MS", "cmd_vel", TWIST)
    waiting: list[zenoh.Query] = []  # a query that is kept has no end
    robot.hub.declare_queryable(f"@/{robot.hub.zid()}/ros2/**", waiting.append)
    await harness.until(lambda: len(waiting) >= 4 or harness.sink.is_up, publishing=True)
    assert not harness.sink.is_up
    await harness.connect()
    await drive(harness)
    waiting.clear()


@pytest.mark.parametrize("announces", [False, True])
@story(BridgedRobot, connected=False, imu="imu")
async def test_another_bridge_that_does_not_answer_hides_no_second_base(
    harness: DriverHarness, robot: BridgedRobot, announces: bool
) -> None:
    """As one behind a slow link to the hub; it announces a topic of this robot or none."""
    alone(robot)
    list_base(robot)
    waiting: list[zenoh.Query] = []  # a query that is kept has no end
    with open_session("client", "connect/endpoints", robot.endpoint) as far:
        if announces:
            robot.announce("MP", "imu", "sensor_msgs/msg/Imu", zid=str(far.zid()))
        far.declare_queryable(f"@/{far.zid()}/ros2/**", waiting.append)
        await only_zero_arrives(harness)
        waiting.clear()
