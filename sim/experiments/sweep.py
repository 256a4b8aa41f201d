"""Tables of a parameter sweep: means of all variants, and for two keys effects and interaction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.experiments.compare import Difference, Side, compare, corrected
from swarmd.sim.experiments.plan import shown
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.statistics import (
    LEVEL,
    Interval,
    holm,
    interaction_p,
    interval,
    mean_interval,
    number,
    restricted,
)
from swarmd.sim.metrics.metric import Metric

MARK = "*"
READING = (
    f"means; {MARK} differs from the first variant, with Holm's correction for the whole table"
)


@dataclass(frozen=True, slots=True)
class Marginal:
    """The mean of all runs with one `value` of a swept `key`, over all values of the other key."""

    key: str
    value: str
    mean: float
    interval: Interval | None


@dataclass(frozen=True, slots=True)
class Factors:
    """The effects of two swept keys on one metric: marginal means and interaction."""

    metric: str
    unit: str
    n: int
    """The number of seeds with a value in each variant; all others are left out."""
    marginals: tuple[Marginal, ...]
    largest: str
    """The variant whose mean is farthest from the additive model, the sum of both effects."""
    deviation: float
    """The mean of that variant minus the additive model."""
    p: float | None
    """Of the null hypothesis of no interaction. None with one seed, one value of a key, or without
    scatter."""
    p_holm: float | None = None
    """`p` with Holm's correction for all metrics."""


def first_and_others(results: Results, metrics: Sequence[Metric]) -> list[list[Difference]]:
    """The differences of each further variant from the first variant: a list for each variant.

    Holm's correction of p covers the differences of all variants together.
    """
    first, *further = _sides(results)
    by_variant = [compare(first, side, metrics) for side in further]
    in_order = iter(corrected([difference for row in by_variant for difference in row]))
    return [[next(in_order) for _ in row] for row in by_variant]


