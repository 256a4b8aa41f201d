"""Seven robots of a row gather in one cluster and rest: one run."""

from __future__ import annotations

from functools import cache

import pytest

from benchmarks.outcomes.attraction import outcomes
from benchmarks.outcomes.outcome import Outcome

CLAIMS = (
    "one cluster",
    "share of late",
    "late distance to the c",
    "late speed",
    "late distance to the n",
    "touches",
)


@cache
def found() -> dict[str, Outcome]:
    return {one.what: one for one in outcomes((0,))}


@pytest.mark.parametrize("claim", CLAIMS)
def test_outcome(claim: str) -> None:
    (one,) = [outcome for what, outcome in found().items() if what.startswith(claim)]
    assert one.is_reached, f"{one.what}: {one.shown}; wanted {one.wanted}"


def test_every_outcome_is_a_claim() -> None:
    assert len(found()) == len(CLAIMS)
