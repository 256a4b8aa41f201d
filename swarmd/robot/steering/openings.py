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

_MAX_RANGE = cython.declare(cython.double, 2.5)  # m from the lidar within which openings are seen
_JUMP = cython.declare(cython.double, 0.25)  # m between neighbouring ranges at the end of a wall
# Widths of the robot, and m: through a wider opening two robots pass side by side.
_NARROWEST_SHARE = 1.5
_WIDEST = 1.0
_MIN_RETURNS = cython.declare(cython.int, 10)  # a scan with fewer returns shows no opening
_MIN_RAYS = cython.declare(cython.int, 3)  # between the posts of an opening
# m by which a return between the posts may be nearer than the farther post
_POST_SLACK = cython.declare(cython.double, 0.02)
# Share of the returns between the posts that must be farther.
_CLEAR_SHARE = cython.declare(cython.double, 0.9)
_MIN_WALL = cython.declare(cython.double, 0.2)  # m of wall to each side of an opening at least
_FACE_LENGTH = cython.declare(cython.double, 0.8)  # m of this wall whose returns give its direction
_MIN_FACE_RETURNS = cython.declare(cython.int, 6)  # of these returns at least
# m from the line of a wall within which a return belongs to it
_ON_WALL = cython.declare(cython.double, 0.1)
_MAX_HOLE = cython.declare(cython.double, 0.22)  # m between neighbouring returns of a wall at most
# m from the outline of a track within which a return is no wall
_TRACK_SLACK = cython.declare(cython.double, 0.12)
# Two sightings with differences below these are the same opening: m, m, m, rad.
_SAME_AXIS = cython.declare(cython.double, 0.14)
_SAME_HALF = cython.declare(cython.double, 0.08)
_SAME_SPAN = cython.declare(cython.double, 0.2)
_SAME_ANGLE = cython.declare(cython.double, 0.4)
# Weight of the lengths of a new sighting: others may hide a part of what it shows.
_LENGTH_WEIGHT = cython.declare(cython.double, 0.4)
SIGHTINGS = cython.declare(cython.longlong, 2)
"""Sightings of an opening before right of way uses it."""
# s without a sighting after which an opening is forgotten
_FORGET_SINGLE = 5.0
_FORGET = 120.0
_MAX_OPENINGS = 8  # openings
_MAX_WALL_ENDS = 40  # of walls in one scan, the nearest: more are rain, grass or railings


@cython.cfunc
def _reach(places: cython.double[::1], count: cython.Py_ssize_t) -> cython.double:
    """How far in m the first `count` places reach from 0 without a gap of more than _MAX_HOLE."""
    reach: cython.double = 0.0
    before: cython.double = -1.0
    while reach > before:
        before = reach
        for i in range(count):
            if reach < places[i] and places[i] - reach <= _MAX_HOLE:
                reach = places[i]
    return reach


