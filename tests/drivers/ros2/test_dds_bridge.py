"""The ros2dds driver against a stand-in for a robot behind its bridge, over real Zenoh."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.values import Array, Twist, Value
from swarmd.drivers.ros2.driver import RosDriver
from swarmd.testing.driver_contract import DriverHarness
from tests.drivers.ros.contract import RosContract
from tests.drivers.ros2 import robots
from tests.drivers.ros2.harness import check, drive, reported
from tests.drivers.ros2.robots import BridgedRobot
from tests.support import ros2_types as dds
from tests.support.range_ring import RING_DEG, ring_spec, with_ring
from tests.support.stories import story

pytestmark = pytest.mark.long


class RobotWithRing(BridgedRobot):
    """A lidar and six range sensors, each with a topic."""

    platform = with_ring("burger", replace(ring_spec(), rate=5.0))  # a busy machine keeps that

    def make(self, options: Mapping[str, Value]) -> RosDriver:
        ring: dict[str, Value] = {f"ir/s{k}": deg for k, deg in enumerate(RING_DEG)}
        return super().make({"ranges": ring, **options})

    def publish(self) -> None:
        super().publish()
        self.publish_ranges(np.full(len(RING_DEG), 0.5))

    def publish_ranges(self, ranges: Array) -> None:
        for k, metres in enumerate(ranges.tolist()):
            message = dds.OlderRange(header=dds.stamped(self._stamp()), range=metres)
            self.put(f"ir/s{k}", message)


class TestContract(RosContract):
    def rig(self) -> RobotWithRing:
        return RobotWithRing()


@story(BridgedRobot, imu="imu", battery="battery_state", battery_percentage="share")
async def test_all_senses_arrive_with_their_meaning(
    harness: DriverHarness, robot: BridgedRobot
) -> None:
    ranges = [1.0 + 0.001 * i for i in range(250)]
    sink = harness.sink

    def have_arrived() -> bool:
        """Sent again and again: a driver that has lost its base after a stall takes nothing."""
        robot.put("scan", robots.scan(500.0, ranges))
        robot.put("odom", robots.odometry(501.0, x=2.0, yaw=1.0))
        robot.put("imu", dds.Imu(orientation=dds.Quaternion(z=1.0, w=0.0)))
        robot.put("battery_state", dds.BatteryState(voltage=11.5, percentage=0.5))
        stamps = (sink.scans[-1].stamp, sink.odometries[-1].stamp)
        readings = sink.taken["readings"]
        return stamps == (500.0, 501.0) and bool(readings) and "battery" in readings[-1]

    await harness.until(have_arrived)
    np.testing.assert_allclose(sink.scans[-1].ranges, ranges, rtol=1e-6)
    pose = sink.odometries[-1].pose
    assert pose.x == 2.0
    assert pose.yaw == pytest.approx(1.0)
    assert sink.taken["readings"][-1]["yaw"] == pytest.approx(math.pi)
    assert sink.taken["readings"][-1]["battery"] == pytest.approx(0.5)


@story(lambda: BridgedRobot(is_stamped=True), cmd_vel_frame="base_footprint")
async def test_stamped_commands_are_in_the_frame_asked_for(
    harness: DriverHarness, robot: BridgedRobot
) -> None:
    harness.driver.send(Twist(0.1), 1, 1)
    samples = robot.samples()
    while not samples:
        await asyncio.sleep(0.01)
        samples = robot.samples()
    message = dds.TwistStamped.deserialize(samples[0].payload.to_bytes())
    assert message.header.frame_id == "base_footprint"
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (0, 0)


@story(BridgedRobot, connected=False)
async def test_a_base_that_restarts_at_once_gets_zero_first(
    harness: DriverHarness, robot: BridgedRobot
) -> None:
    robot.announce("MS", "cmd_vel", "geometry_msgs/msg/Twist")
    await harness.connect()
    await drive(harness)
    robot.tokens.pop().undeclare()
    robot.announce("MS", "cmd_vel", "geometry_msgs/msg/Twist")
    robot.commands()
    taken: list[Twist] = []

    def has_zero() -> bool:
        harness.driver.send(Twist(0.1), 2, 2)
        taken.extend(robot.commands())
        return harness.sink.is_up and any(twist.is_zero for twist in taken)

    await harness.until(has_zero, publishing=True)  # once the driver has noticed


def test_check_reports_commands_of_other_nodes() -> None:
    robot = BridgedRobot()

    def publish() -> None:
        robot.publish()
        robot.put("cmd_vel", robots.command(0.0))

    found = check(robot, publish)
    assert not found["last_word"].is_well
    assert "commands of another node on /cmd_vel" in found["last_word"].text


@story(BridgedRobot, connected=False)
async def test_a_missing_topic_is_reported_while_the_driver_runs(
    harness: DriverHarness, robot: BridgedRobot
) -> None:
    robot.announce("MP", "bot1/scan", "sensor_msgs/msg/LaserScan")
    await harness.until(lambda: reported(harness, "no /scan, but /bot1/scan", is_up=False))
    robot.publish_odometry()
    await harness.until(lambda: harness.sink.is_up)

    def is_reported() -> bool:
        robot.publish_odometry()
        return reported(harness, "no /scan, but /bot1/scan", is_up=True)

    await harness.until(is_reported)
