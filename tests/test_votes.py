"""Voting windows and majorities, with times handed in."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.votes import VoteWindow, majority, read_opinion, tally


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_a_window_is_open_until_its_length_has_passed() -> None:
    window = VoteWindow(5.0, now=10.0)
    assert window.close(14.999) is None
    assert window.close(15.0) == {}


def test_a_window_gives_the_latest_vote_of_each_sender() -> None:
    window = VoteWindow(5.0, now=0.0)
    for sender, opinion, heard_at in (("a", 1, 1.0), ("b", 2, 1.0), ("a", 3, 2.0), ("b", 9, 0.5)):
        window.add(sender, opinion, heard_at)
    assert window.close(5.0) == {"a": 3, "b": 2}


def test_windows_tumble_and_share_no_vote() -> None:
    window = VoteWindow(5.0, now=0.0)
    window.add("a", 1, 4.9)
    assert window.close(5.0) == {"a": 1}
    assert window.close(9.9) is None
    assert window.close(10.0) == {}


def test_windows_stay_in_step_when_they_are_closed_late() -> None:
    window = VoteWindow(5.0, now=0.0)
    assert window.close(7.0) == {}
    assert window.close(9.9) is None
    assert window.close(10.0) == {}


def test_windows_that_ended_unseen_are_closed_as_one() -> None:
    window = VoteWindow(5.0, now=0.0)
    assert window.close(3607.0) == {}
    assert window.close(3607.5) is None
    assert window.close(3610.0) == {}


@pytest.mark.parametrize(("heard_at", "counts"), [(2.0, True), (1.9, False)])
def test_a_vote_expires(heard_at: float, counts: bool) -> None:
    window = VoteWindow(5.0, now=0.0, expiry=3.0)
    window.add("a", 1, heard_at)
    assert window.close(5.0) == ({"a": 1} if counts else {})


def test_a_tally_names_the_most_frequent_first() -> None:
    assert list(tally([3, 1, 2, 2, 3, 3, 1]).items()) == [(3, 3), (1, 2), (2, 2)]


@pytest.mark.parametrize("ties", ["random", "keep", "lowest"])
def test_a_clear_majority_wins_whatever_the_rule_for_ties(ties: str) -> None:
    assert majority([1, 2, 2], 0, ties=ties, rng=rng()) == 2  # type: ignore[arg-type]


@pytest.mark.parametrize("ties", ["random", "keep", "lowest"])
def test_without_votes_nothing_changes(ties: str) -> None:
    assert majority([], 4, ties=ties, rng=rng()) == 4  # type: ignore[arg-type]


def test_a_tie_keeps_the_current_opinion_even_if_it_is_not_among_the_equals() -> None:
    assert majority([1, 2], 0, ties="keep", rng=rng()) == 0


def test_a_tie_goes_to_the_lowest() -> None:
    assert majority([2, 1], 0, ties="lowest", rng=rng()) == 1


def test_a_tie_goes_to_each_of_the_equals_as_often() -> None:
    chance = rng()
    counts = tally(majority([1, 1, 2, 2, 3], 0, ties="random", rng=chance) for _ in range(1000))
    # Binomial: 500 +- 16, four standard deviations.
    assert set(counts) == {1, 2}
    assert all(436 <= count <= 564 for count in counts.values())


@pytest.mark.parametrize(
    ("value", "opinion"),
    [(0, 0), (2, 2), (3, None), (-1, None), (True, None), (1.0, None), ("1", None), (None, None)],
)
def test_only_whole_numbers_within_range_are_opinions(value: object, opinion: int | None) -> None:
    assert read_opinion(value, 3) == opinion
