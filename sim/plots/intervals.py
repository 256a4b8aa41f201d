"""Pictures of metrics run by run, and of the differences between variants, with intervals.

Variants are the rows of a picture, and with `curve_figure` the values along its axis. A single
variant with many metrics is a table.
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
    NOTHING,
    Interval,
    Summary,
    interval,
    number,
    summarize,
)
from swarmd.sim.plots.bands import paint_target
from swarmd.sim.plots.theme import (
    GUIDE_COLOUR,
    NOTE,
    VARIANT_COLOURS,
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
_MAX_STRIPS = 3  # metrics of a single variant that are drawn run by run; more are a table
_FEWEST_ON_SCALE = 3  # rows that are placed by their values
_LONGEST = 3.0  # times the height of rows at equal distances
_TABLE_ROW, _TABLE_WIDTH = 0.26, 8.2  # inches
_TITLE = 20  # characters of a line of a title
_SMALL = 7.5  # points of a table, which `fit` makes smaller
_PAPER_ROW = 0.75  # of the height of a row


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """A metric in a picture: `values` of each variant's runs, None where a run has none.

    `is_share`: the values are 0 or 1, and their mean is a share of the runs. `is_time_to_event`:
    None means that the event never happened. Panels of the same `quantity` have the same axis.
    """

    label: str
    quantity: str = ""
    unit: str = ""
    values: Mapping[str, Sequence[float | None] | Array]
    target: float | None = None
    is_share: bool = False
    is_time_to_event: bool = False


def intervals_figure(
    panels: Sequence[Panel], title: str = "", *, width: float | None = None, axis: str = ""
) -> Figure:
    """A picture of metrics by variant.

    One panel a metric, one row a variant: a point for every run, above them the mean as a diamond
    with its 95 % interval (of a share: Wilson's). Times to an event that never happened in some
    runs have the median of all runs instead. Rows of numbers stand at their value. One variant
    with more than three metrics is a table. `width`: in inches, for a paper. `axis` names the rows.
    SwarmError if there is nothing to draw.
    """
    runs = _runs_of(panels)
    if len(runs) == 1 and len(panels) > _MAX_STRIPS:
        return _table_figure(panels, title, width)
    labels = [_row_label(*item) for item in runs.items()]
    rows = rows_of([*runs])
    figure, grid = grid_of_panels(len(panels), labels, width, rows)
    for axes, panel in zip(grid, panels, strict=True):
        _paint_panel(axes, panel, runs, rows)
    _share_scales(grid, panels)
    _name_rows(grid, axis, rows)
    figure.suptitle(title, fontsize=11, gid=NOTE)
    figure.supxlabel(_explanation(panels), fontsize=8, color=GUIDE_COLOUR, gid=NOTE)
    return fit(figure, width)


@dataclass(frozen=True, slots=True)
class PanelRows:
    """Where the rows of variants stand: `places` (variants,), in rows below the first one.

    `is_log`: places are logarithms of the values.
    """

    places: Sequence[float]
    is_log: bool = False


def rows_of(names: Sequence[str]) -> PanelRows:
    """Rows at the values of variants that are rising numbers; else at equal distances.

    The closest two are one row apart. Where this would make a long figure, the logarithms of the
    values are tried, then equal distances. Two rows are always next to each other.
    """
    equal = PanelRows(range(len(names)))
    values = np.array([finite_number(name) for name in names])
    if len(names) < _FEWEST_ON_SCALE or not (np.diff(values) > 0.0).all():  # NaN: not a number
        return equal
    for is_log in (False, True) if values[0] > 0.0 else (False,):
        scaled = np.log(values) if is_log else values
        places = (scaled - scaled[0]) / np.diff(scaled).min()
        if places[-1] <= _LONGEST * (len(names) - 1):
            return PanelRows(places.tolist(), is_log)
    return equal


def _runs_of(panels: Sequence[Panel]) -> dict[str, int]:
    """The most runs of each variant in a panel, by its name in order; SwarmError without panels."""
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
    """A figure of so many panels, side by side as far as it is wide enough; one row a label.

    Its rows are named only at the left.
    """
    aside = 0.3 + 0.07 * max(map(len, labels))
    columns = min(count, 3)
    if width is not None:
        aside *= 0.8
        columns = max(1, min(count, int((width - aside) / _NARROWEST)))
    rows = -(-count // columns)
    height = 0.85 + max(0.42 * (places.places[-1] + 1.0), 0.6)
    if width is None:
        figure = new_figure(aside + 3.4 * columns, height * rows + 0.7)
    else:
        figure = new_figure(width, 0.8 * height * rows + 0.1)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes in grid.flat[count:]:
        axes.remove()
    return figure, list(grid.flat[:count])


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
    """Ticks and limits of each panel; panels of one quantity have the same."""
    for group in _groups(grid, panels):
        known = np.concatenate([_finite(values) for _, p in group for values in p.values.values()])
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


def _finite(values: Sequence[float | None] | Array) -> Array:
    numbers = np.array(values, dtype=np.float64)  # None gives NaN
    known: Array = numbers[np.isfinite(numbers)]
    return known


def curve_figure(
    panels: Sequence[Panel], title: str = "", *, width: float | None = None, axis: str = ""
) -> Figure:
    """A picture of metrics over the numbers that are the names of the variants.

    One panel a metric: a point for every run, the means with their 95 % intervals, joined by a
    line; times to an event as in `intervals_figure`. `axis` names the numbers. `width`: in inches,
    for a paper. SwarmError if there is nothing to draw, or if a name is not a number.
    """
    runs = _runs_of(panels)
    names = [*runs]
    at = np.array([finite_number(name) for name in names])
    if not np.isfinite(at).all() or len(at) < 2:  # a line needs two
        raise SwarmError("a curve needs at least two values of one swept number")
    columns = min(len(panels), 3)
    if width is not None:
        columns = max(1, min(columns, int(width / _NARROWEST)))
    lines = -(-len(panels) // columns)
    across, high = (3.6 * columns, 2.7) if width is None else (width, 0.72 * width / columns)
    figure = new_figure(across, high * lines + (0.5 if width is None else 0.1))
    grid = figure.subplots(lines, columns, squeeze=False)
    is_log = rows_of(names).is_log
    for axes, panel in zip(grid.flat, panels, strict=False):
        _paint_curve(axes, panel, dict(zip(names, at.tolist(), strict=True)))
        if is_log:
            axes.set_xscale("log")
            axes.set_xticks(at, names)
            axes.minorticks_off()
        axes.set_xlabel(axis, fontsize=9)
    for group in _groups(list(grid.flat), panels):
        low = min(axes.get_ylim()[0] for axes, _ in group)
        high = max(axes.get_ylim()[1] for axes, _ in group)
        for axes, panel in group:
            axes.set_ylim(*((-0.05, 1.05) if panel.is_share else (low, high)))
    for axes in grid.flat[len(panels) :]:
        axes.remove()
    figure.suptitle(title, fontsize=11, gid=NOTE)
    figure.supxlabel(_explanation(panels), fontsize=8, color=GUIDE_COLOUR, gid=NOTE)
    return fit(figure, width)


def _paint_curve(axes: Axes, panel: Panel, at: Mapping[str, float]) -> None:
    tidy(axes)
    colour = VARIANT_COLOURS[0]
    means: list[tuple[float, float]] = []
    for name, x in at.items():
        values = np.array(panel.values.get(name, ()), dtype=np.float64)  # None gives NaN
        found = summarize(values, is_share=panel.is_share, is_time_to_event=panel.is_time_to_event)
        finite = values[np.isfinite(values)]
        axes.scatter(np.full(finite.size, x), finite, s=11.0, color=colour, alpha=0.35,
                     linewidths=0.0, zorder=2.0)  # fmt: skip
        bounds = _interval_of(found, panel)
        if bounds is not None:
            axes.plot([x, x], [bounds.low, bounds.high], color=colour, linewidth=2.0, zorder=3.0)
        middle = found.median if found.never else found.mean
        means.append((x, np.nan if middle is None else middle))
        if middle is not None:
            axes.scatter([x], [middle], s=26.0, marker="D", edgecolors=colour, clip_on=False,
                         zorder=4.0,
                         color="white" if found.never else colour)  # fmt: skip
    axes.plot(*np.array(means).T, color=colour, linewidth=1.2, zorder=2.5)
    if panel.target is not None:
        paint_target(axes, panel.target)
    axes.margins(0.08)
    axes.set_title(fill(panel.label, _TITLE), fontsize=9.5, loc="left")
    axes.set_ylabel(_unit_of(panel), fontsize=9)


def _interval_of(found: Summary, panel: Panel) -> Interval | None:
    return found.share_interval if panel.is_share else found.mean_interval


def _table_figure(panels: Sequence[Panel], title: str, width: float | None) -> Figure:
    """The metrics of one variant as the rows of a table; for a paper without median and range."""
    columns = ["metric", "mean", "95 % interval", "median", "range", "runs"]
    shares = [0.36, 0.11, 0.19, 0.11, 0.15, 0.08]
    from matplotlib.transforms import Bbox

    rows = [_table_row(panel) for panel in panels]
    if width is not None:
        kept = slice(0, 3)
        columns, rows, shares = columns[kept], [row[kept] for row in rows], [0.57, 0.14, 0.29]
    height = _TABLE_ROW * (len(rows) + 1) * (1.0 if width is None else _PAPER_ROW)

    figure = new_figure(width or _TABLE_WIDTH, height)
    axes = figure.subplots()
    axes.set_axis_off()
    table = axes.table(rows, colLabels=columns, colWidths=shares, bbox=Bbox.unit(),
                       edges="horizontal", cellLoc="left", colLoc="left")  # fmt: skip
    table.auto_set_font_size(value=False)
    table.set_fontsize(9 if width is None else _SMALL)
    for (row, _), cell in table.get_celld().items():
        cell.PAD = 0.02
        cell.set_edgecolor("0.3" if row == 0 else "0.85")
        cell.set_linewidth(0.6)
    axes.set_title(title, fontsize=11, loc="left", gid=NOTE)
    return fit(figure, width)


def _table_row(panel: Panel) -> list[str]:
    """The cells of a metric; a target stands behind the unit."""
    (values,) = panel.values.values()
    numbers = np.array(values, dtype=np.float64)  # None gives NaN
    found = summarize(numbers, is_share=panel.is_share, is_time_to_event=panel.is_time_to_event)
    target = "" if panel.target is None else f", target {panel.target:g}"
    unit = f" [{_unit_of(panel)}]" if _unit_of(panel) else ""
    of_all = "" if found.n == numbers.size else f" of {numbers.size}"
    return [
        f"{panel.label}{unit}{target}",
        f"{found.never} of {numbers.size} never" if found.never else number(found.mean),
        interval(_interval_of(found, panel)),
        number(found.median),
        f"{number(found.min)} to {number(found.max)}" if found.n else NOTHING,
        f"{found.n}{of_all}",
    ]


def _paint_strip(axes: Axes, values: Array, row: float, panel: Panel, colour: str) -> None:
    """Points, mean and interval of one variant."""
    beside = axes.get_yaxis_transform()
    found = summarize(values, is_share=panel.is_share, is_time_to_event=panel.is_time_to_event)
    if found.n == 0:
        text = f"{found.never} of {values.size} never" if found.never else "no value"
        axes.text(0.5, row, text, transform=beside, ha="center", va="center", fontsize=8,
                  color=GUIDE_COLOUR)  # fmt: skip
        return
    finite = _finite(values)
    axes.scatter(finite, row + 0.13 + _spread(finite.size), s=13.0, color=colour, alpha=0.45,
                 linewidths=0.0, zorder=2.0)  # fmt: skip
    bounds = _interval_of(found, panel)
    if bounds is not None:
        axes.plot(
            [bounds.low, bounds.high], [row - 0.22] * 2, color=colour, linewidth=2.4, zorder=3.0
        )
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
    """A picture of the differences of means with their 95 % intervals; filled: 0 is excluded.

    One panel a metric, one row a variant. `width`: in inches, for a paper. `axis` names the rows.
    SwarmError if there is no difference.
    """
    if not panels:
        raise SwarmError("no metric has differences: nothing to draw")
    names = list(dict.fromkeys(name for panel in panels for name in panel.of))
    # The first variant has no row.
    variants = [names[0].split(" - ", 1)[-1], *(name.split(" - ", 1)[0] for name in names)]
    _, *places = (placed := rows_of(variants)).places
    rows = PanelRows([place - places[0] for place in places], placed.is_log)
    figure, grid = grid_of_panels(len(panels), names, width, rows)
    for axes, panel in zip(grid, panels, strict=True):
        _paint_differences(axes, panel, names, rows)
    _name_rows(grid, axis, rows)
    is_paired = any(one.is_paired for panel in panels for one in panel.of.values())
    how = "paired by seed" if is_paired else "independent samples"
    figure.suptitle(title, fontsize=11, gid=NOTE)
    note = f"difference of means with its 95 % interval, {how}; filled: the interval excludes 0"
    figure.supxlabel(note, fontsize=8, color=GUIDE_COLOUR, gid=NOTE)
    return fit(figure, width)


def _paint_differences(
    axes: Axes, panel: DifferencePanel, names: Sequence[str], rows: PanelRows
) -> None:
    prepare_rows(axes, names, rows)
    axes.axvline(0.0, color=GUIDE_COLOUR, linewidth=1.0, zorder=1.8)
    # Of the variant that is compared, as in the other figures; the first variant has no row.
    pairs = [name.split(" - ", 1) for name in names]
    variants = [pairs[0][-1], *(pair[0] for pair in pairs)]
    colours = [colour for colour, _ in variant_styles(variants)][1:]
    for name, row, colour in zip(names, rows.places, colours, strict=True):
        one = panel.of.get(name)
        if one is None or one.difference is None:
            beside = axes.get_yaxis_transform()
            axes.text(0.5, row, "-" if one is None else one.conclusion, transform=beside,
                      ha="center", va="center", fontsize=8, color=GUIDE_COLOUR)  # fmt: skip
            continue
        if one.interval is not None:
            axes.plot([one.interval.low, one.interval.high], [row] * 2, color=colour, linewidth=2.0)
        axes.scatter([one.difference], [row], s=34.0, marker="D", zorder=4.0, linewidths=1.2,
                     color=colour if one.differs else "white", edgecolors=colour)  # fmt: skip
    axes.margins(x=0.12)
    axes.locator_params(axis="x", nbins=5)
    axes.set_title(panel.label, fontsize=9.5, loc="left")
    axes.set_xlabel(panel.unit, fontsize=9)
