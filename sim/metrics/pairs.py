"""Pairs of nearby points at many instants at once, and the groups that they form.

scipy is imported by the functions that use it: it takes a tenth of a second.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array

Ints = NDArray[np.int64]
MAX_POINTS = 20_000
"""Points of all instants together that are processed at once; bounds the memory."""
FEW = 40
"""Up to this many points, comparing all pairs is faster than a tree."""
_MARGIN = 1.0 + 1e-9  # the tree compares squared distances; `near` compares distances


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Pairs (p,): the instant, the indices a < b of the two points, and their distance in m."""

    instant: Ints
    a: Ints
    b: Ints
    distance: Array


def spans(instants: int, points: int) -> Iterator[slice]:
    """Consecutive slices of the instants, of at most MAX_POINTS points or one instant each."""
    step = max(1, MAX_POINTS // max(points, 1))
    for start in range(0, instants, step):
        yield slice(start, min(start + step, instants))


def near(place: Array, is_in: NDArray[np.bool_], reach: float) -> Pairs:
    """The pairs of points `place` (T, n, 2) within `reach` m of each other at the same instant.

    Only points with `is_in` (T, n) count.
    """
    if place.shape[1] <= FEW:
        a, b = np.triu_indices(place.shape[1], 1)
        away = place[:, a] - place[:, b]
        distance = np.hypot(away[..., 0], away[..., 1])
        instant, pair = np.nonzero((distance <= reach) & is_in[:, a] & is_in[:, b])
        return Pairs(instant, a[pair], b[pair], distance[instant, pair])
    instant, point = np.nonzero(is_in)
    where = place[instant, point]
    span = min(reach, _diagonal(where)) * _MARGIN
    rows = _tree(where, instant, span).query_pairs(span, output_type="ndarray").T
    first, second = rows.astype(np.int64)  # in (T, n) order, so that point[first] < point[second]
    away = where[first] - where[second]
    distance = np.hypot(away[:, 0], away[:, 1])
    pairs = Pairs(instant[first], point[first], point[second], distance)
    return chosen(pairs, distance <= reach)


def chosen(pairs: Pairs, is_chosen: NDArray[np.bool_]) -> Pairs:
    """The pairs for which `is_chosen` (p,) is true."""
    return Pairs(
        pairs.instant[is_chosen], pairs.a[is_chosen], pairs.b[is_chosen], pairs.distance[is_chosen]
    )


def nearest(place: Array, is_in: NDArray[np.bool_]) -> Array:
    """(T, n) distance in m from each point of `place` (T, n, 2) to its nearest neighbor.

    `is_in` (T, n): whether a point counts at an instant. Neighbors are the other points that count
    at the same instant. NaN for a point that does not count, inf for a point without a neighbor.
    """
    best = np.where(is_in, np.inf, np.nan)
    for span in spans(*place.shape[:2]):
        if place.shape[1] <= FEW:
            close = near(place[span], is_in[span], np.inf)
            np.minimum.at(best[span], (close.instant, close.a), close.distance)
            np.minimum.at(best[span], (close.instant, close.b), close.distance)
            continue
        instant, point = np.nonzero(is_in[span])
        where = place[span][instant, point]
        if len(where) < 2:
            continue
        tree = _tree(where, instant, _diagonal(where))
        # The two nearest points of each point are the point itself and its neighbor. If points
        # coincide, the point itself may come second.
        first, second = tree.query(tree.data, k=2)[1].T
        neighbor = np.where(second == np.arange(len(where)), first, second)
        away = np.hypot(*(where - where[neighbor]).T)
        best[span][instant, point] = np.where(instant[neighbor] == instant, away, np.inf)
    return best


def components(nodes: int, a: Ints, b: Ints) -> Ints:
    """(nodes,) the lowest node of the connected component of each node; edges are (a, b)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(nodes, nodes))
    label = connected_components(edges, directed=False)[1]
    lowest: Ints = np.unique(label, return_index=True)[1]
    named: Ints = lowest[label]
    return named


def _diagonal(where: Array) -> float:
    """The diagonal in m of the box around points (k, 2)."""
    return float(np.hypot(*np.ptp(where, axis=0))) if len(where) else 0.0


def _tree(where: Array, instant: Ints, reach: float) -> Any:
    """A k-d tree of points (k, 2); a third coordinate keeps instants farther apart than `reach`."""
    from scipy.spatial import cKDTree

    return cKDTree(np.column_stack((where, instant * (2.0 * reach + 1.0))))
