"""Marks of contacts on axes, which show the position and how many robots were moving."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from swarmd.sim.metrics.contacts import contact_list
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
MARKS = {BOTH: ("X", CONTACT_COLOUR), ONE: ("P", "0.6"), NONE: ("o", "white"), OTHER: ("s", "0.6")}
"""The marker and the colour of each kind of contact, by its label in a legend."""


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
