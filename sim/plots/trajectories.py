"""Pictures of one run and of many runs from above, with paths of robots and marks of contacts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.operator.texts.values import counted
from swarmd.sim.metrics.contacts import contact_list
from swarmd.sim.metrics.window import presence
from swarmd.sim.plots import scene
from swarmd.sim.plots.theme import (
    CONTACT_COLOUR,
    GUIDE_COLOUR,
    NOTE,
    PALE,
    explained,
    fit,
    grid_of,
    new_figure,
)
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
_CELL = 0.1  # of the width of a map
BOTH = "contact, both moving"
ONE = "contact, one moving"
NONE = "contact, none moving"
OTHER = "contact with wall or box"
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
    scene.check_drawable(trace)
    is_named = len(trace.ids) <= MAX_NAMED
    extent = scene.extent_of(trace)
    entries = (_names(trace) if is_named and width is None else []) + _key(trace)
    handles, labels = zip(*entries, strict=True)
    longest_label = max(map(len, labels))
    size = _figure_size(extent, title.count("\n"), longest_label, width, is_named=is_named)
    figure = new_figure(*size, is_map=True)
    axes = figure.add_subplot()
    scene.prepare(axes, extent)
    scene.paint_fields(axes, trace, extent, fields)
    paths_by_time = paint_run(axes, trace, is_small=width is not None)
    title = title or f"{counted(len(trace.ids), 'robot')}, {trace.duration:.0f} s"
    axes.set_title(title, fontsize=11, gid=NOTE)
    axes.set_xlabel(", ".join(word for word in ("x [m]", scene.cut_note(trace)) if word))
    axes.set_ylabel("y [m]")

    style: Any = {"frameon": False, "fontsize": 9}
    if is_named and width is None:  # beside the map
        axes.legend(handles, labels, loc="center left", bbox_to_anchor=(1.01, 0.5), **style)
    else:  # below the map
        columns = 3 if is_named else _COLUMNS
        figure.legend(handles, labels, loc="outside lower center", ncols=columns, **style)
    if not is_named:
        bar = figure.colorbar(paths_by_time, ax=axes, label="time [s]", shrink=0.7, aspect=35)
        bar.ax.tick_params(labelsize=9)
    return fit(figure, width)


def _figure_size(
    extent: scene.Extent, title_breaks: int, longest_label: int, width: float | None, *,
    is_named: bool,
) -> tuple[float, float]:  # fmt: skip
    """The width and the height in inches of a figure of one run.

    `title_breaks`: line breaks in the title. `longest_label`: characters of the longest label in
    the legend. `width`: in inches, for a paper.
    """
    map_width, map_height = extent.panel(6.3 if is_named else 8.0)
    if width is not None:  # a paper: the axes, and beside the map of many robots a colour bar
        y_axis = 0.6
        x_axis_and_legend = 0.75
        colour_bar = 0.0 if is_named else 0.6
        scale = (width - (y_axis + colour_bar)) / map_width
        return width, map_height * scale + x_axis_and_legend
    x_axis = 0.5
    y_axis = 0.7
    legend_width = 0.8 + 0.07 * longest_label if is_named else 1.0
    title_height = 0.25 * (1 + title_breaks)
    return map_width + y_axis + legend_width, map_height + x_axis + title_height


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
    """Red-edged marks of `size` points at contacts; marker and face show what was moving.

    Contacts of one kind in a cell (_CELL of the axes' width) have one mark with their number, since
    robots that rub against each other have a hundred.
    """
    for kind, (marker, face) in MARKS.items():
        places = np.array([mark.place for mark in marks if mark.kind == kind]).reshape(-1, 2)
        cells = np.round(places / (_CELL * np.ptp(axes.get_xlim())))
        for at in np.unique(cells, axis=0):
            inside = places[(cells == at).all(axis=1)]
            place = inside.mean(axis=0)
            axes.scatter(place[0], place[1], s=size**2, marker=marker, facecolors=face,
                         edgecolors=CONTACT_COLOUR, linewidths=1.0, zorder=6.0)  # fmt: skip
            if len(inside) > 1:
                axes.annotate(f"{len(inside)}", place, xytext=(0.65 * size, 0.0), va="center",
                              textcoords="offset points", fontsize=max(size, 6.0), zorder=6.5,
                              color=CONTACT_COLOUR, bbox=PALE)  # fmt: skip


def _place(trace: Trace, time: float, rows: list[int]) -> tuple[float, float]:
    instant = int(np.searchsorted(trace.t, time).clip(0, len(trace.t) - 1))
    places = trace.pose[instant, rows, :2]
    # Between two robots, nearer to the smaller one.
    reach = np.array([radius(trace.footprint(row)) for row in reversed(rows)])
    x, y = np.average(places, axis=0, weights=reach)
    return float(x), float(y)


MAX_RUNS = 25
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

    `runs`: the name of each run, and a function that loads its trace (None: the run has no trace,
    and gets an empty frame with a note). The pictures are drawn as by `trajectories_figure`,
    without legends. `note`: a text below the figure. `width`: in inches, for a paper. SwarmError
    without a run.
    """
    if not runs:
        raise SwarmError("there is no run: nothing to draw")
    drawn = runs[:MAX_RUNS]
    extent = _common_extent(drawn)
    figure, grid = _grid_of_maps(len(drawn), extent, width)
    for axes, (name, load) in zip(grid, drawn, strict=True):
        axes.set_title(name, fontsize=8, pad=3.0)
        _paint_small(axes, load(), extent, fields)
    cut = "" if len(drawn) == len(runs) else f"the first {len(drawn)} of {len(runs)} runs"
    scale = f"each frame {extent.width:.3g} m x {extent.height:.3g} m{_LEGEND}" if extent else ""
    below = "; ".join(text for text in (note, cut, scale) if text)
    return explained(figure, title or f"{len(drawn)} runs", below, width)


def _grid_of_maps(
    count: int, extent: scene.Extent | None, width: float | None
) -> tuple[Figure, list[Axes]]:
    """A new figure with a grid of `count` maps that is about square; returns figure and axes.

    `extent`: the part of the world that each map shows; None: no run has a trace. `width`: in
    inches, for a paper. All sizes here are in inches.
    """
    columns = min(5, math.ceil(math.sqrt(count)))
    rows = -(-count // columns)  # rounded up
    longer_side = 4.0 if count <= 2 else 3.0 if count <= 6 else 2.3  # of a map
    map_width, map_height = extent.panel(longer_side) if extent else (longer_side, longer_side)
    gap = 0.1  # beside a map
    if width is None:
        name_height = 0.3
        texts_height = 0.6
        size = columns * (map_width + gap), rows * (map_height + name_height) + texts_height
    else:  # a paper, with smaller names and no texts
        name_height = 0.25
        margin = 0.1
        scaled_height = map_height * (width / columns - gap) / map_width
        size = width, rows * (scaled_height + name_height) + margin
    figure = new_figure(*size, is_map=True)
    return figure, grid_of(figure, count, rows, columns)


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
