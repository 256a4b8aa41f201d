"""The answers of swarmctl are true at some delays and losses; `make network` tests many more."""

from __future__ import annotations

import pytest

from tests.support.field_swarm import FieldSwarm
from tests.support.network_matrix import TRUE, cell

pytestmark = pytest.mark.integration

ROBOTS = ("r01", "r02", "r03", "r04")


def test_each_answer_is_true_with_losses(swarm: FieldSwarm) -> None:
    for row in cell(swarm, 0.1, 0.1):
        print("; ".join((*row.cells, row.judged.text)))
        assert row.judged.verdict == TRUE, row


@pytest.mark.evidence
def test_without_loss_a_slow_radio_reaches_every_robot(swarm: FieldSwarm) -> None:
    for row in cell(swarm, 0.3, 0.0):
        print("; ".join((*row.cells, row.judged.text)))
        assert (row.judged.verdict, row.judged.answer.code) == (TRUE, 0), row
        assert row.judged.counted == set(ROBOTS)
