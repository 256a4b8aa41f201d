"""Another node commands the base, or publishes a second scan: what the robot gets, and is told."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Twist
from swarmd.drivers.ros2 import driver as ros_driver
from swarmd.testing.driver_contract import DriverHarness, play
from tests.drivers.ros2 import robots
from tests.drivers.ros2.harness import announce, drive, reported
from tests.drivers.ros2.robots import BridgedRobot, Robot, ZenohRobot

LASER = "sensor_msgs/msg/LaserScan"
MAKERS: list[Callable[[], Robot]] = [BridgedRobot, ZenohRobot]
FOREIGN = 0.3
both = pytest.mark.parametrize("make", MAKERS)


async def taken_after(harness: DriverHarness, act: Callable[[], None]) -> list[Twist]:
    """What reaches the base up to the first command of the driver that follows `act`."""
    harness.rig.commands()
    act()
    taken: list[Twist] = []

    def has_come() -> bool:
        taken.extend(harness.rig.commands())
        return any(twist.linear != FOREIGN for twist in taken)

    await harness.until(has_come)
    return taken


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
            taken = await taken_after(
                harness, lambda: robot.put("cmd_vel", robots.command(FOREIGN))
            )
            assert [twist.linear for twist in taken[:2]] == [FOREIGN, 0.0]
        assert reported(harness, "someone else drives", is_up=False)
        assert harness.sink.gets_zero

    play(robot, story)


@both
def test_a_stopped_robot_gets_each_zero_while_another_drives(make: Callable[[], Robot]) -> None:
    robot = make()

    async def story(harness: DriverHarness) -> None:
        await drive(harness)
        harness.driver.send(ZERO, 3, 3, is_stopped=True)
        assert (await harness.command()).is_zero
        await taken_after(harness, lambda: robot.put("cmd_vel", robots.command(FOREIGN)))
        await harness.until(lambda: not harness.sink.is_up)
        for _ in range(5):
            (twist,) = await taken_after(
                harness, lambda: harness.driver.send(ZERO, 4, 4, is_stopped=True)
            )
            assert twist.is_zero

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
        assert reported(harness, "2 publish /scan", is_up=True)
        robot._tokens.pop().undeclare()
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
