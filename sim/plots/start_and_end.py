"""A run's first and last instant side by side, coloured by cluster or by opinion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.values import OPINION
from swarmd.sim.metrics import pairs
from swarmd.sim.metrics.aggregation import cluster_link, clusters
from swarmd.sim.metrics.window import first, last, presence
from swarmd.sim.plots import scene
from swarmd.sim.plots.theme import GUIDE_COLOUR, NOTE, ROBOT_COLOURS, fit, new_figure
from swarmd.sim.trace import Trace
from swarmd.sim.world.scalar_fields import Field
from swarmd.texts.values import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NO_COLOUR = "white"
"""The colour of lone robots, and of robots without an opinion."""
SMALL_COLOUR = "0.6"
"""The colour of all groups beyond those with a colour of their own."""
_MAX_COUNTED = 4  # opinions in a title


def start_and_end_figure(
    trace: Trace,
    title: str = "",
    *,
    link: float | None = None,
    fields: Sequence[Field] = (),
    width: float | None = None,
) -> Figure:
    """A figure of a run seen from above, at its first and at its last instant.

    Colours show clusters: robots that are linked, directly or through other robots, by distances of
    at most `link` m (single linkage). Thin lines show these links. The largest clusters have a
    colour each. Smaller clusters are grey, single robots white. If robots report opinions, colours
    show opinions instead.

    `link`: in m. None: as in metrics, twice the largest protection threshold of the robots'
    platforms (`cluster_link`); all robots have one colour if the trace has no threshold. `width`:
    in inches, for a paper. SwarmError if the trace has no instant or no robot.
    """
    scene.check_drawable(trace)
    link_m = cluster_link(trace) if link is None else link
    opinions = opinions_of(trace)
    extent = scene.extent_of(trace)
    figure, start_and_end = _two_maps(extent, len(trace.ids), width)
    # Start and end, each as a trace of one instant.
    instants = ((first(trace), "start"), (last(trace), f"end, {trace.duration:.0f} s"))
    for axes, (part, name) in zip(start_and_end, instants, strict=True):
        grouping = by_opinion(part, opinions) if opinions else by_cluster(part, link_m)
        scene.prepare(axes, extent)
        scene.paint_fields(axes, trace, extent, fields)
        _paint_instant(axes, part, None if opinions else link_m)
        scene.paint_bodies(axes, part, 0, grouping.colours, is_filled=True)
        axes.set_title(f"{name}: {grouping.label}", fontsize=10, pad=4.0)
    if title:
        figure.suptitle(title, fontsize=11, gid=NOTE)
    if opinions:
        _add_legend(figure, opinions)
    else:
        figure.supxlabel(_note(trace, link_m), fontsize=8, color=GUIDE_COLOUR, gid=NOTE)
    return fit(figure, width)


def _two_maps(extent: scene.Extent, robots: int, width: float | None) -> tuple[Figure, list[Axes]]:
    """A new figure with two maps, side by side, or one below the other if the maps are wide.

    `robots`: their number; a map of many robots is larger. `width`: in inches, for a paper.
    Returns the figure and the axes of the two maps. All sizes here are in inches.
    """
    map_width, map_height = extent.panel(5.5 if robots <= 100 else 7.0)
    rows, columns = (2, 1) if map_width > 1.6 * map_height else (1, 2)
    # The y axis stands beside the maps, a title above each map, texts above and below all maps.
    if width is None:
        y_axis, gap = 0.7, 0.2
        map_title, texts = 0.4, 1.1
        size = columns * (map_width + gap) + y_axis, rows * (map_height + map_title) + texts
    else:  # a paper, with smaller texts: the y axis leaves the rest of the width to the maps
        y_axis = 0.55
        map_title, texts = 0.25, 0.6
        scale = (width - y_axis) / (columns * map_width)
        size = width, rows * (map_height * scale + map_title) + texts
    figure = new_figure(*size, is_map=True)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in grid[-1]:
        axes.set_xlabel("x [m]")
    for axes in grid[:, 0]:
        axes.set_ylabel("y [m]")
    return figure, list(grid.flat)


@dataclass(frozen=True, slots=True)
class Grouping:
    """The colour (n,) of each robot, and a text that counts the groups."""

    colours: list[str]
    label: str


def opinions_of(trace: Trace) -> list[float]:
    """The opinions held at the first or the last instant, sorted; empty without a vote."""
    opinion = trace.report.get(OPINION)
    if opinion is None or not len(opinion):
        return []
    ends = opinion[[0, -1]]
    return [float(value) for value in np.unique(ends[np.isfinite(ends)])]


def by_opinion(part: Trace, opinions: Sequence[float]) -> Grouping:
    """Robots by opinion at the first instant of `part`; each of `opinions` has its colour."""
    held = np.where(presence(part), part.report[OPINION], np.nan)[0]
    colour_of = dict.fromkeys(opinions, SMALL_COLOUR)
    colour_of |= dict(zip(opinions, ROBOT_COLOURS[:-1], strict=False))
    colours = [colour_of.get(float(value), NO_COLOUR) for value in held]
    counts = Counter(float(value) for value in held if np.isfinite(value))
    most = sorted(counts, key=lambda value: (-counts[value], value))
    parts = [f"opinion {value:g}: {counts[value]}" for value in most[:_MAX_COUNTED]]
    parts += [f"{len(most) - _MAX_COUNTED} more"] if len(most) > _MAX_COUNTED else []
    return Grouping(colours, ", ".join(parts) or "no opinion yet")


def by_cluster(part: Trace, link: float | None) -> Grouping:
    """Robots by cluster at the first instant of `part`; one colour without a `link`."""
    n = int(presence(part)[0].sum())
    robots = counted(n, "robot")
    if link is None:
        return Grouping([ROBOT_COLOURS[0]] * len(part.ids), robots)
    labels = [int(label) for label in clusters(part, link)[0]]
    sizes = Counter(label for label in labels if label >= 0)
    by_size = sorted((label for label in sizes if sizes[label] > 1), key=lambda k: (-sizes[k], k))
    # A single robot has NO_COLOUR. A cluster is grey, but the largest have a colour each: the
    # colours without the last, which is grey too.
    colour_of = dict.fromkeys(sizes, NO_COLOUR) | dict.fromkeys(by_size, SMALL_COLOUR)
    colour_of |= dict(zip(by_size, ROBOT_COLOURS[:-1], strict=False))
    colours = [colour_of.get(label, NO_COLOUR) for label in labels]
    largest = max(sizes.values(), default=0)
    if n > 1 and largest == 1:
        return Grouping(colours, f"all {n} alone")
    if len(sizes) > 1:
        return Grouping(colours, f"{len(sizes)} clusters, the largest of {largest}")
    return Grouping(colours, f"one cluster of {n}" if n > 1 else robots)


def _add_legend(figure: Figure, opinions: Sequence[float]) -> None:
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=colour, edgecolor="0.1", label=f"opinion {value:g}")
        for value, colour in zip(opinions, ROBOT_COLOURS[:-1], strict=False)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False, fontsize=9)


def _note(trace: Trace, link: float | None) -> str:
    linked = "" if link is None else f"one cluster: each within {link:g} m of the next"
    return "; ".join(word for word in (scene.cut_note(trace), linked) if word)


def _paint_instant(axes: Axes, part: Trace, link: float | None) -> None:
    scene.paint_arena(axes, part)
    scene.paint_movable_boxes(axes, part)
    if link is not None:
        near = pairs.near(part.pose[..., :2], presence(part), link)
        scene.paint_links(axes, part.pose[0, near.a, :2], part.pose[0, near.b, :2])
