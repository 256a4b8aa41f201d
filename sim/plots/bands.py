"""Pictures of metrics over time: the median over the seeds, and bands around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swarmd.errors import SwarmError
from swarmd.sim.plots.canvas import (
    GUIDE_COLOUR,
    VARIANT_COLOURS,
    new_figure,
    save,
    tidy,
)
from swarmd.values import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Series = tuple[Array, Array]
"""Of one run: instants (T,) in s, increasing, and values (T,); NaN where there is none."""

MOST_INSTANTS = 600
_STYLES = ("-", "--", ":", "-.")
_MANY_RUNS = 20  # from as many on, 95 % of the runs are not simply all of them
_MOST_OUTER = 3  # variants up to which their wide bands can be told apart
_MOST_INNER = 7


@dataclass(frozen=True, slots=True, eq=False)
class Bands:
    """What the runs of a variant come to over time (T,); NaN where no run has a value.

    `low`, `high` hold 95 % of the runs, or all if there are fewer than 20; `lower`, `upper` half.
    """

    t: Array
    low: Array
    lower: Array
    median: Array
    upper: Array
    high: Array


def bands_of(runs: Sequence[Series]) -> Bands:
    """The bands of runs, each interpolated onto common instants; nothing is carried on beyond
    a run's own end, and infinite values count as none."""
    t = _common_instants([instants for instants, _ in runs])
    rows = np.full((len(runs), len(t)), np.nan)
    for row, (instants, values) in zip(rows, runs, strict=True):
        if len(instants):
            finite = np.where(np.isfinite(values), values, np.nan)
            row[:] = np.interp(t, instants, finite, left=np.nan, right=np.nan)
    outer = (0.025, 0.975) if len(runs) >= _MANY_RUNS else (0.0, 1.0)
    bands = np.full((5, len(t)), np.nan)
    has_value = np.isfinite(rows).any(axis=0)
    shares = (outer[0], 0.25, 0.5, 0.75, outer[1])
    if has_value.any():
        bands[:, has_value] = np.nanquantile(rows[:, has_value], shares, axis=0)
    return Bands(t, *bands)


def draw_series(
    groups: Mapping[str, Sequence[Series]],
    path: Path,
    *,
    label: str,
    unit: str = "",
    title: str = "",
    target: float | None = None,
    events: Sequence[tuple[float, str]] = (),
) -> None:
    """Write a picture of a metric over time: .png, .svg or .pdf, by its suffix.

    `groups`: the runs of each variant. A line tells the median of its runs; a dark band holds
    half of them, a pale one 95 % (all, if they are fewer than 20); with many variants there is
    room for fewer bands. `target` is a dashed line, `events` are s and word of dotted ones.
    SwarmError if there is nothing to draw.
    """
    figure = series_figure(
        groups, label=label, unit=unit, title=title, target=target, events=events
    )
    save(figure, path)


def series_figure(
    groups: Mapping[str, Sequence[Series]],
    *,
    label: str,
    unit: str = "",
    title: str = "",
    target: float | None = None,
    events: Sequence[tuple[float, str]] = (),
) -> Figure:
    """The picture that `draw_series` writes."""
    if not any(len(values) for runs in groups.values() for _, values in runs):
        raise SwarmError(f"{label}: no run has values over time: nothing to draw")
    aside = 0.0 if len(groups) == 1 else 0.9 + 0.07 * max(len(name) + 9 for name in groups)
    figure = new_figure(7.5 + aside, max(4.2, 0.9 + 0.22 * len(groups)))
    axes = figure.add_subplot()
    tidy(axes)
    for index, (name, runs) in enumerate(groups.items()):
        _paint_variant(axes, bands_of(runs), len(runs), index, len(groups), name)
    if target is not None:
        paint_target(axes, target)
    for time, word in events:
        _paint_event(axes, time, word)
    axes.margins(x=0.01)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"{label} [{unit}]" if unit else label)
    axes.set_title(title or label, fontsize=11, loc="left")
    axes.set_title(_reading(groups), fontsize=8, loc="right", color=GUIDE_COLOUR)
    if len(groups) > 1:
        figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


def paint_target(axes: Axes, target: float) -> None:
    """A dashed line across, with its value."""
    axes.axhline(target, color=GUIDE_COLOUR, linestyle=(0, (5, 3)), linewidth=1.1, zorder=1.8)
    axes.annotate(f"target {target:g}", (1.0, target), xycoords=("axes fraction", "data"),
                  xytext=(-2, 3), textcoords="offset points", ha="right", fontsize=8,
                  color=GUIDE_COLOUR)  # fmt: skip


def _paint_event(axes: Axes, time: float, word: str) -> None:
    axes.axvline(time, color=GUIDE_COLOUR, linestyle=":", linewidth=1.0, zorder=1.8)
    axes.annotate(word, (time, 1.0), xycoords=("data", "axes fraction"), xytext=(3, -3),
                  textcoords="offset points", rotation=90, va="top", fontsize=8,
                  color=GUIDE_COLOUR)  # fmt: skip


def _paint_variant(
    axes: Axes, bands: Bands, runs: int, index: int, variants: int, name: str
) -> None:
    colour = VARIANT_COLOURS[index % len(VARIANT_COLOURS)]
    style = _STYLES[index // len(VARIANT_COLOURS) % len(_STYLES)]
    if runs > 1 and variants <= _MOST_OUTER:
        axes.fill_between(bands.t, bands.low, bands.high, color=colour, alpha=0.14, linewidth=0.0)
    if runs > 2 and variants <= _MOST_INNER:
        axes.fill_between(
            bands.t, bands.lower, bands.upper, color=colour, alpha=0.24, linewidth=0.0
        )
    axes.plot(bands.t, bands.median, color=colour, linestyle=style, linewidth=1.8, zorder=3.0,
              label=f"{name} (n = {runs})")  # fmt: skip


def _reading(groups: Mapping[str, Sequence[Series]]) -> str:
    """What lines and bands mean here."""
    counts = [len(runs) for runs in groups.values()]
    words = ["median" if max(counts) > 1 else "one run"]
    if max(counts) > 2 and len(groups) <= _MOST_INNER:
        words.append("50 %")
    if max(counts) > 1 and len(groups) <= _MOST_OUTER:
        words.append("95 %" if min(counts) >= _MANY_RUNS else "all")
    bands = f", bands: {' and '.join(words[1:])} of the runs" if words[1:] else ""
    own = f", n = {counts[0]}" if len(groups) == 1 and counts[0] > 1 else ""
    return f"line: {words[0]}{bands}{own}"


def _common_instants(of_runs: Sequence[Array]) -> Array:
    first = of_runs[0]
    if len(first) <= MOST_INSTANTS and all(np.array_equal(first, t) for t in of_runs):
        return first
    ends = [t[[0, -1]] for t in of_runs if len(t)]
    longest = max(len(t) for t in of_runs)
    start, stop = min(t[0] for t in ends), max(t[1] for t in ends)
    return np.linspace(start, stop, min(longest, MOST_INSTANTS))
