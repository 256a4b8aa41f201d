"""Driver `ros2dds` at a real zenoh-bridge-ros2dds, the robot a ROS 2 node on DDS."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import pytest
import zenoh

from swarmd.core.values import ZERO, Twist, Value
from swarmd.drivers.ros import cdr, messages
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.drivers.ros2.driver import RosDriver
from swarmd.drivers.ros2.key_scheme import TopicEnd
from swarmd.testing.driver_contract import TIMEOUT, DriverHarness, play
from tests.drivers.ros.contract import DOCKED, RosContract, docked
from tests.drivers.ros2.dds_rig import SENSES, DdsRobot
from tests.drivers.ros2.harness import check, drive_on, freeze, reported
from tests.drivers.ros2.robots import open_session
from tests.drivers.ros2.stops import ESTOP, STATE, STOP, Empty, served
from tests.support import ros2_types as dds
from tests.support.dds_node import DdsNode
from tests.support.processes import wait_until
from tests.support.ros2_bridge import why_no_bridge
from tests.support.stories import story

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(bool(why_no_bridge()), reason=why_no_bridge()),
]


class TestContract(RosContract):
    def rig(self) -> DdsRobot:
        return DdsRobot(published={**SENSES, "bumper": dds.Bool})


async def moves(harness: DriverHarness, earlier: Sequence[Twist] = ()) -> None:
    """Wait until the base gets a command to move, after a zero; `earlier`: what it got before."""
    taken = [*earlier]

    def is_moving() -> bool:
        harness.driver.send(Twist(0.1, -0.2), 1, 1)
        taken.extend(harness.rig.commands())
        return bool(taken) and taken[-1] == Twist(0.1, -0.2)

    await harness.until(is_moving, publishing=True)
    assert taken[0].is_zero


async def reports_lost(harness: DriverHarness, words: str) -> None:
    """Wait until the driver reports the base as lost with this text."""
    await harness.until(lambda: reported(harness, words, is_up=False), publishing=True)


@pytest.mark.parametrize(
    ("namespace", "at"), [("/tb3_01", ""), ("", "/tb3_01"), ("/front", "/tb3_01")]
)
def test_a_namespace_is_the_robots_or_the_bridges(namespace: str, at: str) -> None:
    play(DdsRobot(namespace=namespace, at=at), moves)


@story(DdsRobot)
async def test_a_frozen_bridge_is_reported_and_no_late_command_moves_the_robot(
    harness: DriverHarness, robot: DdsRobot
) -> None:
    await moves(harness)
    await freeze(harness, robot.bridge.freeze)
    zeros = await drive_on(harness, robot.bridge.thaw)
    assert all(twist.is_zero for twist in zeros)
    await harness.connect()
    await moves(harness, zeros)


@story(DdsRobot)
async def test_a_bridge_that_freezes_under_a_command_delivers_that_one_and_zero_after_it(
    harness: DriverHarness, robot: DdsRobot
) -> None:
    """No end of the link can take back a command that left while the bridge froze.

    The base keeps ten commands: it may see the zeros after the late command alone.
    """
    assert isinstance(harness.driver, RosDriver)
    await moves(harness)
    await freeze(harness, robot.bridge.freeze)
    harness.driver._credit.hear(asyncio.get_running_loop().time())
    harness.driver.send(Twist(0.2), 1, 1)
    first, *others = await drive_on(harness, robot.bridge.thaw)
    assert first in (Twist(0.2), ZERO)
    assert others
    assert all(twist.is_zero for twist in others)


@story(lambda: DdsRobot(published={}), connected=False)
async def test_a_base_that_leaves_while_its_lidar_stays_gets_zero_first(
    harness: DriverHarness, robot: DdsRobot
) -> None:
    lidar = DdsNode(robot.domain, "lidar", {"/scan": dds.LaserScan})
    stop_speaking = asyncio.create_task(_spin(lidar))
    await moves(harness)
    robot.stop()
    await reports_lost(harness, "no node subscribes to /cmd_vel")
    harness.driver.send(Twist(0.1), 1, 1)
    robot.start()
    await moves(harness)
    stop_speaking.cancel()
    lidar.close()


async def _spin(lidar: DdsNode) -> None:
    """The scans of a lidar that is a node of its own."""
    for count in itertools.count(100):
        stamp = dds.Time(count, 0)
        step = 2.0 * math.pi / 360
        header = dds.Header(stamp, "base_scan")
        lidar.publish(
            "/scan", dds.LaserScan(header=header, angle_increment=step, ranges=[2.0] * 360)
        )
        await asyncio.sleep(0.02)


def test_the_bridge_and_its_stand_in_announce_and_send_the_same() -> None:
    robot = DdsRobot()
    session = open_session("client", "connect/endpoints", robot.endpoint)
    tokens: set[str] = set()
    samples: list[zenoh.Sample] = []
    session.liveliness().declare_subscriber(
        "@/*/@ros2_lv/*/**", lambda token: tokens.add(str(token.key_expr)), history=True
    )
    session.declare_subscriber("scan", samples.append)
    ends = (
        TopicEnd("/scan", messages.LaserScan, is_publisher=True, is_reliable=False, depth=5),
        TopicEnd("/odom", messages.Odometry, is_publisher=True, is_reliable=True, depth=10),
        TopicEnd("/cmd_vel", messages.Twist, is_publisher=False, is_reliable=True, depth=10),
    )

    def is_all_there() -> bool:
        robot.publish()
        return len(tokens) == len(ends) and bool(samples)

    wait_until(is_all_there, "three tokens and a scan")
    zid = next(iter(tokens)).split("/")[1]
    assert tokens == set(Ros2Dds().tokens(zid, ends))
    assert samples[0].attachment is None
    assert len(cdr.decode(messages.LaserScan, samples[0].payload.to_bytes()).ranges) == 360
    session.close()
    robot.close()


@story(DdsRobot)
async def test_a_restarted_bridges_announcements_are_gone_with_it(
    harness: DriverHarness, robot: DdsRobot
) -> None:
    await moves(harness)
    robot.disconnect()
    await reports_lost(harness, "nothing answers at")
    robot.stop()
    robot.reconnect()
    await reports_lost(harness, "announces no topic at all")


@pytest.mark.parametrize(
    ("make", "wanted"),
    [
        (DdsRobot, {}),
        (
            lambda: DdsRobot(is_elsewhere=True),
            {"scan": "ROS_DOMAIN_ID", "cmd_vel": "no node subscribes to /cmd_vel; start the base"},
        ),
        (lambda: DdsRobot(distro="humble"), {"scan": "ROS_DISTRO"}),
    ],
    ids=["well", "domain", "distro"],
)
def test_check_reports_the_cause(make: Callable[[], DdsRobot], wanted: dict[str, str]) -> None:
    robot = make()
    seconds, tries = (3.0, 1) if wanted else (TIMEOUT / 4.0, 3)
    found = check(robot, robot.publish, seconds=seconds, tries=tries)
    assert found["connection"].is_well
    for subject, text in wanted.items():
        assert not found[subject].is_well
        assert text in found[subject].text
    if not wanted:
        assert all(finding.is_well for finding in found.values()), found


def test_check_of_a_robot_that_is_off_asks_to_start_it() -> None:
    robot = DdsRobot(is_on=False)
    found = check(robot, seconds=2.0)
    assert "start the robot" in found["scan"].text
    assert "no node subscribes to /cmd_vel" in found["cmd_vel"].text


@story(DdsRobot, connected=False, readings=DOCKED)
async def test_a_latched_message_reaches_the_second_subscriber_of_a_bridge(
    harness: DriverHarness, robot: DdsRobot
) -> None:
    """The first makes the bridge read the writer's history; for others it has a cache."""
    dock, heard = robot.dock(is_latched=True), list[zenoh.Sample]()
    session = open_session("client", "connect/endpoints", robot.endpoint)
    session.declare_subscriber("dock", heard.append)
    dock.put(True)
    wait_until(lambda: len(heard) > 0, "another subscriber has the message")
    await harness.connect()
    await harness.until(lambda: docked(harness) == 1.0, publishing=True)
    dock.put(False)
    await harness.until(lambda: docked(harness) == 0.0, publishing=True)
    session.close()
    dock.close()


