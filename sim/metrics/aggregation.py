"""Numbers of a run: pure functions over a `Trace`.

Those of aggregation follow what the paper's authors ask for (Kaiser et al., ICRA 2022, outlook:
mean distance to the centroid) and what its figures show (groups).
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from swarmd.sim.trace import ARENA, Trace
from swarmd.sim.world.contacts import Episodes
from swarmd.sim.world.geometry import gaps, radius, transform
from swarmd.values import Array

WALLS = "the arena"
"""Stands for walls, boxes and poles among robot ids; no id holds a blank."""


def distance_to_centroid(trace: Trace) -> Array:
    """(T,) the robots' mean distance in m to the mean of their positions (axle centres)."""
    place = trace.pose[..., :2]
    away = place - place.mean(axis=1, keepdims=True)
    distance: Array = np.hypot(away[..., 0], away[..., 1]).mean(axis=1)
    return distance


def clusters(trace: Trace, link: float) -> NDArray[np.int64]:
    """(T, n) for each robot the lowest index in its cluster.

    Single linkage (Sneath 1957): robots belong together if a chain of robots, each within `link`
    m of the next (axle centres), joins them.
    """
    labels = np.tile(np.arange(len(trace.ids)), (len(trace.t), 1))
    for instant, place in enumerate(trace.pose[..., :2]):
        away = place[:, None] - place[None]
        labels[instant] = _components(np.hypot(away[..., 0], away[..., 1]) <= link)
    return labels


def cluster_counts(trace: Trace, link: float) -> NDArray[np.int64]:
    """(T,) the number of clusters, lone robots included."""
    labels = np.sort(clusters(trace, link), axis=1)
    counts: NDArray[np.int64] = 1 + np.count_nonzero(np.diff(labels, axis=1), axis=1)
    return counts


def largest_cluster(trace: Trace, link: float) -> NDArray[np.int64]:
    """(T,) the number of robots in the largest cluster."""
    labels = clusters(trace, link)
    sizes: NDArray[np.int64] = np.sum(labels[:, :, None] == labels[:, None, :], axis=2)
    largest: NDArray[np.int64] = np.max(sizes, axis=1, initial=0)
    return largest


def contact_episodes(trace: Trace) -> dict[tuple[str, str], int]:
    """How often each pair touched; WALLS stands for walls, boxes and poles."""
    episodes = Episodes()
    for time, (a, b) in zip(trace.contact_t, trace.contact_pair, strict=True):
        other = WALLS if b == ARENA else trace.ids[b]
        episodes.add(float(time), trace.ids[a], other)
    return episodes.counts


def contacts_between_robots(trace: Trace) -> int:
    """The number of touches of two robots."""
    return sum(n for pair, n in contact_episodes(trace).items() if WALLS not in pair)


def contacts_with_arena(trace: Trace) -> int:
    """The number of touches of a robot with a wall, box or pole."""
    return sum(n for pair, n in contact_episodes(trace).items() if WALLS in pair)


def minimum_gap(trace: Trace) -> float:
    """The smallest distance in m between two robots' footprints; inf for one robot alone.

    Exact at the trace's instants: footprints as polygons, 0 if they touch or overlap.
    """
    best = np.inf
    for a, b in combinations(range(len(trace.ids)), 2):
        apart = trace.pose[:, a, :2] - trace.pose[:, b, :2]
        reach = radius(trace.footprint(a)) + radius(trace.footprint(b))
        closest_possible = np.hypot(apart[:, 0], apart[:, 1]) - reach
        near = closest_possible < best
        if near.any():
            shape_a = transform(trace.footprint(a), trace.pose[near, a])
            shape_b = transform(trace.footprint(b), trace.pose[near, b])
            best = min(best, float(gaps(shape_a, shape_b).min()))
    return float(best)


def protection_duty(trace: Trace) -> float | None:
    """The share of robot-instants in which protection changed the wish; None if not recorded."""
    if trace.active is None or trace.active.size == 0:
        return None
    return float(trace.active.mean())


def path_length(trace: Trace) -> Array:
    """(n,) the way in m that each robot's axle centre went."""
    step = np.diff(trace.pose[..., :2], axis=0)
    length: Array = np.hypot(step[..., 0], step[..., 1]).sum(axis=0)
    return length


def mean_speed(trace: Trace, since: float = 0.0) -> float:
    """The robots' mean speed in m/s over the instants from `since` s after the start on."""
    late = trace.t >= trace.t[0] + since if len(trace.t) else np.zeros(0, dtype=bool)
    if late.sum() < 2:
        return 0.0
    step = np.diff(trace.pose[late, :, :2], axis=0)
    seconds = float(trace.t[late][-1] - trace.t[late][0])
    return float(np.hypot(step[..., 0], step[..., 1]).sum() / (seconds * len(trace.ids)))


def _components(is_linked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The lowest index within reach of each node of a symmetric (n, n) graph with loops."""
    n = len(is_linked)
    labels = np.arange(n)
    while True:
        lowest = np.where(is_linked, labels[None, :], n).min(axis=1, initial=n)
        if np.array_equal(lowest, labels):
            return labels
        labels = lowest
