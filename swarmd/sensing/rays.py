"""Features of a scan: the nearest return, sectors, free gaps, objects.

Rays may come in any order, number and spacing. NaN is unknown and left out, +inf is no return, and
a range below `range_min` (or -inf) counts as `range_min`. A scan of None, as before the first scan,
has no returns. Returned bearings are within [-pi, pi).
"""

from __future__ import annotations

import math

from swarmd.core.kernels import compiled_kernel
from swarmd.core.values import Array, Scan
from swarmd.sensing import rays_numpy
from swarmd.sensing.rays_numpy import Gap, Ray, RayClusters, gaps, sectors

__all__ = [
    "Gap",
    "Ray",
    "RayClusters",
    "closest_points",
    "clusters",
    "gaps",
    "nearest",
    "sectors",
    "unit_vectors",
]

_features = compiled_kernel("swarmd.sensing.scan_kernel") or rays_numpy


def nearest(scan: Scan | None, *, bearing: float = 0.0, half_width: float = math.pi) -> Ray | None:
    """The nearest return within `half_width` rad of a bearing; None without one."""
    found: Ray | None = _features.nearest(scan, bearing=bearing, half_width=half_width)
    return found


def unit_vectors(bearings: Array) -> Array:
    """The directions (n, 2) at `bearings` (n,) rad."""
    vectors: Array = _features.unit_vectors(bearings)
    return vectors


def closest_points(scan: Scan | None, *, within: float, count: int = 24) -> Array:
    """The points where surfaces come closest: (k, 2) of range in m and bearing in rad.

    One point per robot, and one per straight wall (the foot of the perpendicular): the local
    minima, among `count` equal sectors, of the ranges up to `within` m.
    """
    found: Array = _features.closest_points(scan, within=within, count=count)
    return found


def clusters(
    scan: Scan | None, *, within: float, jump: float = 0.06, grazing: float = math.radians(10.0)
) -> RayClusters:
    """The objects up to `within` m.

    Two neighbouring rays belong together if their ranges differ by less than `jump` m plus what a
    surface seen at an angle of `grazing` rad makes between them, which grows with the range
    (Borges and Aldon, "Line extraction in 2D range images for mobile robotics", 2004).
    """
    found: RayClusters = _features.clusters(scan, within=within, jump=jump, grazing=grazing)
    return found
