"""The rays of one kind of range sensor: which of them fall into an interval of bearings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from swarmd.values import Array

Places = NDArray[np.intp]

_TURNS = 2.0 * np.pi * np.array([-2.0, -1.0, 0.0, 1.0])
# Widens each interval, so that no ray slips between two surfaces that share a corner.
_SEAM = 1e-12
# What rays may differ from equal steps for their places to be worked out instead of searched.
_EVEN = 1e-13


class Rays:
    """Rays in order of bearing, four turns long, so that no interval is cut in two.

    By place in that order: `number` in the sweep, `cos` and `sin` of the bearing.
    """

    def __init__(self, bearings: Array) -> None:
        """`bearings` (n,) rad of a sweep, in any order."""
        wrapped = np.mod(bearings + np.pi, 2.0 * np.pi) - np.pi
        order = np.argsort(wrapped, kind="stable")
        self.number = np.tile(order, len(_TURNS))
        self.cos = np.tile(np.cos(bearings[order]), len(_TURNS))
        self.sin = np.tile(np.sin(bearings[order]), len(_TURNS))
        self._bearings = np.add.outer(_TURNS, wrapped[order]).ravel()
        self._step = 2.0 * np.pi / max(len(order), 1)
        even = self._bearings[:1] + self._step * np.arange(len(self._bearings))
        self._is_even = np.allclose(even, self._bearings, rtol=0.0, atol=_EVEN)

    def within(self, low: Array, high: Array) -> tuple[Places, Places]:
        """The places of the rays in each interval (k,) of bearings, and how many it has (k,).

        The intervals one after another, each within -5 pi and 3 pi.
        """
        first = self._place(low - _SEAM)
        counts = self._place(high + _SEAM) - first
        end = counts.cumsum()
        places = (first - end + counts).repeat(counts)
        places += np.arange(len(places))
        return places, counts

    def _place(self, bearing: Array) -> Places:
        """How many rays have lesser bearings."""
        if not self._is_even:
            return np.searchsorted(self._bearings, bearing)
        place: Array = np.ceil((bearing - self._bearings[0]) / self._step)
        return place.astype(np.intp)
