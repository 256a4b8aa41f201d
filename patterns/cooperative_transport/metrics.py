"""Metrics of cooperative transport: the way of the box to the lamp of the scenario."""

from __future__ import annotations

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

LAMP = (2.0, 0.0)
"""The place of the lamp, in m."""
ARRIVED = 0.5
"""m from the lamp: the box, 0.25 m from its middle to its sides, has arrived."""


@metric(unit="0 or 1", better="more")
def arrived(trace: Trace) -> bool:
    """Whether the box arrives at the lamp."""
    return way(trace) is not None


@metric(better="less")
def way(trace: Trace) -> float | None:
    """The box's path until arrival, over the straight distance; None: no arrival."""
    places = _box(trace)
    to_lamp = np.hypot(*(places - LAMP).T)
    arrivals = np.flatnonzero(to_lamp < ARRIVED)
    if not len(arrivals):
        return None
    first = arrivals[0]
    steps = np.hypot(*np.diff(places[: first + 1], axis=0).T)
    return float(steps.sum() / (to_lamp[0] - to_lamp[first]))


@metric(unit="m")
def moved(trace: Trace) -> float:
    """The distance of the box at the end from its place at the start."""
    places = _box(trace)
    return float(np.hypot(*(places[-1] - places[0])))


def _box(trace: Trace) -> Array:
    """(T, 2) the middle of the box in m."""
    if trace.box_pose is None:
        raise ValueError("the scenario has no movable box")
    return trace.box_pose[:, 0, :2]
