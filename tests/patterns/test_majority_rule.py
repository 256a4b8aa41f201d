"""The majority rule, alone and in a swarm of objects that hear each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import pytest

from swarmd.core.values import Inputs, Message, Value
from swarmd.patterns.majority_rule.pattern import MajorityRule
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject

BURGER = load_platform("burger")


class TestMajorityRule(PatternContract):
    pattern = MajorityRule


class TestMajorityRuleByRounds(PatternContract):
    pattern = MajorityRule
    params: ClassVar[Mapping[str, Value]] = {"windows": "rounds", "count_own": True}
    platforms = ("burger",)


def make(seed: int = 0, **params: Value) -> MajorityRule:
    """Its windows end in step by default."""
    pattern = Subject(MajorityRule, BURGER, {"staggered": False, **params}).make(seed)
    assert isinstance(pattern, MajorityRule)
    return pattern


def hear(votes: Mapping[str, Value]) -> tuple[Message, ...]:
    return tuple(Message(sender, "opinion", value, 0.0) for sender, value in votes.items())


def opinion_after(pattern: MajorityRule, votes: Mapping[str, Value]) -> int:
    """Its opinion after one window of 5 s in which the votes were heard."""
    pattern.step(Inputs(now=0.0, dt=0.0))
    pattern.step(Inputs(now=4.0, dt=4.0, messages=hear(votes)))
    pattern.step(Inputs(now=5.0, dt=1.0))
    return pattern.opinion


def test_adopts_the_majority_of_its_neighbours() -> None:
    assert opinion_after(make(initial=0), {"b": 2, "c": 2, "d": 1}) == 2


def test_other_channels_are_ignored() -> None:
    pattern = make(initial=0)
    pattern.step(Inputs(now=0.0, dt=0.0))
    elsewhere = (Message("b", "weather", 2, 0.0),)
    pattern.step(Inputs(now=4.0, dt=4.0, messages=elsewhere))
    pattern.step(Inputs(now=5.0, dt=1.0))
    assert pattern.opinion == 0


@pytest.mark.parametrize(("ties", "opinion"), [("lowest", 1), ("keep", 3)])
def test_ties_follow_the_parameter(ties: str, opinion: int) -> None:
    pattern = make(opinions=4, initial=3, ties=ties)
    assert opinion_after(pattern, {"b": 2, "c": 1}) == opinion


def test_ties_are_random_by_default() -> None:
    seen = {opinion_after(make(seed, initial=0), {"b": 2, "c": 1}) for seed in range(20)}
    assert seen == {1, 2}


@pytest.mark.parametrize(
    ("window", "period", "times"),
    [(5.0, 2.0, [0.0, 2.0, 4.0, 5.0, 7.0, 9.0, 10.0]), (4.0, 3.0, [0.0, 2.0, 4.0, 6.0, 8.0, 10.0])],
)
def test_shares_at_once_then_regularly_and_after_each_window(
    window: float, period: float, times: list[float]
) -> None:
    pattern = make(initial=1, window=window, share_period=period)
    shared = [
        now
        for now in np.arange(0.0, 11.0, 0.5).tolist()
        if pattern.step(Inputs(now=now, dt=0.5)).messages
    ]
    assert shared == times


def test_a_changed_window_applies_from_the_next_one() -> None:
    pattern = make(initial=0)
    pattern.step(Inputs(now=0.0, dt=0.0))
    pattern.update(make(initial=0, window=2.0).params)
    pattern.step(Inputs(now=5.0, dt=5.0))
    pattern.step(Inputs(now=6.0, dt=1.0, messages=hear({"b": 2})))
    assert pattern.step(Inputs(now=6.9, dt=0.9)).report["opinion"] == 0
    assert pattern.step(Inputs(now=7.0, dt=0.1)).report["opinion"] == 2


def test_a_removed_opinion_is_drawn_again() -> None:
    pattern = make(initial=2)
    pattern.update(make(opinions=2, initial=0).params)
    assert pattern.opinion in {0, 1}
