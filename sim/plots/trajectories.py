"""Pictures of one run and of many runs from above, with paths of robots and marks of contacts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.sim.metrics.contacts import contact_list
from swarmd.sim.metrics.window import presence
from swarmd.sim.plots import scene
from swarmd.sim.plots.theme import CONTACT_COLOUR, GUIDE_COLOUR, NOTE, fit, new_figure
from swarmd.sim.trace import Trace
from swarmd.sim.world.geometry import radius
from swarmd.sim.world.scalar_fields import Field

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MANY_COLOUR = "#440154"  # the end of the colours of time
MAX_NAMED = 20
"""Up to so many robots, each has a colour and a line in the legend."""
_COLUMNS = 4  # of a legend below
BOTH, ONE, NONE, OTHER = (
    "contact, both moving",
    "contact, one moving",
    "contact, none moving",
    "contact with wall or box",
)
MARKS = {BOTH: ("X", CONTACT_COLOUR), ONE: ("P", "0.6"), NONE: ("o", "white"), OTHER: ("s", "0.6")}
"""The marker and the colour of each kind of contact, by its label in a legend."""


def trajectories_figure(
    trace: Trace, title: str = "", *, fields: Sequence[Field] = (), width: float | None = None
) -> Figure:
    """A figure of a run seen from above, with the scalar fields of its scenario.

    Each of up to MAX_NAMED robots has a colour and a line in the legend. With more robots, colours
    show the time. Footprints are hollow at the start and filled at the end, with a line from the
    axle to the front. Walls, boxes and poles are grey, movable boxes brown. Red-edged marks show
    contacts; their shape shows how many of the robots were moving. `width`: in inches, for a paper;
    robots are then not named. SwarmError if matplotlib is not installed, or if the trace has no
    instant or no robot.
    """
    # 1. The figure; its sizes are in inches.
    scene.check_drawable(trace)
    is_named = len(trace.ids) <= MAX_NAMED
    extent = scene.extent_of(trace)
    map_width, map_height = extent.panel(6.3 if is_named else 8.0)
    entries = (_names(trace) if is_named and width is None else []) + _key(trace)
    handles, labels = zip(*entries, strict=True)
    if width is None:
        # The legend has a sample and 0.07 for each character; 0.7 and 0.5 are for the two axes.
        legend_width = 0.8 + 0.07 * max(map(len, labels)) if is_named else 1.0
        title_height = 0.25 * (1 + title.count("\n"))
        size = map_width + 0.7 + legend_width, map_height + 0.5 + title_height
    else:  # a paper: of the width, 0.6 is for the y axis, and 0.6 for a colour bar
        scale = (width - (0.6 if is_named else 1.2)) / map_width
        size = width, map_height * scale + 0.75
    figure = new_figure(*size, is_map=True)

    # 2. The map.
    axes = figure.add_subplot()
    scene.prepare(axes, extent)
    scene.paint_fields(axes, trace, extent, fields)
    paths = paint_run(axes, trace, is_small=width is not None)  # None if robots have colours
    title = title or f"{len(trace.ids)} robots, {trace.duration:.0f} s"
    axes.set_title(title, fontsize=11, gid=NOTE)
    axes.set_xlabel(", ".join(word for word in ("x [m]", scene.cut_note(trace)) if word))
    axes.set_ylabel("y [m]")

    # 3. The legend: beside the map, or below it in a paper and for many robots.
    style: Any = {"frameon": False, "fontsize": 9}
    if paths is None and width is not None:
        figure.legend(handles, labels, loc="outside lower center", ncols=3, **style)
    elif paths is None:
        axes.legend(handles, labels, loc="center left", bbox_to_anchor=(1.01, 0.5), **style)
    else:  # paths of many robots, coloured by time
        figure.legend(handles, labels, loc="outside lower center", ncols=_COLUMNS, **style)
        bar = figure.colorbar(paths, ax=axes, label="time [s]", shrink=0.7, aspect=35)
        bar.ax.tick_params(labelsize=9)
    return fit(figure, width)


def paint_run(axes: Axes, trace: Trace, *, is_small: bool = False) -> Any:
    """Paint arena, paths, start and end of all robots, and contacts of a run onto axes.

    With more than MAX_NAMED robots the colour of paths shows the time, and the paths are returned
    for a colour bar; else None. `is_small`: thin lines and small marks, for one of many pictures.
    """
    n = len(trace.ids)
    is_named = n <= MAX_NAMED
    scene.paint_arena(axes, trace)
    scene.paint_movable_boxes(axes, trace)
    colours = [scene.robot_colour(robot) if is_named else MANY_COLOUR for robot in range(n)]
    starts = colours if is_named else ["0.45"] * n
    paths = None
    if is_named:
        scene.paint_paths(axes, trace, linewidth=0.6 if is_small else 1.1)
    else:
        paths = scene.paint_paths_by_time(axes, trace, linewidth=0.3 if is_small else 0.5)
    scene.paint_bodies(axes, trace, 0, starts, is_filled=False)
    scene.paint_bodies(axes, trace, -1, colours, is_filled=True)
    _paint_changes(axes, trace, colours, size=3.5 if is_small else 6.5)
    size = 4.5 if is_small or not is_named else 8.0
    paint_contacts(axes, marks_of(trace), size=size)
    return paths


def _paint_changes(axes: Axes, trace: Trace, colours: list[str], *, size: float) -> None:
    """A triangle up where a robot's daemon joined, down where it left or died."""
    step = np.diff(presence(trace).astype(np.int64), axis=0)
    for change, marker in ((1, "^"), (-1, "v")):
        instants, rows = np.nonzero(step == change)
        if len(rows):
            # A robot that leaves may leave the arena too; its pose is then NaN.
            x, y = trace.pose[instants + (change > 0), rows, :2].T
            axes.scatter(x, y, s=size**2, marker=marker, facecolors=[colours[row] for row in rows],
                         edgecolors="white", linewidths=0.8, zorder=5.0)  # fmt: skip


