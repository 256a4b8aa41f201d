"""Driver `ros2dds` and a robot whose nodes are on Fast DDS, behind the real bridge."""

from __future__ import annotations

import itertools
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.values import Value
from swarmd.testing.driver_contract import DriverHarness, play
from tests.drivers.ros.contract import RosContract
from tests.drivers.ros2.dds_rig import SENSES, DdsRobot
from tests.drivers.ros2.harness import check
from tests.drivers.ros2.stops import ESTOP, STATE, STOP, Empty, served
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
RESET, GO = "/swarmd/reset", "/swarmd/run/go"
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
    assert "drops calls by Fast DDS: /base" in found["services"].text


def test_a_node_stops_the_robot_and_gets_the_answer(program: Path) -> None:
    robot = DdsRobot(make_node=partial(FastDdsNode, program))
    kinds = {f"/{STOP}": Empty, f"/{ESTOP}": dds.String}
    state = f"/{STATE}"

    async def story(harness: DriverHarness) -> None:
        commands = served(harness)
        with closing(
            FastDdsNode(program, robot.domain, "fast", kinds, {state: dds.String})
        ) as fast:

            def answers(topic: str, message: Any) -> list[str]:
                """A message before the bridge has its route is lost."""
                fast.publish(topic, message)
                return [one.data for one in fast.take(state)]

            def is_stopped() -> bool:
                return "stop done" in answers(f"/{STOP}", Empty())

            def is_estopped() -> bool:
                return "estop done" in answers(f"/{ESTOP}", dds.String("smoke"))

            await harness.until(is_stopped, publishing=True)
            await harness.until(is_estopped, publishing=True)
            assert {(one.verb, one.reason) for one in commands} == {
                ("stop", ""),
                ("estop", "smoke"),
            }

    play(robot, story, connected=True)


def test_the_bridge_drops_the_calls_of_services(program: Path) -> None:
    """A call by a node on Fast DDS does nothing and has no answer; one by CycloneDDS has."""
    robot = DdsRobot(make_node=partial(FastDdsNode, program))

    async def story(harness: DriverHarness) -> None:
        commands = served(harness)
        with (
            closing(FastDdsNode(program, robot.domain, "fast", clients=[GO])) as fast,
            closing(DdsNode(robot.domain, "cyclone", clients=[RESET])) as cyclone,
        ):
            count = itertools.count(1)

            def is_dropped() -> bool:
                fast.call(GO)
                return DROPPED in robot.bridge.log.read_text()

            def is_served() -> bool:
                cyclone.call(RESET, next(count))
                fast.call(GO)
                return bool(cyclone.answers(RESET))

            await harness.until(is_dropped, publishing=True)
            await harness.until(is_served, publishing=True)
            assert {command.verb for command in commands} == {"reset"}
            assert not fast.take(GO)

    services: dict[str, Value] = {"operator": "ros", "runs": {"go": {"pattern": "drive"}}}
    play(robot, story, connected=True, services=services)
