"""Another node commands the base, or publishes a second scan: what the robot gets, and is told."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Twist
from swarmd.drivers.ros import zero_answers
from swarmd.drivers.ros2 import driver as ros_driver
from swarmd.testing.driver_contract import DriverHarness, play
from tests.drivers.ros2 import robots
from tests.drivers.ros2.harness import announce, drive, reported, stands
from tests.drivers.ros2.robots import BridgedRobot, Robot, ZenohRobot
from tests.support import ros2_types as dds

LASER = "sensor_msgs/msg/LaserScan"
MAKERS: list[Callable[[], Robot]] = [BridgedRobot, ZenohRobot]
FOREIGN = 0.3
both = pytest.mark.parametrize("make", MAKERS)


async def taken_after(harness: DriverHarness, robot: Robot) -> list[Twist]:
    """The first two commands that reach the base from a command of another node on."""
    robot.put("cmd_vel", robots.command(FOREIGN))
    taken: list[Twist] = []

    def has_come() -> bool:
        taken.extend(harness.rig.commands())
        while taken and taken[0].linear != FOREIGN:
            taken.pop(0)  # a zero that answers an earlier one
        return len(taken) > 1

    await harness.until(has_come)
    return taken[:2]


@both
def test_a_stopped_robot_gets_zero_at_once_after_each_command_of_another(
    make: Callable[[], Robot],
) -> None:
    robot = make()

    async def story(harness: DriverHarness) -> None:
        await drive(harness)
        harness.driver.send(ZERO, 3, 3, is_stopped=True)
        assert (await harness.command()).is_zero
        for _ in range(3):  # no command of the daemon comes meanwhile
            taken = await taken_after(harness, robot)
            assert [twist.linear for twist in taken] == [FOREIGN, 0.0]
        assert reported(harness, "someone else drives", is_up=False)
        assert harness.sink.gets_zero

    play(robot, story)


@both
def test_zeros_are_repeated_while_another_node_commands(make: Callable[[], Robot]) -> None:
    """The zero that answers a command is late on a slow link."""
    robot = make()

    async def story(harness: DriverHarness) -> None:
        await drive(harness)
        harness.driver.send(ZERO, 3, 3, is_stopped=True)
        assert (await harness.command()).is_zero
        await taken_after(harness, robot)
        zeros: list[Twist] = []
        while len(zeros) < 10:  # no command of the daemon comes
            zeros.append(await harness.command())
        assert all(twist.is_zero for twist in zeros)

    play(robot, story)


@both
def test_a_stopped_robot_gets_each_zero_while_another_drives(
    make: Callable[[], Robot], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zero_answers, "LASTING", 0.0)
    robot = make()

    async def story(harness: DriverHarness) -> None:
        await drive(harness)
        harness.driver.send(ZERO, 3, 3, is_stopped=True)
        assert (await harness.command()).is_zero
        await taken_after(harness, robot)
        await harness.until(lambda: not harness.sink.is_up)
        for _ in range(5):
            robot.commands()
            harness.driver.send(ZERO, 4, 4, is_stopped=True)
            assert (await harness.command()).is_zero

    play(robot, story)


@both
def test_a_robot_that_need_not_stand_is_left_to_the_other(make: Callable[[], Robot]) -> None:
    robot = make()

    async def story(harness: DriverHarness) -> None:
        await drive(harness)
        robot.put("cmd_vel", robots.command(FOREIGN))
        await harness.until(lambda: not harness.sink.is_up)
        await asyncio.sleep(0.2)
        robot.commands()
        for _ in range(10):
            robot.put("cmd_vel", robots.command(FOREIGN))
            harness.driver.send(Twist(0.1), 4, 4)
            await asyncio.sleep(0.02)
        assert {twist.linear for twist in robot.commands()} == {FOREIGN}

    play(robot, story)


def test_odometry_arrives_while_another_drives() -> None:
    robot = BridgedRobot()

    async def story(harness: DriverHarness) -> None:
        await drive(harness)
        robot.put("cmd_vel", robots.command(FOREIGN))
        await harness.until(lambda: not harness.sink.is_up)
        known = len(harness.sink.odometries)
        await harness.until(lambda: len(harness.sink.odometries) > known, publishing=True)
        assert not harness.sink.is_up

    play(robot, story)


def test_zeros_are_not_promised_without_a_link() -> None:
    robot = BridgedRobot()

    async def story(harness: DriverHarness) -> None:
        await drive(harness)
        robot.disconnect()
        await harness.until(lambda: not harness.sink.is_up)
        await harness.until(lambda: not harness.sink.gets_zero)
        robot.reconnect()
        await harness.until(lambda: harness.sink.gets_zero)  # its sensors are still silent
        assert not harness.sink.is_up

    play(robot, story)


@both
def test_two_announced_publishers_of_the_scan_hold_the_robot(
    make: Callable[[], Robot],
) -> None:
    robot = make()

    async def story(harness: DriverHarness) -> None:
        announce(robot, "MP", "scan", LASER)
        await harness.until(lambda: harness.sink.is_up, publishing=True)
        assert harness.sink.hold is None
        announce(robot, "MP", "scan", LASER, zid="0123456789abcdef0123456789abcdef")
        await harness.until(lambda: harness.sink.hold is Reason.SCAN_CONFLICT, publishing=True)
        assert harness.sink.is_up
        assert reported(harness, " publish /scan", is_up=True)
        robot.tokens.pop().undeclare()
        await harness.until(lambda: harness.sink.hold is None, publishing=True)

    play(robot, story)


def test_stamps_of_two_publishers_hold_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_driver, "_EXPLAIN_PERIOD", 0.3)
    robot = BridgedRobot()

    async def story(harness: DriverHarness) -> None:
        def is_held() -> bool:
            robot.put("scan", robots.scan(robot._stamp() - 50.0))
            return harness.sink.hold is Reason.SCAN_CONFLICT

        await harness.until(is_held, publishing=True)
        assert reported(harness, "two publish it", is_up=True)

    play(robot, story)


@both
def test_a_command_on_another_topic_of_the_base_is_another_nodes(
    make: Callable[[], Robot],
) -> None:
    robot = make()
    stamped = dds.TwistStamped(dds.stamped(1.0), dds.Twist())

    async def story(harness: DriverHarness) -> None:
        await drive(harness)
        for _ in range(5):
            robot.put("cmd_vel_stamped", stamped)
            await asyncio.sleep(0.02)
        assert harness.sink.is_up, "zeros do not drive"
        robot.put("cmd_vel_joy", robots.command(FOREIGN))
        await harness.until(lambda: not harness.sink.is_up)
        assert reported(harness, "someone else drives: commands on /cmd_vel_joy", is_up=False)
        assert (await harness.command()).is_zero
        harness.driver.send(ZERO, 3, 3, is_stopped=True)
        assert (await harness.command()).is_zero
        robot.put("cmd_vel_joy", robots.command(FOREIGN))
        assert (await harness.command()).is_zero, "at once, without a command of the daemon"
        await harness.until(lambda: harness.sink.is_up, publishing=True)

    play(robot, story, other_commands=["cmd_vel_stamped", "cmd_vel_joy"])


@both
def test_an_active_goal_of_an_action_is_another_nodes_command(
    make: Callable[[], Robot],
) -> None:
    robot = make()

    def report(state: int) -> None:
        robot.put(STATUS, dds.GoalStatusArray([dds.GoalStatus(status=state)]))

    async def story(harness: DriverHarness) -> None:
        serve(robot)
        await drive(harness)
        report(4)
        await asyncio.sleep(0.1)
        assert harness.sink.is_up
        for end in (lambda: report(4), lambda: robot.tokens.pop().undeclare()):
            report(2)
            await harness.until(lambda: not harness.sink.is_up)
            assert reported(harness, "action /dock", is_up=False)
            await asyncio.sleep(2.2)  # longer than a command counts
            robot.publish()
            harness.driver.send(ZERO, 3, 3, is_stopped=True)
            assert (await harness.command()).is_zero
            assert not harness.sink.is_up
            end()
            await harness.until(lambda: harness.sink.is_up, publishing=True)

    play(robot, story, other_actions=["dock"])


STATUS = "dock/_action/status"


def serve(robot: Robot) -> None:
    """Announce the server of an action as the robot's hub does."""
    if isinstance(robot, BridgedRobot):
        robot.announce(f"@/{robot.hub.zid()}/@ros2_lv/AS/dock/irobot_create_msgs§action§Dock")
    else:
        announce(robot, "MP", STATUS, "action_msgs/msg/GoalStatusArray")


