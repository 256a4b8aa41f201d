"""Metrics of dispersion: true ranges at the end of a run."""

from __future__ import annotations

import numpy as np

from swarmd.sim.metrics.lidar_ranges import lidar_ranges
from swarmd.sim.metrics.own import metric
from swarmd.sim.metrics.window import late
from swarmd.sim.trace import Trace

_SECONDS = 10.0  # the last of a run


@metric(unit="m", better="more")
def least_late_range(trace: Trace) -> float:
    """The least true range to a robot or wall in the last 10 s."""
    return float(lidar_ranges(late(trace, _SECONDS)).min())


@metric(unit="m")
def median_late_range(trace: Trace) -> float:
    """The median true range to the nearest robot or wall in the last 10 s."""
    return float(np.median(lidar_ranges(late(trace, _SECONDS))))
