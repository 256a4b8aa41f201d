"""Intervals cover the true value about as often as their level says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from statistics import NormalDist

import numpy as np
import pytest

from swarmd.core.values import Array
from swarmd.sim.experiments import statistics
from swarmd.sim.experiments.statistics import (
    HEADER,
    Interval,
    difference_interval,
    difference_p,
    holm,
    interaction_p,
    logrank_p,
    mean_interval,
    median_interval,
    ratio_interval,
    restricted,
    summarize,
    summary_rows,
    wilson,
)
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.plots.survival import Times, survival_curve

NORMAL = NormalDist()
TRIALS = 400
# 400 trials of 95 % scatter by 1.1 %; bootstrap intervals of 20 values are known to be a little
# narrow (Efron & Tibshirani 1993, chapter 14), the more so for skewed values.
COARSE = (0.89, 0.99)


def draws(kind: str, n: int) -> Array:
    """Samples (TRIALS, n) of a distribution whose mean is 1."""
    rng = np.random.default_rng(7)
    if kind == "normal":
        return rng.normal(1.0, 2.0, (TRIALS, n))
    return rng.exponential(1.0, (TRIALS, n))


def coverage(intervals: list[Interval | None], truth: float) -> float:
    return float(np.mean([interval is not None and truth in interval for interval in intervals]))


@pytest.fixture(autouse=True)
def _fewer_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(statistics, "RESAMPLES", 1000)


@pytest.mark.short_rows(1)
@pytest.mark.parametrize(
    ("interval", "kind", "truth"),
    [
        (mean_interval, "normal", 1.0),
        (mean_interval, "exponential", 1.0),
        (median_interval, "normal", 1.0),
        (median_interval, "exponential", np.log(2.0)),
    ],
)
def test_an_interval_covers_the_true_value(
    interval: Callable[[Array], Interval | None], kind: str, truth: float
) -> None:
    share = coverage([interval(sample) for sample in draws(kind, 25)], truth)
    assert COARSE[0] <= share <= COARSE[1]


@pytest.mark.short_rows(1)
@pytest.mark.parametrize(
    ("interval", "kind", "truth"),
    [(difference_interval, "normal", 3.0), (ratio_interval, "exponential", 4.0)],
)
def test_the_interval_of_two_means_covers_their_difference_and_ratio(
    interval: Callable[[Array, Array], Interval | None], kind: str, truth: float
) -> None:
    is_ratio = interval is ratio_interval
    found = [
        interval(4.0 * sample[20:], sample[:20]) if is_ratio
        else interval(sample[:20], sample[20:] + truth)
        for sample in draws(kind, 45)
    ]  # fmt: skip
    assert COARSE[0] <= coverage(found, truth) <= COARSE[1]


def test_a_ratio_to_nothing_has_no_interval() -> None:
    assert ratio_interval(np.ones(5), np.zeros(5)) is None


def test_two_samples_are_resampled_independently() -> None:
    """The same draws for both would make of them pairs, which they are not."""
    sample = draws("normal", 20)[0]
    found = difference_interval(sample, sample)
    assert found is not None
    assert found.high - found.low > 2.0 * sample.std() / 20**0.5


def test_the_interval_of_a_mean_is_bca() -> None:
    """What bias correction and acceleration are for, each: by the formula, done the long way."""
    sample = draws("exponential", 25)[0]
    n, mean = sample.size, sample.mean()
    rng = np.random.default_rng([1993, 0])
    replicates = np.array([sample[row].mean() for row in rng.integers(n, size=(1000, n))])
    bias = NORMAL.inv_cdf(float((replicates < mean).mean()))
    left_out = np.array([np.delete(sample, i).mean() for i in range(n)])
    away = left_out.mean() - left_out  # E&T 14.15
    acceleration = (away**3).sum() / (6.0 * (away**2).sum() ** 1.5)
    ends = [
        NORMAL.cdf(bias + (bias + z) / (1.0 - acceleration * (bias + z)))
        for z in (NORMAL.inv_cdf(0.025), NORMAL.inv_cdf(0.975))
    ]
    found = mean_interval(sample)
    assert found is not None
    assert (found.low, found.high) == pytest.approx(np.quantile(replicates, ends), rel=1e-12)
    assert found.high - mean > 1.3 * (mean - found.low)


@pytest.mark.parametrize(
    ("count", "n", "low", "high"),
    [(0, 20, 0.0, 0.161), (20, 20, 0.839, 1.0), (10, 20, 0.299, 0.701), (1, 29, 0.006, 0.172)],
)
def test_wilsons_interval_is_as_published(count: int, n: int, low: float, high: float) -> None:
    """The last row is Newcombe's (Statistics in Medicine 17, 1998, table I)."""
    found = wilson(count, n)
    assert found.low == pytest.approx(low, abs=6e-4)
    assert found.high == pytest.approx(high, abs=6e-4)


