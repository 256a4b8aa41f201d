"""Comparison of two experiments or variants: difference, interval and p of each metric."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError, unknown
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.statistics import (
    LEVEL,
    Interval,
    difference_interval,
    difference_p,
    holm,
    interval,
    logrank_p,
    mean_interval,
    number,
    restricted,
)
from swarmd.sim.metrics.metric import Metric

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Side:
    """One side of a comparison: a variant of an experiment, `label` as the user named it."""

    label: str
    results: Results
    variant: str


@dataclass(frozen=True, slots=True)
class Difference:
    """The comparison of one metric between side a and side b.

    A run is compared if it has a value. If `is_paired`, its pair, the run of the same seed on the
    opposite side, must have a value, too.

    For a time to an event that never happened in some runs, the means are restricted to `horizon`
    s. Then `p` is that of the log-rank test, which takes no pairs, and uses all finished runs.
    """

    metric: str
    unit: str
    n_a: int
    """The number of compared runs of side a."""
    n_b: int
    mean_a: float | None = None
    """None if side a has no compared run."""
    mean_b: float | None = None
    difference: float | None = None
    """`mean_b` - `mean_a`; None if either mean is None."""
    interval: Interval | None = None
    """The 95 % interval of the difference; None with fewer than two pairs, or runs on a side."""
    is_paired: bool = False
    """Runs of the same seed are pairs."""
    better: Literal["a", "b"] | None = None
    """The better side; None if the interval holds 0, or if the metric has no better direction."""
    never_a: int = 0
    """The number of compared runs of side a in which the event of the metric never happened."""
    never_b: int = 0
    horizon: float | None = None
    p: float | None = None
    """Of the null hypothesis that the sides do not differ; None with too few runs."""
    p_holm: float | None = None
    """`p` with Holm's correction for all metrics of the comparison."""

    @property
    def differs(self) -> bool:
        """Whether the interval excludes 0."""
        return self.interval is not None and 0.0 not in self.interval

    @property
    def conclusion(self) -> str:
        """The result of the comparison in a few words; "-" if a side has no compared run."""
        if self.difference is None:
            return "-"
        if self.interval is None:
            text = "too few runs"
        elif not self.differs:
            text = "no difference shown"
        else:
            text = "differs" if self.better is None else f"{self.better.upper()} is better"
            if not self.holds:
                text += ", not after Holm"
        if self.horizon is None:
            return text
        never = f"never: {self.never_a} of {self.n_a}, {self.never_b} of {self.n_b}"
        return f"{text} up to {self.horizon:g} s; {never}"

    @property
    def holds(self) -> bool:
        """Whether the metric still differs after Holm's correction."""
        return self.differs and self.p_holm is not None and self.p_holm <= 1.0 - LEVEL


def sides(a: str, b: str, *, is_trusted: bool = False) -> list[tuple[Side, Side]]:
    """The pairs of variants to compare. `a` and `b`: FOLDER, or FOLDER:VARIANT of a sweep.

    Two single variants give one pair, also if their names differ. Two folders with the same
    variants give a pair for each variant. ConfigError if the folders have different variants, or if
    a single variant is compared with several. `is_trusted`: metrics in Python files run even if the
    files are new or have changed.
    """
    left, right = (sides_of(text, is_trusted=is_trusted) for text in (a, b))
    if len(left) == 1 or len(right) == 1:
        if len(left) == len(right):
            return [(left[0], right[0])]
        folder, swept = (a, left) if len(left) > 1 else (b, right)
        variants = ", ".join(side.variant for side in swept)
        raise ConfigError(f"{folder}: name one of its variants, as {swept[0].label}: {variants}")
    if [side.variant for side in left] != [side.variant for side in right]:
        raise ConfigError(
            f"{a} and {b}: their variants are not the same; name one of each,"
            f" such as {left[0].label} and {right[0].label}"
        )
    return list(zip(left, right, strict=True))


def sides_of(text: str, *, is_trusted: bool = False) -> list[Side]:
    """The variants that `FOLDER` or `FOLDER:VARIANT` names; ConfigError for an unknown variant."""
    folder = text
    variant = None
    if not Path(text).is_dir() and ":" in text:
        folder, _, variant = text.partition(":")
    results = load_results(folder, is_trusted=is_trusted)
    if not results.rows:
        raise ConfigError(f"{folder}: no run of it has finished; run it first")
    if variant is not None and variant not in results.variants:
        raise ConfigError(f"{folder}: {unknown('variant', variant, results.variants)}")
    wanted = results.variants if variant is None else (variant,)
    return [Side(f"{folder}:{name}" if name else folder, results, name) for name in wanted]


def compare(a: Side, b: Side, names: Sequence[str | Metric] | None = None) -> list[Difference]:
    """Compare the metrics `names` of two sides; None: all metrics that both sides have.

    If both sides have the same planned seeds, runs of the same seed are pairs, which removes the
    common effect of the seed. A pair with a failed run is left out. With different seeds the sides
    are independent samples. ConfigError for an unknown metric.
    """
    both = [name for name in a.results.metrics if name in b.results.metrics]
    differences = [
        _difference(a, b, a.results.about(name)) for name in (both if names is None else names)
    ]
    return corrected(differences)


