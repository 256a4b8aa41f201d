"""Response thresholds: one robot at a stimulus."""

from __future__ import annotations

from itertools import pairwise

import pytest

from swarmd.core.values import Inputs, Value
from swarmd.patterns.response_threshold.pattern import ResponseThreshold
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestResponseThreshold(PatternContract):
    pattern = ResponseThreshold


PLATFORM = TestResponseThreshold.subject("burger").platform


def works(stimulus: float, seed: int, seconds: int = 1, **params: Value) -> list[bool]:
    """Whether a robot works, after each second."""
    pattern = Subject(ResponseThreshold, PLATFORM, params).make(seed)
    readings = {"stimulus": stimulus}
    return [
        bool(pattern.step(Inputs(float(k), 1.0, readings=readings)).report["works"])
        for k in range(1, seconds + 2)
    ]


@pytest.mark.parametrize(("stimulus", "share"), [(5.0, 0.5), (2.5, 0.2), (10.0, 0.8), (0.0, 0.0)])
def test_begins_to_work_with_the_probability_of_the_source(stimulus: float, share: float) -> None:
    begun = sum(works(stimulus, seed)[-1] for seed in range(400))
    # Binomial: four standard deviations are at most 0.1.
    assert begun / 400.0 == pytest.approx(share, abs=0.1 if share else 0.0)


def test_a_working_robot_stops_with_a_fixed_probability() -> None:
    history = works(1e6, 0, 4000)
    stops = sum(now and not later for now, later in pairwise(history))
    assert stops / sum(history[:-1]) == pytest.approx(0.2, abs=0.03)


def test_decides_once_a_period() -> None:
    assert works(1e6, 0, 3, decide_period=100.0) == [False] * 4


def test_stands_still_without_the_reading() -> None:
    pattern = Subject(ResponseThreshold, PLATFORM, {}).make()
    found = [pattern.step(Inputs(float(k), 1.0)) for k in range(5)]
    assert not any(one.report["works"] for one in found)
    assert all(one.twist is None for one in found)
