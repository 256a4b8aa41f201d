"""How one number is taken from a series."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from swarmd.core.values import Array
from swarmd.sim.metrics.metric import Value, at_end, at_start, late_mean, peak
from swarmd.sim.trace import Trace
from tests.sim.metrics.runs import run


def clock(trace: Trace) -> Array:
    return trace.t


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (at_start(clock), 0.0),
        (at_end(clock), 120.0),
        (late_mean(clock), 90.0),
        (peak(clock), 120.0),
    ],
)
def test_a_number_of_a_series(value: Value, expected: float) -> None:
    assert value(run(np.zeros((1201, 1, 3)))) == pytest.approx(expected)


@pytest.mark.parametrize("take", [at_start, at_end, late_mean, peak])
def test_no_series_and_no_instant_are_no_number(
    take: Callable[[Callable[[Trace], Array | None]], Value],
) -> None:
    assert take(lambda trace: None)(run(np.zeros((3, 1, 3)))) is None
    assert take(clock)(run(np.zeros((0, 1, 3)))) is None
    assert take(lambda trace: trace.t * np.nan)(run(np.zeros((3, 1, 3)))) is None


def test_what_is_not_known_is_left_out() -> None:
    holes = np.array([1.0, np.nan, 5.0, 3.0])
    assert peak(lambda trace: holes)(run(np.zeros((4, 1, 3)))) == 5.0
