"""Driver `ros1` against a real roscore and nodes in rospy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.values import Twist
from swarmd.testing.driver_contract import DriverHarness
from tests.drivers.ros.contract import RosContract
from tests.drivers.ros1.rig import RosRobot, ros_robot
from tests.support.roscore import RosCore
from tests.support.stories import story


class TestContract(RosContract):
    @pytest.fixture(autouse=True)
    def _use(self, roscore: RosCore) -> None:
        self.core = roscore

    def rig(self) -> RosRobot:
        return RosRobot(self.core)


@story(
    ros_robot,
    imu="imu",
    battery="battery",
    battery_percentage="share",
    scan_yaw_deg=90.0,
    scan_upside_down=True,
)
async def test_all_senses_arrive_as_they_were_sent(harness: DriverHarness, robot: RosRobot) -> None:
    sink = harness.sink
    sent = [0.5, math.inf, -math.inf, math.nan, 0.0, *(3.0 for _ in range(355))]

    def has_come() -> bool:
        robot.do("ranges", ranges=sent)  # again: what has waited for 0.5 s is dropped
        return bool(sink.scans) and math.isinf(sink.scans[-1].ranges[1])

    await harness.until(has_come)
    scan = sink.scans[-1]
    np.testing.assert_array_equal(scan.ranges, np.array(sent, np.float32))
    np.testing.assert_allclose(
        np.exp(1j * scan.bearings), np.exp(1j * np.radians(90.0 - np.arange(360))), atol=1e-5
    )
    await harness.until(lambda: bool(sink.odometries))
    assert sink.odometries[-1].pose.yaw == pytest.approx(0.6)
    assert sink.odometries[-1].twist == Twist(0.1, -0.2)

    def is_read() -> bool:
        robot.do("extras")
        return bool(sink.taken["readings"]) and len(sink.taken["readings"][-1]) == 3

    await harness.until(is_read)
    wanted = {"yaw": 0.5, "battery": 0.75, "battery_voltage": 12.0}
    assert sink.taken["readings"][-1] == pytest.approx(wanted)
    assert sink.lost.count("ros1/scan") == 0


@story(ros_robot)
async def test_a_base_that_returns_with_another_type_is_commanded_in_it(
    harness: DriverHarness, robot: RosRobot
) -> None:
    robot.disconnect()
    await harness.until(lambda: not harness.sink.is_up)
    robot._words = ("--command-type", "TwistStamped")
    robot.reconnect()
    await harness.until(lambda: harness.sink.is_up, publishing=True)
    assert (await harness.command(Twist(0.1))).is_zero
    taken: list[Twist] = []

    def is_moving() -> bool:
        harness.driver.send(Twist(0.1, 0.2, 0.3), 1, 1)
        taken.extend(robot.commands())
        return Twist(0.1, 0.2, 0.3) in taken

    await harness.until(is_moving, publishing=True)
