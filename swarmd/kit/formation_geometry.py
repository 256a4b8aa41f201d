"""Places in a formation from what one robot senses of the others, without leader or positions.

Points are x, y in m in the base frame of the robot, which is at the origin. The robot fits the
formation to all robots in sight and itself, and takes its own place in it. So robots that see the
same agree, and a complete formation stays as it is.

Line: the closest point of the line that fits best by least squares (Yun, Alptekin and Albayrak,
"Line and circle formation of distributed physical mobile robots", J. Robotic Systems 14(2), 1997;
the task is Sugihara and Suzuki's, J. Robotic Systems 13(3), 1996). Ours: the spacing along it, and
the places on a circle, are those of the evenly spaced row or polygon that fits best. With one
neighbour on each side that is the middle between them, as in Defago and Souissi,
"Non-uniform circle formation algorithm for oblivious mobile robots with convergence toward
uniformity", Theor. Comput. Sci. 396, 2008.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from swarmd.core.values import Array, Neighbor, Pose, Scan
from swarmd.kit.steering import from_base
from swarmd.sensing.rays import RayClusters, clusters

# Beyond this share of its range a lidar sees only parts of an object.
_MAX_RANGE_SHARE = 0.95
# rad: the largest angle between two objects of which one hides a part of the other.
_MAX_OCCLUSION_ANGLE = math.radians(3.0)
# Centers nearer to each other than this share of the largest width belong to one robot.
_MERGE_SHARE = 0.45
# A position is the mean of at most so many measurements. A measurement farther from it than so many
# m plus this share of its distance means that the robot has moved.
_MAX_AVERAGED = 20
_MOVED_DISTANCE, _MOVED_SHARE = 0.06, 0.08
# s for which a neighbour that is no longer sensed is assumed to stay where it was.
_TRACK_TIMEOUT = 2.0


def place_on_line(others: Array, spacing: float) -> Array:
    """The place (2,) of a robot at the origin in a line with `others` (k, 2).

    The line minimises the squared distances from it (total least squares); along it the robots keep
    their order, `spacing` m apart.
    """
    points = _with_itself(others)
    middle = points.sum(axis=0) / len(points)
    x, y = (points - middle).T
    angle = 0.5 * math.atan2(2.0 * float(x @ y), float(x @ x) - float(y @ y))
    ahead = np.array([math.cos(angle), math.sin(angle)])
    rank = _rank(x * ahead[0] + y * ahead[1])
    along = (rank - 0.5 * (len(points) - 1)) * spacing
    place: Array = middle + along * ahead
    return place


def place_on_circle(others: Array, radius: float) -> Array:
    """The place (2,) of a robot at the origin on a circle of `radius` m with `others` (k, 2).

    The center is the mean of all positions; around it the robots keep their order at equal angles.
    """
    points = _with_itself(others)
    count = len(points)
    middle: Array = points.sum(axis=0) / count
    if count < 2:
        return middle
    x, y = (points - middle).T
    angles = np.arctan2(y, x)
    order = np.argsort(angles, kind="stable")
    off = angles[order] - 2.0 * math.pi / count * np.arange(count)
    first = math.atan2(float(np.sin(off).sum()), float(np.cos(off).sum()))
    own = first + 2.0 * math.pi / count * _rank(angles)
    place: Array = middle + radius * np.array([math.cos(own), math.sin(own)])
    return place


def radius_of(spacing: float, count: int) -> float:
    """The radius in m of the circle on which `count` robots are `spacing` m apart."""
    return spacing / (2.0 * math.sin(math.pi / count)) if count > 1 else 0.0


def robot_centers(scan: Scan, *, reach: float, width: float, offset: tuple[float, float]) -> Array:
    """The centers (k, 2) of objects up to `reach` m away and at most `width` m wide.

    `offset` is the lidar's from the axle. An object is assumed to be as deep as it is wide. An
    object hidden on one side by a nearer one is assumed to be as wide as the others, measured from
    its visible side. An object hidden on both sides may be a wall behind two robots: it is ignored.
    """
    seen = clusters(scan, within=reach)
    halves, bearings = 0.5 * seen.widths, seen.bearings.copy()
    is_chosen = (seen.widths <= width) & (seen.ranges <= _MAX_RANGE_SHARE * reach)
    is_whole = is_chosen & seen.is_free
    usual = median(halves[is_whole].tolist()) if is_whole.any() else 0.0
    for index in (is_chosen & ~seen.is_free).nonzero()[0].tolist():
        sides = _hidden_sides(seen, index)
        if len(sides) > 1:
            is_chosen[index] = False
        elif sides:
            half = max(float(halves[index]), usual)
            shown = float(halves[index] / max(seen.ranges[index], 1e-3))
            whole = math.asin(half / (float(seen.ranges[index]) + half))
            bearings[index] += sides[0] * max(whole - shown, 0.0)
            halves[index] = half
    found = np.array((seen.ranges[is_chosen] + halves[is_chosen], bearings[is_chosen])).T
    found = from_base(found, offset)
    centers = found[:, :1] * np.stack((np.cos(found[:, 1]), np.sin(found[:, 1])), axis=-1)
    return _merged(centers, seen.counts[is_chosen].tolist(), _MERGE_SHARE * width)


def _merged(centers: Array, counts: Sequence[int], least: float) -> Array:
    """Centers (k, 2) with those nearer than `least` m to each other merged, nearest pair first.

    One robot appears in pieces where rays are lost, or old while the lidar turns. `counts` weighs
    them.
    """
    if len(centers) < 2:
        return centers
    points, weights = centers[:, 0] + 1j * centers[:, 1], np.array(counts, float)
    apart = np.abs(points[:, None] - points)
    np.fill_diagonal(apart, np.inf)
    while len(points) > 1 and apart.min() < least:
        i, j = sorted(divmod(int(apart.argmin()), len(points)))
        points[i] += (points[j] - points[i]) * weights[j] / (weights[i] + weights[j])
        weights[i] += weights[j]
        points, weights = np.delete(points, j), np.delete(weights, j)
        apart = np.delete(np.delete(apart, j, axis=0), j, axis=1)
        apart[i] = apart[:, i] = np.abs(points - points[i])
        apart[i, i] = np.inf
    return np.stack((points.real, points.imag), axis=-1)


def _hidden_sides(seen: RayClusters, index: int) -> list[float]:
    """The sides on which a nearer object hides a part of it: 1 left, -1 right."""
    away = (seen.bearings - seen.bearings[index] + math.pi) % (2.0 * math.pi) - math.pi
    spreads = 0.5 * seen.widths / np.maximum(seen.ranges, 1e-3)
    room = np.abs(away) - spreads - spreads[index]
    is_before = (seen.ranges < seen.ranges[index]) & (room < _MAX_OCCLUSION_ANGLE)
    return [side for side in (1.0, -1.0) if (is_before & (side * away > 0.0)).any()]


def to_base_frame(point: Sequence[float], pose: Pose) -> tuple[float, float]:
    """A point x, y of the odometry frame, in the base frame at `pose`."""
    cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
    x, y = point[0] - pose.x, point[1] - pose.y
    return cos * x + sin * y, cos * y - sin * x


def to_odometry_frame(point: Sequence[float], pose: Pose) -> tuple[float, float]:
    """A point x, y of the base frame at `pose`, in the odometry frame."""
    cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
    x, y = point
    return pose.x + cos * x - sin * y, pose.y + sin * x + cos * y


@dataclass(slots=True)
class _Track:
    """A neighbour's last measurement and its time, and its mean position x + iy."""

    sensed: tuple[float, float]
    place: complex
    at: float
    count: int = 1


