"""Best of n: one robot through its states."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Inputs, Message, Value
from swarmd.patterns.best_of_n.pattern import BestOfN
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestBestOfN(PatternContract):
    pattern = BestOfN


def make(seed: int = 0, **params: Value) -> BestOfN:
    subject = TestBestOfN.subject("burger")
    pattern = Subject(BestOfN, subject.platform, {"initial": 0, **params}).make(seed)
    assert isinstance(pattern, BestOfN)
    return pattern


def promotions(quality: float) -> list[float]:
    """The lengths in s of the promotions of option 0 in an hour."""
    pattern, begun, found = make(), 0.0, []
    readings = {"quality_0": quality, "quality_1": 1.0}
    promoted = False
    for k in range(36000):
        promotes = bool(pattern.step(Inputs(0.1 * k, 0.1, readings=readings)).report["promotes"])
        if promotes and not promoted:
            begun = 0.1 * k
        if promoted and not promotes:
            found.append(0.1 * k - begun)
        promoted = promotes
    return found


@pytest.mark.parametrize(("quality", "mean"), [(1.0, 8.4), (0.5, 4.2)])
def test_promotes_its_option_longer_the_better_it_is(quality: float, mean: float) -> None:
    lengths = promotions(quality)
    # Exponential: the standard error is mean / sqrt(n), some 5 %.
    assert np.mean(lengths) == pytest.approx(mean, rel=0.2)


def test_speaks_only_while_it_promotes() -> None:
    pattern = make()
    readings = {"quality_0": 1.0, "quality_1": 1.0}
    for k in range(600):
        found = pattern.step(Inputs(0.1 * k, 0.1, readings=readings))
        assert found.report["promotes"] or not found.messages
    assert pattern.opinion == 0


def decided(votes: list[int], *, seed: int = 0, **params: Value) -> int:
    """The opinion after the end of a promotion in which neighbours sent these votes in turn."""
    pattern = make(seed, **params)
    readings = {"quality_0": 1.0, "quality_1": 1.0}
    promoted, k = False, 0
    while True:
        heard = tuple(
            Message(f"b{n}", "opinion", vote, 0.001 * (len(votes) - n))
            for n, vote in enumerate(votes)
        )
        found = pattern.step(Inputs(0.1 * k, 0.1, readings=readings, messages=heard))
        if promoted and not found.report["promotes"]:
            return int(found.report["opinion"])
        promoted, k = bool(found.report["promotes"]), k + 1


def test_the_majority_of_the_last_heard_and_itself_wins() -> None:
    assert decided([1, 1, 1]) == 1
    assert decided([1, 1, 0]) == 0  # two to two: it keeps its own
    assert decided([0, 0, 0, 1, 1, 1], group=3) == 1
    assert decided([1, 1, 1, 0, 0, 0], group=3) == 0


def test_a_voter_adopts_that_of_a_random_one() -> None:
    found = [decided([1, 1, 0], rule="voter", seed=seed) for seed in range(60)]
    # Binomial: 40 +- 3.7; four standard deviations.
    assert 25 <= sum(found) <= 55


def test_keeps_its_opinion_if_none_is_heard_or_all_are_invalid() -> None:
    assert decided([]) == 0
    assert decided([7, 7, 7]) == 0


def test_an_option_without_a_reading_of_its_quality_is_refused() -> None:
    with pytest.raises(ConfigError, match="quality_2"):
        make(options=3)


def test_an_option_that_is_no_more_is_not_adopted() -> None:
    subject = TestBestOfN.subject("burger")
    three = {"reading:quality_2"}
    platform = replace(subject.platform, provides=subject.platform.provides | three)
    some: dict[str, Value] = {
        "rule": "voter",
        "initial": 0,
        "exploration": 0.1,
        "dissemination": 0.1,
    }
    pattern: Any = Subject(BestOfN, platform, {**some, "options": 3}).make()
    readings = {"quality_0": 1.0, "quality_1": 1.0, "quality_2": 1.0}
    heard = (Message("robot-2", "opinion", 2, 0.0),)
    pattern.step(Inputs(0.0, 0.1, messages=heard, readings=readings))
    pattern.update(Subject(BestOfN, platform, {**some, "options": 2}).make().params)
    for k in range(1, 20):
        pattern.step(Inputs(0.1 * k, 0.1, readings=readings))
    assert pattern.opinion == 0


def test_an_option_of_no_quality_is_never_promoted() -> None:
    pattern = make()
    readings = {"quality_0": 0.0, "quality_1": 1.0}
    said = [pattern.step(Inputs(0.1 * k, 0.1, readings=readings)).messages for k in range(6000)]
    assert not any(said)
