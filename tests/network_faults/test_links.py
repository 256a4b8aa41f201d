"""Robots that hear each other in part: links of one direction, and a line.

The near laptop hears every robot all the time, and only looks.
"""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import FAR, NEAR, ask, check_all_alive, prepare

pytestmark = pytest.mark.integration

ROBOTS = ("r01", "r02", "r03", "r04", "r05", "r06")


@pytest.mark.parametrize("is_mute", [True, False], ids=["mute", "deaf"])
def test_one_robot_is_cut_off_in_one_direction(swarm: FieldSwarm, is_mute: bool) -> None:
    prepare(swarm, "running")
    others = {*ROBOTS[1:], FAR}
    for other in others:
        pair = ("r01", other) if is_mute else (other, "r01")
        swarm.field.set(source=pair[0], target=pair[1], is_cut=True)
    judged = ask(swarm, "estop", options=("--timeout", "4s"))
    assert judged.counted >= set(ROBOTS[1:])
    assert ("r01" in judged.named) == (judged.answer.code == 3)
    if is_mute:  # it hears everything
        swarm.await_states(NEAR, "estopped")
    swarm.field.heal()
    swarm.await_states(NEAR, "estopped")
    check_all_alive(swarm)


def line(swarm: FieldSwarm, *hops: Iterable[str]) -> None:
    """Each group hears itself and the groups beside it."""
    for number, some in enumerate(hops):
        for others in hops[number + 2 :]:
            swarm.field.set_between(some, others, is_cut=True)


def test_a_line_is_known_and_stopped_to_its_end(swarm: FieldSwarm) -> None:
    """The far laptop hears two robots, these two more, and those the last two."""
    prepare(swarm, "running")
    line(swarm, (FAR,), ROBOTS[:2], ROBOTS[2:4], ROBOTS[4:])
    judged = ask(swarm, "members")
    assert judged.answer.json["members"], judged
    assert {one["robot"] for one in judged.answer.json["members"]} >= set(ROBOTS[:4])
    judged = ask(swarm, "stop", "r03")
    swarm.await_states(NEAR, "stopped", ["r03"])
    judged = ask(swarm, "estop", "r04")
    swarm.await_states(NEAR, "estopped", ["r04"])
    assert swarm.states(NEAR)["r01"] == "running"
    judged = ask(swarm, "estop")
    assert judged.counted >= set(ROBOTS[:2])
    swarm.await_states(NEAR, "estopped")
    swarm.field.heal()
    check_all_alive(swarm)
    assert ask(swarm, "reset").counted == set(ROBOTS)
