"""Random walkers cover a room and turn both ways: two runs, and two that never turn."""

from __future__ import annotations

from functools import cache

from studies.outcomes.outcome import Outcome
from studies.outcomes.random_walk import outcomes


@cache
def found() -> tuple[Outcome, ...]:
    return tuple(outcomes((0, 1)))


def check(claim: str) -> None:
    (one,) = [outcome for outcome in found() if outcome.what.startswith(claim)]
    assert one.is_reached, f"{one.what}: {one.shown}; wanted {one.wanted}"


def test_moves() -> None:
    check("mean speed")


def test_covers_as_random_search_does() -> None:
    check("floor covered / by random")


def test_covers_more_than_who_never_turns() -> None:
    check("floor covered / by drive")


def test_turns_both_ways() -> None:
    check("turned more")


def test_leaves_protection_little_to_do() -> None:
    check("protection duty")


def test_touches_nothing() -> None:
    check("touches")


def test_every_outcome_is_asked_for() -> None:
    assert len(found()) == 6
