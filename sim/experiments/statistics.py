"""Means, medians and shares with their 95 % intervals, and tables of them as text.

- Mean: bootstrap interval, bias-corrected and accelerated (BCa: Efron & Tibshirani, An Introduction
  to the Bootstrap, 1993, chapter 14.3).
- Median: percentile bootstrap interval (chapter 13.3). BCa takes its acceleration from the
  jackknife, which fails for medians (chapter 11.6).
- Share: Wilson's score interval (Wilson, JASA 22, 1927). At a share of 0 or 1 resampling would give
  an interval of no width; Wilson's interval has one.
- Difference of means: permutation test (Ernst, "Permutation Methods", Statist. Science 19, 2004).
- Times to an event that never happened in some runs: log-rank test.
- All metrics of a comparison together: Holm's correction of p.

With few values bootstrap intervals are too narrow (Efron & Tibshirani 1993, chapter 14). Measured
here with normal and exponential values, 95 % intervals of a mean contain the true mean in 79 % of
the cases with 5 values, in 87 % with 10, and in 92 % with 20.

scipy.stats is imported in the functions, since the import takes most of a second.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics.metric import Metric

LEVEL = 0.95
RESAMPLES = 5000
PERMUTATIONS = 9999  # the least p is 1e-4
FEW = 10
"""With fewer values than this number, bootstrap intervals are much too narrow."""
METHOD = (
    "bootstrap of 5000 resamples (Efron & Tibshirani 1993): BCa for means, percentile for medians;"
    " Wilson's score (1927) for shares"
)
_SEED = 1993
_BATCH = 2_000_000  # numbers resampled at a time: 16 MB


class Interval(NamedTuple):
    """From `low` to `high`, both included."""

    low: float
    high: float

    def __contains__(self, value: object) -> bool:
        return isinstance(value, float) and self.low <= value <= self.high


@dataclass(frozen=True, slots=True)
class Summary:
    """Statistics of the values of a metric; without a value, only `n` and `never` are set.

    Intervals are None for fewer than two values. For a time to an event that never happened in some
    runs, the mean and all intervals are None: the mean of the runs with the event would be biased.
    """

    n: int
    """The number of runs with a value."""
    mean: float | None = None
    mean_interval: Interval | None = None
    median: float | None = None
    """Of all runs; None if the event never happened in at least half of them."""
    median_interval: Interval | None = None
    min: float | None = None
    max: float | None = None
    share: float | None = None
    """The share of ones, for a metric that is 0 or 1 by definition."""
    share_interval: Interval | None = None
    never: int | None = None
    """The number of runs without the event, for a time to an event."""


def summarize(values: Array, *, is_share: bool = False, is_time_to_event: bool = False) -> Summary:
    """The summary of values (n,). NaN: the run has no value.

    `is_share`: the metric is 0 or 1 by definition, not a count that happens to be 0 or 1.
    `is_time_to_event`: NaN means that the event never happened.
    """
    kept = values[~np.isnan(values)]
    never = values.size - kept.size if is_time_to_event else None
    if not kept.size:
        return Summary(n=0, never=never)
    if never:
        median = float(np.median(np.where(np.isnan(values), np.inf, values)))
        return Summary(
            n=kept.size,
            median=median if np.isfinite(median) else None,
            min=float(kept.min()),
            never=never,
        )
    return Summary(
        n=kept.size,
        mean=float(kept.mean()),
        mean_interval=mean_interval(kept),
        median=float(np.median(kept)),
        median_interval=median_interval(kept),
        min=float(kept.min()),
        max=float(kept.max()),
        share=float(kept.mean()) if is_share else None,
        share_interval=wilson(int(kept.sum()), kept.size) if is_share else None,
        never=never,
    )


def mean_interval(values: Array) -> Interval | None:
    """The BCa interval of the mean of values (n,); None with fewer than two or infinite values."""
    if values.size >= 2 and np.isfinite(values).all() and np.ptp(values) == 0.0:
        return Interval(float(values[0]), float(values[0]))
    return _bootstrap((values,), np.mean, "BCa")


def median_interval(values: Array) -> Interval | None:
    """The percentile interval of the median of values (n,); None as for `mean_interval`."""
    return _bootstrap((values,), np.median, "percentile")


def difference_interval(a: Array, b: Array) -> Interval | None:
    """The interval of mean(b) - mean(a) of independent samples (n,) and (m,), each resampled.

    Percentile interval (Efron & Tibshirani 1993, chapter 8.3 for two samples); None as for
    `mean_interval`.
    """

    def difference(a: Array, b: Array, axis: int) -> Array:
        return np.asarray(b.mean(axis=axis) - a.mean(axis=axis))

    return _bootstrap((a, b), difference, "percentile")


def ratio_interval(above: Array, below: Array) -> Interval | None:
    """The interval of mean(above) / mean(below) of independent samples, as `difference_interval`.

    None also if a resampled mean of `below` is 0.
    """

    def ratio(above: Array, below: Array, axis: int) -> Array:
        return np.asarray(above.mean(axis=axis) / below.mean(axis=axis))

    with np.errstate(divide="ignore"):
        bounds = _bootstrap((above, below), ratio, "percentile")
    return bounds if bounds is not None and np.isfinite(bounds).all() else None


def difference_p(a: Array, b: Array, *, is_paired: bool) -> float | None:
    """The p of a two-sided permutation test of equal means of a (n,) and b (m,).

    `is_paired`: a[i] and b[i] are a pair, and values are exchanged within pairs alone. The test is
    exact if there are at most PERMUTATIONS exchanges, else it draws PERMUTATIONS random exchanges.
    None with fewer than two or infinite values on a side.
    """
    from scipy.stats import permutation_test

    if min(a.size, b.size) < 2 or not (np.isfinite(a).all() and np.isfinite(b).all()):
        return None

    def difference(a: Array, b: Array, axis: int) -> Array:
        return np.asarray(b.mean(axis=axis) - a.mean(axis=axis))

    test = permutation_test(
        (a, b),
        difference,
        permutation_type="samples" if is_paired else "independent",
        vectorized=True,
        n_resamples=PERMUTATIONS,
        batch=max(1, _BATCH // (a.size + b.size)),
        rng=np.random.default_rng([_SEED, 1]),
    )
    return float(test.pvalue)


def logrank_p(a: Array, b: Array, end_a: float, end_b: float) -> float | None:
    """The p of a two-sided log-rank test of times to an event a (n,) and b (m,).

    NaN: the event did not happen by `end_a` or `end_b`, the duration of the runs in s; such a time
    is right-censored. Source: Mantel, "Evaluation of Survival Data", Cancer Chemotherapy Reports
    50, 1966. Runs with a common seed count as independent. None with fewer than two runs on a side,
    without any event, or if no event can tell the sides apart, such as events on one side after all
    runs of the opposite side have ended.
    """
    from scipy.stats import CensoredData, logrank

    if min(a.size, b.size) < 2 or not np.isfinite(np.concatenate((a, b))).any():
        return None
    both = [
        CensoredData(uncensored=x[~np.isnan(x)], right=np.full(int(np.isnan(x).sum()), end))
        for x, end in ((a, end_a), (b, end_b))
    ]
    with np.errstate(invalid="ignore"):  # 0 / 0 if no event can tell the sides apart
        p = float(logrank(*both).pvalue)
    return None if np.isnan(p) else p


def restricted(times: Array, horizon: float) -> Array:
    """Times to an event (n,), each limited to `horizon` s; NaN: the event never happened.

    The mean of the result is the restricted mean survival time: the area under the survival curve
    up to `horizon` (Royston and Parmar, BMC Medical Research Methodology 13:152, 2013). All runs
    must last at least `horizon` s.
    """
    return np.minimum(np.where(np.isnan(times), np.inf, times), horizon)


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """The p of several tests with Holm's correction (Scand. J. Statist. 6, 1979); None stays None.

    If each test with a corrected p below 0.05 counts as a finding, the probability that any finding
    is false is below 0.05.
    """
    known = sorted((p, index) for index, p in enumerate(p_values) if p is not None)
    corrected: list[float | None] = [None] * len(p_values)
    least = 0.0
    for rank, (p, index) in enumerate(known):
        least = max(least, min(1.0, (len(known) - rank) * p))
        corrected[index] = least
    return corrected


def interaction_p(cells: Array, *, has_blocks: bool) -> float | None:
    """The p of the interaction of two factors; a small p says that their effects do not add up.

    `cells` (rows, columns, n): n runs for each combination of the factors. F test of the two-way
    analysis of variance with equal n (Montgomery, Design and Analysis of Experiments, chapter 5.3).
    `has_blocks`: the k-th runs of all cells share a seed, and the common effect of the seed is
    removed from the scatter. None with one run per cell, one row or column, or without scatter.
    """
    from scipy.stats import f as distribution

    rows, columns, n = cells.shape
    means, all_mean = cells.mean(axis=2), cells.mean()
    added = means.mean(axis=1)[:, None] + means.mean(axis=0)[None] - all_mean
    scatter = cells - means[:, :, None]
    degrees = rows * columns * (n - 1)
    if has_blocks:
        scatter = scatter - (cells.mean(axis=(0, 1)) - all_mean)
        degrees -= n - 1
    freedom = (rows - 1) * (columns - 1)
    error = float((scatter**2).sum())
    if not freedom or not degrees or error <= 1e-24 * float((cells**2).sum()):
        return None
    ratio = n * float(((means - added) ** 2).sum()) / freedom / (error / degrees)
    return float(distribution.sf(ratio, freedom, degrees))


@cache
def wilson(count: int, n: int) -> Interval:
    """Wilson's score interval of the share `count` of `n`; ValueError if n is 0."""
    from scipy.stats import binomtest

    if n < 1:
        raise ValueError("a share of nothing has no interval")
    bounds = binomtest(count, n).proportion_ci(LEVEL, method="wilson")
    return Interval(float(bounds.low), float(bounds.high))