def test_a_share_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="nothing"):
        wilson(0, 0)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1.0, np.nan, 3.0], {"n": 2, "mean": 2.0, "median": 2.0, "min": 1.0, "max": 3.0}),
        ([np.nan], {"n": 0, "mean": None, "mean_interval": None}),
        ([2.5], {"mean": 2.5, "mean_interval": None, "median_interval": None}),
        ([0.1] * 20, dict.fromkeys(("mean_interval", "median_interval"), Interval(0.1, 0.1))),
        ([1.0, 2.0, np.inf], {"mean": np.inf, "mean_interval": None}),
        ([0.0, 1.0, 0.0], {"share": None, "share_interval": None}),  # counts are no share
    ],
)
def test_a_summary_leaves_out_what_the_values_do_not_give(
    values: list[float], expected: dict[str, object]
) -> None:
    found = asdict(summarize(np.array(values)))
    assert {name: found[name] for name in expected} == expected


@pytest.mark.parametrize("value", [0.5, 2.0, -1.0])
def test_a_metric_said_to_be_0_or_1_that_is_not_has_no_share(value: float) -> None:
    """The function of a user may return any number, whatever its unit is."""
    found = summarize(np.array([1.0] * 9 + [value]), is_share=True)
    assert (found.share, found.share_interval) == (None, None)
    assert found.mean_interval is not None
    assert found.mean_interval.low < found.mean_interval.high


def test_a_share_has_the_interval_of_a_share() -> None:
    found = summarize(np.array([1.0] * 19 + [0.0]), is_share=True)
    assert found.share == pytest.approx(0.95)
    assert found.share_interval == wilson(19, 20)


def test_a_time_that_some_runs_never_reached_has_a_median_and_no_mean() -> None:
    found = summarize(np.array([10.0, 20.0, np.nan]), is_time_to_event=True)
    assert (found.n, found.never, found.median) == (2, 1, 20.0)
    assert (found.mean, found.mean_interval, found.median_interval) == (None, None, None)
    (row,) = summary_rows([(METRICS["gather_time"], found)])
    assert row[HEADER.index("MEAN")] == "1 of 3 never"
    mostly_never = summarize(np.array([10.0, np.nan, np.nan]), is_time_to_event=True)
    assert (mostly_never.median, mostly_never.never) == (None, 2)
    every = summarize(np.array([10.0, 20.0]), is_time_to_event=True)
    assert (every.mean, every.never) == (15.0, 0)


def test_the_p_of_a_difference_is_that_of_the_exact_permutations() -> None:
    a, b = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])
    assert difference_p(a, b, is_paired=False) == pytest.approx(2.0 / 20.0)  # 2 of 6 over 3
    assert difference_p(a, b, is_paired=True) == pytest.approx(2.0 / 8.0)  # 2 of 2**3 signs
    assert difference_p(a, b[:1], is_paired=False) is None


