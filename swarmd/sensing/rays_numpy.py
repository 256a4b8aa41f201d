"""Features of a scan with numpy: the reference of scan_kernel.py.

`rays.py` says how ranges and bearings count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array, Scan

T = TypeVar("T", bound=np.generic)

_EMPTY = np.empty(0)
_TWO_PI = 2.0 * math.pi
UNSEEN = 1e9  # m: the range given to rays without a return, so that they form runs


class Ray(NamedTuple):
    """One return: range in m, bearing in rad."""

    range: float
    bearing: float


class Gap(NamedTuple):
    """A free sector: bearing of its middle and width, in rad."""

    bearing: float
    width: float


@dataclass(frozen=True, slots=True, eq=False)
class RayClusters:
    """Objects as runs of neighbouring rays, one element of each array per object.

    `ranges` (k,) m to the nearest ray, `bearings` (k,) rad of the middle, `widths` (k,) m across
    the visible part, `counts` (k,) rays, `is_free` (k,) true if no nearer object hides
    a side of it.
    """

    ranges: Array
    bearings: Array
    widths: Array
    counts: NDArray[np.int64]
    is_free: NDArray[np.bool_]

    def __len__(self) -> int:
        """The number of objects."""
        return len(self.ranges)


def nearest(scan: Scan | None, *, bearing: float = 0.0, half_width: float = math.pi) -> Ray | None:
    """See `rays.nearest`."""
    ranges, layout = _known(scan)
    bearings = wrapped(layout)
    if half_width < math.pi:
        is_inside = np.abs(_wrap(bearings - bearing)) <= half_width
        ranges, bearings = ranges[is_inside], bearings[is_inside]
    if not len(ranges):
        return None
    index = int(np.argmin(ranges))
    if ranges[index] == math.inf:
        return None
    return Ray(float(ranges[index]), float(bearings[index]))


def unit_vectors(bearings: Array) -> Array:
    """See `rays.unit_vectors`."""
    return np.stack((np.cos(bearings), np.sin(bearings)), axis=1)


def sectors(scan: Scan | None, count: int) -> Array:
    """The nearest range in each of `count` equal sectors (count,); +inf without a return.

    Sector 0 is centred ahead, the others follow counter-clockwise.
    """
    ranges, layout = _known(scan)
    result = np.full(count, math.inf)
    np.minimum.at(result, _sector_of(wrapped(layout), count), ranges)
    return result


def closest_points(scan: Scan | None, *, within: float, count: int = 24) -> Array:
    """See `rays.closest_points`."""
    ranges, layout = _known(scan)
    seen = (ranges <= within).nonzero()[0]
    if not len(seen):
        return np.empty((0, 2))
    # In order of falling range, the last to write into a sector is its nearest ray.
    seen = seen.take(np.argsort(-ranges.take(seen), kind="stable"))
    sector = in_sectors(layout, count).take(seen)
    lowest = np.full(count, math.inf)
    lowest[sector] = ranges.take(seen)
    nearest_ray = np.empty(count, dtype=np.int64)
    nearest_ray[sector] = seen
    is_minimum = (lowest < _rolled(lowest, count - 1)) & (lowest <= _rolled(lowest, 1))
    if count < 3 or not is_minimum.any():
        is_minimum = lowest == lowest.min()
    minima = (is_minimum & (lowest < math.inf)).nonzero()[0]
    points = np.empty((len(minima), 2))
    points[:, 0] = lowest.take(minima)
    points[:, 1] = wrapped(layout).take(nearest_ray.take(minima))
    return points


def nearest_bearings(bearings: Array, wanted: Array) -> tuple[NDArray[np.intp], Array]:
    """For each of `wanted` (k,), the index of the nearest of `bearings` (n,) and the distance."""
    order = np.argsort(bearings % _TWO_PI, kind="stable")
    rising = bearings[order] % _TWO_PI
    after = np.searchsorted(rising, wanted % _TWO_PI) % len(rising)
    pair = np.stack((after, after - 1))
    off = np.abs((rising[pair] - wanted + np.pi) % _TWO_PI - np.pi)
    nearer = off.argmin(axis=0)
    column = np.arange(len(wanted))
    return order[pair[nearer, column]], off[nearer, column]


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
    bearings, is_free = _rolled(bearings, start), _rolled(is_free, start)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], is_free, [False])).astype(np.int8)))
    found = []
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        width = float((bearings[end - 1] - bearings[first]) % _TWO_PI)
        middle = float(bearings[first]) + 0.5 * width
        found.append(Gap((middle + math.pi) % _TWO_PI - math.pi, width))
    return sorted(found, key=lambda gap: -gap.width)


def clusters(
    scan: Scan | None, *, within: float, jump: float = 0.06, grazing: float = math.radians(10.0)
) -> RayClusters:
    """See `rays.clusters`."""
    ranges, layout = _known(scan)
    if not len(ranges) or ranges.min() > within:
        return RayClusters(_EMPTY, _EMPTY, _EMPTY, np.empty(0, np.int64), np.empty(0, np.bool_))
    order, bearings, _, spacing = in_order(layout)
    ranges = ranges.take(order)
    ranges = np.where(ranges > within, UNSEEN, ranges)
    slopes, is_apart = surfaces(layout, grazing)
    after = _rolled(ranges, 1)
    is_last = np.abs(ranges - after) > jump + np.minimum(ranges, after) * slopes
    is_last |= is_apart
    # Start behind a break, so that no object spans the end of the arrays.
    shift = int(is_last.argmax()) + 1
    ends = _rolled(is_last, shift).nonzero()[0]
    if not len(ends):
        ends = np.array([len(ranges) - 1])
    turned = np.concatenate((bearings[shift:], bearings[:shift] + _TWO_PI))
    return _objects(_rolled(ranges, shift), turned, ends, spacing)


def _objects(
    ranges: Array, bearings: Array, ends: NDArray[np.int64], spacing: float
) -> RayClusters:
    """The runs that end at `ends`; runs of rays without a return are left out."""
    starts = np.concatenate(([0], ends[:-1] + 1))
    lowest = np.minimum.reduceat(ranges, starts)
    seen = (lowest < UNSEEN).nonzero()[0]
    lowest, first, last = lowest.take(seen), starts.take(seen), ends.take(seen)
    near, far = ranges.take(first), ranges.take(last)
    spread = bearings.take(last) - bearings.take(first)
    # |near - far e^(i spread)|, written so that it cannot be the root of less than 0.
    chord = np.hypot(near - far, 2.0 * np.sqrt(near * far) * np.sin(0.5 * spread))
    return RayClusters(
        ranges=lowest,
        bearings=_wrap(bearings.take(first) + 0.5 * spread),
        # An object around the robot, like a room, is wide although its ends are near each other.
        widths=np.maximum(chord, spread * lowest) + lowest * min(spacing, math.pi),
        counts=last - first + 1,
        is_free=(ranges.take(first - 1, mode="wrap") > near)
        & (ranges.take(last + 1, mode="wrap") > far),
    )


def _known(scan: Scan | None) -> tuple[Array, bytes]:
    """The known ranges, at least range_min, and the bytes of their bearings."""
    if scan is None:
        return _EMPTY, b""
    ranges, bearings = scan.ranges, scan.bearings
    is_unknown = np.isnan(ranges)
    if is_unknown.any():
        ranges, bearings = ranges[~is_unknown], bearings[~is_unknown]
    return np.maximum(ranges, scan.range_min), bearings.tobytes()


# Most sensors send the same bearings with each scan, so values derived from them are cached.
@lru_cache(maxsize=4)
def wrapped(layout: bytes) -> Array:
    """The bearings within [-pi, pi); read-only."""
    return _wrap(np.frombuffer(layout))


@lru_cache(maxsize=4)
def in_order(layout: bytes) -> tuple[NDArray[np.int64], Array, Array, float]:
    """The order of rising bearings, these bearings, the steps to the next, the median step."""
    order = np.argsort(wrapped(layout), kind="stable")
    bearings = wrapped(layout)[order]
    steps = _rolled(bearings, 1) - bearings
    steps[-1] += _TWO_PI
    spacing = float(np.sort(steps)[len(steps) // 2]) if len(steps) > 1 else _TWO_PI
    return order, bearings, steps, spacing


@lru_cache(maxsize=4)
def surfaces(layout: bytes, grazing: float) -> tuple[Array, NDArray[np.bool_]]:
    """The slope of a surface at `grazing` rad to the next ray, and which rays are too far apart.

    Up to two rays may be unknown in the middle of an object.
    """
    _, _, steps, spacing = in_order(layout)
    return steps / math.tan(grazing), steps >= min(3.5 * spacing, 0.5 * math.pi)


@lru_cache(maxsize=4)
def in_sectors(layout: bytes, count: int) -> NDArray[np.int64]:
    """The sector of each ray."""
    return _sector_of(wrapped(layout), count)


def _sector_of(bearings: Array, count: int) -> NDArray[np.int64]:
    return np.rint(bearings * (count / _TWO_PI)).astype(np.int64) % count


def _wrap(bearings: Array) -> Array:
    wrapped: Array = (bearings + math.pi) % _TWO_PI - math.pi
    return wrapped


def _rolled(array: NDArray[T], by: int) -> NDArray[T]:
    """The array starting at element `by`; np.roll takes three times as long."""
    return np.concatenate((array[by:], array[:by]))
