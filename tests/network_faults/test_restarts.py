"""Robots that freeze, end and start again while the swarm is estopped."""

from __future__ import annotations

import pytest

from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import NEAR, ask, check_all_alive, prepare

pytestmark = pytest.mark.integration

ROBOTS = ("r01", "r02", "r03", "r04", "r05", "r06")


def test_a_frozen_robot_is_named_and_latched_when_it_thaws(swarm: FieldSwarm) -> None:
    prepare(swarm, "running")
    swarm.daemons["r01"].freeze()
    judged = ask(swarm, "estop")
    assert (judged.answer.code, judged.named) == (3, {"r01"}), judged
    swarm.daemons["r01"].thaw()
    swarm.await_states(NEAR, "estopped")
    swarm.moved()
    check_all_alive(swarm)
    assert swarm.moved() == set()


def test_a_robot_that_starts_with_an_empty_disk_takes_the_latch_over(swarm: FieldSwarm) -> None:
    prepare(swarm, "estopped")
    swarm.daemons["r01"].kill()
    swarm.moved()
    swarm.start(["r01"], state="empty")
    swarm.await_states(NEAR, "estopped")
    assert swarm.moved() == set()
    judged = ask(swarm, "reset")
    assert (judged.answer.code, judged.counted) == (0, set(ROBOTS)), judged


def test_a_robot_that_is_killed_while_estopped_is_estopped_again(swarm: FieldSwarm) -> None:
    prepare(swarm, "estopped")
    for robot in ROBOTS:
        swarm.daemons[robot].kill()
    swarm.start(["r01"])
    swarm.await_states(NEAR, "estopped", ["r01"])
    swarm.start(ROBOTS[1:])
    swarm.await_states(NEAR, "estopped")
