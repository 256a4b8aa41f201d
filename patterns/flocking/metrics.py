"""Metrics of flocking: whether the robots move, and together."""

from __future__ import annotations

import numpy as np

from swarmd.sim.metrics.aggregation import cluster_counts
from swarmd.sim.metrics.kinematics import mean_speed
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

LINK = 1.5
"""Distance in m between axles of one flock: twice the rest length of a spring."""
_BURGER = 0.22  # m/s, the speed limit


@metric(unit="share", better="more")
def speed_share(trace: Trace) -> float | None:
    """The mean speed over the run as a share of a Burger's limit."""
    speed = mean_speed(trace)
    return None if speed is None else speed / _BURGER


@metric(better="less")
def parts(trace: Trace) -> float:
    """The mean number of clusters over the run, lone robots included."""
    return float(cluster_counts(trace, LINK).mean())


@metric(unit="share", better="more", bounds=(0.0, 1.0))
def together(trace: Trace) -> float:
    """The centroid's path as a share of a robot's mean path, over the last half of the run.

    1 if all move alike, 0 if they mill or stand.
    """
    half = len(trace.t) // 2
    place = trace.pose[half::10, :, :2]
    own = np.hypot(*np.moveaxis(np.diff(place, axis=0), -1, 0)).sum()
    centre = np.diff(place.mean(axis=1), axis=0)
    if own == 0.0:
        return 0.0
    return float(np.hypot(centre[:, 0], centre[:, 1]).sum() * place.shape[1] / own)
