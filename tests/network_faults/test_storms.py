"""Most of a swarm vanishes at one moment: the rest is answered for, and the others are named."""

from __future__ import annotations

import pytest

from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import FAR, NEAR, ask, check_all_alive, prepare


def names(count: int) -> tuple[str, ...]:
    return tuple(f"r{number:02d}" for number in range(1, count + 1))


# A quarter of each swarm stays.
pytestmark = [
    pytest.mark.integration,
    pytest.mark.parametrize(
        "started_swarm",
        [names(4), pytest.param(names(16), marks=pytest.mark.evidence)],
        indirect=True,
        ids=["3 of 4", "12 of 16"],
    ),
]


def check_survivors(swarm: FieldSwarm, verb: str, staying: set[str]) -> None:
    """The far laptop's answer counts the robots that are left and names those that are not."""
    judged = ask(swarm, verb)
    assert judged.answer.code == 3, judged
    assert judged.counted == staying, judged
    assert judged.named == set(swarm.robots) - staying, judged


@pytest.mark.evidence
def test_most_of_a_swarm_is_killed(swarm: FieldSwarm) -> None:
    staying = swarm.robots[: len(swarm.robots) // 4]
    vanishing = swarm.robots[len(staying) :]
    prepare(swarm, "running")
    for robot in vanishing:
        swarm.daemons[robot].process.kill()
    check_survivors(swarm, "run", set(staying))
    swarm.await_moving(*staying)
    check_survivors(swarm, "estop", set(staying))
    swarm.moved()
    swarm.start(vanishing, state="empty")
    swarm.await_states(NEAR, "estopped")
    assert swarm.moved() == set()
    check_all_alive(swarm)


@pytest.mark.evidence
def test_most_of_a_swarm_is_cut_off(swarm: FieldSwarm) -> None:
    """From the far laptop and the robots that stay: the near laptop still reaches everybody."""
    staying = swarm.robots[: len(swarm.robots) // 4]
    vanishing = swarm.robots[len(staying) :]
    prepare(swarm, "running")
    swarm.field.set_between((FAR, *staying), vanishing, is_cut=True)
    check_survivors(swarm, "run", set(staying))
    swarm.await_moving(*swarm.robots)  # who is cut off is autonomous
    check_survivors(swarm, "estop", set(staying))
    swarm.field.heal()
    swarm.await_states(NEAR, "estopped")
    check_all_alive(swarm)
    swarm.moved()
    assert ask(swarm, "reset").counted == set(swarm.robots)
    assert swarm.moved() == set()