def _names(trace: Trace) -> list[tuple[Any, str]]:
    """Handle and label for each robot."""
    from matplotlib.lines import Line2D

    entries: list[tuple[Any, str]] = []
    for robot, name in enumerate(trace.ids):
        line = Line2D(
            [], [], color=scene.robot_colour(robot), linestyle=scene.robot_style(robot), linewidth=2
        )
        entries.append((line, name))
    return entries


def _key(trace: Trace) -> list[tuple[Any, str]]:
    """Handle and label of each kind of mark in the picture."""
    from matplotlib.lines import Line2D

    def mark(marker: str, face: str, edge: str, label: str) -> tuple[Any, str]:
        handle = Line2D([], [], linestyle="none", marker=marker, markersize=8,
                        markerfacecolor=face, markeredgecolor=edge)  # fmt: skip
        return handle, label

    entries = [mark("s", "white", "0.35", "start"), mark("s", "0.35", "0.1", "end")]
    step = np.diff(presence(trace).astype(np.int64), axis=0)
    if (step > 0).any():
        entries.append(mark("^", "0.35", "white", "joins"))
    if (step < 0).any():
        entries.append(mark("v", "0.35", "white", "leaves"))
    if trace.movable_boxes:
        entries.append(mark("s", scene.MOVABLE_BOX_COLOUR, "0.3", "movable box or item"))
    kinds = [mark.kind for mark in marks_of(trace)]
    for kind, (marker, face) in MARKS.items():
        if kind in kinds:
            label = f"{kind}: {kinds.count(kind)}"
            entries.append(mark(marker, face, CONTACT_COLOUR, label))
    return entries


@dataclass(frozen=True, slots=True)
class Mark:
    """A contact in a picture: its kind, and x and y in m."""

    kind: str
    place: tuple[float, float]


def marks_of(trace: Trace) -> list[Mark]:
    """A mark for every contact, where it began."""
    row_of = {robot: row for row, robot in enumerate(trace.ids)}
    marks = []
    for contact in contact_list(trace):
        rows = [row_of[contact.a]] + ([row_of[contact.b]] if contact.kind == "robot" else [])
        moving = contact.is_a_moving + contact.is_b_moving
        kind = (NONE, ONE, BOTH)[moving] if len(rows) == 2 else OTHER
        marks.append(Mark(kind, _place(trace, contact.start, rows)))
    return marks


