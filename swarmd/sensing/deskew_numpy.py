"""Motion of rays with numpy: the reference of the same functions of `scan_kernel`."""

from __future__ import annotations

import math

import numpy as np

from swarmd.core.values import Array

_TURN = 2.0 * math.pi


def move_rays(
    ranges: Array,
    bearings: Array,
    cos: Array,
    sin: Array,
    ages: Array,
    path: Array,
    limits: tuple[float, float, float, float],
) -> tuple[Array, Array]:
    """The ranges and bearings (n,) at the end of a path, of rays measured `ages` s before it.

    `cos` and `sin` (n,) of the bearings; `path` (m, 4) as of `OdometryHistory.path`, m >= 2;
    `limits`: the sensor's x and y in the base frame, range_min and range_max in m. A ray without a
    distance turns and keeps its class. A return that is nearer than range_min at the end of the
    path is -inf, too close to measure. The new bearings are within [-pi, pi).
    """
    offset_x, offset_y, range_min, range_max = limits
    x, y, turn = (np.interp(ages, path[:, 0], path[:, k]) for k in (1, 2, 3))
    c, s = np.cos(turn), np.sin(turn)
    ahead, left = c * cos - s * sin, s * cos + c * sin
    # How far the sensor was from its place at the end of the path.
    x = x + ((c - 1.0) * offset_x - s * offset_y)
    y = y + (s * offset_x + (c - 1.0) * offset_y)
    is_return = np.isfinite(ranges)
    along = np.where(is_return, ranges, 1.0) + (ahead * x + left * y)
    across = ahead * y - left * x
    distance = np.minimum(np.sqrt(along * along + across * across), range_max)
    distance = np.where(distance < range_min, -np.inf, distance)
    turned = bearings + turn + np.where(is_return, np.arctan2(across, along), 0.0)
    return np.where(is_return, distance, ranges), (turned + math.pi) % _TURN - math.pi


def rays_in_sector(
    ranges: Array,
    bearings: Array,
    ages: Array,
    first: int,
    way: tuple[float, float, float],
    sector: tuple[float, float, float],
    limits: tuple[float, float, float, float],
) -> tuple[Array, Array, Array]:
    """Ranges, bearings and ages (k,) of the rays that lie in a sector, from ray `first` on.

    `way`: x and y in m and yaw in rad of the place where all were measured, relative to the one for
    which ranges and bearings are returned; a ray counts if it lies in the sector as seen from one
    of the two. `sector`: the bearing of its start, 1.0 if it lies counter-clockwise of that or else
    -1.0, and its width in rad. `limits` as of `move_rays`.
    """
    ranges, bearings, ages = ranges[first:], bearings[first:], ages[first:]
    path, at = np.array(((0.0, *way), (1.0, *way))), np.zeros(len(ranges))
    cos, sin = np.cos(bearings), np.sin(bearings)
    moved, turned = move_rays(ranges, bearings, cos, sin, at, path, limits)
    start, direction, width = sector
    seen = np.stack((bearings + way[2], turned))
    inside = np.any(direction * (seen - start) % _TURN < width, axis=0)
    return moved[inside], turned[inside], ages[inside]
