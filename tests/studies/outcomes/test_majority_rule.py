"""What the majority rule brings about, in a hundred debates of each kind."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from studies.outcomes import majority_rule as claims
from studies.outcomes.outcome import Outcome

SEEDS = (0, 1)


@pytest.fixture(scope="module")
def free() -> Mapping[str, Outcome]:
    """By the end of its name, what debates over a radio that loses come to."""
    found = claims.free(claims.debates(SEEDS, air=claims.LOSSY), "lossy")
    return {outcome.what.removeprefix("lossy: "): outcome for outcome in found}


def test_seven_robots_agree_within_twenty_seconds(free: Mapping[str, Outcome]) -> None:
    outcome = free["share agreed within 20 s"]
    assert outcome.is_reached, outcome


def test_half_of_the_swarms_agree_once_each_robot_has_decided(free: Mapping[str, Outcome]) -> None:
    outcome = free["median time, s"]
    assert outcome.is_reached, outcome


def test_no_opinion_is_favoured(free: Mapping[str, Outcome]) -> None:
    outcome = free["chi-squared of who wins"]
    assert outcome.is_reached, outcome


def test_two_halves_that_differ_agree() -> None:
    outcome = claims.split(SEEDS)
    assert outcome.is_reached, outcome


def test_between_equals_either_wins_as_often() -> None:
    outcome = claims.tie(SEEDS)
    assert outcome.is_reached, outcome


def test_rounds_go_as_the_theory_of_synchronous_updates() -> None:
    outcome = claims.in_step(SEEDS)
    assert outcome.is_reached, outcome


def test_robots_in_lockstep_take_as_long() -> None:
    outcome = claims.like_lockstep(SEEDS)
    assert outcome.is_reached, outcome
