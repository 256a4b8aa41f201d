"""Rays of range sensors against flat and round shapes, and the errors of the ranges.

A kernel (see `swarmd/core/kernels.py`) for `lidar.py` and `noise.py`. Seen from the sensor, each
shape covers one interval of bearings. The distance of a shape is computed only for the rays within
this interval. So the time of a scan grows with the shapes nearby, not with rays times shapes. The
arithmetic uses one over the distance, which along a flat surface is a weighted sum of the cosine
and the sine of the bearing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import wrap
from swarmd.core.cython_shadow import (
    HUGE_VAL,
    Block,
    Doubles,
    IndexTable,
    Indices,
    Table,
    asin,
    atan2,
    ceil,
    cos,
    fabs,
    floor,
    hypot,
    isfinite,
    rint,
    sin,
    sqrt,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from swarmd.core.values import Array, ScanSpec

BLOCK = 6
"""Rays in one packet of an LDS, which its driver loses together."""

# rad added to each interval, so that no ray passes between two surfaces that share a corner.
_BEARING_MARGIN = 1e-12
# m2: a surface whose `side` (see `_meet_surface`) is nearer to 0 than this is seen edge-on and
# ignored.
_MIN_SIDE = 1e-10
_ROUNDING = 1e-6  # m, added to ranges of interest
_WIDE = 1.5  # rad: half of a sector that is taken for all around
_BLOCK = BLOCK


@cython.cclass
class Caster:
    """Casts the rays of one kind of sensor; a grid finds the bodies within its reach."""

    _rays: int
    _number: Indices
    _cos: Doubles
    _sin: Doubles
    _bearings: Doubles
    _is_even: bool
    _ray_step: float
    _range_min: float
    _range_max: float
    _sensor_x: float  # place of the sensor in the base frame
    _sensor_y: float
    _walls: Table
    _poles: Table
    # Bodies: the polygons, then the discs.
    _polygon_count: int
    _body_count: int
    _corner_count: int
    _edges: Block  # start, and vector to the end, in the owner's frame
    _discs: Table  # x, y, radius in the owner's frame
    _owner: Indices
    _reach: Doubles  # of a body from its owner's origin, and the range of the sensor
    _max_reach: float
    _placed_edges: Block  # in the world frame, as all that follow
    _disc_centers: Table
    _body_places: Table  # x, y of the owner; NaN: absent
    _step: int  # at whose poses `Sweeps` placed the bodies; -1: at others
    # The grid: the bodies of cell c are _members[_cell_begin[c]] to _members[_cell_begin[c + 1]].
    _cell_begin: Indices
    _members: Indices
    _cell_of: Indices
    _grid_columns: int
    _grid_rows: int
    _west: float
    _south: float
    _cell_size: float
    # The sensor that is cast now: its pose in the world frame, and one over the distance of each
    # ray's nearest return.
    _x: float
    _y: float
    _yaw: float
    _cos_yaw: float
    _sin_yaw: float
    _inverse: Doubles
    # The sector that is cast now: first index and number of its rays, and the cone around: cosine
    # and sine of its middle in the world frame and of half its width. `_is_wide`: no cone is used.
    _first: int
    _count: int
    _is_wide: bool
    _cos_middle: float
    _sin_middle: float
    _cos_half: float
    _sin_half: float

    def __init__(
        self,
        spec: ScanSpec,
        rays: Any,
        walls: Array,
        poles: Array,
        edges: Array,
        polygon_owners: NDArray[np.intp],
        discs: Array,
        disc_owners: NDArray[np.intp],
    ) -> None:
        """Take the rays of a sensor, and the shapes of `lidar.Shapes` as arrays; lengths in m.

        - `spec`: the sensor. `rays`: its rays in order of bearing (`lidar.SortedRays`).
        - `walls` (w, 5): start, vector to the end, and the least `side` (see `_meet_surface`) of a
          wall in reach.
        - `poles` (p, 3): x, y, radius.
        - `edges` (b, k, 4) of polygons: start, and vector to the end. `polygon_owners` (b,): the
          rows of the robots or boxes that have the polygons.
        - `discs` (d, 3): x, y, radius. `disc_owners` (d,): as `polygon_owners`.
        """
        self._set_rays(spec, rays)
        self._walls = np.array(walls, order="C").data
        self._poles = np.array(poles, order="C").data
        self._polygon_count = len(edges)
        self._corner_count = edges.shape[1]
        self._body_count = len(edges) + len(discs)
        self._edges = np.array(edges, order="C").data
        self._discs = np.array(discs, order="C").data
        self._owner = np.concatenate((polygon_owners, disc_owners)).astype(np.intp).data
        reaches = _radii(edges, discs) + (spec.range_max + _ROUNDING)
        self._reach = reaches.data
        # At least 0.1 m: the grid's cells are at least this wide, and their width is a divisor.
        self._max_reach = max(float(reaches.max(initial=0.0)), 0.1)
        self._make_buffers(edges.shape, len(discs))

    def _set_rays(self, spec: ScanSpec, rays: Any) -> None:
        """Set the rays and the sensor; returns 0."""
        n = len(spec.bearings)
        self._rays = n
        self._number = np.array(rays.number[:n], np.intp).data
        self._cos = np.array(rays.cos[:n]).data
        self._sin = np.array(rays.sin[:n]).data
        self._bearings = np.array(rays.bearings).data
        self._is_even = rays.is_even
        self._ray_step = rays.step
        self._range_min = spec.range_min
        self._range_max = spec.range_max
        self._sensor_x, self._sensor_y = spec.offset

    def _make_buffers(self, edges_shape: tuple[int, ...], discs: int) -> None:
        """Make the buffers for the bodies in the world frame, the grid and a scan; returns 0."""
        self._step = -1
        self._placed_edges = np.empty(edges_shape).data
        self._disc_centers = np.empty((discs, 2)).data
        self._body_places = np.empty((self._body_count, 2)).data
        grid_side = int(self._body_count**0.5) + 2
        self._cell_begin = np.empty(grid_side * grid_side + 1, np.intp).data
        self._members = np.empty(self._body_count, np.intp).data
        self._cell_of = np.empty(self._body_count, np.intp).data
        self._inverse = np.empty(self._rays).data

    def cast(self, poses: Table, observers: Indices, ranges: Table) -> None:
        """Cast all rays of robots `observers` (m,) into `ranges` (m, rays), in the order of rays.

        `poses` (n, 3) of all bodies; a row of NaN is absent. Ranges in m; +inf: no return within
        range_max, -inf: nearer than range_min.
        """
        if not cython.compiled:
            poses, observers, ranges = (np.asarray(one).data for one in (poses, observers, ranges))
        if not self._rays or not len(observers):
            return
        self._set_bodies(poses)
        self._step = -1
        for request in range(len(observers)):
            self._cast_sector(poses, observers[request], 0, self._rays, ranges, request)

    def _cast_sector(
        self, poses: Table, robot: int, first: int, count: int, ranges: Table, row: int
    ) -> None:
        """Cast `count` rays of a robot into row `row` of `ranges`. Returns 0, always.

        The rays are those from index `first` on, in order of bearing. `_set_bodies` must have been
        called with `poses`.
        """
        self._first = first
        self._count = count
        for i in range(count):
            self._inverse[i] = 0.0  # no return
        # The pose of an absent robot is NaN in x, y and yaw, so x is enough to check.
        if isfinite(poses[robot, 0]):
            self._set_sensor(poses[robot, 0], poses[robot, 1], poses[robot, 2])
            self._set_cone()
            self._meet_walls()
            self._meet_bodies(robot)
            for i in range(len(self._poles)):
                self._meet_circle(self._poles[i, 0], self._poles[i, 1], self._poles[i, 2])
        self._write_ranges(ranges, row)

    def _write_ranges(self, ranges: Table, row: int) -> None:
        """Write the ranges of the sector's rays into a row of `ranges`; returns 0."""
        for i in range(self._count):
            distance = HUGE_VAL
            if self._inverse[i] > 0.0:
                distance = 1.0 / self._inverse[i]
                if distance > self._range_max:
                    distance = HUGE_VAL
                elif distance < self._range_min:
                    distance = -HUGE_VAL
            # A sector may begin with the last rays and end with the first rays.
            index = self._first + i
            if index >= self._rays:
                index -= self._rays
            ranges[row, self._number[index]] = distance

    def _set_bodies(self, poses: Table) -> None:
        """Place all bodies in the world frame and in the grid; `poses` (n, 3) of their owners.

        Bodies are the polygons, then the discs, of robots and movable boxes. Returns 0, always.
        """
        west = HUGE_VAL
        east = -HUGE_VAL
        south = HUGE_VAL
        north = -HUGE_VAL
        for body in range(self._body_count):
            owner = self._owner[body]
            x = poses[owner, 0]
            y = poses[owner, 1]
            self._body_places[body, 0] = x
            self._body_places[body, 1] = y
            if not isfinite(x):  # the owner is absent
                continue
            west = min(west, x)
            east = max(east, x)
            south = min(south, y)
            north = max(north, y)
            if body < self._polygon_count:
                self._place_polygon(body, x, y, poses[owner, 2])
            else:
                self._place_disc(body - self._polygon_count, x, y, poses[owner, 2])
        self._fill_grid(west, east, south, north)

    def _place_polygon(self, body: int, x: float, y: float, yaw: float) -> None:
        """Rotate and shift the start of each edge, and rotate the vector to its end. Returns 0."""
        c = cos(yaw)
        s = sin(yaw)
        for i in range(self._corner_count):
            self._placed_edges[body, i, 0] = (
                c * self._edges[body, i, 0] - s * self._edges[body, i, 1]
            ) + x
            self._placed_edges[body, i, 1] = (
                s * self._edges[body, i, 0] + c * self._edges[body, i, 1]
            ) + y
            self._placed_edges[body, i, 2] = (
                c * self._edges[body, i, 2] - s * self._edges[body, i, 3]
            )
            self._placed_edges[body, i, 3] = (
                s * self._edges[body, i, 2] + c * self._edges[body, i, 3]
            )

    def _place_disc(self, disc: int, x: float, y: float, yaw: float) -> None:
        """Rotate and shift the centre of a disc; returns 0."""
        c = cos(yaw)
        s = sin(yaw)
        self._disc_centers[disc, 0] = (c * self._discs[disc, 0] - s * self._discs[disc, 1]) + x
        self._disc_centers[disc, 1] = (s * self._discs[disc, 0] + c * self._discs[disc, 1]) + y

    def _fill_grid(self, west: float, east: float, south: float, north: float) -> None:
        """Sort the bodies by grid cell; the bounds are those of the bodies' places in m.

        Without a body `west` is above `east`, and the grid is empty. A cell is at least as wide as
        the longest reach of a body. So all bodies that a sensor may detect are in its cell and the
        eight cells around. Returns 0, always.
        """
        self._grid_columns = 0
        self._grid_rows = 0
        if not west <= east:
            return
        # `_cell_begin` has room for about as many cells as bodies.
        self._cell_size = max(
            self._max_reach, max(east - west, north - south) / sqrt(self._body_count)
        )
        self._west = west
        self._south = south
        self._grid_columns = cython.cast(cython.Py_ssize_t, (east - west) / self._cell_size) + 1
        self._grid_rows = cython.cast(cython.Py_ssize_t, (north - south) / self._cell_size) + 1
        self._sort_bodies()

    def _sort_bodies(self) -> None:
        """Set `_members` and `_cell_begin` by a counting sort; returns 0."""
        cells = self._grid_columns * self._grid_rows
        total = 0
        # 1. `_cell_begin` holds the number of bodies of each cell.
        for cell in range(cells + 1):
            self._cell_begin[cell] = 0
        for body in range(self._body_count):
            self._cell_of[body] = -1  # absent
            if isfinite(self._body_places[body, 0]):
                cell = self._cell_at(self._body_places[body, 0], self._body_places[body, 1])
                self._cell_of[body] = cell
                self._cell_begin[cell] += 1
        # 2. `_cell_begin` holds the end of each cell's range of `_members`.
        for cell in range(cells + 1):
            total += self._cell_begin[cell]
            self._cell_begin[cell] = total
        # 3. Each range is filled from its end downwards, so `_cell_begin` ends at its begin.
        for body in range(self._body_count):
            cell = self._cell_of[body]
            if cell >= 0:
                self._cell_begin[cell] -= 1
                self._members[self._cell_begin[cell]] = body

    def _cell_at(self, x: float, y: float) -> int:
        """The number of the grid cell of a finite place within the grid."""
        return self._grid_columns * cython.cast(
            cython.Py_ssize_t, (y - self._south) / self._cell_size
        ) + cython.cast(cython.Py_ssize_t, (x - self._west) / self._cell_size)

    def _set_sensor(self, x: float, y: float, yaw: float) -> None:
        """Set the pose of the sensor, from the pose of its robot."""
        self._cos_yaw = cos(yaw)
        self._sin_yaw = sin(yaw)
        self._x = x + (self._cos_yaw * self._sensor_x - self._sin_yaw * self._sensor_y)
        self._y = y + (self._sin_yaw * self._sensor_x + self._cos_yaw * self._sensor_y)
        self._yaw = wrap(yaw)

    def _set_cone(self) -> None:
        """The cone around the sector's rays: what lies outside needs no bearings."""
        low = self._bearings[self._first]
        high = self._bearings[self._first + self._count - 1]
        middle = self._yaw + 0.5 * (low + high)
        half = 0.5 * (high - low)
        self._is_wide = half > _WIDE
        self._cos_middle = cos(middle)
        self._sin_middle = sin(middle)
        self._cos_half = cos(half)
        self._sin_half = sin(half)

    def _outside(self, x: float, y: float, side: float) -> float:
        """How far x, y from the sensor lies outside the left (1) or right (-1) edge of the cone."""
        along = self._cos_middle * x + self._sin_middle * y
        left = self._cos_middle * y - self._sin_middle * x
        return side * left * self._cos_half - along * self._sin_half

    def _is_outside(self, x: float, y: float, radius: float) -> bool:
        """True if a disc at x, y from the sensor does not meet the cone."""
        if self._is_wide:
            return False
        along = self._cos_middle * x + self._sin_middle * y
        left = self._cos_middle * y - self._sin_middle * x
        return fabs(left * self._cos_half) - along * self._sin_half > radius + _ROUNDING

    def _meet_walls(self) -> None:
        for i in range(len(self._walls)):
            x = self._walls[i, 0] - self._x
            y = self._walls[i, 1] - self._y
            # See `_meet_surface` for `side`: the sensor is before the wall, and the wall in reach.
            side = x * self._walls[i, 3] - y * self._walls[i, 2]
            if side < -_MIN_SIDE and side >= self._walls[i, 4]:
                end_x = x + self._walls[i, 2]
                end_y = y + self._walls[i, 3]
                # Both ends lie outside one edge of the cone.
                if not self._is_wide and (
                    min(self._outside(x, y, 1.0), self._outside(end_x, end_y, 1.0)) > _ROUNDING
                    or min(self._outside(x, y, -1.0), self._outside(end_x, end_y, -1.0)) > _ROUNDING
                ):
                    continue
                self._meet_surface(x, y, self._walls[i, 2], self._walls[i, 3], side)

    def _meet_bodies(self, carrier: int) -> None:
        """Meet the bodies in the sensor's grid cell and the eight cells around; returns 0.

        To meet a shape is to note its distance at each ray that hits it. `carrier`: the row of the
        robot that carries the sensor.
        """
        if not self._grid_columns:
            return
        sensor_row = cython.cast(
            cython.Py_ssize_t, floor((self._y - self._south) / self._cell_size)
        )
        sensor_column = cython.cast(
            cython.Py_ssize_t, floor((self._x - self._west) / self._cell_size)
        )
        # Columns `west` to `east` - 1 and rows `south` to `north` - 1 of the grid. For a sensor far
        # outside the grid, `east` equals `west` or `north` is not above `south`: no members.
        west = min(max(sensor_column - 1, 0), self._grid_columns)
        east = max(min(sensor_column + 2, self._grid_columns), west)
        south = max(sensor_row - 1, 0)
        north = min(sensor_row + 2, self._grid_rows)
        for grid_row in range(south, north):
            # The members of the cells of a row follow each other.
            for member in range(
                self._cell_begin[grid_row * self._grid_columns + west],
                self._cell_begin[grid_row * self._grid_columns + east],
            ):
                self._meet_body(self._members[member], carrier)

    def _meet_body(self, body: int, carrier: int) -> None:
        """Meet a body, unless it is out of reach, outside the cone or a polygon of the carrier.

        `_meet_circle` leaves out the carrier's disc, which is around the sensor. Returns 0.
        """
        disc = body - self._polygon_count  # negative for a polygon
        radius = self._reach[body] - self._range_max
        x = self._body_places[body, 0] - self._x
        y = self._body_places[body, 1] - self._y
        if x * x + y * y > self._reach[body] * self._reach[body]:
            return
        if self._is_outside(x, y, radius):
            return
        if disc >= 0:
            self._meet_circle(
                self._disc_centers[disc, 0], self._disc_centers[disc, 1], self._discs[disc, 2]
            )
        elif self._owner[body] != carrier:
            self._meet_polygon(body)

    def _meet_polygon(self, body: int) -> None:
        """Note the edges of a polygon that face the sensor; see `_meet_surface`."""
        for i in range(self._corner_count):
            x = self._placed_edges[body, i, 0]
            y = self._placed_edges[body, i, 1]
            along_x = self._placed_edges[body, i, 2]
            along_y = self._placed_edges[body, i, 3]
            side = along_x * self._y
            side -= along_y * self._x
            side += x * along_y - y * along_x
            if side < -_MIN_SIDE:
                self._meet_surface(x - self._x, y - self._y, along_x, along_y, side)

    def _meet_surface(
        self, x: float, y: float, along_x: float, along_y: float, side: float
    ) -> None:
        """Note the distance of a flat surface at each ray of the sector that hits it. Returns 0.

        (`x`, `y`): the vector in m from the sensor to the start of the surface, in the world frame.
        (`along_x`, `along_y`): the vector from the start to the end. `side`: their cross product
        x * along_y - y * along_x in m2. The caller has checked that `side` is negative: the sensor
        is in front of the surface.
        """
        # The surface covers the bearings from `high - width` to `high` (rad).
        high = atan2(y, x) - self._yaw
        width = atan2(-side, x * (x + along_x) + y * (y + along_y))
        # A ray in the direction `d` meets the line of the surface at the distance
        # cross(start, along) / cross(d, along), so 1 / distance = cross(d, along) / side. This is a
        # weighted sum of the cosine and the sine of the ray's bearing, with the weights:
        by_cos = (self._cos_yaw * along_y - self._sin_yaw * along_x) / side
        by_sin = (self._cos_yaw * along_x + self._sin_yaw * along_y) / -side
        first = self._ray_index((high - width) - _BEARING_MARGIN)
        rays = self._ray_index(high + _BEARING_MARGIN) - first
        # `first` counts over the four revolutions, the argument from the sector's first ray.
        self._note_surface((first - self._first) % self._rays, rays, by_cos, by_sin)

    def _note_surface(self, begin: int, rays: int, by_cos: float, by_sin: float) -> None:
        """Note a flat surface at `rays` rays from ray `begin` on. Returns 0.

        Rays count from the sector's first ray on, around the full circle. Those of the surface may
        begin behind the sector, and go on past a full circle into the sector. So a first pass notes
        the rays from `begin` on, and a second pass the rays past a full circle. 1 / distance is the
        sum of the cosine and the sine of the bearing, with the weights `by_cos` and `by_sin`.
        """
        end = begin + rays
        for _ in range(2):
            for i in range(begin, min(end, self._count)):
                index = self._first + i
                if index >= self._rays:
                    index -= self._rays
                inverse = by_cos * self._cos[index] + by_sin * self._sin[index]
                if inverse > self._inverse[i]:
                    self._inverse[i] = inverse
            begin = 0
            end = end - self._rays

    def _meet_circle(self, x: float, y: float, radius: float) -> None:
        """Note the distance of a circle at each ray of the sector that hits the circle. Returns 0.

        `x`, `y`: the centre of the circle in the world frame. A circle around the sensor is left
        out: no sensor sees its own housing.
        """
        x -= self._x
        y -= self._y
        # m2: the square of the distance along a tangent from the sensor to the circle.
        tangent_squared = x * x + y * y - radius * radius
        is_around_sensor = not tangent_squared > 0.0
        if is_around_sensor or self._is_outside(x, y, radius):  # outside the sector's cone
            return
        # The circle covers the bearings `middle` +- `half` (rad).
        middle = atan2(y, x) - self._yaw
        half = asin(radius / hypot(x, y))
        first = self._ray_index((middle - half) - _BEARING_MARGIN)
        rays = self._ray_index((middle + half) + _BEARING_MARGIN) - first
        self._note_circle(
            (first - self._first) % self._rays,
            rays,
            self._cos_yaw * x + self._sin_yaw * y,
            self._cos_yaw * y - self._sin_yaw * x,
            radius,
            tangent_squared,
        )

    def _note_circle(
        self,
        begin: int,
        rays: int,
        ahead: float,
        left: float,
        radius: float,
        tangent_squared: float,
    ) -> None:
        """Note a circle at `rays` rays from ray `begin` on (see `_note_surface`). Returns 0.

        `ahead`, `left`: the centre in the robot's axes. A ray meets the circle twice. The product
        of both distances is `tangent_squared`, so 1 / nearer = farther / tangent_squared.
        """
        end = begin + rays
        aside: float  # the distance of the centre from the ray
        for _ in range(2):
            for i in range(begin, min(end, self._count)):
                index = self._first + i
                if index >= self._rays:
                    index -= self._rays
                aside = self._cos[index] * left - self._sin[index] * ahead
                farther = self._cos[index] * ahead + self._sin[index] * left
                farther += sqrt(max(radius * radius - aside * aside, 0.0))
                inverse = farther / tangent_squared
                if inverse > self._inverse[i]:
                    self._inverse[i] = inverse
            begin = 0
            end = end - self._rays

    def _ray_index(self, bearing: float) -> int:
        """The index of the first ray at `bearing` rad or beyond, over the four revolutions."""
        low = 0
        high = len(self._bearings)
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


