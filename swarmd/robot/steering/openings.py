"""Openings: the gaps in walls that the scans of one robot show, such as doors. Pure.

An opening is the gap from the end of a wall (a post) to the nearest other return of a wall (after
Mujahed, Fischer and Mertsching, "Safe gap based (SG) reactive navigation", ECMR 2013). The place of
an opening is kept in the frame of the odometry.

A kernel (see `core/kernels.py`), since each scan passes it. right_of_way.py calls it.
"""

from __future__ import annotations

from operator import itemgetter
from typing import Any

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import PI, TURN
from swarmd.core.buffers import scratch, view
from swarmd.core.cython_shadow import (
    Doubles,
    Indices,
    Table,
    atan,
    atan2,
    cos,
    fabs,
    hypot,
    remainder,
    sin,
)
from swarmd.core.values import Array, Pose, Scan
from swarmd.robot.steering.tracks import ScanReturns

_MAX_RANGE = 2.5  # m from the lidar within which openings are seen
_JUMP = 0.25  # m between neighbouring ranges at the end of a wall
# Widths of the robot, and m: through a wider opening two robots pass side by side.
_NARROWEST_SHARE = 1.5
_WIDEST = 1.0
_MIN_RETURNS = 10  # a scan with fewer returns shows no opening
_MIN_RAYS = 3  # between the posts of an opening
# m by which a return between the posts may be nearer than the farther post
_POST_SLACK = 0.02
# Share of the returns between the posts that must be farther.
_CLEAR_SHARE = 0.9
_MIN_WALL = 0.2  # m of wall to each side of an opening at least
_FACE_LENGTH = 0.8  # m of this wall whose returns give its direction
_MIN_FACE_RETURNS = 6  # of these returns at least
# m from the line of a wall within which a return belongs to it
_ON_WALL = 0.1
_MAX_HOLE = 0.22  # m between neighbouring returns of a wall at most
# m from the outline of a track within which a return is no wall
_TRACK_SLACK = 0.12
# Two sightings with differences below these are the same opening: m, m, m, rad.
_SAME_AXIS = 0.14
_SAME_HALF = 0.08
_SAME_SPAN = 0.2
_SAME_ANGLE = 0.4
# Weight of the lengths of a new sighting: others may hide a part of what it shows.
_LENGTH_WEIGHT = 0.4
SIGHTINGS = 2
"""Sightings of an opening before right of way uses it."""
# s without a sighting after which an opening is forgotten
_FORGET_SINGLE = 5.0
_FORGET = 120.0
_MAX_OPENINGS = 8  # openings
_MAX_WALL_ENDS = 40  # of walls in one scan, the nearest: more are rain, grass or railings


def _reach(places: Doubles, count: int) -> float:
    """How far in m the first `count` places reach from 0 without a gap of more than _MAX_HOLE."""
    reach = 0.0
    before = -1.0
    while reach > before:
        before = reach
        for i in range(count):
            if reach < places[i] and places[i] - reach <= _MAX_HOLE:
                reach = places[i]
    return reach