def test_the_p_of_a_difference_is_near_that_of_the_t_test_for_normal_values() -> None:
    from scipy.stats import ttest_ind

    rng = np.random.default_rng(5)
    a, b = rng.normal(0.0, 1.0, 30), rng.normal(0.6, 1.0, 30)
    found = difference_p(a, b, is_paired=False)
    assert found == pytest.approx(ttest_ind(a, b).pvalue, abs=0.01)


def test_the_log_rank_test_is_that_of_its_definition() -> None:
    """Mantel's statistic, summed event by event."""
    a = np.array([10.0, 20.0, 30.0, np.nan, np.nan])
    b = np.array([5.0, 8.0, 12.0, 15.0, 40.0])
    observed = expected = variance = 0.0
    for t in sorted([*a[:3], *b]):
        at_risk_a = np.sum(~(a < t))
        at_risk = at_risk_a + np.sum(~(b < t))
        observed += float(t in a)
        expected += at_risk_a / at_risk
        variance += at_risk_a * (at_risk - at_risk_a) / at_risk**2
    from scipy.stats import chi2

    p = chi2.sf((observed - expected) ** 2 / variance, 1)
    assert logrank_p(a, b, 60.0, 60.0) == pytest.approx(p)
    assert logrank_p(np.full(3, np.nan), np.full(3, np.nan), 60.0, 60.0) is None
    # At 90 s the runs of one side are over; at 5 s all have the event.
    assert logrank_p(np.full(3, np.nan), np.full(3, 90.0), 60.0, 300.0) is None
    assert logrank_p(np.full(3, 5.0), np.full(3, 5.0), 60.0, 60.0) is None


def test_the_restricted_mean_is_the_area_under_the_survival_curve() -> None:
    times = np.array([10.0, 35.0, 70.0, np.nan, 20.0])
    curve = survival_curve(Times(times, np.full(5, 90.0)))
    at = np.append(curve.t[curve.t < 60.0], 60.0)
    area = np.sum(np.diff(at) * curve.share[: len(at) - 1])
    assert restricted(times, 60.0).mean() == pytest.approx(area)


def test_holms_correction_is_that_of_r() -> None:
    """p.adjust(c(0.01, 0.02, 0.03, 0.04), "holm") of R, in another order."""
    assert holm([0.04, 0.01, None, 0.03, 0.02]) == pytest.approx([0.06, 0.04, None, 0.06, 0.06])


BATTERIES = np.array(
    [
        [[130, 155, 74, 180], [34, 40, 80, 75], [20, 70, 82, 58]],
        [[150, 188, 159, 126], [136, 122, 106, 115], [25, 70, 58, 45]],
        [[138, 110, 168, 160], [174, 120, 150, 139], [96, 104, 82, 60]],
    ],
    np.float64,
)
"""Life in hours by material and temperature: Montgomery, example 5.1."""


def test_the_interaction_of_a_textbook_is_found() -> None:
    assert interaction_p(BATTERIES, has_blocks=False) == pytest.approx(0.0186, abs=5e-5)


def test_the_effect_of_a_seed_is_no_scatter() -> None:
    rng = np.random.default_rng(2)
    cells = rng.normal(0.0, 1.0, (2, 3, 10))
    moved = cells + 50.0 * rng.normal(0.0, 1.0, 10)
    found = interaction_p(cells, has_blocks=True)
    assert interaction_p(moved, has_blocks=True) == pytest.approx(found)


def test_without_interaction_each_p_is_as_likely() -> None:
    from scipy.stats import kstest

    rng = np.random.default_rng(4)
    found = [interaction_p(rng.normal(0.0, 1.0, (2, 3, 6)), has_blocks=True) for _ in range(400)]
    assert kstest(found, "uniform").pvalue > 0.01


def test_cells_without_scatter_or_with_one_run_have_no_interaction() -> None:
    assert interaction_p(np.ones((2, 2, 5)), has_blocks=True) is None
    assert interaction_p(np.ones((2, 2, 1)), has_blocks=False) is None