def _radii(edges: Array, discs: Array) -> Array:
    """(bodies,) m from the origin of a body's owner to the farthest point of the body."""
    polygons = np.hypot(edges[..., 0], edges[..., 1]).max(axis=1, initial=0.0)
    return np.concatenate((polygons, np.hypot(discs[:, 0], discs[:, 1]) + discs[:, 2]))


@cython.cclass
class Sweeps:
    """The scans in progress of one kind of rotating sensor, in order of their first steps.

    A sector is the rays of one step of a sweep. The kernel keeps the scans from step to step: to
    hand them over in arrays at each step took 5 % of the time of a run with 7 robots.
    """

    _caster: Caster
    _steps: int  # of a sweep
    # By the steps since the begin of a scan: first index and number of the rays of the sector.
    _first: Indices
    _counts: Indices
    _ranges: Table
    # The scans: robot, first step, and row of `_ranges`.
    _scans: IndexTable
    _count: int

    def __init__(self, caster: Caster, first: Any, counts: Any, ranges: Array) -> None:
        """Start without scans; `caster` casts their rays.

        `first`, `counts` (steps + 1,): the first ray and the number of rays of each sector. The
        sectors count by steps from the begin of a scan, the rays by bearing. `ranges` (2 n, rays)
        in m of n robots: the rows into which scans are cast, in the order of the scan's rays.
        """
        self._caster = caster
        self._steps = len(counts) - 1
        self._first = first.data
        self._counts = counts.data
        self._ranges = ranges.data
        self._scans = np.empty((len(ranges), 3), np.intp).data

    def begin(self, robot: int, step: int, row: int) -> None:
        """Begin a scan of `robot` at `step`, the latest so far, in `row` of the ranges."""
        place = self._count
        self._scans[place, 0] = robot
        self._scans[place, 1] = step
        self._scans[place, 2] = row
        self._count += 1

    def advance(self, poses: Table, step: int, ends_only: bool) -> list[tuple[int, int]]:
        """Cast the rays of `step`, and return robot and row of each scan that ends.

        `poses` as in `Caster.cast`, the same in all calls for a step. `ends_only`: the rays of
        scans that do not end are left to a later call for this step.
        """
        ended: list[Any] = []
        caster: Caster = self._caster
        if not cython.compiled:
            poses = np.asarray(poses).data
        for i in range(self._count):
            robot = self._scans[i, 0]
            row = self._scans[i, 2]
            sector = step - self._scans[i, 1]  # the steps since the scan began
            if sector == self._steps:
                ended.append((robot, row))
            elif ends_only:
                break  # scans end in the order of their begins, so no later scan ends at this step
            if self._counts[sector]:
                if caster._step != step:  # once for all scans and calls of a step
                    caster._set_bodies(poses)
                    caster._step = step
                Caster._cast_sector(
                    caster,
                    poses,
                    robot,
                    self._first[sector],
                    self._counts[sector],
                    self._ranges,
                    row,
                )
        if ended:
            self._remove_first(len(ended))
        return ended

    def _remove_first(self, count: int) -> None:
        """Remove the first `count` scans; returns 0."""
        self._count -= count
        for i in range(self._count):
            for k in range(3):
                self._scans[i, k] = self._scans[i + count, k]


