"""Voting windows and majorities, with times handed in."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.kit.vote_windows import ROUNDS, Rounds, RoundVote, Ties, VoteWindow, majority, tally


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_a_window_gives_the_latest_vote_of_each_sender() -> None:
    window = VoteWindow(5.0, now=0.0)
    for sender, opinion, heard_at in (("a", 1, 1.0), ("b", 2, 1.0), ("a", 3, 2.0), ("b", 9, 0.5)):
        window.add(sender, opinion, heard_at)
    assert window.close(5.0) == {"a": 3, "b": 2}


def test_windows_that_ended_between_calls_close_as_one() -> None:
    window = VoteWindow(5.0, now=0.0)
    assert window.close(3607.0) == {}
    assert window.close(3607.5) is None
    assert window.close(3610.0) == {}


@pytest.mark.parametrize(("heard_at", "counts"), [(2.0, True), (1.9, False)])
@pytest.mark.parametrize("period", [None, 5.0])
def test_a_vote_expires(period: float | None, heard_at: float, counts: bool) -> None:
    window = VoteWindow(5.0, period=period, now=0.0, expiry=3.0)
    window.add("a", 1, heard_at)
    assert window.close(5.0) == ({"a": 1} if counts else {})


def test_the_first_window_may_end_early_and_the_others_follow_it() -> None:
    window = VoteWindow(5.0, now=0.0, first=0.4)
    closed = [now for now in np.arange(0.0, 16.0, 0.5).tolist() if window.close(now) is not None]
    assert closed == [2.0, 7.0, 12.0]


@pytest.mark.parametrize(("heard_at", "counts"), [(5.0, True), (4.9, False)])
def test_a_vote_from_before_the_window_does_not_count(heard_at: float, counts: bool) -> None:
    window = VoteWindow(5.0, now=0.0)
    window.close(5.0)
    window.add("a", 1, heard_at)
    assert window.close(10.0) == ({"a": 1} if counts else {})


def test_a_sliding_window_counts_a_vote_again_until_it_is_too_old() -> None:
    window = VoteWindow(3.0, period=1.0, now=0.0)
    window.add("a", 1, 0.5)
    assert window.close(0.9) is None
    assert [window.close(now) for now in (1.0, 2.0, 3.0, 3.4)] == [{"a": 1}] * 3 + [None]
    assert [window.close(now) for now in (4.0, 5.0)] == [{}, {}]


def rounds(*heard: tuple[str, int, int, int], number: int = 0, expiry: float = 3.0) -> Rounds:
    """Rounds of 1 to 5 s that begin at 0 s, with the round votes heard at 0.5 s."""
    made = Rounds(5.0, 1.0, now=0.0, expiry=expiry)
    made.round = number
    for sender, *round_vote in heard:
        made.add_round_vote(sender, RoundVote(*round_vote), 0.5)
    return made


def test_a_round_ends_when_all_have_voted_but_not_before_the_pause() -> None:
    one = rounds(("a", 0, 1, 1), ("b", 0, 2, 2))
    assert one.close(0.9) is None
    assert one.close(1.0) == {"a": 1, "b": 2}
    assert one.round == 1
    assert one.close(2.0) is None


def test_a_round_waits_for_those_behind_until_its_time_is_over() -> None:
    one = rounds(("a", 4, 1, 1), ("b", 3, 2, 2), number=4, expiry=60.0)
    assert one.close(4.9) is None
    assert one.close(5.0) == {"a": 1}
    assert one.round == 5


def test_a_round_does_not_wait_for_a_silent_robot() -> None:
    one = rounds(("gone", 3, 2, 2), number=4)
    one.add_round_vote("a", RoundVote(4, 1, 1), 3.0)
    assert one.close(3.5) is None
    assert one.close(3.6) == {"a": 1}


def test_a_round_does_not_wait_for_a_robot_that_left() -> None:
    one = rounds(("a", 4, 1, 1), ("b", 3, 2, 2), number=4)
    one.forget("b")
    assert one.close(1.0) == {"a": 1}


def test_a_robot_one_round_ahead_counts_with_its_previous_vote() -> None:
    one = rounds(("a", 5, 2, 1), ("b", 4, 2, 0), number=4)
    assert one.close(1.0) == {"a": 1, "b": 2}


def test_a_round_vote_of_an_earlier_round_is_ignored() -> None:
    one = rounds(("a", 4, 1, 1), number=4)
    one.add_round_vote("a", RoundVote(3, 2, 2), 0.6)
    assert one.close(1.0) == {"a": 1}


def test_the_latest_of_two_round_votes_counts_once() -> None:
    one = rounds(("a", 0, 1, 1), ("a", 0, 1, 1))
    one.add_round_vote("a", RoundVote(0, 2, 1), 0.7)
    one.add_round_vote("a", RoundVote(0, 0, 1), 0.6)
    assert one.close(1.0) == {"a": 2}


def test_a_robot_that_fell_behind_jumps_without_deciding() -> None:
    one = rounds(("a", 9, 1, 1), ("b", 9, 1, 1), ("c", 0, 2, 2))
    assert one.close(1.0) == {}
    assert one.round == 9
    one.add_round_vote("c", RoundVote(9, 2, 2), 1.5)
    assert one.close(2.0) == {"a": 1, "b": 1, "c": 2}


@pytest.mark.parametrize("wild", [2, 30000, ROUNDS // 2 - 1])
def test_a_single_arbitrary_round_is_ignored(wild: int) -> None:
    one = rounds(("wild", wild, 0, 0), ("a", 0, 1, 1), ("b", 0, 2, 2))
    assert one.close(1.0) == {"a": 1, "b": 2}
    assert one.round == 1


def test_round_numbers_wrap_around() -> None:
    one = rounds(("a", 0, 2, 1), number=ROUNDS - 1)
    assert one.close(1.0) == {"a": 1}
    assert one.round == 0


def test_a_vote_without_a_round_counts_in_every_round() -> None:
    one = rounds(("a", 0, 1, 1))
    one.add("b", 2, 0.5)
    assert one.close(1.0) == {"a": 1, "b": 2}
    one.add_round_vote("a", RoundVote(1, 1, 1), 1.5)
    assert one.close(2.0) == {"a": 1, "b": 2}


def test_a_round_with_no_votes_ends_too() -> None:
    one = rounds()
    assert one.close(4.9) is None
    assert one.close(5.0) == {}


def test_a_tally_names_the_most_frequent_first() -> None:
    assert list(tally([3, 1, 2, 2, 3, 3, 1]).items()) == [(3, 3), (1, 2), (2, 2)]


@pytest.mark.parametrize("ties", ["random", "keep", "lowest"])
def test_a_clear_majority_wins_whatever_the_rule_for_ties(ties: Ties) -> None:
    assert majority([1, 2, 2], 0, ties=ties, rng=rng()) == 2
    assert majority([], 4, ties=ties, rng=rng()) == 4


def test_a_random_tie_is_uniform() -> None:
    chance = rng()
    counts = tally(majority([1, 1, 2, 2, 3], 0, ties="random", rng=chance) for _ in range(1000))
    # Binomial: 500 +- 16, four standard deviations.
    assert set(counts) == {1, 2}
    assert all(436 <= count <= 564 for count in counts.values())
