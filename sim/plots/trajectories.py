"""Pictures of runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from swarmd.errors import ConfigError, SwarmError
from swarmd.sim.trace import Trace
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.geometry import transform
from swarmd.values import Array


def draw_trajectories(trace: Trace, path: Path, title: str = "") -> None:
    """Write a picture of a run seen from above: .png, .svg or .pdf, by its suffix.

    The way of each robot in its colour, its footprint hollow at the start and filled at the end
    with a line from the axle to where it heads; walls, boxes and poles in grey; a red cross where
    robots touched. SwarmError if matplotlib is not installed or there is nothing to draw.
    """
    if len(trace.t) == 0:
        raise SwarmError("the trace holds no instant: nothing to draw")
    try:
        # Here, since it takes most of a second and nobody else needs it.
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise SwarmError("pictures need matplotlib: pip install 'swarmd[plot]'") from error
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_aspect("equal")
    _draw_arena(axes, trace)
    for robot in range(len(trace.ids)):
        _draw_robot(axes, trace, robot)
    _draw_contacts(axes, trace)
    axes.set_title(title or f"{len(trace.ids)} robots, {trace.duration:.0f} s")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    if len(trace.ids) <= 20:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def _draw_arena(axes: Any, trace: Trace) -> None:
    try:
        arena = parse_arena(str(trace.meta.get("arena", "")))
    except ConfigError:  # a trace from elsewhere: no walls are known
        return
    x, y = arena.length / 2.0, arena.width / 2.0
    axes.plot([-x, x, x, -x, -x], [-y, -y, y, y, -y], color="0.3", linewidth=2.5)
    for box in arena.boxes:
        axes.fill(*box.corners.T, color="0.6")
    for pole in arena.poles:
        turn = np.linspace(0.0, 2.0 * np.pi, 40)
        outline = pole.x + pole.radius * np.cos(turn), pole.y + pole.radius * np.sin(turn)
        axes.fill(*outline, color="0.6")


def _draw_robot(axes: Any, trace: Trace, robot: int) -> None:
    colour = f"C{robot % 10}"
    pose = trace.pose[:, robot]
    axes.plot(pose[:, 0], pose[:, 1], color=colour, linewidth=0.9, label=trace.ids[robot])
    for at, is_filled in ((pose[0], False), (pose[-1], True)):
        outline = transform(trace.footprint(robot), at)
        axes.fill(*outline.T, facecolor=colour if is_filled else "none", edgecolor=colour,
                  alpha=0.75 if is_filled else 1.0, linewidth=1.0)  # fmt: skip
        axes.plot(*_nose(trace.footprint(robot), at).T, color="k" if is_filled else colour,
                  linewidth=1.0)  # fmt: skip


def _nose(footprint: Array, pose: Array) -> Array:
    ahead = float(footprint[:, 0].max())
    return transform(np.array([[0.0, 0.0], [ahead, 0.0]]), pose)


def _draw_contacts(axes: Any, trace: Trace) -> None:
    if len(trace.contact_t) == 0:
        return
    instants = np.searchsorted(trace.t, trace.contact_t).clip(0, len(trace.t) - 1)
    place = trace.pose[instants, trace.contact_pair[:, 0], :2]
    axes.plot(place[:, 0], place[:, 1], "rx", markersize=7, label="touch")
