"""Voting patterns: windows of each kind, sharing, and messages that must not count."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from swarmd.core.values import Inputs, Message, Neighbor, Value
from swarmd.kit.behavior import Context
from swarmd.kit.vote_windows import ROUNDS, Windows
from swarmd.kit.voting_pattern import VotingParams, VotingPattern
from swarmd.settings.settings import load_platform
from tests.support.voting_sim import Air, VotingSim

PLATFORM = load_platform("burger")


class Listener(VotingPattern[VotingParams]):
    """Remembers what it was asked to decide on, and adopts the highest."""

    asked: Mapping[str, int] | None = None

    def decide(self, votes: Mapping[str, int]) -> int:
        self.asked = dict(votes)
        return max(votes.values())


class Desk:
    """One listener, stepped every 0.1 s, and its messages."""

    def __init__(self, windows: Windows = "tumbling", **params: object) -> None:
        given = {"initial": 0, "staggered": False, "expiry": 60.0, **params}
        made = VotingParams(windows=windows, **given)  # type: ignore[arg-type]
        self.pattern = Listener(made, Context("me", PLATFORM, np.random.default_rng(0)))
        self.now = 100.0
        self.sent: list[tuple[float, str, Value]] = []
        self.report: Mapping[str, object] = {}

    def step(self, *heard: tuple[str, Value], age: float = 0.0, near: tuple[str, ...] = ()) -> None:
        """A step in which this was heard: a list is a round_vote, all else an opinion."""
        messages = tuple(
            Message(sender, "round_vote" if isinstance(value, list) else "opinion", value, age)
            for sender, value in heard
        )
        neighbors = tuple(Neighbor(name, 0.1) for name in near)
        inputs = Inputs(round(self.now, 3), 0.1, neighbors=neighbors, messages=messages)
        outputs = self.pattern.step(inputs)
        self.report = outputs.report
        self.sent += [(self.now - 100.0, key, value) for key, value in outputs.messages.items()]
        self.now += 0.1

    def wait(self, seconds: float, near: tuple[str, ...] = ()) -> None:
        for _ in range(round(seconds / 0.1)):
            self.step(near=near)


KINDS: tuple[Windows, ...] = ("tumbling", "sliding", "rounds")
WORDS: tuple[Value, ...] = (-1, 3, 2**70, True, 1.0, "1", None, b"1", {"opinion": 1})
LISTS: tuple[Any, ...] = (
    *([], [0, 1], [0, 1, 2, 0], [0, 3, 0], [0, 0, -1], [-1, 1, 1], [ROUNDS, 1, 1]),
    *([0.0, 1, 1], [True, 1, 1], [0, None, 1], [0, 1, "1"], [[0], 1, 1]),
)


@pytest.mark.parametrize("windows", KINDS)
def test_a_malformed_message_is_ignored(windows: Windows) -> None:
    desk = Desk(windows)
    desk.step()
    desk.step(*[(f"bad-{number}", value) for number, value in enumerate((*WORDS, *LISTS))])
    desk.wait(11.0)
    assert desk.pattern.asked is None
    assert desk.pattern.opinion == 0


@pytest.mark.parametrize("windows", KINDS)
def test_its_own_message_is_not_a_vote(windows: Windows) -> None:
    desk = Desk(windows)
    desk.step()
    desk.step(("me", 2), ("me", [0, 2, 2]))
    desk.wait(6.0)
    assert desk.pattern.asked is None


@pytest.mark.parametrize("windows", KINDS)
@pytest.mark.parametrize("count_own", [False, True])
def test_count_own_adds_a_vote_but_not_to_the_report(windows: Windows, count_own: bool) -> None:
    desk = Desk(windows, count_own=count_own)
    desk.step()
    desk.step(("b", 1), ("b", 1), ("c", 2))
    desk.wait(5.0 if windows == "tumbling" else 1.0)
    assert desk.pattern.asked == {"b": 1, "c": 2, **({"me": 0} if count_own else {})}
    assert desk.report["heard"] == 2


@pytest.mark.parametrize("windows", KINDS)
def test_the_own_opinion_alone_decides_nothing(windows: Windows) -> None:
    desk = Desk(windows, count_own=True)
    desk.wait(11.0)
    assert desk.pattern.asked is None


@pytest.mark.parametrize("windows", KINDS)
@pytest.mark.parametrize("near", [("b", "c"), ("c",)])
def test_the_vote_of_a_lost_neighbour_is_dropped(windows: Windows, near: tuple[str, ...]) -> None:
    desk = Desk(windows)
    desk.step(near=("b", "c"))
    desk.step(("b", 2), ("c", 1), near=("b", "c"))
    desk.wait(5.0 if windows == "tumbling" else 1.0, near=near)
    assert desk.pattern.asked == ({"b": 2, "c": 1} if "b" in near else {"c": 1})


@pytest.mark.parametrize(("age", "asked"), [(2.8, {"b": 2}), (3.1, None)])
@pytest.mark.parametrize("windows", ["sliding", "rounds"])
def test_the_age_of_a_message_counts(
    windows: Windows, age: float, asked: Mapping[str, int] | None
) -> None:
    desk = Desk(windows, expiry=3.0)
    desk.wait(0.9)
    desk.step(("b", 2), age=age)
    desk.now = 101.0
    desk.step()
    assert desk.pattern.asked == asked


def test_a_vote_for_a_removed_opinion_does_not_count() -> None:
    desk = Desk()
    desk.step()
    desk.step(("b", 2), ("c", 1))
    desk.pattern.update(VotingParams(opinions=2, initial=0, staggered=False, expiry=60.0))
    desk.wait(5.0)
    assert desk.pattern.asked == {"c": 1}


@pytest.mark.parametrize("windows", ["tumbling", "sliding"])
def test_windows_count_votes_of_robots_in_rounds(windows: Windows) -> None:
    desk = Desk(windows)
    desk.step()
    desk.step(("b", [7, 2, 1]))
    desk.wait(5.0 if windows == "tumbling" else 1.0)
    assert desk.pattern.asked == {"b": 2}


def test_rounds_count_votes_of_robots_without_rounds() -> None:
    desk = Desk("rounds")
    desk.step()
    desk.step(("b", 2), ("c", [0, 1, 1]))
    desk.wait(1.0)
    assert desk.pattern.asked == {"b": 2, "c": 1}
    assert desk.report == {"opinion": 2, "heard": 2, "round": 1}


def test_under_rounds_the_round_vote_holds_the_vote_before() -> None:
    desk = Desk("rounds")
    desk.step()
    desk.step(("b", [0, 2, 2]))
    desk.wait(1.1)
    assert desk.sent[0][1:] == ("round_vote", [0, 0, 0])
    assert desk.sent[-1][1:] == ("round_vote", [1, 2, 0])


def test_changed_windows_apply_at_once_and_keep_the_opinion() -> None:
    desk = Desk()
    desk.step()
    desk.wait(1.0)
    desk.pattern.update(VotingParams(windows="rounds"))
    desk.step(("b", [0, 2, 2]))
    desk.wait(1.0)
    assert desk.sent[-1][1:] == ("round_vote", [1, 2, 0])


@pytest.mark.parametrize("windows", ["tumbling", "sliding"])
def test_windows_of_robots_are_staggered_by_default(windows: Windows) -> None:
    ends = set()
    for seed in range(10):
        desk = Desk(windows, staggered=True)
        desk.pattern.context.rng.bit_generator.state = np.random.PCG64(seed).state
        desk.step()
        while desk.pattern.asked is None:
            desk.step(("b", 1))
        ends.add(round(desk.now - 100.0, 1))
    longest = 5.0 if windows == "tumbling" else 1.0
    assert len(ends) >= 4
    assert max(ends) <= longest + 0.2


@pytest.mark.parametrize("windows", KINDS)
def test_robots_agree_despite_lost_late_and_repeated_messages(windows: Windows) -> None:
    air = Air(delay=0.2, jitter=0.2, loss=0.3, twice=0.3)
    params: Mapping[str, Value] = {"windows": windows, "window": 2.0, "count_own": True}
    for seed in range(3):
        swarm = VotingSim("majority_rule", 5, seed=seed, params=params, air=air)
        assert swarm.run(40.0, until_agreed=6.0).agreed_at < 30.0


def test_rounds_continue_when_robots_leave_and_join() -> None:
    params: Mapping[str, Value] = {"windows": "rounds", "opinions": 2}
    held, starts = [0, 0, 0, 0, 1], [0.0, 0.0, 0.0, 0.0, 20.0]
    swarm = VotingSim(
        "majority_rule", 5, seed=0, params=params, held=held, starts=starts, ends={3: 10.05}
    )
    debate = swarm.run(40.0)
    assert debate.rounds[100:150, 0].max() - debate.rounds[100, 0] >= 3
    assert np.ptp(debate.rounds[250:, [0, 1, 2, 4]], axis=1).max() <= 1
    assert debate.winner == 0
    assert 20.0 < debate.agreed_at < 30.0


def test_an_initial_opinion_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match="initial is 3"):
        VotingParams(initial=3)
