"""Distances between what a lidar sees and the robot's own outline."""

from __future__ import annotations

import numpy as np

from swarmd.values import Array, Scan, ScanSpec


def seen_points(scan: Scan, spec: ScanSpec) -> Array:
    """(k, 2) points in the base frame in m, one for each ray that sees something.

    A ray that is too close to measure gives the point at range_min along it.
    """
    is_seen = scan.ranges < np.inf
    distances = np.maximum(scan.ranges[is_seen], scan.range_min)
    bearings = scan.bearings[is_seen]
    points = np.empty((len(distances), 2))
    points[:, 0] = spec.offset[0] + distances * np.cos(bearings)
    points[:, 1] = spec.offset[1] + distances * np.sin(bearings)
    return points


class Footprint:
    """A convex polygon (k, 2), counter-clockwise, in the base frame in m."""

    def __init__(self, corners: Array) -> None:
        self.corners = np.asarray(corners, dtype=np.float64)
        self._edges = np.roll(self.corners, -1, axis=0) - self.corners
        self._lengths = np.maximum(np.hypot(self._edges[:, 0], self._edges[:, 1]), 1e-12)

    def gaps(self, points: Array) -> Array:
        """(n,) distances in m from the outline to points (n, 2); 0 for points inside."""
        offsets = points[:, None, :] - self.corners[None, :, :]
        along = np.einsum("nkd,kd->nk", offsets, self._edges) / self._lengths**2
        nearest = offsets - np.clip(along, 0.0, 1.0)[:, :, None] * self._edges[None, :, :]
        distances: Array = np.sqrt(np.einsum("nkd,nkd->nk", nearest, nearest).min(axis=1))
        across = self._edges[:, 0] * offsets[:, :, 1] - self._edges[:, 1] * offsets[:, :, 0]
        return np.where((across >= 0.0).all(axis=1), 0.0, distances)
