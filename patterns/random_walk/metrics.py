"""Metrics of the random walk: how fast it is, and how much of the floor it covers."""

from __future__ import annotations

import math

import numpy as np

from swarmd.sim.metrics.coverage import COVER, covered_area
from swarmd.sim.metrics.kinematics import mean_speed
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

FLOOR = 36.0
"""Area of the scenario's room in m2."""
_BURGER = 0.22  # m/s, the speed limit


@metric(unit="share", better="more")
def speed_share(trace: Trace) -> float | None:
    """The mean speed over the run as a share of a Burger's limit."""
    speed = mean_speed(trace)
    return None if speed is None else speed / _BURGER


@metric(better="more")
def of_random_search(trace: Trace) -> float | None:
    """The covered floor as a share of what a random search with an equal path covers.

    Random search covers the share 1 - exp(-w L / A) of the floor A: w is the search width, twice
    0.5 m, and L the length of the paths of all robots (Koopman, Operations Research 4, 1956). None
    without any path.
    """
    path = np.hypot(*np.moveaxis(np.diff(trace.pose[..., :2], axis=0), -1, 0)).sum()
    expected = FLOOR * (1.0 - math.exp(-2.0 * COVER * float(path) / FLOOR))
    area = covered_area(trace)
    return area / expected if expected and area is not None else None
