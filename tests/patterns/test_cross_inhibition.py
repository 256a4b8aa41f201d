"""Cross-inhibition, alone: what it makes of one neighbour's opinion."""

from __future__ import annotations

from collections import Counter

import pytest

from swarmd.core.values import Value
from swarmd.patterns.cross_inhibition.pattern import CrossInhibition
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestCrossInhibition(PatternContract):
    pattern = CrossInhibition


def make(own: int, **params: Value) -> CrossInhibition:
    given = {"initial": own, **params}
    pattern = Subject(CrossInhibition, load_platform("burger"), given).make()
    assert isinstance(pattern, CrossInhibition)
    return pattern


@pytest.mark.parametrize(
    ("own", "heard", "crossed", "direct"),
    [(1, 1, 1, 1), (1, 2, 0, 2), (1, 0, 1, 1), (0, 2, 2, 2), (0, 0, 0, 0)],
)
def test_the_opinion_after_one_is_heard(own: int, heard: int, crossed: int, direct: int) -> None:
    assert make(own).decide({"b": heard}) == crossed
    assert make(own, rule="direct").decide({"b": heard}) == direct
    assert make(own, is_stubborn=True).decide({"b": heard}) == own


def test_each_neighbour_is_drawn_with_equal_probability() -> None:
    pattern = make(0)
    counts = Counter(pattern.decide({"b": 1, "c": 2, "d": 2}) for _ in range(900))
    # Binomial: 300 +- 14, four standard deviations.
    assert 243 <= counts[1] <= 357
