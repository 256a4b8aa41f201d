"""The ros2dds driver against a stand-in for a robot behind its bridge, over real Zenoh."""

from __future__ import annotations

import asyncio
import math

import numpy as np
import pytest

from swarmd.core.values import Pose, Twist, Value
from swarmd.testing.driver_contract import DriverContract, DriverHarness
from tests.drivers.ros2 import robots
from tests.drivers.ros2.robots import BridgedRobot
from tests.drivers.ros2.stories import check, drive, play, told
from tests.support import second_codec as second


class TestContract(DriverContract):
    def rig(self) -> BridgedRobot:
        return BridgedRobot()


class TestStampedContract(DriverContract):
    def rig(self) -> BridgedRobot:
        return BridgedRobot(is_stamped=True)


def test_all_senses_arrive_with_their_meaning() -> None:
    robot = BridgedRobot()

    async def story(harness: DriverHarness) -> None:
        ranges = [1.0 + 0.001 * i for i in range(250)]
        robot.put("scan", robots.scan(500.0, ranges))
        robot.put("odom", robots.odometry(501.0, x=2.0, yaw=1.0))
        robot.put("imu", second.Imu(orientation=second.Quaternion(z=1.0, w=0.0)))
        robot.put("battery_state", second.BatteryState(voltage=11.5, percentage=0.5))
        heard = harness.sink
        await harness.until(lambda: bool(heard.values) and "battery" in heard.values[-1])
        await harness.until(lambda: heard.odometries[-1].stamp == 501.0)
        await harness.until(lambda: heard.scans[-1].stamp == 500.0)
        np.testing.assert_allclose(heard.scans[-1].ranges, ranges, rtol=1e-6)
        pose = heard.odometries[-1].pose
        assert pose.x == 2.0
        assert pose.yaw == pytest.approx(1.0)
        assert heard.values[-1]["yaw"] == pytest.approx(math.pi)
        assert heard.values[-1]["battery"] == pytest.approx(0.5)

    play(robot, story, imu="imu", battery="battery_state")


def test_topics_stand_behind_the_namespace() -> None:
    robot = BridgedRobot()

    async def story(harness: DriverHarness) -> None:
        await asyncio.sleep(0.2)
        robot.publish()
        robot.put("r/scan", robots.scan(1.0))
        await harness.until(lambda: harness.sink.is_up)
        assert len(harness.sink.scans) <= 1
        assert not harness.sink.odometries

    play(robot, story, connected=False, namespace="{robot}")


def test_seven_ranges_are_one_scan() -> None:
    robot = BridgedRobot()
    degrees = {"p/l2": 40.0, "p/l1": 20.0, "p/c": 0.0, "p/r1": -20.0, "p/r2": -40.0}
    ranges: dict[str, Value] = {**degrees, "p/bl": 150.0, "p/br": [-150.0, 0.05]}

    async def story(harness: DriverHarness) -> None:
        stamps = iter(range(1, 10_000))

        def has_scans() -> bool:
            stamp = 0.1 * next(stamps)
            for i, name in enumerate(ranges):
                message = second.Range(header=second.stamped(stamp), range=0.02 * (i + 1))
                robot.put(name, message)
            return len(harness.sink.scans) >= 3

        await harness.until(has_scans)
        scan = max(harness.sink.scans, key=lambda scan: np.isfinite(scan.ranges).sum())
        wanted = [0.02, 0.04, 0.06, 0.08, 0.10, 0.12, 0.14 + 0.05]
        np.testing.assert_allclose(scan.ranges, wanted, rtol=1e-5)
        np.testing.assert_allclose(np.degrees(scan.bearings), [40, 20, 0, -20, -40, 150, -150])

    play(robot, story, connected=False, ranges=ranges)


def test_stamped_commands_are_in_the_frame_asked_for() -> None:
    robot = BridgedRobot(is_stamped=True)

    async def story(harness: DriverHarness) -> None:
        harness.driver.send(Twist(0.1), 1, 1)
        samples = robot.samples()
        while not samples:
            await asyncio.sleep(0.01)
            samples = robot.samples()
        message = second.TwistStamped.deserialize(samples[0].payload.to_bytes())
        assert message.header.frame_id == "base_footprint"
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == (0, 0)

    play(robot, story, cmd_vel_frame="base_footprint")


def test_another_nodes_command_is_reported_and_the_driver_stops_publishing() -> None:
    robot = BridgedRobot()

    async def story(harness: DriverHarness) -> None:
        await drive(harness)

        def is_lost() -> bool:
            robot.put("cmd_vel", robots.command(0.3))
            return not harness.sink.is_up

        await harness.until(is_lost, publishing=True)
        assert told(harness, "another node drives this robot", is_up=False)
        await harness.until(lambda: any(twist.is_zero for twist in robot.commands()))
        harness.driver.send(Twist(0.1), 2, 2)
        await asyncio.sleep(0.2)
        assert {twist.linear for twist in robot.commands()} <= {0.3}, "but for the other node's"
        await harness.connect()
        harness.driver.send(Twist(0.1), 3, 3)
        assert (await harness.command()).is_zero

    play(robot, story)


def test_a_base_that_is_started_anew_in_no_time_gets_zero_first() -> None:
    robot = BridgedRobot()
    zid = robot.hub.zid()
    token = f"@/{zid}/@ros2_lv/MS/cmd_vel/geometry_msgs§msg§Twist/:1::0,10"
    base = robot.hub.liveliness().declare_token(token)

    async def story(harness: DriverHarness) -> None:
        await drive(harness)
        base.undeclare()
        robot.announce(token)
        await asyncio.sleep(0.3)
        robot.publish()
        assert harness.sink.is_up
        robot.commands()
        harness.driver.send(Twist(0.1), 2, 2)
        assert (await harness.command()).is_zero

    play(robot, story)


