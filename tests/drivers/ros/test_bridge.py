"""Driver `ros2dds` at a real zenoh-bridge-ros2dds, the robot a ROS 2 node on DDS."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable

import pytest

from swarmd.drivers.ros.dialect import Endpoint
from swarmd.drivers.ros2dds import Ros2Dds
from swarmd.testing import dds_types
from swarmd.testing.dds_node import DdsNode
from swarmd.testing.driver_contract import DriverContract, Stage
from swarmd.testing.processes import wait_until
from swarmd.testing.ros2_bridge import why_no_bridge
from swarmd.values import Twist
from tests.drivers.ros.dds_rig import DdsRobot
from tests.drivers.ros.robots import open_session
from tests.drivers.ros.stories import check, play, told

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(bool(why_no_bridge()), reason=why_no_bridge()),
]


class TestContract(DriverContract):
    def rig(self) -> DdsRobot:
        return DdsRobot()


class TestStampedContract(DriverContract):
    def rig(self) -> DdsRobot:
        return DdsRobot(is_stamped=True)


async def moves(stage: Stage) -> None:
    """Until the base is told to move."""
    taken: list[Twist] = []

    def is_moving() -> bool:
        stage.driver.send(Twist(0.1, -0.2), 1, 1)
        taken.extend(stage.rig.commands())
        return bool(taken) and taken[-1] == Twist(0.1, -0.2)

    await stage.until(is_moving, speaking=True)
    assert taken[0].is_zero


async def tells(stage: Stage, words: str) -> None:
    """Until the driver says that of a base that is lost."""
    await stage.until(lambda: told(stage, words, is_up=False), speaking=True)


@pytest.mark.parametrize(
    ("namespace", "at"), [("/tb3_01", ""), ("", "/tb3_01"), ("/front", "/tb3_01")]
)
def test_a_namespace_is_the_robots_or_the_bridges(namespace: str, at: str) -> None:
    play(DdsRobot(namespace=namespace, at=at), moves)


def test_a_robot_that_leaves_and_returns_gets_zero_first() -> None:
    robot = DdsRobot()

    async def story(stage: Stage) -> None:
        await moves(stage)
        robot.stop()
        await stage.until(lambda: not stage.heard.is_up)
        await tells(stage, "no /scan")
        stage.driver.send(Twist(0.1), 1, 1)
        robot.start()
        await moves(stage)

    play(robot, story)


def test_a_frozen_bridge_is_told_and_nothing_late_moves_the_robot() -> None:
    robot = DdsRobot()

    async def story(stage: Stage) -> None:
        await moves(stage)
        robot.bridge.freeze()
        for _ in range(20):
            stage.driver.send(Twist(0.1), 1, 1)
            await asyncio.sleep(0.05)
        await stage.until(lambda: not stage.heard.is_up, speaking=True)
        robot.commands()
        robot.bridge.thaw()
        assert (await stage.command()).is_zero
        await asyncio.sleep(1.0)
        assert all(twist.is_zero for twist in robot.commands())
        await stage.connect()
        await moves(stage)

    play(robot, story)
