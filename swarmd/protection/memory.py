"""Where something has come too near to be seen, for a sensor that says nothing of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from swarmd.values import Array, Scan

LASTS = 30.0
"""Seconds for which it is remembered where nothing shows that it has gone."""

_BAND = 0.25  # m beyond range_min from where things can get into the blind zone between two scans
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

    def __init__(self, range_min: float) -> None:
        """The radius in m within which the sensor is blind."""
        self._rim = range_min + _BAND
        self._near = np.empty(0)
        self.bearings = np.empty(0)
        self.ages = np.empty(0)

    def update(self, scan: Scan, turned: float, seconds: float) -> None:
        """Take in a scan; since the one before the base has turned by so many rad."""
        is_near = (scan.ranges <= self._rim) & (scan.ranges > -np.inf)
        if len(self._near) or len(self.bearings):
            bearings = np.concatenate((self.bearings, self._near)) - turned
            ages = np.concatenate((self.ages, np.zeros(len(self._near)))) + seconds
            self.bearings, self.ages = self._shadows(scan, is_near, bearings, ages)
        self._near = scan.bearings[is_near]

    def _shadows(
        self, scan: Scan, is_near: Mask, bearings: Array, ages: Array
    ) -> tuple[Array, Array]:
        """Where those at `bearings` hide now: at the nearest ray of a run without a return."""
        off = np.abs((scan.bearings - bearings[:, None] + np.pi) % (2.0 * np.pi) - np.pi)
        off[off > _SHIFT] = np.inf
        is_out = np.isfinite(off[:, is_near]).any(axis=1)
        off[:, ~_in_runs(scan.ranges == np.inf)] = np.inf
        place = off.argmin(axis=1)
        is_hidden = np.isfinite(off[np.arange(len(off)), place]) & ~is_out & (ages < LASTS)
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
