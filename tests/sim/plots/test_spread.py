"""Bands hold the runs that they say they hold."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.sim.experiments.statistics import wilson
from swarmd.sim.plots.spread import (
    MOST_INSTANTS,
    Series,
    bands_of,
    is_yes_or_no,
    shares_of,
    smoothed,
)

T = np.arange(5.0)


def constant(value: float) -> Series:
    return T, np.full(5, value)


def test_the_middle_is_the_median_and_half_of_the_runs_are_in_the_inner_band() -> None:
    bands = bands_of([constant(value) for value in (1.0, 2.0, 3.0, 4.0, 50.0)])
    assert bands.inner is not None
    assert bands.outer is not None
    ends = [float(row[2]) for row in (*bands.outer, *bands.inner, bands.middle)]
    assert ends == [1.0, 50.0, 2.0, 4.0, 3.0]
    assert np.array_equal(bands.t, T)


def test_from_twenty_runs_on_the_outer_band_leaves_the_rarest_out() -> None:
    runs = [constant(float(value)) for value in range(41)]
    outer = bands_of(runs).outer
    assert outer is not None
    assert (outer[0][0], outer[1][0]) == (1.0, 39.0)


@pytest.mark.parametrize(("count", "bands"), [(1, (None, None)), (2, (None, "outer"))])
def test_few_runs_have_few_bands(count: int, bands: tuple[str | None, str | None]) -> None:
    found = bands_of([constant(float(value)) for value in range(count)])
    assert (found.inner is None, found.outer is None) == (bands[0] is None, bands[1] is None)


def test_a_run_counts_no_longer_than_it_lasts() -> None:
    bands = bands_of([constant(0.0), (T[:3], np.full(3, 1.0))])
    assert bands.middle[1] == 0.5
    assert bands.middle[-1] == 0.0


def test_runs_of_other_instants_are_interpolated() -> None:
    bands = bands_of([(T, T), (np.array([0.0, 4.0]), np.array([0.0, 4.0]))])
    assert bands.middle == pytest.approx(bands.t)
    assert len(bands.t) == 5


def test_what_is_not_finite_counts_for_nothing() -> None:
    hole = (T, np.array([1.0, np.nan, np.inf, 1.0, 1.0]))
    assert bands_of([hole, constant(3.0)]).middle.tolist() == [2.0, 3.0, 3.0, 2.0, 2.0]
    assert np.isnan(bands_of([hole]).middle[1:3]).all()


def test_runs_without_any_value_have_no_band() -> None:
    empty = np.zeros(0), np.zeros(0)
    assert np.isnan(bands_of([constant(np.nan)]).middle).all()
    assert bands_of([empty, constant(1.0)]).middle.tolist() == [1.0] * 5
    assert np.isnan(shares_of([constant(np.nan)]).middle).all()
    assert shares_of([empty, constant(1.0)]).middle.tolist() == [1.0] * 5


def test_long_runs_are_thinned() -> None:
    t = np.arange(10_000) / 10.0
    bands = bands_of([(t, t)])
    assert len(bands.t) == MOST_INSTANTS
    assert bands.t[-1] == t[-1]


def test_a_share_has_wilsons_interval_and_keeps_its_steps() -> None:
    step = (T, np.array([0.0, 0.0, 1.0, 1.0, 1.0]))
    shares = shares_of([step, constant(0.0), constant(1.0), (T[:2], np.ones(2))])
    assert shares.middle.tolist() == [0.5, 0.5, 2 / 3, 2 / 3, 2 / 3]
    assert shares.outer is not None
    interval = wilson(2, 3)
    assert (shares.outer[0][-1], shares.outer[1][-1]) == (interval.low, interval.high)
    late = np.array([0.0, 1.5, 4.0]), np.array([0.0, 1.0, 1.0])
    assert set(shares_of([late, step]).middle) <= {0.0, 0.5, 1.0}


@pytest.mark.parametrize(
    ("runs", "expected"),
    [
        ([constant(0.0), constant(1.0)], True),
        ([constant(np.nan), constant(1.0)], True),
        ([constant(0.5)], False),
        ([constant(np.nan)], False),
        ([], False),
    ],
)
def test_shares_are_recognised(runs: list[Series], expected: bool) -> None:
    assert is_yes_or_no(runs) is expected


def test_a_running_mean_is_taken_around_each_instant() -> None:
    t, values = smoothed((T, np.array([0.0, 3.0, 6.0, np.nan, 0.0])), 2.0)
    assert np.array_equal(t, T)
    assert values[:3].tolist() == [1.5, 3.0, 4.5]
    assert np.isnan(values[3])
    assert values[4] == 0.0
