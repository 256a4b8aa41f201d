"""Marks of contacts on axes, which show the position and the moving robots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from swarmd.sim.metrics.contacts import contact_list
from swarmd.sim.plots.scene import robot_colour
from swarmd.sim.plots.theme import CONTACT_COLOUR
from swarmd.sim.trace import Trace
from swarmd.sim.world.geometry import radius

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BOTH, ONE, NONE, OTHER = (
    "contact, both moving",
    "contact, one moving",
    "contact, none moving",
    "contact with wall or box",
)
MARKERS = {BOTH: "X", ONE: "P", NONE: "o", OTHER: "s"}
"""The marker of each kind of contact, by its label in a legend."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A contact in a picture: its kind, x and y in m, and the rows of the robots that moved."""

    kind: str
    place: tuple[float, float]
    movers: tuple[int, ...]


def marks_of(trace: Trace) -> list[Mark]:
    """A mark for every contact, where it began."""
    row_of = {robot: row for row, robot in enumerate(trace.ids)}
    found = []
    for contact in contact_list(trace):
        rows = [row_of[contact.a]] + ([row_of[contact.b]] if contact.kind == "robot" else [])
        is_moving = contact.is_a_moving, contact.is_b_moving
        movers = tuple(row for row, moves in zip(rows, is_moving, strict=False) if moves)
        kind = (NONE, ONE, BOTH)[len(movers)] if len(rows) == 2 else OTHER
        found.append(Mark(kind, _place(trace, contact.start, rows), movers))
    return found


def paint_contacts(axes: Axes, marks: list[Mark], *, is_by_robot: bool, size: float) -> None:
    """A red-edged mark of `size` points at each contact; marker and face show what was moving.

    `is_by_robot`: robots have colours, and a mark has the colour of a single moving robot.
    """
    for kind, marker in MARKERS.items():
        of_kind = [mark for mark in marks if mark.kind == kind]
        if of_kind:
            x, y = zip(*(mark.place for mark in of_kind), strict=True)
            faces = [face_of(mark, is_by_robot=is_by_robot) for mark in of_kind]
            axes.scatter(x, y, s=size**2, marker=marker, facecolors=faces,
                         edgecolors=CONTACT_COLOUR, linewidths=1.0, zorder=6.0)  # fmt: skip


def face_of(mark: Mark, *, is_by_robot: bool) -> str:
    """The colour inside a mark."""
    if not mark.movers:
        return "white"
    if len(mark.movers) == 2 or not is_by_robot:
        return CONTACT_COLOUR
    return robot_colour(mark.movers[0])


def _place(trace: Trace, time: float, rows: list[int]) -> tuple[float, float]:
    instant = int(np.searchsorted(trace.t, time).clip(0, len(trace.t) - 1))
    places = trace.pose[instant, rows, :2]
    # Between two robots, nearer to the smaller one.
    reach = np.array([radius(trace.footprint(row)) for row in reversed(rows)])
    x, y = np.average(places, axis=0, weights=reach)
    return float(x), float(y)
