"""What the voter model brings about, in a hundred debates of each kind."""

from __future__ import annotations

from studies.outcomes import voter_model as claims

SEEDS = (0, 1)


def test_an_opinion_wins_as_often_as_its_share_at_first() -> None:
    outcome = claims.exits(SEEDS)
    assert outcome.is_reached, outcome


def test_rounds_take_as_long_as_the_theory_of_synchronous_updates_has_it() -> None:
    outcome = claims.in_step(SEEDS)
    assert outcome.is_reached, outcome


def test_tumbling_windows_take_as_long_as_robots_that_decide_in_turn() -> None:
    outcome = claims.in_turn(SEEDS)
    assert outcome.is_reached, outcome