@cython.final
@cython.auto_pickle(False)
@cython.cclass
class _PlacedReturns:
    """The returns of one scan in order of bearing, in the frame of the odometry. All in m."""

    ranges: cython.double[::1]
    bearings: cython.double[::1]  # rad
    x: cython.double[::1]
    y: cython.double[::1]
    tracks: cython.double[::1]  # x, y, square of the radius with slack of each moving object
    # The place of the sensor in the base frame, and the pose of the base by odometry.
    offset_x: cython.double
    offset_y: cython.double
    pose_x: cython.double
    pose_y: cython.double
    pose_cos: cython.double
    pose_sin: cython.double
    is_wall: cython.uchar[::1]  # the return is near, and no part of a track
    # The `count` returns of walls in the frame of one opening, and room for a number for each.
    count: cython.Py_ssize_t
    along: cython.double[::1]
    side: cython.double[::1]
    places: cython.double[::1]

    @cython.cfunc
    def take(self, returns: ScanReturns, offset: Any, pose: Pose) -> cython.int:
        """Take the returns, which the sensor at `offset` saw from `pose`, and make room."""
        yaw: cython.double = pose.yaw
        # All buffers from one allocation, which costs as much as a hundred returns.
        n: cython.Py_ssize_t = returns.count
        room: cython.double[::1] = scratch(5 * n)
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

    @cython.cfunc
    def place(self, row: cython.Py_ssize_t) -> cython.int:
        """Set `x` and `y` of a return."""
        x: cython.double = self.offset_x + self.ranges[row] * cos(self.bearings[row])
        y: cython.double = self.offset_y + self.ranges[row] * sin(self.bearings[row])
        self.x[row] = self.pose_x + self.pose_cos * x - self.pose_sin * y
        self.y[row] = self.pose_y + self.pose_sin * x + self.pose_cos * y

    @cython.cfunc
    def set_tracks(self, tracks: tuple[Any, ...]) -> cython.int:
        """Set `tracks`, each given as (x, y, radius)."""
        k: cython.Py_ssize_t = 0
        x: cython.double
        y: cython.double
        radius: cython.double
        self.tracks = scratch(3 * len(tracks))
        for x, y, radius in tracks:
            radius += _TRACK_SLACK
            self.tracks[k] = x
            self.tracks[k + 1] = y
            self.tracks[k + 2] = radius * radius
            k += 3

    @cython.cfunc
    def ends(self) -> list[Any]:
        """The ends of surfaces where the range jumps, as (range, order, return, direction).

        The direction is 1 or -1: the step of the index towards the farther neighbour. `order` is
        the index of the return before the jump, by which ends are sorted by bearing. `return` is
        the index of the nearer return.
        """
        n: cython.Py_ssize_t = len(self.ranges)
        i: cython.Py_ssize_t
        ends: list[Any] = []
        for i in range(n):
            j: cython.Py_ssize_t = i + 1 if i + 1 < n else 0
            step: cython.double = self.ranges[j] - self.ranges[i]
            if step > _JUMP and self.ranges[i] < _MAX_RANGE:
                ends.append((self.ranges[i], i, i, 1))
            elif step < -_JUMP and self.ranges[j] < _MAX_RANGE:
                ends.append((self.ranges[j], i, j, -1))
        return ends

    @cython.cfunc
    def is_free(self, row: cython.Py_ssize_t) -> cython.bint:
        """True for a return that is no part of a track."""
        i: cython.Py_ssize_t
        tracks: cython.double[::1] = self.tracks
        x: cython.double = self.x[row]
        y: cython.double = self.y[row]
        for i in range(0, len(tracks), 3):
            dx: cython.double = x - tracks[i]
            dy: cython.double = y - tracks[i + 1]
            if dx * dx + dy * dy <= tracks[i + 2]:
                return False
        return True

    @cython.cfunc
    def mark_walls(self) -> cython.int:
        """Set `is_wall` of each return, and the places of the near returns."""
        n: cython.Py_ssize_t = len(self.ranges)
        row: cython.Py_ssize_t
        self.is_wall = np.empty(n, np.uint8).data
        for row in range(n):
            if self.ranges[row] < _MAX_RANGE:
                self.place(row)
            self.is_wall[row] = self.ranges[row] < _MAX_RANGE and self.is_free(row)

    @cython.cfunc
    def partner(
        self, post: cython.Py_ssize_t, direction: cython.int, narrowest: cython.double
    ) -> cython.Py_ssize_t:
        """The index of the other post of an opening: the return of a wall nearest to `post`.

        -1 if there is no opening: the gap is narrower than `narrowest` m or wider than _WIDEST, or
        too few returns between the posts are farther away than the posts.

        `post`: the index of the return at the end of a wall, where the range jumps. `direction`: 1
        or -1, the step of the index into the gap. `narrowest`: m.
        """
        count: cython.Py_ssize_t = len(self.ranges)
        row: cython.Py_ssize_t = post + direction
        steps_to_partner: cython.Py_ssize_t = 0
        partner: cython.Py_ssize_t = -1
        least_square: cython.double = _WIDEST * _WIDEST

        # 1. The nearest return of a wall, over half of the scan. Begins at the second return, since
        # the first is the farther neighbour; `beside` also wraps an index one beyond an end.
        for step in range(2, count // 2):
            row = self.beside(row, direction)
            if not self.is_wall[row]:
                continue
            dx: cython.double = self.x[row] - self.x[post]
            dy: cython.double = self.y[row] - self.y[post]
            square: cython.double = dx * dx + dy * dy
            if square < least_square:
                if square <= narrowest * narrowest:
                    return -1
                steps_to_partner = step
                partner = row
                least_square = square
        if steps_to_partner <= _MIN_RAYS:
            return -1

        # 2. Counts the returns between the posts that are farther away than the posts.
        clear_range: cython.double = max(self.ranges[post], self.ranges[partner]) - _POST_SLACK
        clear_count: cython.double = 0.0
        row = self.beside(post, direction)
        while row != partner:
            if self.ranges[row] > clear_range:
                clear_count += 1.0
            row = self.beside(row, direction)
        return partner if clear_count / (steps_to_partner - 1) >= _CLEAR_SHARE else -1

    @cython.cfunc
    @cython.inline
    def beside(self, row: cython.Py_ssize_t, direction: cython.int) -> cython.Py_ssize_t:
        """The index of the next return, to the left (`direction` 1) or to the right (-1)."""
        row += direction
        n: cython.Py_ssize_t = len(self.ranges)
        return row + n if row < 0 else row - n if row >= n else row

    @cython.cfunc
    def turn_into(self, opening: Opening) -> cython.int:
        """Set `along` and `side`: the returns of walls in the frame of an opening."""
        k: cython.Py_ssize_t = 0
        cos_angle: cython.double = cos(opening.angle)
        sin_angle: cython.double = sin(opening.angle)
        for row in range(len(self.ranges)):
            if self.is_wall[row]:
                dx: cython.double = self.x[row] - opening.x
                dy: cython.double = self.y[row] - opening.y
                self.along[k] = cos_angle * dx + sin_angle * dy
                self.side[k] = cos_angle * dy - sin_angle * dx
                k += 1
        self.count = k


@cython.final
@cython.cclass
class Opening:
    """An opening in a wall, in the frame of the odometry; m and rad."""

    x = cython.declare(cython.double, visibility="readonly")  # the middle
    y = cython.declare(cython.double, visibility="readonly")
    angle = cython.declare(cython.double, visibility="readonly")  # direction through the opening
    half = cython.declare(cython.double, visibility="readonly")  # of the width
    # Where the opening begins and ends along `angle`, from the middle.
    first = cython.declare(cython.double, visibility="readonly")
    last = cython.declare(cython.double, visibility="readonly")
    # How far the wall reaches to the left and to the right of the middle.
    left = cython.declare(cython.double, visibility="readonly")
    right = cython.declare(cython.double, visibility="readonly")
    hits = cython.declare(cython.longlong, visibility="readonly")  # number of sightings
    seen_at = cython.declare(cython.double, visibility="readonly")  # s, of the last sighting

    @cython.ccall
    def to_local(
        self, x: cython.double, y: cython.double, sign: cython.double
    ) -> tuple[cython.double, cython.double]:
        """A place in the frame of the opening: m along the way through, and m to its left.

        `sign` is 1 for the way through along `angle`, -1 for the opposite way.
        """
        c: cython.double = sign * cos(self.angle)
        s: cython.double = sign * sin(self.angle)
        dx: cython.double = x - self.x
        dy: cython.double = y - self.y
        return c * dx + s * dy, c * dy - s * dx

    @cython.ccall
    def ends(self, sign: cython.double) -> tuple[cython.double, cython.double]:
        """Where the opening begins and ends in m, along the way through by `sign`."""
        if sign > 0.0:
            return self.first, self.last
        return -self.last, -self.first

    @cython.cfunc
    def measure(self, returns: _PlacedReturns) -> cython.int:
        """Measure direction, begin, end and the lengths of the walls by the returns of walls."""
        returns.turn_into(self)
        if self.align(returns):
            returns.turn_into(self)
        self.first = -self.reach_along(returns, -1.0)
        self.last = self.reach_along(returns, 1.0)
        self.left = self.half + self.reach_beside(returns, 1.0)
        self.right = self.half + self.reach_beside(returns, -1.0)

    @cython.cfunc
    def align(self, returns: _PlacedReturns) -> cython.bint:
        """Set `angle` to the normal of the walls beside the opening, by least squares.

        False with too few returns. Walls are longer than the gap, so their angle is more exact than
        that of the line between the posts.
        """
        count: cython.Py_ssize_t = 0
        along: cython.double = 0.0
        side: cython.double = 0.0
        for i in range(returns.count):
            if self.is_face(returns, i):
                along = along + returns.along[i]
                side = side + returns.side[i]
                count = count + 1
        if count < _MIN_FACE_RETURNS:
            return False
        along = along / count
        side = side / count
        covariance: cython.double = 0.0
        variance: cython.double = 0.0
        for i in range(returns.count):
            if self.is_face(returns, i):
                from_mean: cython.double = returns.side[i] - side
                covariance += (returns.along[i] - along) * from_mean
                variance += from_mean * from_mean
        self.angle -= atan(covariance / max(variance, 1e-9))
        return True

    @cython.cfunc
    def is_face(self, returns: _PlacedReturns, i: cython.Py_ssize_t) -> cython.bint:
        """True if return `i` belongs to the face of the wall beside the opening."""
        off: cython.double = fabs(returns.side[i])
        return fabs(returns.along[i]) < _ON_WALL and self.half < off < self.half + _FACE_LENGTH

    @cython.cfunc
    def reach_along(self, returns: _PlacedReturns, direction: cython.double) -> cython.double:
        """How far in m the sides of the opening reach along its axis, in `direction` 1 or -1."""
        count: cython.Py_ssize_t = 0
        for i in range(returns.count):
            if fabs(fabs(returns.side[i]) - self.half) < _ON_WALL:
                returns.places[count] = direction * returns.along[i]
                count += 1
        return _reach(returns.places, count)

    @cython.cfunc
    def reach_beside(self, returns: _PlacedReturns, direction: cython.double) -> cython.double:
        """How far in m the wall reaches beyond one side of the opening (1 left, -1 right)."""
        count: cython.Py_ssize_t = 0
        for i in range(returns.count):
            along: cython.double = returns.along[i]
            if fabs(along - self.first) < _ON_WALL or fabs(along - self.last) < _ON_WALL:
                returns.places[count] = direction * returns.side[i] - self.half
                count += 1
        return _reach(returns.places, count)

    @cython.cfunc
    def is_same(self, sighting: Opening) -> cython.bint:
        """True if both may be sightings of one opening."""
        c: cython.double = cos(self.angle)
        s: cython.double = sin(self.angle)
        dx: cython.double = sighting.x - self.x
        dy: cython.double = sighting.y - self.y
        return (
            fabs(remainder(self.angle - sighting.angle, PI)) < _SAME_ANGLE
            and fabs(c * dy - s * dx) < _SAME_AXIS
            and fabs(self.half - sighting.half) < _SAME_HALF
            and self.first - _SAME_SPAN < c * dx + s * dy < self.last + _SAME_SPAN
        )

    @cython.cfunc
    def update(self, sighting: Opening) -> cython.int:
        """Take in another sighting: a weighted mean of place, angle and lengths.

        The weight of the place and the angle falls with the number of sightings, down to a tenth;
        that of the lengths does not. The middle moves only across the axis of the opening: along
        the axis, `first` and `last` say where the opening lies.
        """
        weight: cython.double = 1.0 / min(self.hits + 1, 10)
        turn: cython.double = sighting.angle - self.angle
        cos_angle: cython.double = cos(self.angle)
        sin_angle: cython.double = sin(self.angle)
        dx: cython.double = sighting.x - self.x
        dy: cython.double = sighting.y - self.y
        along: cython.double = cos_angle * dx + sin_angle * dy
        side: cython.double = cos_angle * dy - sin_angle * dx
        first: cython.double = sighting.first
        last: cython.double = sighting.last
        left: cython.double = sighting.left
        right: cython.double = sighting.right

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


@cython.final
@cython.cclass
class Openings:
    """The openings that a robot remembers. Times are in s and come with each call."""

    _narrowest: cython.double
    known: list[Opening] = cython.declare(list, visibility="readonly")
    _returns: ScanReturns

    def __init__(self, body: float, returns: ScanReturns | None = None) -> None:
        """`body`: half of the robot's width in m. `returns`: what tracks share; None: its own."""
        self._narrowest = 2.0 * _NARROWEST_SHARE * body
        self.known = []
        self._returns = returns or ScanReturns()

    @cython.ccall
    def clear(self) -> None:
        """Forget all openings."""
        self.known = []

    @cython.ccall
    def forget(self, opening: object) -> cython.bint:
        """Forget one opening; False if it was not remembered."""
        before = len(self.known)
        self.known = [known for known in self.known if known is not opening]
        return len(self.known) < before

    def observe(
        self,
        scan: Scan,
        offset: Any,
        pose: Pose,
        now: cython.double,
        tracks: tuple[Any, ...],
        kept: object,
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
            memory_time: cython.double = _FORGET if known.hits >= SIGHTINGS else _FORGET_SINGLE
            if now - known.seen_at < memory_time or known is kept:
                remembered.append(known)
        if len(remembered) > _MAX_OPENINGS:  # openings with a single sighting go first
            remembered.sort(
                key=lambda known: (known is kept, known.hits >= SIGHTINGS, known.seen_at)
            )
            del remembered[: len(remembered) - _MAX_OPENINGS]
        self.known = remembered

    @cython.cfunc
    def _openings_in(
        self,
        scan: Scan,
        offset: Any,
        pose: Pose,
        now: cython.double,
        tracks: tuple[Any, ...],
    ) -> list[Opening]:
        """The openings in a scan, measured; several sightings of an opening count as the first.

        `offset`: m, the place of the sensor in the base frame. `pose`: of the base at the scan, in
        the frame of the odometry. `now`: s. `tracks`: (x, y, radius) in m of moving objects, in the
        same frame.
        """
        opening: Opening
        known: Opening
        post: cython.Py_ssize_t
        partner: cython.Py_ssize_t
        direction: cython.int
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


@cython.cfunc
def _opening(
    returns: _PlacedReturns, post: cython.Py_ssize_t, partner: cython.Py_ssize_t
) -> Opening:
    """The opening between two returns, measured."""
    opening: Opening = Opening()
    dx: cython.double = returns.x[partner] - returns.x[post]
    dy: cython.double = returns.y[partner] - returns.y[post]
    opening.x = 0.5 * (returns.x[post] + returns.x[partner])
    opening.y = 0.5 * (returns.y[post] + returns.y[partner])
    opening.angle = atan2(dx, -dy)
    opening.half = 0.5 * hypot(dx, dy)
    opening.hits = 1
    opening.measure(returns)
    return opening


@cython.ccall
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
    i: cython.Py_ssize_t
    table: cython.const_double[:, ::1] = view(points)
    robot_along: cython.double = place[0]
    robot_aside: cython.double = place[1]
    cos_heading: cython.double = cos(place[2])
    sin_heading: cython.double = sin(place[2])
    begin: cython.double = span[0]
    end: cython.double = span[1]
    wanted_width: cython.double = width[0]
    width_error: cython.double = width[1]
    expected: cython.double = middle[0]
    farthest: cython.double = middle[1]
    sides: list[float] = []

    # 1. The returns that count, in m to the left of the axis, in rising order.
    for i in range(len(table)):
        x: cython.double = table[i, 0]
        y: cython.double = table[i, 1]
        along: cython.double = robot_along + cos_heading * x - sin_heading * y
        if begin < along < end:
            sides.append(robot_aside + sin_heading * x + cos_heading * y)
    sides.sort()

    # 2. The gap.
    is_measured: cython.bint = False
    best: cython.double = 0.0
    least_error: cython.double = 0.0  # m from `best` to the expected middle
    for i in range(1, len(sides)):
        if not fabs(sides[i] - sides[i - 1] - wanted_width) < width_error:
            continue
        gap: cython.double = 0.5 * (sides[i] + sides[i - 1])
        if fabs(gap) < farthest and (not is_measured or fabs(gap - expected) < least_error):
            is_measured = True
            best = gap
            least_error = fabs(gap - expected)
    return best if is_measured else None
