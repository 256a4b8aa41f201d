"""Many runs in one picture, each small."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from swarmd.core.errors import SwarmError
from swarmd.sim.plots.fields import paint_fields
from swarmd.sim.plots.scene import Extent, check_drawable, extent_of, prepare
from swarmd.sim.plots.theme import GUIDE_COLOUR, NOTE, fit, new_figure
from swarmd.sim.plots.trajectories import paint_run
from swarmd.sim.trace import Trace
from swarmd.sim.world.scalar_fields import Field

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_RUNS = 25
_SIDE = 2.3  # inches of a run's longer side
_SIDES = ((2, 4.0), (6, 3.0))  # up to so many runs it is larger
_LEGEND = "; outlines: starts; red: contacts"

Load = Callable[[], Trace | None]
"""Loads a run's trace when it is drawn, so that the traces are not in memory together."""


def overview_figure(
    runs: Sequence[tuple[str, Load]],
    title: str = "",
    *,
    note: str = "",
    fields: Sequence[Field] = (),
    width: float | None = None,
) -> Figure:
    """Small pictures of up to 25 runs, each with its name.

    A run whose trace is None is an empty frame that says so. Drawn as by `trajectories_figure`, but
    without legends and to one scale. `note` is text below. `width`: in inches, for a paper.
    SwarmError if there is no run.
    """
    if not runs:
        raise SwarmError("there is no run: nothing to draw")
    shown = runs[:MAX_RUNS]
    columns = min(5, math.ceil(math.sqrt(len(shown))))
    rows = -(-len(shown) // columns)
    extent = _common_extent(shown)
    side = next((inches for most, inches in _SIDES if len(shown) <= most), _SIDE)
    across, height = extent.panel(side) if extent else (side, side)
    inches = columns * (across + 0.1), rows * (height + 0.3) + 0.6
    if width is not None:
        inches = width, rows * (height * (width / columns - 0.1) / across + 0.25) + 0.1
    figure = new_figure(*inches, is_map=True)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes, (name, load) in zip(grid.flat, shown, strict=False):
        axes.set_title(name, fontsize=8, pad=3.0)
        _paint_small(axes, load(), extent, fields)
    for axes in grid.flat[len(shown) :]:
        axes.remove()
    cut = "" if len(shown) == len(runs) else f"the first {len(shown)} of {len(runs)} runs"
    size = f"each frame {extent.width:.3g} m x {extent.height:.3g} m{_LEGEND}" if extent else ""
    below = "; ".join(part for part in (note, cut, size) if part)
    figure.suptitle(title or f"{len(shown)} runs", fontsize=11, gid=NOTE)
    figure.supxlabel(below, fontsize=8, color=GUIDE_COLOUR, gid=NOTE)
    return fit(figure, width)


def _common_extent(runs: Sequence[tuple[str, Load]]) -> Extent | None:
    """An extent that holds every run, for one scale; None if there is no trace."""
    shown = []
    for _, load in runs:
        trace = load()
        if trace is not None:
            check_drawable(trace)
            shown.append(extent_of(trace))
    if not shown:
        return None
    return Extent(
        min(extent.left for extent in shown),
        max(extent.right for extent in shown),
        min(extent.bottom for extent in shown),
        max(extent.top for extent in shown),
    )


def _paint_small(
    axes: Axes, trace: Trace | None, extent: Extent | None, fields: Sequence[Field]
) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color("0.8")
    if extent is not None:
        prepare(axes, extent)
    if trace is None or extent is None:
        axes.text(0.5, 0.5, "no trace", transform=axes.transAxes, ha="center", va="center",
                  fontsize=9, color=GUIDE_COLOUR)  # fmt: skip
        return
    paint_fields(axes, trace, extent, fields, is_small=True)
    paint_run(axes, trace, is_small=True)
