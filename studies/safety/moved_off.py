"""When a body that had stood moved off before a collision, and how far from the robot."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from studies.safety.judge import Collision
from swarmd.sim.trace import Trace
from swarmd.sim.world.geometry import gaps, transform

_AT_REST = 0.003  # m/s


class MovedOff(Struct, frozen=True):
    """The begin of the motion that ended in a collision."""

    before: float
    """s before the collision."""
    gap: float
    """m, then, between the outlines of both."""

    @property
    def text(self) -> str:
        """Such as `moved off 0.42 s before, at 7.4 cm`."""
        return f"moved off {self.before:.2f} s before, at {100.0 * self.gap:.1f} cm"


def moved_off(trace: Trace, one: Collision) -> MovedOff | None:
    """When the other robot of a collision moved off; None if that is no robot, or at rest."""
    other = one.b if one.robot == one.a else one.a
    if other not in trace.ids:
        return None
    row, robot = trace.ids.index(other), trace.ids.index(one.robot)
    last = int(np.searchsorted(trace.t, one.time, side="right")) - 1
    way = np.diff(trace.pose[: last + 1, row, :2], axis=0)
    is_at_rest = np.hypot(way[:, 0], way[:, 1]) <= _AT_REST * np.diff(trace.t[: last + 1])
    rests = np.flatnonzero(is_at_rest)
    begin = int(rests[-1]) + 1 if len(rests) else 0
    if begin == last:
        return None
    outlines = [transform(trace.footprint(k), trace.pose[begin, k]) for k in (robot, row)]
    return MovedOff(float(one.time - trace.t[begin]), float(gaps(*outlines)))
