"""Metrics of cue aggregation: how many robots are at each of the two spots of the scenario."""

from __future__ import annotations

import numpy as np

from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

WARMER = (1.5, 0.0)
OTHER = (-1.5, 0.0)
"""The spots, in m."""
RADIUS = 1.0
"""How far around a spot robots count, in m: 0.21 of the floor."""


@metric(unit="share", better="more", bounds=(0.0, 1.0))
def share_at_warmer(trace: Trace) -> float:
    """The mean share of robots at the warmer spot in the last half."""
    return _share(trace, WARMER)


@metric(unit="share", bounds=(0.0, 1.0))
def share_at_other(trace: Trace) -> float:
    """The mean share of robots at the less warm spot in the last half."""
    return _share(trace, OTHER)


def _share(trace: Trace, spot: tuple[float, float]) -> float:
    late = trace.pose[len(trace.pose) // 2 :, :, :2]
    return float((np.hypot(late[..., 0] - spot[0], late[..., 1] - spot[1]) < RADIUS).mean())
