"""A router that is frozen while the driver commands, as rmw_zenohd may be, and then continues."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import zenoh

from swarmd.core.values import ZERO, Twist
from swarmd.drivers.ros2.driver import RosDriver
from swarmd.testing.driver_contract import DriverHarness
from tests.drivers.ros.contract import last_arrives
from tests.drivers.ros2.harness import drive, drive_on, freeze
from tests.drivers.ros2.robots import BridgedRobot, Robot, ZenohRobot, open_session
from tests.support.processes import CAP, stop_process
from tests.support.stories import story

ROOT = Path(__file__).parents[3]

pytestmark = pytest.mark.integration


class ApartRobot(Robot):
    """Its hub is a process of its own, and its node a peer of that."""

    def reconnect(self) -> None:
        command = [sys.executable, "-m", "tests.drivers.ros2.hub", self.endpoint]
        self._router = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert self._router.stdout is not None
        assert self._router.stdout.readline() == "ready\n"
        self.hub = open_session("peer", "connect/endpoints", self.endpoint)
        self.tokens: list[zenoh.LivelinessToken] = []
        self._commands = commands = list[zenoh.Sample]()
        self.hub.declare_subscriber(self.command_key(), commands.append)

    def freeze(self) -> None:
        stop_process(self._router.pid)

    def thaw(self) -> None:
        self._router.send_signal(signal.SIGCONT)

    def close(self) -> None:
        self.hub.close()
        self._router.kill()
        self._router.communicate(timeout=CAP)


class ApartBridged(ApartRobot, BridgedRobot):
    """As zenoh-bridge-ros2dds passes messages on."""


class ApartZenoh(ApartRobot, ZenohRobot):
    """As with rmw_zenoh."""


@story(ApartBridged, ApartZenoh)
async def test_a_frozen_hub_delivers_no_late_command(
    harness: DriverHarness, robot: ApartRobot
) -> None:
    await drive(harness)
    await freeze(harness, robot.freeze)
    assert all(twist.is_zero for twist in await drive_on(harness, robot.thaw))
    await harness.connect()
    await last_arrives(harness, Twist(0.2))  # the zero that comes first may be one of those before


@story(ApartBridged, ApartZenoh)
async def test_of_a_hub_that_freezes_under_a_command_comes_that_one_and_zero_at_once(
    harness: DriverHarness, robot: ApartRobot
) -> None:
    assert isinstance(harness.driver, RosDriver)
    await drive(harness)
    await freeze(harness, robot.freeze)
    harness.driver._credit.hear(asyncio.get_running_loop().time())
    harness.driver.send(Twist(0.2), 1, 1)
    taken = await drive_on(harness, robot.thaw)
    assert taken[:2] == [Twist(0.2), ZERO]
    assert all(twist.is_zero for twist in taken[1:])
