"""Parts A and B of the test with a daemon and a ROS 2 base behind the real bridge.

The person kills and restarts the daemon and the bridge as the steps say.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest
from cyclonedds.core import Policy, Qos

from swarmd.core.values import Value
from swarmd.operator.acceptance.result_file import read_record
from swarmd.operator.acceptance.verdict import Result
from tests.drivers.ros2.dds_rig import SENSES
from tests.drivers.ros2.robots import open_session
from tests.operator.acceptance.daemon_rig import DaemonRig
from tests.operator.acceptance.person import Person, person
from tests.operator.acceptance.ros2_base import LiftedBase, is_driving
from tests.support.dds_node import RELIABLE, SENSOR, DdsNode
from tests.support.processes import end_process, wait_until, watchdogs
from tests.support.ros2_bridge import why_no_bridge
from tests.support.ros2_types import Twist

pytestmark = [
    pytest.mark.evidence,
    pytest.mark.integration,
    pytest.mark.skipif(bool(why_no_bridge()), reason=why_no_bridge()),
]
ROBOT = "tb3-01"
DOWN = 3.0  # s
LONG = 120.0  # s
KEPT = Qos(
    Policy.Reliability.Reliable(10**8), Policy.Durability.TransientLocal, Policy.History.KeepLast(1)
)


class Rig(DaemonRig):
    """A daemon of a Burger without a command timeout, its bridge and its base.

    `first`: a topic of which another node has another quality of service, before the base begins.
    `others`: further options of the driver.
    """

    def __init__(
        self,
        folder: Path,
        left: ExitStack,
        first: Mapping[str, Qos] | None = None,
        others: Mapping[str, Value] | None = None,
        **fields: Any,
    ) -> None:
        if first is not None:
            fields["is_on"] = False
        self.base = LiftedBase(**fields)
        left.callback(self.base.close)
        for topic, quality in (first or {}).items():
            left.callback(self._first(topic, quality).close)
        left.callback(self.end_watchdogs)
        options: dict[str, Value] = {
            "endpoint": self.base.endpoint,
            "cmd_vel_listeners": ["/rosbag2"],
        }
        options.update(others or {})
        super().__init__(folder, left, ROBOT, "burger", "ros2dds", options)

    def _first(self, topic: str, quality: Qos) -> DdsNode:
        """A node that has a topic first, and then the base: the route of the bridge is as here."""
        base = self.base
        ends = ({f"/{topic}": SENSES[topic]}, {}) if topic in SENSES else ({}, {f"/{topic}": Twist})
        node = DdsNode(base.domain, "rosbag2", *ends, qos={f"/{topic}": quality})
        session = open_session("client", "connect/endpoints", base.endpoint)
        with closing(session):
            liveliness = session.liveliness()
            wait_until(lambda: any(liveliness.get(f"@/*/@ros2_lv/*/{topic}/**")), "the route")
            base.start()
            wait_until(lambda: any(session.get("@/*/ros2/node/*/base")), "the base is listed")
        return node

    def end_watchdogs(self) -> None:
        for pid in watchdogs(self.swarm, ROBOT):
            end_process(pid)

    def answer(self, one: Person) -> None:
        """Say yes, and wait until the wheels turn."""
        one.answer("y")
        wait_until(lambda: is_driving(self.base), "its wheels turn", 20.0)
        time.sleep(1.5)


def test_a_sound_base_stops_in_every_case(tmp_path: Path, left: ExitStack) -> None:
    judge_part_b(Rig(tmp_path, left), tmp_path / "results")


def judge_part_b(rig: Rig, folder: Path) -> None:
    """Do what part B asks; a sound base passes all but B8, and B6 is not shown."""
    with person(rig.swarm, ROBOT, "--only", "B", "--folder", str(folder)) as one:
        for step in ("B1", "B2"):
            one.answer("y")
            one.read_on(f"{step} PASS", LONG)
        rig.restart()
        time.sleep(3.0)
        for step in ("B3", "B4", "B5"):
            one.answer("y")
            one.read_on(f"{step} PASS", LONG)
        one.answer("n")  # B6: profile dev has no link to cut
        rig.answer(one)
        rig.kill()
        time.sleep(DOWN)
        rig.start()
        one.restore(LONG)
        one.read_on("B7 PASS", LONG)
        rig.answer(one)
        rig.base.disconnect()
        time.sleep(DOWN)
        rig.base.reconnect()
        one.restore(LONG)
        one.read_on("B8 ", LONG)
        one.answer("n")  # B9: the base has no stop button
        one.end()
    found = read_record(folder).verdicts
    # A Burger keeps its last velocity: nothing reaches it without its bridge (docs/failures.md).
    assert found["B8"].result is Result.FAIL
    assert "drove on" in found["B8"].reason
    passed = {name for name, verdict in found.items() if verdict.result is Result.PASS}
    assert passed == {"B1", "B2", "B3", "B4", "B5", "B7"}


def test_a_daemon_without_a_watchdog_is_found(tmp_path: Path, left: ExitStack) -> None:
    rig, folder = Rig(tmp_path, left), tmp_path / "results"
    with person(rig.swarm, ROBOT, "--only", "B1", "--folder", str(folder)) as one:
        one.answer("y")
        one.read_on("B1 PASS", LONG)
        one.end()
    with person(rig.swarm, ROBOT, "--only", "B7", "--folder", str(folder)) as one:
        rig.answer(one)
        left_over = watchdogs(rig.swarm, ROBOT)
        for pid in left_over:  # it cannot send its zeros, and the daemon cannot start another
            os.kill(pid, signal.SIGSTOP)
        rig.kill()
        for pid in left_over:
            os.kill(pid, signal.SIGKILL)
        time.sleep(DOWN)
        rig.start()
        one.restore(LONG)
        one.read_on("B7 FAIL", LONG)
        one.end()
    assert "drove on" in read_record(folder).verdicts["B7"].reason


def test_a_base_that_ignores_zero_never_gets_to_the_floor(tmp_path: Path, left: ExitStack) -> None:
    rig, folder = Rig(tmp_path, left, ignores_zero=True), tmp_path / "results"
    with person(rig.swarm, ROBOT, "--only", "B", "--folder", str(folder)) as one:
        one.answer("y")
        one.read_on("B1 FAIL", LONG)
        one.end()
    found = read_record(folder).verdicts
    assert "ignores zero" in found["B1"].reason
    with person(rig.swarm, ROBOT, "--only", "C", "--folder", str(folder)) as one:
        one.end()
    assert read_record(folder).verdicts["C1"].result is Result.NOT_SHOWN


def test_a_second_publisher_of_commands_is_found(tmp_path: Path, left: ExitStack) -> None:
    rig, folder = Rig(tmp_path, left), tmp_path / "results"
    other = rig.base.other_node()
    left.callback(other.close)
    with person(rig.swarm, ROBOT, "--only", "A6", "--folder", str(folder)) as one:
        one.answer("y")
        for _ in range(20):
            other.command("cmd_vel", 0.05)
            time.sleep(0.2)
        one.read_on("A6 FAIL", LONG)
        one.end()
    assert "someone else drives" in read_record(folder).verdicts["A6"].reason


def test_the_check_runs_beside_the_daemon(tmp_path: Path, left: ExitStack) -> None:
    rig, folder = Rig(tmp_path, left), tmp_path / "results"
    words = ("--folder", str(folder), "--daemon-config", str(rig.config))
    with person(rig.swarm, ROBOT, "--only", "A5", *words) as one:
        one.read_on("A5 ", LONG)
        one.end()
    found = read_record(folder).verdicts["A5"]
    assert found.result is Result.PASS, found
    assert "cmd_vel" in found.reason


@pytest.mark.parametrize(
    ("topic", "first", "own", "step"),
    [("cmd_vel", RELIABLE, KEPT, ""), ("odom", RELIABLE, SENSOR, "A10"),
     ("scan", RELIABLE, SENSOR, "A7")],
)  # fmt: skip
def test_a_quality_of_service_that_does_not_match_is_found(
    tmp_path: Path, left: ExitStack, topic: str, first: Qos, own: Qos, step: str
) -> None:
    """The route of the bridge is as the first node wants it; the base comes later."""
    rig, folder = Rig(tmp_path, left, {topic: first}, qos={topic: own}), tmp_path / "results"
    words = ("--folder", str(folder), "--daemon-config", str(rig.config))
    for one_step in filter(None, ("A5", step and "A6", step)):
        with person(rig.swarm, ROBOT, "--only", one_step, *words) as one:
            if one_step == "A6":
                one.answer("y")
            one.read_on(f"{one_step} FAIL", LONG)
            one.end()
    found = read_record(folder).verdicts
    assert f"/{topic}" in found["A5"].reason
    assert "nothing passes" in found["A5"].reason
    assert not step or "missing" in found[step].reason
