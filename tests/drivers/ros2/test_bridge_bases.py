"""Two bases or two lidars in one DDS domain behind the real bridge, and a base that crashed."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import Twist
from swarmd.testing.driver_contract import DriverHarness, play
from tests.drivers.ros2.dds_rig import DdsRobot
from tests.drivers.ros2.harness import drive, reported
from tests.drivers.ros2.robots import open_session
from tests.support import ros2_types as dds
from tests.support.dds_node import DdsNode
from tests.support.ros2_bridge import Bridge, why_no_bridge
from tests.support.stories import story

ROOT = Path(__file__).parents[3]
TAKES = {"/cmd_vel": dds.Twist}

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(bool(why_no_bridge()), reason=why_no_bridge()),
]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("other", "2 nodes take /cmd_vel: /base, /other; "),
        ("base", "2 living nodes named /base take"),
        ("", "/dds_reader_python"),
    ],
)
@story(DdsRobot, connected=False)
async def test_no_command_but_zero_ever_reaches_two_bases(
    harness: DriverHarness, robot: DdsRobot, name: str, words: str
) -> None:
    other = DdsNode(robot.domain, name, {}, TAKES)
    taken: list[float] = []

    def is_held() -> bool:
        harness.driver.send(Twist(0.1), 1, 1)
        taken.extend(command.linear.x for command in other.take("/cmd_vel"))
        taken.extend(command.linear for command in robot.commands())
        return harness.sink.hold is Reason.BASE_CONFLICT

    await harness.until(is_held, publishing=True)
    await harness.until(lambda: is_held() and len(taken) >= 40, publishing=True)
    assert set(taken) == {0.0}
    await harness.until(lambda: reported(harness, words, is_up=True), publishing=True)
    other.close()
    await harness.until(lambda: harness.sink.hold is None, publishing=True)


@story(DdsRobot)
async def test_a_second_bridge_that_takes_the_commands_holds_the_robot(
    harness: DriverHarness, robot: DdsRobot, tmp_path: Path
) -> None:
    await drive(harness)
    with (
        Bridge(tmp_path, robot.domain) as second,
        open_session("client", "connect/endpoints", second.endpoint) as far,
    ):
        far.declare_subscriber("cmd_vel", lambda sample: None)
        await harness.until(  # at first it is a reader of some process
            lambda: reported(harness, "/zenoh_bridge_ros2dds takes /cmd_vel", is_up=True),
            publishing=True,
        )
        assert harness.sink.hold is Reason.BASE_CONFLICT


@pytest.mark.parametrize("name", ["rosbag2_recorder", ""])
@pytest.mark.parametrize("is_first", [True, False])
def test_what_records_commands_holds_nothing(name: str, is_first: bool) -> None:
    robot = DdsRobot()
    nodes = [DdsNode(robot.domain, name, {}, TAKES)] if is_first else []

    async def story(harness: DriverHarness) -> None:
        await drive(harness)
        nodes[1:] = [DdsNode(robot.domain, name, {}, TAKES)]
        for _ in range(60):  # longer than the bridge's whole list is old
            robot.publish()
            await asyncio.sleep(0.05)
        assert all(
            text.startswith("zenoh-bridge-ros2dds") for up, text in harness.sink.states if up
        )
        assert harness.sink.hold is None

    play(robot, story, cmd_vel_listeners=["dds_reader_*"])
    for node in nodes:
        node.close()


@story(lambda: DdsRobot(is_on=False), connected=False)
async def test_a_base_that_crashed_and_is_back_is_stopped_before_it_is_forgotten(
    harness: DriverHarness, robot: DdsRobot
) -> None:
    speeds: list[str] = []

    def has_speed(speed: str) -> bool:
        harness.driver.send(Twist(0.1), 1, 1)
        return speeds[-1:] == [speed]

    with base_process(robot.domain, speeds):
        await harness.until(lambda: has_speed("0.1"))
    speeds.clear()
    with base_process(robot.domain, speeds):
        await harness.until(lambda: reported(harness, "/base take /cmd_vel: it crashed and is"))
        assert harness.sink.hold is Reason.BASE_CONFLICT
        await harness.until(lambda: has_speed("0.0"))
        assert not reported(harness, "living")
        await harness.until(
            lambda: (
                has_speed("0.0")
                and reported(harness, ", but zenoh-bridge-ros2dds does not hand it on")
            )
        )


@story(lambda: DdsRobot(namespace="/tb3_01"), connected=False)
async def test_another_robots_topics_are_not_proposed_after_a_crash(
    harness: DriverHarness, robot: DdsRobot
) -> None:
    others = {"/tb3_02/scan": dds.LaserScan, "/tb3_02/odom": dds.Odometry}
    other = DdsNode(robot.domain, "other", others, {"/tb3_02/cmd_vel": dds.Twist})
    await harness.connect()
    await drive(harness)
    robot.stop()
    await harness.until(lambda: reported(harness, "no /tb3_01/scan any more", is_up=False))
    assert not reported(harness, "tb3_02")
    other.close()


@contextmanager
def base_process(domain: int, speeds: list[str]) -> Iterator[None]:
    """A base in a process of its own, which is killed in the end."""
    command = [sys.executable, "-m", "tests.drivers.ros2.dds_base", str(domain)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as base:
        assert base.stdout is not None
        lines = base.stdout

        def read() -> None:
            for line in lines:
                speeds.append(line.strip())

        reading = threading.Thread(target=read)
        reading.start()
        try:
            yield
        finally:
            base.kill()
            reading.join()
