"""Seven robots of a row gather in one cluster and rest: three runs."""

from __future__ import annotations

from functools import cache

from studies.outcomes.attraction import outcomes
from studies.outcomes.outcome import Outcome


@cache
def found() -> tuple[Outcome, ...]:
    return tuple(outcomes((0, 1, 2)))


def check(claim: str) -> None:
    (one,) = [outcome for outcome in found() if outcome.what.startswith(claim)]
    assert one.is_reached, f"{one.what}: {one.shown}; wanted {one.wanted}"


def test_is_one_cluster_at_the_end() -> None:
    check("one cluster")


def test_stays_one_cluster() -> None:
    check("share of late")


def test_is_dense() -> None:
    check("late distance to the c")


def test_rests() -> None:
    check("late speed")


def test_keeps_room() -> None:
    check("late distance to the n")


def test_touches_nothing() -> None:
    check("touches")


def test_every_outcome_is_asked_for() -> None:
    assert len(found()) == 6
