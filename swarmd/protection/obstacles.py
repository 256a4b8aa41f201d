"""The obstacles of mode `barrier`: near returns of the last scan, hidden ones, and told discs.

Part of the library of barrier.py. Units: m, s, rad, in the base frame.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarmd.protection.barrier_assumptions import REACTION, Assumptions
from swarmd.protection.buffers import checked, checked_indices, doubles, indices, take, view
from swarmd.protection.dead_reckoning import ScanMotion
from swarmd.protection.outline import Outline

if TYPE_CHECKING:  # Cython reads this import, CPython the other one
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import INFINITY, NAN, cos, hypot, sin
else:
    from swarmd.core.cython_shadow import INFINITY, NAN, cos, hypot, sin

NO_NUMBERS = view(np.empty(0))
NO_ROWS = view(np.empty((0, 4)))

_ROOM = 96  # points, before there are more
_FIRST_RUN = cython.declare(cython.Py_ssize_t, 8)  # points that insertion sorts


@cython.final
@cython.cclass
class Points:
    """Points: places, gaps to the outline in m, and ages in s. The first `count` are in use."""

    count: cython.Py_ssize_t
    x: cython.double[::1]
    y: cython.double[::1]
    gap: cython.double[::1]
    age: cython.double[::1]

    def __init__(self, room: int) -> None:
        self.x, self.y = doubles(room), doubles(room)
        self.gap, self.age = doubles(room), doubles(room)

    @cython.cfunc
    @cython.exceptval(-1)
    def reserve(self, room: cython.Py_ssize_t) -> cython.int:
        """Make the arrays at least `room` long; arrays that were shorter lose their numbers."""
        if len(self.x) >= room:
            return 0
        room += room // 2  # else each further point would make new arrays
        self.x, self.y = doubles(room), doubles(room)
        self.gap, self.age = doubles(room), doubles(room)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def add(
        self, x: cython.double, y: cython.double, gap: cython.double, age: cython.double
    ) -> cython.int:
        """Add a point; `reserve` must have made room."""
        at: cython.Py_ssize_t = self.count
        self.x[at], self.y[at], self.gap[at], self.age[at] = x, y, gap, age
        self.count = at + 1
        return 0


@cython.final
@cython.cclass
class NearObstacles:
    """The returns of the last scan that are near enough to constrain the robot.

    First come the contacts: returns too close to measure. For these the directions of the rays are
    kept, too. The other returns follow by rising gaps.
    """

    points: Points
    contacts: cython.Py_ssize_t  # the first points
    rays: Points  # unit vectors of the rays of contacts, in `x` and `y`
    is_near: cython.bint  # an obstacle is so near that the envelope (envelope.py) holds
    has_contact: cython.bint  # a decision since the last scan found the robot in contact
    min_gap: object  # m to the nearest return; None without a return
    bearings: object  # of the rays, as the scan has them
    _bearings: cython.const[cython.double][::1]
    _directions: cython.double[::1]  # x and y of each ray; x is NaN where they are not known yet
    # The points before they are sorted, and two orders of them.
    _unsorted: Points
    _order: cython.longlong[::1]
    _spare: cython.longlong[::1]
    _assumptions: Assumptions
    _outline: Outline
    _motion: ScanMotion

    def __init__(self, assumptions: Assumptions, outline: Outline, motion: ScanMotion) -> None:
        self._assumptions, self._outline = assumptions, outline
        self._motion = motion
        self.points, self._unsorted = Points(_ROOM), Points(_ROOM)
        self._order, self._spare = indices(_ROOM), indices(_ROOM)
        self.rays = Points(16)
        self._bearings, self._directions = NO_NUMBERS, doubles(2)

    def check_indices(self) -> None:
        """ValueError unless the contacts are among the points, each with a ray."""
        if not 0 <= self.contacts <= min(len(self.points.x), len(self.rays.x)):
            raise ValueError(f"{self.contacts} contacts of {len(self.points.x)} points")

    @cython.cfunc
    def set_bearings(self, bearings):
        """Take the rays of other bearings; their directions are found when they are needed."""
        i: cython.Py_ssize_t
        count: cython.Py_ssize_t = len(bearings)
        self.bearings, self._bearings = bearings, view(bearings)
        if len(self._directions) < 2 * count:
            self._directions = doubles(2 * count)
        directions: cython.p_double = checked(self._directions, 2 * count)
        for i in range(count):
            directions[2 * i] = NAN

    @cython.cfunc
    @cython.exceptval(-1)
    def _find_direction(self, ray: cython.Py_ssize_t) -> cython.int:
        """Put the direction of a ray into `_directions`."""
        bearing: cython.double = self._bearings[ray]
        self._directions[2 * ray], self._directions[2 * ray + 1] = cos(bearing), sin(bearing)
        return 0

    @cython.cfunc
    def find_min_gap(self, ranges: cython.const[cython.double][::1], range_min: cython.double):
        """Set `min_gap` by a scan whose obstacles are not taken."""
        i: cython.Py_ssize_t
        outline: Outline = self._outline
        nearest: cython.double = _least_of(ranges)
        within: cython.double = outline.nearest_within(nearest, range_min)
        smallest: cython.double = INFINITY
        for i in range(len(ranges)):
            if ranges[i] <= within:
                away: cython.double = range_min if ranges[i] < range_min else ranges[i]
                self._find_direction(i)
                x: cython.double = outline.lidar_x + away * self._directions[2 * i]
                y: cython.double = outline.lidar_y + away * self._directions[2 * i + 1]
                gap: cython.double = outline.gap_of(x, y)
                if gap < smallest:
                    smallest = gap
        self._set_min_gap(nearest, smallest)

    @cython.cfunc
    @cython.exceptval(-1)
    def _set_min_gap(self, nearest: cython.double, smallest: cython.double) -> cython.int:
        """Set `min_gap` by the least range of the scan and the smallest gap of its returns."""
        if nearest == INFINITY:
            self.min_gap = None
        else:
            self.min_gap = 0.0 if nearest == -INFINITY else smallest
        return 0

    @cython.cfunc
    def take_scan(
        self,
        ranges: cython.const[cython.double][::1],
        range_min: cython.double,
        ages: cython.const[cython.double][::1],
        hidden: cython.double[:, ::1],
    ):
        """Take the near obstacles of a scan, and the near hidden obstacles.

        `ages` (n,) in s are those of the rays; empty: all are 0. `hidden` (m, 3) has the ray (unit
        vector) to a hidden obstacle, and its least distance in m from the lidar. A hidden obstacle
        that may touch the robot counts as a contact. IndexError if the lengths do not match; then
        the obstacles of the last scan stay.
        """
        count: cython.Py_ssize_t = len(ranges)
        room: cython.Py_ssize_t = count + len(hidden)
        if count > len(self._bearings):
            raise IndexError(f"{count} ranges, but {len(self._bearings)} rays")
        if len(ages) > 0 and len(ages) != count:
            raise IndexError(f"{count} ranges, but {len(ages)} ages")
        self.points.reserve(room)
        self.rays.reserve(room)
        self._unsorted.reserve(room)
        if len(self._order) < len(self._unsorted.x):
            self._order = indices(len(self._unsorted.x))
            self._spare = indices(len(self._unsorted.x))
        self.has_contact = False
        self.points.count = self.rays.count = self._unsorted.count = self.contacts = 0
        late: cython.double = self._motion.late
        within: cython.double = self._assumptions.within + self._assumptions.others * late
        furthest: cython.double = self._assumptions.binding_range(self._assumptions.stale + late)
        outermost: cython.double = (within if within > furthest else furthest) + self._outline.outer
        closest: cython.double = self._take_returns(ranges, range_min, ages, outermost, furthest)
        of_hidden: cython.double = self._take_hidden(hidden, furthest)
        if of_hidden < closest:
            closest = of_hidden
        self.is_near = self.rays.count > 0 or closest <= within
        self._sort_points()

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def _take_returns(
        self,
        ranges: cython.const[cython.double][::1],
        range_min: cython.double,
        ages: cython.const[cython.double][::1],
        outermost: cython.double,
        furthest: cython.double,
    ) -> cython.double:
        """Add the returns up to `furthest` m from the outline, and set `min_gap`.

        The result is the least gap in m among the returns up to `outermost` m from the lidar.
        """
        i: cython.Py_ssize_t
        count: cython.Py_ssize_t = len(ranges)
        has_ages: cython.bint = len(ages) > 0
        outline: Outline = self._outline
        rays: Points = self.rays
        unsorted: Points = self._unsorted
        directions: cython.p_double = checked(self._directions, 2 * count)
        to_x: cython.p_double = checked(unsorted.x, count)
        to_y: cython.p_double = checked(unsorted.y, count)
        to_gap: cython.p_double = checked(unsorted.gap, count)
        to_age: cython.p_double = checked(unsorted.age, count)
        near: cython.Py_ssize_t = 0
        nearest: cython.double = _least_of(ranges)
        # All returns among which the nearest to the outline is; see Footprint.nearest.
        ring: cython.double = outline.nearest_within(nearest, range_min)
        smallest: cython.double = INFINITY  # gap of all returns
        closest: cython.double = INFINITY  # gap of the near ones
        for i in range(count):
            away: cython.double = ranges[i]
            if not (away <= outermost or away <= ring):
                continue
            if directions[2 * i] != directions[2 * i]:
                self._find_direction(i)
            age: cython.double = ages[i] if has_ages else 0.0
            if away == -INFINITY:
                rays.add(directions[2 * i], directions[2 * i + 1], 0.0, age)
                continue
            away = range_min if away < range_min else away
            to_x[near] = outline.lidar_x + away * directions[2 * i]
            to_y[near] = outline.lidar_y + away * directions[2 * i + 1]
            gap: cython.double = outline.gap_of(to_x[near], to_y[near])
            to_gap[near], to_age[near] = gap, age
            if gap < smallest:
                smallest = gap
            if ranges[i] <= outermost:
                if gap < closest:
                    closest = gap
                if gap <= furthest:
                    near += 1
        unsorted.count = near
        self._set_min_gap(nearest, smallest)
        return closest

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def _take_hidden(self, hidden: cython.double[:, ::1], furthest: cython.double) -> cython.double:
        """Add the hidden obstacles that are contacts, or up to `furthest` m from the outline.

        The result is the least gap in m of those that are no contacts.
        """
        i: cython.Py_ssize_t
        outline: Outline = self._outline
        age: cython.double = self._motion.oldest
        closest: cython.double = INFINITY
        for i in range(len(hidden)):
            ray_x: cython.double = hidden[i, 0]
            ray_y: cython.double = hidden[i, 1]
            if hidden[i, 2] > outline.along_ray(ray_x, ray_y):
                x: cython.double = outline.lidar_x + hidden[i, 2] * ray_x
                y: cython.double = outline.lidar_y + hidden[i, 2] * ray_y
                gap: cython.double = outline.gap_of(x, y)
                if gap < closest:
                    closest = gap
                if gap <= furthest:
                    self._unsorted.add(x, y, gap, age)
            else:
                self.rays.add(ray_x, ray_y, 0.0, age)
        return closest

    @cython.cfunc
    @cython.exceptval(-1)
    def _sort_points(self) -> cython.int:
        """Fill `points`: contacts at the place where the ray leaves the outline, then the others.

        The others have rising gaps.
        """
        i: cython.Py_ssize_t
        outline: Outline = self._outline
        points: Points = self.points
        rays: Points = self.rays
        unsorted: Points = self._unsorted
        self._sort(unsorted.count)
        for i in range(rays.count):
            away: cython.double = outline.along_ray(rays.x[i], rays.y[i])
            x: cython.double = outline.lidar_x + away * rays.x[i]
            points.add(x, outline.lidar_y + away * rays.y[i], 0.0, rays.age[i])
        self.contacts = rays.count
        take(unsorted.x, self._order, unsorted.count, points.x, rays.count)
        take(unsorted.y, self._order, unsorted.count, points.y, rays.count)
        take(unsorted.gap, self._order, unsorted.count, points.gap, rays.count)
        take(unsorted.age, self._order, unsorted.count, points.age, rays.count)
        points.count = rays.count + unsorted.count
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _sort(self, count: cython.Py_ssize_t) -> cython.int:
        """Merge sort of runs that are sorted by insertion; equal gaps keep their order."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        first: cython.Py_ssize_t
        middle: cython.Py_ssize_t
        end: cython.Py_ssize_t
        run: cython.Py_ssize_t = _FIRST_RUN
        gaps: cython.p_double = checked(self._unsorted.gap, count)
        order: cython.p_longlong = checked_indices(self._order, count)
        spare: cython.p_longlong = checked_indices(self._spare, count)
        for i in range(count):
            gap: cython.double = gaps[i]
            first, j = i - i % run, i
            while j > first and gaps[order[j - 1]] > gap:
                order[j] = order[j - 1]
                j -= 1
            order[j] = i
        while run < count:
            first = 0
            while first < count:
                middle = min(first + run, count)
                end = min(first + 2 * run, count)
                i, j = first, middle
                for k in range(first, end):
                    if i < middle and (j >= end or gaps[order[i]] <= gaps[order[j]]):
                        spare[k] = order[i]
                        i += 1
                    else:
                        spare[k] = order[j]
                        j += 1
                first = end
            order, spare = spare, order
            self._order, self._spare = self._spare, self._order
            run *= 2
        return 0


