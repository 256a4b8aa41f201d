"""Which metrics differ between experiments or variants, by how much, and how certain that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

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
    or if neither direction is good as such. `p`: that there is no difference; `p_holm`: corrected
    for all metrics of the comparison.

    `never_a` and `never_b` count the runs in which the event of a time to an event never happened.
    With such runs the means are those up to `horizon` s, and `p` is that of the log-rank test.
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
    horizon: float | None = None
    p: float | None = None
    p_holm: float | None = None

    @property
    def differs(self) -> bool:
        """Whether the interval excludes 0."""
        return self.interval is not None and 0.0 not in self.interval

    @property
    def conclusion(self) -> str:
        """The result of the comparison in a few words."""
        if self.difference is None:
            return "-"
        text = "differs" if self.better is None else f"{self.better.upper()} is better"
        if self.interval is None:
            text = "too few runs"
        elif not self.differs:
            text = "no difference shown"
        elif not self.holds:
            text += ", not after Holm"
        if self.horizon is None:
            return text
        never = f"never: {self.never_a} of {self.n_a}, {self.never_b} of {self.n_b}"
        return f"{text} up to {self.horizon:g} s; {never}"

    @property
    def holds(self) -> bool:
        """Whether the metric differs after Holm's correction, too."""
        return self.differs and self.p_holm is not None and self.p_holm <= 1.0 - LEVEL


def sides(a: str, b: str, *, is_trusted: bool = False) -> list[tuple[Side, Side]]:
    """The pairs of variants that `A` and `B` name: FOLDER, or FOLDER:VARIANT of a sweep.

    Two folders with the same variants are compared variant by variant. ConfigError if the names
    are ambiguous. `is_trusted`: as of `load_results`.
    """
    left, right = (sides_of(text, is_trusted=is_trusted) for text in (a, b))
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


def sides_of(text: str, *, is_trusted: bool = False) -> list[Side]:
    """The variants that `FOLDER` or `FOLDER:VARIANT` names; ConfigError for an unknown variant."""
    folder, variant = text, None
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
    """The difference of each metric that both sides have; ConfigError for an unknown name.

    With the same planned seeds on both sides, each run is compared with the run of the same seed,
    which removes the common effect of the seed; a failed run drops its counterpart too. Otherwise
    the sides are resampled independently.
    """
    both = [name for name in a.results.metrics if name in b.results.metrics]
    differences = [
        _difference(a, b, a.results.about(name)) for name in (both if names is None else names)
    ]
    return corrected(differences)


def corrected(differences: Sequence[Difference]) -> list[Difference]:
    """The differences with Holm's correction for all of them."""
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
    """A comparison as plain values."""
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
    name, unit = metric.name, metric.unit
    left, right = a.results.metric(metric, a.variant), b.results.metric(metric, b.variant)
    never_a, never_b = int(np.isnan(left).sum()), int(np.isnan(right).sum())
    horizon, p = None, None
    if metric.is_time_to_event and (never_a or never_b):
        end_a, end_b = _duration(a), _duration(b)
        horizon = min(end_a, end_b)
        p = logrank_p(left, right, end_a, end_b)
        left, right = restricted(left, horizon), restricted(right, horizon)
    is_paired = set(a.results.plan.seeds) == set(b.results.plan.seeds)
    if is_paired:
        seeds = a.results.seeds(a.variant), b.results.seeds(b.variant)
        _, places_a, places_b = np.intersect1d(*seeds, assume_unique=True, return_indices=True)
        left, right = left[places_a], right[places_b]
        both = ~(np.isnan(left) | np.isnan(right))
        left, right = left[both], right[both]
        bounds = mean_interval(right - left)
    else:
        left, right = left[~np.isnan(left)], right[~np.isnan(right)]
        bounds = difference_interval(left, right)
    better: Literal["a", "b"] | None = None
    if bounds is not None and metric.better is not None and 0.0 not in bounds:
        better = "b" if (bounds.low > 0.0) == (metric.better == "more") else "a"
    if horizon is None:
        p = difference_p(left, right, is_paired=is_paired)
    mean_a, mean_b = (float(some.mean()) if some.size else None for some in (left, right))
    return Difference(
        metric=name,
        unit=unit,
        n_a=left.size,
        n_b=right.size,
        mean_a=mean_a,
        mean_b=mean_b,
        difference=None if mean_a is None or mean_b is None else mean_b - mean_a,
        interval=bounds,
        is_paired=is_paired,
        better=better,
        never_a=never_a if horizon is not None else 0,
        never_b=never_b if horizon is not None else 0,
        horizon=horizon,
        p=p,
    )


def _duration(side: Side) -> float:
    """The simulated seconds of the runs of one side."""
    variants = {variant.name: variant for variant in side.results.plan.variants}
    return float(variants[side.variant].effective["duration"])
