"""What a sensor that is blind nearby saw last before it came too near to be seen."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from swarmd.protection.footprint import Sight
from swarmd.values import Array, Pose, Scan, ScanSpec

LASTS = 30.0
"""Seconds for which a point is remembered that nothing shows to have gone."""

_BEYOND = 0.03  # m by which a ray must see further than a point to show that it has gone
_BAND = 0.25  # m beyond range_min from which things can get into the blind zone between two scans


class NearMemory:
    """Points inside the blind zone, in the base frame of the last scan; (n, 2) m and ages in s.

    A point is forgotten when a ray through its place sees beyond it (a remembered point that is
    not cleared so would hold the robot for ever), when it is out of the blind zone, where it would
    be seen, and after `LASTS` s.
    """

    def __init__(self, spec: ScanSpec) -> None:
        self._offset = np.array(spec.offset)
        self._blind = spec.range_min
        self._candidates = np.empty((0, 2))
        self._candidate_ages = np.empty(0)
        self.points = np.empty((0, 2))
        self.ages = np.empty(0)

    def update(self, scan: Scan, sight: Sight, moved: Pose, seconds: float) -> None:
        """Take in a scan, taken `seconds` after the one before; `moved` is the base since then."""
        points = np.concatenate((self.points, self._candidates))
        ages = np.concatenate((self.ages, self._candidate_ages)) + seconds
        if len(points):
            cos, sin = math.cos(moved.yaw), math.sin(moved.yaw)
            x, y = points[:, 0] - moved.x, points[:, 1] - moved.y
            points = np.stack((cos * x + sin * y, cos * y - sin * x), axis=1)
            is_kept = self._is_hidden(points, scan) & (ages < LASTS)
            points, ages = points[is_kept], ages[is_kept]
        self.points, self.ages = points, ages
        self._candidates = sight.points(scan, self._blind + _BAND)
        self._candidate_ages = np.zeros(len(self._candidates))

    def _is_hidden(self, points: Array, scan: Scan) -> NDArray[np.bool_]:
        """(n,) true for points in the blind zone through which no ray sees."""
        seen = points - self._offset
        distances = np.hypot(seen[:, 0], seen[:, 1])
        bearings = np.arctan2(seen[:, 1], seen[:, 0])
        off = np.abs((scan.bearings - bearings[:, None] + np.pi) % (2.0 * np.pi) - np.pi)
        through = scan.ranges[off.argmin(axis=1)]
        sees_beyond = np.isfinite(through) & (through > distances + _BEYOND)
        hidden: NDArray[np.bool_] = (distances < self._blind) & ~sees_beyond
        return hidden
