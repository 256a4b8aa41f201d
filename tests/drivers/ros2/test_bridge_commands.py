"""Whose commands a base behind a real bridge gets, in which type, and by which quality."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from importlib import import_module

import pytest
from cyclonedds.core import Policy, Qos

from swarmd.core.values import Twist
from swarmd.testing.driver_contract import TIMEOUT, DriverHarness, play
from tests.drivers.ros2.dds_rig import DdsRobot
from tests.drivers.ros2.harness import check, drive, reported
from tests.drivers.ros2.robots import open_session
from tests.support import ros2_types as dds
from tests.support.dds_node import RELIABLE, SENSOR, DdsNode
from tests.support.processes import wait_until
from tests.support.ros2_bridge import why_no_bridge
from tests.support.stories import story

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(bool(why_no_bridge()), reason=why_no_bridge()),
]

EXECUTING, SUCCEEDED = 2, 4
KEPT = Qos(
    Policy.Reliability.Reliable(10**8),
    Policy.Durability.TransientLocal,
    Policy.History.KeepLast(10),
)
KEPT_BEST_EFFORT = Qos(
    Policy.Reliability.BestEffort, Policy.Durability.TransientLocal, Policy.History.KeepLast(10)
)
STRICT = Qos(
    Policy.Reliability.Reliable(10**8), Policy.History.KeepLast(10), Policy.Deadline(5 * 10**8)
)
QUALITIES = {
    "best effort": SENSOR,
    "reliable": RELIABLE,
    "reliable, transient local": KEPT,
    "best effort, transient local": KEPT_BEST_EFFORT,
}


@pytest.fixture
def joystick() -> Iterator[Callable[[DdsRobot], DdsNode]]:
    """A node beside the robot that publishes stamped commands on a topic of its own."""
    made: list[DdsNode] = []

    def make(robot: DdsRobot) -> DdsNode:
        published = {"/cmd_vel_stamped": dds.TwistStamped}
        made.append(DdsNode(robot.domain, "joystick", published))
        return made[0]

    yield make
    for node in made:
        node.close()


def test_a_goal_that_began_before_the_driver_is_known() -> None:
    robot = DdsRobot(actions=["dock"])
    assert robot.node is not None
    robot.node.goals("/dock", EXECUTING)

    async def story(harness: DriverHarness) -> None:
        await harness.until(lambda: reported(harness, "action /dock", is_up=False), publishing=True)
        line = {one.subject: one for one in await second.check(5.0)}["last_word"]
        assert not line.is_well, "a second subscriber gets it too"
        assert "action /dock" in line.text
        robot.stop()  # with its server
        robot.start()
        await harness.until(lambda: harness.sink.is_up, publishing=True)

    second = robot.make({"other_actions": ["dock"]})
    play(robot, story, connected=False, other_actions=["dock"])


def test_a_check_names_what_is_silent(joystick: Callable[[DdsRobot], DdsNode]) -> None:
    robot = DdsRobot(actions=["dock"])
    joystick(robot)
    found = check(
        robot,
        robot.publish,
        seconds=TIMEOUT,
        other_commands=["cmd_vel_stamped"],
        other_actions=["dock", "undock"],
    )
    line = found["last_word"]
    assert line.is_well
    assert "may publish /cmd_vel_stamped" in line.text
    assert "has no goal; no node serves action /undock" in line.text


@story(DdsRobot)
async def test_a_base_that_returns_with_another_type_is_commanded_in_it(
    harness: DriverHarness, robot: DdsRobot
) -> None:
    for is_stamped in (True, False):
        robot.stop()
        await harness.until(lambda: not harness.sink.is_up)
        robot.is_stamped = is_stamped
        robot.start()
        await harness.until(lambda: harness.sink.is_up, publishing=True)
        await drive(harness)


@pytest.mark.parametrize("is_stamped", [False, True])
@story(lambda is_stamped: DdsRobot(is_stamped=is_stamped), connected=False)
async def test_the_watchdogs_zero_is_zero_in_either_type(
    harness: DriverHarness, robot: DdsRobot
) -> None:
    spec = robot.make({}).zero_sender()
    module, _, maker = spec.maker.partition(":")
    sender = getattr(import_module(module), maker)(**spec.options)
    sender.open()
    await harness.connect()
    taken: list[Twist] = []

    def has_come() -> bool:
        sender.send_zero()
        taken.extend(robot.commands())
        return bool(taken)

    await harness.until(has_come)
    for twist in taken:
        assert max(abs(twist.linear), abs(twist.angular), abs(twist.lateral)) < 1e-300
    sender.close()


@pytest.mark.parametrize("quality", QUALITIES)
def test_data_and_commands_arrive_whatever_their_quality(quality: str) -> None:
    robot = DdsRobot(qos=dict.fromkeys(("scan", "odom", "cmd_vel"), QUALITIES[quality]))
    second = robot.make({})

    async def story(harness: DriverHarness) -> None:
        await drive(harness)
        checking = asyncio.create_task(second.check(TIMEOUT))
        await harness.until(checking.done, publishing=True)
        found = {one.subject: one for one in checking.result()}
        for subject in ("scan", "odometry"):
            assert found[subject].is_well
            assert f", {quality})" in found[subject].text

    play(robot, story)


@story(lambda: DdsRobot(qos={"cmd_vel": STRICT}))
async def test_commands_arrive_at_a_base_that_wants_a_deadline(harness: DriverHarness) -> None:
    await drive(harness)


@pytest.mark.parametrize(
    ("topic", "first", "later", "subject"),
    [("cmd_vel", RELIABLE, KEPT, "cmd_vel"), ("odom", RELIABLE, SENSOR, "odometry")],
    ids=["base", "odometry"],
)
def test_a_quality_that_the_first_node_of_a_topic_had_not_is_named(
    topic: str, first: Qos, later: Qos, subject: str
) -> None:
    """The bridge's route has the quality of the first node; nothing of the second one passes."""
    robot = DdsRobot(qos={topic: later}, is_on=False)
    published = {f"/{topic}": dds.Odometry} if topic == "odom" else {}
    subscribed = {} if published else {f"/{topic}": dds.Twist}
    other = DdsNode(
        robot.domain, "rosbag2_recorder", published, subscribed, qos={f"/{topic}": first}
    )
    session = open_session("client", "connect/endpoints", robot.endpoint)
    wait_until(lambda: any(session.liveliness().get(f"@/*/@ros2_lv/*/{topic}/**")), "the route")
    robot.start()
    wait_until(lambda: any(session.get("@/*/ros2/node/*/base")), "the bridge lists the base")
    session.close()
    found = check(robot, robot.publish, seconds=4.0)[subject]
    other.close()
    assert not found.is_well
    assert "nothing passes" in found.text
