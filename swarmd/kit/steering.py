"""From a wanted direction to a command: keeping clear of what is near, and steering a base.

Vectors are in the base frame, of length 0 (stand) to 1 (full speed), x forward, y left.
"""

from __future__ import annotations

import math

import numpy as np

from swarmd.core.values import ZERO, Array, Twist

# Shorter vectors are rounding noise: their direction means nothing.
_NO_DIRECTION = 1e-9
# Share of full speed when backing: people beside a robot do not expect it.
_BACK_SPEED = 0.5
# 1/s: at 5 scans a second the heading settles without overshoot.
_HEADING_GAIN = 2.0


def from_base(points: Array, offset: tuple[float, float]) -> Array:
    """Points (k, 2) of range, bearing seen by a sensor at `offset`, as seen from the base."""
    x = points[:, 0] * np.cos(points[:, 1]) + offset[0]
    y = points[:, 0] * np.sin(points[:, 1]) + offset[1]
    seen = np.empty((len(points), 2))
    seen[:, 0] = np.hypot(x, y)
    seen[:, 1] = np.arctan2(y, x)
    return seen


def keep_clear(vector: Array, points: Array, *, spacing: float, brake: float) -> Array:
    """The vector without what leads closer than `spacing` m to points (k, 2) of range, bearing.

    Its component towards a point is at most (range - spacing) / brake: it falls from 1 at
    `spacing + brake` to 0 at `spacing`, and nearer than that the vector is pushed away.
    """
    x, y = float(vector[0]), float(vector[1])
    # The nearest come last, so that they are obeyed exactly.
    for distance, bearing in sorted(points.tolist(), reverse=True):
        toward_x, toward_y = math.cos(bearing), math.sin(bearing)
        excess = x * toward_x + y * toward_y - (distance - spacing) / brake
        if excess > 0.0:
            x, y = x - excess * toward_x, y - excess * toward_y
    return np.array([x, y])


def steer(
    vector: Array,
    linear_max: float,
    angular_max: float,
    *,
    points: Array,
    spacing: float,
    brake: float,
    may_back: bool = False,
) -> Twist:
    """The command of a differential base along a vector: it turns, and drives where aligned.

    A target behind means turning in place, or backing at half speed with `may_back`. While the
    heading is not yet that of the vector, points ahead hold the speed as in `keep_clear`. A zero
    or non-finite vector gives zero.
    """
    x, y = float(vector[0]), float(vector[1])
    length = math.hypot(x, y)
    if not _NO_DIRECTION < length < math.inf:
        return ZERO
    side = -1.0 if may_back and x < 0.0 else 1.0
    error = math.atan2(side * y, side * x)
    share = min(length, _BACK_SPEED if side < 0.0 else 1.0) * max(math.cos(error), 0.0) ** 2
    for distance, bearing in points.tolist():
        ahead = side * math.cos(bearing)
        if ahead > 0.0:
            share = min(share, max(distance - spacing, 0.0) / (brake * ahead))
    turn = min(max(_HEADING_GAIN * error, -angular_max), angular_max)
    return Twist(linear=side * share * linear_max, angular=turn)