def variants_table(
    results: Results, metrics: Sequence[Metric]
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and rows of means, variant by metric; READING explains the cells."""
    names = [f"{metric.name} [{metric.unit}]" if metric.unit else metric.name for metric in metrics]
    header = ("VARIANT", *names)
    holds = [[False] * len(metrics)]  # of the first variant
    for differences in first_and_others(results, metrics):
        holds.append([difference.holds for difference in differences])
    rows = []
    for side, marked in zip(_sides(results), holds, strict=True):
        cells = []
        for metric, has_mark in zip(metrics, marked, strict=True):
            values = results.metric(metric, side.variant)
            known, never = _known(results, side.variant, metric, values)
            text = number(float(known.mean()) if known.size else None)
            text += f" ({never} of {values.size} never)" if never else ""
            cells.append(text + MARK if has_mark else text)
        rows.append((side.variant, *cells))
    return header, rows


def variants_document(results: Results, metrics: Sequence[Metric]) -> dict[str, Any]:
    """The differences of each variant from the first as plain values, by variant and metric."""
    _, *further = _sides(results)
    return {
        side.variant: {
            difference.metric: {**asdict(difference), "holds": difference.holds}
            for difference in differences
        }
        for side, differences in zip(further, first_and_others(results, metrics), strict=True)
    }


def factors(results: Results, metrics: Sequence[Metric]) -> list[Factors]:
    """The effects of the two keys of a sweep on each metric with values; empty for other sweeps."""
    sweep = results.plan.sweep
    if len(sweep) != 2 or min(map(len, sweep.values())) < 2:
        return []
    effects = [effect for metric in metrics if (effect := _factors(results, metric)) is not None]
    values = holm([effect.p for effect in effects])
    return [replace(effect, p_holm=p) for effect, p in zip(effects, values, strict=True)]


MARGINAL_HEADER = ("METRIC", "UNIT", "OF ALL WITH", "MEAN", "95 %", "SEEDS")
INTERACTION_HEADER = ("METRIC", "UNIT", "LARGEST DEVIATION FROM THE SUM", "P (HOLM)", "INTERACTION")


def marginal_rows(effect: Factors) -> list[tuple[str, ...]]:
    """Rows below MARGINAL_HEADER."""
    return [
        (effect.metric, effect.unit or "-", f"{part.key}={part.value}", number(part.mean),
         interval(part.interval), str(effect.n))
        for part in effect.marginals
    ]  # fmt: skip


def interaction_row(effect: Factors) -> tuple[str, ...]:
    """A row below INTERACTION_HEADER."""
    if effect.p_holm is None:
        result = "too few runs"
    else:
        result = "shown" if effect.p_holm <= 1.0 - LEVEL else "none shown"
    deviation = f"{effect.deviation:+.4g} with {effect.largest}"
    return (effect.metric, effect.unit or "-", deviation, number(effect.p_holm), result)


def _sides(results: Results) -> list[Side]:
    return [Side(name, results, name) for name in results.variants if results.seeds(name)]


def _known(results: Results, variant: str, metric: Metric, values: Array) -> tuple[Array, int]:
    """The values for a mean, and the number of runs in which a time to an event has no event.

    If there are such runs, the values are restricted to the duration of the runs.
    """
    never = int(np.isnan(values).sum()) if metric.is_time_to_event else 0
    if never:
        return restricted(values, results.duration(variant)), never
    return values[~np.isnan(values)], 0


def _factors(results: Results, metric: Metric) -> Factors | None:
    """The effects of two swept keys on one metric; None if no seed has a value in each variant.

    The values of the first key are rows, the values of the second key are columns.
    """
    (row_key, row_values), (column_key, column_values) = results.plan.sweep.items()
    by_cell = _values_by_cell(results, metric, row_key, column_key)
    common_seeds = sorted(set.intersection(*map(set, by_cell.values())))
    if not common_seeds:
        return None
    row_texts = [*map(shown, row_values)]
    column_texts = [*map(shown, column_values)]
    cells = np.array([
        [[by_cell[row, column][seed] for seed in common_seeds] for column in column_texts]
        for row in row_texts
    ])  # fmt: skip
    row_name, column_name = (key.rpartition(".")[2] for key in (row_key, column_key))
    # Marginal means: of all runs with one value of a key.
    marginals = (
        *_marginals(row_name, row_texts, cells.mean(axis=1)),
        *_marginals(column_name, column_texts, cells.mean(axis=0)),
    )
    # Interaction: the cell whose mean is farthest from the sum of both effects.
    means = cells.mean(axis=2)
    residuals = means - means.mean(axis=1)[:, None] - means.mean(axis=0)[None] + means.mean()
    row, column = np.unravel_index(int(np.abs(residuals).argmax()), residuals.shape)
    largest = f"{row_name}={row_texts[row]},{column_name}={column_texts[column]}"
    p = interaction_p(cells, has_blocks=True)
    deviation = float(residuals[row, column])
    return Factors(metric.name, metric.unit, len(common_seeds), marginals, largest, deviation, p)


def _values_by_cell(
    results: Results, metric: Metric, row_key: str, column_key: str
) -> dict[tuple[str, str], dict[int, float]]:
    """The known values by (row, column) as texts, and by seed.

    An event that never happened counts as the duration of the shortest runs.
    """
    by_cell = {}
    horizon = min(results.duration(name) for name in results.variants)
    for variant in results.plan.variants:
        values = results.metric(metric, variant.name)
        if metric.is_time_to_event:
            values = restricted(values, horizon)
        seeds = map(int, results.seeds(variant.name))
        cell = shown(variant.values[row_key]), shown(variant.values[column_key])
        by_cell[cell] = {
            seed: value
            for seed, value in zip(seeds, values.tolist(), strict=True)
            if not math.isnan(value)
        }
    return by_cell


def _marginals(name: str, texts: Sequence[str], means: Array) -> list[Marginal]:
    """The effect of each value of a key; `means` (values, seeds), with intervals over seeds."""
    return [
        Marginal(name, text, float(values.mean()), mean_interval(values))
        for text, values in zip(texts, means, strict=True)
    ]
