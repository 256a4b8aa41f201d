"""Most of a swarm vanishes at one moment: the rest is answered for, and the others are named."""

from __future__ import annotations

import pytest

from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import FAR, NEAR, TRUE, VERBS, judge, prepare
from tests.support.processes import wait_until

pytestmark = pytest.mark.integration

ROBOTS = tuple(f"r{number:02d}" for number in range(1, 9))
STAYING, VANISHING = ROBOTS[:2], ROBOTS[2:]


def check_survivors(swarm: FieldSwarm, verb: str) -> None:
    """The far laptop's answer counts the robots that are left and names those that are not."""
    swarm.moved()
    answer = swarm.ctl(FAR, *VERBS[verb], "-o", "json")
    judged = judge(swarm, verb, answer)
    assert (judged.verdict, answer.code) == (TRUE, 3), (judged, answer)
    assert judged.counted == set(STAYING), answer
    assert judged.named == set(VANISHING), answer


def check_all_alive(swarm: FieldSwarm) -> None:
    """The far laptop sees every robot again, by itself."""
    wait_until(lambda: swarm.states(FAR).keys() == set(ROBOTS), "all robots alive again")


def test_six_of_eight_are_killed(swarm: FieldSwarm) -> None:
    prepare(swarm, "running")
    for robot in VANISHING:
        swarm.daemons[robot].process.kill()
    check_survivors(swarm, "run")
    swarm.await_moving(*STAYING)
    check_survivors(swarm, "estop")
    swarm.moved()
    swarm.start(VANISHING, state="empty")
    swarm.await_states(NEAR, "estopped")
    assert swarm.moved() == set()
    check_all_alive(swarm)


def test_six_of_eight_are_cut_off(swarm: FieldSwarm) -> None:
    """By the far laptop only: the near one still reaches everybody."""
    prepare(swarm, "running")
    swarm.field.set_between((FAR, *STAYING), VANISHING, is_cut=True)
    check_survivors(swarm, "run")
    swarm.await_moving(*ROBOTS)  # who is cut off is autonomous
    check_survivors(swarm, "estop")
    swarm.field.heal()
    swarm.await_states(NEAR, "estopped")
    check_all_alive(swarm)
    swarm.moved()
    assert swarm.ctl(FAR, *VERBS["reset"]).code == 0
    assert swarm.moved() == set()
