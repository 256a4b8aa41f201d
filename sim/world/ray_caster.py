"""Rays of range sensors against flat and round shapes, and the errors of the ranges.

A kernel (see `swarmd/core/kernels.py`): `lidar.py` and `noise.py` use it. Each shape covers one
interval of bearings seen from the sensor. Its distance is computed only for the rays within that
interval, so a scan costs the shapes nearby and not rays times shapes. The arithmetic uses one over
the distance, which along a surface is the sum of a cosine and a sine.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import (
        HUGE_VAL,
        asin,
        atan2,
        ceil,
        cos,
        fabs,
        floor,
        fmod,
        hypot,
        isfinite,
        rint,
        sin,
        sqrt,
    )
else:
    from swarmd.core.cython_shadow import (
        HUGE_VAL,
        asin,
        atan2,
        ceil,
        cos,
        fabs,
        floor,
        fmod,
        hypot,
        isfinite,
        rint,
        sin,
        sqrt,
    )

from swarmd.sim.world.noise import BLOCK

_PI = cython.declare(cython.double, math.pi)
# rad added to each interval, so that no ray passes between two surfaces that share a corner.
_BEARING_MARGIN = cython.declare(cython.double, 1e-12)
# m2: a surface whose side is smaller than this is seen edge-on and ignored. The side is the
# sensor's distance from its line times its length, negative where the sensor faces its front.
_MIN_SIDE = cython.declare(cython.double, 1e-10)
_ROUNDING = cython.declare(cython.double, 1e-6)  # m, added to ranges of interest
_WIDE = cython.declare(cython.double, 1.5)  # rad: half of a sector that is taken for all around
_BLOCK = cython.declare(cython.Py_ssize_t, BLOCK)


@cython.auto_pickle(False)
@cython.cclass
class Caster:
    """Casts the rays of one kind of sensor; a grid finds the bodies within its reach."""

    _rays: cython.Py_ssize_t
    _number: cython.Py_ssize_t[::1]
    _cos: cython.double[::1]
    _sin: cython.double[::1]
    _bearings: cython.double[::1]
    _is_even: cython.bint
    _ray_step: cython.double
    _range_min: cython.double
    _range_max: cython.double
    _ahead: cython.double
    _left: cython.double
    _walls: cython.double[:, ::1]
    _poles: cython.double[:, ::1]
    # Bodies: the polygons, then the discs.
    _polygons: cython.Py_ssize_t
    _bodies: cython.Py_ssize_t
    _corners: cython.Py_ssize_t
    _edges: cython.double[:, :, ::1]
    _discs: cython.double[:, ::1]
    _owner: cython.Py_ssize_t[::1]
    _reach: cython.double[::1]  # of a body from its owner's origin, and the range of the sensor
    _widest: cython.double
    _placed: cython.double[:, :, ::1]
    _middle: cython.double[:, ::1]
    _at: cython.double[:, ::1]
    # The grid: the bodies of cell c are _members[_begin[c]] to _members[_begin[c + 1]].
    _begin: cython.Py_ssize_t[::1]
    _members: cython.Py_ssize_t[::1]
    _cell: cython.Py_ssize_t[::1]
    _columns: cython.Py_ssize_t
    _lines: cython.Py_ssize_t
    _west: cython.double
    _south: cython.double
    _pitch: cython.double
    # The sensor in turn: its pose, and one over the distance of the nearest return of each ray.
    _x: cython.double
    _y: cython.double
    _yaw: cython.double
    _cos_yaw: cython.double
    _sin_yaw: cython.double
    _nearness: cython.double[::1]
    # The sector in turn: its first place and number of rays, and the cone around them: the cosine
    # and sine of its middle in the world frame and of half its width. `_is_wide`: no cone is used.
    _first: cython.Py_ssize_t
    _count: cython.Py_ssize_t
    _is_wide: cython.bint
    _cos_middle: cython.double
    _sin_middle: cython.double
    _cos_half: cython.double
    _sin_half: cython.double

    def __init__(self, spec, rays, walls, poles, edges, polygon_owners, discs, disc_owners):
        n = len(spec.bearings)
        self._rays = n
        self._number = memoryview(np.array(rays.number[:n], np.intp))
        self._cos, self._sin = (
            memoryview(np.array(rays.cos[:n])),
            memoryview(np.array(rays.sin[:n])),
        )
        self._bearings = memoryview(np.array(rays.bearings))
        self._is_even, self._ray_step = rays.is_even, rays.step
        self._range_min, self._range_max = spec.range_min, spec.range_max
        self._ahead, self._left = spec.offset
        self._walls = memoryview(np.array(walls, order="C"))
        self._poles = memoryview(np.array(poles, order="C"))
        self._polygons, self._corners = len(edges), edges.shape[1]
        self._bodies = len(edges) + len(discs)
        self._edges = memoryview(np.array(edges, order="C"))
        self._discs = memoryview(np.array(discs, order="C"))
        self._owner = memoryview(np.concatenate((polygon_owners, disc_owners)).astype(np.intp))
        reach = np.hypot(edges[..., 0], edges[..., 1]).max(axis=1, initial=0.0)
        around = np.hypot(discs[:, 0], discs[:, 1]) + discs[:, 2]
        reaches = np.concatenate((reach, around)) + (spec.range_max + _ROUNDING)
        self._reach = memoryview(reaches)
        self._widest = max(float(reaches.max(initial=0.0)), 0.1)
        self._placed = memoryview(np.empty(edges.shape))
        self._middle = memoryview(np.empty((len(discs), 2)))
        self._at = memoryview(np.empty((self._bodies, 2)))
        side: cython.Py_ssize_t = int(self._bodies**0.5) + 2
        self._begin = memoryview(np.empty(side * side + 1, np.intp))
        self._members = memoryview(np.empty(self._bodies, np.intp))
        self._cell = memoryview(np.empty(self._bodies, np.intp))
        self._nearness = memoryview(np.empty(n))

    def cast(
        self,
        poses: cython.double[:, ::1],
        observers: cython.Py_ssize_t[::1],
        numbers: cython.Py_ssize_t[::1],
        first: cython.Py_ssize_t[::1],
        counts: cython.Py_ssize_t[::1],
        rows: cython.Py_ssize_t[::1],
        ranges: cython.double[:, ::1],
    ):
        """Fill the sectors `numbers` (m,), in `rows` (m,) of `ranges`.

        A sector has `counts` (k,) rays from place `first` (k,) on.
        """
        one: cython.Py_ssize_t
        robot: cython.Py_ssize_t
        i: cython.Py_ssize_t
        place: cython.Py_ssize_t
        distance: cython.double
        if not self._rays:
            return
        if not cython.compiled:
            poses, observers, ranges = memoryview(poses), memoryview(observers), memoryview(ranges)
            first, counts, rows = memoryview(first), memoryview(counts), memoryview(rows)
            numbers = memoryview(numbers)
        is_set: cython.bint = False
        for one in range(observers.shape[0]):
            robot = observers[one]
            self._first, self._count = first[numbers[one]], counts[numbers[one]]
            if not self._count:
                continue
            if not is_set:
                self._set_bodies(poses)
                is_set = True
            for i in range(self._count):
                self._nearness[i] = 0.0
            # All are NaN if one is: `isfinite` of one is enough.
            if isfinite(poses[robot, 0]):
                self._set_sensor(poses[robot, 0], poses[robot, 1], poses[robot, 2])
                self._set_cone()
                self._meet_walls()
                self._meet_bodies(robot)
                for i in range(self._poles.shape[0]):
                    self._meet_circle(self._poles[i, 0], self._poles[i, 1], self._poles[i, 2])
            for i in range(self._count):
                distance = HUGE_VAL
                if self._nearness[i] > 0.0:
                    distance = 1.0 / self._nearness[i]
                    if distance > self._range_max:
                        distance = HUGE_VAL
                    elif distance < self._range_min:
                        distance = -HUGE_VAL
                place = self._first + i
                if place >= self._rays:
                    place -= self._rays
                ranges[rows[one], self._number[place]] = distance

    @cython.cfunc
    @cython.boundscheck(False)
    def _set_bodies(self, poses: cython.double[:, ::1]) -> cython.int:
        """Place all bodies in the world frame and in the grid."""
        body: cython.Py_ssize_t
        i: cython.Py_ssize_t
        owner: cython.Py_ssize_t
        c: cython.double
        s: cython.double
        x: cython.double
        y: cython.double
        west: cython.double = HUGE_VAL
        east: cython.double = -HUGE_VAL
        south: cython.double = HUGE_VAL
        north: cython.double = -HUGE_VAL
        for body in range(self._bodies):
            owner = self._owner[body]
            x, y = poses[owner, 0], poses[owner, 1]
            self._at[body, 0], self._at[body, 1] = x, y
            if not isfinite(x):
                continue
            west, east = min(west, x), max(east, x)
            south, north = min(south, y), max(north, y)
            c, s = cos(poses[owner, 2]), sin(poses[owner, 2])
            if body < self._polygons:
                for i in range(self._corners):
                    self._placed[body, i, 0] = (
                        c * self._edges[body, i, 0] - s * self._edges[body, i, 1]
                    ) + x
                    self._placed[body, i, 1] = (
                        s * self._edges[body, i, 0] + c * self._edges[body, i, 1]
                    ) + y
                    self._placed[body, i, 2] = (
                        c * self._edges[body, i, 2] - s * self._edges[body, i, 3]
                    )
                    self._placed[body, i, 3] = (
                        s * self._edges[body, i, 2] + c * self._edges[body, i, 3]
                    )
            else:
                i = body - self._polygons
                self._middle[i, 0] = (c * self._discs[i, 0] - s * self._discs[i, 1]) + x
                self._middle[i, 1] = (s * self._discs[i, 0] + c * self._discs[i, 1]) + y
        return self._fill_grid(west, east, south, north)

    @cython.cfunc
    @cython.boundscheck(False)
    def _fill_grid(
        self, west: cython.double, east: cython.double, south: cython.double, north: cython.double
    ) -> cython.int:
        """Sort the bodies by cell; a cell is as wide as the longest reach, or wider."""
        body: cython.Py_ssize_t
        cell: cython.Py_ssize_t
        cells: cython.Py_ssize_t
        end: cython.Py_ssize_t
        self._columns = self._lines = 0
        if not west <= east:
            return 0
        self._pitch = max(self._widest, max(east - west, north - south) / sqrt(self._bodies))
        self._west, self._south = west, south
        self._columns = cython.cast(cython.Py_ssize_t, (east - west) / self._pitch) + 1
        self._lines = cython.cast(cython.Py_ssize_t, (north - south) / self._pitch) + 1
        cells = self._columns * self._lines
        for cell in range(cells + 1):
            self._begin[cell] = 0
        for body in range(self._bodies):
            self._cell[body] = -1
            if isfinite(self._at[body, 0]):
                cell = self._columns * cython.cast(
                    cython.Py_ssize_t, (self._at[body, 1] - south) / self._pitch
                ) + cython.cast(cython.Py_ssize_t, (self._at[body, 0] - west) / self._pitch)
                self._cell[body] = cell
                self._begin[cell] += 1
        end = 0
        for cell in range(cells + 1):  # to the end of each cell, which the next loop moves back
            end += self._begin[cell]
            self._begin[cell] = end
        for body in range(self._bodies):
            cell = self._cell[body]
            if cell >= 0:
                self._begin[cell] -= 1
                self._members[self._begin[cell]] = body
        return 0

    @cython.cfunc
    def _set_sensor(self, x: cython.double, y: cython.double, yaw: cython.double) -> cython.int:
        self._cos_yaw, self._sin_yaw = cos(yaw), sin(yaw)
        self._x = x + (self._cos_yaw * self._ahead - self._sin_yaw * self._left)
        self._y = y + (self._sin_yaw * self._ahead + self._cos_yaw * self._left)
        self._yaw = fmod(yaw + _PI, 2.0 * _PI)
        if self._yaw < 0.0:
            self._yaw += 2.0 * _PI
        self._yaw -= _PI
        return 0

    @cython.cfunc
    def _set_cone(self) -> cython.int:
        """The cone around the sector's rays: what lies outside needs no bearings."""
        low: cython.double = self._bearings[self._first]
        high: cython.double = self._bearings[self._first + self._count - 1]
        middle: cython.double = self._yaw + 0.5 * (low + high)
        half: cython.double = 0.5 * (high - low)
        self._is_wide = half > _WIDE
        self._cos_middle, self._sin_middle = cos(middle), sin(middle)
        self._cos_half, self._sin_half = cos(half), sin(half)
        return 0

    @cython.cfunc
    def _outside(self, x: cython.double, y: cython.double, side: cython.double) -> cython.double:
        """How far x, y from the sensor lies outside the left (1) or right (-1) edge of the cone."""
        along: cython.double = self._cos_middle * x + self._sin_middle * y
        left: cython.double = self._cos_middle * y - self._sin_middle * x
        return side * left * self._cos_half - along * self._sin_half

    @cython.cfunc
    @cython.inline
    def _is_outside(self, x: cython.double, y: cython.double, radius: cython.double) -> cython.bint:
        """True if a disc at x, y from the sensor does not meet the cone."""
        if self._is_wide:
            return False
        along: cython.double = self._cos_middle * x + self._sin_middle * y
        left: cython.double = self._cos_middle * y - self._sin_middle * x
        return fabs(left * self._cos_half) - along * self._sin_half > radius + _ROUNDING

    @cython.cfunc
    @cython.boundscheck(False)
    def _meet_walls(self) -> cython.int:
        i: cython.Py_ssize_t
        x: cython.double
        y: cython.double
        end_x: cython.double
        end_y: cython.double
        side: cython.double
        for i in range(self._walls.shape[0]):
            x, y = self._walls[i, 0] - self._x, self._walls[i, 1] - self._y
            side = x * self._walls[i, 3] - y * self._walls[i, 2]
            if side < -_MIN_SIDE and side >= self._walls[i, 4]:
                end_x, end_y = x + self._walls[i, 2], y + self._walls[i, 3]
                if not self._is_wide and (
                    min(self._outside(x, y, 1.0), self._outside(end_x, end_y, 1.0)) > _ROUNDING
                    or min(self._outside(x, y, -1.0), self._outside(end_x, end_y, -1.0)) > _ROUNDING
                ):
                    continue
                self._meet_surface(x, y, self._walls[i, 2], self._walls[i, 3], side)
        return 0

    @cython.cfunc
    @cython.boundscheck(False)
    def _meet_bodies(self, carrier: cython.Py_ssize_t) -> cython.int:
        """Meet the bodies of the cells around the sensor."""
        line: cython.Py_ssize_t
        middle: cython.Py_ssize_t
        column: cython.Py_ssize_t
        south: cython.Py_ssize_t
        north: cython.Py_ssize_t
        west: cython.Py_ssize_t
        east: cython.Py_ssize_t
        place: cython.Py_ssize_t
        body: cython.Py_ssize_t
        x: cython.double
        y: cython.double
        if not self._columns:
            return 0
        middle = cython.cast(cython.Py_ssize_t, floor((self._y - self._south) / self._pitch))
        column = cython.cast(cython.Py_ssize_t, floor((self._x - self._west) / self._pitch))
        west = min(max(column - 1, 0), self._columns)
        east = max(min(column + 2, self._columns), west)
        south, north = max(middle - 1, 0), min(middle + 2, self._lines)
        for line in range(south, north):
            # The cells of a line lie side by side.
            for place in range(
                self._begin[line * self._columns + west], self._begin[line * self._columns + east]
            ):
                body = self._members[place]
                x, y = self._at[body, 0] - self._x, self._at[body, 1] - self._y
                if x * x + y * y > self._reach[body] * self._reach[body]:
                    continue
                if self._is_outside(x, y, self._reach[body] - self._range_max):
                    continue
                if body >= self._polygons:
                    body -= self._polygons
                    self._meet_circle(
                        self._middle[body, 0], self._middle[body, 1], self._discs[body, 2]
                    )
                elif self._owner[body] != carrier:
                    self._meet_polygon(body)
        return 0

    @cython.cfunc
    @cython.boundscheck(False)
    def _meet_polygon(self, body: cython.Py_ssize_t) -> cython.int:
        i: cython.Py_ssize_t
        x: cython.double
        y: cython.double
        along_x: cython.double
        along_y: cython.double
        side: cython.double
        for i in range(self._corners):
            x, y = self._placed[body, i, 0], self._placed[body, i, 1]
            along_x, along_y = self._placed[body, i, 2], self._placed[body, i, 3]
            side = along_x * self._y
            side -= along_y * self._x
            side += x * along_y - y * along_x
            if side < -_MIN_SIDE:
                self._meet_surface(x - self._x, y - self._y, along_x, along_y, side)
        return 0

    @cython.cfunc
    @cython.boundscheck(False)
    def _meet_surface(
        self,
        x: cython.double,
        y: cython.double,
        along_x: cython.double,
        along_y: cython.double,
        side: cython.double,
    ) -> cython.int:
        high: cython.double = atan2(y, x) - self._yaw
        turn: cython.double = atan2(-side, x * (x + along_x) + y * (y + along_y))
        by_cos: cython.double = (self._cos_yaw * along_y - self._sin_yaw * along_x) / side
        by_sin: cython.double = (self._cos_yaw * along_x + self._sin_yaw * along_y) / -side
        near: cython.double
        first: cython.Py_ssize_t = self._place((high - turn) - _BEARING_MARGIN)
        # From the sector's first ray on; the rays of the surface may begin anew behind it.
        begin: cython.Py_ssize_t = (first - self._first) % self._rays
        end: cython.Py_ssize_t = begin + self._place(high + _BEARING_MARGIN) - first
        i: cython.Py_ssize_t
        place: cython.Py_ssize_t
        for _ in range(2):
            for i in range(begin, min(end, self._count)):
                place = self._first + i
                if place >= self._rays:
                    place -= self._rays
                near = by_cos * self._cos[place] + by_sin * self._sin[place]
                if near > self._nearness[i]:
                    self._nearness[i] = near
            begin, end = 0, end - self._rays
        return 0

    @cython.cfunc
    @cython.boundscheck(False)
    def _meet_circle(self, x: cython.double, y: cython.double, radius: cython.double) -> cython.int:
        beyond: cython.double
        middle: cython.double
        half: cython.double
        ahead: cython.double
        left: cython.double
        aside: cython.double
        near: cython.double
        first: cython.Py_ssize_t
        begin: cython.Py_ssize_t
        end: cython.Py_ssize_t
        i: cython.Py_ssize_t
        place: cython.Py_ssize_t
        x -= self._x
        y -= self._y
        beyond = x * x + y * y - radius * radius
        if not beyond > 0.0:  # from inside: no sensor sees its own housing
            return 0
        if self._is_outside(x, y, radius):
            return 0
        middle, half = atan2(y, x) - self._yaw, asin(radius / hypot(x, y))
        ahead = self._cos_yaw * x + self._sin_yaw * y
        left = self._cos_yaw * y - self._sin_yaw * x
        first = self._place((middle - half) - _BEARING_MARGIN)
        begin = (first - self._first) % self._rays
        end = begin + self._place((middle + half) + _BEARING_MARGIN) - first
        for _ in range(2):
            for i in range(begin, min(end, self._count)):
                place = self._first + i
                if place >= self._rays:
                    place -= self._rays
                aside = self._cos[place] * left - self._sin[place] * ahead
                near = self._cos[place] * ahead + self._sin[place] * left
                near += sqrt(max(radius * radius - aside * aside, 0.0))
                near /= beyond
                if near > self._nearness[i]:
                    self._nearness[i] = near
            begin, end = 0, end - self._rays
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _place(self, bearing: cython.double) -> cython.Py_ssize_t:
        """The number of rays with smaller bearings, over four turns."""
        low: cython.Py_ssize_t = 0
        high: cython.Py_ssize_t = self._bearings.shape[0]
        middle: cython.Py_ssize_t
        if self._is_even:
            return cython.cast(
                cython.Py_ssize_t, ceil((bearing - self._bearings[0]) / self._ray_step)
            )
        while low < high:
            middle = (low + high) // 2
            if self._bearings[middle] < bearing:
                low = middle + 1
            else:
                high = middle
        return low


