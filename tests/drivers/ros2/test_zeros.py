"""Zeros for a ROS 2 robot: of its watchdog, after a link is back, and of other nodes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from importlib import import_module

import pytest
import zenoh

from swarmd.core.values import Twist
from swarmd.drivers.ros2.session import open_session
from swarmd.testing.driver_contract import DriverHarness
from tests.drivers.ros2 import robots
from tests.drivers.ros2.harness import reported
from tests.drivers.ros2.robots import BridgedRobot, Robot, ZenohRobot
from tests.support.stories import story


@pytest.mark.parametrize(
    "make",
    [BridgedRobot, ZenohRobot, lambda: ZenohRobot(is_humble=True, is_stamped=True)],
    ids=["ros2dds", "rmw_zenoh", "Humble, stamped"],
)
def test_the_zero_sender_of_a_driver_sends_zero_to_its_base(make: Callable[[], Robot]) -> None:
    robot = make()
    spec = robot.make({}).zero_sender()
    module, _, maker = spec.maker.partition(":")
    sender = getattr(import_module(module), maker)(**spec.options)
    sender.open()
    taken: list[Twist] = []
    while not taken:
        sender.send_zero()
        taken.extend(robot.commands())
    assert all(twist.is_zero for twist in taken)
    sender.close()
    robot.close()


@pytest.mark.long
@story(BridgedRobot)
async def test_zeros_of_another_node_that_do_not_end_are_reported(
    harness: DriverHarness, robot: BridgedRobot
) -> None:
    began = asyncio.get_running_loop().time()

    def is_reported() -> bool:
        robot.put("cmd_vel", robots.command(0.0))
        return reported(harness, "another node stops this robot", is_up=True)

    await harness.until(is_reported, publishing=True)
    assert asyncio.get_running_loop().time() - began > 2.5, "a watchdog of ours ends before"


@story(BridgedRobot, connected=False)
async def test_its_session_is_closed_though_the_last_zero_cannot_be_sent(
    harness: DriverHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    sessions: list[zenoh.Session] = []

    def opened(endpoint: str, within: float) -> zenoh.Session | None:
        session = open_session(endpoint, within=within)
        sessions.extend([session] if session is not None else [])
        return session

    monkeypatch.setattr("swarmd.drivers.ros2.driver.open_session", opened)
    await harness.connect()

    def fail(twist: Twist) -> None:
        raise RuntimeError("broken")

    harness.driver.send(Twist(0.1), 1, 1)
    monkeypatch.setattr(harness.driver, "_put", fail)
    await harness.end()
    assert [session.is_closed() for session in sessions] == [True]
