"""Driver `ros1` against a real roscore and nodes in rospy."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
import pytest
from rosbags.typesys.stores import ros1_noetic

from swarmd.core.values import ZERO, Twist, Value
from swarmd.drivers.ros import messages
from swarmd.drivers.ros.from_ros import command_message
from swarmd.drivers.ros1 import serialization
from swarmd.testing import driver_contract
from swarmd.testing.driver_contract import DriverContract, DriverHarness
from tests.drivers.ros1.rig import RosRobot
from tests.support.roscore import RosCore

RobotHarness = Callable[[DriverHarness, RosRobot], Awaitable[None]]


TIME = ros1_noetic.builtin_interfaces__msg__Time(1, 0)


def goal_id() -> ros1_noetic.actionlib_msgs__msg__GoalID:
    return ros1_noetic.actionlib_msgs__msg__GoalID(TIME, "goal")


class TestContract(DriverContract):
    @pytest.fixture(autouse=True)
    def _use(self, roscore: RosCore) -> None:
        self.core = roscore

    def rig(self) -> RosRobot:
        return RosRobot(self.core)


def play(rig: RosRobot, story: RobotHarness, *, connected: bool = True, **options: Value) -> None:
    driver_contract.play(rig, lambda harness: story(harness, rig), connected=connected, **options)


async def reported_text(harness: DriverHarness, words: str) -> str:
    """Wait until the driver has reported these words about its base; the whole text."""

    def is_reported() -> bool:
        return any(words in text for _, text in harness.sink.states)

    await harness.until(is_reported, publishing=True)
    return next(text for _, text in harness.sink.states if words in text)


@pytest.mark.parametrize("hangs", [False, True])
def test_all_senses_arrive_as_they_were_sent(roscore: RosCore, hangs: bool) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        sink = harness.sink
        sent = [0.5, math.inf, -math.inf, math.nan, 0.0, *(3.0 for _ in range(355))]
        body.do("ranges", ranges=sent)
        await harness.until(lambda: bool(sink.scans) and math.isinf(sink.scans[-1].ranges[1]))
        scan = sink.scans[-1]
        np.testing.assert_array_equal(scan.ranges, np.array(sent, np.float32))
        np.testing.assert_allclose(
            np.exp(1j * scan.bearings),
            np.exp(1j * np.radians(90.0 + (-1 if hangs else 1) * np.arange(360))),
            atol=1e-5,
        )
        assert sink.odometries[-1].pose.yaw == pytest.approx(0.6)
        assert sink.odometries[-1].twist == Twist(0.1, -0.2)

        def is_read() -> bool:
            body.do("extras")
            return bool(sink.values) and len(sink.values[-1]) == 3

        await harness.until(is_read)
        wanted = {"yaw": 0.5, "battery": 0.75, "battery_voltage": 12.0}
        assert sink.values[-1] == pytest.approx(wanted)
        assert sink.lost.count("ros1/scan") == 0

    play(
        RosRobot(roscore),
        story,
        imu="imu",
        battery="battery",
        battery_percentage="share",
        scan_yaw_deg=90.0,
        scan_upside_down=hangs,
    )


@pytest.mark.parametrize("options", [{}, {"cmd_vel_type": "twist_stamped"}], ids=["auto", "given"])
def test_commands_are_stamped_if_the_base_expects_it(
    roscore: RosCore, options: dict[str, Any]
) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        harness.driver.send(Twist(0.1), 1, 1)
        assert (await harness.command()).is_zero
        harness.driver.send(Twist(0.1, 0.2, 0.3), 1, 1)
        taken: list[Twist] = []

        def is_stopped() -> bool:
            taken.extend(body.commands())
            return len(taken) >= 2

        await harness.until(is_stopped)
        assert taken[0] == Twist(0.1, 0.2, 0.3)
        assert taken[1].is_zero, "the adapter's own zero after a silence"

    play(RosRobot(roscore, "--command-type", "TwistStamped"), story, **options)


def test_another_command_type_of_the_base_is_named(roscore: RosCore) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        text = await reported_text(harness, "wants geometry_msgs/TwistStamped")
        assert "cmd_vel_type: twist_stamped" in text
        assert not harness.sink.is_up

    robot = RosRobot(roscore, "--command-type", "TwistStamped")
    play(robot, story, connected=False, cmd_vel_type="twist")


def test_a_base_that_returns_with_another_type_is_commanded_in_it(roscore: RosCore) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        body.disconnect()
        await harness.until(lambda: not harness.sink.is_up)
        body._words = ("--command-type", "TwistStamped")
        body.reconnect()
        await harness.until(lambda: harness.sink.is_up, publishing=True)
        harness.driver.send(Twist(0.1), 1, 1)
        assert (await harness.command()).is_zero
        taken: list[Twist] = []

        def is_moving() -> bool:
            harness.driver.send(Twist(0.1), 1, 1)
            taken.extend(body.commands())
            return Twist(0.1) in taken

        await harness.until(is_moving, publishing=True)

    play(RosRobot(roscore), story)


def test_a_command_on_another_topic_of_the_base_is_another_nodes(roscore: RosCore) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        def joy(speed: float) -> None:
            message = command_message(Twist(speed), messages.TwistStamped, "")
            data = serialization.encode_twist_stamped(Twist(speed), 1, 2, "")
            body.put("cmd_vel_joy", message, data)

        for _ in range(10):
            joy(0.0)
            await asyncio.sleep(0.1)
        assert harness.sink.is_up, "zeros do not drive"

        commands = f"someone else drives: commands on {body.namespace}/cmd_vel_joy"
        node = f"published by {body.namespace}/robot"

        def is_named() -> bool:
            joy(0.3)  # the master tells the node later than the first command arrives
            return any(commands in text and node in text for _, text in harness.sink.states)

        await harness.until(is_named, publishing=True)
        assert not harness.sink.is_up
        harness.driver.send(ZERO, 3, 3, is_stopped=True)
        assert (await harness.command()).is_zero
        await harness.until(lambda: harness.sink.is_up, publishing=True)

    play(RosRobot(roscore), story, other_commands=["cmd_vel_joy"])


def test_an_active_goal_of_an_action_is_another_nodes_command(roscore: RosCore) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        def report(state: int) -> None:
            goal = ros1_noetic.actionlib_msgs__msg__GoalStatus(goal_id(), state, "")
            header: Any = ros1_noetic.std_msgs__msg__Header(1, TIME, "")
            goals: list[Any] = [goal]  # of ROS 1, in the class of both
            message = messages.ActionlibStatusArray(header, goals)
            body.put("dock/status", message, serialization.encode(message))

        def is_lost() -> bool:
            report(1)
            return not harness.sink.is_up

        await harness.until(is_lost, publishing=True)
        text = await reported_text(harness, "someone else drives: action")
        assert f"rostopic pub -1 {body.namespace}/dock/cancel actionlib_msgs/GoalID" in text

        def is_back() -> bool:
            report(3)
            return harness.sink.is_up

        await harness.until(is_back, publishing=True)

    play(RosRobot(roscore), story, other_actions=["dock"])


def test_a_scan_of_another_type_is_named_and_nothing_moves(roscore: RosCore) -> None:
    async def story(harness: DriverHarness, body: RosRobot) -> None:
        text = await reported_text(harness, "carries sensor_msgs/Range")
        assert "expected sensor_msgs/LaserScan" in text
        await harness.until(lambda: "ros1/type" in harness.sink.lost, publishing=True)
        assert not harness.sink.is_up
        assert not harness.sink.scans

    play(RosRobot(roscore, "--scan-type", "Range"), story, connected=False)


def test_a_field_of_any_topic_is_a_reading_until_it_is_stale(roscore: RosCore) -> None:
    share: Value = {
        "topic": "battery",
        "type": "sensor_msgs/BatteryState",
        "field": "percentage",
        "stale_after": 0.3,
    }

    async def story(harness: DriverHarness, body: RosRobot) -> None:
        sink = harness.sink

        def is_read() -> bool:
            body.do("extras")
            return bool(sink.values) and sink.values[-1] == {"share": 0.75}

        await harness.until(is_read, publishing=True)
        await harness.until(lambda: math.isnan(sink.values[-1]["share"]), publishing=True)
        assert sink.is_up

    play(RosRobot(roscore), story, readings={"share": share})
