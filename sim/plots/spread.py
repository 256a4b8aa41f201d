"""How runs spread around their middle over time: the numbers behind bands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.experiments.statistics import wilson

Series = tuple[Array, Array]
"""Of one run: instants (T,) in s, increasing, and values (T,); NaN where there is none."""

MOST_INSTANTS = 600
MANY_RUNS = 20
"""From so many runs on, 95 % of them are not simply all of them."""
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Bands:
    """What runs come to over time, (T,) each; NaN where no run has a value.

    `inner` and `outer` are the lower and upper bounds around `middle`; None if there are none.
    """

    t: Array
    middle: Array
    inner: tuple[Array, Array] | None
    outer: tuple[Array, Array] | None


def bands_of(runs: Sequence[Series]) -> Bands:
    """The median, half of the runs around it, and 95 % of them, or all below 20 runs.

    Runs are interpolated onto common instants; none counts beyond its own end, and infinite
    values count as none.
    """
    t = _common_instants([instants for instants, _ in runs])
    rows = np.stack([_interpolated(t, *run) for run in runs])
    ends = (0.025, 0.975) if len(runs) >= MANY_RUNS else (0.0, 1.0)
    found = np.full((5, len(t)), np.nan)
    is_known = np.isfinite(rows).any(axis=0)
    if is_known.any():
        shares = (ends[0], 0.25, 0.5, 0.75, ends[1])
        found[:, is_known] = np.nanquantile(rows[:, is_known], shares, axis=0)
    low, lower, middle, upper, high = found
    inner = (lower, upper) if len(runs) > 2 else None
    return Bands(t, middle, inner, (low, high) if len(runs) > 1 else None)


def shares_of(runs: Sequence[Series]) -> Bands:
    """Of runs whose values are 0 or 1: the share of them that is at 1, with Wilson's interval."""
    t = _common_instants([instants for instants, _ in runs])
    rows = np.stack([_held(t, *run) for run in runs])
    counts, ones = np.isfinite(rows).sum(axis=0), np.nansum(rows, axis=0)
    found = np.full((3, len(t)), np.nan)
    for at in np.flatnonzero(counts):
        interval = wilson(round(ones[at]), int(counts[at]))
        found[:, at] = ones[at] / counts[at], interval.low, interval.high
    return Bands(t, found[0], None, (found[1], found[2]) if len(runs) > 1 else None)


def smoothed(run: Series, seconds: float) -> Series:
    """The run's running mean over so many seconds around each instant; NaN where it had none."""
    t, values = run
    is_known = np.isfinite(values)
    sums = np.concatenate(([0.0], np.cumsum(np.where(is_known, values, 0.0))))
    counts = np.concatenate(([0], np.cumsum(is_known)))
    first = np.searchsorted(t, t - seconds / 2.0 - _ROUNDING)
    after = np.searchsorted(t, t + seconds / 2.0 + _ROUNDING, side="right")
    total, count = sums[after] - sums[first], counts[after] - counts[first]
    return t, np.where(is_known, total / np.maximum(count, 1), np.nan)


def is_yes_or_no(runs: Sequence[Series]) -> bool:
    """Whether the runs have values, and 0 and 1 alone."""
    known = [values[np.isfinite(values)] for _, values in runs]
    return any(len(values) for values in known) and all(
        bool(np.isin(values, (0.0, 1.0)).all()) for values in known
    )


def _interpolated(t: Array, instants: Array, values: Array) -> Array:
    if len(instants) == 0:
        return np.full(len(t), np.nan)
    finite = np.where(np.isfinite(values), values, np.nan)
    return np.interp(t, instants, finite, left=np.nan, right=np.nan)


def _held(t: Array, instants: Array, values: Array) -> Array:
    """At each of `t` the latest value; NaN before the first instant and after the last."""
    if len(instants) == 0:
        return np.full(len(t), np.nan)
    at = np.searchsorted(instants, t + _ROUNDING, side="right") - 1
    is_within = (at >= 0) & (t <= instants[-1] + _ROUNDING) & np.isfinite(values[at])
    held: Array = np.where(is_within, values[at], np.nan)
    return held


def _common_instants(of_runs: Sequence[Array]) -> Array:
    first = of_runs[0]
    if len(first) <= MOST_INSTANTS and all(np.array_equal(first, t) for t in of_runs):
        return first
    ends = [t[[0, -1]] for t in of_runs if len(t)]
    longest = max(len(t) for t in of_runs)
    start, stop = min(t[0] for t in ends), max(t[1] for t in ends)
    return np.linspace(start, stop, min(longest, MOST_INSTANTS))
