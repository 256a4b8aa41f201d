"""Metrics of source seeking: how many robots are at the peak of the scenario's field, and when."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

SOURCE = (2.0, 1.5)
"""The peak, in m."""
WITHIN = 1.7
"""m from the peak within which a robot has arrived: the reading is 79 % of the peak there."""


@metric(unit="share", better="more", bounds=(0.0, 1.0))
def share_there(trace: Trace) -> float:
    """The share of robots that are at the source at the end."""
    return float(_is_there(trace)[-1].mean())


@metric(unit="s", better="less", is_time_to_event=True)
def median_arrival(trace: Trace) -> float | None:
    """The median over robots of the time at which a robot is first at the source."""
    is_there = _is_there(trace)
    first = np.where(is_there.any(axis=0), trace.t[is_there.argmax(axis=0)], np.inf)
    median = float(np.median(first))
    return median if np.isfinite(median) else None


def _is_there(trace: Trace) -> NDArray[np.bool_]:
    away = np.hypot(trace.pose[..., 0] - SOURCE[0], trace.pose[..., 1] - SOURCE[1])
    return np.asarray(away < WITHIN)
