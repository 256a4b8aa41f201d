"""The voter model, alone."""

from __future__ import annotations

from collections import Counter

from swarmd.core.values import Inputs, Message, Value
from swarmd.patterns.voter_model.pattern import VoterModel
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestVoterModel(PatternContract):
    pattern = VoterModel


def make(seed: int = 0, **params: Value) -> VoterModel:
    """Its windows end in step."""
    given = {"initial": 0, "staggered": False, **params}
    pattern = Subject(VoterModel, load_platform("burger"), given).make(seed)
    assert isinstance(pattern, VoterModel)
    return pattern


def opinion_after(pattern: VoterModel, *votes: tuple[str, int]) -> int:
    """Its opinion after one window of 2 s in which the votes were heard."""
    pattern.step(Inputs(now=0.0, dt=0.0))
    heard = tuple(Message(sender, "opinion", vote, 0.0) for sender, vote in votes)
    pattern.step(Inputs(now=1.9, dt=1.9, messages=heard))
    pattern.step(Inputs(now=2.0, dt=0.1))
    return pattern.opinion


def test_decides_every_two_seconds_as_the_original() -> None:
    pattern = make()
    assert opinion_after(pattern, ("b", 1)) == 1
    pattern.step(Inputs(now=2.5, dt=0.5, messages=(Message("b", "opinion", 2, 0.0),)))
    assert pattern.step(Inputs(now=3.9, dt=1.4)).report["opinion"] == 1
    assert pattern.step(Inputs(now=4.0, dt=0.1)).report == {"opinion": 2, "heard": 1}


def test_each_neighbour_is_drawn_with_equal_probability() -> None:
    votes = (("b", 1), ("c", 2), ("d", 2), ("b", 1), ("b", 1))
    pattern = make()
    counts = Counter(pattern.decide({"b": 1, "c": 2, "d": 2}) for _ in range(900))
    # Binomial: 300 +- 14, four standard deviations.
    assert 243 <= counts[1] <= 357
    spoken = Counter(opinion_after(make(seed), *votes) for seed in range(300))
    assert 67 <= spoken[1] <= 133
