"""From a direction vector to a command: keeps clear of near obstacles and steers the base.

Vectors are in the base frame (x forward, y left), of length 0 (stand) to 1 (full speed).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator

from swarmd.core.values import Array, Scan, Twist
from swarmd.kit.points import NearPoints, RobotsInSight, polar_from_base, to_middle
from swarmd.robot.sensing.rays import Ray, closest_points, nearest

__all__ = [
    "AHEAD_HALF_WIDTH",
    "Ahead",
    "NearPoints",
    "RobotsInSight",
    "away_from",
    "drive_along",
    "from_base",
    "keep_clear",
    "near_points",
    "polar_from_base",
    "steer",
    "to_middle",
    "turn_time",
]

AHEAD_HALF_WIDTH = math.radians(60.0)
"""To each side of ahead, in rad: a robot passes obstacles farther aside."""
_LEAST_TURN = 0.01  # rad/s: with less a turn takes no longer


def from_base(points: Array, offset: tuple[float, float]) -> Array:
    """Points (k, 2) of range and bearing from a sensor at `offset` (m), relative to the base."""
    return np.array(polar_from_base(points.tolist(), offset), dtype=np.float64).reshape(-1, 2)


def near_points(scan: Scan | None, *, within: float, offset: tuple[float, float]) -> NearPoints:
    """The closest points up to `within` m from a sensor at `offset` (m), seen from the base."""
    return NearPoints(polar_from_base(closest_points(scan, within=within).tolist(), offset))


def keep_clear(vector: Array, points: Array, *, spacing: float, brake: float) -> Array:
    """The vector limited so that it leads no closer than `spacing` m to `points`.

    `points`: (k, 2) range in m and bearing in rad. The component of the vector towards a point is
    limited to (range - spacing) / brake: to 1 at the range `spacing + brake`, to 0 at the range
    `spacing`. A nearer point makes the component negative, so that the vector leads away.
    """
    x = float(vector[0])
    y = float(vector[1])
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

    If the vector points backwards, the base turns in place, or reverses at half speed with
    `may_back`. Points ahead of the base limit the speed as in `keep_clear`, also while the base is
    still turning. A zero or non-finite vector gives zero.
    """
    return NearPoints(points.tolist()).steer(
        float(vector[0]),
        float(vector[1]),
        linear_max,
        angular_max,
        spacing=spacing,
        brake=brake,
        may_back=may_back,
    )


class Ahead:
    """Finds the nearest return within `AHEAD_HALF_WIDTH` of ahead, once for each scan."""

    def __init__(self) -> None:
        self._scan: Scan | None = None
        self._ray: Ray | None = None

    def within(self, distance: float, scan: Scan | None) -> Ray | None:
        """The return of `scan` if it is nearer to the sensor than `distance` m."""
        if scan is not self._scan:
            self._scan = scan
            self._ray = nearest(scan, half_width=AHEAD_HALF_WIDTH)
        ray = self._ray
        return ray if ray is not None and ray.range < distance else None


def away_from(ray: Ray | None, rng: Generator) -> float:
    """The side to turn to, away from `ray`: 1.0 left, -1.0 right; by chance if it is ahead."""
    side = float(rng.choice((-1.0, 1.0)))
    return -math.copysign(1.0, ray.bearing) if ray is not None and ray.bearing else side


def turn_time(angle: float, turn: float) -> float:
    """The time in s of a turn by `angle` rad at `turn` rad/s, which may be zero."""
    return angle / max(turn, _LEAST_TURN)


def drive_along(x: float, y: float, *, speed: float, turn: float, gain: float = 1.0) -> Twist:
    """The command along a vector, forward or backward, whichever needs less of a turn.

    The linear speed is `gain` times the forward part of the vector, at most `speed` m/s. The
    angular speed is 2 `gain` times the angle to the vector, at most `turn` rad/s.
    """
    angle = math.atan2(y, x) if x >= 0.0 else math.atan2(-y, -x)
    linear = max(-speed, min(speed, gain * x))
    return Twist(linear=linear, angular=max(-turn, min(turn, 2.0 * gain * angle)))
