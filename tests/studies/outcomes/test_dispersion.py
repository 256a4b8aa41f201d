"""Five robots spread to their distance and stand: three runs."""

from __future__ import annotations

from functools import cache

from studies.outcomes.dispersion import outcomes
from studies.outcomes.outcome import Outcome


@cache
def found() -> tuple[Outcome, ...]:
    return tuple(outcomes((0, 1, 2)))


def check(claim: str) -> None:
    (one,) = [outcome for outcome in found() if outcome.what.startswith(claim)]
    assert one.is_reached, f"{one.what}: {one.shown}; wanted {one.wanted}"


def test_reaches_its_distance_and_keeps_it() -> None:
    check("least late")


def test_spreads_no_further() -> None:
    check("median late")


def test_goes_no_long_ways() -> None:
    check("mean way")


def test_stands() -> None:
    check("late speed")


def test_touches_nothing() -> None:
    check("touches")


def test_every_outcome_is_asked_for() -> None:
    assert len(found()) == 5
