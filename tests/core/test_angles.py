"""Angles: the same direction within half a turn, with the bits of Python's `%`."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis.strategies import floats

from swarmd.core.angles import difference, wrap


@pytest.mark.parametrize(
    ("angle", "wanted"),
    [(0.0, 0.0), (1.0, 1.0), (math.pi, -math.pi), (-math.pi, -math.pi), (3.5, 3.5 - math.tau)],
)
def test_an_angle_lies_within_half_a_turn(angle: float, wanted: float) -> None:
    assert wrap(angle) == pytest.approx(wanted, abs=1e-15)
    assert difference(angle + 1.0, 1.0) == pytest.approx(wanted, abs=1e-15)


@given(floats(-1e9, 1e9))
def test_an_angle_has_the_bits_of_the_remainder_of_python(angle: float) -> None:
    assert wrap(angle) == (angle + math.pi) % math.tau - math.pi


def test_an_angle_that_is_not_finite_is_not_a_number() -> None:
    assert math.isnan(wrap(math.nan))
    assert math.isnan(wrap(math.inf))
