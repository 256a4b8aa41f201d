"""Metrics of phototaxis: how near robots are to the lamp of the scenario, and on which way."""

from __future__ import annotations

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

LAMP = (2.0, 0.0)
"""The place of the lamp, in m."""
NEAR = 1.5
"""m from the lamp within which robots have gathered."""
ARRIVED = 0.8
"""m from the lamp within which a robot alone has arrived."""


@metric(unit="share", better="more", bounds=(0.0, 1.0))
def share_near(trace: Trace) -> float:
    """The share of robots within 1.5 m of the lamp at the end."""
    return float((distances(trace)[-1] < NEAR).mean())


@metric(unit="m")
def distance_at_end(trace: Trace) -> float:
    """The mean distance of the robots from the lamp at the end."""
    return float(distances(trace)[-1].mean())


@metric(better="less")
def detour(trace: Trace) -> float | None:
    """The way of the first robot to 0.8 m from the lamp by the straight one; None: never."""
    away = distances(trace)[:, 0]
    there = np.flatnonzero(away < ARRIVED)
    if not len(there):
        return None
    steps = np.hypot(*np.diff(trace.pose[: there[0] + 1, 0, :2], axis=0).T)
    return float(steps.sum() / (away[0] - ARRIVED))


def distances(trace: Trace) -> Array:
    """(T, n) distances of robots from the lamp in m."""
    away: Array = np.hypot(trace.pose[..., 0] - LAMP[0], trace.pose[..., 1] - LAMP[1])
    return away