KINDS = {False: "geometry_msgs/msg/Twist", True: "geometry_msgs/msg/TwistStamped"}


@both
@pytest.mark.parametrize("is_stamped", [False, True])
def test_commands_have_the_type_that_the_base_announces(
    make: Callable[..., Robot], is_stamped: bool
) -> None:
    robot = make(is_stamped=is_stamped)

    async def story(harness: DriverHarness) -> None:
        await harness.until(
            lambda: reported(harness, "nothing announces the type", is_up=False), publishing=True
        )
        harness.driver.send(Twist(0.1), 1, 1)
        harness.driver.send(ZERO, 1, 1, is_stopped=True)
        assert stands(await harness.command())
        announce(robot, "MS", "cmd_vel", KINDS[is_stamped])
        await harness.until(lambda: harness.sink.is_up, publishing=True)
        await drive(harness)

    play(robot, story, connected=False, cmd_vel_type="auto")


@both
def test_a_type_that_changes_or_is_not_clear_ends_commands_with_zero(
    make: Callable[..., Robot],
) -> None:
    robot = make()

    async def story(harness: DriverHarness) -> None:
        announce(robot, "MS", "cmd_vel", KINDS[False])
        await harness.until(lambda: harness.sink.is_up, publishing=True)
        await drive(harness)
        announce(robot, "MS", "cmd_vel", KINDS[True])
        await harness.until(lambda: not harness.sink.is_up, publishing=True)
        assert stands(await harness.command())
        assert reported(harness, "the type of commands on /cmd_vel is not clear", is_up=False)
        harness.driver.send(Twist(0.1), 1, 1)
        await asyncio.sleep(0.2)
        assert all(map(stands, robot.commands()))
        robot.tokens.pop().undeclare()
        await harness.until(lambda: harness.sink.is_up, publishing=True)
        await drive(harness)

    play(robot, story, connected=False, cmd_vel_type="auto")
