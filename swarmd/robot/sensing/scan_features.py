"""Features of a scan: the nearest return, closest points, objects; `rays.py` has the interface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core.angles import PI, TURN, wrap
from swarmd.core.buffers import view, view_of
from swarmd.core.cython_shadow import INFINITY, Doubles, Table, cos, fabs, hypot, sin, sqrt
from swarmd.robot.sensing.scan_layout import ScanLayout, layout_of

if TYPE_CHECKING:
    from swarmd.core.values import Array, Scan

# m: the range given to rays without a return, so that they form runs.
_UNSEEN = 1e9


def nearest(scan: Scan, bearing: float, half_width: float) -> tuple[Any, ...] | None:
    """Range and bearing of the ray that `rays.nearest` finds; None without one."""
    layout: ScanLayout | None = layout_of(scan)
    if layout is None:
        return None
    ranges = layout.known
    n = layout.n
    least = scan.range_min
    lowest = INFINITY
    index = -1
    is_sector = half_width < PI
    for i in range(n):
        distance = ranges[i]
        if distance < least:
            distance = least
        if distance < lowest:
            if is_sector and fabs(wrap(layout.wrapped[i] - bearing)) > half_width:
                continue
            lowest = distance
            index = i
    return None if index < 0 else (lowest, layout.wrapped[index])


def unit_vectors(bearings: Array) -> Array:
    """(n, 2) the unit vectors of `bearings` (n,) in rad."""
    given: Doubles = view(bearings)
    vectors = np.empty((len(given), 2))
    out: Table = view_of(vectors)
    for i in range(len(given)):
        angle = given[i]
        out[i, 0] = cos(angle)
        out[i, 1] = sin(angle)
    return vectors


def closest_points(scan: Scan, within: float, count: int) -> Array:
    """The closest points of a scan: (p, 2) range in m and bearing in rad.

    The surroundings are divided into `count` equal sectors. A point is the nearest ray of a sector
    whose range is a local minimum among the sectors. Without a local minimum, the points are the
    nearest rays of the sectors with the least range.
    Empty (0, 2) without a return up to `within` m. ValueError for a count below 1.
    """
    if count < 1:  # C ends the process where it divides by zero
        raise ValueError(f"count is {count}; expected at least 1 sector")
    layout: ScanLayout | None = layout_of(scan)
    if layout is None:
        return np.empty((0, 2))
    layout.set_sectors(count)
    if not _store_nearest_rays(layout, count, scan.range_min, within):
        return np.empty((0, 2))
    # A local minimum needs two neighbours.
    point_count = _store_local_minima(layout, count) if count >= 3 else 0
    if point_count == 0:
        point_count = _store_nearest_sectors(layout, count)
    return layout.points[:point_count].copy()


def _store_nearest_rays(layout: ScanLayout, count: int, range_min: float, within: float) -> bool:
    """Store the nearest ray of each of `count` sectors; False without a return up to `within` m.

    Sets `lowest`, the range of this ray, which is at least `range_min` m, and `nearest_ray`, its
    index. A sector without a return up to `within` has the range inf.
    """
    ranges = layout.known
    ray_count = layout.n
    lowest = layout.lowest
    is_seen = False
    for k in range(count):
        lowest[k] = INFINITY
        layout.nearest_ray[k] = 0
    for i in range(ray_count):
        distance = ranges[i]
        if distance < range_min:
            distance = range_min
        if distance <= within:
            is_seen = True
            k = layout.sector[i]
            if distance <= lowest[k]:
                lowest[k] = distance
                layout.nearest_ray[k] = i
    return is_seen


def _store_local_minima(layout: ScanLayout, count: int) -> int:
    """Store a point for each sector that is nearer than both neighbours; the number of points."""
    lowest = layout.lowest
    before = lowest[count - 1]
    point_count = 0
    for k in range(count):
        after = lowest[k + 1] if k + 1 < count else lowest[0]
        if lowest[k] < before and lowest[k] <= after:
            _store_point(layout, point_count, k)
            point_count += 1
        before = lowest[k]
    return point_count


def _store_nearest_sectors(layout: ScanLayout, count: int) -> int:
    """Store a point for each sector as near as the nearest sector; the number of points."""
    lowest = layout.lowest
    least = INFINITY
    point_count = 0
    for k in range(count):
        least = min(least, lowest[k])
    for k in range(count):
        if lowest[k] == least and least < INFINITY:
            _store_point(layout, point_count, k)
            point_count += 1
    return point_count


def _store_point(layout: ScanLayout, place: int, sector: int) -> None:
    layout.point[place, 0] = layout.lowest[sector]
    layout.point[place, 1] = layout.wrapped[layout.nearest_ray[sector]]


def clusters(scan: Scan, within: float, jump: float, grazing: float) -> list[tuple[Any, ...]]:
    """The objects in a scan, as `rays.RayClusters` lists them.

    An object is a run of neighbouring rays with returns of a single surface. Two neighbouring
    ranges belong to an object if they differ by at most `jump`, plus the change along a surface at
    the angle `grazing` to the ray.

    `scan`: the scan. `within`: m; returns beyond count as no return. `jump`: m. `grazing`: rad.
    """
    layout: ScanLayout | None = layout_of(scan)
    if layout is None:
        return []
    layout.set_grazing(grazing)
    if not _store_ranges(layout, scan.range_min, within):
        return []

    # Measures each object with a return, once around from the ray behind the last ray of an object.
    ray_count = layout.n
    ranges = layout.work
    is_last = layout.is_last
    first = _store_last_rays(layout, jump)
    last = first + ray_count - 1
    lowest = INFINITY
    objects: list[tuple[Any, ...]] = []
    for i in range(first, last + 1):
        k = i - ray_count if i >= ray_count else i  # the index wraps around
        if ranges[k] < lowest:
            lowest = ranges[k]
        if is_last[k] or i == last:  # `last` is no last ray if all rays are a single object
            if lowest < _UNSEEN:
                objects.append(_object(layout, first, i, lowest))
            first = i + 1
            lowest = INFINITY
    return objects


def _store_ranges(layout: ScanLayout, range_min: float, within: float) -> bool:
    """Store the ranges in the order of bearing; False if no ray has a return up to `within` m.

    The range is _UNSEEN for a ray without a return up to `within`, and at least `range_min` m.
    """
    known_ranges = layout.known
    order = layout.order
    ranges: Doubles = layout.work
    is_seen = False
    count = layout.n
    for i in range(count):
        distance = known_ranges[order[i]]
        if distance < range_min:
            distance = range_min
        if distance > within:
            distance = _UNSEEN
        else:
            is_seen = True
        ranges[i] = distance
    return is_seen


def _store_last_rays(layout: ScanLayout, jump: float) -> int:
    """Store in `is_last` which rays are the last ray of an object; the first ray of an object.

    The next ray is too far away from the last ray of an object: in angle (`is_apart`), or in range.
    Without a last ray all rays are a single object, which may begin at any ray: the result is 1.
    """
    ranges = layout.work
    slopes = layout.slopes
    is_apart = layout.is_apart
    is_last = layout.is_last
    count = layout.n
    first = 0
    for i in range(count):
        distance = ranges[i]
        after = ranges[i + 1] if i + 1 < count else ranges[0]
        nearer = after if after < distance else distance
        is_last[i] = is_apart[i] or fabs(distance - after) > jump + nearer * slopes[i]
        if first == 0 and is_last[i]:
            first = i + 1
    return max(first, 1)


def _object(layout: ScanLayout, first: int, last: int, lowest: float) -> tuple[Any, ...]:
    """The object of the rays `first` to `last`; indices beyond n wrap around."""
    n = layout.n
    begin = first % n
    end = last % n
    start = layout.rising[begin] + (TURN if first >= n else 0.0)
    stop = layout.rising[end] + (TURN if last >= n else 0.0)
    near = layout.work[begin]
    far = layout.work[end]
    spread = stop - start
    chord = hypot(near - far, 2.0 * sqrt(near * far) * sin(0.5 * spread))
    return (
        lowest,
        wrap(start + 0.5 * spread),
        max(chord, spread * lowest) + lowest * min(layout.spacing, PI),
        last - first + 1,
        layout.work[(begin + n - 1) % n] > near and layout.work[(end + 1) % n] > far,
    )
