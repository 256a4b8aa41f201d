"""Traces made by hand for pictures, and a check of layouts."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.sim.trace import Trace
from tests.support.traces import trace_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def walk(n: int, instants: int = 20, *, arena: str = "6x6", **parts: Any) -> Trace:
    """A run of robots that walk at random, from a grid 1 m apart, at 10 Hz."""
    rng = np.random.default_rng([5, n])
    side = int(np.ceil(np.sqrt(n)))
    grid = np.stack(np.divmod(np.arange(n), side), axis=-1) - (side - 1) / 2.0
    pose = np.empty((instants, n, 3))
    pose[..., :2] = grid + 0.05 * np.cumsum(rng.normal(size=(instants, n, 2)), axis=0)
    pose[..., 2] = rng.uniform(-3.0, 3.0, n)
    ids = tuple(f"tb3-{robot:02d}" for robot in range(n))
    meta = {"arena": arena, "thresholds": {"burger": 0.4}}
    return trace_of(pose, **{"ids": ids, "meta": meta, **parts})


def full(n: int) -> Trace:
    """A run that holds all that a picture can show: two robots at least."""
    arena = "6x6,box:2:2:0.5:0.5:20,pole:-2:2:0.2,segment:-2:-2.5:2:-2.5,box/crate:2:0:0.4:0.4:0:2"
    present = np.ones((20, n), dtype=bool)
    present[:10, 0] = present[15:, 1] = False
    box_pose = np.full((20, 2, 3), np.nan)
    box_pose[:, 0] = np.linspace((2.0, 0.0, 0.0), (2.4, 0.3, 1.0), 20)
    box_pose[5:10, 1] = -2.0, 0.0, 0.5
    square = np.array([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]])
    return replace(
        walk(n, arena=arena),
        contact_t=np.array([0.2, 0.3, 1.2, 1.9]),
        contact_pair=np.array([[0, 1], [0, 1], [1, 0], [1, -1]]),
        contact_speed=np.array([[0.1, 0.1], [0.1, 0.1], [0.1, 0.0], [0.1, 0.0]]),
        present=present,
        movable_boxes=("crate", "door"),
        box_pose=box_pose,
        box_shapes=np.stack((square, square)),
    )


def overlaps(figure: Figure) -> list[tuple[str, str]]:
    """The pairs of texts of a figure that overlap by more than two pixels."""
    from matplotlib.text import Text

    figure.draw_without_rendering()
    hidden = {
        label
        for axes in figure.axes
        for axis in (axes.xaxis, axes.yaxis)
        for tick in axis.get_major_ticks()
        for label in (tick.label1, tick.label2)
        if not min(axis.get_view_interval()) <= tick.get_loc() <= max(axis.get_view_interval())
    }
    boxes = [
        (text.get_text(), text.get_window_extent().padded(-1.0))
        for text in figure.findobj(Text)
        if text.get_visible() and text.get_text() and text not in hidden
    ]
    return [
        (one, other)
        for (one, box), (other, box2) in itertools.combinations(boxes, 2)
        if box.overlaps(box2)
    ]
