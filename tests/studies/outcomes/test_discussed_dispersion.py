"""Experiment 2 in short: two seeds, and 6 s in which to stand instead of 30 s."""

from __future__ import annotations

from functools import cache

import pytest

from studies.outcomes.discussed_dispersion import outcomes
from studies.outcomes.outcome import Outcome

pytestmark = pytest.mark.timeout(900)  # of a machine that has much else to do
SEEDS = (0, 3)
"""Of opinion 2 and of opinion 1."""


@cache
def found() -> list[Outcome]:
    return outcomes(SEEDS, seconds=46.0)


@pytest.mark.parametrize(
    "what",
    [
        "all hold one opinion",
        "farthest before 20 s",
        "least range from 40 s on",
        "the same, so that it is that opinion's",
        "farthest from 40 to 70 s",
        "share of that time in which one moves",
        "contacts",
        "one that joins late holds",
        "runs in which it changes the mind",
    ],
)
def test_experiment_2(what: str) -> None:
    (outcome,) = (one for one in found() if one.what.startswith(what))
    assert outcome.is_reached, outcome.shown
