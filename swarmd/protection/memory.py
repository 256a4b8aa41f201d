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

    A point gets there because the base moves, or by its own motion, at `others_speed` m/s at most:
    then its ray shows nothing any more, and nothing is left within reach of where it was. It is
    forgotten when a ray through its place sees beyond it (a remembered point that is not cleared
    so would hold the robot for ever), when it is out of the blind zone, faster than it could
    follow or seen there, and after `LASTS` s.
    """

    def __init__(self, spec: ScanSpec, others_speed: float) -> None:
        self._offset = np.array(spec.offset)
        self._blind = spec.range_min
        self._others_speed = others_speed
        self._candidates = np.empty((0, 2))
        self.points = np.empty((0, 2))
        self.ages = np.empty(0)

    def update(self, scan: Scan, sight: Sight, moved: Pose, seconds: float) -> None:
        """Take in a scan, taken `seconds` after the one before; `moved` is the base since then."""
        shown = sight.points(scan, self._blind + _BAND)
        points = np.concatenate((self.points, self._candidates))
        ages = np.concatenate((self.ages, np.zeros(len(self._candidates)))) + seconds
        if len(points):
            points = self._followed(_seen_from(points, moved), scan, shown, seconds)
            is_kept = self._is_hidden(points, scan) & (ages < LASTS)
            points, ages = points[is_kept], ages[is_kept]
        self.points, self.ages, self._candidates = points, ages, shown

    def _followed(self, points: Array, scan: Scan, shown: Array, seconds: float) -> Array:
        """The points; those outside the blind zone that may have come inside, just inside."""
        off = points - self._offset
        distances = np.hypot(off[:, 0], off[:, 1])
        moves = self._others_speed * seconds + _BEYOND
        is_lost = (distances >= self._blind) & (distances < self._blind + moves)
        is_lost &= self._through(points, scan) == np.inf
        for i in np.flatnonzero(is_lost).tolist():
            left = shown - points[i]
            is_lost[i] = not (left[:, 0] ** 2 + left[:, 1] ** 2 < moves * moves).any()
        shares = np.where(is_lost, 0.999 * self._blind / np.maximum(distances, 1e-9), 1.0)
        followed: Array = self._offset + off * shares[:, None]
        return followed

    def _is_hidden(self, points: Array, scan: Scan) -> NDArray[np.bool_]:
        """(n,) true for points in the blind zone through which no ray sees."""
        distances = np.hypot(*(points - self._offset).T)
        through = self._through(points, scan)
        sees_beyond = np.isfinite(through) & (through > distances + _BEYOND)
        hidden: NDArray[np.bool_] = (distances < self._blind) & ~sees_beyond
        return hidden

    def _through(self, points: Array, scan: Scan) -> Array:
        """(n,) the ranges of the rays through points."""
        off = points - self._offset
        bearings = np.arctan2(off[:, 1], off[:, 0])
        turn = np.abs((scan.bearings - bearings[:, None] + np.pi) % (2.0 * np.pi) - np.pi)
        through: Array = scan.ranges[turn.argmin(axis=1)]
        return through


def _seen_from(points: Array, moved: Pose) -> Array:
    """Points of a frame, in that of a base that has moved so since."""
    cos, sin = math.cos(moved.yaw), math.sin(moved.yaw)
    x, y = points[:, 0] - moved.x, points[:, 1] - moved.y
    return np.stack((cos * x + sin * y, cos * y - sin * x), axis=1)
