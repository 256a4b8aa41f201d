"""Emergency stops over a bad radio: counted truly, and every robot is latched in the end."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import FAR, NEAR, TRUE, VERBS, judge, prepare

pytestmark = pytest.mark.integration

ROBOTS = ("r01", "r02", "r03", "r04")
FAULTS: dict[str, dict[str, Any]] = {
    "clean": {},
    "lossy": {"loss": 0.2},
    "duplicated": {"duplicate": 0.3, "reorder": 0.3},
    "slow": {"delay": 0.2, "jitter": 0.05},
    "slow and lossy": {"delay": 0.25, "jitter": 0.1, "loss": 0.1, "duplicate": 0.05},
}


@pytest.mark.parametrize(
    ("fault", "count"),
    [
        ("slow and lossy", 2),
        pytest.param("duplicated", 2, marks=pytest.mark.evidence),
        *(pytest.param(fault, 100, marks=pytest.mark.evidence) for fault in FAULTS),
    ],
)
def test_estops_are_counted_truly_and_latch_every_robot(
    swarm: FieldSwarm, fault: str, count: int
) -> None:
    radio = (*ROBOTS, FAR)
    seconds = []
    for _ in range(count):
        prepare(swarm, "running")
        swarm.field.set_between(radio, radio, **FAULTS[fault])
        swarm.moved()
        judged = judge(swarm, "estop", swarm.ctl(FAR, *VERBS["estop"], "-o", "json"))
        assert judged.verdict == TRUE, judged
        swarm.await_states(NEAR, "estopped")
        swarm.moved()
        assert swarm.states(NEAR) == dict.fromkeys(ROBOTS, "estopped")
        assert swarm.moved() == set()
        seconds.append((len(judged.counted), round(judged.answer.seconds, 2)))
    print(fault, sorted(seconds, key=lambda one: one[1]))