@cython.auto_pickle(False)
@cython.cclass
class Errors:
    """The errors of all sensors with one number of rays, and the encoding by their drivers.

    `normal` (rays,) and `even` (rays and blocks,) are the random numbers of the next scan.
    """

    _near: cython.double
    _near_sd: cython.double
    _far_sd: cython.double
    _resolution: cython.double
    _dropout: cython.double
    _factors: cython.double[::1]
    _reach: cython.double[:, ::1]
    _lost: cython.double[::1]
    _encoded: cython.double[:, ::1]
    _block_dropout: cython.double[::1]
    _normal: cython.double[::1]
    _even: cython.float[::1]

    def __init__(self, noise, factors, reach, lost, encoded, block_dropout, normal, even):
        self._near, self._near_sd, self._far_sd = noise.near, noise.near_sd, noise.far_sd
        self._resolution = noise.resolution
        self._dropout = np.float32(noise.dropout)  # as the numbers that it is compared to
        self._factors, self._reach = memoryview(factors), memoryview(reach)
        self._lost, self._encoded = memoryview(lost), memoryview(encoded)
        self._block_dropout = memoryview(block_dropout)
        self._normal, self._even = memoryview(normal), memoryview(even)

    def measure(self, row: cython.Py_ssize_t, ranges: cython.double[::1]):
        """Replace exact `ranges` (rays,) of robot `row` by its measurements, encoded."""
        i: cython.Py_ssize_t
        rays: cython.Py_ssize_t = ranges.shape[0]
        r: cython.double
        spread: cython.double
        factor: cython.double = self._factors[row]
        range_min: cython.double = self._reach[row, 0]
        range_max: cython.double = self._reach[row, 1]
        blocks: cython.double = self._block_dropout[row]
        if not cython.compiled:
            ranges = memoryview(ranges)
        for i in range(rays):
            r = ranges[i]
            if not isfinite(r):
                continue
            spread = self._far_sd * r
            if r < self._near:
                spread = self._near_sd
            r *= factor
            r += spread * self._normal[i]
            if self._resolution > 0.0:
                r /= self._resolution
                r = rint(r)
                r *= self._resolution
            if r < range_min:
                r = -HUGE_VAL
            if r > range_max:
                r = HUGE_VAL
            if self._even[i] < self._dropout or self._even[rays + i // _BLOCK] < blocks:
                r = self._lost[row]
            ranges[i] = r
        self.encode(row, ranges)

    @cython.ccall
    def encode(self, row: cython.Py_ssize_t, ranges: cython.double[::1]):
        """Encode `ranges` (rays,) in place as the driver of robot `row` does."""
        i: cython.Py_ssize_t
        near: cython.double = self._encoded[row, 0]
        nothing: cython.double = self._encoded[row, 1]
        if not cython.compiled:
            ranges = memoryview(ranges)
        for i in range(ranges.shape[0]):
            if ranges[i] == HUGE_VAL:
                ranges[i] = nothing
            elif ranges[i] == -HUGE_VAL:
                ranges[i] = near