@cython.cfunc
@cython.exceptval(-1.0, check=True)
def _least_of(ranges: cython.const[cython.double][::1]) -> cython.double:
    """The least range; inf without a return."""
    i: cython.Py_ssize_t
    least: cython.double = INFINITY
    for i in range(len(ranges)):
        if ranges[i] < least:
            least = ranges[i]
    return least


@cython.final
@cython.cclass
class ToldDiscs:
    """Discs in which an obstacle is (see `ToldObstacle`), and which of them can bind the robot."""

    obstacles: tuple  # as they were given
    table: cython.double[:, ::1]  # (n, 4) x, y, radius, age
    count: cython.Py_ssize_t  # number of discs that can bind
    row: cython.longlong[::1]  # the places of these discs in `table`

    def __init__(self) -> None:
        self.obstacles, self.table = (), NO_ROWS
        self.row = indices(8)

    @cython.cfunc
    def set(self, told):
        """Take other obstacles."""
        self.obstacles = told
        rows = [(disc.x, disc.y, disc.radius, disc.age) for disc in told]
        self.table = view(np.array(rows, np.float64).reshape(-1, 4))
        if len(self.row) < len(told):
            self.row = indices(len(told))

    @cython.cfunc
    @cython.exceptval(-1)
    def find_binding(self, assumptions: Assumptions, radius: cython.double) -> cython.int:
        """Find the discs that can bind a robot whose outline reaches `radius` m from its axle."""
        i: cython.Py_ssize_t
        table: cython.double[:, ::1] = self.table
        approach: cython.double = assumptions.others + assumptions.fastest
        self.count = 0
        for i in range(len(table)):
            gap: cython.double = hypot(table[i, 0], table[i, 1]) - table[i, 2] - radius
            age: cython.double = table[i, 3] + REACTION
            if not (gap > assumptions.fresh + approach * age):
                self.row[self.count] = i
                self.count += 1
        return 0
