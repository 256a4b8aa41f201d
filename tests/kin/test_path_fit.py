"""The registration of two paths, with answers by hand."""

from __future__ import annotations

import math

import pytest

from swarmd.kin.path_fit import PathFit

L_SHAPE = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (1.0, 2.0)]


def test_finds_the_turn_and_the_shift() -> None:
    fit = PathFit()
    for k, (x, y) in enumerate(L_SHAPE):  # p: q turned by a quarter to the left, then (3, 1) on
        fit.add(0.2 * k, 3.0 - y, 1.0 + x, x, y)
    assert fit.turn == pytest.approx(math.pi / 2)
    assert fit.residual == pytest.approx(0.0, abs=1e-6)
    assert fit.place(2.0, 5.0) == pytest.approx((-2.0, 3.0))


def test_a_mirrored_path_does_not_fit() -> None:
    fit = PathFit()
    for k, (x, y) in enumerate(L_SHAPE):
        fit.add(0.0001 * k, x, -y, x, y)
    # Squared distances from the means: 0.75 in x and 2.75 in y, for both; x times y: 0.75.
    # a = 0.75 - 2.75 = -2, b = -2 * 0.75 = -1.5; (3.5 + 3.5 - 2 * 2.5) / 4 = 0.5.
    assert fit.residual == pytest.approx(math.sqrt(0.5), abs=0.001)


def test_a_track_that_stands_leaves_the_spread_of_the_path() -> None:
    fit = PathFit()
    for k in range(2):
        fit.add(0.0, 5.0, 5.0, float(k), 0.0)
    assert fit.spread == pytest.approx(0.5)
    assert fit.residual == pytest.approx(0.5)


def test_forgets_what_is_long_past() -> None:
    fit = PathFit()
    fit.add(0.0, 9.0, 9.0, 0.0, 0.0)
    for k, (x, y) in enumerate(L_SHAPE):
        fit.add(100.0 + 0.2 * k, x, y, x, y)
    assert fit.residual == pytest.approx(0.0, abs=1e-3)
