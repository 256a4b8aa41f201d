"""Opinions as ROS topics: what is published, and what is heard of other robots."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zenoh

from swarmd.core.errors import ConfigError
from swarmd.core.messages import Code
from swarmd.core.values import Value
from swarmd.core.verbs import RunRequest
from swarmd.driver_api.opinion_link import HeardOpinion, opinion_link
from swarmd.drivers.ros.opinion_options import PUBLISHED
from swarmd.drivers.ros.options import Ros1Options, RosOptions, read_options
from swarmd.drivers.ros2.opinions import MAX_OF_ONE
from swarmd.network.operator.operator import Operator
from swarmd.network.settings import NetworkSettings
from swarmd.testing.driver_contract import DriverHarness
from tests.drivers.ros2.harness import check
from tests.drivers.ros2.robots import BridgedRobot, Robot, ZenohRobot, scan
from tests.support.drive_daemon import ROBOT, status
from tests.support.processes import DaemonProcess, unique_swarm, wait_until
from tests.support.stories import story

pytestmark = pytest.mark.long

INT32 = "std_msgs::msg::dds_::Int32_/"
# Computed by REP 2016 for `int64 id`, `int64 opinion`.
PAIR = "communication_interfaces::msg::dds_::OpinionMessage_/"
BOTH: dict[str, Value] = {
    "publish": True,
    "robots": ["tb4_07"],
    "broadcast": "/majority_broadcast",
    "ids": [7],
}


def key(robot: Robot, topic: str, kind: str = INT32, hashed: str = "TypeHashNotSupported") -> str:
    return f"{robot.domain}/{topic}/{kind}{hashed}" if isinstance(robot, ZenohRobot) else topic


def int32(value: int) -> bytes:
    return b"\0\1\0\0" + struct.pack("<i", value)


def pair(id: int, opinion: int) -> bytes:
    return b"\0\1\0\0" + struct.pack("<qq", id, opinion)


class Ear:
    """The daemon's side: keeps what is heard."""

    def __init__(self, harness: DriverHarness) -> None:
        self.heard: list[HeardOpinion] = []
        link = opinion_link(harness.driver)
        assert link is not None
        link.hear(self.heard.append)
        self.link = link


@story(BridgedRobot, ZenohRobot, opinions=BOTH)
async def test_opinions_of_declared_robots_are_heard(harness: DriverHarness, robot: Robot) -> None:
    ear = Ear(harness)

    def has_both() -> bool:
        robot.hub.put(key(robot, "tb4_07/opinion"), int32(2))
        robot.hub.put(key(robot, "majority_broadcast", PAIR), pair(7, 1))
        return {one.name for one in ear.heard} == {"tb4_07", "7"}

    await harness.until(has_both, publishing=True)
    assert set(ear.heard) == {HeardOpinion("tb4_07", 2, None, True), HeardOpinion("7", 1, 7, True)}


@story(BridgedRobot, opinions=BOTH)
async def test_a_flood_on_the_topic_of_one_robot_is_cut_at_each_look(
    harness: DriverHarness, robot: Robot
) -> None:
    ear = Ear(harness)
    topics: Any = ear.link
    advance, counts = topics.advance, list[int]()

    def counted(dropped: Callable[[str], None]) -> None:
        before = len(ear.heard)
        advance(dropped)
        counts.append(len(ear.heard) - before)

    def is_full() -> bool:
        for _ in range(100):
            robot.hub.put("tb4_07/opinion", int32(1))
        return any(count >= MAX_OF_ONE for count in counts)

    topics.advance = counted
    await harness.until(is_full, publishing=True)
    assert max(counts) == MAX_OF_ONE


STRANGE: dict[str, Callable[[Robot], tuple[str, bytes]]] = {
    "another robot": lambda robot: (key(robot, "tb4_08/opinion"), int32(1)),
    "another id": lambda robot: (key(robot, "majority_broadcast", PAIR), pair(8, 1)),
    "no bytes": lambda robot: (key(robot, "tb4_07/opinion"), b""),
    "half a message": lambda robot: (key(robot, "tb4_07/opinion"), int32(1)[:6]),
    "a long message": lambda robot: (key(robot, "tb4_07/opinion"), int32(1) + bytes(10_000)),
    "text": lambda robot: (key(robot, "tb4_07/opinion"), b"\xff" * 8),
    "a wildcard": lambda _: ("**", int32(1)),
}


@story(BridgedRobot, ZenohRobot, opinions=BOTH)
@pytest.mark.parametrize("strange", STRANGE.values(), ids=STRANGE)
async def test_anything_else_is_not_heard(
    harness: DriverHarness, robot: Robot, strange: Callable[[Robot], tuple[str, bytes]]
) -> None:
    ear, (at, payload) = Ear(harness), strange(robot)

    def is_heard() -> bool:
        robot.hub.put(at, payload)
        robot.hub.put(key(robot, "tb4_07/opinion"), int32(2))
        return len(ear.heard) >= 3

    await harness.until(is_heard, publishing=True)
    assert set(ear.heard) == {HeardOpinion("tb4_07", 2, None, True)}


@story(BridgedRobot, ZenohRobot, opinions={"unknown": True, "robots": ["tb4_07"]})
async def test_unknown_robots_are_heard_as_undeclared_if_the_option_says_so(
    harness: DriverHarness, robot: Robot
) -> None:
    ear = Ear(harness)

    def has_both() -> bool:
        for name in ("\x1b[2J", "tb3-02", "swarmd", "a/b", "tb4_07", "tb4_08"):
            robot.hub.put(key(robot, f"{name}/opinion"), int32(1))
        return "tb4_08" in {one.name for one in ear.heard}

    await harness.until(has_both, publishing=True)
    assert {(one.name, one.is_declared) for one in ear.heard} == {
        ("tb4_07", True),
        ("tb4_08", False),
    }


