"""Pictures of metrics by variant: every run a point, their mean with its 95 % interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.core.values import Array
from swarmd.sim.experiments.statistics import mean_interval, wilson
from swarmd.sim.plots.theme import GUIDE_COLOUR, VARIANT_COLOURS, new_figure, save, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_READING = "a point: one run; diamond and bar: the mean and its 95 % interval"


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """A metric in a picture: `values` of each variant's runs, None where a run has none.

    `is_share`: the values are 0 or 1, so their mean is a share of the runs.
    """

    label: str
    unit: str = ""
    values: Mapping[str, Sequence[float | None]]
    target: float | None = None
    is_share: bool = False


def draw_intervals(panels: Sequence[Panel], path: Path, title: str = "") -> None:
    """Write a picture of metrics by variant: .png, .svg or .pdf, by its suffix.

    One panel a metric, one row a variant: a point for every run, above them the mean as a diamond
    with its 95 % interval (of a share: Wilson's). SwarmError if there is nothing to draw.
    """
    save(intervals_figure(panels, title), path)


def intervals_figure(panels: Sequence[Panel], title: str = "") -> Figure:
    """The picture that `draw_intervals` writes."""
    if not panels:
        raise SwarmError("no metric has values: nothing to draw")
    runs: dict[str, int] = {}
    for panel in panels:
        for name, values in panel.values.items():
            runs[name] = max(runs.get(name, 0), len(values))
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    aside = 0.3 + 0.07 * max(len(_row_label(*item)) for item in runs.items())
    height = 0.85 + max(0.42 * len(runs), 0.6)
    figure = new_figure(aside + 3.4 * columns, height * rows + (0.7 if title else 0.4))
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes, panel in zip(grid.flat, panels, strict=False):
        _paint_panel(axes, panel, runs)
    for axes in grid.flat[len(panels) :]:
        axes.remove()
    if title:
        figure.suptitle(title, fontsize=11)
    figure.supxlabel(_READING, fontsize=8, color=GUIDE_COLOUR)
    return figure


def _row_label(name: str, runs: int) -> str:
    return f"{name} (n = {runs})" if name else f"n = {runs}"


def _paint_panel(axes: Axes, panel: Panel, runs: Mapping[str, int]) -> None:
    tidy(axes)
    axes.spines["left"].set_visible(False)
    axes.grid(axis="y", visible=False)
    if panel.target is not None:
        axes.axvline(panel.target, color=GUIDE_COLOUR, linestyle=(0, (5, 3)), linewidth=1.1)
    for row, name in enumerate(runs):
        given = panel.values.get(name, ())
        values = np.array([np.nan if v is None else v for v in given], dtype=np.float64)
        _paint_strip(axes, values, row, VARIANT_COLOURS[row % len(VARIANT_COLOURS)],
                     is_share=panel.is_share)  # fmt: skip
    axes.set_yticks(range(len(runs)), [_row_label(*item) for item in runs.items()], fontsize=9)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(runs) - 0.5, -0.6)
    known = [v for values in panel.values.values() for v in values if v is not None]
    is_count = bool(known) and not panel.is_share and all(float(v).is_integer() for v in known)
    axes.locator_params(axis="x", nbins=6, integer=is_count)
    if panel.is_share:
        axes.set_xlim(-0.05, 1.05)
    elif known and min(known) == max(known):  # nothing to scale by
        axes.set_xlim(known[0] - 1.0, known[0] + 1.0)
        axes.set_xticks([known[0]])
    words = [
        "share of runs" if panel.is_share else panel.unit,
        "" if panel.target is None else f"target {panel.target:g}",
    ]
    axes.set_title(panel.label, fontsize=9.5, loc="left")
    axes.set_xlabel(", ".join(word for word in words if word), fontsize=9)


def _paint_strip(axes: Axes, values: Array, row: int, colour: str, *, is_share: bool) -> None:
    finite = values[np.isfinite(values)]
    if not finite.size:
        axes.text(0.5, row, "no value", transform=axes.get_yaxis_transform(), ha="center",
                  va="center", fontsize=8, color=GUIDE_COLOUR)  # fmt: skip
        return
    axes.scatter(finite, row + 0.13 + _spread(finite.size), s=13.0, color=colour, alpha=0.45,
                 linewidths=0.0, zorder=2.0)  # fmt: skip
    mean = float(finite.mean())
    interval = wilson(int(finite.sum()), finite.size) if is_share else mean_interval(finite)
    if interval is not None:
        axes.plot(
            [interval.low, interval.high], [row - 0.22] * 2, color=colour, linewidth=2.4, zorder=3.0
        )
    axes.scatter([mean], [row - 0.22], s=34.0, marker="D", color=colour, edgecolors="white",
                 linewidths=0.7, zorder=4.0)  # fmt: skip
    if finite.size < values.size:
        note = f"{values.size - finite.size} without"
        axes.text(1.0, row - 0.3, note, transform=axes.get_yaxis_transform(), ha="right",
                  va="bottom", fontsize=7.5, color=GUIDE_COLOUR)  # fmt: skip


def _spread(n: int) -> Array:
    """Offsets (n,) that keep points of one value apart: the golden ratio's even sequence."""
    return 0.3 * ((np.arange(n, dtype=np.float64) * 0.6180339887498949) % 1.0 - 0.5)
