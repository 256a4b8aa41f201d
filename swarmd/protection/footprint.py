"""Distances between what a lidar sees and the robot's own outline."""

from __future__ import annotations

import numpy as np

from swarmd.values import Array, Scan, ScanSpec


class Sight:
    """Where the rays of one lidar end, in the base frame in m."""

    def __init__(self, spec: ScanSpec) -> None:
        self.offset = spec.offset
        self._offset = np.array(spec.offset)
        self._bearings = np.empty(0)
        self._directions = np.empty((0, 2))

    def points(self, scan: Scan, within: float = np.inf) -> Array:
        """(k, 2) points, one for each ray that sees something up to `within` m from the lidar.

        A ray that is too close to measure gives the point at range_min along it.
        """
        if scan.bearings is not self._bearings:  # most sensors never change theirs
            self._bearings = scan.bearings
            self._directions = np.stack((np.cos(scan.bearings), np.sin(scan.bearings)), axis=1)
        is_seen = scan.ranges < np.inf if within == np.inf else scan.ranges <= within
        seen = np.flatnonzero(is_seen)
        distances = np.maximum(scan.ranges[seen], scan.range_min)
        return self._offset + distances[:, None] * self._directions[seen]


class Footprint:
    """A convex polygon (k, 2), counter-clockwise, in the base frame in m."""

    def __init__(self, corners: Array) -> None:
        self.corners = np.asarray(corners, dtype=np.float64)
        edges = np.roll(self.corners, -1, axis=0) - self.corners
        self._lengths = np.maximum(np.hypot(edges[:, 0], edges[:, 1]), 1e-12)
        along = edges / self._lengths[:, None]
        outward = np.stack((along[:, 1], -along[:, 0]), axis=1)
        # One product gives a point's place along each edge and its height above it, both in m.
        self._axes = np.concatenate((along, outward))
        self._origins = np.einsum("ka,ka->k", self._axes, np.tile(self.corners, (2, 1)))[:, None]
        self._outward = outward
        self._known: dict[tuple[float, float], tuple[float, float]] = {}

    def gaps(self, points: Array) -> Array:
        """(n,) distances in m from the outline to points (n, 2); 0 for points inside."""
        k = len(self._lengths)
        # Edges along the first axis: numpy reduces along a short last one three times as slowly.
        placed = self._axes.dot(points.T) - self._origins
        along, above = placed[:k], placed[k:]
        beyond = along - np.minimum(np.maximum(along, 0.0), self._lengths[:, None])
        squares = (beyond * beyond + above * above).min(axis=0)
        squares[above.max(axis=0) <= 0.0] = 0.0
        distances: Array = np.sqrt(squares)
        return distances

    def min_gap(self, scan: Scan, sight: Sight) -> float | None:
        """The smallest of the gaps to what a scan shows; None if it shows nothing.

        The outline lies between two circles around the lidar. So only a ray whose range is within
        their difference of the smallest can show the nearest point.
        """
        nearest = float(scan.ranges.min(initial=np.inf))
        if nearest == np.inf:
            return None
        inner, outer = self._circles(sight.offset)
        within = max(max(nearest, scan.range_min) - inner, 0.0) + outer
        return float(self.gaps(sight.points(scan, within)).min())

    def _circles(self, place: tuple[float, float]) -> tuple[float, float]:
        """The radii around a place within which all is outline, and beyond which nothing is.

        The first is less than 0 for a place outside.
        """
        if place not in self._known:
            at = np.array(place)
            inner = -float((self._outward.dot(at) - self._origins[len(self._lengths) :, 0]).max())
            if inner < 0.0:
                inner = -float(self.gaps(at[None])[0])
            self._known[place] = inner, float(np.hypot(*(self.corners - at).T).max())
        return self._known[place]
