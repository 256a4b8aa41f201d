"""Pictures of metrics over time: the median over the seeds, and bands around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from swarmd.core.errors import SwarmError
from swarmd.sim.plots.spread import (
    MANY_RUNS,
    Bands,
    Series,
    bands_of,
    is_yes_or_no,
    shares_of,
    smoothed,
)
from swarmd.sim.plots.theme import GUIDE_COLOUR, VARIANT_COLOURS, new_figure, save, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STYLES = ("-", "--", ":", "-.")
_MOST_OUTER = 3  # variants up to which their wide bands can be told apart
_MOST_INNER = 7
_PALE = {"facecolor": "white", "alpha": 0.7, "pad": 1.0, "linewidth": 0.0}


def draw_series(
    groups: Mapping[str, Sequence[Series]],
    path: Path,
    *,
    label: str,
    unit: str = "",
    title: str = "",
    target: float | None = None,
    events: Sequence[tuple[float, str]] = (),
    smoothing: float = 0.0,
) -> None:
    """Write a picture of a metric over time: .png, .svg or .pdf, by its suffix.

    `groups`: the runs of each variant. A line tells the median of its runs; a dark band holds
    half of them, a pale one 95 % (all, if they are fewer than 20); with many variants there is
    room for fewer bands. If all values are 0 or 1 the line is the share of the runs that are at
    1, and its band the 95 % interval of that. `target` is a dashed line, `events` are s and word
    of dotted ones. Before all else a running mean is taken of each run over `smoothing` s, which
    the picture says. SwarmError if there is nothing to draw.
    """
    figure = series_figure(
        groups,
        label=label,
        unit=unit,
        title=title,
        target=target,
        events=events,
        smoothing=smoothing,
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
    smoothing: float = 0.0,
) -> Figure:
    """The picture that `draw_series` writes."""
    kept = {name: runs for name, runs in groups.items() if any(len(t) for t, _ in runs)}
    if not kept:
        raise SwarmError(f"{label}: no run has values over time: nothing to draw")
    if smoothing > 0.0:
        kept = {name: [smoothed(run, smoothing) for run in runs] for name, runs in kept.items()}
    is_share = is_yes_or_no([run for runs in kept.values() for run in runs])
    aside = 0.0 if len(kept) == 1 else 0.9 + 0.07 * max(len(name) + 9 for name in kept)
    figure = new_figure(7.5 + aside, max(4.2, 0.9 + 0.22 * len(kept)))
    axes = figure.add_subplot()
    tidy(axes)
    for index, (name, runs) in enumerate(kept.items()):
        bands = shares_of(runs) if is_share else bands_of(runs)
        _paint_variant(axes, bands, index, len(kept), f"{name} (n = {len(runs)})")
    if target is not None:
        paint_target(axes, target)
    for time, word in events:
        _paint_event(axes, time, word)
    axes.margins(x=0.01)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"{label}: share of runs" if is_share else f"{label} [{unit or '1'}]")
    axes.set_title(title, fontsize=11, loc="left")
    note = f"; running mean over {smoothing:g} s" if smoothing > 0.0 else ""
    axes.set_title(_reading(kept, is_share=is_share) + note, fontsize=8, loc="right",
                   color=GUIDE_COLOUR)  # fmt: skip
    if len(kept) > 1:
        figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


def paint_target(axes: Axes, target: float) -> None:
    """A dashed line across, with its value."""
    axes.axhline(target, color=GUIDE_COLOUR, linestyle=(0, (5, 3)), linewidth=1.1, zorder=1.8)
    axes.annotate(f"target {target:g}", (1.0, target), xycoords=("axes fraction", "data"),
                  xytext=(-2, 3), textcoords="offset points", ha="right", fontsize=8,
                  color=GUIDE_COLOUR, bbox=_PALE)  # fmt: skip


def _paint_event(axes: Axes, time: float, word: str) -> None:
    axes.axvline(time, color=GUIDE_COLOUR, linestyle=":", linewidth=1.0, zorder=1.8)
    axes.annotate(word, (time, 1.0), xycoords=("data", "axes fraction"), xytext=(2, -3),
                  textcoords="offset points", rotation=90, va="top", fontsize=7.5, bbox=_PALE,
                  color=GUIDE_COLOUR, zorder=2.5)  # fmt: skip


def _paint_variant(axes: Axes, bands: Bands, index: int, variants: int, label: str) -> None:
    colour = VARIANT_COLOURS[index % len(VARIANT_COLOURS)]
    style = _STYLES[index // len(VARIANT_COLOURS) % len(_STYLES)]
    if bands.outer is not None and variants <= _MOST_OUTER:
        axes.fill_between(bands.t, *bands.outer, color=colour, alpha=0.14, linewidth=0.0)
    if bands.inner is not None and variants <= _MOST_INNER:
        axes.fill_between(bands.t, *bands.inner, color=colour, alpha=0.24, linewidth=0.0)
    axes.plot(bands.t, bands.middle, color=colour, linestyle=style, linewidth=1.8, zorder=3.0,
              label=label)  # fmt: skip


def _reading(groups: Mapping[str, Sequence[Series]], *, is_share: bool) -> str:
    """What lines and bands mean here."""
    counts = [len(runs) for runs in groups.values()]
    own = f", n = {counts[0]}" if len(groups) == 1 and counts[0] > 1 else ""
    if max(counts) == 1:
        return "one run each" if len(groups) > 1 else "one run"
    is_wide = len(groups) <= _MOST_OUTER
    if is_share:
        return f"share of the runs{', band: its 95 % interval' if is_wide else ''}{own}"
    words = ["50 %"] if max(counts) > 2 and len(groups) <= _MOST_INNER else []
    words += [] if not is_wide else ["95 %"] if min(counts) >= MANY_RUNS else ["all"]
    bands = f", bands: {' and '.join(words)} of the runs" if words else ""
    return f"line: median{bands}{own}"
