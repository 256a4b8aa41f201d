"""Driver `ros2dds` and a robot whose nodes are on Fast DDS, behind the real bridge."""

from __future__ import annotations

import itertools
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from swarmd.core.messages import Code, Reply
from swarmd.driver_api.command_source import Answer, DriverCommand, command_source
from swarmd.testing.driver_contract import DriverHarness, play
from tests.drivers.ros.contract import RosContract
from tests.drivers.ros2.dds_rig import SENSES, DdsRobot
from tests.drivers.ros2.harness import check
from tests.support import ros2_types as dds
from tests.support.dds_node import DdsNode
from tests.support.fast_dds import FastDdsNode, compile_node, why_no_fast_dds
from tests.support.ros2_bridge import why_no_bridge

pytestmark = [
    pytest.mark.evidence,
    pytest.mark.integration,
    pytest.mark.skipif(bool(why_no_bridge()), reason=why_no_bridge()),
    pytest.mark.skipif(bool(why_no_fast_dds()), reason=why_no_fast_dds()),
]
STOP, ESTOP = "/swarmd/stop", "/swarmd/estop"
DROPPED = "received invalid request"
"""What the bridge writes of a call without the header that rmw_cyclonedds_cpp puts before it."""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compile_node(tmp_path_factory.mktemp("fast_dds"))


class TestContract(RosContract):
    @pytest.fixture(autouse=True)
    def _compiled(self, program: Path) -> None:
        self._make_node = partial(FastDdsNode, program)

    def rig(self) -> DdsRobot:
        published = {**SENSES, "bumper": dds.Bool}
        return DdsRobot(published=published, make_node=self._make_node)


def test_check_finds_the_topics_and_the_node(program: Path) -> None:
    robot = DdsRobot(make_node=partial(FastDdsNode, program))
    found = check(robot, robot.publish, tries=4)
    assert "/scan (sensor_msgs/msg/LaserScan, best effort)" in found["scan"].text
    assert "/odom (nav_msgs/msg/Odometry, reliable)" in found["odometry"].text
    assert found["cmd_vel"].text.endswith("has a subscriber: /base")


def test_check_warns_of_services_that_the_node_cannot_call(program: Path) -> None:
    robot = DdsRobot(make_node=partial(FastDdsNode, program))
    found = check(robot, robot.publish, tries=4, services={"operator": "ros"})
    assert not found["services"].is_well
    assert "drops calls by Fast DDS, also of stop and estop: /base" in found["services"].text


def test_the_bridge_drops_the_calls_of_services(program: Path) -> None:
    """A call by a node on Fast DDS does nothing and has no answer; one by CycloneDDS has."""
    commands: list[DriverCommand] = []

    def take(command: DriverCommand, answer: Answer) -> None:
        commands.append(command)
        answer(Reply(id="i", robot="r", code=Code.APPLIED, text="done"))

    robot = DdsRobot(make_node=partial(FastDdsNode, program))

    async def story(harness: DriverHarness) -> None:
        source = command_source(harness.driver)
        assert source is not None
        source.serve(take)
        with (
            closing(FastDdsNode(program, robot.domain, "fast", clients=[ESTOP])) as fast,
            closing(DdsNode(robot.domain, "cyclone", clients=[STOP])) as cyclone,
        ):
            count = itertools.count(1)

            def is_dropped() -> bool:
                fast.call(ESTOP)
                return DROPPED in robot.bridge.log.read_text()

            def is_served() -> bool:
                cyclone.call(STOP, next(count))
                fast.call(ESTOP)
                return bool(cyclone.answers(STOP))

            await harness.until(is_dropped, publishing=True)
            await harness.until(is_served, publishing=True)
            assert {command.verb for command in commands} == {"stop"}
            assert not fast.take(ESTOP)

    play(robot, story, connected=True, services={"operator": "ros"})
