"""The smallest gap: exact, and the same as looking at every pair and instant."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.values import Array
from swarmd.sim.metrics import gap, pairs
from swarmd.sim.trace import Trace
from swarmd.sim.world.geometry import gaps, transform
from tests.sim.metrics.runs import line, run
from tests.support.examples import examples


def by_hand(trace: Trace) -> Array:
    """(T,) with every pair looked at."""
    each = [
        gaps(
            transform(trace.footprint(a), trace.pose[:, a]),
            transform(trace.footprint(b), trace.pose[:, b]),
        )
        for a, b in combinations(range(len(trace.ids)), 2)
    ]
    smallest: Array = np.min(each, axis=0)
    return smallest


def strewn(seed: int, n: int, instants: int, side: float) -> Trace:
    rng = np.random.default_rng(seed)
    pose = rng.uniform(-side / 2.0, side / 2.0, (instants, n, 3))
    pose[..., 2] = rng.uniform(-3.0, 3.0, (instants, n))
    names = ("burger", "jackal", "waffle_pi")
    return run(pose, platforms=tuple(names[i % 3] for i in range(n)))


def test_minimum_gap_is_between_footprints_not_centres() -> None:
    pose = np.zeros((2, 2, 3))
    pose[:, 1, 0] = (3.0, 2.0)
    assert gap.minimum_gap(run(pose)) == pytest.approx(2.0 - 0.508)
    np.testing.assert_allclose(gap.minimum_gaps(run(pose)), [3.0 - 0.508, 2.0 - 0.508])
    pose[1, 1, 2] = math.pi / 2.0  # the second one's narrow side now
    assert gap.minimum_gap(run(pose)) == pytest.approx(2.0 - 0.254 - 0.215)


LOPSIDED = {
    "burger": np.array([[-0.6, -0.1], [0.1, -0.1], [0.2, 0.4]]),
    "jackal": np.array([[-0.1, -0.2], [0.7, -0.1], [0.1, 0.1], [0.0, 0.1], [-0.1, 0.0]]),
    "waffle_pi": np.array([[-0.1, 0.0], [0.0, -0.8], [0.1, 0.0], [0.0, 0.1]]),
}


@pytest.mark.parametrize(
    ("n", "side", "shapes"),
    [(5, 80.0, {}), (7, 6.0, {}), (30, 200.0, {}), (5, 6.0, {"footprints": LOPSIDED})],
)
@given(seed=st.integers(0, 10_000))
@settings(deadline=None, max_examples=examples(10))
def test_gaps_are_those_of_all_pairs(
    n: int, side: float, shapes: dict[str, Any], seed: int
) -> None:
    trace = replace(strewn(seed, n, 8, side), **shapes)
    np.testing.assert_allclose(gap.minimum_gaps(trace), by_hand(trace), atol=1e-12)
    assert gap.minimum_gap(trace) == pytest.approx(float(by_hand(trace).min()), abs=1e-12)


def test_gaps_of_more_instants_than_are_worked_on_at_once() -> None:
    n = 41
    trace = strewn(5, n, 2 * pairs.MAX_POINTS // n, 400.0)
    rows = slice(None, None, 37)
    few = replace(trace, t=trace.t[rows], pose=trace.pose[rows], safe=trace.safe[rows])
    every = gap.minimum_gaps(trace)
    np.testing.assert_allclose(every[rows], by_hand(few), atol=1e-12)
    assert gap.minimum_gap(trace) == pytest.approx(float(every.min()), abs=1e-12)


def test_minimum_gap_is_zero_in_touch_and_infinite_alone() -> None:
    assert gap.minimum_gap(run(line(0.0, 0.5))) == 0.0
    assert gap.minimum_gap(run(line(0.0))) == math.inf
    assert gap.minimum_gaps(run(line(0.0))).tolist() == [math.inf]
    assert gap.minimum_gap(run(np.zeros((0, 2, 3)))) == math.inf
    assert gap.minimum_gaps(run(np.zeros((0, 50, 3)))).shape == (0,)


def test_the_body_of_an_absent_robot_counts() -> None:
    trace = run(line(0.0, 1.0), present=np.array([[True, False]]))
    assert gap.minimum_gap(trace) == pytest.approx(1.0 - 0.508)


def test_a_body_that_is_not_in_the_arena_does_not_count() -> None:
    pose = np.repeat(line(0.0, 1.0, 5.0), 2, axis=0)
    pose[1, 1] = np.nan
    gaps = gap.minimum_gaps(run(pose))
    without = gap.minimum_gaps(run(pose[:, [0, 2]]))
    assert gaps[0] < 1.0
    assert gaps[1] == without[1]
    pose[1, 2] = np.nan
    assert gap.minimum_gaps(run(pose))[1] == np.inf
    assert gap.minimum_gap(run(pose[1:])) == np.inf
