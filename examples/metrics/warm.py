"""A custom metric, for examples/beeclust.yaml: `--metrics examples/metrics/warm.py:warm`."""

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace


@metric(unit="share", better="more")
def warm(trace: Trace) -> Array:
    """Robots within 1 m of the warm spot."""
    away = np.hypot(trace.pose[..., 0] - 1.5, trace.pose[..., 1])
    share: Array = (away < 1.0).mean(axis=1)
    return share
