"""Many runs in one picture, small, to see at a glance what happened."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from swarmd.errors import SwarmError
from swarmd.sim.plots.canvas import GUIDE_COLOUR, new_figure, save
from swarmd.sim.plots.scene import check_drawable, extent_of, prepare
from swarmd.sim.plots.trajectories import paint_run
from swarmd.sim.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_RUNS = 25
_SIDE = 2.3  # inches


def draw_overview(
    runs: Sequence[tuple[str, Trace | None]], path: Path, title: str = "", *, note: str = ""
) -> None:
    """Write small pictures of up to 25 runs, each with its name: .png, .svg or .pdf, by its suffix.

    A run whose trace is None is a frame that says so. Drawn as by `draw_trajectories`, without
    legends. `note` stands below. SwarmError if there is no run.
    """
    save(overview_figure(runs, title, note=note), path)


def overview_figure(
    runs: Sequence[tuple[str, Trace | None]], title: str = "", *, note: str = ""
) -> Figure:
    """The picture that `draw_overview` writes."""
    if not runs:
        raise SwarmError("there is no run: nothing to draw")
    shown = runs[:MOST_RUNS]
    columns = min(5, math.ceil(math.sqrt(len(shown))))
    rows = -(-len(shown) // columns)
    width, height = _SIDE, _SIDE
    known = [trace for _, trace in shown if trace is not None]
    if known:
        check_drawable(known[0])
        width, height = extent_of(known[0]).panel(_SIDE)
    figure = new_figure(columns * width + 0.3, rows * (height + 0.25) + 0.6)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes, (name, trace) in zip(grid.flat, shown, strict=False):
        axes.set_title(name, fontsize=8, pad=3.0)
        _paint_small(axes, trace, width)
        axes.set_box_aspect(height / width)
    for axes in grid.flat[len(shown) :]:
        axes.remove()
    figure.suptitle(title or f"{len(shown)} runs", fontsize=11)
    cut = "" if len(shown) == len(runs) else f"the first {len(shown)} of {len(runs)} runs"
    figure.supxlabel("; ".join(part for part in (note, cut) if part), fontsize=8,
                     color=GUIDE_COLOUR)  # fmt: skip
    return figure


def _paint_small(axes: Axes, trace: Trace | None, width: float) -> None:
    axes.set_axis_off()
    if trace is None:
        axes.text(0.5, 0.5, "no trace", transform=axes.transAxes, ha="center", va="center",
                  fontsize=9, color=GUIDE_COLOUR)  # fmt: skip
        return
    check_drawable(trace)
    extent = extent_of(trace)
    prepare(axes, extent)
    paint_run(axes, trace, scale=72.0 * width / extent.width, is_small=True)
