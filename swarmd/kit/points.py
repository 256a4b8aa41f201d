"""The arithmetic on points around the base: steering, and robots among the objects of a scan.

A kernel (see `core/kernels.py`): `steering.py`, `robot_detection.py` and `formation_geometry.py`
use it.
"""

from __future__ import annotations

import math
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import (
    INFINITY,
    NAN,
    Table,
    asin,
    atan2,
    cos,
    fabs,
    hypot,
    isinf,
    isnan,
    remainder,
    sin,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import TypeAlias

    from swarmd.core.values import Scan

    Pair: TypeAlias = tuple[float, float]

from swarmd.core.values import ZERO, Twist

_PI = math.pi
# A shorter vector is rounding noise: its direction means nothing.
_MIN_LENGTH = 1e-9
# Share of full speed in reverse: people beside a robot do not expect it to back up.
_MAX_REVERSE_SHARE = 0.5
# 1/s: at 5 scans a second the heading settles without overshoot.
_HEADING_GAIN = 2.0
# rad: the largest angle between two objects of which one hides a part of the other.
_MAX_OCCLUSION_ANGLE = math.radians(3.0)
# Centers nearer to each other than this share of the largest width belong to one robot.
_MERGE_SHARE = 0.45
# A robot farther than this share of the range at which it is lost pulls as one at this share.
_MAX_LOSS_SHARE = 0.95
# m from the nearest ray of an object to the middle of a robot: half a body, and the error of both.
_SAME_PLACE = 0.35
# rad on each side of a robot whose rays say nothing of the free space.
_MARGIN = 0.05
# m: a nearer object counts as one at this range where its range divides.
_MIN_RANGE = 1e-3


def polar_from_base(points: Iterable[Sequence[float]], offset: Pair) -> list[Pair]:
    """(range in m, bearing in rad) of each point, seen from the base.

    `points`: (range, bearing) of each point, seen from a sensor at `offset` (m) in the base frame.
    """
    forward = offset[0]
    left = offset[1]
    found = []
    for distance, bearing in points:
        _check(bearing)
        x = distance * cos(bearing) + forward
        y = distance * sin(bearing) + left
        found.append((hypot(x, y), atan2(y, x)))
    return found


def _check(bearing: float) -> None:
    if isinf(bearing):
        raise ValueError("a bearing is infinite; expected an angle")


@cython.cclass
class NearPoints:
    """Points around the base, such as returns of a scan, for `keep_clear` and `steer`.

    `nearest`: the smallest range in m, +inf without points.
    """

    nearest: float
    _farthest_first: list[Any]

    def __init__(self, points: Iterable[Sequence[float]]) -> None:
        """`points`: range in m and bearing in rad of each."""
        distance = INFINITY
        self._farthest_first = []
        for distance, bearing in sorted(map(tuple, points), reverse=True):
            _check(bearing)
            self._farthest_first.append((distance, cos(bearing), sin(bearing)))
        self.nearest = distance

    def keep_clear(self, x: float, y: float, *, spacing: float, brake: float) -> Pair:
        """The vector x, y limited as by the function `keep_clear`."""
        # The nearest come last, so that their limits hold exactly.
        for distance, toward_x, toward_y in self._farthest_first:
            if brake == 0.0:
                raise ZeroDivisionError("brake is 0 m")
            excess = x * toward_x + y * toward_y - (distance - spacing) / brake
            if excess > 0.0:
                x = x - excess * toward_x
                y = y - excess * toward_y
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
        """The command of a differential drive along the vector (x, y), slower before points.

        (x, y): direction in the base frame; its length is the share of full speed, up to 1.
        `linear_max` in m/s and `angular_max` in rad/s: full speed. `spacing`: the range in m of a
        point ahead at which the base stands. `brake`: the distance in m before that range over
        which the base slows down. `may_back`: drive in reverse to a target behind. Zero for a
        vector of no length or infinite length.
        """
        length = math.hypot(x, y)
        if not _MIN_LENGTH < length < INFINITY:
            return ZERO
        sign = -1.0 if may_back and x < 0.0 else 1.0  # of the motion: -1 in reverse
        speed_share = min(length, _MAX_REVERSE_SHARE if sign < 0.0 else 1.0)
        # The base slows down with the error of its heading, and only turns from 90 degrees on.
        heading_error = atan2(sign * y, sign * x)
        speed_share *= math.pow(max(cos(heading_error), 0.0), 2.0)
        # The speed toward a point falls from full speed at the range spacing + brake to zero at the
        # range spacing. `toward_x`, the cosine of the bearing, is the share of the speed that leads
        # toward the point.
        for distance, toward_x, _ in self._farthest_first:
            ahead = sign * toward_x
            if ahead > 0.0:
                if brake == 0.0:  # compiled code would not raise by itself
                    raise ZeroDivisionError("brake is 0 m")
                speed_share = min(speed_share, max(distance - spacing, 0.0) / (brake * ahead))
        turn = min(max(_HEADING_GAIN * heading_error, -angular_max), angular_max)
        return Twist(sign * speed_share * linear_max, turn)


@cython.cclass
class RobotsInSight:
    """The objects of a scan that may be robots, in the order of their bearings from the lidar.

    `objects`: all of them, as in `RayClusters`, from the lidar. `narrow`: all objects no wider than
    a robot; those beyond reach only beside named robots. `polar`: range in m and bearing in rad,
    from the base, of each of `objects` that no nearer object hides in part.
    """

    objects: list[Any]
    narrow: list[Any]
    polar: list[Pair]

    def __init__(
        self,
        objects: Iterable[Any],
        width: float,
        reach: float,
        offset: Pair,
        named: Iterable[Pair] = (),
    ) -> None:
        """`objects` as in `RayClusters`, from the lidar at `offset` (m); a robot is at most `width`
        m wide and `reach` m away.

        `named`: m and rad from the base to the middles of robots. If there are any, an object is a
        robot if it is at one of them, however wide it is.
        """
        places = [(d * cos(b), d * sin(b)) for d, b in named]
        forward = offset[0]
        left = offset[1]
        self.objects = []
        self.polar = []
        self.narrow = [] if places else self.objects
        for one in objects:
            row: tuple[Any, ...] = tuple(one)  # of a tuple itself, whose items C reads faster
            away = row[0]
            is_narrow = row[2] <= width
            if places and is_narrow:
                self.narrow.append(one)
            if away <= reach and (_is_at(one, offset, places) if places else is_narrow):
                self.objects.append(one)
                if row[4]:
                    bearing = row[1]
                    _check(bearing)
                    x = away * cos(bearing) + forward
                    y = away * sin(bearing) + left
                    self.polar.append((hypot(x, y), atan2(y, x)))

    def arrangement(self, near: float) -> tuple[int, float]:
        """The number of robots of `polar` nearer than `near` m, and how well all lie on one line.

        The second is the length of the sum of exp(2i bearing): their number on one line.
        """
        count = 0
        x = 0.0
        y = 0.0
        for distance, bearing in self.polar:
            count += distance < near
            x += cos(2.0 * bearing)  # doubled: ahead and behind are one line
            y += sin(2.0 * bearing)
        return count, hypot(x, y)

    def pull(self, spacing: float, brake: float, reach: float) -> Pair:
        """The sum of the attraction of all robots: a vector in the base frame.

        The attraction of a robot is 0 up to `spacing` m and grows with its range, by 1 for each
        `brake` m at first, and beyond all bounds near `reach` m, as potentials do that keep robots
        connected (Ji and Egerstedt, "Distributed coordination control of multiagent systems while
        preserving connectedness", 2007).
        """
        x = 0.0
        y = 0.0
        if brake == 0.0 or reach == 0.0:  # compiled code would not raise by itself
            raise ZeroDivisionError(f"brake is {brake} m and reach {reach} m")
        for distance, bearing in self.polar:
            if distance > spacing:
                rest = 1.0 - min(distance / reach, _MAX_LOSS_SHARE)
                weight = (distance - spacing) / (brake * rest)
                x += weight * cos(bearing)
                y += weight * sin(bearing)
        return x, y

    def keep_in_sight(self, x: float, y: float, *, reach: float, brake: float) -> Pair:
        """The vector (x, y), limited so that it leads no farther than `reach` m from the robots.

        As `keep_clear` with the opposite sign: the component away from a robot is at most 1 at the
        range `reach` - `brake`, and 0 at `reach`.
        """
        if brake == 0.0:  # compiled code would not raise by itself
            raise ZeroDivisionError("brake is 0 m")
        for distance, bearing in self.polar:
            ahead = cos(bearing)
            left = sin(bearing)
            excess = -(x * ahead + y * left) - max(reach - distance, 0.0) / brake
            if excess > 0.0:
                x = x + excess * ahead
                y = y + excess * left
        return x, y


def _is_at(one: Any, offset: Pair, places: list[Pair]) -> bool:
    """True if an object is at one of the places, m from the base."""
    x = offset[0] + one[0] * math.cos(one[1])
    y = offset[1] + one[0] * math.sin(one[1])
    return any([math.hypot(ahead - x, left - y) < _SAME_PLACE for ahead, left in places])


def to_middle(scan: Scan, robots: Iterable[Sequence[Any]]) -> Pair:
    """A vector in m towards the middle of the free space around a lidar, 0 in the open.

    The mean of range times direction over all rays, less the mean range times the mean direction: a
    lidar that does not look all around has its rays on one side. No return counts as `range_max`.
    In the middle of a round room the vector is 0, beside it half as long as the way there.

    `robots`: range in m, bearing in rad and width in m of each, whose rays are left out.
    """
    rays = np.array((scan.ranges, scan.bearings), np.float64)
    rays[0].clip(scan.range_min, scan.range_max, out=rays[0])  # NaN stays
    # The ranges and bearings, known ones first. CPython reads a memoryview faster than an array.
    ray: Table = rays if cython.compiled else rays.data
    count = 0
    for robot in robots:
        bearing = robot[1]
        half = math.atan2(0.5 * robot[2], robot[0]) + _MARGIN
        for i in range(ray.shape[1]):
            if not fabs(remainder(ray[1, i] - bearing, 2.0 * _PI)) > half:
                ray[0, i] = NAN
    for i in range(ray.shape[1]):
        if not isnan(ray[0, i]):
            ray[0, count] = ray[0, i]
            ray[1, count] = ray[1, i]
            count += 1
    if count == 0:
        return 0.0, 0.0
    # By numpy, whose sums have another order than a loop.
    ranges, bearings = rays[:, :count]
    weights = (ranges - np.add.reduce(ranges) / count) / count
    return float(weights @ np.cos(bearings)), float(weights @ np.sin(bearings))


def robot_centers(objects: list[Any], reach: float, width: float, offset: Any) -> list[Any]:
    """The centers (x, y) of the objects of a scan that may be robots, in m in the base frame.

    `objects` (clusters of rays) as in `RayClusters`, seen from the lidar at `offset` (m). An object
    may be a robot if it is at most `width` m wide and `reach` m away. Skips an object that is
    hidden on both sides.
    """
    if not objects:
        return []
    ranges, bearings, widths, counts, is_free = map(list, zip(*objects))  # noqa: B905
    candidates = [i for i in range(len(ranges)) if widths[i] <= width and ranges[i] <= reach]
    whole_halves = [0.5 * widths[i] for i in candidates if is_free[i]]
    usual_half = median(whole_halves) if whole_halves else 0.0
    # (range, bearing) from the lidar, and number of rays
    centers = []
    weights = []
    for i in candidates:
        away = ranges[i]
        bearing = bearings[i]
        half = 0.5 * widths[i]
        side = 0 if is_free[i] else _hidden_side(ranges, bearings, widths, i)
        if side == _BOTH:
            continue
        if side:  # the whole object is assumed to be as wide as the median
            half = max(half, usual_half)
            bearing += side * _angle_to_center(away, widths[i], half)
        # The center lies half a width behind the visible side.
        centers.append((away + half, bearing))
        weights.append(counts[i])
    xs = []
    ys = []
    for away, bearing in polar_from_base(centers, offset):
        xs.append(away * cos(bearing))
        ys.append(away * sin(bearing))
    # A robot may appear in several pieces: merge centers that are too near for two robots.
    _merge(xs, ys, weights, _MERGE_SHARE * width)
    return list(zip(xs, ys))  # noqa: B905


_BOTH = 2


def _hidden_side(
    ranges: list[float], bearings: list[float], widths: list[float], index: int
) -> int:
    """The side on which nearer objects hide the object `index`: 1 left, -1 right, 0, or `_BOTH`."""
    own_range = ranges[index]
    own_bearing = bearings[index]
    reach = _spread(own_range, widths[index]) + _MAX_OCCLUSION_ANGLE
    side = 0
    for i in range(len(ranges)):
        near = ranges[i]
        if near < own_range:
            angle = bearings[i] - own_bearing
            if angle >= _PI:
                angle -= 2.0 * _PI
            elif angle < -_PI:
                angle += 2.0 * _PI
            if angle != 0.0 and fabs(angle) - _spread(near, widths[i]) < reach:
                if side * angle < 0.0:
                    return _BOTH
                side = 1 if angle > 0.0 else -1
    return side


def _spread(distance: float, width: float) -> float:
    """Half the angle in rad under which an object is seen."""
    return 0.5 * width / max(distance, _MIN_RANGE)


def _angle_to_center(away: float, visible_width: float, radius: float) -> float:
    """The angle in rad from the middle of an object's visible part to the object's center.

    The object is a circle of `radius` m, `away` m from the lidar, whose one side is hidden. The
    edge of the other side lies `edge_angle` from the middle of the visible part, and
    `center_angle` from the center.
    """
    edge_angle = _spread(away, visible_width)
    center_angle = asin(radius / max(away + radius, _MIN_RANGE))
    return max(center_angle - edge_angle, 0.0)


def _merge(xs: list[float], ys: list[float], weights: list[int], least: float) -> None:
    """Merge points nearer than `least` m to each other, the nearest pair first.

    A robot appears in pieces where rays are lost, or where it moves while the lidar turns. A merged
    point lies at the weighted mean. Changes the three lists (m, m, number of rays) in place.
    """
    first = 0
    while True:
        # The nearest pair; `second` is 0 if no pair is near enough, since second > first.
        shortest = least
        second = 0
        for i in range(len(xs)):
            x = xs[i]
            y = ys[i]
            for j in range(i + 1, len(xs)):
                distance = hypot(xs[j] - x, ys[j] - y)
                if distance < shortest:
                    shortest = distance
                    first = i
                    second = j
        if not second:
            return  # for compiled callers: no error was raised
        # The pair becomes one point.
        share = weights[second] / (weights[first] + weights[second])
        xs[first] += (xs[second] - xs[first]) * share
        ys[first] += (ys[second] - ys[first]) * share
        weights[first] += weights[second]
        del xs[second], ys[second], weights[second]
