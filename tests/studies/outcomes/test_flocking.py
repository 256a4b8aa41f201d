"""A flock moves as one, where random walkers of the same start are soon apart: two runs of each."""

from __future__ import annotations

from functools import cache

from studies.outcomes.flocking import outcomes
from studies.outcomes.outcome import Outcome


@cache
def found() -> tuple[Outcome, ...]:
    return tuple(outcomes((1, 2)))


def check(claim: str) -> None:
    (one,) = [outcome for outcome in found() if outcome.what.startswith(claim)]
    assert one.is_reached, f"{one.what}: {one.shown}; wanted {one.wanted}"


def test_moves() -> None:
    check("mean speed")


def test_moves_together() -> None:
    check("way of the centroid")


def test_stays_one() -> None:
    check("parts, mean")


def test_splits_less_than_random_walkers() -> None:
    check("parts fewer")


def test_touches_nothing() -> None:
    check("touches")


def test_every_outcome_is_asked_for() -> None:
    assert len(found()) == 5
