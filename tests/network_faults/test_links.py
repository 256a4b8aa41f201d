"""Robots that hear each other in part: links of one direction, and a line.

The near laptop hears every robot all the time, and only looks.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import FAR, NEAR, ask, check_all_alive, prepare
from tests.support.processes import wait_until

pytestmark = pytest.mark.integration

ROBOTS = ("r01", "r02", "r03", "r04")


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


def test_an_operator_on_the_computer_of_a_robot_stops_that_robot_too(swarm: FieldSwarm) -> None:
    """Also alone in its radio; a second emergency stop is no replay, and one reset ends both."""
    prepare(swarm, "running")
    swarm.field.set_between(ROBOTS[:1], (*ROBOTS[1:], FAR), is_cut=True)
    for _ in range(2):
        answer = swarm.ctl("r01", "estop", "--timeout", "2s", "-o", "json")
        assert answer.json["replies"]["r01"]["code"] == "applied", answer
        assert not {*answer.json["replies"]} & {*ROBOTS[1:]}
    swarm.field.heal()
    swarm.await_states(NEAR, "estopped")

    def are_all_held_by_both() -> bool:
        held = [len(one["status"]["latches"]) for one in swarm.members(NEAR).values()]
        return held == [2] * len(ROBOTS)

    wait_until(are_all_held_by_both, "each robot holds both emergency stops")
    assert swarm.ctl("r01", "reset", "--all", "--yes").code == 0
    swarm.await_states(NEAR, "idle")


def line(swarm: FieldSwarm, *hops: Iterable[str]) -> None:
    """Each group hears itself and the groups beside it."""
    for number, some in enumerate(hops):
        for others in hops[number + 2 :]:
            swarm.field.set_between(some, others, is_cut=True)


def test_a_line_is_known_and_stopped_to_its_end(swarm: FieldSwarm) -> None:
    """The far laptop hears one robot, that one two more, and those the last one."""
    prepare(swarm, "running")
    line(swarm, (FAR,), ROBOTS[:1], ROBOTS[1:3], ROBOTS[3:])
    judged = ask(swarm, "members")
    assert judged.answer.json["members"], judged
    assert {one["robot"] for one in judged.answer.json["members"]} >= set(ROBOTS[:3])
    judged = ask(swarm, "stop", "r02")
    swarm.await_states(NEAR, "stopped", ["r02"])
    judged = ask(swarm, "estop", "r03")
    swarm.await_states(NEAR, "estopped", ["r03"])
    assert swarm.states(NEAR)["r01"] == "running"
    judged = ask(swarm, "estop")
    assert judged.counted >= set(ROBOTS[:1])
    swarm.await_states(NEAR, "estopped")
    swarm.field.heal()
    check_all_alive(swarm)
    assert ask(swarm, "reset").counted == set(ROBOTS)


def links(swarm: FieldSwarm) -> dict[tuple[str, str], dict[str, Any]]:
    """What `links` shows of each robot and of each robot that it hears."""
    answer = swarm.ctl(NEAR, "links", "-o", "json")
    assert answer.code == 0, answer
    return {(one["robot"], one["hears"]): one for one in answer.json["links"]}


def test_a_link_that_is_cut_is_shown_in_its_direction_alone(swarm: FieldSwarm) -> None:
    swarm.field.set(source="r01", target="r02", is_cut=True)
    deaf, hearing = ("r02", "r01"), ("r01", "r02")
    before = links(swarm)[deaf]["lost"]
    wait_until(lambda: links(swarm)[deaf]["lost"] >= before + 3, "r02 misses beacons of r01")
    found = links(swarm)
    assert found[deaf]["age"] > 3.0
    assert found[hearing]["age"] < 3.0
    assert "multicast" in found["r03", "r01"]["ways"]
    assert found["r03", "r01"]["round_trip"] is not None
    findings = swarm.ctl(NEAR, "doctor", "r02", "-o", "json").json["findings"]
    (hears,) = (one for one in findings if (one["where"], one["what"]) == ("r02", "hears"))
    assert hears["level"] == "warning"
    swarm.field.heal()
    check_all_alive(swarm)


@pytest.mark.evidence
def test_wait_sees_robots_that_a_slow_link_shows_late(swarm: FieldSwarm) -> None:
    """A look over this link takes longer than 2 s."""
    radio = (*ROBOTS, FAR)
    prepare(swarm, "idle")
    swarm.field.set_between(radio, radio, delay=1.1)
    answer = swarm.ctl(FAR, "wait", "--for", "state=idle", "--for", "count=4", "--timeout", "60s")
    assert answer.code == 0, answer
    swarm.field.clear()
