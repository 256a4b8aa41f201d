"""Pictures of one run: the ways of the robots, and its start beside its end."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics import pairs
from swarmd.sim.metrics.radio_graph import radio_range
from swarmd.sim.metrics.window import last, presence
from swarmd.sim.plots.contacts import BOTH, MARKERS, NONE, ONE, marks_of, paint_contacts
from swarmd.sim.plots.scene import (
    LINK_COLOUR,
    THING_COLOUR,
    check_drawable,
    cut_note,
    extent_of,
    paint_arena,
    paint_bodies,
    paint_links,
    paint_paths,
    paint_paths_by_time,
    paint_things,
    prepare,
    robot_colour,
    robot_style,
)
from swarmd.sim.plots.sheet import Layout, Sheet, legend_height, legend_width
from swarmd.sim.plots.theme import CONTACT_COLOUR, save
from swarmd.sim.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MANY_COLOUR = "#440154"  # the end of the colours of time
MOST_NAMED = 20
"""Robots up to which each has its colour and its line in the legend."""
_ASIDE = 4  # columns of a legend below


def draw_trajectories(
    trace: Trace, path: Path, title: str = "", *, has_links: bool = False
) -> None:
    """Write a picture of a run seen from above: .png, .svg or .pdf, by its suffix.

    Up to 20 robots have a colour and a line in the legend each; the ways of more are coloured by
    time. Footprints are hollow at the start and filled at the end, with a line from the axle to
    where they head; walls, boxes and poles are grey, movable boxes brown; red-edged marks tell
    where robots touched and who was moving. `has_links`: thin lines join those that hear each
    other at the end, if the radio has a range. SwarmError if matplotlib is not installed, there
    is nothing to draw or the file cannot be written.
    """
    save(trajectories_figure(trace, title, has_links=has_links), path)


def trajectories_figure(trace: Trace, title: str = "", *, has_links: bool = False) -> Figure:
    """The picture that `draw_trajectories` writes."""
    check_drawable(trace)
    is_named = len(trace.ids) <= MOST_NAMED
    extent = extent_of(trace)
    width, height = extent.panel(6.3 if is_named else 8.0)
    links = _links(trace) if has_links else None
    entries = (_names(trace) if is_named else []) + _key(trace, links)
    layout = Layout(width=width, height=height, right=legend_width(entries))
    if not is_named:
        below = 0.45 + legend_height(-(-len(entries) // _ASIDE))
        layout = Layout(width=width, height=height, right=1.1, bottom=below)
    title = title or f"{len(trace.ids)} robots, {trace.duration:.0f} s"
    sheet = Sheet(layout, title, least_height=legend_height(len(entries)) if is_named else 0.0)
    axes = sheet.map()
    prepare(axes, extent)
    ways = paint_run(axes, trace, scale=72.0 * width / extent.width)
    if links is not None:
        paint_links(axes, *links)
    axes.set_xlabel(", ".join(word for word in ("x [m]", cut_note(trace)) if word))
    axes.set_ylabel("y [m]")
    if ways is None:
        sheet.legend_aside(entries)
    else:
        sheet.legend_below(entries, _ASIDE)
        bar = sheet.figure.colorbar(ways, cax=sheet.bar_axes(), label="time [s]")
        bar.ax.tick_params(labelsize=9)
    return sheet.figure


def paint_run(axes: Axes, trace: Trace, *, scale: float, is_small: bool = False) -> Any:
    """All of a run onto axes of `scale` points a metre; the ways if a colour bar should tell time.

    `is_small`: with thinner lines and smaller marks, for one of many pictures.
    """
    n = len(trace.ids)
    is_named = n <= MOST_NAMED
    paint_arena(axes, trace)
    paint_things(axes, trace)
    colours = [robot_colour(robot) if is_named else MANY_COLOUR for robot in range(n)]
    starts = colours if is_named else ["0.45"] * n
    ways = None
    if is_named:
        paint_paths(axes, trace, linewidth=0.6 if is_small else 1.1)
    else:
        ways = paint_paths_by_time(axes, trace, linewidth=0.3 if is_small else 0.5)
    paint_bodies(axes, trace, 0, starts, is_filled=False, scale=scale)
    paint_bodies(axes, trace, -1, colours, is_filled=True, scale=scale)
    _paint_changes(axes, trace, colours, size=3.5 if is_small else 6.5)
    size = 4.5 if is_small or not is_named else 8.0
    paint_contacts(axes, marks_of(trace), is_by_robot=is_named, size=size)
    return ways


def _paint_changes(axes: Axes, trace: Trace, colours: list[str], *, size: float) -> None:
    """A triangle up where a robot's daemon joined, down where it left or died."""
    step = np.diff(presence(trace).astype(np.int64), axis=0)
    for change, marker in ((1, "^"), (-1, "v")):
        instants, rows = np.nonzero(step == change)
        if len(rows):
            # Who leaves may leave the arena too, and is then nowhere.
            x, y = trace.pose[instants + (change > 0), rows, :2].T
            axes.scatter(x, y, s=size**2, marker=marker, facecolors=[colours[row] for row in rows],
                         edgecolors="white", linewidths=0.8, zorder=5.0)  # fmt: skip


def _links(trace: Trace) -> tuple[Array, Array] | None:
    """Where those stand that hear each other at the end; None if everyone hears everyone."""
    reach, end = radio_range(trace), last(trace)
    if np.isinf(reach):
        return None
    near = pairs.near(end.pose[..., :2], presence(end), reach)
    return end.pose[0, near.a, :2], end.pose[0, near.b, :2]


def _names(trace: Trace) -> list[tuple[Any, str]]:
    """Handle and label for each robot."""
    from matplotlib.lines import Line2D

    entries: list[tuple[Any, str]] = []
    for robot, name in enumerate(trace.ids):
        line = Line2D([], [], color=robot_colour(robot), linestyle=robot_style(robot), linewidth=2)
        entries.append((line, name + _stay(trace, robot)))
    return entries


def _stay(trace: Trace, robot: int) -> str:
    """When a robot's daemon was there, if not always."""
    is_there = presence(trace)[:, robot]
    if is_there.all():
        return ""
    if not is_there.any():
        return " (never there)"
    step = np.diff(is_there.astype(np.int64))
    changes = [
        f"{'from' if step[k] > 0 else 'to'} {trace.t[k + 1]:g} s" for k in np.flatnonzero(step)
    ]
    return f" ({', '.join(changes)})"


def _key(trace: Trace, links: tuple[Array, Array] | None) -> list[tuple[Any, str]]:
    """What the marks mean, of those that are there."""
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
    if trace.things:
        entries.append(mark("s", THING_COLOUR, "0.3", "movable box"))
    if links is not None:
        entries.append((Line2D([], [], color=LINK_COLOUR), f"radio, {radio_range(trace):g} m"))
    found = [touch.kind for touch in marks_of(trace)]
    is_named = len(trace.ids) <= MOST_NAMED
    faces = {BOTH: CONTACT_COLOUR, ONE: "0.6" if is_named else CONTACT_COLOUR, NONE: "white"}
    for kind, marker in MARKERS.items():
        if kind in found:
            whose = " (its colour)" if kind == ONE and is_named else ""
            label = f"{kind}{whose}: {found.count(kind)}"
            entries.append(mark(marker, faces.get(kind, "0.6"), CONTACT_COLOUR, label))
    return entries
