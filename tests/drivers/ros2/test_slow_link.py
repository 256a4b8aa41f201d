"""A driver whose hub is behind a slow link, such as a loaded Wi-Fi."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

import pytest

from swarmd.core.values import Twist, Value
from swarmd.drivers.ros2 import dds_bridge as ros2dds
from swarmd.testing.driver_contract import TIMEOUT, DriverHarness
from tests.drivers.ros2.robots import BridgedRobot
from tests.support.processes import wait_until
from tests.support.slow_link import SlowLink
from tests.support.stories import story

TICK = 0.05
DELAY = 0.35  # s each way: opening a session takes 1.4 s

pytestmark = pytest.mark.integration


class FarRobot(BridgedRobot):
    """Its driver reaches it by a link with `delay` s each way."""

    def __init__(self, delay: float) -> None:
        super().__init__()
        self.link = SlowLink(self.endpoint, delay).__enter__()

    def options(self, given: Mapping[str, Value]) -> Mapping[str, Value]:
        return super().options({"endpoint": self.link.endpoint, **given})

    def close(self) -> None:
        super().close()
        self.link.__exit__()


@pytest.mark.parametrize("delay", [0.1, DELAY])
@story(lambda delay: FarRobot(delay), connected=False)
async def test_a_robot_behind_a_slow_link_drives_without_a_zero_and_stops(
    harness: DriverHarness, delay: float
) -> None:
    async def command(harness: DriverHarness, twist: Twist, seconds: float) -> None:
        for _ in range(round(seconds / TICK)):
            harness.rig.publish()
            harness.driver.send(twist, 1, 1)
            await asyncio.sleep(TICK)

    await harness.connect()
    await command(harness, Twist(0.1), 0.5 + 2.0 * delay)

    async def drives_without_a_zero() -> bool:
        harness.rig.commands()
        await command(harness, Twist(0.1), 1.0)
        taken = harness.rig.commands()
        return len(taken) >= 5 and not any(twist.is_zero for twist in taken)

    async with asyncio.timeout(TIMEOUT):
        while not await drives_without_a_zero():
            pass  # a machine that halts this process for 0.2 s interrupts a robot, too
    await command(harness, Twist(), 0.5 + 2.0 * delay)
    stopping: list[bool] = []

    def has_stopped() -> bool:
        stopping.extend(twist.is_zero for twist in harness.rig.commands())
        return stopping[-1:] == [True]

    await harness.until(has_stopped)
    assert stopping == sorted(stopping), "nothing follows the first zero"


def test_the_watchdog_reaches_a_base_behind_a_slow_link() -> None:
    robot = FarRobot(DELAY)
    options = robot.options({})
    sender = ros2dds.make_zero_sender(robot="r", given=options)
    try:
        sender.open()
        wait_until(lambda: sender.is_connected, "connected")
    finally:
        sender.close()
        robot.close()
