"""Distances between the returns of a lidar and the robot's outline."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array, Scan, ScanSpec


class Separations(NamedTuple):
    """Distance, direction and lever of n points from an outline, each (n,), in the base frame.

    `gap` in m, 0 for points inside; `nx`, `ny` the unit vector from the nearest place of the
    outline to the point; `lever` in m per rad: how far a turn moves that place along the vector.
    """

    gap: Array
    nx: Array
    ny: Array
    lever: Array


class ScanGeometry:
    """The returns of one lidar as points in the base frame, in m."""

    def __init__(self, spec: ScanSpec) -> None:
        self.offset = spec.offset
        self._offset = np.array(spec.offset)
        self._bearings = np.empty(0)
        self._directions = np.empty((0, 2))

    def points(self, scan: Scan, within: float = np.inf) -> Array:
        """(k, 2) points of all returns up to `within` m from the lidar.

        A return too close to measure gives the point at range_min along its ray.
        """
        is_seen = scan.ranges < np.inf if within == np.inf else scan.ranges <= within
        return self.points_of_rays(scan, np.flatnonzero(is_seen))

    def points_of_rays(self, scan: Scan, rays: NDArray[np.intp]) -> Array:
        """(k, 2) points of the rays with these indices (k,), which all have a return."""
        if scan.bearings is not self._bearings:  # most sensors keep theirs
            self._bearings = scan.bearings
            self._directions = np.stack((np.cos(scan.bearings), np.sin(scan.bearings)), axis=1)
        distances = np.maximum(scan.ranges[rays], scan.range_min)
        return self._offset + distances[:, None] * self._directions[rays]


class Footprint:
    """A convex polygon (k, 2), counter-clockwise, in the base frame in m."""

    def __init__(self, corners: Array) -> None:
        self.corners = np.asarray(corners, dtype=np.float64)
        edges = np.roll(self.corners, -1, axis=0) - self.corners
        self._lengths = np.maximum(np.hypot(edges[:, 0], edges[:, 1]), 1e-12)
        along = edges / self._lengths[:, None]
        outward = np.stack((along[:, 1], -along[:, 0]), axis=1)
        # One product gives a point's coordinate along each edge and its height above it, in m.
        self._axes = np.concatenate((along, outward))
        self._origins = np.einsum("ka,ka->k", self._axes, np.tile(self.corners, (2, 1)))[:, None]
        self._outward = outward
        self._edges = np.concatenate((along.T, self.corners.T))
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

    def separations(self, x: Array, y: Array) -> Separations:
        """The separations of points at `x`, `y` (n,) from the outline."""
        k, n = len(self._lengths), len(x)
        placed = self._axes.dot(np.array((x, y)))
        placed -= self._origins
        along, above = placed[:k], placed[k:]
        on = np.minimum(np.maximum(along, 0.0), self._lengths[:, None])
        beyond = along - on
        squares = beyond * beyond
        squares += above * above
        edge = squares.argmin(axis=0)
        cell = edge * n + np.arange(n)
        gap = np.sqrt(squares.take(cell))
        gap[above.max(axis=0) <= 0.0] = 0.0
        far, high = beyond.take(cell), above.take(cell)
        # On and inside the outline the vector has no length: the edge's normal replaces it.
        at = gap < 1e-9
        if at.any():
            far[at], high[at] = 0.0, 1.0
        inverse = 1.0 / np.where(at, 1.0, gap)
        far *= inverse
        high *= inverse
        along_x, along_y, start_x, start_y = self._edges.take(edge, axis=1)
        nx, ny = far * along_x + high * along_y, far * along_y - high * along_x
        share = on.take(cell)
        lever = (start_x + share * along_x) * ny - (start_y + share * along_y) * nx
        return Separations(gap, nx, ny, lever)

    def along_rays(self, place: tuple[float, float], directions: Array) -> Array:
        """(n,) m from an inner point to the outline along `directions` (n, 2); 0 from outside."""
        heights = self._origins[len(self._lengths) :, 0] - self._outward.dot(np.array(place))
        approach = directions.dot(self._outward.T)
        with np.errstate(divide="ignore"):
            ways = np.where(approach > 1e-12, heights / approach, np.inf)
        distances: Array = np.maximum(ways.min(axis=1), 0.0)
        return distances

    def nearest(self, scan: Scan, geometry: ScanGeometry) -> tuple[float, float] | None:
        """Gap in m and bearing in rad, from the axle, of the return nearest to the outline.

        None without a return. A return too close to measure has gap 0 and the bearing of its ray.
        The outline lies between two circles around the lidar, so only rays whose range exceeds the
        smallest by at most the difference of the radii are examined.
        """
        nearest = float(scan.ranges.min(initial=np.inf))
        if nearest == np.inf:
            return None
        if nearest == -np.inf:
            return 0.0, float(scan.bearings[scan.ranges.argmin()])
        inner, outer = self.circles(geometry.offset)
        within = max(max(nearest, scan.range_min) - inner, 0.0) + outer
        points = geometry.points(scan, within)
        gaps = self.gaps(points)
        index = int(gaps.argmin())
        x, y = points[index].tolist()
        return float(gaps[index]), math.atan2(y, x)

    def min_gap(self, scan: Scan, geometry: ScanGeometry) -> float | None:
        """The gap in m to the nearest return; None without a return."""
        nearest = self.nearest(scan, geometry)
        return None if nearest is None else nearest[0]

    def circles(self, place: tuple[float, float]) -> tuple[float, float]:
        """Radii of the largest circle within the outline and the smallest around it, about a place.

        The first is negative for a place outside.
        """
        if place not in self._known:
            at = np.array(place)
            inner = -float((self._outward.dot(at) - self._origins[len(self._lengths) :, 0]).max())
            if inner < 0.0:
                inner = -float(self.gaps(at[None])[0])
            self._known[place] = inner, float(np.hypot(*(self.corners - at).T).max())
        return self._known[place]
