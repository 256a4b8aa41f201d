"""Robots that freeze, end and start again while the swarm is estopped."""

from __future__ import annotations

import pytest

from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import NEAR, ask, check_all_alive, prepare

pytestmark = pytest.mark.integration

ROBOTS = ("r01", "r02", "r03", "r04")


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


def test_a_swarm_that_is_restarted_stays_estopped_also_where_the_disk_is_empty(
    swarm: FieldSwarm,
) -> None:
    """No daemon is left that has heard the stop itself: only the latches know of it."""
    prepare(swarm, "estopped")
    for robot in ROBOTS:
        swarm.daemons[robot].kill()
    swarm.moved()
    swarm.start(ROBOTS[1:])
    swarm.await_states(NEAR, "estopped", ROBOTS[1:])
    swarm.start(["r01"], state="empty")
    swarm.await_states(NEAR, "estopped")
    assert swarm.moved() == set()
    judged = ask(swarm, "reset")
    assert (judged.answer.code, judged.counted) == (0, set(ROBOTS)), judged
