"""Which metrics differ between two experiments, by how much, and how certain that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swarmd.core.errors import ConfigError, unknown
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.statistics import (
    LEVEL,
    Interval,
    difference_interval,
    interval,
    mean_interval,
    number,
)
from swarmd.sim.metrics.metric import Metric


@dataclass(frozen=True, slots=True)
class Side:
    """One side of a comparison: a variant of an experiment, `label` as the user named it."""

    label: str
    results: Results
    variant: str


@dataclass(frozen=True, slots=True)
class Difference:
    """How one metric differs: `difference` is the mean of `b` less the mean of `a`.

    `interval` is the 95 % interval of the difference. `is_paired`: the difference is taken seed by
    seed. `n_a` and `n_b` count the runs that were compared: those with a value, and if `is_paired`
    only the seeds with a value on both sides. A mean is None if its own side has no such run,
    `difference` if either has none, `interval` also with fewer than two pairs or runs on a side.
    `better` is the better side; None if the sides do not differ,
    or if neither direction is good as such. `never_a` and `never_b` count the runs in which the
    event of a time to an event never happened; with such runs there is no difference of means.
    """

    metric: str
    unit: str
    n_a: int
    n_b: int
    mean_a: float | None = None
    mean_b: float | None = None
    difference: float | None = None
    interval: Interval | None = None
    is_paired: bool = False
    better: Literal["a", "b"] | None = None
    never_a: int = 0
    never_b: int = 0

    @property
    def differs(self) -> bool:
        """Whether the interval excludes 0."""
        return self.interval is not None and 0.0 not in self.interval

    @property
    def conclusion(self) -> str:
        """The result of the comparison in a few words."""
        if self.never_a or self.never_b:
            of_a, of_b = self.n_a + self.never_a, self.n_b + self.never_b
            return f"never: {self.never_a} of {of_a}, {self.never_b} of {of_b}"
        if self.difference is None:
            return "-"
        if self.interval is None:
            return "too few runs"
        if not self.differs:
            return "no difference shown"
        return "differs" if self.better is None else f"{self.better.upper()} is better"


def sides(a: str, b: str) -> list[tuple[Side, Side]]:
    """The pairs of variants that `A` and `B` name: FOLDER, or FOLDER:VARIANT of a sweep.

    Two folders with the same variants are compared variant by variant. ConfigError if the names
    are ambiguous.
    """
    left, right = sides_of(a), sides_of(b)
    if len(left) == 1 or len(right) == 1:
        if len(left) == len(right):
            return [(left[0], right[0])]
        folder, many = (a, left) if len(left) > 1 else (b, right)
        variants = ", ".join(side.variant for side in many)
        raise ConfigError(f"{folder}: name one of its variants, as {many[0].label}: {variants}")
    if [side.variant for side in left] != [side.variant for side in right]:
        raise ConfigError(
            f"{a} and {b}: their variants are not the same; name one of each,"
            f" such as {left[0].label} and {right[0].label}"
        )
    return list(zip(left, right, strict=True))


def sides_of(text: str) -> list[Side]:
    """The variants that `FOLDER` or `FOLDER:VARIANT` names; ConfigError for an unknown variant."""
    folder, variant = text, None
    if not Path(text).is_dir() and ":" in text:
        folder, _, variant = text.partition(":")
    results = load_results(folder)
    if not results.rows:
        raise ConfigError(f"{folder}: no run of it has finished; run it first")
    if variant is not None and variant not in results.variants:
        raise ConfigError(f"{folder}: {unknown('variant', variant, results.variants)}")
    wanted = results.variants if variant is None else (variant,)
    return [Side(f"{folder}:{name}" if name else folder, results, name) for name in wanted]


def compare(a: Side, b: Side, names: Sequence[str | Metric] | None = None) -> list[Difference]:
    """The difference of each metric that both sides have; ConfigError for an unknown name.

    With the same planned seeds on both sides, each run is compared with the run of the same seed,
    which removes the common effect of the seed; a failed run drops its counterpart too. Otherwise
    the sides are resampled independently.
    """
    both = [name for name in a.results.metrics if name in b.results.metrics]
    return [_difference(a, b, a.results.about(name)) for name in (both if names is None else names)]


DIFFERENCE_HEADER = ("METRIC", "UNIT", "MEAN A", "MEAN B", "B - A", "95 %", "RUNS", "RESULT")


def difference_row(one: Difference) -> tuple[str, ...]:
    """The cells of a table below DIFFERENCE_HEADER."""
    runs = str(one.n_a) if one.n_a == one.n_b else f"{one.n_a}, {one.n_b}"
    numbers = number(one.mean_a), number(one.mean_b), number(one.difference)
    return (one.metric, one.unit or "-", *numbers, interval(one.interval), runs, one.conclusion)


def document(a: Side, b: Side, differences: Sequence[Difference]) -> dict[str, Any]:
    """A comparison as plain values."""
    return {
        "a": a.label,
        "b": b.label,
        "level": LEVEL,
        "differ_by_chance": 0.05 * sum(one.interval is not None for one in differences),
        "metrics": {one.metric: {**asdict(one), "differs": one.differs} for one in differences},
    }


def _difference(a: Side, b: Side, metric: Metric) -> Difference:
    name, unit = metric.name, metric.unit
    left, right = a.results.metric(metric, a.variant), b.results.metric(metric, b.variant)
    never_a, never_b = int(np.isnan(left).sum()), int(np.isnan(right).sum())
    if metric.is_time_to_event and (never_a or never_b):
        known_a, known_b = left.size - never_a, right.size - never_b
        return Difference(name, unit, known_a, known_b, never_a=never_a, never_b=never_b)
    is_paired = set(a.results.plan.seeds) == set(b.results.plan.seeds)
    if is_paired:
        seeds = a.results.seeds(a.variant), b.results.seeds(b.variant)
        _, places_a, places_b = np.intersect1d(*seeds, assume_unique=True, return_indices=True)
        left, right = left[places_a], right[places_b]
        both = ~(np.isnan(left) | np.isnan(right))
        left, right = left[both], right[both]
        found = mean_interval(right - left)
    else:
        left, right = left[~np.isnan(left)], right[~np.isnan(right)]
        found = difference_interval(left, right)
    better: Literal["a", "b"] | None = None
    if found is not None and metric.better is not None and 0.0 not in found:
        better = "b" if (found.low > 0.0) == (metric.better == "more") else "a"
    mean_a, mean_b = (float(some.mean()) if some.size else None for some in (left, right))
    return Difference(
        metric=name,
        unit=unit,
        n_a=left.size,
        n_b=right.size,
        mean_a=mean_a,
        mean_b=mean_b,
        difference=None if mean_a is None or mean_b is None else mean_b - mean_a,
        interval=found,
        is_paired=is_paired,
        better=better,
    )