@story(DdsRobot)
async def test_a_node_on_dds_stops_the_robot_and_gets_the_answer(
    harness: DriverHarness, robot: DdsRobot
) -> None:
    """`ros2 topic pub` publishes with durability TRANSIENT_LOCAL, and waits for a subscription."""
    commands = served(harness)
    kinds = {f"/{STOP}": Empty, f"/{ESTOP}": dds.String}
    state = f"/{STATE}"
    node = DdsNode(robot.domain, "caller", kinds, {state: dds.String}, latched=[*kinds])

    async def told(topic: str, message: Any) -> str:
        await harness.until(lambda: node.is_heard(topic), publishing=True)
        node.publish(topic, message)
        texts: list[str] = []

        def is_answered() -> bool:
            texts.extend(one.data for one in node.take(state))
            return bool(texts)

        await harness.until(is_answered, publishing=True)
        return texts[0]

    await told(f"/{STOP}", Empty())
    assert await told(f"/{ESTOP}", dds.String("smoke")) == "estop done"
    assert [(one.verb, one.reason) for one in commands] == [("stop", ""), ("estop", "smoke")]
    # The writer keeps its messages, and the robot gets neither of them again.
    assert await told(f"/{STOP}", Empty()) == "stop done"
    assert [one.verb for one in commands] == ["stop", "estop", "stop"]
    node.close()


SERVICES: dict[str, Value] = {"operator": "ros", "runs": {"go": {"pattern": "drive"}}}
RESET, GO = "/swarmd/reset", "/swarmd/run/go"


@story(DdsRobot, services=SERVICES)
async def test_services_are_called_over_dds_and_not_late(
    harness: DriverHarness, robot: DdsRobot
) -> None:
    """A call that waited in a frozen bridge has no known age, so that the daemon refuses a run."""
    commands = served(harness)
    caller = DdsNode(robot.domain, "caller", clients=[RESET, GO])
    answers: dict[int, Any] = {}
    count = itertools.count(1)

    def is_served(service: str) -> bool:
        """A call before the bridge has its route is lost."""
        caller.call(service, next(count))
        answers.update(caller.answers(service))
        return bool(answers)

    await harness.until(lambda: is_served(RESET), publishing=True)
    answer = answers.popitem()[1]
    assert (answer.success, answer.message, commands[-1].verb) == (True, "reset done", "reset")

    async def settle() -> None:
        while not (commands and commands[-1].age is not None):
            await harness.until(lambda: is_served(GO), publishing=True)
            answers.clear()
            await asyncio.sleep(0.2)

    commands.clear()
    await settle()
    assert commands[-1].verb == "run"

    robot.bridge.freeze()
    await asyncio.sleep(0.2)
    caller.call(GO, 10**6)
    await asyncio.sleep(2.0)
    commands.clear()
    robot.bridge.thaw()
    await harness.until(lambda: 10**6 in caller.answers(GO), publishing=True)
    assert {command.age for command in commands} == {None}
    commands.clear()
    await settle()
    caller.close()
