"""A DDS participant with ROS 2's topic and type names stands in for the robot.

It is cyclonedds' own, which also writes and reads every byte of the messages. Between it and the
driver: a gateway of a few lines that does what the bridge does with these two topics. Where there
is a real zenoh-bridge-ros2dds, `test_bridge.py` goes through that.
"""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Mapping

import pytest
import zenoh
from cyclonedds.domain import Domain

from swarmd.core.values import Twist, Value
from swarmd.drivers.ros import cdr, messages
from swarmd.drivers.ros import from_ros as conversion
from swarmd.drivers.ros2 import dds_bridge as ros2dds
from swarmd.drivers.ros2.driver import RosDriver
from swarmd.testing.driver_contract import DriverHarness, running_driver
from tests.drivers.ros2 import robots
from tests.support import dds_types
from tests.support.dds_node import DdsNode
from tests.support.ros2_bridge import LOOPBACK, free_domain


class DdsRobot:
    """Says scans on rt/scan and hears commands on rt/cmd_vel."""

    platform = robots.PLATFORM

    def __init__(self, domain: int, endpoint: str) -> None:
        self.endpoint = endpoint
        self.node = DdsNode(
            domain, "base", {"/scan": dds_types.LaserScan}, {"/cmd_vel": dds_types.Twist}
        )
        self._spoken = 0

    def make(self, options: Mapping[str, Value]) -> RosDriver:
        return ros2dds.make_driver(
            swarm="s",
            robot="r",
            platform=self.platform,
            options={"endpoint": self.endpoint, **options},
        )

    def close(self) -> None:
        self.node.close()

    def publish(self) -> None:
        self._spoken += 1
        stamp = dds_types.Time(self._spoken, 0)
        step = 2.0 * math.pi / 360
        self.node.say(
            "/scan",
            dds_types.LaserScan(
                header=dds_types.Header(stamp, "base_scan"),
                angle_increment=step,
                ranges=[1.0 + 0.001 * i for i in range(360)],
            ),
        )

    def commands(self) -> list[Twist]:
        return [Twist(said.linear.x, said.angular.z) for said in self.node.heard("/cmd_vel")]


class Gateway:
    """What a bridge does with these two topics, as raw CDR, from a participant of its own."""

    def __init__(self, domain: int, endpoint: str) -> None:
        self._hub = robots.open_session("router", "listen/endpoints", endpoint)
        self._node = DdsNode(
            domain, "gateway", {"/cmd_vel": dds_types.Twist}, {"/scan": dds_types.LaserScan}
        )
        self._hub.declare_subscriber("cmd_vel", self._to_dds)
        self._is_ending = threading.Event()
        self._thread = threading.Thread(target=self._from_dds)
        self._thread.start()

    def close(self) -> None:
        self._is_ending.set()
        self._thread.join()
        self._hub.close()
        self._node.close()

    def _to_dds(self, sample: zenoh.Sample) -> None:
        self._node.say("/cmd_vel", dds_types.Twist.deserialize(sample.payload.to_bytes()))

    def _from_dds(self) -> None:
        while not self._is_ending.wait(0.005):
            for message in self._node.heard("/scan"):
                self._hub.put("scan", message.serialize())


@pytest.mark.integration
def test_scans_come_in_and_commands_go_out_over_dds() -> None:
    endpoint, number = robots.free_endpoint(), free_domain()
    domain = Domain(number, LOOPBACK)  # ends, with all that is in it, when it is deleted
    gateway = Gateway(number, endpoint)
    robot = DdsRobot(number, endpoint)

    async def story(harness: DriverHarness) -> None:
        await harness.until(lambda: len(harness.sink.scans) >= 3, publishing=True)
        scan = harness.sink.scans[-1]
        assert scan.ranges[100] == pytest.approx(1.1)
        taken: list[Twist] = []

        def moves() -> bool:
            harness.driver.send(Twist(0.1, -0.2), 1, 1)
            taken.extend(robot.commands())
            return bool(taken) and not taken[-1].is_zero

        await harness.until(moves, publishing=True)
        assert taken[0].is_zero
        assert taken[-1] == Twist(0.1, -0.2)
        await harness.end()

        def stands() -> bool:
            taken.extend(robot.commands())
            return taken[-1].is_zero

        await harness.until(stands)

    async def run() -> None:
        async with running_driver(robot) as harness:
            await harness.connect()
            await story(harness)

    try:
        asyncio.run(run())
    finally:
        gateway.close()
    del domain


def test_bytes_are_those_of_cyclonedds_too() -> None:
    scan = dds_types.LaserScan(
        header=dds_types.Header(dds_types.Time(7, 5), "base_scan"),
        angle_min=-1.5,
        angle_increment=0.25,
        ranges=[0.0, math.inf, 1.5],
        intensities=[1.0, 2.0, 3.0],
    )
    written = scan.serialize()
    read = cdr.decode(messages.LaserScan, written)
    assert read.ranges.tolist() == scan.ranges
    assert cdr.encode(read) == written
    twist = dds_types.Twist(dds_types.Vector3(0.1, 0.0, 0.0), dds_types.Vector3(0.0, 0.0, -0.2))
    assert cdr.encode(conversion.twist_message(Twist(0.1, -0.2))) == twist.serialize()
