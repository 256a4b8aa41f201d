"""Faults of a robot on either ROS 2 middleware: each is reported once, and the robot stops."""

from __future__ import annotations

import asyncio
import logging
import math
import threading
import time
from collections.abc import Callable

import pytest
import zenoh

from swarmd.core.values import Twist
from swarmd.drivers.ros2 import driver as ros_driver
from swarmd.drivers.ros2.session import open_session
from swarmd.link.carriers.session import has_subscriber
from swarmd.testing.driver_contract import TIMEOUT, CollectingSink, DriverHarness, play
from tests.drivers.ros2 import robots
from tests.drivers.ros2.harness import check, drive, reported
from tests.drivers.ros2.robots import BridgedRobot, Robot, ZenohRobot
from tests.support.stories import story

pytestmark = pytest.mark.long

LASER, TWIST = "sensor_msgs/msg/LaserScan", "geometry_msgs/msg/Twist"
STAMPED = "geometry_msgs/msg/TwistStamped"
MAKERS: list[Callable[[], Robot]] = [BridgedRobot, ZenohRobot]


@pytest.fixture(autouse=True)
def _reports_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """The driver explains a fault 0.3 s after its start instead of 2 s."""
    monkeypatch.setattr(ros_driver, "_EXPLAIN_PERIOD", 0.3)


class Deaf(BridgedRobot):
    """Takes commands on another topic."""

    def command_key(self) -> str:
        return "bot1/cmd_vel"


async def stays_lost(harness: DriverHarness, words: str) -> None:
    """The driver reports the loss, and no command reaches the base meanwhile."""

    def is_reported() -> bool:
        harness.driver.send(Twist(0.1), 1, 1)
        return reported(harness, words, is_up=False)

    await harness.until(is_reported, publishing=True)
    await asyncio.sleep(0.1)
    harness.rig.commands()
    for _ in range(10):
        harness.driver.send(Twist(0.1), 1, 1)
        harness.rig.publish()
        await asyncio.sleep(0.01)
    assert not harness.sink.is_up
    assert all(twist.is_zero for twist in harness.rig.commands())


@story(BridgedRobot, ZenohRobot, connected=False)
async def test_a_base_that_wants_another_type_is_not_commanded(
    harness: DriverHarness, robot: Robot
) -> None:
    robot.announce("MS", "cmd_vel", STAMPED)
    await stays_lost(harness, "set driver_options.cmd_vel_type: twist_stamped")
    robot.announce("MS", "cmd_vel", TWIST)
    await harness.connect()
    assert (await harness.command(Twist(0.1))).is_zero


@story(BridgedRobot, ZenohRobot)
async def test_a_base_that_announces_another_type_later_is_lost(
    harness: DriverHarness, robot: Robot
) -> None:
    for seq in range(2):
        harness.driver.send(Twist(0.1), seq, seq)
    robot.announce("MS", "cmd_vel", STAMPED)
    await stays_lost(harness, f"/cmd_vel wants {STAMPED}, not {TWIST}")


@story(lambda: BridgedRobot(is_stamped=True))
async def test_the_last_zero_is_zero_also_to_a_base_that_reads_it_as_a_twist(
    harness: DriverHarness, robot: BridgedRobot
) -> None:
    for seq in range(2):
        harness.driver.send(Twist(0.1), seq, seq)
    await harness.until(lambda: bool(robot.samples()))
    robot.samples()
    robot.announce("MS", "cmd_vel", TWIST)
    await harness.until(lambda: not harness.sink.is_up, publishing=True)
    await harness.end()
    payloads: list[bytes] = []

    def are_last_zero() -> bool:
        """The last two, after stamped zeros that were under way."""
        payloads.extend(sample.payload.to_bytes() for sample in robot.samples())
        taken = [robots.twist(payload[:52], is_stamped=False) for payload in payloads[-2:]]
        speeds = [abs(v) for one in taken for v in (one.linear, one.angular, one.lateral)]
        return len(taken) == 2 and max(speeds) < 1e-9

    await harness.until(are_last_zero)


def test_a_robot_whose_base_takes_no_commands_is_lost() -> None:
    robot = Deaf()
    robot.announce("MP", "scan", LASER)
    robot.announce("MS", "bot1/cmd_vel", TWIST)
    words = "no node subscribes to /cmd_vel, but to /bot1/cmd_vel; correct driver_options.namespace"
    play(robot, lambda harness: stays_lost(harness, words), connected=False)


