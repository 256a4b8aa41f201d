"""Items that robots have delivered, in the disc `nest` of their kind (world/item_kind.py)."""

from __future__ import annotations

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics.metric import Metric
from swarmd.sim.trace import Trace
from swarmd.sim.world.item_kind import DELIVERED


def items_delivered(trace: Trace) -> float | None:
    """Items for each robot and minute; None for a run without items that can be delivered."""
    values = delivered(trace)
    if values is None or not trace.duration:
        return None
    return float(values[-1] - values[0]) / len(trace.ids) / (trace.duration / 60.0)


def delivered(trace: Trace) -> Array | None:
    """(T,) the items that all robots have delivered so far; None without the reading."""
    counts = trace.readings.get(DELIVERED)
    if counts is None:
        return None
    known = np.fmax.accumulate(counts, axis=0)  # the count of a robot that has no reading now stays
    total: Array = np.nansum(known, axis=1)
    return total


METRICS = (
    Metric("items_delivered", "1/min", "items that a robot delivers in a minute, on average",
           "ours", items_delivered, better="more"),
)  # fmt: skip