def corrected(differences: Sequence[Difference]) -> list[Difference]:
    """The differences with `p_holm` set: Holm's correction for all of them together."""
    values = holm([difference.p for difference in differences])
    return [
        replace(difference, p_holm=p) for difference, p in zip(differences, values, strict=True)
    ]


DIFFERENCE_HEADER = (
    *("METRIC", "UNIT", "MEAN A", "MEAN B", "B - A", "95 %"),
    *("P (HOLM)", "RUNS", "RESULT"),
)


def difference_row(difference: Difference) -> tuple[str, ...]:
    """The cells of a table below DIFFERENCE_HEADER."""
    runs = (
        str(difference.n_a)
        if difference.n_a == difference.n_b
        else f"{difference.n_a}, {difference.n_b}"
    )
    numbers = number(difference.mean_a), number(difference.mean_b), number(difference.difference)
    cells = interval(difference.interval), number(difference.p_holm), runs, difference.conclusion
    return (difference.metric, difference.unit or "-", *numbers, *cells)


def document(a: Side, b: Side, differences: Sequence[Difference]) -> dict[str, Any]:
    """A comparison as dicts, lists, texts and numbers, for JSON."""
    return {
        "a": a.label,
        "b": b.label,
        "level": LEVEL,
        "differ_by_chance": 0.05
        * sum(difference.interval is not None for difference in differences),
        "metrics": {
            difference.metric: {
                **asdict(difference),
                "differs": difference.differs,
                "holds": difference.holds,
            }
            for difference in differences
        },
    }


def _difference(a: Side, b: Side, metric: Metric) -> Difference:
    """Compare one metric of two sides: means, 95 % interval and p, without Holm's correction."""
    # (runs,). NaN: the run has no value; of a time to an event: the event never happened.
    measured_a = a.results.metric(metric, a.variant)
    measured_b = b.results.metric(metric, b.variant)
    is_paired = set(a.results.plan.seeds) == set(b.results.plan.seeds)
    # If an event never happened in some runs, times are limited to the horizon: `restricted` puts
    # the horizon in place of longer times and of NaN. `horizon` None: no times are limited.
    has_never = bool(np.isnan(measured_a).any() or np.isnan(measured_b).any())
    horizon = (
        min(a.results.duration(a.variant), b.results.duration(b.variant))
        if metric.is_time_to_event and has_never
        else None
    )
    values_a = measured_a
    values_b = measured_b
    if horizon is not None:
        values_a = restricted(values_a, horizon)
        values_b = restricted(values_b, horizon)
    # The runs that are compared: runs with a value, or pairs of runs with two values.
    runs_a = np.flatnonzero(~np.isnan(values_a))
    runs_b = np.flatnonzero(~np.isnan(values_b))
    if is_paired:
        runs_a, runs_b = _pairs(a, b, runs_a, runs_b)
    values_a = values_a[runs_a]
    values_b = values_b[runs_b]
    if horizon is None:
        p = difference_p(values_a, values_b, is_paired=is_paired)
    else:  # of all finished runs, without pairs: the test is for independent samples
        p = logrank_p(
            measured_a, measured_b, a.results.duration(a.variant), b.results.duration(b.variant)
        )
    if is_paired:
        bounds = mean_interval(values_b - values_a)
    else:
        bounds = difference_interval(values_a, values_b)
    mean_a = float(values_a.mean()) if values_a.size else None
    mean_b = float(values_b.mean()) if values_b.size else None
    return Difference(
        metric=metric.name,
        unit=metric.unit,
        n_a=values_a.size,
        n_b=values_b.size,
        mean_a=mean_a,
        mean_b=mean_b,
        difference=None if mean_a is None or mean_b is None else mean_b - mean_a,
        interval=bounds,
        is_paired=is_paired,
        better=_better(bounds, metric),
        never_a=0 if horizon is None else int(np.isnan(measured_a[runs_a]).sum()),
        never_b=0 if horizon is None else int(np.isnan(measured_b[runs_b]).sum()),
        horizon=horizon,
        p=p,
    )


def _pairs(a: Side, b: Side, runs_a: Indices, runs_b: Indices) -> tuple[Indices, Indices]:
    """Those of the runs `runs_a` and `runs_b` that have the same seed; equal places are pairs."""
    seeds_a = np.array(a.results.seeds(a.variant), dtype=np.int64)[runs_a]
    seeds_b = np.array(b.results.seeds(b.variant), dtype=np.int64)[runs_b]
    _, places_a, places_b = np.intersect1d(
        seeds_a, seeds_b, assume_unique=True, return_indices=True
    )
    return runs_a[places_a], runs_b[places_b]


def _better(bounds: Interval | None, metric: Metric) -> Literal["a", "b"] | None:
    """The better side, from the interval of b - a; None if no side is better."""
    if bounds is None or metric.better is None or 0.0 in bounds:
        return None
    is_b_greater = bounds.low > 0.0
    is_more_better = metric.better == "more"
    return "b" if is_b_greater == is_more_better else "a"
