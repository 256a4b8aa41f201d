"""Pairs of points that are near, at every instant at once: by cells where there are many."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array

Ints = NDArray[np.int64]
FEW = 40
"""Up to so many points all pairs are looked at: that is faster than cells."""
AT_ONCE = 20_000
"""So many points, of all instants taken together, are worked on at once: it bounds the memory."""
_HALF = ((0, 1), (1, -1), (1, 0), (1, 1))  # each pair of adjacent cells once


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Pairs (p,): at which instant, which two points a < b, and how far apart in m."""

    instant: Ints
    a: Ints
    b: Ints
    distance: Array


def spans(instants: int, points: int) -> Iterator[slice]:
    """Slices of the instants that are small enough to be worked on at once."""
    step = max(1, AT_ONCE // max(points, 1))
    for start in range(0, instants, step):
        yield slice(start, min(start + step, instants))


def near(place: Array, is_in: NDArray[np.bool_], reach: float) -> Pairs:
    """The pairs of points (T, n, 2) within `reach` m, of those in (T, n)."""
    if place.shape[1] <= FEW:
        return _among_few(place, is_in, reach)
    return _among_many(place, is_in, reach)


def chosen(found: Pairs, is_chosen: NDArray[np.bool_]) -> Pairs:
    """Those of the pairs for which (p,) is true."""
    return Pairs(
        found.instant[is_chosen], found.a[is_chosen], found.b[is_chosen], found.distance[is_chosen]
    )


def nearest(place: Array, is_in: NDArray[np.bool_]) -> Array:
    """(T, n) how far the nearest other point is; NaN for what is not in, inf for one alone."""
    best = np.where(is_in, np.inf, np.nan)
    for span in spans(*place.shape[:2]):
        _note_nearest(best[span], place[span], is_in[span])
    return best


def components(nodes: int, a: Ints, b: Ints) -> Ints:
    """(nodes,) the lowest node that edges (a, b) join each one to, by itself or over others.

    Union-find, all edges at once: a higher root hooks onto a lower one, then paths are halved
    (Shiloach and Vishkin 1982, without their machine).
    """
    label = np.arange(nodes)
    while len(a):
        root_a, root_b = label[a], label[b]
        is_apart = root_a != root_b
        a, b, root_a, root_b = a[is_apart], b[is_apart], root_a[is_apart], root_b[is_apart]
        np.minimum.at(label, np.maximum(root_a, root_b), np.minimum(root_a, root_b))
        while not np.array_equal(label, up := label[label]):
            label = up
    return label


def _note_nearest(best: Array, place: Array, is_in: NDArray[np.bool_]) -> None:
    inside = place[is_in]
    if len(inside) == 0:
        return
    extent = np.ptp(inside, axis=0).max()
    # In a square strewn evenly most have a neighbour so near; the rest looks at all the others.
    reach = np.inf if place.shape[1] <= FEW else 2.0 * extent / np.sqrt(place.shape[1])
    found = near(place, is_in, reach)
    np.minimum.at(best, (found.instant, found.a), found.distance)
    np.minimum.at(best, (found.instant, found.b), found.distance)
    for instant, point in np.argwhere(np.isinf(best)):
        away = place[instant] - place[instant, point]
        distance = np.where(is_in[instant], np.hypot(away[:, 0], away[:, 1]), np.inf)
        distance[point] = np.inf
        best[instant, point] = distance.min()


def _among_few(place: Array, is_in: NDArray[np.bool_], reach: float) -> Pairs:
    a, b = np.triu_indices(place.shape[1], 1)
    away = place[:, a] - place[:, b]
    distance = np.hypot(away[..., 0], away[..., 1])
    instant, pair = np.nonzero((distance <= reach) & is_in[:, a] & is_in[:, b])
    return Pairs(instant, a[pair], b[pair], distance[instant, pair])


def _among_many(place: Array, is_in: NDArray[np.bool_], reach: float) -> Pairs:
    instant, point = np.nonzero(is_in)
    where = place[instant, point]
    if len(where) == 0:
        return _among_few(place[:, :0], is_in[:, :0], reach)
    extent = float(np.ptp(where, axis=0).max())
    # A little wider, lest rounding put two that are just within reach two cells apart.
    cell = min(max(reach * (1.0 + 1e-9), 1e-6 * extent, 1e-9), 2.0 * extent + 1.0)
    column = np.floor((where - where.min(axis=0)) / cell).astype(np.int64)
    # A column left free at each side: a neighbouring cell is never one of another row or instant.
    width = int(column.max()) + 3
    key = (instant * width + column[:, 0] + 1) * width + column[:, 1] + 1
    order = np.argsort(key, kind="stable")
    key = key[order]
    found = [_runs(np.arange(len(key)), np.arange(1, len(key) + 1), _end(key, key))]
    for right, up in _HALF:
        wanted = key + right * width + up
        found.append(_runs(np.arange(len(key)), np.searchsorted(key, wanted), _end(key, wanted)))
    one = order[np.concatenate([i for i, _ in found])]
    other = order[np.concatenate([j for _, j in found])]
    away = where[one] - where[other]
    distance = np.hypot(away[:, 0], away[:, 1])
    is_near = distance <= reach
    one, other = one[is_near], other[is_near]
    a, b = np.minimum(point[one], point[other]), np.maximum(point[one], point[other])
    return Pairs(instant[one], a, b, distance[is_near])


def _end(key: Ints, wanted: Ints) -> Ints:
    return np.searchsorted(key, wanted, side="right").astype(np.int64)


def _runs(one: Ints, start: Ints, stop: Ints) -> tuple[Ints, Ints]:
    """Each of `one` with every number of its run [start, stop)."""
    count = np.maximum(stop - start, 0)
    before = np.cumsum(count) - count
    other = np.arange(int(count.sum())) + np.repeat(start - before, count)
    return np.repeat(one, count), other
