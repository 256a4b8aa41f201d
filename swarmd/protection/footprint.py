"""Distances between what a lidar sees and the robot's own outline."""

from __future__ import annotations

import numpy as np

from swarmd.values import Array, Scan, ScanSpec


class Sight:
    """Where the rays of one lidar end, in the base frame in m."""

    def __init__(self, spec: ScanSpec) -> None:
        self._offset = np.array(spec.offset)
        self._bearings = np.empty(0)
        self._directions = np.empty((0, 2))

    def points(self, scan: Scan) -> Array:
        """(k, 2) points, one for each ray that sees something.

        A ray that is too close to measure gives the point at range_min along it.
        """
        if scan.bearings is not self._bearings:  # most sensors never change theirs
            self._bearings = scan.bearings
            self._directions = np.stack((np.cos(scan.bearings), np.sin(scan.bearings)), axis=1)
        is_seen = scan.ranges < np.inf
        distances = np.maximum(scan.ranges[is_seen], scan.range_min)
        return self._offset + distances[:, None] * self._directions[is_seen]


class Footprint:
    """A convex polygon (k, 2), counter-clockwise, in the base frame in m."""

    def __init__(self, corners: Array) -> None:
        self.corners = np.asarray(corners, dtype=np.float64)
        edges = np.roll(self.corners, -1, axis=0) - self.corners
        self._lengths = np.maximum(np.hypot(edges[:, 0], edges[:, 1]), 1e-12)
        along = edges / self._lengths[:, None]
        outward = np.stack((along[:, 1], -along[:, 0]), axis=1)
        # One product gives a point's place along each edge and its height above it, both in m.
        self._axes = np.concatenate((along, outward)).T
        self._origins = np.einsum("ak,ka->k", self._axes, np.tile(self.corners, (2, 1)))
        self._centre = self.corners.mean(axis=0)
        self._reach = float(np.hypot(*(self.corners - self._centre).T).max())
        self._inside = float(-(self._centre @ outward.T - self._origins[len(edges) :]).max())

    def gaps(self, points: Array) -> Array:
        """(n,) distances in m from the outline to points (n, 2); 0 for points inside."""
        k = len(self._lengths)
        placed = points @ self._axes - self._origins
        along, above = placed[:, :k], placed[:, k:]
        beyond = along - np.minimum(np.maximum(along, 0.0), self._lengths)
        squares = (beyond * beyond + above * above).min(axis=1)
        squares[above.max(axis=1) <= 0.0] = 0.0
        distances: Array = np.sqrt(squares)
        return distances

    def min_gap(self, points: Array) -> float | None:
        """The smallest of the gaps; None if there are no points.

        The outline lies between two circles around its centre. So only a point whose distance
        from there is within their difference of the smallest can be the nearest.
        """
        if not len(points):
            return None
        away = np.hypot(points[:, 0] - self._centre[0], points[:, 1] - self._centre[1])
        limit = max(self._reach, float(away.min()) + self._reach - self._inside)
        return float(self.gaps(points[away <= limit]).min())
