"""Stops on topics in ROS 2, through a hub as each middleware's, and their answers."""

from __future__ import annotations

import pytest
import zenoh

from swarmd.testing.driver_contract import CollectingSink, DriverHarness
from tests.drivers.ros2.robots import BridgedRobot, Robot, ZenohRobot
from tests.drivers.ros2.stops import ESTOP, STATE, STOP, Empty, served
from tests.support import ros2_types as dds
from tests.support.stories import story

pytestmark = pytest.mark.long

# Published by rmw_zenoh for std_msgs/msg/Empty and String (REP 2016).
EMPTY = "std_msgs::msg::dds_::Empty_/"
EMPTY += "RIHS01_20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312"
STRING = "std_msgs::msg::dds_::String_/"
STRING += "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


def key(robot: Robot, topic: str, kind: str) -> str:
    return robot.key(topic, kind) if isinstance(robot, ZenohRobot) else topic


@story(
    BridgedRobot, ZenohRobot, lambda: ZenohRobot(domain=3, is_humble=True), stop_operator="ros-lab"
)
async def test_a_message_stops_the_robot_and_the_answer_is_published(
    harness: DriverHarness, robot: Robot
) -> None:
    commands, heard = served(harness), list[zenoh.Sample]()
    robot.hub.declare_subscriber(key(robot, STATE, "String"), heard.append)
    robot.put(STOP, Empty())
    await harness.until(lambda: len(heard) == 1, publishing=True)
    robot.put(ESTOP, dds.String("smoke"))
    await harness.until(lambda: len(heard) == 2, publishing=True)
    told = [(one.verb, one.operator, one.reason, one.source) for one in commands]
    assert told == [
        ("stop", "ros-lab", "", "ROS topic /swarmd/stop"),
        ("estop", "ros-lab", "smoke", "ROS topic /swarmd/estop"),
    ]
    texts = [dds.String.deserialize(sample.payload.to_bytes()).data for sample in heard]
    assert texts == ["stop done", "estop done"]
    assert [sample.attachment is not None for sample in heard] == [
        isinstance(robot, ZenohRobot)
    ] * 2


@story(ZenohRobot, connected=False)
async def test_the_topics_are_announced_before_a_base_is_there(
    harness: DriverHarness, robot: ZenohRobot
) -> None:
    """`ros2 topic pub --once` waits for a subscription of its type. No durability: volatile."""

    def ends() -> dict[str, tuple[str, str, str]]:
        replies = robot.hub.liveliness().get("@ros2_lv/**")
        tokens = [str(reply.ok.key_expr).split("/") for reply in replies if reply.ok is not None]
        return {
            parts[9]: (parts[5], f"{parts[10]}/{parts[11]}", parts[12])
            for parts in tokens
            if parts[5] in ("MP", "MS") and "swarmd" in parts[9]
        }

    await harness.until(lambda: len(ends()) == 3)
    assert ends() == {
        "%swarmd%stop": ("MS", EMPTY, "::,10:,:,:,,"),
        "%swarmd%estop": ("MS", STRING, "::,10:,:,:,,"),
        "%swarmd%state": ("MP", STRING, "::,10:,:,:,,"),
    }


@story(BridgedRobot, ZenohRobot)
async def test_a_retained_message_stops_once(harness: DriverHarness, robot: Robot) -> None:
    """A publisher that keeps its message (TRANSIENT_LOCAL) does not stop the next session."""
    commands = served(harness)
    publisher = zenoh.ext.declare_advanced_publisher(
        robot.hub, key(robot, STOP, "Empty"), cache=zenoh.ext.CacheConfig(1)
    )
    publisher.put(Empty().serialize())
    await harness.until(lambda: len(commands) == 1, publishing=True)
    await harness.end()
    async with harness.run_again(CollectingSink()) as again:
        await again.connect()
        robot.put(ESTOP, dds.String("later"))
        await again.until(lambda: len(commands) == 2, publishing=True)
    assert [one.verb for one in commands] == ["stop", "estop"]


@story(BridgedRobot, ZenohRobot)
@pytest.mark.parametrize("payload", [b"\xff" * 300, bytes(300 * 1024)], ids=["garbage", "huge"])
async def test_bytes_that_are_no_message_stop_and_none_do_not(
    harness: DriverHarness, robot: Robot, payload: bytes
) -> None:
    commands = served(harness)
    robot.hub.put(key(robot, ESTOP, "String"), b"")
    robot.hub.put("**", payload)
    await harness.until(lambda: f"/{ESTOP}:refused" in harness.sink.lost, publishing=True)
    assert not commands
    robot.hub.put(key(robot, ESTOP, "Float64"), payload)
    await harness.until(lambda: bool(commands), publishing=True)
    assert [(one.verb, one.reason) for one in commands] == [("estop", "")]


@story(BridgedRobot, ZenohRobot)
async def test_a_flood_is_cut_and_delays_no_emergency_stop(
    harness: DriverHarness, robot: Robot
) -> None:
    commands = served(harness)
    for _ in range(2000):
        robot.put(STOP, Empty())
    robot.put(ESTOP, dds.String("smoke"))

    def verbs() -> list[str]:
        return [one.verb for one in commands]

    await harness.until(lambda: "estop" in verbs(), publishing=True)
    assert verbs().count("estop") == 1
    assert 1 <= verbs().count("stop") < 200