def paint_contacts(axes: Axes, marks: list[Mark], *, size: float) -> None:
    """A red-edged mark of `size` points at each contact; marker and face show what was moving."""
    for kind, (marker, face) in MARKS.items():
        places = [mark.place for mark in marks if mark.kind == kind]
        if places:
            x, y = zip(*places, strict=True)
            axes.scatter(x, y, s=size**2, marker=marker, facecolors=face,
                         edgecolors=CONTACT_COLOUR, linewidths=1.0, zorder=6.0)  # fmt: skip


def _place(trace: Trace, time: float, rows: list[int]) -> tuple[float, float]:
    instant = int(np.searchsorted(trace.t, time).clip(0, len(trace.t) - 1))
    places = trace.pose[instant, rows, :2]
    # Between two robots, nearer to the smaller one.
    reach = np.array([radius(trace.footprint(row)) for row in reversed(rows)])
    x, y = np.average(places, axis=0, weights=reach)
    return float(x), float(y)


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
    """A figure of small pictures of up to MAX_RUNS runs seen from above, all at one scale.

    `runs`: the name of each run, and a function that loads its trace, or gives None. A run without
    a trace has an empty frame with a note. The pictures are drawn as by `trajectories_figure`,
    without legends. `note`: a text below the figure. `width`: in inches, for a paper. SwarmError
    without a run.
    """
    if not runs:
        raise SwarmError("there is no run: nothing to draw")
    drawn = runs[:MAX_RUNS]

    # 1. A grid that is about square; sizes are in inches.
    columns = min(5, math.ceil(math.sqrt(len(drawn))))
    rows = -(-len(drawn) // columns)  # rounded up
    extent = _common_extent(drawn)
    # Few runs have larger pictures.
    side = next((inches for most, inches in _SIDES if len(drawn) <= most), _SIDE)
    map_width, map_height = extent.panel(side) if extent else (side, side)
    # Each map has 0.1 beside it, and 0.3 (in a paper 0.25) above it for its name.
    size = columns * (map_width + 0.1), rows * (map_height + 0.3) + 0.6
    if width is not None:
        scaled_height = map_height * (width / columns - 0.1) / map_width
        size = width, rows * (scaled_height + 0.25) + 0.1
    figure = new_figure(*size, is_map=True)
    grid = figure.subplots(rows, columns, squeeze=False)

    # 2. The pictures.
    for axes, (name, load) in zip(grid.flat, drawn, strict=False):
        axes.set_title(name, fontsize=8, pad=3.0)
        _paint_small(axes, load(), extent, fields)
    for axes in grid.flat[len(drawn) :]:
        axes.remove()

    # 3. The texts.
    cut = "" if len(drawn) == len(runs) else f"the first {len(drawn)} of {len(runs)} runs"
    scale = f"each frame {extent.width:.3g} m x {extent.height:.3g} m{_LEGEND}" if extent else ""
    below = "; ".join(text for text in (note, cut, scale) if text)
    figure.suptitle(title or f"{len(drawn)} runs", fontsize=11, gid=NOTE)
    figure.supxlabel(below, fontsize=8, color=GUIDE_COLOUR, gid=NOTE)
    return fit(figure, width)


def _common_extent(runs: Sequence[tuple[str, Load]]) -> scene.Extent | None:
    """An extent that holds every run, for one scale; None if there is no trace."""
    extents = []
    for _, load in runs:
        trace = load()
        if trace is not None:
            scene.check_drawable(trace)
            extents.append(scene.extent_of(trace))
    if not extents:
        return None
    return scene.Extent(
        min(extent.left for extent in extents),
        max(extent.right for extent in extents),
        min(extent.bottom for extent in extents),
        max(extent.top for extent in extents),
    )


def _paint_small(
    axes: Axes, trace: Trace | None, extent: scene.Extent | None, fields: Sequence[Field]
) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color("0.8")
    if extent is not None:
        scene.prepare(axes, extent)
    if trace is None or extent is None:
        axes.text(0.5, 0.5, "no trace", transform=axes.transAxes, ha="center", va="center",
                  fontsize=9, color=GUIDE_COLOUR)  # fmt: skip
        return
    scene.paint_fields(axes, trace, extent, fields, is_small=True)
    paint_run(axes, trace, is_small=True)
