"""Levy walk: one robot, without and with an obstacle."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.core.errors import ParameterError
from swarmd.core.values import Inputs, Value
from swarmd.patterns.levy_walk.pattern import LevyWalk
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, empty_scan, scan_of

BURGER = load_platform("burger")


class TestLevyWalk(PatternContract):
    pattern = LevyWalk


def flights(count: int, **params: Value) -> list[float]:
    """The lengths in m of so many flights in the open, of a robot that does what it requests."""
    pattern = Subject(LevyWalk, BURGER, params).make(1)
    scan, length, k = empty_scan(BURGER, 0, 0.0), 0.0, 0
    found: list[float] = []
    while len(found) <= count:
        twist = pattern.step(Inputs(0.1 * k, 0.1 if k else 0.0, scan)).twist
        assert twist is not None
        if twist.linear:
            length += 0.1 * twist.linear
        elif length:
            found.append(length)
            length = 0.0
        k += 1
    return found[1:]


@pytest.mark.parametrize("exponent", [1.5, 2.0, 3.0])
def test_the_lengths_of_flights_follow_the_power_law(exponent: float) -> None:
    lengths = np.array(flights(300, exponent=exponent, shortest=0.3, longest=10.0))
    most = (10.0 / 0.3) ** (1.0 - exponent)
    for limit in (0.5, 1.0, 3.0):
        share = ((limit / 0.3) ** (1.0 - exponent) - most) / (1.0 - most)
        # Binomial: four standard deviations of 300 are at most 0.12.
        assert (lengths > limit).mean() == pytest.approx(share, abs=0.12)
    assert lengths.min() > 0.29
    assert lengths.max() < 10.1


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_turns_away_from_an_obstacle_ahead(side: float) -> None:
    pattern = Subject(LevyWalk, BURGER, {}).make()
    scan = scan_of(BURGER, [Disc(0.5, 0.1 * side)])
    twist = pattern.step(Inputs(0.0, 0.0, scan, True)).twist
    assert twist is not None
    assert twist.linear == 0.0
    assert twist.angular * side < 0.0


def test_the_shortest_flight_is_below_the_longest() -> None:
    with pytest.raises(ParameterError, match="shortest"):
        Subject(LevyWalk, BURGER, {"shortest": 2.0, "longest": 1.0}).make()
