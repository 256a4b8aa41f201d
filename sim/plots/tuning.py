"""Figures of a tuning: the metric over each parameter, and the importance of parameters."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swarmd.sim.experiments.search_space import ParameterSpace
from swarmd.sim.plots.theme import GUIDE_COLOUR, VARIANT_COLOURS, new_figure, save

if TYPE_CHECKING:
    from swarmd.sim.experiments.tune import Tuning
    from swarmd.sim.metrics.catalog import Metric

_COLUMNS = 3
_LINE = 24  # characters along an axis
_PRESENT, _BEST, _OUT = VARIANT_COLOURS[5], VARIANT_COLOURS[1], GUIDE_COLOUR


def draw_tuning(found: Tuning, folder: Path) -> list[Path]:
    """Write the figures of a tuning, as far as there are values; returns the paths.

    SwarmError without matplotlib, or if a file cannot be written.
    """
    paths = []
    if isinstance(found.space, ParameterSpace):
        paths.append(draw_landscape(found, found.space, folder / "landscape.png"))
    if found.importance:
        paths.append(draw_importance(found, folder / "importance.png"))
    return paths


def draw_landscape(found: Tuning, space: ParameterSpace, path: Path) -> Path:
    """Draw the mean of each candidate over each parameter.

    A small point is a candidate that ended early, whose mean is extrapolated.
    """
    rows = -(-len(space.parameters) // _COLUMNS)
    columns = min(len(space.parameters), _COLUMNS)
    figure = new_figure(3.4 * columns, 2.8 * rows)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes, one in zip(grid.flat, space.parameters, strict=False):
        for candidate in found.candidates:
            value = found.value(candidate)
            if one.name not in candidate.values:
                continue
            best, present = candidate is found.best, candidate.number == 0
            axes.plot(
                one.number_of(candidate.values[one.name]),
                value,
                linestyle="none",
                marker="D" if present else "o",
                markersize=8 if best else 3 if candidate.is_out else 5,
                color=_BEST if best else _PRESENT if present else _OUT,
                alpha=0.5 if candidate.is_out else 1.0,
                label="tuned" if best else "present" if present else None,
            )
        if one.choices:
            axes.set_xticks(range(len(one.choices)), list(map(str, one.choices)))
        else:
            low, high = one.low, one.high
            edges = (0.03 * (low - high), 0.03 * (high - low))
            if one.is_log:
                axes.set_xscale("log")
                edges = (-0.1 * low, 0.1 * high)
            left, right = axes.get_xlim()  # present values may be outside of the range
            axes.set_xlim(min(left, low + edges[0]), max(right, high + edges[1]))
        share = found.importance.get(one.key)
        note = "" if share is None else f"\nimportance {share:.0%}"
        axes.set_xlabel(f"{one.name} [{one.unit}]{note}" if one.unit else f"{one.name}{note}")
    for axes in grid.flat[len(space.parameters) :]:
        axes.set_axis_off()
    for axes in grid[:, 0]:
        axes.set_ylabel(_label(found.metric))
    handles, labels = grid.flat[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside upper center", ncols=2)
    return save(figure, path)


def _label(metric: Metric) -> str:
    """Its words on lines as long as the axis, and its unit."""
    unit = f" [{metric.unit}]" if metric.unit else ""
    return textwrap.fill(metric.name.replace("_", " ") + unit, _LINE, break_long_words=False)


def draw_importance(found: Tuning, path: Path) -> Path:
    """The share of each parameter in what makes candidates good."""
    items = sorted(found.importance.items(), key=lambda item: item[1])
    figure = new_figure(6.0, 1.0 + 0.3 * len(items))
    axes = figure.subplots()
    axes.barh(np.arange(len(items)), [share for _, share in items], color=VARIANT_COLOURS[0])
    axes.set_yticks(np.arange(len(items)), [key for key, _ in items])
    axes.set_xlabel("importance (PED-ANOVA)")
    axes.set_xlim(0.0, 1.0)
    return save(figure, path)