@cython.cclass
class Errors:
    """The errors of all sensors with the same number of rays, and what their drivers report.

    `normal` (rays,) and `uniform` (rays + blocks,) are buffers: before each `measure`, the caller
    writes standard normal numbers, and numbers that are uniform from 0 to 1, into them.
    """

    _near: float
    _near_sd: float
    _far_sd: float
    _resolution: float
    _dropout: float
    _factors: Doubles
    _reach: Table
    _lost: Doubles  # the range of a ray that dropped out, by robot
    _encoded: Table
    _block_dropout: Doubles
    _normal: Doubles
    _uniform: Doubles  # of each ray, then of each block

    def __init__(
        self,
        noise: Any,
        factors: Array,
        reach: Array,
        lost: Array,
        encoded: Array,
        block_dropout: Array,
        normal: Array,
        uniform: Any,
    ) -> None:
        self._near = noise.near
        self._near_sd = noise.near_sd
        self._far_sd = noise.far_sd
        self._resolution = noise.resolution
        self._dropout = float(np.float32(noise.dropout))  # as the numbers that it is compared to
        self._factors = factors.data
        self._reach = reach.data
        self._lost = lost.data
        self._encoded = encoded.data
        self._block_dropout = block_dropout.data
        self._normal = normal.data
        self._uniform = uniform.data

    def measure(self, row: int, ranges: Doubles) -> None:
        """Replace the exact `ranges` (rays,) in m of robot `row` by those that its driver reports.

        A ray without a return (inf) has no error. A measurement nearer than range_min becomes -inf,
        and beyond range_max inf; `encode` replaces both. A ray drops out alone, or with its block
        of _BLOCK rays.
        """
        rays = len(ranges)
        spread: float  # standard deviation in m
        factor = self._factors[row]  # 1 plus the bias of the robot's sensor
        range_min = self._reach[row, 0]
        range_max = self._reach[row, 1]
        block_dropout = self._block_dropout[row]
        if not cython.compiled:
            ranges = np.asarray(ranges).data
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
            drops_out = (
                self._uniform[i] < self._dropout
                or self._uniform[rays + i // _BLOCK] < block_dropout
            )
            if drops_out:
                r = self._lost[row]
            ranges[i] = r
        self.encode(row, ranges)

    def encode(self, row: int, ranges: Doubles) -> None:
        """Encode `ranges` (rays,) in place as the driver of robot `row` does."""
        near = self._encoded[row, 0]
        nothing = self._encoded[row, 1]
        if not cython.compiled:
            ranges = np.asarray(ranges).data
        for i in range(len(ranges)):
            if ranges[i] == HUGE_VAL:
                ranges[i] = nothing
            elif ranges[i] == -HUGE_VAL:
                ranges[i] = near
