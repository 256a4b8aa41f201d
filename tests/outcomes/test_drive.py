"""Drive goes straight, at its speed, and stands before a wall: one run, each claim a test."""

from __future__ import annotations

from functools import cache

import pytest

from benchmarks.outcomes.drive import outcomes
from benchmarks.outcomes.outcome import Outcome

CLAIMS = ("most aside", "speed", "way in the last", "footprint", "touches", "circle")


@cache
def found() -> dict[str, Outcome]:
    return {one.what: one for one in outcomes((0,))}


@pytest.mark.parametrize("claim", CLAIMS)
def test_outcome(claim: str) -> None:
    (one,) = [outcome for what, outcome in found().items() if what.startswith(claim)]
    assert one.is_reached, f"{one.what}: {one.shown}; wanted {one.wanted}"


def test_every_outcome_is_a_claim() -> None:
    assert len(found()) == len(CLAIMS)
