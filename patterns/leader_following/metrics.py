"""Metrics of leader following: how far gaps are from the policy's gap."""

from __future__ import annotations

import numpy as np

from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

STANDSTILL = 0.5
"""The gap at rest on a Burger, in m."""
HEADWAY = 1.5
"""The default in s: the gap grows by so much for each m/s."""
SPEED = 0.11
"""The leader's speed in m/s."""


@metric(unit="m", better="less")
def gap_error(trace: Trace) -> float | None:
    """The largest difference between a gap and the policy's gap, just before the leader's end.

    None if the last robot stands, since the gaps at the start are near the policy's.
    """
    places = trace.pose[:, :, :2]  # the robots in the order of the chain
    before = int(len(places) * 55 / 90)  # the leader is removed after 60 of 90 s
    apart = np.diff(places[before], axis=0)
    if np.ptp(places[:, -1, 0]) < STANDSTILL:
        return None
    return float(np.abs(np.hypot(*apart.T) - STANDSTILL - HEADWAY * SPEED).max())
