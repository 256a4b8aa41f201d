"""Openings: the gaps in walls that the scans of one robot show, such as doors. Pure.

An opening is the gap from the end of a wall (a post) to the nearest other return of a wall (after
Mujahed, Fischer and Mertsching, "Safe gap based (SG) reactive navigation", ECMR 2013). The place of
an opening is kept in the frame of the odometry.

A kernel (see `core/kernels.py`), since each scan passes it. right_of_way.py calls it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.values import Pose, Scan

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import (
        atan,
        atan2,
        cos,
        fabs,
        hypot,
        remainder,
        sin,
    )
else:
    from swarmd.core.cython_shadow import (
        atan,
        atan2,
        cos,
        fabs,
        hypot,
        remainder,
        sin,
    )

_REACH = cython.declare(cython.double, 2.5)  # m from the lidar within which openings are seen
_JUMP = cython.declare(cython.double, 0.25)  # m between neighbouring ranges at the end of a wall
# Widths of the robot, and m: through a wider opening two robots pass side by side.
_NARROWEST, _WIDEST = 1.5, 1.0
_LEAST_RETURNS = 10  # a scan with fewer returns shows no opening
_LEAST_RAYS = cython.declare(cython.int, 3)  # between the posts of an opening
# m by which a return between the posts may be nearer than the farther post
_BETWEEN = cython.declare(cython.double, 0.02)
# Share of the returns between the posts that must be farther.
_CLEAR = cython.declare(cython.double, 0.9)
_WALL = cython.declare(cython.double, 0.2)  # m of wall to each side of an opening at least
_FACE = cython.declare(cython.double, 0.8)  # m of this wall whose returns give its direction
_LEAST_FACE = cython.declare(cython.int, 6)  # of these returns at least
# m from the line of a wall within which a return belongs to it
_ALONG = cython.declare(cython.double, 0.1)
_HOLE = cython.declare(cython.double, 0.22)  # m between neighbouring returns of a wall at most
# m from the outline of a track within which a return is no wall
_AT_TRACK = cython.declare(cython.double, 0.12)
# Two sightings with differences below these are the same opening: m, m, m, rad.
_SAME_AXIS = cython.declare(cython.double, 0.14)
_SAME_HALF = cython.declare(cython.double, 0.08)
_SAME_SPAN = cython.declare(cython.double, 0.2)
_SAME_ANGLE = cython.declare(cython.double, 0.4)
SIGHTINGS = 2
"""Sightings of an opening before right of way uses it."""
_FORGET_ONE, _FORGET = 5.0, 120.0  # s without a sighting after which an opening is forgotten
_MOST = 8  # openings
_MOST_ENDS = 40  # of walls in one scan, the nearest: more are rain, grass or a fence

_half_turn = cython.declare(cython.double, math.pi)


@cython.cfunc
def _view(values):
    """An array as the kernel reads it: in CPython a memoryview, which is faster to index."""
    return values if cython.compiled else memoryview(values)


@cython.cfunc
def _doubles(n: cython.Py_ssize_t) -> cython.double[::1]:
    """A buffer. Views that are made in one place spare the compiler a part of its work."""
    return memoryview(np.empty(n))


@cython.cfunc
def _reach(places: cython.double[::1], count: cython.Py_ssize_t) -> cython.double:
    """How far in m the first `count` places reach from 0 without a gap of more than _HOLE."""
    i: cython.Py_ssize_t
    reach: cython.double = 0.0
    before: cython.double = -1.0
    while reach > before:
        before = reach
        for i in range(count):
            if reach < places[i] and places[i] - reach <= _HOLE:
                reach = places[i]
    return reach


@cython.cfunc
def _grown(old: cython.double, new: cython.double, is_more: cython.bint) -> cython.double:
    """A filtered length; it grows faster than it shrinks, since a part may be hidden."""
    return old + (0.4 if is_more else 0.03) * (new - old)


@cython.final
@cython.auto_pickle(False)
@cython.cclass
class _Sight:
    """The returns of one scan in order of bearing, in the frame of the odometry. All in m."""

    ranges: cython.double[::1]
    x: cython.double[::1]
    y: cython.double[::1]
    tracks: cython.double[:, ::1]  # (k, 3) x, y, radius of moving objects
    is_wall: cython.uchar[::1]  # the return is near, and no part of a track
    # The `count` returns of walls in the frame of one opening, and room for a number for each.
    count: cython.Py_ssize_t
    along: cython.double[::1]
    side: cython.double[::1]
    places: cython.double[::1]

    @cython.cfunc
    def ends(self) -> list:
        """The ends of surfaces where the range jumps, as (range, order, return, direction).

        The direction is 1 or -1: the step in index towards the farther neighbour.
        """
        n: cython.Py_ssize_t = len(self.ranges)
        i: cython.Py_ssize_t
        ends: list = []
        for i in range(n):
            j: cython.Py_ssize_t = i + 1 if i + 1 < n else 0
            step: cython.double = self.ranges[j] - self.ranges[i]
            if step > _JUMP and self.ranges[i] < _REACH:
                ends.append((self.ranges[i], i, i, 1))
            elif step < -_JUMP and self.ranges[j] < _REACH:
                ends.append((self.ranges[j], i, j, -1))
        return ends

    @cython.cfunc
    def is_free(self, row: cython.Py_ssize_t) -> cython.bint:
        """True for a return that is no part of a track."""
        i: cython.Py_ssize_t
        for i in range(len(self.tracks)):
            dx: cython.double = self.x[row] - self.tracks[i, 0]
            dy: cython.double = self.y[row] - self.tracks[i, 1]
            radius: cython.double = self.tracks[i, 2] + _AT_TRACK
            if dx * dx + dy * dy <= radius * radius:
                return False
        return True

    @cython.cfunc
    def mark_walls(self) -> cython.int:
        """Set `is_wall` of each return."""
        n: cython.Py_ssize_t = len(self.ranges)
        row: cython.Py_ssize_t
        self.is_wall = memoryview(np.empty(n, np.uint8))
        self.along, self.side, self.places = _doubles(n), _doubles(n), _doubles(n)
        for row in range(n):
            self.is_wall[row] = self.ranges[row] < _REACH and self.is_free(row)
        return 0

    @cython.cfunc
    def partner(
        self, post: cython.Py_ssize_t, way: cython.int, narrowest: cython.double
    ) -> cython.Py_ssize_t:
        """The index of the return of a wall nearest to the end `post` of a wall: the other post.

        `way` is 1 or -1, the direction of the gap. -1 if there is no opening: the gap is narrower
        than `narrowest` m, wider than _WIDEST, or too few returns in it are farther than the posts.
        """
        n: cython.Py_ssize_t = len(self.ranges)
        row: cython.Py_ssize_t = post + way
        step: cython.Py_ssize_t
        steps: cython.Py_ssize_t = 0
        partner: cython.Py_ssize_t = -1
        least_square: cython.double = _WIDEST * _WIDEST
        for step in range(2, n // 2):
            row = self.beside(row, way)
            if not self.is_wall[row]:
                continue
            dx: cython.double = self.x[row] - self.x[post]
            dy: cython.double = self.y[row] - self.y[post]
            away: cython.double = dx * dx + dy * dy
            if away < least_square:
                if away <= narrowest * narrowest:
                    return -1
                steps, partner, least_square = step, row, away
        if steps <= _LEAST_RAYS:
            return -1
        farthest: cython.double = max(self.ranges[post], self.ranges[partner]) - _BETWEEN
        clear: cython.double = 0.0
        row = self.beside(post, way)
        while row != partner:
            if self.ranges[row] > farthest:
                clear += 1.0
            row = self.beside(row, way)
        return partner if clear / (steps - 1) >= _CLEAR else -1

    @cython.cfunc
    @cython.inline
    def beside(self, row: cython.Py_ssize_t, way: cython.int) -> cython.Py_ssize_t:
        """The index of the next return, to the left (`way` 1) or to the right (-1)."""
        row += way
        n: cython.Py_ssize_t = len(self.ranges)
        return row + n if row < 0 else row - n if row >= n else row

    @cython.cfunc
    def turn_into(self, opening: Opening) -> cython.int:
        """Set `along` and `side`: the returns of walls in the frame of an opening."""
        row: cython.Py_ssize_t
        k: cython.Py_ssize_t = 0
        c: cython.double = cos(opening.angle)
        s: cython.double = sin(opening.angle)
        for row in range(len(self.ranges)):
            if self.is_wall[row]:
                dx: cython.double = self.x[row] - opening.x
                dy: cython.double = self.y[row] - opening.y
                self.along[k] = c * dx + s * dy
                self.side[k] = c * dy - s * dx
                k += 1
        self.count = k
        return 0


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

    @property
    def walls(self) -> tuple[float, float]:
        """How far the wall reaches to the left and the right of the middle."""
        return self.left, self.right

    def to_local(self, x: cython.double, y: cython.double, sign: cython.double) -> tuple:
        """A place in the frame of the opening: m along the way through, and m to its left.

        `sign` is 1 for the way through along `angle`, -1 for the opposite way.
        """
        c: cython.double = sign * cos(self.angle)
        s: cython.double = sign * sin(self.angle)
        dx: cython.double = x - self.x
        dy: cython.double = y - self.y
        return c * dx + s * dy, c * dy - s * dx

    def ends(self, sign: cython.double) -> tuple:
        """Where the opening begins and ends in m, along the way through by `sign`."""
        return (self.first, self.last) if sign > 0.0 else (-self.last, -self.first)

    @cython.cfunc
    def measure(self, sight: _Sight) -> cython.int:
        """Measure direction, begin, end and the lengths of the walls by the returns of walls."""
        sight.turn_into(self)
        if self.align(sight):
            sight.turn_into(self)
        self.first = -self.reach_along(sight, -1.0)
        self.last = self.reach_along(sight, 1.0)
        self.left = self.half + self.reach_beside(sight, 1.0)
        self.right = self.half + self.reach_beside(sight, -1.0)
        return 0

    @cython.cfunc
    def align(self, sight: _Sight) -> cython.bint:
        """Set `angle` to the normal of the walls beside the opening, by least squares.

        False with too few returns. Walls are longer than the gap, so their angle is more exact than
        that of the line between the posts.
        """
        i: cython.Py_ssize_t
        count: cython.Py_ssize_t = 0
        along: cython.double = 0.0
        side: cython.double = 0.0
        for i in range(sight.count):
            if self.is_face(sight, i):
                along, side, count = along + sight.along[i], side + sight.side[i], count + 1
        if count < _LEAST_FACE:
            return False
        along, side = along / count, side / count
        rise: cython.double = 0.0
        run: cython.double = 0.0
        for i in range(sight.count):
            if self.is_face(sight, i):
                off: cython.double = sight.side[i] - side
                rise, run = rise + (sight.along[i] - along) * off, run + off * off
        self.angle -= atan(rise / max(run, 1e-9))
        return True

    @cython.cfunc
    def is_face(self, sight: _Sight, i: cython.Py_ssize_t) -> cython.bint:
        """True if return `i` belongs to the face of the wall beside the opening."""
        off: cython.double = fabs(sight.side[i])
        return fabs(sight.along[i]) < _ALONG and self.half < off < self.half + _FACE

    @cython.cfunc
    def reach_along(self, sight: _Sight, way: cython.double) -> cython.double:
        """How far in m the sides of the opening reach along it; `way` (1 or -1): the direction."""
        i: cython.Py_ssize_t
        count: cython.Py_ssize_t = 0
        for i in range(sight.count):
            if fabs(fabs(sight.side[i]) - self.half) < _ALONG:
                sight.places[count] = way * sight.along[i]
                count += 1
        return _reach(sight.places, count)

    @cython.cfunc
    def reach_beside(self, sight: _Sight, way: cython.double) -> cython.double:
        """How far in m the wall reaches beyond one side of the opening (`way` 1 left, -1 right)."""
        i: cython.Py_ssize_t
        count: cython.Py_ssize_t = 0
        for i in range(sight.count):
            along: cython.double = sight.along[i]
            if fabs(along - self.first) < _ALONG or fabs(along - self.last) < _ALONG:
                sight.places[count] = way * sight.side[i] - self.half
                count += 1
        return _reach(sight.places, count)

    @cython.cfunc
    def is_same(self, sighting: Opening) -> cython.bint:
        """True if both may be sightings of one opening."""
        c: cython.double = cos(self.angle)
        s: cython.double = sin(self.angle)
        dx: cython.double = sighting.x - self.x
        dy: cython.double = sighting.y - self.y
        return (
            fabs(remainder(self.angle - sighting.angle, _half_turn)) < _SAME_ANGLE
            and fabs(c * dy - s * dx) < _SAME_AXIS
            and fabs(self.half - sighting.half) < _SAME_HALF
            and self.first - _SAME_SPAN < c * dx + s * dy < self.last + _SAME_SPAN
        )

    @cython.cfunc
    def update(self, seen: Opening) -> cython.int:
        """Take in another sighting: a weighted mean of place, angle and lengths."""
        share: cython.double = 1.0 / min(self.hits + 1, 10)
        turn: cython.double = seen.angle - self.angle
        c: cython.double = cos(self.angle)
        s: cython.double = sin(self.angle)
        dx: cython.double = seen.x - self.x
        dy: cython.double = seen.y - self.y
        along: cython.double = c * dx + s * dy
        side: cython.double = c * dy - s * dx
        first: cython.double = seen.first
        last: cython.double = seen.last
        left: cython.double = seen.left
        right: cython.double = seen.right
        if fabs(remainder(turn, 2.0 * _half_turn)) > 0.5 * _half_turn:  # seen from the other side
            first, last, left, right = -last, -first, right, left
        first, last = first + along, last + along
        self.x += share * -s * side
        self.y += share * c * side
        self.angle += share * remainder(turn, _half_turn)
        self.half += share * (seen.half - self.half)
        self.first = _grown(self.first, first, first < self.first)
        self.last = _grown(self.last, last, last > self.last)
        self.left = _grown(self.left, left, left > self.left)
        self.right = _grown(self.right, right, right > self.right)
        self.hits, self.seen_at = self.hits + 1, seen.seen_at
        return 0


@cython.final
@cython.cclass
class Openings:
    """The openings that a robot remembers. Times are in s and come with each call."""

    _narrowest: cython.double
    _known: list

    def __init__(self, body: float) -> None:
        """`body`: half of the robot's width in m."""
        self._narrowest = 2.0 * _NARROWEST * body
        self._known = []

    def __iter__(self) -> Iterator[Opening]:
        return iter(self._known)

    def clear(self) -> None:
        """Forget all openings."""
        self._known = []

    def forget(self, opening: object) -> cython.bint:
        """Forget one opening; False if it was not remembered."""
        before = len(self._known)
        self._known = [known for known in self._known if known is not opening]
        return len(self._known) < before

    def observe(
        self, scan: Scan, offset: tuple, pose: Pose, now: cython.double, tracks: tuple, kept: object
    ) -> None:
        """Take in a conditioned scan from a pose in the frame of the odometry.

        `offset`: place of the sensor in the base frame. `tracks`: x, y, radius of moving objects in
        the frame of the odometry. `kept`: an opening that is not forgotten, or None.
        """
        sighting: Opening
        known: Opening
        for sighting in self._found(scan, offset, pose, now, tracks):
            for known in self._known:
                if known.is_same(sighting):
                    known.update(sighting)
                    break
            else:
                self._known.append(sighting)
        if not self._known:
            return
        remembered: list = []
        for known in self._known:
            longest: cython.double = _FORGET if known.hits >= SIGHTINGS else _FORGET_ONE
            if now - known.seen_at < longest or known is kept:
                remembered.append(known)
        if len(remembered) > _MOST:  # those that were seen once go first
            remembered.sort(
                key=lambda known: (known is kept, known.hits >= SIGHTINGS, known.seen_at)
            )
            del remembered[: len(remembered) - _MOST]
        self._known = remembered

    @cython.cfunc
    def _found(self, scan, offset, pose, now: cython.double, tracks: tuple) -> list:
        """The openings in a scan: measured, and each once."""
        opening: Opening
        before: Opening
        post: cython.Py_ssize_t
        row: cython.Py_ssize_t
        way: cython.int
        seen: list = []
        ranges, bearings = scan.ranges, scan.bearings
        rays = ((ranges > 0.0) & (ranges < np.inf)).nonzero()[0]
        if len(rays) < _LEAST_RETURNS:
            return seen
        bearings = bearings[rays]
        order = bearings.argsort(kind="stable")
        ranges = ranges[rays[order]].astype(np.float64, copy=False)
        sight: _Sight = _Sight()
        sight.ranges = _view(ranges)
        ends: list = sight.ends()
        if not ends:
            return seen
        bearings = bearings[order]
        x, y = np.empty(len(rays)), np.empty(len(rays))
        sight.x, sight.y = _view(x), _view(y)
        sight.tracks = _view(np.array(tracks, np.float64).reshape(-1, 3))
        rows = np.array([end[2] for end in ends])
        x[rows], y[rows] = _places(ranges[rows], bearings[rows], offset, pose)
        ends = [end for end in ends if sight.is_free(end[2])]
        if not ends:
            return seen
        if len(ends) > _MOST_ENDS:
            ends.sort()
            del ends[_MOST_ENDS:]
            ends.sort(key=itemgetter(1))
        rows = (ranges < _REACH).nonzero()[0]
        x[rows], y[rows] = _places(ranges[rows], bearings[rows], offset, pose)
        sight.mark_walls()
        for _, _, post, way in ends:
            row = sight.partner(post, way, self._narrowest)
            if row < 0:
                continue
            opening = _opening(sight, post, row)
            opening.seen_at = now
            if min(opening.left, opening.right) < opening.half + _WALL:
                continue
            for before in seen:
                if opening.is_same(before):
                    break
            else:
                seen.append(opening)
        return seen


@cython.cfunc
def _places(ranges, bearings, offset, pose) -> tuple:
    """The places of returns in the frame of the odometry, x and y."""
    x, y = offset[0] + ranges * np.cos(bearings), offset[1] + ranges * np.sin(bearings)
    yaw: cython.double = pose.yaw
    c: cython.double = cos(yaw)
    s: cython.double = sin(yaw)
    return pose.x + c * x - s * y, pose.y + s * x + c * y


@cython.cfunc
def _opening(sight: _Sight, post: cython.Py_ssize_t, row: cython.Py_ssize_t) -> Opening:
    """The opening between two returns, measured."""
    opening: Opening = Opening()
    dx: cython.double = sight.x[row] - sight.x[post]
    dy: cython.double = sight.y[row] - sight.y[post]
    opening.x = 0.5 * (sight.x[post] + sight.x[row])
    opening.y = 0.5 * (sight.y[post] + sight.y[row])
    opening.angle, opening.half, opening.hits = atan2(dx, -dy), 0.5 * hypot(dx, dy), 1
    opening.measure(sight)
    return opening
