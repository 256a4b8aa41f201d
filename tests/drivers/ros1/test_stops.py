"""Stops on topics in ROS 1: from nodes in rospy, over a real master."""

from __future__ import annotations

from rosbags.typesys.stores import ros1_noetic as noetic

from swarmd.core.messages import Code, Reply
from swarmd.core.values import Value
from swarmd.driver_api.command_source import Answer, DriverCommand, command_source
from swarmd.drivers.ros1.driver import Ros1Driver
from swarmd.drivers.ros1.serialization import encode
from swarmd.testing.driver_contract import DriverHarness
from tests.drivers.ros1.rig import PLATFORM, RosRobot, ros_robot
from tests.support.stories import story


def served(harness: DriverHarness, texts: list[str]) -> list[DriverCommand]:
    """The commands from now on, each answered with the next text, or with the last one."""
    commands: list[DriverCommand] = []

    def take(command: DriverCommand, answer: Answer) -> None:
        commands.append(command)
        text = texts[min(len(commands), len(texts)) - 1]
        answer(Reply(id="i", robot="r", code=Code.APPLIED, text=text))

    source = command_source(harness.driver)
    assert source is not None
    source.serve(take)
    return commands


def test_a_stop_counts_however_long_it_waited() -> None:
    """The adapter drops messages that waited for 0.5 s, except those of kept topics."""
    options: dict[str, Value] = {"namespace": "r", "other_commands": ["joy"], "imu": "imu"}
    config = Ros1Driver(swarm="s", robot="r", platform=PLATFORM, options=options)._config(False)
    names = [*config["topics"], *config["command_topics"]]
    kept = [names[index] for index in config["kept_topics"]]
    assert kept == ["/r/swarmd/stop", "/r/swarmd/estop"]


@story(ros_robot)
async def test_a_node_in_rospy_stops_the_robot_and_gets_its_state(
    harness: DriverHarness, robot: RosRobot
) -> None:
    commands = served(harness, ["stopped: commanded zero", "estopped: commanded zero"])
    # As `rostopic pub` does: latched, so that a subscriber that connects later gets the message.
    robot.do("latch", topic="swarmd/stop", kind="Empty")
    await harness.until(lambda: len(commands) == 1)
    robot.do("follow", topic="swarmd/state")  # a late subscriber gets the last answer
    await harness.until(lambda: len(robot.texts()) == 1)
    robot.do("latch", topic="swarmd/estop", kind="String", text="smoke")
    await harness.until(lambda: len(commands) == 2)
    assert [one.verb for one in commands] == ["stop", "estop"]
    assert commands[1].reason == "smoke"
    assert commands[0].source == f"ROS topic {robot.namespace}/swarmd/stop"
    await harness.until(lambda: len(robot.texts()) == 2)
    assert robot.texts() == ["stopped: commanded zero", "estopped: commanded zero"]
    # The publishers keep their messages: they come once, however long the robot runs.
    robot.do("latch", topic="swarmd/estop", kind="String", text="again")
    await harness.until(lambda: len(commands) == 3, publishing=True)
    assert [one.verb for one in commands] == ["stop", "estop", "estop"]


@story(ros_robot)
async def test_a_stop_of_another_type_stops_and_one_of_megabytes_too(
    harness: DriverHarness, robot: RosRobot
) -> None:
    commands = served(harness, ["estopped"])

    def put_stop() -> bool:
        robot.put("swarmd/stop", noetic.std_msgs__msg__Float64(1.0), bytes(8))
        return "stop" in [one.verb for one in commands]

    def put_estop() -> bool:
        text = noetic.std_msgs__msg__String("x" * (1 << 20))
        robot.put("swarmd/estop", text, encode(text))
        return "estop" in [one.verb for one in commands]

    await harness.until(put_stop)
    await harness.until(put_estop)
    assert {one.reason for one in commands} == {""}
