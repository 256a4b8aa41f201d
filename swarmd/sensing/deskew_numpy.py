"""Motion of rays with numpy: the reference of `scan_kernel.move_rays`."""

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
