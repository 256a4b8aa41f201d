"""From a direction vector to a command: keeps clear of near obstacles and steers the base.

Vectors are in the base frame (x forward, y left), of length 0 (stand) to 1 (full speed).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from swarmd.core.values import ZERO, Array, Twist

# A shorter vector is rounding noise: its direction means nothing.
_MIN_LENGTH = 1e-9
# Share of full speed in reverse: people beside a robot do not expect it to back up.
_MAX_REVERSE_SHARE = 0.5
# 1/s: at 5 scans a second the heading settles without overshoot.
_HEADING_GAIN = 2.0


def polar_from_base(
    points: Iterable[Sequence[float]], offset: tuple[float, float]
) -> list[tuple[float, float]]:
    """Range (m) and bearing of each point from the base.

    `points`: range and bearing of each from a sensor at `offset` (m).
    """
    found = []
    for distance, bearing in points:
        x = distance * math.cos(bearing) + offset[0]
        y = distance * math.sin(bearing) + offset[1]
        # With the bits of numpy's hypot; those of math.hypot may differ.
        found.append((abs(complex(x, y)), math.atan2(y, x)))
    return found


def from_base(points: Array, offset: tuple[float, float]) -> Array:
    """Points (k, 2) of range and bearing from a sensor at `offset` (m), relative to the base."""
    return np.array(polar_from_base(points.tolist(), offset), dtype=np.float64).reshape(-1, 2)


class NearPoints:
    """Points around the base, prepared for several steps.

    `nearest` is the smallest range in m, +inf without points.
    """

    __slots__ = ("_farthest_first", "nearest")

    def __init__(self, points: Iterable[Sequence[float]]) -> None:
        """`points`: range in m and bearing in rad of each."""
        self._farthest_first = [
            (distance, math.cos(bearing), math.sin(bearing))
            for distance, bearing in sorted(map(tuple, points), reverse=True)
        ]
        self.nearest = self._farthest_first[-1][0] if self._farthest_first else math.inf

    def keep_clear(
        self, x: float, y: float, *, spacing: float, brake: float
    ) -> tuple[float, float]:
        """The vector x, y limited as by the function `keep_clear`."""
        # The nearest come last, so that their limits hold exactly.
        for distance, toward_x, toward_y in self._farthest_first:
            excess = x * toward_x + y * toward_y - (distance - spacing) / brake
            if excess > 0.0:
                x, y = x - excess * toward_x, y - excess * toward_y
        return x, y

    def steer(
        self,
        x: float,
        y: float,
        linear_max: float,
        angular_max: float,
        *,
        spacing: float,
        brake: float,
        may_back: bool = False,
    ) -> Twist:
        """The command along the vector x, y as by the function `steer`."""
        length = math.hypot(x, y)
        if not _MIN_LENGTH < length < math.inf:
            return ZERO
        side = -1.0 if may_back and x < 0.0 else 1.0
        error = math.atan2(side * y, side * x)
        share = min(length, _MAX_REVERSE_SHARE if side < 0.0 else 1.0)
        share *= max(math.cos(error), 0.0) ** 2
        for distance, toward_x, _ in self._farthest_first:
            ahead = side * toward_x
            if ahead > 0.0:
                share = min(share, max(distance - spacing, 0.0) / (brake * ahead))
        turn = min(max(_HEADING_GAIN * error, -angular_max), angular_max)
        return Twist(linear=side * share * linear_max, angular=turn)


def keep_clear(vector: Array, points: Array, *, spacing: float, brake: float) -> Array:
    """The vector limited so that it leads no closer than `spacing` m to points (k, 2).

    Points are range, bearing. The component towards a point is at most (range - spacing) / brake:
    it falls from 1 at `spacing + brake` to 0 at `spacing`; nearer points push the vector away.
    """
    x, y = float(vector[0]), float(vector[1])
    return np.array(NearPoints(points.tolist()).keep_clear(x, y, spacing=spacing, brake=brake))


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
    """The command of a differential base along a vector: it turns, and drives once aligned.

    For a vector that points backwards it turns in place, or reverses at half speed with `may_back`.
    Points ahead limit the speed as in `keep_clear` while the base is still turning. A zero or
    non-finite vector gives zero.
    """
    x, y = float(vector[0]), float(vector[1])
    return NearPoints(points.tolist()).steer(
        x, y, linear_max, angular_max, spacing=spacing, brake=brake, may_back=may_back
    )