def test_another_nodes_zeros_do_not_count_as_driving() -> None:
    robot = BridgedRobot()

    async def story(harness: DriverHarness) -> None:
        for _ in range(20):
            robot.put("cmd_vel", robots.command(0.0))
            robot.publish()
            await asyncio.sleep(0.01)
        assert harness.sink.is_up

    play(robot, story)


def test_commands_of_its_own_are_not_taken_for_anothers() -> None:
    robot = BridgedRobot()

    async def story(harness: DriverHarness) -> None:
        for _ in range(30):
            harness.driver.send(Twist(0.1), 1, 1)
            robot.publish()
            await asyncio.sleep(0.01)
        assert harness.sink.is_up

    play(robot, story)


def test_a_scan_with_nan_and_zeros_passes_as_it_is() -> None:
    robot = BridgedRobot()

    async def story(harness: DriverHarness) -> None:
        robot.put("scan", robots.scan(900.0, [math.nan, 0.0, math.inf, 1.0] * 90))
        await harness.until(lambda: harness.sink.scans[-1].stamp == 900.0)
        wanted = [math.nan, 0.0, math.inf, 1.0] * 90
        np.testing.assert_array_equal(harness.sink.scans[-1].ranges, wanted)

    play(robot, story)


def test_odometry_that_is_not_finite_is_counted() -> None:
    robot = BridgedRobot()

    async def story(harness: DriverHarness) -> None:
        robot.put("odom", robots.odometry(900.0, x=math.nan))
        await harness.until(lambda: "odometry" in harness.sink.lost)
        assert all(odometry.pose != Pose(math.nan) for odometry in harness.sink.odometries)

    play(robot, story)


def test_check_tells_rates_types_and_clocks() -> None:
    robot = BridgedRobot()
    found = check(robot, robot.publish)
    assert all(finding.is_well for finding in found.values())
    assert "zenoh-bridge-ros2dds at tcp/" in found["connection"].text
    assert "/scan (sensor_msgs/msg/LaserScan): " in found["scan"].text
    assert " Hz, 360 rays, stamps advanced " in found["scan"].text
    assert "/cmd_vel (geometry_msgs/msg/Twist) has a subscriber" in found["cmd_vel"].text
    assert "no other node publishes /cmd_vel" in found["others"].text


def test_check_without_a_bridge_says_what_to_start() -> None:
    robot = BridgedRobot()
    robot.disconnect()
    found = check(robot, seconds=1.5)
    assert list(found) == ["connection"]
    assert "start zenoh-bridge-ros2dds" in found["connection"].text
    assert robot.endpoint in found["connection"].text


def announce(robot: BridgedRobot, what: str, topic: str, kind: str) -> None:
    zid = str(robot.hub.zid())
    robot.announce(f"@/{zid}/@ros2_lv/{what}/{topic}/{kind.replace('/', '§')}/:::1,5")


@pytest.mark.parametrize(
    ("topic", "kind", "wanted"),
    [
        (
            "bot1§scan",
            "sensor_msgs/msg/LaserScan",
            "no /scan, but /bot1/scan of that type; correct",
        ),
        ("scan", "sensor_msgs/msg/PointCloud2", "/scan carries sensor_msgs/msg/PointCloud2; want"),
        ("scan", "sensor_msgs/msg/LaserScan", "/scan is announced but silent; look at the sensor"),
        ("tf", "tf2_msgs/msg/TFMessage", "no /scan among /tf; start the sensor, or correct"),
    ],
)
def test_check_of_a_silent_topic_goes_by_what_is_announced(
    topic: str, kind: str, wanted: str
) -> None:
    robot = BridgedRobot()
    announce(robot, "MP", topic, kind)
    found = check(robot, robot.publish_odometry, seconds=1.0)
    assert not found["scan"].is_well
    assert wanted in found["scan"].text


def test_check_reports_an_unnamed_publisher_of_commands() -> None:
    robot = BridgedRobot()
    announce(robot, "MP", "cmd_vel", "geometry_msgs/msg/Twist")
    announce(robot, "MS", "cmd_vel", "geometry_msgs/msg/Twist")
    found = check(robot, robot.publish)
    zid = str(robot.hub.zid())
    assert found["others"].is_well
    assert found["others"].text.startswith(f"a node behind bridge {zid[:8]} may publish /cmd_vel")


def test_check_reports_commands_without_a_subscriber() -> None:
    found = check(BridgedRobot(), seconds=1.0, cmd_vel="other_vel")
    assert not found["cmd_vel"].is_well
    assert "no node subscribes to /other_vel" in found["cmd_vel"].text


def test_check_reports_commands_of_other_nodes() -> None:
    robot = BridgedRobot()

    def speak() -> None:
        robot.publish()
        robot.put("cmd_vel", robots.command(0.0))

    found = check(robot, speak)
    assert not found["others"].is_well
    assert "commands of another node on /cmd_vel" in found["others"].text


def test_a_missing_topic_is_reported_while_the_driver_runs() -> None:
    robot = BridgedRobot()
    announce(robot, "MP", "bot1§scan", "sensor_msgs/msg/LaserScan")

    async def story(harness: DriverHarness) -> None:
        await harness.until(lambda: told(harness, "no /scan, but /bot1/scan", is_up=False))
        robot.publish_odometry()
        await harness.until(lambda: harness.sink.is_up)

        def is_told() -> bool:
            robot.publish_odometry()
            return told(harness, "no /scan, but /bot1/scan", is_up=True)

        await harness.until(is_told)

    play(robot, story, connected=False)
