"""Pictures of metrics run by run, and of the differences between variants, with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.core.values import Array
from swarmd.sim.experiments.compare import Difference
from swarmd.sim.experiments.statistics import summarize
from swarmd.sim.plots.theme import (
    GUIDE_COLOUR,
    NOTE,
    fit,
    in_order,
    new_figure,
    tidy,
    variant_styles,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_EXPLANATION = "point: one run; diamond and bar: the mean and its 95 % interval"
_NARROWEST = 1.6  # inches of a panel in a paper
_MEDIAN = "; hollow diamond: the median, where some runs never had the event"


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """A metric in a picture: `values` of each variant's runs, None where a run has none.

    `is_share`: the values are 0 or 1, and their mean is a share of the runs. `is_time_to_event`:
    None means that the event never happened.
    """

    label: str
    unit: str = ""
    values: Mapping[str, Sequence[float | None] | Array]
    target: float | None = None
    is_share: bool = False
    is_time_to_event: bool = False


def intervals_figure(
    panels: Sequence[Panel], title: str = "", *, width: float | None = None, axis: str = ""
) -> Figure:
    """A figure of metrics by variant, with a panel for each metric and a row for each variant.

    A row has a point for every run, and above the points the mean as a diamond with its 95 %
    interval (for a share Wilson's interval). For a time to an event that never happened in some
    runs, the median of all runs takes the place of the mean. `width`: in inches, for a paper.
    `axis`: the title of the rows. SwarmError without a panel.
    """
    if not panels:
        raise SwarmError("no metric has values: nothing to draw")
    runs: dict[str, int] = {}
    for panel in panels:
        for name, values in panel.values.items():
            runs[name] = max(runs.get(name, 0), len(values))
    runs = {name: runs[name] for name in in_order(runs)}
    labels = [_row_label(*item) for item in runs.items()]
    figure, grid = grid_of_panels(len(panels), labels, width)
    for axes, panel in zip(grid, panels, strict=True):
        _paint_panel(axes, panel, runs)
    _name_rows(grid, axis)
    figure.suptitle(title, fontsize=11, gid=NOTE)
    figure.supxlabel(_explanation(panels), fontsize=8, color=GUIDE_COLOUR, gid=NOTE)
    return fit(figure, width)


def grid_of_panels(
    count: int, labels: Sequence[str], width: float | None
) -> tuple[Figure, list[Axes]]:
    """A figure of `count` panels, as many side by side as its width allows.

    Each panel has a row for each of `labels`, which stand at the left of the figure alone.
    """
    aside = 0.3 + 0.07 * max(map(len, labels))
    columns = min(count, 3)
    if width is not None:
        aside *= 0.8
        columns = max(1, min(count, int((width - aside) / _NARROWEST)))
    rows = -(-count // columns)
    height = 0.85 + max(0.42 * len(labels), 0.6)
    if width is None:
        figure = new_figure(aside + 3.4 * columns, height * rows + 0.7)
    else:
        figure = new_figure(width, 0.8 * height * rows + 0.1)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes in grid.flat[count:]:
        axes.remove()
    return figure, list(grid.flat[:count])


def prepare_rows(axes: Axes, labels: Sequence[str]) -> None:
    """Name the rows of a panel, from above."""
    tidy(axes)
    axes.spines["left"].set_visible(False)
    axes.grid(axis="y", visible=False)
    axes.set_yticks(range(len(labels)), labels, fontsize=9)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(labels) - 0.5, -0.6)


def _name_rows(grid: Sequence[Axes], axis: str) -> None:
    for axes in grid if axis else ():
        if axes.get_subplotspec().is_first_col():  # type: ignore[union-attr]
            axes.set_ylabel(axis, fontsize=9)


def _row_label(name: str, runs: int) -> str:
    return f"{name} (n = {runs})" if name else f"n = {runs}"


def _paint_panel(axes: Axes, panel: Panel, runs: Mapping[str, int]) -> None:
    prepare_rows(axes, [_row_label(*item) for item in runs.items()])
    if panel.target is not None:
        axes.axvline(panel.target, color=GUIDE_COLOUR, linestyle=(0, (5, 3)), linewidth=1.1)
    colours = [colour for colour, _ in variant_styles([*runs])]
    for row, name in enumerate(runs):
        values = np.array(panel.values.get(name, ()), dtype=np.float64)  # None gives NaN
        _paint_strip(axes, values, row, panel, colours[row])
    known = [v for some in panel.values.values() for v in some if v is not None and v == v]
    is_count = bool(known) and not panel.is_share and all(float(v).is_integer() for v in known)
    axes.locator_params(axis="x", nbins=6, integer=is_count)
    if panel.is_share:
        axes.set_xlim(-0.05, 1.05)
    elif known and np.ptp(known) <= 1e-3 * np.abs(known).max():  # no differences to show
        axes.set_xlim(min(known) - 1.0, max(known) + 1.0)
        axes.set_xticks([known[0]], [f"{known[0]:.4g}"])
    words = [
        "share of runs" if panel.is_share else panel.unit,
        "" if panel.target is None else f"target {panel.target:g}",
    ]
    axes.set_title(panel.label, fontsize=9.5, loc="left")
    axes.set_xlabel(", ".join(word for word in words if word), fontsize=9)


def _paint_strip(axes: Axes, values: Array, row: int, panel: Panel, colour: str) -> None:
    """Points, mean and interval of one variant."""
    beside = axes.get_yaxis_transform()
    found = summarize(values, is_share=panel.is_share, is_time_to_event=panel.is_time_to_event)
    if found.n == 0:
        text = f"{found.never} of {values.size} never" if found.never else "no value"
        axes.text(0.5, row, text, transform=beside, ha="center", va="center", fontsize=8,
                  color=GUIDE_COLOUR)  # fmt: skip
        return
    finite = values[np.isfinite(values)]
    axes.scatter(finite, row + 0.13 + _spread(finite.size), s=13.0, color=colour, alpha=0.45,
                 linewidths=0.0, zorder=2.0)  # fmt: skip
    interval = found.share_interval if panel.is_share else found.mean_interval
    if interval is not None:
        ends = [interval.low, interval.high]
        axes.plot(ends, [row - 0.22] * 2, color=colour, linewidth=2.4, zorder=3.0)
    middle = found.median if found.never else found.mean
    if middle is not None:
        face, edge = ("white", colour) if found.never else (colour, "white")
        axes.scatter([middle], [row - 0.22], s=34.0, marker="D", color=face, edgecolors=edge,
                     linewidths=1.2 if found.never else 0.7, zorder=4.0)  # fmt: skip
    if found.n < values.size:
        text = f"{found.never} of {values.size} never" if found.never else ""
        axes.text(1.0, row - 0.3, text or f"{values.size - found.n} without", transform=beside,
                  ha="right", va="bottom", fontsize=7.5, color=GUIDE_COLOUR)  # fmt: skip


def _explanation(panels: Sequence[Panel]) -> str:
    has_never = any(
        value is None or np.isnan(value)
        for panel in panels
        if panel.is_time_to_event
        for values in panel.values.values()
        for value in values
    )
    return _EXPLANATION + (_MEDIAN if has_never else "")


def _spread(n: int) -> Array:
    """Offsets (n,) that separate points of one value: a low-discrepancy sequence (golden ratio)."""
    return 0.3 * ((np.arange(n, dtype=np.float64) * 0.6180339887498949) % 1.0 - 0.5)


@dataclass(frozen=True, slots=True)
class DifferencePanel:
    """A metric in a picture: its label, and the difference of each variant from the first."""

    label: str
    unit: str
    of: Mapping[str, Difference]


def differences_figure(
    panels: Sequence[DifferencePanel],
    title: str = "",
    *,
    width: float | None = None,
    axis: str = "",
) -> Figure:
    """A figure of differences of means with their 95 % intervals.

    A panel for each metric, a row for each variant. A filled diamond: the interval excludes 0.
    `width`: in inches, for a paper. `axis`: the title of the rows. SwarmError without a panel.
    """
    if not panels:
        raise SwarmError("no metric has differences: nothing to draw")
    rows = list(dict.fromkeys(name for panel in panels for name in panel.of))
    figure, grid = grid_of_panels(len(panels), rows, width)
    for axes, panel in zip(grid, panels, strict=True):
        _paint_differences(axes, panel, rows)
    _name_rows(grid, axis)
    is_paired = any(one.is_paired for panel in panels for one in panel.of.values())
    how = "paired by seed" if is_paired else "independent samples"
    figure.suptitle(title, fontsize=11, gid=NOTE)
    note = f"difference of means with its 95 % interval, {how}; filled: the interval excludes 0"
    figure.supxlabel(note, fontsize=8, color=GUIDE_COLOUR, gid=NOTE)
    return fit(figure, width)


def _paint_differences(axes: Axes, panel: DifferencePanel, rows: Sequence[str]) -> None:
    prepare_rows(axes, rows)
    axes.axvline(0.0, color=GUIDE_COLOUR, linewidth=1.0, zorder=1.8)
    # Of the variant that is compared, as in the other figures; the first variant has no row.
    pairs = [name.split(" - ", 1) for name in rows]
    variants = [pairs[0][-1], *(pair[0] for pair in pairs)]
    colours = [colour for colour, _ in variant_styles(variants)][1:]
    for row, name in enumerate(rows):
        one = panel.of.get(name)
        if one is None or one.difference is None:
            beside = axes.get_yaxis_transform()
            axes.text(0.5, row, "-" if one is None else one.conclusion, transform=beside,
                      ha="center", va="center", fontsize=8, color=GUIDE_COLOUR)  # fmt: skip
            continue
        colour = colours[row]
        if one.interval is not None:
            axes.plot([one.interval.low, one.interval.high], [row] * 2, color=colour, linewidth=2.0)
        axes.scatter([one.difference], [row], s=34.0, marker="D", zorder=4.0, linewidths=1.2,
                     color=colour if one.differs else "white", edgecolors=colour)  # fmt: skip
    axes.margins(x=0.12)
    axes.locator_params(axis="x", nbins=5)
    axes.set_title(panel.label, fontsize=9.5, loc="left")
    axes.set_xlabel(panel.unit, fontsize=9)