@cython.cclass
class _PlacedReturns:
    """The returns of one scan in order of bearing, in the frame of the odometry. All in m."""

    ranges: Doubles
    bearings: Doubles  # rad
    x: Doubles
    y: Doubles
    tracks: Doubles  # x, y, square of the radius with slack of each moving object
    # The place of the sensor in the base frame, and the pose of the base by odometry.
    offset_x: float
    offset_y: float
    pose_x: float
    pose_y: float
    pose_cos: float
    pose_sin: float
    is_wall: Indices  # the return is near, and no part of a track
    # The `count` returns of walls in the frame of one opening, and room for a number for each.
    count: int
    along: Doubles
    side: Doubles
    places: Doubles

    def take(self, returns: ScanReturns, offset: Any, pose: Pose) -> None:
        """Take the returns, which the sensor at `offset` saw from `pose`, and make room."""
        yaw = pose.yaw
        # All buffers from one allocation, which costs as much as a hundred returns.
        n = returns.count
        room = scratch(5 * n)
        self.ranges = returns.ranges[:n]
        self.bearings = returns.bearings[:n]
        self.x = room[:n]
        self.y = room[n : 2 * n]
        self.along = room[2 * n : 3 * n]
        self.side = room[3 * n : 4 * n]
        self.places = room[4 * n :]
        self.offset_x, self.offset_y = offset
        self.pose_x = pose.x
        self.pose_y = pose.y
        self.pose_cos = cos(yaw)
        self.pose_sin = sin(yaw)

    def place(self, row: int) -> None:
        """Set `x` and `y` of a return."""
        x = self.offset_x + self.ranges[row] * cos(self.bearings[row])
        y = self.offset_y + self.ranges[row] * sin(self.bearings[row])
        self.x[row] = self.pose_x + self.pose_cos * x - self.pose_sin * y
        self.y[row] = self.pose_y + self.pose_sin * x + self.pose_cos * y

    def set_tracks(self, tracks: tuple[Any, ...]) -> None:
        """Set `tracks`, each given as (x, y, radius)."""
        k = 0
        self.tracks = scratch(3 * len(tracks))
        for x, y, radius in tracks:
            radius += _TRACK_SLACK
            self.tracks[k] = x
            self.tracks[k + 1] = y
            self.tracks[k + 2] = radius * radius
            k += 3

    def ends(self) -> list[Any]:
        """The ends of surfaces where the range jumps, as (range, order, return, direction).

        The direction is 1 or -1: the step of the index towards the farther neighbour. `order` is
        the index of the return before the jump, by which ends are sorted by bearing. `return` is
        the index of the nearer return.
        """
        n = len(self.ranges)
        ends: list[Any] = []
        for i in range(n):
            j = i + 1 if i + 1 < n else 0
            step = self.ranges[j] - self.ranges[i]
            if step > _JUMP and self.ranges[i] < _MAX_RANGE:
                ends.append((self.ranges[i], i, i, 1))
            elif step < -_JUMP and self.ranges[j] < _MAX_RANGE:
                ends.append((self.ranges[j], i, j, -1))
        return ends

    def is_free(self, row: int) -> bool:
        """True for a return that is no part of a track."""
        tracks = self.tracks
        x = self.x[row]
        y = self.y[row]
        for i in range(0, len(tracks), 3):
            dx = x - tracks[i]
            dy = y - tracks[i + 1]
            if dx * dx + dy * dy <= tracks[i + 2]:
                return False
        return True

    def mark_walls(self) -> None:
        """Set `is_wall` of each return, and the places of the near returns."""
        n = len(self.ranges)
        self.is_wall = np.empty(n, np.uint8).data
        for row in range(n):
            if self.ranges[row] < _MAX_RANGE:
                self.place(row)
            self.is_wall[row] = self.ranges[row] < _MAX_RANGE and self.is_free(row)

    def partner(self, post: int, direction: int, narrowest: float) -> int:
        """The index of the other post of an opening: the return of a wall nearest to `post`.

        -1 if there is no opening: the gap is narrower than `narrowest` m or wider than _WIDEST, or
        too few returns between the posts are farther away than the posts.

        `post`: the index of the return at the end of a wall, where the range jumps. `direction`: 1
        or -1, the step of the index into the gap. `narrowest`: m.
        """
        count = len(self.ranges)
        row = post + direction
        steps_to_partner = 0
        partner = -1
        least_square = _WIDEST * _WIDEST

        # 1. The nearest return of a wall, over half of the scan. Begins at the second return, since
        # the first is the farther neighbour; `beside` also wraps an index one beyond an end.
        for step in range(2, count // 2):
            row = self.beside(row, direction)
            if not self.is_wall[row]:
                continue
            dx = self.x[row] - self.x[post]
            dy = self.y[row] - self.y[post]
            square = dx * dx + dy * dy
            if square < least_square:
                if square <= narrowest * narrowest:
                    return -1
                steps_to_partner = step
                partner = row
                least_square = square
        if steps_to_partner <= _MIN_RAYS:
            return -1

        # 2. Counts the returns between the posts that are farther away than the posts.
        clear_range = max(self.ranges[post], self.ranges[partner]) - _POST_SLACK
        clear_count = 0.0
        row = self.beside(post, direction)
        while row != partner:
            if self.ranges[row] > clear_range:
                clear_count += 1.0
            row = self.beside(row, direction)
        return partner if clear_count / (steps_to_partner - 1) >= _CLEAR_SHARE else -1

    def beside(self, row: int, direction: int) -> int:
        """The index of the next return, to the left (`direction` 1) or to the right (-1)."""
        row += direction
        n = len(self.ranges)
        return row + n if row < 0 else row - n if row >= n else row

    def turn_into(self, opening: Opening) -> None:
        """Set `along` and `side`: the returns of walls in the frame of an opening."""
        k = 0
        cos_angle = cos(opening.angle)
        sin_angle = sin(opening.angle)
        for row in range(len(self.ranges)):
            if self.is_wall[row]:
                dx = self.x[row] - opening.x
                dy = self.y[row] - opening.y
                self.along[k] = cos_angle * dx + sin_angle * dy
                self.side[k] = cos_angle * dy - sin_angle * dx
                k += 1
        self.count = k


@cython.cclass
class Opening:
    """An opening in a wall, in the frame of the odometry; m and rad."""

    x: float  # the middle
    y: float
    angle: float  # direction through the opening
    half: float  # of the width
    # Where the opening begins and ends along `angle`, from the middle.
    first: float
    last: float
    # How far the wall reaches to the left and to the right of the middle.
    left: float
    right: float
    hits: int  # number of sightings
    seen_at: float  # s, of the last sighting

    def to_local(self, x: float, y: float, sign: float) -> tuple[cython.double, cython.double]:
        """A place in the frame of the opening: m along the way through, and m to its left.

        `sign` is 1 for the way through along `angle`, -1 for the opposite way.
        """
        c = sign * cos(self.angle)
        s = sign * sin(self.angle)
        dx = x - self.x
        dy = y - self.y
        return c * dx + s * dy, c * dy - s * dx

    def ends(self, sign: float) -> tuple[cython.double, cython.double]:
        """Where the opening begins and ends in m, along the way through by `sign`."""
        if sign > 0.0:
            return self.first, self.last
        return -self.last, -self.first

    def measure(self, returns: _PlacedReturns) -> None:
        """Measure direction, begin, end and the lengths of the walls by the returns of walls."""
        returns.turn_into(self)
        if self.align(returns):
            returns.turn_into(self)
        self.first = -self.reach_along(returns, -1.0)
        self.last = self.reach_along(returns, 1.0)
        self.left = self.half + self.reach_beside(returns, 1.0)
        self.right = self.half + self.reach_beside(returns, -1.0)

    def align(self, returns: _PlacedReturns) -> bool:
        """Set `angle` to the normal of the walls beside the opening, by least squares.

        False with too few returns. Walls are longer than the gap, so their angle is more exact than
        that of the line between the posts.
        """
        count = 0
        along = 0.0
        side = 0.0
        for i in range(returns.count):
            if self.is_face(returns, i):
                along = along + returns.along[i]
                side = side + returns.side[i]
                count = count + 1
        if count < _MIN_FACE_RETURNS:
            return False
        along = along / count
        side = side / count
        covariance = 0.0
        variance = 0.0
        for i in range(returns.count):
            if self.is_face(returns, i):
                from_mean = returns.side[i] - side
                covariance += (returns.along[i] - along) * from_mean
                variance += from_mean * from_mean
        self.angle -= atan(covariance / max(variance, 1e-9))
        return True

    def is_face(self, returns: _PlacedReturns, i: int) -> bool:
        """True if return `i` belongs to the face of the wall beside the opening."""
        off = fabs(returns.side[i])
        return fabs(returns.along[i]) < _ON_WALL and self.half < off < self.half + _FACE_LENGTH

    def reach_along(self, returns: _PlacedReturns, direction: float) -> float:
        """How far in m the sides of the opening reach along its axis, in `direction` 1 or -1."""
        count = 0
        for i in range(returns.count):
            if fabs(fabs(returns.side[i]) - self.half) < _ON_WALL:
                returns.places[count] = direction * returns.along[i]
                count += 1
        return _reach(returns.places, count)

    def reach_beside(self, returns: _PlacedReturns, direction: float) -> float:
        """How far in m the wall reaches beyond one side of the opening (1 left, -1 right)."""
        count = 0
        for i in range(returns.count):
            along = returns.along[i]
            if fabs(along - self.first) < _ON_WALL or fabs(along - self.last) < _ON_WALL:
                returns.places[count] = direction * returns.side[i] - self.half
                count += 1
        return _reach(returns.places, count)

    def is_same(self, sighting: Opening) -> bool:
        """True if both may be sightings of one opening."""
        c = cos(self.angle)
        s = sin(self.angle)
        dx = sighting.x - self.x
        dy = sighting.y - self.y
        return (
            fabs(remainder(self.angle - sighting.angle, PI)) < _SAME_ANGLE
            and fabs(c * dy - s * dx) < _SAME_AXIS
            and fabs(self.half - sighting.half) < _SAME_HALF
            and self.first - _SAME_SPAN < c * dx + s * dy < self.last + _SAME_SPAN
        )

    def update(self, sighting: Opening) -> None:
        """Take in another sighting: a weighted mean of place, angle and lengths.

        The weight of the place and the angle falls with the number of sightings, down to a tenth;
        that of the lengths does not. The middle moves only across the axis of the opening: along
        the axis, `first` and `last` say where the opening lies.
        """
        weight = 1.0 / min(self.hits + 1, 10)
        turn = sighting.angle - self.angle
        cos_angle = cos(self.angle)
        sin_angle = sin(self.angle)
        dx = sighting.x - self.x
        dy = sighting.y - self.y
        along = cos_angle * dx + sin_angle * dy
        side = cos_angle * dy - sin_angle * dx
        first = sighting.first
        last = sighting.last
        left = sighting.left
        right = sighting.right

        # 1. Begin, end and walls of the sighting in the frame of this opening.
        if fabs(remainder(turn, TURN)) > 0.5 * PI:  # seen from the other side
            first, last, left, right = -last, -first, right, left
        first = first + along
        last = last + along

        # 2. The weighted mean.
        self.x += weight * -sin_angle * side
        self.y += weight * cos_angle * side
        self.angle += weight * remainder(turn, PI)
        self.half += weight * (sighting.half - self.half)
        self.first += _LENGTH_WEIGHT * (first - self.first)
        self.last += _LENGTH_WEIGHT * (last - self.last)
        self.left += _LENGTH_WEIGHT * (left - self.left)
        self.right += _LENGTH_WEIGHT * (right - self.right)
        self.hits = self.hits + 1
        self.seen_at = sighting.seen_at


@cython.cclass
class Openings:
    """The openings that a robot remembers. Times are in s and come with each call."""

    _narrowest: float
    known: list[Opening]
    _returns: ScanReturns

    def __init__(self, body: float, returns: ScanReturns | None = None) -> None:
        """`body`: half of the robot's width in m. `returns`: what tracks share; None: its own."""
        self._narrowest = 2.0 * _NARROWEST_SHARE * body
        self.known = []
        self._returns = returns or ScanReturns()

    def clear(self) -> None:
        """Forget all openings."""
        self.known = []

    def forget(self, opening: object) -> bool:
        """Forget one opening; False if it was not remembered."""
        before = len(self.known)
        self.known = [known for known in self.known if known is not opening]
        return len(self.known) < before

    def observe(
        self, scan: Scan, offset: Any, pose: Pose, now: float, tracks: tuple[Any, ...], kept: object
    ) -> None:
        """Take in a conditioned scan: update or add the openings that the scan shows.

        Openings without a recent sighting are forgotten; at most _MAX_OPENINGS remain.

        Args:
            scan: the scan.
            offset: m, the place of the sensor in the base frame.
            pose: of the base in the frame of the odometry, when the scan was taken.
            now: s.
            tracks: (x, y, radius) in m of moving objects in the frame of the odometry.
            kept: an opening that is never forgotten; None: no such opening.
        """
        sighting: Opening
        known: Opening
        for sighting in self._openings_in(scan, offset, pose, now, tracks):
            for known in self.known:
                if known.is_same(sighting):
                    known.update(sighting)
                    break
            else:
                self.known.append(sighting)
        if not self.known:
            return

        # Forgets openings without a recent sighting.
        remembered: list[Opening] = []
        for known in self.known:
            memory_time = _FORGET if known.hits >= SIGHTINGS else _FORGET_SINGLE
            if now - known.seen_at < memory_time or known is kept:
                remembered.append(known)
        if len(remembered) > _MAX_OPENINGS:  # openings with a single sighting go first
            remembered.sort(
                key=lambda known: (known is kept, known.hits >= SIGHTINGS, known.seen_at)
            )
            del remembered[: len(remembered) - _MAX_OPENINGS]
        self.known = remembered

    def _openings_in(
        self, scan: Scan, offset: Any, pose: Pose, now: float, tracks: tuple[Any, ...]
    ) -> list[Opening]:
        """The openings in a scan, measured; several sightings of an opening count as the first.

        `offset`: m, the place of the sensor in the base frame. `pose`: of the base at the scan, in
        the frame of the odometry. `now`: s. `tracks`: (x, y, radius) in m of moving objects, in the
        same frame.
        """
        opening: Opening
        known: Opening
        openings: list[Opening] = []

        # 1. The returns in the order of their bearings.
        self._returns.take(scan)
        if self._returns.count < _MIN_RETURNS:
            return openings
        returns: _PlacedReturns = _PlacedReturns()
        returns.take(self._returns, offset, pose)

        # 2. The ends of walls, as (range, order, return, direction): returns where the range jumps.
        # An end on a track is no wall.
        wall_ends: list[Any] = returns.ends()
        if not wall_ends:
            return openings
        returns.set_tracks(tracks)
        for _, _, post, _ in wall_ends:
            returns.place(post)
        wall_ends = [end for end in wall_ends if returns.is_free(end[2])]
        if not wall_ends:
            return openings

        # 3. The nearest ends (sorted by range), in the order of bearing (sorted by `order`). Then
        # the places of all near returns.
        if len(wall_ends) > _MAX_WALL_ENDS:
            wall_ends.sort()
            del wall_ends[_MAX_WALL_ENDS:]
            wall_ends.sort(key=itemgetter(1))
        returns.mark_walls()

        # 4. An opening lies between a wall's end and its partner, with walls beside both.
        for _, _, post, direction in wall_ends:
            partner = returns.partner(post, direction, self._narrowest)
            if partner < 0:
                continue
            opening = _opening(returns, post, partner)
            opening.seen_at = now
            if min(opening.left, opening.right) < opening.half + _MIN_WALL:
                continue
            for known in openings:
                if opening.is_same(known):
                    break
            else:
                openings.append(opening)
        return openings


def _opening(returns: _PlacedReturns, post: int, partner: int) -> Opening:
    """The opening between two returns, measured."""
    opening: Opening = Opening()
    dx = returns.x[partner] - returns.x[post]
    dy = returns.y[partner] - returns.y[post]
    opening.x = 0.5 * (returns.x[post] + returns.x[partner])
    opening.y = 0.5 * (returns.y[post] + returns.y[partner])
    opening.angle = atan2(dx, -dy)
    opening.half = 0.5 * hypot(dx, dy)
    opening.hits = 1
    opening.measure(returns)
    return opening


def gap_middle(
    points: Array,
    place: tuple[Any, ...],
    span: tuple[Any, ...],
    width: tuple[Any, ...],
    middle: tuple[Any, ...],
) -> float | None:
    """The middle of a gap between two returns, in m to the left of the axis of an opening.

    The two returns are neighbours across the axis: no return that counts is between them. None
    without a gap of the wanted width. Of several gaps, the gap nearest to the expected middle.

    Args:
        points: (n, 2) returns in m in the base frame.
        place: of the robot in the frame of the axis: m along it, m to its left, rad.
        span: m along the axis between which returns count, both excluded.
        width: (the wanted width of the gap, the bound of the error of the width), m.
        middle: (the expected middle, the bound of the middle's distance from the axis), m.
    """
    table: Table = view(points)
    robot_along = place[0]
    robot_aside = place[1]
    cos_heading = cos(place[2])
    sin_heading = sin(place[2])
    begin = span[0]
    end = span[1]
    wanted_width = width[0]
    width_error = width[1]
    expected = middle[0]
    farthest = middle[1]
    sides: list[float] = []

    # 1. The returns that count, in m to the left of the axis, in rising order.
    for i in range(len(table)):
        x = table[i, 0]
        y = table[i, 1]
        along = robot_along + cos_heading * x - sin_heading * y
        if begin < along < end:
            sides.append(robot_aside + sin_heading * x + cos_heading * y)
    sides.sort()

    # 2. The gap.
    is_measured = False
    best = 0.0
    least_error = 0.0  # m from `best` to the expected middle
    for i in range(1, len(sides)):
        if not fabs(sides[i] - sides[i - 1] - wanted_width) < width_error:
            continue
        gap = 0.5 * (sides[i] + sides[i - 1])
        if fabs(gap) < farthest and (not is_measured or fabs(gap - expected) < least_error):
            is_measured = True
            best = gap
            least_error = fabs(gap - expected)
    return best if is_measured else None
