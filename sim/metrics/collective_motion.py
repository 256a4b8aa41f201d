"""Alignment of a swarm, and the path of its centroid.

A robot's direction is its direction of motion, not its yaw: robots may reverse or slide, and a row
of parallel robots at rest is no flock. A robot slower than STANDING counts as a zero vector, so
that a swarm at rest scores 0. Only present robots count.
"""

from __future__ import annotations

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics.metric import Metric, late_mean
from swarmd.sim.metrics.window import centroids, presence, row_means
from swarmd.sim.trace import Trace

STANDING = 0.01
"""Speed in m/s below which a robot stands."""


def polarisations(trace: Trace) -> Array:
    """(T,) the length of the mean direction of motion: 1 if all move in one direction.

    The order parameter of Vicsek et al. 1995 (Phys. Rev. Lett. 75, 1226). The particles of Vicsek
    never stand; here a robot that stands counts as a zero vector. NaN while no robot is present,
    and in a trace of one instant.
    """
    is_present = presence(trace)
    ahead = _directions(trace)
    order: Array = np.hypot(
        row_means(ahead[..., 0], is_present), row_means(ahead[..., 1], is_present)
    )
    return order


def centroid_path_lengths(trace: Trace, every: float = 1.0) -> Array:
    """(T,) the path length in m of the centroid up to each instant, in steps of `every` s.

    Ours: in a swarm that mills or disperses, robots are fast but the centroid hardly moves. Long
    steps suppress jitter of the positions. A step in which the set of present robots changes, or is
    empty, adds nothing.
    """
    is_present = presence(trace)
    centre = centroids(trace)
    lengths = np.zeros(len(trace.t))
    last = 0
    for at in range(1, len(trace.t)):
        lengths[at] = lengths[at - 1]
        if trace.t[at] - trace.t[last] >= every - 1e-9:
            is_same = bool((is_present[at] == is_present[last]).all() and is_present[at].any())
            lengths[at] += float(np.hypot(*(centre[at] - centre[last]))) if is_same else 0.0
            last = at
    return lengths


def centroid_path_length(trace: Trace) -> float | None:
    """`centroid_path_lengths` at the last instant; None if no robot is ever present."""
    return float(centroid_path_lengths(trace)[-1]) if presence(trace).any() else None


def _directions(trace: Trace) -> Array:
    """(T, n, 2) unit vectors of motion by central differences, 0 for a standing robot."""
    instants = len(trace.t)
    if instants < 2:
        return np.full((instants, len(trace.ids), 2), np.nan)
    before = np.maximum(np.arange(instants) - 1, 0)
    after = np.minimum(np.arange(instants) + 1, instants - 1)
    step = trace.pose[after, :, :2] - trace.pose[before, :, :2]
    length = np.hypot(step[..., 0], step[..., 1])
    is_moving = length > STANDING * (trace.t[after] - trace.t[before])[:, None]
    unit: Array = np.where(is_moving, 1.0 / np.where(is_moving, length, 1.0), 0.0)[..., None] * step
    return unit


METRICS = (
    Metric("polarisation", "0 to 1",
           "length of the mean direction of motion, mean of the last 60 s; 0 at rest",
           "Vicsek et al. 1995, Phys. Rev. Lett. 75", late_mean(polarisations), polarisations),
    Metric("centroid_path_length", "m", "path length of the centroid, in steps of a second", "ours",
           centroid_path_length, centroid_path_lengths),
)  # fmt: skip
