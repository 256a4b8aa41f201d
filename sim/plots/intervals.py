"""Pictures of metrics run by run, and of the differences between variants, with intervals.

A variant is one point of a parameter sweep. Each variant is a row of a picture; in `curve_figure`
each variant is a value on the horizontal axis. A single variant with many metrics gives a table.
`fit` removes the texts with the gid NOTE (titles, explanations) from a figure for a paper.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.core.numbers import finite_number
from swarmd.core.values import Array
from swarmd.sim.experiments.compare import Difference
from swarmd.sim.experiments.statistics import (
    Interval,
    Summary,
    summarize,
)
from swarmd.sim.plots.bands import paint_target
from swarmd.sim.plots.theme import (
    GUIDE_COLOUR,
    VARIANT_COLOURS,
    explained,
    finite,
    grid_of,
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
_FEWEST_ON_SCALE = 3  # rows that are placed by their values
_LONGEST = 3.0  # times the height of rows at equal distances
_TITLE = 20  # characters of a line of a title


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One metric in a figure, for all variants."""

    label: str
    quantity: str = ""  # panels of the same quantity have the same axis
    unit: str = ""
    values: Mapping[str, Sequence[float | None] | Array]
    """The value of each run, by variant; None if a run has no value."""
    target: float | None = None  # the value of a dashed line
    is_share: bool = False  # the values are 0 or 1, and their mean is a share of the runs
    is_time_to_event: bool = False  # None means that the event never happened


def intervals_figure(
    panels: Sequence[Panel], title: str = "", *, width: float | None = None, axis: str = ""
) -> Figure:
    """A figure with a panel for each metric and a row for each variant.

    A row has a point for every run, and above the points the mean as a diamond with its 95 %
    interval (Wilson's interval if the mean is a share). If an event never happened in some runs,
    the median of all runs stands in place of the mean. If the variants are numbers, the distances
    of the rows are the distances of the numbers. `width`: in inches, for a paper. `axis`: the name
    of the rows. SwarmError without panels.
    """
    runs = _runs_of(panels)
    labels = [_row_label(*item) for item in runs.items()]
    rows = rows_of([*runs])
    figure, grid = grid_of_panels(len(panels), labels, width, rows)
    for axes, panel in zip(grid, panels, strict=True):
        _paint_panel(axes, panel, runs, rows)
    _share_scales(grid, panels)
    _name_rows(grid, axis, rows)
    return explained(figure, title, _explanation(panels), width)


@dataclass(frozen=True, slots=True)
class PanelRows:
    """The vertical places (variants,) of the rows: the distance from the first row, in rows.

    `is_log`: the distances are those of the logarithms of the variants' values.
    """

    places: Sequence[float]
    is_log: bool = False


def rows_of(names: Sequence[str]) -> PanelRows:
    """The places of rows for variants `names`: on a scale if the names are rising numbers.

    On a scale, the distances of rows are proportional to the differences of the numbers, and the
    two closest rows are one row apart. If the figure would be too long, the logarithms of the
    numbers are taken in place of the numbers. Without a scale, all distances are one row: if the
    figure would still be too long, if the names are not rising numbers, or if there are fewer than
    _FEWEST_ON_SCALE rows.
    """
    equal = PanelRows(range(len(names)))
    values = np.array([finite_number(name) for name in names])
    if len(names) < _FEWEST_ON_SCALE or not (np.diff(values) > 0.0).all():  # NaN: not a number
        return equal
    scales = (False, True) if values[0] > 0.0 else (False,)  # only numbers above 0 have logarithms
    for is_log in scales:
        scaled = np.log(values) if is_log else values
        places = (scaled - scaled[0]) / np.diff(scaled).min()
        if places[-1] <= _LONGEST * (len(names) - 1):
            return PanelRows(places.tolist(), is_log)
    return equal


def _runs_of(panels: Sequence[Panel]) -> dict[str, int]:
    """The number of runs of each variant, in the panel with the most runs of this variant.

    The variants are in the order of `in_order`. SwarmError without panels.
    """
    if not panels:
        raise SwarmError("no metric has values: nothing to draw")
    runs: dict[str, int] = {}
    for panel in panels:
        for name, values in panel.values.items():
            runs[name] = max(runs.get(name, 0), len(values))
    return {name: runs[name] for name in in_order(runs)}


