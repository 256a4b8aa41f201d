"""Five robots spread to their distance and stand: two runs."""

from __future__ import annotations

from functools import cache

import pytest

from benchmarks.outcomes.dispersion import outcomes
from benchmarks.outcomes.outcome import Outcome

CLAIMS = ("least late", "median late", "late speed", "touches")


@cache
def found() -> dict[str, Outcome]:
    return {one.what: one for one in outcomes((0, 1))}


@pytest.mark.parametrize("claim", CLAIMS)
def test_outcome(claim: str) -> None:
    (one,) = [outcome for what, outcome in found().items() if what.startswith(claim)]
    assert one.is_reached, f"{one.what}: {one.shown}; wanted {one.wanted}"


def test_every_outcome_is_a_claim() -> None:
    assert len(found()) == len(CLAIMS)
