"""Where something has come too near to be seen, for a sensor that says nothing of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from swarmd.values import Array, Scan

LASTS = 30.0
"""Seconds for which it is remembered where nothing shows that it has gone."""

_SHIFT = math.radians(12.0)  # by which what is in the blind zone may have moved between two scans
_RUN = 3  # rays side by side without a return: fewer are lost ones

Mask = NDArray[np.bool_]


class NearMemory:
    """The bearings (n,) rad, in the base frame of the last scan, along which something is hidden.

    A sensor that is blind nearby gives no return for what is there. So a ray that has a return
    proves its part of the blind zone empty, and one that has none may be hidden or see nothing:
    hidden it is if something was near there before. That moves with its shadow, and is forgotten
    once a return shows its place to be empty, or itself to be out again. A memory that is not
    cleared so would hold the robot for ever.
    """

    def __init__(self, range_min: float, band: float) -> None:
        """Blind within `range_min` m; between two scans things come up to `band` m nearer."""
        self._rim, self._out = range_min + band, range_min + 2.0 * band
        self._near = np.empty(0)
        self.bearings = np.empty(0)
        self.ages = np.empty(0)

    def update(self, scan: Scan, turned: float, seconds: float) -> None:
        """Take in a scan; since the one before the base has turned by so many rad."""
        if len(self._near) or len(self.bearings):
            bearings = np.concatenate((self.bearings, self._near)) - turned
            ages = np.concatenate((self.ages, np.zeros(len(self._near)))) + seconds
            self.bearings, self.ages = self._shadows(scan, bearings, ages)
        # What is too close to measure is near as well.
        self._near = scan.bearings[scan.ranges <= self._rim]

    def _shadows(self, scan: Scan, bearings: Array, ages: Array) -> tuple[Array, Array]:
        """Where those at `bearings` hide now: at the nearest ray of a run without a return."""
        shadows = scan.bearings[_in_runs(scan.ranges == np.inf)]
        if not len(shadows):
            return shadows, shadows
        place, off = _nearest(shadows, bearings)
        is_hidden = (off <= _SHIFT) & (ages < LASTS)
        seen = scan.bearings[(scan.ranges <= self._out) & (scan.ranges > -np.inf)]
        if len(seen):
            is_hidden &= _nearest(seen, bearings)[1] > _SHIFT
        rays, first = np.unique(place[is_hidden], return_index=True)
        return shadows[rays], ages[is_hidden][first]


def _nearest(bearings: Array, wanted: Array) -> tuple[NDArray[np.intp], Array]:
    """For each of `wanted` (k,) the nearest of `bearings` (n,), and how far off it is, in rad."""
    turn = 2.0 * np.pi
    order = np.argsort(bearings % turn)
    rising = bearings[order] % turn
    after = np.searchsorted(rising, wanted % turn) % len(rising)
    pair = np.stack((after, after - 1))
    off = np.abs((rising[pair] - wanted + np.pi) % turn - np.pi)
    nearer = off.argmin(axis=0)
    column = np.arange(len(wanted))
    return order[pair[nearer, column]], off[nearer, column]


def _in_runs(is_empty: Mask) -> Mask:
    """True for rays without a return among at least `_RUN` such side by side."""
    n = len(is_empty)
    if n < _RUN or not is_empty.any():
        return np.zeros(n, np.bool_)
    around = np.concatenate((is_empty[1 - _RUN :], is_empty, is_empty[: _RUN - 1]))
    windows = np.asarray(sliding_window_view(around, _RUN).all(axis=1))
    found: Mask = np.asarray(sliding_window_view(windows, _RUN).any(axis=1))
    return found
