"""Figures of metrics over time: the median over the runs, and bands around the median."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.core.values import Array
from swarmd.sim.experiments.statistics import wilson
from swarmd.sim.plots.theme import (
    GUIDE_COLOUR,
    NOTE,
    PALE,
    fit,
    in_order,
    new_figure,
    tidy,
    variant_styles,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

Series = tuple[Array, Array]
"""One run: increasing instants (T,) in s and values (T,), NaN without a value."""

MAX_INSTANTS = 600
MANY_RUNS = 20
"""From this number of runs on the wide band holds 95 % of the runs, else all runs."""
_ROUNDING = 1e-9
_TWO_COLUMNS = 5.0  # inches of a figure of a paper in which panels stand side by side
_MAX_OUTER = 3  # variants up to which wide bands are drawn
_MAX_INNER = 7  # variants up to which bands of half of the runs are drawn
_OWN_PANELS = 4  # variants that have a panel each


def series_figure(
    facets: Mapping[str, Mapping[str, Sequence[Series]]],
    *,
    label: str,
    unit: str = "",
    title: str = "",
    target: float | None = None,
    events: Sequence[tuple[float, str]] = (),
    smoothing: float = 0.0,
    width: float | None = None,
    legend_title: str = "",
) -> Figure:
    """A figure of a metric over time, with a panel for each facet.

    The line of a variant is the median of its runs. A dark band holds half of the runs. A pale band
    holds 95 % of the runs, or all if there are fewer than MANY_RUNS. Four variants of one facet
    have a panel each, with the medians of the others in grey, but not in a column of a paper. With
    many variants bands are left out. If all values are 0 or 1, the line is the share of runs at 1,
    and the band is the 95 % interval of this share.

    - `facets`: by panel, the runs of each variant. A variant has one colour in all panels.
    - `target`: the value of a dashed line.
    - `events`: times in s of dotted lines, with their labels.
    - `smoothing`: s of the running mean of each run.
    - `width`: in inches, for a paper.

    SwarmError without values.
    """
    # 1. The runs of each panel and variant that have values.
    smoothed_facets = {panel: _smoothed(variants, smoothing) for panel, variants in facets.items()}
    drawn = {panel: variants for panel, variants in smoothed_facets.items() if variants}
    runs_of_variants = [runs for variants in drawn.values() for runs in variants.values()]
    all_runs = [run for runs in runs_of_variants for run in runs]
    if not all_runs:
        raise SwarmError(f"{label}: no run has values over time: nothing to draw")
    is_share = is_yes_or_no(all_runs)

    # 2. The panels. If bands of one panel would cover each other, each variant has its own.
    legend = shown_legend = Legend.of(
        {name: len(runs) for name, runs in variants.items()} for variants in drawn.values()
    )
    behind: Mapping[str, Sequence[Series]] = {}
    is_column = width is not None and width < _TWO_COLUMNS
    if len(drawn) == 1 and len(legend.counts) == _OWN_PANELS and not is_column:
        (behind,) = drawn.values()
        drawn = {
            f"{legend_title} {legend.text(name)}".strip(): {name: behind[name]}
            for name in legend.counts
        }
        shown_legend = Legend({"": 0})
    figure, panels = new_series_figure(list(drawn), shown_legend, width)
    for axes, variants in zip(panels, drawn.values(), strict=True):
        for runs in behind.values():
            other = shares_of(runs) if is_share else bands_of(runs)
            axes.plot(other.t, other.middle, color="0.8", linewidth=1.0)
        for name, runs in variants.items():
            bands = shares_of(runs) if is_share else bands_of(runs)
            _paint_variant(axes, bands, legend.style(name), len(variants), legend.text(name))
        if target is not None:
            paint_target(axes, target)
        for time, event in events:
            _paint_event(axes, time, event)
        axes.margins(x=0.01)
        if is_count(all_runs) and not is_share:
            axes.locator_params(axis="y", integer=True)

    # 3. The texts.
    explanation = _explanation(runs_of_variants, len(shown_legend.counts), is_share=is_share)
    explanation += "; grey: the other medians" if behind else ""
    explanation += f"; running mean over {smoothing:g} s" if smoothing > 0.0 else ""
    text = f"{label}: share of runs" if is_share else f"{label} [{unit or '1'}]"
    return finish_series(
        figure, panels, text, title, explanation, shown_legend, width, legend_title
    )


@dataclass(frozen=True, slots=True)
class Legend:
    """The variants of a figure in order, and the number of runs of each in a panel."""

    counts: Mapping[str, int]

    @staticmethod
    def of(runs_by_panel: Iterable[Mapping[str, int]]) -> Legend:
        """The variants of all panels. `runs_by_panel`: the number of runs of each variant."""
        counts: dict[str, int] = {}
        for runs_of in runs_by_panel:
            for name, runs in runs_of.items():
                counts[name] = max(counts.get(name, 0), runs)
        return Legend({name: counts[name] for name in in_order(counts)})

    def style(self, name: str) -> tuple[str, str]:
        """The colour and the line style of a variant."""
        names = [*self.counts]
        return variant_styles(names)[names.index(name)]

    def text(self, name: str) -> str:
        """A variant's text in the legend."""
        return f"{name} (n = {self.counts[name]})" if name else f"n = {self.counts[name]}"