@pytest.mark.parametrize("has_old_base", [False, True], ids=["an old lidar", "an old base"])
def test_check_names_the_distribution_of_a_node_that_the_bridge_cannot_read(
    has_old_base: bool,
) -> None:
    """Up to Humble nodes announce their ends in another form: the bridge lists no node of them."""
    robot = BridgedRobot()
    robot.list_nodes()
    robot.announce("MP", "odom", "nav_msgs/msg/Odometry")
    published = {"/odom": "nav_msgs/msg/Odometry"}
    if has_old_base:
        robot.announce("MP", "scan", LASER)
        robot.list_node("aa", "lidar", {**published, "/scan": LASER})
        robot.list_writer("aa")
        robot.list_reader("bb")
    else:
        robot.announce("MS", "cmd_vel", TWIST)
        robot.list_node("aa", "base", published, {"/cmd_vel": TWIST})
        robot.list_reader("aa")
        robot.list_writer("bb")
    publish = robot.publish if has_old_base else robot.publish_odometry
    found = check(robot, publish, seconds=1.5, cmd_vel_type="twist")
    old, other = ("cmd_vel", "scan") if has_old_base else ("scan", "cmd_vel")
    assert not found[old].is_well
    assert "ROS_DISTRO" in found[old].text
    assert "correct driver_options" not in found[old].text
    assert found[other].is_well


class Sleeper:
    """A lidar that spins up once a node has subscribed for so many seconds, on either side."""

    def __init__(self, robot: Robot, seconds: float) -> None:
        self._robot, self._seconds = robot, seconds
        self._woken_at = math.inf
        self._scans = robot.hub.declare_publisher(
            robot.key("scan", "LaserScan") if isinstance(robot, ZenohRobot) else "scan"
        )

    def publish(self) -> None:
        now = time.monotonic()
        if math.isinf(self._woken_at) and self._is_subscribed():
            self._woken_at = now + self._seconds
        if now >= self._woken_at:
            self._robot.publish()
        else:
            self._robot.publish_odometry()

    def _is_subscribed(self) -> bool:
        """A node of rmw_zenoh counts tokens; a bridge reads DDS for a Zenoh subscriber."""
        if not isinstance(self._robot, ZenohRobot):
            return has_subscriber(self._scans)
        replies = self._robot.hub.liveliness().get("@ros2_lv/*/*/*/*/MS/*/*/*/%scan/**")
        return any(reply.ok is not None for reply in replies)


@pytest.mark.parametrize("make", MAKERS)
def test_check_wakes_a_lidar_that_sleeps_and_waits_for_it(make: Callable[[], Robot]) -> None:
    robot = make()
    robot.announce("MP", "scan", LASER)
    robot.announce("MS", "cmd_vel", TWIST)
    lidar = Sleeper(robot, seconds=1.0)
    found = check(robot, lidar.publish, seconds=0.5)
    assert found["scan"].is_well, found["scan"].text


def test_check_does_not_count_its_own_subscription() -> None:
    robot = Deaf()
    found = check(robot, robot.publish)
    assert not found["cmd_vel"].is_well
    assert found["cmd_vel"].text.startswith("no node subscribes to /cmd_vel; start the base, or")


@story(BridgedRobot, ZenohRobot)
async def test_the_first_command_after_an_instant_restart_of_the_hub_is_zero(
    harness: DriverHarness, robot: Robot
) -> None:
    until = asyncio.get_running_loop().time() + 0.5  # the driver has looked up its link
    while asyncio.get_running_loop().time() < until:
        harness.driver.send(Twist(0.1), 1, 1)
        robot.publish()
        await asyncio.sleep(0.01)
    robot.disconnect()
    robot.reconnect()
    await harness.until(
        lambda: reported(harness, "was started again", is_up=False), publishing=True
    )
    await harness.until(lambda: harness.sink.is_up, publishing=True)
    robot.commands()
    assert (await harness.command(Twist(0.1))).is_zero


