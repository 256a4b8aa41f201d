"""The obstacles of mode `barrier`: returns of the last scan, hidden obstacles, and discs.

Part of the unit of barrier.py. Units: m, s, rad, in the base frame.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import checked, checked_indices, doubles, indices, view
from swarmd.core.cython_shadow import INFINITY, NAN, Doubles, Indices, Table, cos, hypot, sin
from swarmd.robot.protection.barrier_assumptions import OTHER, REACTION, Assumptions
from swarmd.robot.protection.dead_reckoning import ScanMotion
from swarmd.robot.protection.outline import Outline
from swarmd.robot.protection.surfaces import find_surface_gaps

if TYPE_CHECKING:
    from swarmd.core.values import Array
    from swarmd.robot.protection.decision import ToldObstacle

NO_NUMBERS = view(np.empty(0))
NO_ROWS = view(np.empty((0, 4)))
"""No hidden obstacle, and no disc."""

REACH = 1.5
"""m from the lidar, up to which a layer of returns looks."""

# The columns of the table of discs.
DISC_X = 0  # m, in the base frame when the disc was measured
DISC_Y = 1
DISC_RADIUS = 2  # m
DISC_AGE = 3  # s from the measurement until the decision

_ROOM = 96  # points, before there are more
_FIRST_RUN = 8  # points that insertion sorts


@cython.cclass
class ReturnLayer:
    """A layer that tells the kinds of returns, off by default: without it each return is OTHER.

    The kind of a return gives the speed at which its obstacle may approach
    (`Assumptions.speed_of`), how far the obstacle extends (`Assumptions.extent_of`), and the caps
    of its constraints.
    """

    kinds: Indices  # of the last scan: the kind of the return of each ray
    has_kinds: bool  # the last scan has a return that is not OTHER
    has_bare_walls: bool  # the last scan has a return of the kind BARE_WALL
    wants_all: bool  # `observe` needs the directions of all rays

    def __init__(self, rays: int) -> None:
        self.kinds = indices(rays)

    def observe(
        self,
        ranges: Doubles,
        directions: Doubles,
        ages: Doubles,
        filled: Doubles,
        borrowed: int,
        hidden: Table,
        motion: ScanMotion,
    ) -> None:
        """Take in a scan: set `kinds`, `has_kinds` and `has_bare_walls`.

        Args:
            ranges: (n,) m. -inf: a return too close to measure, inf: no return.
            directions: (2n,) the unit vector (x, y) along each ray; set for rays up to REACH, and
                with `wants_all` for all rays.
            ages: (n,) s of the rays against the newest ray; empty: all are 0.
            filled: (n,) 1 for each ray that the scan did not measure; empty: all are 0.
            borrowed: how many rays, the first ones, are of the scan before (see `Scan`).
            hidden: (m, 3), as of `NearObstacles.take_scan`.
            motion: when and where the scan was taken.
        """


@cython.cclass
class Points:
    """Points: places, gaps to the outline in m, and ages in s. The first `count` are in use.

    `kind`: of the obstacle.
    """

    count: int
    x: Doubles
    y: Doubles
    gap: Doubles
    age: Doubles
    kind: Indices

    def __init__(self, room: int) -> None:
        self.x = doubles(room)
        self.y = doubles(room)
        self.gap = doubles(room)
        self.age = doubles(room)
        self.kind = indices(room)

    def reserve(self, room: int) -> None:
        """Make the arrays at least `room` long; arrays that were shorter lose their numbers."""
        if len(self.x) >= room:
            return
        room += room // 2  # else each further point would make new arrays
        self.x = doubles(room)
        self.y = doubles(room)
        self.gap = doubles(room)
        self.age = doubles(room)
        self.kind = indices(room)

    def add(self, x: float, y: float, gap: float, age: float, kind: int) -> None:
        """Add a point; `reserve` must have made room."""
        at = self.count
        self.x[at] = x
        self.y[at] = y
        self.gap[at] = gap
        self.age[at] = age
        self.kind[at] = kind
        self.count = at + 1


@cython.cclass
class NearObstacles:
    """The returns of the last scan that are near enough to constrain the robot.

    First come the contacts: returns too close to measure. The directions of their rays are stored,
    too. The other returns follow by rising gaps.
    """

    points: Points
    # m, for each point, from the wide surface that it is on; NaN: on none. See `find_surfaces`.
    surface_gap: Doubles
    contacts: int  # the first points
    rays: Points  # unit vectors of the rays of contacts, in `x` and `y`
    is_near: bool  # an obstacle is so near that the envelope (envelope.py) holds
    has_contact: bool  # a decision since the last scan found the robot in contact
    min_gap: float | None  # m to the nearest return; None without a return
    longest_peer: float  # m, the longest diagonal of the peers heard; 0: none; inf: not known
    bearings: Array  # of the rays, as the scan has them
    _bearings: Doubles
    _directions: Doubles  # x and y of each ray; x is NaN where they are not known yet
    # The points before they are sorted, and two orders of them.
    _unsorted: Points
    _unsorted_gap: Doubles  # as `surface_gap`
    _returns: int  # the first unsorted points, in the order of their rays
    _has_surfaces: bool  # `surface_gap` is known
    _order: Indices
    _spare: Indices
    _assumptions: Assumptions
    _outline: Outline
    _motion: ScanMotion
    _layer: ReturnLayer | None  # None: all returns are OTHER

    def __init__(
        self,
        assumptions: Assumptions,
        outline: Outline,
        motion: ScanMotion,
        layer: ReturnLayer | None,
    ) -> None:
        self._assumptions = assumptions
        self._outline = outline
        self._motion = motion
        self._layer = layer
        self.points = Points(_ROOM)
        self._unsorted = Points(_ROOM)
        self.surface_gap = doubles(_ROOM)
        self._unsorted_gap = doubles(_ROOM)
        self._order = indices(_ROOM)
        self._spare = indices(_ROOM)
        self.rays = Points(16)
        self._bearings = NO_NUMBERS
        self._directions = doubles(2)

    def check_indices(self) -> None:
        """ValueError unless the contacts are among the points, each with a ray."""
        if not 0 <= self._returns <= self._unsorted.count:
            raise ValueError(f"{self._returns} returns of {self._unsorted.count} points")
        if not 0 <= self.contacts <= min(len(self.points.x), len(self.rays.x)):
            raise ValueError(f"{self.contacts} contacts of {len(self.points.x)} points")

    def has_bare_walls(self) -> bool:
        """True if a return of the last scan is of the kind BARE_WALL."""
        layer: ReturnLayer | None = self._layer
        if layer is None:
            return False
        return layer.has_bare_walls != 0

    def hear(self, diagonal: float) -> None:
        """Take in the longest diagonal in m of the platforms of all peers; inf: not known."""
        self.longest_peer = diagonal
        self._has_surfaces = False

    def set_bearings(self, bearings: Array) -> None:
        """Take the rays of other bearings; their directions are found when they are needed."""
        count = len(bearings)
        self.bearings = bearings
        self._bearings = view(bearings)
        if len(self._directions) < 2 * count:
            self._directions = doubles(2 * count)
        directions = checked(self._directions, 2 * count)
        for i in range(count):
            directions[2 * i] = NAN

    def _find_direction(self, ray: int) -> None:
        """Put the direction of a ray into `_directions`."""
        bearing = self._bearings[ray]
        self._directions[2 * ray] = cos(bearing)
        self._directions[2 * ray + 1] = sin(bearing)

    def _find_directions(self, ranges: Doubles, wants_all: bool) -> None:
        """Find the directions of all rays with a range up to REACH m, or of all rays."""
        for i in range(len(ranges)):
            if (wants_all or ranges[i] <= REACH) and self._directions[2 * i] != self._directions[
                2 * i
            ]:
                self._find_direction(i)

    def find_min_gap(self, ranges: Doubles, range_min: float) -> None:
        """Set `min_gap` by a scan whose obstacles do not replace those of the last scan."""
        outline: Outline = self._outline
        nearest = _least_of(ranges)
        range_of_nearest = outline.nearest_within(nearest, range_min)
        smallest_gap = INFINITY
        for i in range(len(ranges)):
            if ranges[i] <= range_of_nearest:
                measured_range = range_min if ranges[i] < range_min else ranges[i]
                self._find_direction(i)
                x = outline.lidar_x + measured_range * self._directions[2 * i]
                y = outline.lidar_y + measured_range * self._directions[2 * i + 1]
                gap = outline.gap_of(x, y)
                if gap < smallest_gap:
                    smallest_gap = gap
        self._set_min_gap(nearest, smallest_gap)

    def _set_min_gap(self, nearest: float, smallest_gap: float) -> None:
        """Set `min_gap` by the least range of the scan and the smallest gap of its returns."""
        if nearest == INFINITY:
            self.min_gap = None
        else:
            self.min_gap = 0.0 if nearest == -INFINITY else smallest_gap

    def take_scan(
        self,
        ranges: Doubles,
        range_min: float,
        ages: Doubles,
        filled: Doubles,
        borrowed: int,
        hidden: Table,
    ) -> None:
        """Replace the near obstacles by those of a scan, hidden obstacles included.

        A hidden obstacle is in the blind zone of the lidar, and is known from earlier scans. A
        hidden obstacle that may touch the robot counts as a contact. IndexError if the lengths do
        not match: the obstacles of the last scan then stay.

        Args:
            ranges: (n,) m, -inf for a return too close to measure, inf for no return.
            range_min: m, the least range that the lidar measures.
            ages: (n,) s of the rays against the newest ray; empty: all are 0.
            filled: (n,) 1 for each ray that the scan did not measure; empty: all are 0.
            borrowed: how many rays, the first ones, are of the scan before (see `Scan`).
            hidden: (m, 3) unit vector from the lidar to each hidden obstacle, and the least
                distance of the obstacle from the lidar in m.
        """
        count = len(ranges)
        room = count + len(hidden)
        if count > len(self._bearings):
            raise IndexError(f"{count} ranges, but {len(self._bearings)} rays")
        if len(ages) > 0 and len(ages) != count:
            raise IndexError(f"{count} ranges, but {len(ages)} ages")
        if len(filled) > 0 and len(filled) != count:
            raise IndexError(f"{count} ranges, but {len(filled)} filled or not")

        # 1. Makes room, and drops the obstacles of the last scan.
        self.points.reserve(room)
        self.rays.reserve(room)
        self._unsorted.reserve(room)
        if len(self._order) < len(self._unsorted.x):
            self._order = indices(len(self._unsorted.x))
            self._spare = indices(len(self._unsorted.x))
        self.has_contact = False
        self._has_surfaces = False
        self._returns = 0
        self.points.count = 0
        self.rays.count = 0
        self._unsorted.count = 0
        self.contacts = 0

        # 2. The kinds of the returns.
        layer: ReturnLayer | None = self._layer
        if layer is not None:
            self._find_directions(ranges, layer.wants_all)
            layer.observe(ranges, self._directions, ages, filled, borrowed, hidden, self._motion)

        # 3. Gaps in m up to which an obstacle matters: for the envelope, and for constraints.
        # `extra_age` in s: how much older than usual the oldest ray may be.
        extra_age = self._motion.extra_age
        envelope_range = (
            self._assumptions.envelope_range + self._assumptions.others_speed * extra_age
        )
        binding_range = self._assumptions.binding_range(
            self._assumptions.longest_scan_age + extra_age
        )
        # m from the lidar: a return with a greater range has a gap greater than both, since the
        # whole outline lies within `outer` m of the lidar.
        longest_range = (
            envelope_range if envelope_range > binding_range else binding_range
        ) + self._outline.outer

        # 4. Takes returns and hidden obstacles, and sorts them. Each contact has a ray.
        least_gap = self._take_returns(ranges, range_min, ages, longest_range, binding_range)
        least_hidden_gap = self._take_hidden(hidden, binding_range)
        if least_hidden_gap < least_gap:
            least_gap = least_hidden_gap
        has_contacts = self.rays.count > 0
        self.is_near = has_contacts or least_gap <= envelope_range
        self._sort_points()

    def _take_returns(
        self,
        ranges: Doubles,
        range_min: float,
        ages: Doubles,
        longest_range: float,
        binding_range: float,
    ) -> float:
        """Add the returns whose gap to the outline is at most `binding_range`, and set `min_gap`.

        `min_gap` is the least gap of all returns, at any range. Returns too close to measure go to
        `rays`, and have no gap. The result is the least gap in m among the returns with a range up
        to `longest_range`, or inf without such a return.

        Args:
            ranges: (n,) m. -inf: too close to measure. inf: no return.
            range_min: m, the least range that the lidar measures.
            ages: (n,) s against the newest ray. Empty: all are 0.
            longest_range: m from the lidar, beyond which no return is added.
            binding_range: m from the outline.
        """
        count = len(ranges)
        has_ages = len(ages) > 0
        outline: Outline = self._outline
        rays: Points = self.rays
        unsorted: Points = self._unsorted
        directions = checked(self._directions, 2 * count)
        near_x = checked(unsorted.x, count)
        near_y = checked(unsorted.y, count)
        near_gap = checked(unsorted.gap, count)
        near_age = checked(unsorted.age, count)
        near_kind = checked_indices(unsorted.kind, count)
        layer: ReturnLayer | None = self._layer if self._assumptions.has_kinds else None
        near_count = 0
        least_range = _least_of(ranges)
        # m: the return nearest to the outline, which gives `min_gap`, has at most this range. In a
        # scan without near returns, this range may be above `longest_range`.
        range_for_min_gap = outline.nearest_within(least_range, range_min)
        least_gap = INFINITY  # of all returns
        least_near_gap = INFINITY  # of the returns up to `longest_range`
        for i in range(count):
            measured_range = ranges[i]
            if not (measured_range <= longest_range or measured_range <= range_for_min_gap):
                continue
            # A direction that no scan has needed so far is NaN.
            has_direction = directions[2 * i] == directions[2 * i]
            if not has_direction:
                self._find_direction(i)
            age = ages[i] if has_ages else 0.0
            if measured_range == -INFINITY:
                rays.add(directions[2 * i], directions[2 * i + 1], 0.0, age, OTHER)
                continue
            measured_range = range_min if measured_range < range_min else measured_range
            # Writes the return behind the near returns. If the return is not near, `near_count`
            # stays, and the next return overwrites it.
            near_x[near_count] = outline.lidar_x + measured_range * directions[2 * i]
            near_y[near_count] = outline.lidar_y + measured_range * directions[2 * i + 1]
            gap = outline.gap_of(near_x[near_count], near_y[near_count])
            near_gap[near_count] = gap
            near_age[near_count] = age
            near_kind[near_count] = (
                layer.kinds[i] if layer is not None and layer.has_kinds else OTHER
            )
            if gap < least_gap:
                least_gap = gap
            if ranges[i] <= longest_range:
                if gap < least_near_gap:
                    least_near_gap = gap
                if gap <= binding_range:
                    near_count += 1
        unsorted.count = near_count
        self._returns = near_count
        self._set_min_gap(least_range, least_gap)
        return least_near_gap

    def _take_hidden(self, hidden: Table, binding_range: float) -> float:
        """Add the hidden obstacles (see `take_scan`) that may constrain the robot.

        A hidden obstacle that may be within the outline becomes a contact. An obstacle farther than
        `binding_range` m from the outline is left out. The result is the least gap in m of the
        obstacles that are not contacts; inf without such an obstacle.
        """
        outline: Outline = self._outline
        age = self._motion.oldest
        closest_gap = INFINITY
        for i in range(len(hidden)):
            ray_x = hidden[i, 0]
            ray_y = hidden[i, 1]
            least_distance = hidden[i, 2]
            is_outside = least_distance > outline.along_ray(ray_x, ray_y)
            if is_outside:
                x = outline.lidar_x + least_distance * ray_x
                y = outline.lidar_y + least_distance * ray_y
                gap = outline.gap_of(x, y)
                if gap < closest_gap:
                    closest_gap = gap
                if gap <= binding_range:
                    self._unsorted.add(x, y, gap, age, OTHER)
            else:
                self.rays.add(ray_x, ray_y, 0.0, age, OTHER)
        return closest_gap

    def _sort_points(self) -> None:
        """Fill `points`: first the contacts, then the other near obstacles by rising gaps.

        A contact is placed where its ray leaves the outline.
        """
        outline: Outline = self._outline
        points: Points = self.points
        rays: Points = self.rays
        unsorted: Points = self._unsorted
        self._sort(unsorted.count)
        for i in range(rays.count):
            to_outline = outline.along_ray(rays.x[i], rays.y[i])
            x = outline.lidar_x + to_outline * rays.x[i]
            y = outline.lidar_y + to_outline * rays.y[i]
            points.add(x, y, 0.0, rays.age[i], rays.kind[i])
        self.contacts = rays.count
        _take(unsorted.x, self._order, unsorted.count, points.x, rays.count)
        _take(unsorted.y, self._order, unsorted.count, points.y, rays.count)
        _take(unsorted.gap, self._order, unsorted.count, points.gap, rays.count)
        _take(unsorted.age, self._order, unsorted.count, points.age, rays.count)
        for i in range(unsorted.count):
            points.kind[rays.count + i] = unsorted.kind[self._order[i]]
        points.count = rays.count + unsorted.count

    def find_surfaces(self) -> None:
        """Set `surface_gap`, once for each scan: only a robot that creeps needs it.

        Contacts and hidden obstacles are on no wide surface.
        """
        unsorted: Points = self._unsorted
        if self._has_surfaces:
            return
        if len(self._unsorted_gap) < unsorted.count:
            self._unsorted_gap = doubles(len(unsorted.x))
        if len(self.surface_gap) < self.points.count:
            self.surface_gap = doubles(len(self.points.x))
        find_surface_gaps(
            unsorted.x,
            unsorted.y,
            unsorted.gap,
            self._returns,
            self._outline,
            self.longest_peer,
            self._unsorted_gap,
        )
        for i in range(self._returns, unsorted.count):
            self._unsorted_gap[i] = NAN
        for i in range(self.contacts):
            self.surface_gap[i] = NAN
        for i in range(unsorted.count):
            self.surface_gap[self.contacts + i] = self._unsorted_gap[self._order[i]]
        self._has_surfaces = True

    def _sort(self, count: int) -> None:
        """Write into `_order` the indices of the first `count` unsorted points by rising gaps.

        A merge sort of runs that are sorted by insertion first. Equal gaps keep their order.
        """
        run_length = _FIRST_RUN
        gaps = checked(self._unsorted.gap, count)
        order = checked_indices(self._order, count)
        spare = checked_indices(self._spare, count)

        # 1. Sorts each run of `_FIRST_RUN` points by insertion.
        for left in range(count):
            gap = gaps[left]
            first = left - left % run_length
            right = left
            while right > first and gaps[order[right - 1]] > gap:
                order[right] = order[right - 1]
                right -= 1
            order[right] = left

        # 2. Merges pairs of neighbouring runs into `spare`, until a single run is left.
        while run_length < count:
            first = 0
            while first < count:
                middle = min(first + run_length, count)
                end = min(first + 2 * run_length, count)
                left = first
                right = middle
                for target in range(first, end):
                    if left < middle and (right >= end or gaps[order[left]] <= gaps[order[right]]):
                        spare[target] = order[left]
                        left += 1
                    else:
                        spare[target] = order[right]
                        right += 1
                first = end
            order, spare = spare, order
            self._order, self._spare = self._spare, self._order
            run_length *= 2


def _take(values: Doubles, order: Indices, count: int, into: Doubles, begin: int) -> None:
    """Put the values at the first `count` indices of `order` into a buffer, from `begin` on."""
    index = checked_indices(order, count)
    given = checked(values, count)
    to = checked(into, begin + count)
    for i in range(count):
        to[begin + i] = given[index[i]]


def _least_of(ranges: Doubles) -> float:
    """The least range; inf without a return."""
    least = INFINITY
    for i in range(len(ranges)):
        if ranges[i] < least:
            least = ranges[i]
    return least


@cython.cclass
class ObstacleDiscs:
    """Discs in which an obstacle is (see `ToldObstacle`), with those that can constrain a robot."""

    obstacles: tuple[ToldObstacle, ...]  # the argument of `set`
    table: Table  # (n, 4): DISC_X, DISC_Y, DISC_RADIUS and DISC_AGE of each disc
    count: int  # number of discs that can bind
    binding: Indices  # the indices of these discs in `table`

    def __init__(self) -> None:
        self.obstacles = ()
        self.table = NO_ROWS
        self.binding = indices(8)

    def set(self, told: tuple[ToldObstacle, ...]) -> None:
        """Replace the discs by `told`, a tuple of ToldObstacle."""
        self.obstacles = told
        rows = [(disc.x, disc.y, disc.radius, disc.age) for disc in told]
        self.table = view(np.array(rows, np.float64).reshape(-1, 4))
        if len(self.binding) < len(told):
            self.binding = indices(len(told))

    def find_binding(self, assumptions: Assumptions, radius: float) -> None:
        """List in `binding` the discs that can constrain a robot.

        `radius` in m: how far the outline of the robot reaches from its axle.
        """
        table = self.table
        approach_speed = assumptions.others_speed + assumptions.top_surface_speed
        self.count = 0
        for i in range(len(table)):
            distance = hypot(table[i, DISC_X], table[i, DISC_Y])
            gap = distance - table[i, DISC_RADIUS] - radius
            age = table[i, DISC_AGE] + REACTION
            if not (gap > assumptions.fresh_binding_range + approach_speed * age):
                self.binding[self.count] = i
                self.count += 1
