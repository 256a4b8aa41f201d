"""Which robots can hear each other: by distance, and by what stands between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.geometry import Indices, apart, crossings

_AT_ONCE = 65_536
"""How many pairs of way and obstacle are looked at together."""

_HALF_AROUND = ((0, 0), (1, 0), (-1, 1), (0, 1), (1, 1))


class Sight:
    """What stands between two places: boxes, inner walls and poles, but not robots."""

    def __init__(self, arena: Arena) -> None:
        """What is fixed in the arena; the outer walls stand between no two robots."""
        self._walls, self._poles = arena.surfaces, arena.circles

    def is_clear(self, a: Array, b: Array, things: Array | None = None) -> NDArray[np.bool_]:
        """True where nothing stands between a and b (k, 2), m in the world frame.

        `things` (t, c, 2): the corners of movable boxes; NaN where one is out of the arena.
        """
        walls, poles = self._walls, self._poles
        if things is not None and len(things):
            edges = np.stack((things, np.roll(things, -1, axis=1)), axis=2).reshape(-1, 2, 2)
            walls = np.concatenate((walls, edges))
        is_clear = np.ones(len(a), dtype=np.bool_)
        stride = max(1, _AT_ONCE // max(1, len(walls) + len(poles)))
        for first in range(0, len(a), stride):
            some = slice(first, first + stride)
            here, there = a[some, None], b[some, None]
            is_behind = crossings(here, there, walls[:, 0], walls[:, 1]).any(axis=1)
            if len(poles):
                is_behind |= (apart(poles[:, :2], here, there) < poles[:, 2]).any(axis=1)
            is_clear[some] = ~is_behind
        return is_clear


def all_pairs(n: int) -> Indices:
    """Every two of n, (k, 2), the lower row first, in order."""
    return np.stack(np.triu_indices(n, 1), axis=-1)


def near_pairs(places: Array, reach: float) -> Indices:
    """Every two of `places` (n, 2) at most `reach` m apart: (k, 2), lower row first, in order.

    By cells as wide as the reach, so the cost grows with the pairs and not with n squared.
    """
    # A little wider, lest rounding put two that are just within reach two cells apart.
    cells = np.floor(places / (reach * (1.0 + 1e-9))).astype(np.int64)
    cells -= cells.min(axis=0, initial=np.iinfo(np.int64).max)
    width = int(cells[:, 0].max(initial=0)) + 2
    keys = cells[:, 1] * width + cells[:, 0]
    order = np.argsort(keys, kind="stable")
    in_order = keys[order]
    found = [
        _neighbors(in_order, order, keys + dy * width + dx, is_own=(dx, dy) == (0, 0))
        for dx, dy in _HALF_AROUND
    ]
    pairs = np.concatenate(found)
    way = places[pairs[:, 0]] - places[pairs[:, 1]]
    pairs = pairs[np.hypot(way[:, 0], way[:, 1]) <= reach]
    pairs.sort(axis=1)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _neighbors(in_order: Indices, order: Indices, wanted: Indices, *, is_own: bool) -> Indices:
    """Each row with each of the rows whose cell is the wanted one, (k, 2)."""
    first = np.searchsorted(in_order, wanted, side="left")
    counts = np.searchsorted(in_order, wanted, side="right") - first
    row = np.repeat(np.arange(len(wanted)), counts)
    within = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    pairs = np.stack((row, order[first[row] + within]), axis=-1)
    return pairs[pairs[:, 0] < pairs[:, 1]] if is_own else pairs