@pytest.mark.parametrize("make", MAKERS)
def test_one_cause_is_one_line_in_the_log(
    make: Callable[[], Robot], caplog: pytest.LogCaptureFixture
) -> None:
    robot = make()
    robot.announce("MP", "bot1/scan", LASER)
    robot.announce("MP", "bot1/odom", "nav_msgs/msg/Odometry")

    async def story(harness: DriverHarness) -> None:
        await harness.until(
            lambda: reported(harness, "no /scan, but /bot1/scan of that type; correct")
        )
        await asyncio.sleep(1.0)  # it is examined again

    play(robot, story, connected=False)
    (line,) = [record for record in caplog.records if "driver" in record.name]
    assert line.levelno == logging.WARNING
    assert line.getMessage().count(";") == 1


@pytest.mark.parametrize(
    ("scan", "words"),
    [
        (lambda robot: robots.scan(5.0), "all with the stamp 5; look at the sensor"),
        (
            lambda robot: robots.scan(robot._stamp(), [1.0] * 180, angle_increment=0.0174),
            "180 rays that leave too wide a sector unseen; look at",
        ),
        (lambda robot: robots.scan(robot._stamp(), angle_max=-6.28), "wrong sign"),
    ],
    ids=["constant stamps", "half a scan", "a mirrored header"],
)
@story(BridgedRobot)
async def test_scans_that_cannot_be_relied_on_are_reported_while_the_driver_runs(
    harness: DriverHarness, robot: BridgedRobot, scan: Callable[[Robot], object], words: str
) -> None:
    def is_reported() -> bool:
        robot.publish_odometry()
        robot.put("scan", scan(robot))
        return reported(harness, words, is_up=True)

    await harness.until(is_reported)


@pytest.mark.parametrize(
    ("make", "step"), [(BridgedRobot, "start zenoh-bridge-ros2dds"), (ZenohRobot, "rmw_zenohd")]
)
def test_check_without_a_hub_names_what_to_start(make: Callable[[], Robot], step: str) -> None:
    robot = make()
    robot.disconnect()
    found = check(robot, seconds=1.2)
    assert list(found) == ["connection"]
    assert step in found["connection"].text
    assert robot.endpoint in found["connection"].text


def test_the_command_type_of_a_base_is_known_before_its_first_message() -> None:
    robot = BridgedRobot()
    robot.announce("MS", "cmd_vel", TWIST)
    is_ending = threading.Event()

    def publish() -> None:
        while not is_ending.wait(0.0003):
            robot.publish()

    async def run() -> bool:
        driver, sink = robot.make({"cmd_vel_type": "twist_stamped"}), CollectingSink()
        running = asyncio.create_task(driver.run(sink))
        async with asyncio.timeout(TIMEOUT):
            while len(sink.states) < 2:
                await asyncio.sleep(0.01)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        return any(is_up for is_up, _ in sink.states)

    publisher = threading.Thread(target=publish)
    publisher.start()
    try:
        assert not any(asyncio.run(run()) for _ in range(3))
    finally:
        is_ending.set()
        publisher.join()
        robot.close()


@pytest.mark.parametrize("make", MAKERS)
def test_invalid_names_add_no_second_line(make: Callable[[], Robot]) -> None:
    robot = make()
    robot.announce("MP", "bot1/scan\nok    scan", LASER)
    robot.announce("MP", "bot1/" + 2000 * "x", LASER)
    found = check(robot, robot.publish_odometry, seconds=2.0)
    assert "announces no topic at all" in found["scan"].text
    assert found["scan"].text.isprintable()


@story(BridgedRobot, connected=False, cmd_vel_type="auto")
async def test_a_base_is_found_among_more_topics_of_others_than_are_kept(
    harness: DriverHarness, robot: BridgedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros_driver, "_MAX_ENDPOINTS", 8)
    for count in range(20):
        robot.announce("MP", f"other{count}", "std_msgs/msg/Bool")
    robot.announce("MS", "cmd_vel", TWIST)
    await harness.connect()
    await drive(harness)


def test_a_hub_that_answers_as_the_check_ends_leaves_no_session(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An open session that listens to anything keeps its process alive for ever."""
    robot, made = BridgedRobot(), []
    is_over = threading.Event()

    def late(endpoint: str, within: float) -> zenoh.Session | None:
        is_over.wait(TIMEOUT)
        made.append(open_session(endpoint, within=within))
        return made[-1]

    async def run() -> None:
        await robot.make({}).check(0.05)
        is_over.set()

    monkeypatch.setattr("swarmd.drivers.ros2.driver.open_session", late)
    asyncio.run(run())
    assert [session is not None and session.is_closed() for session in made] == [True]
    robot.close()
