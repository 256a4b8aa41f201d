"""Aggregation: distance to the centroid, clusters and nearest neighbours.

The authors of ROS2swarm (Kaiser et al., ICRA 2022) propose the mean distance to the centroid as the
measure of aggregation. They also speak of groups, which the metrics of clusters define exactly.
Absent robots do not count.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.metrics import pairs
from swarmd.sim.metrics.metric import SHARE, Metric, at_end, at_start, late_mean, peak
from swarmd.sim.metrics.window import LATE, by_platform, centroids, late, presence, row_means
from swarmd.sim.trace import Trace

LINKS = 2.0
"""Length of a link between robots of one cluster, in protection thresholds."""


def distance_to_centroid(trace: Trace) -> Array:
    """(T,) the robots' mean distance in m to the mean of their positions (axle centres).

    Named in the outlook of Kaiser et al. 2022. NaN while no robot is present.
    """
    away = trace.pose[..., :2] - centroids(trace)[:, None]
    return row_means(np.hypot(away[..., 0], away[..., 1]), presence(trace))


def distance_at(trace: Trace, time: float) -> float | None:
    """The mean distance to the centroid `time` s after the start; None if the run is shorter."""
    at = int(np.searchsorted(trace.t - trace.t[:1], time - 1e-9))
    return float(distance_to_centroid(trace)[at]) if at < len(trace.t) else None


def cluster_link(trace: Trace) -> float | None:
    """The distance in m within which two robots are linked in a cluster.

    Twice the largest protection threshold of the robots; None if the trace has no threshold. The
    definition is ours: Kaiser et al. 2022 give no number for their clusters.
    """
    thresholds = by_platform(trace, "thresholds")
    largest = 0.0 if thresholds is None else float(thresholds.max(initial=0.0))
    return LINKS * largest if largest > 0.0 else None


def clusters(trace: Trace, link: float) -> NDArray[np.int64]:
    """(T, n) for each robot the lowest index in its cluster; -1 for an absent robot.

    Single linkage (Sneath 1957): a cluster is a chain of robots, each within `link` m of the next
    (axle centres).
    """
    is_present = presence(trace)
    instants, n = is_present.shape
    labels = np.full((instants, n), -1, dtype=np.int64)
    for span in pairs.spans(instants, n):
        links = pairs.near(trace.pose[span, :, :2], is_present[span], link)
        size = len(labels[span]) * n
        # Nodes are numbered instant * n + robot, so that the remainder by n is the robot.
        joined = pairs.components(size, links.instant * n + links.a, links.instant * n + links.b)
        labels[span] = joined.reshape(labels[span].shape) % max(n, 1)
    labels[~is_present] = -1
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
    """(T,) the share of present robots in the largest cluster; NaN without a present robot."""
    present = presence(trace).sum(axis=1)
    share: Array = np.where(
        present > 0, largest_cluster(trace, link) / np.maximum(present, 1), np.nan
    )
    return share


def is_one_cluster(trace: Trace, link: float) -> NDArray[np.bool_]:
    """(T,) whether all present robots are in one cluster; false without one."""
    is_one: NDArray[np.bool_] = cluster_counts(trace, link) == 1
    return is_one


def gather_time(trace: Trace, link: float, share: float = 0.5) -> float | None:
    """Seconds until all robots first are in one cluster and close to their centroid.

    The robots are close if their mean distance to the centroid is at most `share` of the mean
    distance at the start. None if this never happens. The metric is our own, to compare how fast
    swarms gather.
    """
    away = distance_to_centroid(trace)
    if len(away) == 0:
        return None
    is_there = np.flatnonzero((away <= share * away[0]) & is_one_cluster(trace, link))
    return float(trace.t[is_there[0]] - trace.t[0]) if len(is_there) else None


def nearest_neighbors(trace: Trace) -> Array:
    """(T, n) the distance in m to the nearest other present robot (axle centres).

    Clark and Evans 1954. NaN for an absent robot, inf for a lone one.
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


def _linked(of: Callable[[Trace, float], Any]) -> Callable[[Trace], Any]:
    """A series or number that needs the link of clusters; None if the trace has no thresholds."""

    def linked(trace: Trace) -> Any:
        link = cluster_link(trace)
        result = None if link is None else of(trace, link)
        return result.astype(np.float64) if isinstance(result, np.ndarray) else result

    return linked


_KAISER = "Kaiser et al. 2022, ICRA"
_SNEATH = "single linkage: Sneath 1957; the link, 2 x protection threshold: ours"

METRICS = (
    Metric("mean_distance_to_centroid_start", "m",
           "robots' mean distance to their centroid at the start", _KAISER,
           at_start(distance_to_centroid), distance_to_centroid),
    Metric("mean_distance_to_centroid_30s", "m",
           "robots' mean distance to their centroid after 30 s", _KAISER,
           lambda trace: distance_at(trace, 30.0), distance_to_centroid),
    Metric("mean_distance_to_centroid_late", "m",
           "robots' mean distance to their centroid, mean of the last 60 s", _KAISER,
           late_mean(distance_to_centroid), distance_to_centroid),
    Metric("mean_distance_to_centroid_end", "m",
           "robots' mean distance to their centroid at the end", _KAISER,
           at_end(distance_to_centroid), distance_to_centroid),
    Metric("clusters_end", "", "number of clusters at the end, lone robots included", _SNEATH,
           at_end(_linked(cluster_counts)), _linked(cluster_counts)),
    Metric("largest_cluster", "robots", "robots in the largest cluster at the end", _SNEATH,
           at_end(_linked(largest_cluster)), _linked(largest_cluster)),
    Metric("largest_cluster_share", "share",
           "share of the robots present that are in the largest cluster at the end", _SNEATH,
           at_end(_linked(largest_cluster_share)), _linked(largest_cluster_share), bounds=SHARE),
    Metric("largest_cluster_peak", "robots", "robots in the largest cluster of the whole run",
           _SNEATH, peak(_linked(largest_cluster)), _linked(largest_cluster)),
    Metric("one_cluster_at_end", "0 or 1", "whether all robots are in one cluster at the end",
           _SNEATH, at_end(_linked(is_one_cluster)), _linked(is_one_cluster), bounds=SHARE),
    Metric("time_in_one_cluster_late", "share",
           "share of the last 60 s in which all are in one cluster", _SNEATH,
           late_mean(_linked(is_one_cluster)), _linked(is_one_cluster), bounds=SHARE),
    Metric("gather_time", "s",
           "until all are in one cluster and half as far from the centroid as at the start", "ours",
           _linked(gather_time), is_time_to_event=True, event="gathering"),
    Metric("nearest_neighbor_median_late", "m",
           "median distance to the nearest other robot in the last 60 s",
           "Clark and Evans 1954, Ecology 35", nearest_neighbor_median, nearest_neighbor_medians),
)  # fmt: skip
