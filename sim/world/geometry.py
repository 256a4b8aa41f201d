"""Plane geometry of convex polygons, vectorised; shared by lidar, metrics and layouts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array

Indices = NDArray[np.intp]


def transform(points: Array, poses: Array) -> Array:
    """Points (..., k, 2) of frames at `poses` (..., 3) x, y, yaw, in the world frame."""
    cos = np.cos(poses[..., 2, None])
    sin = np.sin(poses[..., 2, None])
    x = poses[..., 0, None] + cos * points[..., 0] - sin * points[..., 1]
    y = poses[..., 1, None] + sin * points[..., 0] + cos * points[..., 1]
    return np.stack((x, y), axis=-1)


def radius(polygon: Array) -> float:
    """The distance in m of the farthest corner of a polygon (k, 2) from its frame's origin."""
    return float(np.hypot(polygon[:, 0], polygon[:, 1]).max())


def gaps(a: Array, b: Array) -> Array:
    """The exact distance in m of convex polygons a (..., k, 2) and b (..., m, 2); 0 in overlap.

    Two convex shapes that do not overlap are nearest at a corner of one of them.
    """
    apart = np.minimum(_corner_distance(a, b), _corner_distance(b, a))
    return np.where(overlaps(a, b), 0.0, apart)


def overlaps(a: Array, b: Array) -> NDArray[np.bool_]:
    """True where two counter-clockwise convex polygons (..., k, 2) share an inner point.

    Separating axis theorem: two polygons are apart if an edge of one of them has all corners of the
    other polygon on its outer side.
    """
    return np.logical_not(_separates(a, b) | _separates(b, a))


def _separates(a: Array, b: Array) -> NDArray[np.bool_]:
    edge = np.roll(a, -1, axis=-2) - a
    to = b[..., None, :, :] - a[..., :, None, :]
    side = edge[..., :, None, 0] * to[..., 1] - edge[..., :, None, 1] * to[..., 0]
    separated: NDArray[np.bool_] = np.asarray(np.any(np.all(side <= 0.0, axis=-1), axis=-1))
    return separated


def _corner_distance(corners: Array, polygon: Array) -> Array:
    """The distance of the nearest of the corners (..., k, 2) to the edges of the polygon."""
    start = polygon[..., None, :, :]
    edge = np.roll(polygon, -1, axis=-2)[..., None, :, :] - start
    to = corners[..., :, None, :] - start
    along = (to * edge).sum(axis=-1) / np.maximum((edge * edge).sum(axis=-1), 1e-300)
    nearest = to - np.clip(along, 0.0, 1.0)[..., None] * edge
    distance: Array = np.hypot(nearest[..., 0], nearest[..., 1]).min(axis=(-1, -2))
    return distance


def crossings(a: Array, b: Array, start: Array, end: Array) -> NDArray[np.bool_]:
    """True where the path from a to b (..., 2) crosses the segment start to end (..., 2).

    Touching an end of the segment counts, touching an end of the path does not.
    """
    way = b - a
    wall = end - start
    sides = _cross(wall, a - start) * _cross(wall, b - start)
    ends = _cross(way, start - a) * _cross(way, end - a)
    return np.asarray((sides < 0.0) & (ends <= 0.0))


def apart(points: Array, a: Array, b: Array) -> Array:
    """The distance in m of points (..., 2) from the segment between a and b (..., 2)."""
    way = b - a
    to = points - a
    along = (to * way).sum(axis=-1) / np.maximum((way * way).sum(axis=-1), 1e-300)
    rest = to - np.clip(along, 0.0, 1.0)[..., None] * way
    distance: Array = np.hypot(rest[..., 0], rest[..., 1])
    return distance


def _cross(u: Array, v: Array) -> Array:
    product: Array = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    return product
