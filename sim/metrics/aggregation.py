"""How a swarm gathers.

The authors of ROS2swarm (Kaiser et al., ICRA 2022) name the mean distance to the centroid as the
number that aggregation should be judged by, and speak of groups; the rest makes that exact.
Robots whose daemon is not there (`present`) are no part of the swarm and are left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from swarmd.sim.metrics import pairs
from swarmd.sim.metrics.window import LATE, by_platform, late, presence, row_means
from swarmd.sim.trace import Trace
from swarmd.values import Array

LINKS = 2.0
"""Robots are of one cluster within so many protection thresholds."""


def distance_to_centroid(trace: Trace) -> Array:
    """(T,) the robots' mean distance in m to the mean of their positions (axle centres).

    Named in the outlook of Kaiser et al. 2022. NaN while no robot is present.
    """
    is_here = presence(trace)
    centre = np.stack([row_means(trace.pose[..., axis], is_here) for axis in (0, 1)], axis=-1)
    away = trace.pose[..., :2] - centre[:, None]
    return row_means(np.hypot(away[..., 0], away[..., 1]), is_here)


def distance_at(trace: Trace, time: float) -> float | None:
    """The mean distance to the centroid `time` s after the start; None if the run is shorter."""
    at = int(np.searchsorted(trace.t - trace.t[:1], time - 1e-9))
    return float(distance_to_centroid(trace)[at]) if at < len(trace.t) else None


def cluster_link(trace: Trace) -> float | None:
    """The distance in m within which two robots belong together: twice the largest threshold.

    Of the protection of the robots there are; None if the trace does not say. Ours: the paper
    gives no number for what it calls a cluster.
    """
    thresholds = by_platform(trace, "thresholds")
    return None if thresholds is None or len(thresholds) == 0 else LINKS * float(thresholds.max())


def clusters(trace: Trace, link: float) -> NDArray[np.int64]:
    """(T, n) for each robot the lowest index in its cluster; -1 for one that is not present.

    Single linkage (Sneath 1957): robots belong together if a chain of robots, each within `link`
    m of the next (axle centres), joins them.
    """
    is_here = presence(trace)
    instants, n = is_here.shape
    labels = np.full((instants, n), -1, dtype=np.int64)
    for span in pairs.spans(instants, n):
        found = pairs.near(trace.pose[span, :, :2], is_here[span], link)
        size = len(labels[span]) * n
        joined = pairs.components(size, found.instant * n + found.a, found.instant * n + found.b)
        labels[span] = joined.reshape(labels[span].shape) % max(n, 1)
    labels[~is_here] = -1
    return labels


def cluster_counts(trace: Trace, link: float) -> NDArray[np.int64]:
    """(T,) the number of clusters, lone robots included."""
    own = np.arange(len(trace.ids))
    counts: NDArray[np.int64] = np.count_nonzero(clusters(trace, link) == own, axis=1)
    return counts


def largest_cluster(trace: Trace, link: float) -> NDArray[np.int64]:
    """(T,) the number of robots in the largest cluster."""
    labels = clusters(trace, link)
    instants, n = labels.shape
    instant, robot = np.nonzero(labels >= 0)
    sizes = np.bincount(instant * n + labels[instant, robot], minlength=instants * n)
    largest: NDArray[np.int64] = sizes.reshape(instants, n).max(axis=1, initial=0)
    return largest


def largest_cluster_share(trace: Trace, link: float) -> Array:
    """(T,) the share of the robots present that are in the largest cluster; NaN if none is."""
    present = presence(trace).sum(axis=1)
    share: Array = np.where(
        present > 0, largest_cluster(trace, link) / np.maximum(present, 1), np.nan
    )
    return share


def is_one_cluster(trace: Trace, link: float) -> NDArray[np.bool_]:
    """(T,) whether all robots present are in one cluster; false while none is."""
    is_one: NDArray[np.bool_] = cluster_counts(trace, link) == 1
    return is_one


def gather_time(trace: Trace, link: float, share: float = 0.5) -> float | None:
    """Seconds until first all are in one cluster and the distance to the centroid is down.

    Down to `share` of what it was at the start. Ours, for comparing how fast swarms gather; None
    if that never is.
    """
    away = distance_to_centroid(trace)
    if len(away) == 0:
        return None
    is_there = np.flatnonzero((away <= share * away[0]) & is_one_cluster(trace, link))
    return float(trace.t[is_there[0]] - trace.t[0]) if len(is_there) else None


def nearest_neighbors(trace: Trace) -> Array:
    """(T, n) how far in m the nearest other present robot is (axle centres).

    Clark and Evans 1954. NaN for a robot that is not present, inf for one that is alone.
    """
    return pairs.nearest(trace.pose[..., :2], presence(trace))


def nearest_neighbor_medians(trace: Trace) -> Array:
    """(T,) the median of those distances over the robots; NaN while fewer than two are present."""
    distance = nearest_neighbors(trace)
    is_known = np.isfinite(distance)
    medians = np.full(len(distance), np.nan)
    rows = is_known.any(axis=1)
    medians[rows] = np.nanmedian(np.where(is_known, distance, np.nan)[rows], axis=1)
    return medians


def nearest_neighbor_median(trace: Trace, seconds: float = LATE) -> float | None:
    """The median of those distances over all robots and the last `seconds`; None if alone."""
    distance = nearest_neighbors(late(trace, seconds))
    known = distance[np.isfinite(distance)]
    return float(np.median(known)) if len(known) else None
