"""Features of a scan: the nearest return, sectors, free gaps, objects.

Rays may come in any order, number and spacing. A range of NaN is unknown, and the ray is left out.
A range of +inf is no return. A range below `range_min` (or -inf) counts as `range_min`. `scan` may
be None, as before the first scan, and then has no returns. Returned bearings are within [-pi, pi).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from swarmd.core.values import Array, Scan
from swarmd.robot.sensing import scan_features

_TWO_PI = 2.0 * math.pi


class Ray(NamedTuple):
    """One return: range in m, bearing in rad."""

    range: float
    bearing: float


class Gap(NamedTuple):
    """A free sector: bearing of its middle and width, in rad."""

    bearing: float
    width: float


class RayClusters(Struct, frozen=True, eq=False):
    """Objects in a scan, each a run of neighbouring rays; each array has an element per object."""

    objects: Sequence[tuple[float, float, float, int, bool]]
    """(k,) range, bearing, width, count and `is_free` of each object."""

    @property
    def ranges(self) -> Array:
        """(k,) m, of the nearest ray"""
        return self._column(0, np.float64)

    @property
    def bearings(self) -> Array:
        """(k,) rad, of the middle"""
        return self._column(1, np.float64)

    @property
    def widths(self) -> Array:
        """(k,) m across the visible part"""
        return self._column(2, np.float64)

    @property
    def counts(self) -> NDArray[np.int64]:
        """(k,) number of rays"""
        return self._column(3, np.int64)

    @property
    def is_free(self) -> NDArray[np.bool_]:
        """(k,) True if no nearer object hides a side of the object"""
        return self._column(4, np.bool_)

    def _column(self, place: int, kind: Any) -> NDArray[Any]:
        return np.array([values[place] for values in self.objects], dtype=kind)

    def __len__(self) -> int:
        """The number of objects."""
        return len(self.objects)


def nearest(scan: Scan | None, *, bearing: float = 0.0, half_width: float = math.pi) -> Ray | None:
    """The nearest return within `half_width` rad of a bearing; None without one."""
    ray = None if scan is None else scan_features.nearest(scan, bearing, half_width)
    return None if ray is None else Ray(*ray)


def unit_vectors(bearings: Array) -> Array:
    """The directions (n, 2) at `bearings` (n,) rad."""
    vectors: Array = scan_features.unit_vectors(bearings)
    return vectors


def sectors(scan: Scan | None, count: int) -> Array:
    """The nearest range in each of `count` equal sectors (count,); +inf without a return.

    Sector 0 is centred ahead, the others follow counter-clockwise.
    """
    result = np.full(count, math.inf)
    if scan is not None:
        is_known = ~np.isnan(scan.ranges)
        ranges = np.maximum(scan.ranges[is_known], scan.range_min)
        sector = np.rint(_wrap(scan.bearings[is_known]) * (count / _TWO_PI)).astype(np.int64)
        np.minimum.at(result, sector % count, ranges)
    return result


def closest_points(scan: Scan | None, *, within: float, count: int = 24) -> Array:
    """The points where surfaces come closest: (k, 2) of range in m and bearing in rad.

    Each of `count` equal sectors has a range: of its nearest ray up to `within` m, else inf. The
    nearest ray of a sector is a point if both neighbouring sectors have greater ranges. Without
    such a sector, the nearest rays of the sectors with the least range are the points. A robot
    gives one point, and so does a straight wall (the foot of the perpendicular).
    """
    if scan is None:
        return np.empty((0, 2))
    points: Array = scan_features.closest_points(scan, within, count)
    return points


def gaps(scan: Scan | None, *, beyond: float) -> list[Gap]:
    """The free sectors, widest first: runs of rays without a return up to `beyond` m.

    Unknown rays are not free. A scan without any return is one gap of 2 pi ahead.
    """
    if scan is None or not len(scan.ranges):
        return []
    bearings = _wrap(scan.bearings)
    order = np.argsort(bearings, kind="stable")
    bearings = bearings[order]
    is_free = scan.ranges[order] > max(beyond, scan.range_min)
    if is_free.all():
        return [Gap(0.0, _TWO_PI)]
    start = int(np.argmin(is_free))
    bearings = np.roll(bearings, -start)
    is_free = np.roll(is_free, -start)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], is_free, [False])).astype(np.int8)))
    free = []
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        width = float((bearings[end - 1] - bearings[first]) % _TWO_PI)
        middle = float(bearings[first]) + 0.5 * width
        free.append(Gap((middle + math.pi) % _TWO_PI - math.pi, width))
    return sorted(free, key=lambda gap: -gap.width)


def clusters(
    scan: Scan | None, *, within: float, jump: float = 0.06, grazing: float = math.radians(10.0)
) -> RayClusters:
    """The objects up to `within` m.

    Two neighbouring rays belong to one object if their ranges differ by less than a bound. The
    bound is `jump` m plus the difference on a surface at an angle of `grazing` rad to the rays,
    which grows with the range (Borges and Aldon, "Line extraction in 2D range images for mobile
    robotics", 2004).
    """
    return RayClusters([] if scan is None else scan_features.clusters(scan, within, jump, grazing))


def _wrap(bearings: Array) -> Array:
    wrapped: Array = (bearings + math.pi) % _TWO_PI - math.pi
    return wrapped