def new_series_figure(
    panels: Sequence[str], legend: Legend, width: float | None
) -> tuple[Figure, list[Axes]]:
    """A new figure with axes for each of `panels` (names), and room for the legend.

    `width`: in inches, for a paper, in which the legend stands above the panels; else it stands on
    their right.
    """
    legend_lines = 0 if len(legend.counts) == 1 else len(legend.counts)
    count = len(panels)
    columns = 1 if width and width < _TWO_COLUMNS else 2 if count == _OWN_PANELS else count
    rows = -(-count // columns)  # rounded up
    if width is not None:
        figure = new_figure(width, 0.62 * width / columns * rows + 0.15 * legend_lines)
    else:
        longest = max(map(len, map(legend.text, legend.counts)))
        legend_width = 0.9 + 0.07 * longest if legend_lines else 0.0
        panels_width = 7.5 if count == 1 else 4.2 * columns
        figure = new_figure(
            panels_width + legend_width, max(4.2, 3.2 * rows, 0.9 + 0.22 * legend_lines)
        )
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, name in zip(grid.flat, panels, strict=True):
        tidy(axes)
        if name:
            axes.set_title(name, fontsize=9.5)
    return figure, list(grid.flat)


def finish_series(
    figure: Figure,
    panels: Sequence[Axes],
    label: str,
    title: str,
    explanation: str,
    legend: Legend,
    width: float | None,
    legend_title: str = "",
) -> Figure:
    """Add axis labels, titles and a legend to a figure of panels over time; returns the figure.

    `label`: of the vertical axes. `explanation`: how to read lines and bands. `width`: in inches,
    for a paper, or None.
    """
    for axes in panels:
        if axes.get_subplotspec().is_last_row():  # type: ignore[union-attr]
            axes.set_xlabel("time [s]")
        if axes.get_subplotspec().is_first_col():  # type: ignore[union-attr]
            axes.set_ylabel(label)
    # `fit` removes the texts with gid NOTE from a figure for a paper.
    if len(panels) == 1:
        only = panels[0]
        only.set_title(title, fontsize=11, loc="left", gid=NOTE)
        only.set_title(explanation, fontsize=8, loc="right", color=GUIDE_COLOUR, gid=NOTE)
    else:
        figure.suptitle(title, fontsize=11, gid=NOTE)
        figure.supxlabel(explanation, fontsize=8, color=GUIDE_COLOUR, gid=NOTE)
    if len(legend.counts) > 1:
        lines = _line_by_text(panels, legend)
        style: Any = {"frameon": False, "fontsize": 9, "borderaxespad": 0.2}
        place: Any = "outside right upper" if width is None else "outside upper left"
        title_or_none = legend_title or None
        figure.legend([*lines.values()], [*lines], loc=place, title=title_or_none, **style)
    return fit(figure, width)


def _line_by_text(panels: Sequence[Axes], legend: Legend) -> dict[str, Line2D]:
    """A line of each variant that a panel shows, by the variant's text, in order of the legend."""
    shown: dict[str, Line2D] = {}
    for axes in panels:
        handles, texts = axes.get_legend_handles_labels()
        shown |= dict(zip(texts, handles, strict=True))
    return {text: shown[text] for text in map(legend.text, legend.counts) if text in shown}


def _smoothed(
    groups: Mapping[str, Sequence[Series]], seconds: float
) -> dict[str, Sequence[Series]]:
    """The running means of the runs of `groups`, by variant; a run without an instant is left out.

    `seconds`: the window of the running mean; 0: the values as they are.
    """
    known = {name: runs for name, runs in groups.items() if any(len(t) for t, _ in runs)}
    if seconds <= 0.0:
        return known
    return {name: [smoothed(run, seconds) for run in runs] for name, runs in known.items()}


def paint_target(axes: Axes, target: float) -> None:
    """Paint a dashed line across, with its value."""
    axes.axhline(target, color=GUIDE_COLOUR, linestyle=(0, (5, 3)), linewidth=1.1, zorder=1.8)
    axes.annotate(f"target {target:g}", (1.0, target), xycoords=("axes fraction", "data"),
                  xytext=(-2, 3), textcoords="offset points", ha="right", fontsize=8,
                  color=GUIDE_COLOUR, bbox=PALE)  # fmt: skip


def _paint_event(axes: Axes, time: float, word: str) -> None:
    axes.axvline(time, color=GUIDE_COLOUR, linestyle=":", linewidth=1.0, zorder=1.8)
    axes.annotate(word, (time, 1.0), xycoords=("data", "axes fraction"), xytext=(2, -3),
                  textcoords="offset points", rotation=90, va="top", fontsize=7.5, bbox=PALE,
                  color=GUIDE_COLOUR, zorder=2.5)  # fmt: skip


def _paint_variant(
    axes: Axes, bands: Bands, look: tuple[str, str], variants: int, label: str
) -> None:
    colour, style = look
    if bands.outer is not None and variants <= _MAX_OUTER:
        axes.fill_between(bands.t, *bands.outer, color=colour, alpha=0.14, linewidth=0.0)
    if bands.inner is not None and variants <= _MAX_INNER:
        axes.fill_between(bands.t, *bands.inner, color=colour, alpha=0.24, linewidth=0.0)
    axes.plot(bands.t, bands.middle, color=colour, linestyle=style, linewidth=1.8, zorder=3.0,
              label=label)  # fmt: skip


def _explanation(
    runs_of_variants: Sequence[Sequence[Series]], variants: int, *, is_share: bool
) -> str:
    """The text below a figure that explains lines and bands.

    `runs_of_variants`: the runs of each line. `variants`: the number of variants. Up to _MAX_OUTER
    variants have both bands. Up to _MAX_INNER variants have only the band of half of the runs. More
    variants have no band.
    """
    counts = [len(runs) for runs in runs_of_variants]
    runs_text = f", n = {counts[0]}" if len(counts) == 1 and counts[0] > 1 else ""
    if max(counts) == 1:
        return "one run each" if len(counts) > 1 else "one run"
    has_outer_band = variants <= _MAX_OUTER
    if is_share:
        return (
            f"share of the runs{', band: its 95 % interval' if has_outer_band else ''}{runs_text}"
        )
    bands = ["50 %"] if max(counts) > 2 and variants <= _MAX_INNER else []
    if has_outer_band:
        bands.append("95 %" if min(counts) >= MANY_RUNS else "all")
    bands_text = f", bands: {' and '.join(bands)} of the runs" if bands else ""
    return f"line: median{bands_text}{runs_text}"


@dataclass(frozen=True, slots=True, eq=False)
class Bands:
    """Statistics of runs over time, (T,) each; NaN where no run has a value.

    `inner` and `outer`: bands around `middle`, each with its lower and its upper bound; None for
    too few runs.
    """

    t: Array
    middle: Array
    inner: tuple[Array, Array] | None
    outer: tuple[Array, Array] | None


def bands_of(runs: Sequence[Series]) -> Bands:
    """The median of runs over time, a band that holds half of the runs, and a wide band.

    The wide band holds 95 % of the runs, or all runs if there are fewer than MANY_RUNS. Runs are
    interpolated at common instants. If all values are whole numbers, the last value before each
    instant is taken instead. A run has no value after its end, and infinite values are left out.
    """
    t = _common_instants([instants for instants, _ in runs])
    value_at = _held if is_count(runs) else _interpolated
    rows = np.stack([value_at(t, *run) for run in runs])
    lowest, highest = (0.025, 0.975) if len(runs) >= MANY_RUNS else (0.0, 1.0)
    quantiles = np.full((5, len(t)), np.nan)
    is_known = np.isfinite(rows).any(axis=0)
    if is_known.any():
        shares = (lowest, 0.25, 0.5, 0.75, highest)
        quantiles[:, is_known] = np.nanquantile(rows[:, is_known], shares, axis=0)
    low, lower, middle, upper, high = quantiles
    inner = (lower, upper) if len(runs) > 2 else None
    return Bands(t, middle, inner, (low, high) if len(runs) > 1 else None)


def shares_of(runs: Sequence[Series]) -> Bands:
    """The share of runs at 1 with Wilson's interval, for runs whose values are 0 or 1."""
    t = _common_instants([instants for instants, _ in runs])
    rows = np.stack([_held(t, *run) for run in runs])
    counts = np.isfinite(rows).sum(axis=0)
    ones = np.nansum(rows, axis=0)
    share, low, high = np.full((3, len(t)), np.nan)
    for k in np.flatnonzero(counts):
        interval = wilson(round(ones[k]), int(counts[k]))
        share[k] = ones[k] / counts[k]
        low[k] = interval.low
        high[k] = interval.high
    return Bands(t, share, None, (low, high) if len(runs) > 1 else None)


def smoothed(run: Series, seconds: float) -> Series:
    """The running mean of a run over a window of `seconds` around each instant; NaN stays NaN."""
    t, values = run
    is_known = np.isfinite(values)
    sums = np.concatenate(([0.0], np.cumsum(np.where(is_known, values, 0.0))))
    counts = np.concatenate(([0], np.cumsum(is_known)))
    first = np.searchsorted(t, t - seconds / 2.0 - _ROUNDING)
    after = np.searchsorted(t, t + seconds / 2.0 + _ROUNDING, side="right")
    total = sums[after] - sums[first]
    count = counts[after] - counts[first]
    return t, np.where(is_known, total / np.maximum(count, 1), np.nan)


def is_yes_or_no(runs: Sequence[Series]) -> bool:
    """Whether the runs have values, and all of them are 0 or 1."""
    known = _finite(runs)
    return len(known) > 0 and bool(np.isin(known, (0.0, 1.0)).all())


def is_count(runs: Sequence[Series]) -> bool:
    """Whether the runs have values, and all of them are whole numbers."""
    known = _finite(runs)
    return len(known) > 0 and bool((known == np.round(known)).all())


def _finite(runs: Sequence[Series]) -> Array:
    return np.concatenate([np.zeros(0), *(values[np.isfinite(values)] for _, values in runs)])


def _interpolated(t: Array, instants: Array, values: Array) -> Array:
    if len(instants) == 0:
        return np.full(len(t), np.nan)
    finite = np.where(np.isfinite(values), values, np.nan)
    return np.interp(t, instants, finite, left=np.nan, right=np.nan)


def _held(t: Array, instants: Array, values: Array) -> Array:
    """At each of `t` the latest value; NaN before the first instant and after the last."""
    if len(instants) == 0:
        return np.full(len(t), np.nan)
    at = np.searchsorted(instants, t + _ROUNDING, side="right") - 1
    is_within = (at >= 0) & (t <= instants[-1] + _ROUNDING) & np.isfinite(values[at])
    held: Array = np.where(is_within, values[at], np.nan)
    return held


def _common_instants(of_runs: Sequence[Array]) -> Array:
    first = of_runs[0]
    if len(first) <= MAX_INSTANTS and all(np.array_equal(first, t) for t in of_runs):
        return first
    ends = [t[[0, -1]] for t in of_runs if len(t)]
    longest = max(len(t) for t in of_runs)
    start = min(t[0] for t in ends)
    stop = max(t[1] for t in ends)
    return np.linspace(start, stop, min(longest, MAX_INSTANTS))
