"""Random walkers cover a room and turn both ways: one run, and one of robots that never turn."""

from __future__ import annotations

from functools import cache

import pytest

from benchmarks.outcomes.outcome import Outcome
from benchmarks.outcomes.random_walk import outcomes

CLAIMS = ("mean speed", "floor covered / by random", "floor covered / by drive", "turned more")
SAFE = ("protection duty", "touches")


@cache
def found() -> dict[str, Outcome]:
    return {one.what: one for one in outcomes((0,))}


@pytest.mark.parametrize("claim", [*CLAIMS, *SAFE])
def test_outcome(claim: str) -> None:
    (one,) = [outcome for what, outcome in found().items() if what.startswith(claim)]
    assert one.is_reached, f"{one.what}: {one.shown}; wanted {one.wanted}"


def test_every_outcome_is_a_claim() -> None:
    assert len(found()) == len(CLAIMS) + len(SAFE)