class NeighborTracker:
    """Positions of neighbours that are measured rarely and with noise while the robot moves.

    Each new range and bearing is transformed to the odometry frame; repeated measurements of one
    place are averaged. A neighbour that is not sensed for a moment keeps its position.
    """

    def __init__(self) -> None:
        self._known: dict[str, _Track] = {}

    def update(self, neighbors: Sequence[Neighbor], pose: Pose, reach: float, now: float) -> Array:
        """The positions (k, 2) of the neighbours within `reach` m, in the base frame at `pose`."""
        known, found = self._known, []
        self._known = {}
        here, heading = complex(pose.x, pose.y), cmath.rect(1.0, pose.yaw)
        for neighbor in neighbors:
            distance, bearing = neighbor.distance, neighbor.bearing
            track = known.get(neighbor.id)
            if distance is not None and bearing is not None and math.isfinite(distance + bearing):
                if not 0.0 <= distance <= reach:
                    continue
                if track is None or track.sensed != (distance, bearing):
                    place = here + heading * cmath.rect(distance, bearing)
                    track = _again(track, (distance, bearing), place, now)
                track.at = now
            elif track is None or now - track.at > _TRACK_TIMEOUT:
                continue
            self._known[neighbor.id] = track
            found.append((track.place - here) * heading.conjugate())
        return np.array(found, dtype=np.complex128).view(np.float64).reshape(-1, 2)


def _again(old: _Track | None, sensed: tuple[float, float], place: complex, now: float) -> _Track:
    if old is None or abs(old.place - place) > _MOVED_DISTANCE + _MOVED_SHARE * sensed[0]:
        return _Track(sensed, place, now)
    count = min(old.count + 1, _MAX_AVERAGED)
    return _Track(sensed, old.place + (place - old.place) / count, now, count)


def _with_itself(others: Array) -> Array:
    return np.concatenate((np.zeros((1, 2)), others.reshape(-1, 2)))


def _rank(values: Array) -> int:
    """The rank of the first value among all values."""
    return int(np.argsort(values, kind="stable").argmin())