def grid_of_panels(
    count: int, labels: Sequence[str], width: float | None, places: PanelRows
) -> tuple[Figure, list[Axes]]:
    """A new figure with a grid of `count` panels; returns the figure and the axes of the panels.

    `labels`: the labels of the rows in each panel, shown at the left of the grid. `places`: the
    places of these rows. `width`: in inches, for a paper, or None. All sizes here are in inches.
    """
    labels_width = 0.3 + 0.07 * max(map(len, labels))
    columns = min(count, 3)
    if width is not None:
        labels_width *= 0.8
        columns = max(1, min(count, int((width - labels_width) / _NARROWEST)))
    lines = -(-count // columns)  # rounded up
    panel_height = 0.85 + max(0.42 * (places.places[-1] + 1.0), 0.6)
    if width is None:
        figure = new_figure(labels_width + 3.4 * columns, panel_height * lines + 0.7)
    else:
        figure = new_figure(width, 0.8 * panel_height * lines + 0.1)
    return figure, grid_of(figure, count, lines, columns, sharey=True)


def prepare_rows(axes: Axes, labels: Sequence[str], rows: PanelRows) -> None:
    """Name the rows of a panel, from above."""
    tidy(axes)
    axes.spines["left"].set_visible(False)
    axes.grid(axis="y", visible=False)
    axes.set_yticks(rows.places, labels, fontsize=9)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(rows.places[-1] + 0.5, rows.places[0] - 0.6)


def _name_rows(grid: Sequence[Axes], axis: str, rows: PanelRows) -> None:
    note = ", on a log scale" if rows.is_log else ""
    for axes in grid if axis else ():
        if axes.get_subplotspec().is_first_col():  # type: ignore[union-attr]
            axes.set_ylabel(f"{axis}{note}", fontsize=9)


def _row_label(name: str, runs: int) -> str:
    return f"{name} (n = {runs})" if name else f"n = {runs}"


def _paint_panel(axes: Axes, panel: Panel, runs: Mapping[str, int], rows: PanelRows) -> None:
    prepare_rows(axes, [_row_label(*item) for item in runs.items()], rows)
    if panel.target is not None:
        axes.axvline(panel.target, color=GUIDE_COLOUR, linestyle=(0, (5, 3)), linewidth=1.1)
    colours = [colour for colour, _ in variant_styles([*runs])]
    for name, row, colour in zip(runs, rows.places, colours, strict=True):
        values = np.array(panel.values.get(name, ()), dtype=np.float64)  # None gives NaN
        _paint_strip(axes, values, row, panel, colour)
    target = "" if panel.target is None else f"target {panel.target:g}"
    axes.set_title(panel.label, fontsize=9.5, loc="left")
    axes.set_xlabel(", ".join(word for word in (_unit_of(panel), target) if word), fontsize=9)


def _unit_of(panel: Panel) -> str:
    return "share of runs" if panel.is_share else panel.unit


def _groups(grid: Sequence[Axes], panels: Sequence[Panel]) -> list[list[tuple[Axes, Panel]]]:
    """The panels that have one axis: those of one quantity and unit."""
    groups: dict[object, list[tuple[Axes, Panel]]] = {}
    for index, (axes, panel) in enumerate(zip(grid, panels, strict=False)):
        key = (panel.quantity, panel.unit) if panel.quantity else index
        groups.setdefault(key, []).append((axes, panel))
    return list(groups.values())


def _share_scales(grid: Sequence[Axes], panels: Sequence[Panel]) -> None:
    """Set ticks and limits of the horizontal axes; panels of one quantity get the same limits."""
    for group in _groups(grid, panels):
        known = np.concatenate([finite(values) for _, p in group for values in p.values.values()])
        is_share = group[0][1].is_share
        is_count = known.size > 0 and not is_share and bool((known == np.round(known)).all())
        low = min(axes.get_xlim()[0] for axes, _ in group)
        high = max(axes.get_xlim()[1] for axes, _ in group)
        is_same = known.size > 0 and np.ptp(known) <= 1e-3 * np.abs(known).max()
        for axes, _ in group:
            axes.locator_params(axis="x", nbins=6, integer=is_count)
            if is_share:
                axes.set_xlim(-0.05, 1.05)
            elif is_same:  # no differences to show
                axes.set_xlim(known.min() - 1.0, known.max() + 1.0)
                axes.set_xticks([known[0]], [f"{known[0]:.4g}"])
            elif len(group) > 1:
                axes.set_xlim(low, high)


def curve_figure(
    panels: Sequence[Panel], title: str = "", *, width: float | None = None, axis: str = ""
) -> Figure:
    """A figure of metrics over a swept number: the variants are named by its values.

    Each metric has a panel with a point for every run, and a line through the means with their 95 %
    intervals. If an event never happened in some runs, the median of all runs stands in place of
    the mean. `axis`: the name of the swept number. `width`: in inches, for a paper. SwarmError
    without panels, with fewer than two variants, or if the name of a variant is not a number.
    """
    names = [*_runs_of(panels)]
    values = np.array([finite_number(name) for name in names])
    if not np.isfinite(values).all() or len(values) < 2:
        raise SwarmError("a curve needs at least two values of one swept number")
    figure, grid = _grid_of_curves(len(panels), width)
    is_log = rows_of(names).is_log  # the horizontal axis has the scale of the rows of other figures
    for axes, panel in zip(grid, panels, strict=True):
        _paint_curve(axes, panel, dict(zip(names, values.tolist(), strict=True)))
        if is_log:
            axes.set_xscale("log")
            axes.set_xticks(values, names)
            axes.minorticks_off()
        axes.set_xlabel(axis, fontsize=9)
    _share_heights(grid, panels)
    return explained(figure, title, _explanation(panels), width)


def _grid_of_curves(count: int, width: float | None) -> tuple[Figure, list[Axes]]:
    """A new figure with a grid of `count` panels; returns the figure and the axes of the panels.

    `width`: in inches, for a paper, or None. All sizes here are in inches.
    """
    columns = min(count, 3)
    if width is not None:
        columns = max(1, min(columns, int(width / _NARROWEST)))
    lines = -(-count // columns)  # rounded up
    if width is None:  # below the panels is the explanation
        figure = new_figure(3.6 * columns, 2.7 * lines + 0.5)
    else:  # in a paper the height of a panel is 0.72 of its width
        figure = new_figure(width, 0.72 * width / columns * lines + 0.1)
    return figure, grid_of(figure, count, lines, columns)


def _share_heights(grid: Sequence[Axes], panels: Sequence[Panel]) -> None:
    """Set the limits of the vertical axes; panels of one quantity get the same limits."""
    for group in _groups(grid, panels):
        low = min(axes.get_ylim()[0] for axes, _ in group)
        high = max(axes.get_ylim()[1] for axes, _ in group)
        for axes, panel in group:
            if panel.is_share:
                axes.set_ylim(-0.05, 1.05)
            else:
                axes.set_ylim(low, high)


def _paint_curve(axes: Axes, panel: Panel, x_of: Mapping[str, float]) -> None:
    """Paint the runs of a metric, and a line through the means, with intervals.

    `x_of`: the swept number of each variant, by its name. A hollow diamond is a median, in place of
    the mean if an event never happened in some runs.
    """
    tidy(axes)
    colour = VARIANT_COLOURS[0]
    line: list[tuple[float, float]] = []
    for name, x in x_of.items():
        values = np.array(panel.values.get(name, ()), dtype=np.float64)  # None gives NaN
        middle = _paint_runs_at(axes, x, values, panel, colour)
        line.append((x, np.nan if middle is None else middle))
    axes.plot(*np.array(line).T, color=colour, linewidth=1.2, zorder=2.5)
    if panel.target is not None:
        paint_target(axes, panel.target)
    axes.margins(0.08)
    axes.set_title(fill(panel.label, _TITLE), fontsize=9.5, loc="left")
    axes.set_ylabel(_unit_of(panel), fontsize=9)


def _paint_runs_at(axes: Axes, x: float, values: Array, panel: Panel, colour: str) -> float | None:
    """Paint the runs (n,) of a variant as points at `x`, with interval and mean or median.

    Returns the mean or median; None without a value.
    """
    summary = summarize(values, is_share=panel.is_share, is_time_to_event=panel.is_time_to_event)
    known = finite(values)
    axes.scatter(np.full(known.size, x), known, s=11.0, color=colour, alpha=0.35,
                 linewidths=0.0, zorder=2.0)  # fmt: skip
    bounds = _interval_of(summary, panel)
    if bounds is not None:
        axes.plot([x, x], [bounds.low, bounds.high], color=colour, linewidth=2.0, zorder=3.0)
    is_median = bool(summary.never)
    middle = summary.median if is_median else summary.mean
    if middle is not None:
        axes.scatter([x], [middle], s=26.0, marker="D", edgecolors=colour, clip_on=False,
                     zorder=4.0, color="white" if is_median else colour)  # fmt: skip
    return middle


def _interval_of(summary: Summary, panel: Panel) -> Interval | None:
    return summary.share_interval if panel.is_share else summary.mean_interval


def _paint_strip(axes: Axes, values: Array, row: float, panel: Panel, colour: str) -> None:
    """Paint the runs of one variant as points, and above the points their mean and its interval.

    `values`: (n,) of the runs. `row`: the vertical place. A hollow diamond is the median, which
    replaces the mean if an event never happened in some runs. A text gives the number of runs
    without a value.
    """
    # Rows count downwards (`prepare_rows`): a smaller place is higher.
    points_row = row + 0.13
    interval_row = row - 0.22
    text_row = row - 0.3
    place_by_row = axes.get_yaxis_transform()  # of texts: x as a share of the width, y in rows
    summary = summarize(values, is_share=panel.is_share, is_time_to_event=panel.is_time_to_event)
    never = f"{summary.never} of {values.size} never" if summary.never else ""
    if summary.n == 0:
        axes.text(0.5, row, never or "no value", transform=place_by_row, ha="center", va="center",
                  fontsize=8, color=GUIDE_COLOUR)  # fmt: skip
        return
    known = finite(values)
    axes.scatter(known, points_row + _spread(known.size), s=13.0, color=colour, alpha=0.45,
                 linewidths=0.0, zorder=2.0)  # fmt: skip
    bounds = _interval_of(summary, panel)
    if bounds is not None:
        axes.plot([bounds.low, bounds.high], [interval_row] * 2, color=colour, linewidth=2.4,
                  zorder=3.0)  # fmt: skip
    if summary.never and summary.median is not None:
        axes.scatter([summary.median], [interval_row], s=34.0, marker="D", color="white",
                     edgecolors=colour, linewidths=1.2, zorder=4.0)  # fmt: skip
    elif not summary.never and summary.mean is not None:
        axes.scatter([summary.mean], [interval_row], s=34.0, marker="D", color=colour,
                     edgecolors="white", linewidths=0.7, zorder=4.0)  # fmt: skip
    if summary.n < values.size:
        without = never or f"{values.size - summary.n} without"
        axes.text(1.0, text_row, without, transform=place_by_row,
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
    """By "VARIANT - FIRST", the labels of both variants."""


def differences_figure(
    panels: Sequence[DifferencePanel],
    title: str = "",
    *,
    width: float | None = None,
    axis: str = "",
) -> Figure:
    """A figure of the differences of each further variant from the first variant.

    Each metric has a panel, and each further variant a row: the difference of means with its 95 %
    interval. The point is filled if the interval excludes 0. `width`: in inches, for a paper.
    `axis`: the name of the rows. SwarmError without panels.
    """
    if not panels:
        raise SwarmError("no metric has differences: nothing to draw")
    names = list(dict.fromkeys(name for panel in panels for name in panel.of))
    rows = _rows_of_further(_variants_of(names))
    figure, grid = grid_of_panels(len(panels), names, width, rows)
    for axes, panel in zip(grid, panels, strict=True):
        _paint_differences(axes, panel, names, rows)
    _name_rows(grid, axis, rows)
    # All differences are paired, or none: `compare` decides by the seeds of the experiments.
    is_paired = any(d.is_paired for panel in panels for d in panel.of.values())
    method = "paired by seed" if is_paired else "independent samples"
    note = f"difference of means with its 95 % interval, {method}; filled: the interval excludes 0"
    return explained(figure, title, note, width)


def _rows_of_further(variants: Sequence[str]) -> PanelRows:
    """The rows of all variants but the first, which is placed on the scale but has no row."""
    all_rows = rows_of(variants)
    _, first_place, *further_places = all_rows.places
    places = [place - first_place for place in (first_place, *further_places)]
    return PanelRows(places, all_rows.is_log)


def _variants_of(names: Sequence[str]) -> list[str]:
    """The labels of the first variant and of each further variant, from "VARIANT - FIRST"."""
    pairs = [name.split(" - ", 1) for name in names]
    return [pairs[0][-1], *(pair[0] for pair in pairs)]


def _paint_differences(
    axes: Axes, panel: DifferencePanel, names: Sequence[str], rows: PanelRows
) -> None:
    prepare_rows(axes, names, rows)
    axes.axvline(0.0, color=GUIDE_COLOUR, linewidth=1.0, zorder=1.8)
    # Of the variant that is compared, as in the other figures; the first variant has no row.
    colours = [colour for colour, _ in variant_styles(_variants_of(names))][1:]
    for name, row, colour in zip(names, rows.places, colours, strict=True):
        result = panel.of.get(name)
        if result is None or result.difference is None:
            text = "-" if result is None else result.conclusion
            axes.text(0.5, row, text, transform=axes.get_yaxis_transform(),
                      ha="center", va="center", fontsize=8, color=GUIDE_COLOUR)  # fmt: skip
            continue
        if result.interval is not None:
            bounds = [result.interval.low, result.interval.high]
            axes.plot(bounds, [row] * 2, color=colour, linewidth=2.0)
        axes.scatter([result.difference], [row], s=34.0, marker="D", zorder=4.0, linewidths=1.2,
                     color=colour if result.differs else "white", edgecolors=colour)  # fmt: skip
    axes.margins(x=0.12)
    axes.locator_params(axis="x", nbins=5)
    axes.set_title(panel.label, fontsize=9.5, loc="left")
    axes.set_xlabel(panel.unit, fontsize=9)
