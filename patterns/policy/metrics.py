"""Metrics of policy: how far robots have gathered."""

from __future__ import annotations

from swarmd.sim.metrics.aggregation import distance_to_centroid
from swarmd.sim.metrics.metric import at_start, late_mean
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace


@metric(better="less")
def late_share_of_start(trace: Trace) -> float | None:
    """The mean distance to the centroid, late, as a share of that at the start."""
    late = late_mean(distance_to_centroid)(trace)
    start = at_start(distance_to_centroid)(trace)
    return late / start if late is not None and start else None
