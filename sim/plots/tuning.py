"""The figure of a tuning: the metric over each parameter, with its importance."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from swarmd.sim.plots.theme import GUIDE_COLOUR, VARIANT_COLOURS, new_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from swarmd.sim.experiments.tune import Candidate, Tuning
    from swarmd.sim.metrics.catalog import Metric

_COLUMNS = 3
_LINE = 24  # characters along an axis
_PRESENT, _BEST, _OUT = VARIANT_COLOURS[5], VARIANT_COLOURS[1], GUIDE_COLOUR


def draw_landscape(tuning: Tuning, path: Path) -> Path:
    """Draw a panel for each parameter, with the mean of each candidate; returns the path.

    The horizontal axis has the values of the parameter, the vertical axis the metric. The best
    candidate and the present values have colours. A small pale point is a candidate that ended
    early, whose mean is extrapolated.
    """
    space = tuning.space
    rows = -(-len(space.parameters) // _COLUMNS)
    columns = min(len(space.parameters), _COLUMNS)
    figure = new_figure(3.4 * columns, 2.8 * rows)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes, parameter in zip(grid.flat, space.parameters, strict=False):
        for candidate in tuning.candidates:
            if parameter.name in candidate.values:  # present values out of range are left out
                x = parameter.number_of(candidate.values[parameter.name])
                _paint_candidate(axes, candidate, x, tuning)
        if parameter.choices:
            axes.set_xticks(range(len(parameter.choices)), list(map(str, parameter.choices)))
        else:
            low, high = parameter.low, parameter.high
            left_margin = right_margin = 0.03 * (high - low)
            if parameter.is_log:
                axes.set_xscale("log")
                left_margin, right_margin = 0.1 * low, 0.1 * high
            left, right = axes.get_xlim()  # present values may be outside of the range
            axes.set_xlim(min(left, low - left_margin), max(right, high + right_margin))
        share = tuning.importance.get(parameter.key)
        importance = "" if share is None else f"\nimportance {share:.0%}"
        unit = f" [{parameter.unit}]" if parameter.unit else ""
        axes.set_xlabel(f"{parameter.name}{unit}{importance}")
    for axes in grid.flat[len(space.parameters) :]:
        axes.set_axis_off()
    for axes in grid[:, 0]:
        axes.set_ylabel(_label(tuning.metric))
    # The marks mean the same in all panels, so the first panel gives the legend.
    handles, labels = grid.flat[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside upper center", ncols=2)
    return save(figure, path)


def _paint_candidate(axes: Axes, candidate: Candidate, x: float, tuning: Tuning) -> None:
    """Paint the mean of a candidate at the value `x` of a parameter."""
    colour, size, label = _OUT, 3 if candidate.is_out else 5, None
    if candidate.number == 0:
        colour, label = _PRESENT, "present"
    if candidate is tuning.best:  # the present values may be the best
        colour, size, label = _BEST, 8, "tuned"
    axes.plot(
        x,
        tuning.value(candidate),
        linestyle="none",
        marker="D" if candidate.number == 0 else "o",
        markersize=size,
        color=colour,
        alpha=0.5 if candidate.is_out else 1.0,
        label=label,
    )


def _label(metric: Metric) -> str:
    """The label of the axis of a metric: words and unit, on lines as long as the axis."""
    unit = f" [{metric.unit}]" if metric.unit else ""
    return textwrap.fill(metric.name.replace("_", " ") + unit, _LINE, break_long_words=False)
