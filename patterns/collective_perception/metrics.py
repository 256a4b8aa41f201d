"""Metrics of collective perception: whether the robots agree on the right colour."""

from __future__ import annotations

from swarmd.sim.metrics.consensus import consensus_opinion
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

BLACK = 0.0
"""The opinion that is right."""


@metric(unit="0 or 1", better="more")
def agree_on_black(trace: Trace) -> bool:
    """Whether all robots hold the opinion black at the end."""
    return consensus_opinion(trace) == BLACK
