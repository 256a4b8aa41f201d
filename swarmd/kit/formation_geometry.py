"""The place of a robot in a formation, from its sensed neighbours, without leader or positions.

Points are x, y in m in the base frame of the robot, which is at the origin. The robot fits the
formation to all robots in sight and itself, and takes its own place in this formation. So robots
that see the same robots agree, and a complete formation does not move.

Line: the line fits the robots best by least squares (Yun, Alptekin and Albayrak, "Line and circle
formation of distributed physical mobile robots", J. Robotic Systems 14(2), 1997; the task is
Sugihara and Suzuki's, J. Robotic Systems 13(3), 1996). Ours: along the line, the places are those
of the evenly spaced row that fits the robots best.

Circle, ours: the places are the corners of the regular polygon that fits the robots best. A robot
between two neighbours takes the middle, as in Defago and Souissi, "Non-uniform circle formation
algorithm for oblivious mobile robots with convergence toward uniformity", Theor. Comput. Sci. 396,
2008.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swarmd.core.values import Array, Neighbor, Pose, Scan
from swarmd.kit import points as kernel
from swarmd.robot.sensing.rays import clusters

# Beyond this share of its range a lidar sees only parts of an object.
_MAX_RANGE_SHARE = 0.95
# A position is the mean of at most so many measurements. If a measurement differs from the mean by
# more than so many m plus this share of its distance, the robot has moved.
_MAX_AVERAGED = 20
_MOVED_DISTANCE = 0.06
_MOVED_SHARE = 0.08
# s for which a neighbour that is no longer sensed is assumed to stay where it was.
_TRACK_TIMEOUT = 2.0


def place_on_line(others: Array, spacing: float) -> Array:
    """The place (2,) of a robot at the origin in a line with `others` (k, 2).

    The line minimises the squared distances of the robots from the line (total least squares). The
    robots keep their order along the line, `spacing` m apart.
    """
    points = _with_itself(others)
    middle = _middle(points)
    away = [point - middle for point in points]
    xy = 0.0
    xx_yy = 0.0
    for offset in away:
        xy += offset.real * offset.imag
        xx_yy += offset.real * offset.real - offset.imag * offset.imag
    # The main axis of the points has half the angle of their second moments.
    ahead = cmath.rect(1.0, 0.5 * math.atan2(2.0 * xy, xx_yy))
    rank = _rank([offset.real * ahead.real + offset.imag * ahead.imag for offset in away])
    place = middle + (rank - 0.5 * (len(points) - 1)) * spacing * ahead
    return np.array((place.real, place.imag))


def place_on_circle(others: Array, radius: float) -> Array:
    """The place (2,) of a robot at the origin on a circle of `radius` m with `others` (k, 2).

    The center is the mean of all positions. The robots keep their order at equal angles.
    """
    points = _with_itself(others)
    middle = _middle(points)
    turn = 2.0 * math.pi / len(points)
    if len(points) < 2:
        return np.zeros(2)
    angles = [math.atan2((point - middle).imag, (point - middle).real) for point in points]
    # The angle of the first corner that fits best: the mean of angles, as of unit vectors.
    first_corner = 0j
    for number, angle in enumerate(sorted(angles)):
        first_corner += cmath.rect(1.0, angle - turn * number)
    place = middle + cmath.rect(radius, cmath.phase(first_corner) + turn * _rank(angles))
    return np.array((place.real, place.imag))


def radius_of(spacing: float, count: int) -> float:
    """The radius in m of the circle on which `count` robots are `spacing` m apart."""
    return spacing / (2.0 * math.sin(math.pi / count)) if count > 1 else 0.0


def robot_centers(scan: Scan, *, reach: float, width: float, offset: tuple[float, float]) -> Array:
    """The centers (k, 2) in m of objects up to `reach` m away and at most `width` m wide.

    `offset`: the position of the lidar in the base frame, in m. An object counts as deep as it is
    wide. An object that a nearer object hides on one side counts as wide as the median of the
    whole objects, from its visible edge on. An object that is hidden on both sides is ignored,
    since a wall behind two robots looks like such an object.
    """
    # If the scan were cut off at `reach`, the near part of a wall would seem as narrow as a robot.
    objects = clusters(scan, within=scan.range_max).objects
    centers = kernel.robot_centers([*objects], _MAX_RANGE_SHARE * reach, width, offset)
    return np.array(centers, dtype=np.float64).reshape(-1, 2)


def to_base_frame(point: Sequence[float], pose: Pose) -> tuple[float, float]:
    """A point x, y of the odometry frame, in the base frame at `pose`."""
    cos = math.cos(pose.yaw)
    sin = math.sin(pose.yaw)
    x = point[0] - pose.x
    y = point[1] - pose.y
    return cos * x + sin * y, cos * y - sin * x


def to_odometry_frame(point: Sequence[float], pose: Pose) -> tuple[float, float]:
    """A point x, y of the base frame at `pose`, in the odometry frame."""
    cos = math.cos(pose.yaw)
    sin = math.sin(pose.yaw)
    x, y = point
    return pose.x + cos * x - sin * y, pose.y + sin * x + cos * y


@dataclass(slots=True)
class _Track:
    """The last measurement of a neighbour, its time, and the mean position x + iy by odometry."""

    sensed: tuple[float, float]
    place: complex
    at: float
    count: int = 1


class NeighborTracker:
    """Positions of neighbours that are measured rarely and with noise while the robot moves.

    Each new range and bearing gives a position in the odometry frame. The positions of a neighbour
    that stands are averaged. A neighbour that is not sensed for a moment keeps its position.
    """

    def __init__(self) -> None:
        self._known: dict[str, _Track] = {}

    def update(self, neighbors: Sequence[Neighbor], pose: Pose, reach: float, now: float) -> Array:
        """The positions (k, 2) of the neighbours within `reach` m, in the base frame at `pose`."""
        known = self._known
        positions = []
        self._known = {}
        here = complex(pose.x, pose.y)
        heading = cmath.rect(1.0, pose.yaw)
        for neighbor in neighbors:
            distance = neighbor.distance
            bearing = neighbor.bearing
            track = known.get(neighbor.id)
            if distance is not None and bearing is not None and math.isfinite(distance + bearing):
                if not 0.0 <= distance <= reach:
                    continue
                if track is None or track.sensed != (distance, bearing):  # a new measurement
                    place = here + heading * cmath.rect(distance, bearing)
                    track = _again(track, (distance, bearing), place, now)
                track.at = now
            elif track is None or now - track.at > _TRACK_TIMEOUT:
                continue
            self._known[neighbor.id] = track
            positions.append((track.place - here) * heading.conjugate())
        return np.array(positions, dtype=np.complex128).view(np.float64).reshape(-1, 2)


def _again(old: _Track | None, sensed: tuple[float, float], place: complex, now: float) -> _Track:
    """The track after a new measurement: the mean, or a new track if the neighbour has moved."""
    if old is None or abs(old.place - place) > _MOVED_DISTANCE + _MOVED_SHARE * sensed[0]:
        return _Track(sensed, place, now)
    count = min(old.count + 1, _MAX_AVERAGED)
    return _Track(sensed, old.place + (place - old.place) / count, now, count)


def _with_itself(others: Array) -> list[complex]:
    """The robot and the others, as x + iy."""
    return [0j, *(complex(x, y) for x, y in others.reshape(-1, 2).tolist())]


def _middle(points: Sequence[complex]) -> complex:
    whole = 0j
    for point in points:  # sum() of newer Pythons rounds otherwise
        whole += point
    return whole / len(points)


def _rank(values: Sequence[float]) -> int:
    """The rank of the first value among all values."""
    return sum(value < values[0] for value in values)
