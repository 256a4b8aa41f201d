"""A run's first and last instant side by side, with the clusters that the robots form."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from swarmd.sim.metrics import pairs
from swarmd.sim.metrics.aggregation import cluster_link
from swarmd.sim.metrics.window import first, last, presence
from swarmd.sim.plots.grouping import by_cluster, by_opinion, key_of, opinions_of
from swarmd.sim.plots.scene import (
    check_drawable,
    cut_note,
    extent_of,
    paint_arena,
    paint_bodies,
    paint_links,
    paint_things,
    prepare,
)
from swarmd.sim.plots.sheet import Layout, Sheet
from swarmd.sim.plots.theme import save
from swarmd.sim.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_start_and_end(
    trace: Trace, path: Path, title: str = "", *, link: float | None = None
) -> None:
    """Write a picture of the start beside the end: .png, .svg or .pdf, by its suffix.

    Robots of one cluster (single linkage) have one colour, and thin lines join those within
    `link` m of each other; the largest clusters have colours of their own, further ones are grey,
    lone robots white. Without a `link` it is that of the metrics, twice the largest protection
    threshold; if the trace does not say, all robots have one colour. Where robots report opinions,
    these have the colours instead. Errors as for trajectories.
    """
    save(start_and_end_figure(trace, title, link=link), path)


def start_and_end_figure(trace: Trace, title: str = "", *, link: float | None = None) -> Figure:
    """The picture that `draw_start_and_end` writes."""
    check_drawable(trace)
    reach = cluster_link(trace) if link is None else link
    extent = extent_of(trace)
    width, height = extent.panel(5.5 if len(trace.ids) <= 100 else 7.0)
    is_wide = width > 1.6 * height
    rows, columns = (2, 1) if is_wide else (1, 2)
    layout = Layout(width=width, height=height, rows=rows, columns=columns, bottom=0.75, top=0.22,
                    across=0.2, down=0.35)  # fmt: skip
    opinions, scale = opinions_of(trace), 72.0 * width / extent.width
    sheet = Sheet(layout, title, note="" if opinions else _note(trace, reach))
    for index, part in enumerate((first(trace), last(trace))):
        axes = sheet.map(*((index, 0) if is_wide else (0, index)))
        grouping = by_opinion(part, opinions) if opinions else by_cluster(part, reach)
        prepare(axes, extent)
        _paint_instant(axes, part, None if opinions else reach)
        paint_bodies(axes, part, 0, grouping.colours, is_filled=True, scale=scale)
        word = f"end, {trace.duration:.0f} s" if index else "start"
        axes.set_title(f"{word}: {grouping.words}", fontsize=10, pad=4.0)
        axes.tick_params(labelleft=is_wide or not index, labelbottom=not is_wide or bool(index))
        axes.set_xlabel("x [m]" if not is_wide or index else "")
        axes.set_ylabel("y [m]" if is_wide or not index else "")
    if opinions:
        sheet.legend_below(key_of(opinions), len(opinions))
    return sheet.figure


def _note(trace: Trace, link: float | None) -> str:
    linked = "" if link is None else f"one cluster: each within {link:g} m of the next"
    return "; ".join(word for word in (cut_note(trace), linked) if word)


def _paint_instant(axes: Axes, part: Trace, link: float | None) -> None:
    paint_arena(axes, part)
    paint_things(axes, part)
    if link is not None:
        near = pairs.near(part.pose[..., :2], presence(part), link)
        paint_links(axes, part.pose[0, near.a, :2], part.pose[0, near.b, :2])
