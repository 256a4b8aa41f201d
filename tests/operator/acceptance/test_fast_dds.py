"""Parts A and B of the test with a ROS 2 base on Fast DDS behind the real bridge.

The other tests have CycloneDDS, which the bridge has, too.
"""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest

from swarmd.core.values import Value
from swarmd.operator.acceptance.result_file import read_record
from swarmd.operator.acceptance.verdict import Result, Verdict
from tests.operator.acceptance.person import person
from tests.operator.acceptance.test_ros2_base import LONG, ROBOT, Rig, judge_part_b
from tests.support.fast_dds import FastDdsNode, compile_node, why_no_fast_dds
from tests.support.ros2_bridge import why_no_bridge

pytestmark = [
    pytest.mark.evidence,
    pytest.mark.integration,
    pytest.mark.timeout(600),
    pytest.mark.skipif(bool(why_no_bridge()), reason=why_no_bridge()),
    pytest.mark.skipif(bool(why_no_fast_dds()), reason=why_no_fast_dds()),
]
TRIES = 3
"""On a busy machine a base is late with more than 2 % of its scans."""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compile_node(tmp_path_factory.mktemp("fast_dds"))


@pytest.fixture
def rig(program: Path, tmp_path: Path, left: ExitStack) -> Rig:
    make_node = partial(FastDdsNode, program)
    others: dict[str, Value] = {"other_actions": ["dock"]}
    return Rig(tmp_path, left, others=others, make_node=make_node, actions=["dock"])


def judged(rig: Rig, *steps: str) -> dict[str, Verdict]:
    """The verdicts on steps of part A."""
    folder = rig.results
    words = ("--folder", str(folder), "--daemon-config", str(rig.config))
    for step in steps:
        with person(rig.swarm, ROBOT, "--only", step, *words) as one:
            if step == "A6":
                one.answer("y")
            one.read_on(f"{step} ", LONG)
            one.end()
    return dict(read_record(folder).verdicts)


def test_a_sound_base_is_as_it_says_while_it_rests(rig: Rig) -> None:
    found: dict[str, Verdict] = {}
    for _ in range(TRIES):
        verdicts = judged(rig, "A5", "A6")
        found = {name: verdicts[name] for name in ("A5", "A6", "A7", "A8", "A9", "A10")}
        if all(verdict.result is Result.PASS for verdict in found.values()):
            break
    assert all(verdict.result is Result.PASS for verdict in found.values()), found
    assert {"connection", "scan", "odometry", "cmd_vel"} <= {*found["A5"].reason.split(", ")}


def test_a_sound_base_stops_in_every_case(rig: Rig) -> None:
    judge_part_b(rig, rig.results)


def test_a_goal_of_an_action_is_found(rig: Rig) -> None:
    node = rig.base.node
    assert node is not None
    node.goals("/dock", 2)
    found = judged(rig, "A6")["A6"]
    assert found.result is Result.FAIL
    assert "someone else drives: action /dock" in found.reason
