"""Where something has come too near to be seen, for a sensor that says nothing of it."""

from __future__ import annotations

import math

import numpy as np
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
        is_near = scan.ranges <= self._rim  # too close to measure is near as well
        is_out = (scan.ranges <= self._out) & (scan.ranges > -np.inf)
        if len(self._near) or len(self.bearings):
            bearings = np.concatenate((self.bearings, self._near)) - turned
            ages = np.concatenate((self.ages, np.zeros(len(self._near)))) + seconds
            self.bearings, self.ages = self._shadows(scan, is_out, bearings, ages)
        self._near = scan.bearings[is_near]

    def _shadows(
        self, scan: Scan, is_out: Mask, bearings: Array, ages: Array
    ) -> tuple[Array, Array]:
        """Where those at `bearings` hide now: at the nearest ray of a run without a return."""
        off = np.abs((scan.bearings - bearings[:, None] + np.pi) % (2.0 * np.pi) - np.pi)
        off[off > _SHIFT] = np.inf
        is_seen = np.isfinite(off[:, is_out]).any(axis=1)
        off[:, ~_in_runs(scan.ranges == np.inf)] = np.inf
        place = off.argmin(axis=1)
        is_hidden = np.isfinite(off[np.arange(len(off)), place]) & ~is_seen & (ages < LASTS)
        rays, first = np.unique(place[is_hidden], return_index=True)
        return scan.bearings[rays], ages[is_hidden][first]


def _in_runs(is_empty: Mask) -> Mask:
    """True for rays without a return among at least `_RUN` such side by side."""
    found = np.zeros(len(is_empty), np.bool_)
    for first in range(_RUN):
        run = np.ones(len(is_empty), np.bool_)
        for shift in range(_RUN):
            run &= np.roll(is_empty, first - shift)
        found |= run
    return found
