"""A secured swarm on a radio that fails; with `make network` every test here has keys, too."""

from __future__ import annotations

import pytest

from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import FAR, NEAR, TRUE, VERBS, judge, prepare

pytestmark = pytest.mark.integration

ROBOTS = ("r01", "r02", "r03")


@pytest.fixture(scope="module")
def is_secured() -> bool:
    return True


def test_every_verb_is_answered_truly_over_a_slow_and_lossy_radio(swarm: FieldSwarm) -> None:
    radio = (*ROBOTS, FAR)
    for verb in ("members", "run", "estop", "reset"):
        swarm.field.set_between(radio, radio, delay=0.05, loss=0.1)
        swarm.moved()
        judged = judge(swarm, verb, swarm.ctl(FAR, *VERBS[verb], "-o", "json"))
        assert judged.verdict == TRUE, judged
        swarm.field.clear()
    assert "by anna" in swarm.daemons["r01"].text()


def test_a_laptop_without_keys_finds_nothing(swarm: FieldSwarm) -> None:
    prepare(swarm, "running")
    answer = swarm.begin(NEAR, "estop", "--timeout", "1s", is_insecure=True).finish()
    assert answer.code == 6, answer
    assert swarm.states(NEAR) == dict.fromkeys(ROBOTS, "running")