def _bootstrap(
    samples: tuple[Array, ...], statistic: Callable[..., Array], method: str
) -> Interval | None:
    """A bootstrap interval with a fixed random seed; None with fewer than two or infinite values.

    If BCa gives NaN, the interval is a percentile interval.
    """
    from scipy.stats import DegenerateDataWarning, bootstrap

    if any(values.size < 2 or not np.isfinite(values).all() for values in samples):
        return None
    # Almost equal values have no acceleration: 0 / 0.
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", DegenerateDataWarning)
        bounds = bootstrap(
            samples,
            statistic,
            n_resamples=RESAMPLES,
            batch=max(1, _BATCH // sum(values.size for values in samples)),
            vectorized=True,
            axis=-1,
            confidence_level=LEVEL,
            method=method,
            rng=np.random.default_rng([_SEED, 0]),
        ).confidence_interval
    if method == "BCa" and np.isnan((bounds.low, bounds.high)).any():
        return _bootstrap(samples, statistic, "percentile")
    return Interval(float(bounds.low), float(bounds.high))


HEADER = ("METRIC", "UNIT", "MEAN", "95 %", "MEDIAN", "95 %", "MIN", "MAX", "RUNS")
NOTHING = "-"


def summary_rows(summaries: Iterable[tuple[Metric, Summary]]) -> list[tuple[str, ...]]:
    """A row of cells for each metric; a metric that is 0 or 1 has the interval of its share.

    A time to an event that never happened in some runs has their number instead of a mean.
    """
    return [
        (
            metric.name,
            metric.unit or NOTHING,
            f"{summary.never} of {summary.n + summary.never} never"
            if summary.never
            else number(summary.mean),
            interval(summary.mean_interval if summary.share is None else summary.share_interval),
            number(summary.median) if summary.share is None else NOTHING,
            interval(summary.median_interval if summary.share is None else None),
            number(summary.min),
            number(summary.max),
            str(summary.n + (summary.never or 0)),
        )
        for metric, summary in summaries
    ]


def aligned(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of aligned columns."""
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in (header, *rows)
    ]


def number(value: float | None) -> str:
    """The value with four significant digits."""
    return NOTHING if value is None else f"{value:.4g}"


def interval(bounds: Interval | None) -> str:
    """Both ends, with four significant digits each."""
    return NOTHING if bounds is None else f"{bounds.low:.4g} to {bounds.high:.4g}"
