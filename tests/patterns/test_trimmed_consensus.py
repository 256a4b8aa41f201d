"""Trimmed consensus: one robot and its neighbours' values."""

from __future__ import annotations

import math

import pytest

from swarmd.core.values import Inputs, Message, Value
from swarmd.patterns.trimmed_consensus.pattern import TrimmedConsensus, trimmed
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestTrimmedConsensus(PatternContract):
    pattern = TrimmedConsensus


def after(values: dict[str, float], *, late: float = 0.0, **params: Value) -> float:
    """The value after one update, of a robot that holds 5 and heard these `late` s before."""
    given = {"initial": 5.0, **params}
    pattern = Subject(TrimmedConsensus, load_platform("burger"), given).make()
    pattern.step(Inputs(0.0, 0.0))
    heard = tuple(Message(name, "value", value, late) for name, value in values.items())
    return float(pattern.step(Inputs(0.6, 0.6, messages=heard)).report["value"])


@pytest.mark.parametrize(
    ("values", "own", "trim", "kept"),
    [
        ([1.0, 2.0, 8.0, 9.0], 5.0, 1, [2.0, 8.0]),
        ([1.0, 2.0, 8.0, 9.0], 5.0, 0, [1.0, 2.0, 8.0, 9.0]),
        ([1.0, 2.0, 8.0, 9.0], 5.0, 3, []),
        # Fewer than `trim` on one side: all of them, and none of the other side instead.
        ([7.0, 8.0, 9.0], 5.0, 1, [7.0, 8.0]),
        ([5.0, 5.0, 9.0], 5.0, 1, [5.0, 5.0]),
    ],
)
def test_the_largest_above_and_the_smallest_below_are_dropped(
    values: list[float], own: float, trim: int, kept: list[float]
) -> None:
    assert trimmed(values, own, trim) == kept


def test_moves_to_the_mean_of_the_rest_and_its_own() -> None:
    assert after({"a": 1.0, "b": 2.0, "c": 8.0, "d": 9.0}) == pytest.approx(5.0)
    assert after({"a": 4.0, "b": 3.0, "c": 100.0}) == pytest.approx(4.5)
    assert after({"a": 4.0, "b": 3.0, "c": 100.0}, trim=0) == pytest.approx(28.0)


def test_a_stubborn_robot_keeps_its_value() -> None:
    assert after({"a": 1.0, "b": 2.0, "c": 3.0}, is_stubborn=True) == 5.0


def test_an_old_value_and_an_endless_one_do_not_count() -> None:
    assert after({"a": 4.0, "b": 3.0, "c": 2.0}, late=4.0) == 5.0
    assert after({"a": math.nan, "b": math.inf, "c": 1e300}, trim=0) == 5.0
