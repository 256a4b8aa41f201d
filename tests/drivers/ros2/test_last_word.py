"""Lost links, scans of two publishers, and the type of commands: what the robot gets."""

from __future__ import annotations

import asyncio

import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Twist
from swarmd.drivers.ros.foreign_commands import YIELD_TIME
from swarmd.drivers.ros2 import driver as ros_driver
from swarmd.testing.driver_contract import DriverHarness
from tests.drivers.ros2 import robots
from tests.drivers.ros2.harness import drive, reported, stands
from tests.drivers.ros2.robots import BridgedRobot, Robot, ZenohRobot
from tests.support.stories import story

pytestmark = pytest.mark.long


@story(BridgedRobot)
async def test_zeros_go_out_and_are_promised_only_with_a_link(
    harness: DriverHarness, robot: BridgedRobot
) -> None:
    await drive(harness)
    robot.disconnect()
    await harness.until(lambda: not harness.sink.is_up)
    await harness.until(lambda: not harness.sink.gets_zero)
    robot.reconnect()
    await harness.until(lambda: harness.sink.gets_zero)  # its sensors are still silent
    assert not harness.sink.is_up
    assert (await harness.command()).is_zero


@story(BridgedRobot, connected=False)
async def test_stamps_of_two_publishers_hold_the_robot(
    harness: DriverHarness, robot: BridgedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros_driver, "_EXPLAIN_PERIOD", 0.3)
    await harness.connect()

    def is_held() -> bool:
        robot.put("scan", robots.scan(robot._stamp() - 50.0))
        return harness.sink.hold is Reason.SCAN_CONFLICT

    await harness.until(is_held, publishing=True)
    assert reported(harness, "two publish it", is_up=True)


KINDS = {False: "geometry_msgs/msg/Twist", True: "geometry_msgs/msg/TwistStamped"}


@story(
    BridgedRobot,
    ZenohRobot,
    lambda: BridgedRobot(is_stamped=True),
    lambda: ZenohRobot(is_stamped=True),
    connected=False,
    cmd_vel_type="auto",
)
async def test_commands_have_the_type_that_the_base_announces(
    harness: DriverHarness, robot: Robot
) -> None:
    await harness.until(
        lambda: reported(harness, "nothing announces the type", is_up=False), publishing=True
    )
    harness.driver.send(Twist(0.1), 1, 1)
    assert stands(await harness.command(ZERO, is_stopped=True))
    robot.announce("MS", "cmd_vel", KINDS[robot.is_stamped])
    await harness.until(lambda: harness.sink.is_up, publishing=True)
    await drive(harness)


@story(BridgedRobot, ZenohRobot, connected=False, cmd_vel_type="auto")
async def test_a_type_that_changes_or_is_not_clear_ends_commands_with_zero(
    harness: DriverHarness, robot: Robot
) -> None:
    robot.announce("MS", "cmd_vel", KINDS[False])
    await harness.until(lambda: harness.sink.is_up, publishing=True)
    await drive(harness)
    robot.announce("MS", "cmd_vel", KINDS[True])
    await harness.until(lambda: not harness.sink.is_up, publishing=True)
    assert stands(await harness.command())
    assert reported(harness, "the type of commands on /cmd_vel is not clear", is_up=False)
    harness.driver.send(Twist(0.1), 1, 1)
    await asyncio.sleep(0.2)
    assert all(map(stands, robot.commands()))
    robot.tokens.pop().undeclare()
    await harness.until(lambda: harness.sink.is_up, publishing=True)
    await drive(harness)


def is_named(harness: DriverHarness) -> bool:
    """Whether the driver has left the base to an action."""
    return not harness.sink.is_up and "someone else drives: action" in harness.sink.states[-1][1]


@story(BridgedRobot, ZenohRobot, other_actions=["dock"])
async def test_a_last_status_that_comes_after_its_server_has_gone_does_not_last(
    harness: DriverHarness, robot: Robot
) -> None:
    """The announcement and the status have roads of their own."""
    other = robot.other_node()
    harness.driver.send(ZERO, 1, 1)

    def has_goal() -> bool:
        other.report_goal(is_active=True)
        return is_named(harness)

    await harness.until(has_goal, publishing=True)
    other.close()
    await harness.until(lambda: harness.sink.is_up, publishing=True)
    await harness.until(has_goal, publishing=True)
    await harness.until(lambda: harness.sink.is_up, publishing=True)


@story(ZenohRobot, other_actions=["dock"])
async def test_a_client_that_leaves_ends_no_goal(harness: DriverHarness, robot: Robot) -> None:
    other = robot.other_node()
    client = robot.announce("MS", *robot.server[1:])
    harness.driver.send(ZERO, 1, 1)

    def has_goal() -> bool:
        other.report_goal(is_active=True)
        return is_named(harness)

    await harness.until(has_goal, publishing=True)
    client.undeclare()
    leaver = robot.announce("MP", *robot.server[1:], zid="0123456789abcdef" * 2)
    leaver.undeclare()  # of two servers one has gone
    ends = asyncio.get_running_loop().time() + YIELD_TIME + 1.0
    while asyncio.get_running_loop().time() < ends:
        robot.publish()
        await asyncio.sleep(0.05)
        assert not harness.sink.is_up
    other.close()
    await harness.until(lambda: harness.sink.is_up, publishing=True)