@story(ZenohRobot, opinions=BOTH)
@pytest.mark.parametrize("typed", ["std_msgs::msg::dds_::Int64_/", INT32], ids=["type", "hash"])
async def test_a_key_of_another_type_or_hash_is_not_heard_and_changes_no_command(
    harness: DriverHarness, robot: ZenohRobot, typed: str
) -> None:
    ear, driver = Ear(harness), harness.driver
    scheme: Any = getattr(driver, "_scheme")  # noqa: B009 - a private attribute

    def is_heard() -> bool:
        hashed = "TypeHashNotSupported" if typed != INT32 else "RIHS01_" + 64 * "0"
        robot.hub.put(f"0/tb4_07/opinion/{typed}{hashed}", int32(1))
        robot.hub.put(key(robot, "tb4_07/opinion"), int32(2))
        return len(ear.heard) >= 3

    await harness.until(is_heard, publishing=True)
    assert {one.opinion for one in ear.heard} == {2}
    assert scheme._is_humble is False  # the placeholder of another robot's keys says nothing


@story(BridgedRobot, ZenohRobot, opinions=BOTH)
async def test_the_own_opinion_is_published(harness: DriverHarness, robot: Robot) -> None:
    ear = Ear(harness)
    samples: list[zenoh.Sample] = []
    suffix = "/*/*" if isinstance(robot, ZenohRobot) else ""
    prefix = f"{robot.domain}/" if isinstance(robot, ZenohRobot) else ""
    robot.hub.declare_subscriber(f"{prefix}{PUBLISHED}{suffix}", samples.append)

    def is_published() -> bool:
        ear.link.publish(2)
        return bool(samples)

    await harness.until(is_published, publishing=True)
    assert samples[0].payload.to_bytes() == int32(2)
    assert (samples[0].attachment is not None) == isinstance(robot, ZenohRobot)


@story(BridgedRobot)
async def test_without_the_option_nothing_is_exchanged(
    harness: DriverHarness, robot: Robot
) -> None:
    assert opinion_link(harness.driver) is None


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"topic": PUBLISHED}, "opinions.topic"),
        ({"topic": "/opinion"}, "opinions.topic"),
        ({"robots": ["tb4-07"]}, "tb4-07"),
        ({"robots": ["a/*"]}, "opinions.robots"),
        ({"broadcast": "/votes/**"}, "opinions.broadcast"),
        ({"broadcast": "cmd_vel"}, "cmd_vel and opinions.broadcast"),
        ({"broadcast": PUBLISHED, "publish": True}, "opinions.publish and opinions.broadcast"),
        ({"ids": [1]}, "opinions.ids"),
        ({"ids": [-1], "broadcast": "votes"}, "ids"),
    ],
)
def test_a_wrong_option_is_refused(changes: dict[str, Value], part: str) -> None:
    with pytest.raises(ConfigError, match=part.replace("*", ".")):
        read_options(RosOptions, {"opinions": changes}, "ros2dds", "r")


def test_the_driver_of_ros_1_refuses_the_option() -> None:
    with pytest.raises(ConfigError, match="opinions"):
        read_options(Ros1Options, {"opinions": BOTH}, "ros1", "r")


def test_a_check_names_the_topics() -> None:
    robot = BridgedRobot()
    finding = check(robot, robot.publish, namespace="r7", opinions=BOTH)["opinions"]
    assert "publishes /r7/swarmd/opinion" in finding.text
    assert "hears /majority_broadcast, /tb4_07/opinion" in finding.text


@pytest.mark.integration
def test_a_voting_pattern_adopts_the_opinion_of_ros_robots_and_publishes_its_own(
    tmp_path: Path,
) -> None:
    robot = BridgedRobot()
    samples: list[zenoh.Sample] = []
    robot.hub.declare_subscriber(PUBLISHED, samples.append)
    robots = ["tb4_07", "tb4_08"]
    opinions: dict[str, Value] = {"publish": True, "robots": list[Value](robots)}
    options: dict[str, Any] = {
        "driver": "ros2dds",
        "driver_options": {**robot.options({"opinions": opinions}), "command_timeout": "base"},
    }
    swarm, count = unique_swarm(), [0]

    def turn() -> None:
        count[0] += 1
        robot.put("scan", scan(100.0 + 0.1 * count[0]))
        for name in robots:
            robot.hub.put(f"{name}/opinion", int32(2))

    daemon = DaemonProcess(
        tmp_path, swarm=swarm, robot=ROBOT, endpoint="", platform="burger", options=options
    )
    try:
        with daemon, Operator(NetworkSettings(swarm=swarm), name="anna") as operator:
            daemon.wait_ready()

            def runs() -> bool:
                turn()
                now = status(operator)
                if now is None:
                    return False
                outcome = operator.request(
                    RunRequest,
                    {ROBOT: now.epoch},
                    pattern="majority_rule",
                    params={"initial": 0, "window": 1.0, "share_period": 0.5},
                    timeout=10.0,
                )
                reply = outcome.replies.get(ROBOT)
                return reply is not None and reply.code is Code.APPLIED

            def has_adopted() -> bool:
                turn()
                return int32(2) in [sample.payload.to_bytes() for sample in samples]

            wait_until(runs, "it votes")
            wait_until(has_adopted, "the opinion of the ROS robots is adopted and published")
        assert samples[0].payload.to_bytes() == int32(0)
        assert "hears opinions of the ROS robot tb4_07, not authenticated" in daemon.text()
    finally:
        robot.close()
