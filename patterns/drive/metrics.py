"""Metrics of drive: three robots drive towards a wall, and one on a circle, as in the scenario."""

from __future__ import annotations

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics.clearance import clearance
from swarmd.sim.metrics.own import metric
from swarmd.sim.trace import Trace

LIMITS = {"burger": 0.22, "waffle": 0.26, "jackal": 0.5}
"""m/s, of the platforms' files."""
CIRCLE = 0.15 / 0.3
"""Radius in m from speed and turn rate of the scenario's circle."""
_UNDER_WAY = (2.0, 6.0)
_LATE = 5.0  # s at the end


@metric(better="less")
def speed_error(trace: Trace) -> float:
    """The largest relative error of a speed ahead, of those that drive towards the wall."""
    since, until = np.searchsorted(trace.t, _UNDER_WAY)
    seconds = float(trace.t[until] - trace.t[since])
    errors = []
    for name, limit in LIMITS.items():
        path = _path(trace, name)
        errors.append(abs(float(path[until, 0] - path[since, 0]) / seconds / limit - 1.0))
    return max(errors)


@metric(unit="m", better="less")
def most_aside(trace: Trace) -> float:
    """The largest distance of a robot from its line."""
    return max(float(np.abs(_path(trace, name)[:, 1]).max()) for name in LIMITS)


@metric(unit="m", better="less")
def late_path(trace: Trace) -> float:
    """The longest way of a robot in the last 5 s, from place to place."""
    late = np.searchsorted(trace.t, trace.t[-1] - _LATE)
    paths = [_path(trace, name) for name in LIMITS]
    return max(float(np.hypot(*(path[-1] - path[late]))) for path in paths)


@metric(unit="m", better="more")
def to_the_wall(trace: Trace) -> float | None:
    """The least distance of a footprint from the wall."""
    return clearance(trace)


@metric(better="less")
def radius_error(trace: Trace) -> float | None:
    """The relative error of the radius of the circle; None if the robot stands."""
    around = _path(trace, "circle") - (0.0, CIRCLE)
    if np.ptp(around[:, 0]) < CIRCLE:  # it is on the circle, too
        return None
    return float(np.abs(np.hypot(*around.T) / CIRCLE - 1.0).max())


def _path(trace: Trace, name: str) -> Array:
    """(T, 2) position in m, forward and left of the start of a robot."""
    pose = trace.pose[:, trace.ids.index(name)]
    cos = np.cos(pose[0, 2])
    sin = np.sin(pose[0, 2])
    step = pose[:, :2] - pose[0, :2]
    return np.column_stack(
        (cos * step[:, 0] + sin * step[:, 1], cos * step[:, 1] - sin * step[:, 0])
    )
