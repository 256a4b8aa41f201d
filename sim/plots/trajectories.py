"""A picture of one run from above, with the paths of the robots and marks of contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.sim.metrics.contacts import contact_list
from swarmd.sim.metrics.window import presence
from swarmd.sim.plots.fields import paint_fields
from swarmd.sim.plots.scene import (
    MOVABLE_BOX_COLOUR,
    check_drawable,
    cut_note,
    extent_of,
    paint_arena,
    paint_bodies,
    paint_movable_boxes,
    paint_paths,
    paint_paths_by_time,
    prepare,
    robot_colour,
    robot_style,
)
from swarmd.sim.plots.theme import CONTACT_COLOUR, NOTE, fit, new_figure
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
    """A picture of a run seen from above, with the scalar fields of its scenario.

    Up to 20 robots have a colour and a line in the legend each; the paths of more are coloured by
    time. Footprints are hollow at the start and filled at the end, with a line from the axle to
    the front. Walls, boxes and poles are grey, movable boxes brown. Red-edged marks show contacts
    and how many robots were moving. `width`: in inches, for a paper, which does not name robots.
    SwarmError if matplotlib is not installed or there is nothing to draw.
    """
    check_drawable(trace)
    is_named = len(trace.ids) <= MAX_NAMED
    extent = extent_of(trace)
    across, height = extent.panel(6.3 if is_named else 8.0)
    entries = (_names(trace) if is_named and width is None else []) + _key(trace)
    handles, labels = zip(*entries, strict=True)
    if width is None:
        aside = 0.8 + 0.07 * max(map(len, labels)) if is_named else 1.0
        above = 0.25 * (1 + title.count("\n"))
        figure = new_figure(across + 0.7 + aside, height + 0.5 + above, is_map=True)
    else:
        scale = (width - (0.6 if is_named else 1.2)) / across
        figure = new_figure(width, height * scale + 0.75, is_map=True)
    axes = figure.add_subplot()
    prepare(axes, extent)
    paint_fields(axes, trace, extent, fields)
    paths = paint_run(axes, trace, is_small=width is not None)
    title = title or f"{len(trace.ids)} robots, {trace.duration:.0f} s"
    axes.set_title(title, fontsize=11, gid=NOTE)
    axes.set_xlabel(", ".join(word for word in ("x [m]", cut_note(trace)) if word))
    axes.set_ylabel("y [m]")
    style: Any = {"frameon": False, "fontsize": 9}
    if paths is None and width is not None:
        figure.legend(handles, labels, loc="outside lower center", ncols=3, **style)
    elif paths is None:
        axes.legend(handles, labels, loc="center left", bbox_to_anchor=(1.01, 0.5), **style)
    else:
        figure.legend(handles, labels, loc="outside lower center", ncols=_COLUMNS, **style)
        bar = figure.colorbar(paths, ax=axes, label="time [s]", shrink=0.7, aspect=35)
        bar.ax.tick_params(labelsize=9)
    return fit(figure, width)


def paint_run(axes: Axes, trace: Trace, *, is_small: bool = False) -> Any:
    """Paint a run onto axes; return the paths if they need a colour bar.

    `is_small`: thinner lines and smaller marks, for one of many pictures.
    """
    n = len(trace.ids)
    is_named = n <= MAX_NAMED
    paint_arena(axes, trace)
    paint_movable_boxes(axes, trace)
    colours = [robot_colour(robot) if is_named else MANY_COLOUR for robot in range(n)]
    starts = colours if is_named else ["0.45"] * n
    paths = None
    if is_named:
        paint_paths(axes, trace, linewidth=0.6 if is_small else 1.1)
    else:
        paths = paint_paths_by_time(axes, trace, linewidth=0.3 if is_small else 0.5)
    paint_bodies(axes, trace, 0, starts, is_filled=False)
    paint_bodies(axes, trace, -1, colours, is_filled=True)
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
        line = Line2D([], [], color=robot_colour(robot), linestyle=robot_style(robot), linewidth=2)
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
        entries.append(mark("s", MOVABLE_BOX_COLOUR, "0.3", "movable box"))
    found = [mark.kind for mark in marks_of(trace)]
    for kind, (marker, face) in MARKS.items():
        if kind in found:
            label = f"{kind}: {found.count(kind)}"
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
    found = []
    for contact in contact_list(trace):
        rows = [row_of[contact.a]] + ([row_of[contact.b]] if contact.kind == "robot" else [])
        moving = contact.is_a_moving + contact.is_b_moving
        kind = (NONE, ONE, BOTH)[moving] if len(rows) == 2 else OTHER
        found.append(Mark(kind, _place(trace, contact.start, rows)))
    return found


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
