"""Distances between the returns of a lidar and the robot's outline."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array, Platform, Scan, ScanSpec
from swarmd.robot.sensing.rays import unit_vectors


class ScanGeometry:
    """The returns of one lidar as points in the base frame, in m."""

    def __init__(self, spec: ScanSpec) -> None:
        self.offset = spec.offset
        self._offset = np.array(spec.offset)

    def points(self, scan: Scan, within: float = np.inf) -> Array:
        """(k, 2) points of all returns up to `within` m from the lidar.

        A return too close to measure gives the point at range_min along its ray.
        """
        is_seen = scan.ranges < np.inf if within == np.inf else scan.ranges <= within
        return self.points_of_rays(scan, np.flatnonzero(is_seen))

    def points_of_rays(self, scan: Scan, rays: NDArray[np.intp]) -> Array:
        """(k, 2) points of the rays with these indices (k,), which all have a return."""
        distances = np.maximum(scan.ranges[rays], scan.range_min)
        return self._offset + distances[:, None] * unit_vectors(scan.bearings[rays])


class Footprint:
    """A convex polygon (k, 2), counter-clockwise, in the base frame in m.

    Attributes:
        corners: (k, 2), m.
        lengths: (k,), m, of the edges.
        axes: (2k, 2), unit vectors: the directions of the edges, then their outward normals.
        origins: (2k,), m, the coordinates of the start of each edge along its two axes.
    """

    def __init__(self, corners: Array) -> None:
        self.corners = np.asarray(corners, dtype=np.float64)
        edges = np.roll(self.corners, -1, axis=0) - self.corners
        self.lengths = np.maximum(np.hypot(edges[:, 0], edges[:, 1]), 1e-12)
        along = edges / self.lengths[:, None]
        outward = np.stack((along[:, 1], -along[:, 0]), axis=1)
        # Less the origins, a point's coordinate along each edge and its height above it, in m.
        self.axes = np.concatenate((along, outward))
        starts = np.tile(self.corners, (2, 1))
        self.origins = self.axes[:, 0] * starts[:, 0] + self.axes[:, 1] * starts[:, 1]
        self._outward = outward
        self._known: dict[tuple[float, float], tuple[float, float]] = {}

    def gaps(self, points: Array) -> Array:
        """(n,) distances in m from the outline to points (n, 2); 0 for points inside."""
        # Edges along the first axis: numpy reduces along a short last one three times as slowly.
        along, above = self._placed(points[:, 0], points[:, 1])
        beyond = along - np.minimum(np.maximum(along, 0.0), self.lengths[:, None])
        # The nearest place lies on an edge that the point is above; an inner point is above none.
        squares = np.where(above <= 0.0, np.inf, beyond * beyond + above * above).min(axis=0)
        squares[squares == np.inf] = 0.0
        distances: Array = np.sqrt(squares)
        return distances

    def _placed(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Coordinates (k, n) of points along each edge, and above it.

        No matrix product: some machines fuse its operations, and some do not.
        """
        placed = self.axes[:, :1] * x
        placed += self.axes[:, 1:] * y
        placed -= self.origins[:, None]
        return placed[: len(self.lengths)], placed[len(self.lengths) :]

    def along_rays(self, place: tuple[float, float], directions: Array) -> Array:
        """(n,) m from a point inside to the outline along `directions` (n, 2); 0 from outside."""
        nx, ny = self._outward.T
        heights = self.origins[len(nx) :] - (nx * place[0] + ny * place[1])
        approach = directions[:, :1] * nx + directions[:, 1:] * ny
        with np.errstate(divide="ignore"):
            ways = np.where(approach > 1e-12, heights / approach, np.inf)
        distances: Array = np.maximum(ways.min(axis=1), 0.0)
        return distances

    def nearest(self, scan: Scan, geometry: ScanGeometry) -> tuple[float, float] | None:
        """Gap in m and bearing in rad, from the axle, of the return nearest to the outline.

        None without a return. A return too close to measure has gap 0 and the bearing of its ray.
        The outline lies between two circles around the lidar. So a return that is farther from the
        lidar than the nearest return by more than the difference of both radii is not examined.
        """
        nearest = float(scan.ranges.min(initial=np.inf))
        if nearest == np.inf:
            return None
        if nearest == -np.inf:
            return 0.0, float(scan.bearings[scan.ranges.argmin()])
        inner, outer = self.circles(geometry.offset)
        within = max(max(nearest, scan.range_min) - inner, 0.0) + outer
        return self.nearest_point(geometry.points(scan, within))

    def nearest_point(self, points: Array) -> tuple[float, float]:
        """Gap in m and bearing in rad, from the axle, of the nearest of points (n, 2); n > 0."""
        gaps = self.gaps(points)
        index = int(gaps.argmin())
        x, y = points[index].tolist()
        return float(gaps[index]), math.atan2(y, x)

    def circles(self, place: tuple[float, float]) -> tuple[float, float]:
        """Radii in m of two circles around a place: inside of, and around, the outline.

        The first is the largest circle within the outline; for a place outside, minus the distance
        to the outline. The second is the smallest circle that contains the outline.
        """
        if place not in self._known:
            at = np.array(place)
            inner = -float((self._outward.dot(at) - self.origins[len(self.lengths) :]).max())
            if inner < 0.0:
                inner = -float(self.gaps(at[None])[0])
            self._known[place] = inner, float(np.hypot(*(self.corners - at).T).max())
        return self._known[place]


def radius_of(platform: Platform) -> float:
    """The radius in m of the circle around the axle's middle that holds the footprint."""
    return max(math.hypot(x, y) for x, y in platform.footprint.tolist())
