"""The constraints of mode `barrier` in the plane of the two speeds, and the points behind them.

Part of the unit of barrier.py. A constraint is an inequality a x + b y <= cap. x and y are the
linear and the angular speed of the command, each divided by its limit. So a and b are the closing
speeds in m/s at the limits. The cap in m/s is the highest speed at which a place of the outline may
close on a point. `ConstraintRows` is a table with one constraint in each row, so names in the code
say row for constraint.

Units: m, s, rad, in the predicted base frame: the base frame at the pose at which the next command
takes effect.
"""

from __future__ import annotations

import math

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import checked, checked_indices, doubles, indices
from swarmd.core.cython_shadow import INFINITY, Doubles, Indices, cos, fabs, sin, sqrt
from swarmd.core.values import Limits
from swarmd.robot.protection.barrier_assumptions import (
    BARE_WALL,
    OTHER,
    REACTION,
    WALL,
    Assumptions,
)
from swarmd.robot.protection.closing_speed import (
    CREEP_SPEED,
    DECISION_PERIOD,
    closing_cap,
    closing_deceleration,
    reciprocal_cap,
    wall_cap,
)
from swarmd.robot.protection.comparisons import at_least, maximum
from swarmd.robot.protection.dead_reckoning import PlanarPose
from swarmd.robot.protection.obstacles import NearObstacles, Points
from swarmd.robot.protection.outline import CHUNK, Chunk, Outline
from swarmd.robot.protection.touch_zone import TouchSector

SIDE_ANGLE = math.radians(60.0)
"""rad between a return and its two side constraints."""
ROWS_OF_A_POINT = 6
"""Constraints that a point has at most, beside those of the corners."""
ENVELOPE_ROWS = 48
"""Constraints of the envelope of speeds."""

_SLACK = 1e-6  # far beyond BINDING_TOLERANCE
_NEAREST = 1e-9  # m: a point at a corner or at the lidar
_side_cos = math.cos(SIDE_ANGLE)
_side_sin = math.sin(SIDE_ANGLE)


@cython.cclass
class SpeedAxes:
    """The plane of the two speeds: the direction of the linear speed, and the limit of each."""

    along_x: float
    along_y: float
    limit: float  # m/s, of the linear speed in its direction
    angular_limit: float  # rad/s


def linear_limit(limits: Limits, along_x: float, along_y: float) -> float:
    """The limit of the linear speed in m/s in the direction of a unit vector."""
    ahead = abs(along_x)
    aside = abs(along_y)
    return min(
        limits.linear / ahead if ahead else math.inf, limits.lateral / aside if aside else math.inf
    )


@cython.cclass
class ConstraintRows:
    """A table of constraints: first those with a point, then those of the envelope."""

    count: int  # constraints without the envelope
    all: int  # constraints with the envelope
    x: Doubles  # a of a x + b y <= cap
    y: Doubles  # b
    cap: Doubles
    gap: Doubles  # m to the obstacle, for reports
    source: Indices  # the index of the placed point

    def __init__(self) -> None:
        self._allocate(384)

    def reserve(self, room: int) -> None:
        """Make the arrays at least `room` long; arrays that were shorter lose their numbers."""
        if len(self.x) < room:
            self._allocate(room + room // 2)

    def _allocate(self, room: int) -> None:
        """Make all arrays anew."""
        self.x = doubles(room)
        self.y = doubles(room)
        self.cap = doubles(room)
        self.gap = doubles(room)
        self.source = indices(room)

    def add(self, x: float, y: float, cap: float, gap: float, source: int) -> None:
        """Add a constraint; `reserve` must have made room."""
        row = self.count
        self.x[row] = x
        self.y[row] = y
        self.cap[row] = cap
        self.gap[row] = gap
        self.source[row] = source
        self.count = row + 1


@cython.cclass
class PlacedPoints:
    """The points of one decision in the predicted base frame.

    The returns of the scan come first, then the centres of discs in which an obstacle is (see
    `ObstacleDiscs`).
    """

    seen: int  # number of returns; before `add_seen`, of returns to be placed
    contacts: int  # how many returns, the first ones, are in contact
    discs: int  # number of discs
    x: Doubles
    y: Doubles
    gap: Doubles  # m from the outline
    free: Doubles  # m that must stay free
    age: Doubles  # s
    contact: Doubles  # m: within this gap the obstacle may touch the robot unseen
    scan_gap: Doubles  # m, of a seen point when it was measured
    radius: Doubles  # m, of a disc
    others: Doubles  # m/s at which the obstacle may approach
    kind: Indices  # of the obstacle
    normal_x: Doubles  # the unit vector from the outline
    normal_y: Doubles
    first_row: Indices  # the index of the first constraint of each point
    in_touch_zone: Indices  # 1 for a seen point that the robot may touch
    near_index: Indices  # of a seen point in `NearObstacles.points`

    def __init__(self) -> None:
        self._allocate(96)

    def check_indices(self) -> None:
        """ValueError unless the counts of points are within the arrays."""
        counts = self.contacts, self.seen, self.discs
        if min(counts) < 0 or self.seen + self.discs > len(self.x):
            raise ValueError(f"contacts, seen points and discs are {counts}, in {len(self.x)}")

    def reserve(self, room: int) -> None:
        """Make the arrays at least `room` long; arrays that were shorter lose their numbers."""
        if len(self.x) < room:
            self._allocate(room + room // 2)  # else each further point would make new arrays

    def _allocate(self, room: int) -> None:
        """Make all arrays anew."""
        self.x = doubles(room)
        self.y = doubles(room)
        self.gap = doubles(room)
        self.free = doubles(room)
        self.age = doubles(room)
        self.radius = doubles(room)
        self.contact = doubles(room)
        self.scan_gap = doubles(room)
        self.others = doubles(room)
        self.kind = indices(room)
        self.normal_x = doubles(room)
        self.normal_y = doubles(room)
        self.first_row = indices(room)
        self.in_touch_zone = indices(room)
        self.near_index = indices(room)

    def place(self, chunk: Chunk, first: int, rows: ConstraintRows) -> None:
        """Copy the points of a chunk to the arrays here, from index `first` on.

        The caller has written one row for each point, from row `rows.count` on, and counts these
        rows after this call. Point and row refer to each other: the row becomes the `first_row` of
        the point, and the point the `source` of the row.
        """
        count = chunk.count
        end = first + count
        row = rows.count
        chunk_x = chunk.x
        chunk_y = chunk.y
        free = chunk.free
        age = chunk.age
        hidden = chunk.hidden
        chunk_normal_x = chunk.normal_x
        chunk_normal_y = chunk.normal_y
        gap = chunk.gap
        radius = chunk.radius
        placed_x = checked(self.x, end)
        placed_y = checked(self.y, end)
        placed_free = checked(self.free, end)
        placed_age = checked(self.age, end)
        placed_contact = checked(self.contact, end)
        placed_gap = checked(self.gap, end)
        placed_normal_x = checked(self.normal_x, end)
        placed_normal_y = checked(self.normal_y, end)
        placed_radius = checked(self.radius, end)
        others = chunk.others
        placed_others = checked(self.others, end)
        kind = chunk.kind
        placed_kind = checked_indices(self.kind, end)
        for j in range(count):
            i = first + j
            placed_x[i] = chunk_x[j]
            placed_y[i] = chunk_y[j]
            placed_free[i] = free[j]
            placed_age[i] = age[j]
            placed_contact[i] = free[j] + hidden[j]  # the obstacle may touch within both parts
            placed_normal_x[i] = chunk_normal_x[j]
            placed_normal_y[i] = chunk_normal_y[j]
            placed_gap[i] = gap[j]
            placed_radius[i] = radius[j]
            placed_others[i] = others[j]
            placed_kind[i] = kind[j]
        first_row = checked_indices(self.first_row, end)
        source = checked_indices(rows.source, row + count)
        for j in range(count):
            first_row[first + j] = row + j
            source[row + j] = first + j


def _is_near_corners(gap: float, free: float, age: float, others: float) -> bool:
    """True if a point is so near that the corners of the outline need constraints of their own.

    A point is near if its gap may be at most twice the free distance at the next decision. For a
    point with a greater gap the next decision adds the constraints in time: more than the free
    distance is then left to brake within.

    `gap`, `free`: m, the present gap and the distance that must stay free. `age`: s from the
    measurement of the point until the command takes effect. `others`: m/s, of the obstacle.
    """
    return gap <= 2.0 * free + others * (age + DECISION_PERIOD)


def _wall_cap(
    chunk: Chunk, j: int, linear: float, lever: float, gap: float, assumptions: Assumptions
) -> float:
    """The cap in m/s of one place of the outline towards point `j` of a wall that stands.

    `linear`, `lever`: as of `Constraints._add`. `gap`: m from the place to the point.
    """
    braking = closing_deceleration(
        linear, lever, assumptions.braking_linear, assumptions.braking_angular
    )
    return wall_cap(gap - chunk.free[j], braking, chunk.age[j], chunk.others[j])


def _set_wall_caps(chunk: Chunk, axes: SpeedAxes, assumptions: Assumptions) -> None:
    """Replace the caps of points of walls that stand by `wall_cap`.

    A wall that stands is straight, so no part of the wall extends unseen into the blind zone: its
    hidden gap becomes 0.
    """
    for j in range(chunk.count):
        if chunk.kind[j] != OTHER:
            linear = chunk.normal_x[j] * axes.along_x + chunk.normal_y[j] * axes.along_y
            chunk.cap[j] = _wall_cap(chunk, j, linear, chunk.lever[j], chunk.gap[j], assumptions)
            chunk.hidden[j] = 0.0


def _set_corner_wall_caps(
    chunk: Chunk,
    axes: SpeedAxes,
    assumptions: Assumptions,
    corner_x: float,
    corner_y: float,
    begin: int,
    end: int,
) -> None:
    """Replace caps of one corner, as `_set_wall_caps` does for the nearest place of the outline.

    The loop is not part of the loop of `_add_corners`, which would compute two caps for each point.

    `corner_x`, `corner_y`: m, the corner. `begin`, `end`: the points of the chunk from `begin` to
    before `end`, whose distance from the corner is in `row_gap`.
    """
    for j in range(begin, end):
        if chunk.kind[j] != OTHER:
            distance = chunk.row_gap[j]
            dx = (chunk.x[j] - corner_x) / distance
            dy = (chunk.y[j] - corner_y) / distance
            linear = dx * axes.along_x + dy * axes.along_y
            lever = corner_x * dy - corner_y * dx
            chunk.row_cap[j] = _wall_cap(chunk, j, linear, lever, distance, assumptions)


@cython.cclass
class ToldPlaces:
    """Circles in the predicted base frame in which an unseen obstacle may be, its parts included.

    A return in such a circle has the full `unseen_extent`, also if it is of the kind BARE_WALL.
    """

    count: int
    x: Doubles  # m
    y: Doubles
    reach: Doubles  # m

    def __init__(self) -> None:
        self._allocate(8)

    def check_indices(self) -> None:
        """ValueError unless the circles are within the arrays."""
        if not 0 <= self.count <= min(len(self.x), len(self.y), len(self.reach)):
            raise ValueError(f"{self.count} circles in {len(self.x)}")

    def begin(self, room: int) -> None:
        """Drop all circles, and make room for `room` circles."""
        self.count = 0
        if len(self.x) < room:
            self._allocate(room + room // 2)

    def _allocate(self, room: int) -> None:
        """Make all arrays anew."""
        self.x = doubles(room)
        self.y = doubles(room)
        self.reach = doubles(room)

    def add(self, x: float, y: float, reach: float) -> None:
        """Add a circle; `begin` must have made room."""
        self.x[self.count] = x
        self.y[self.count] = y
        self.reach[self.count] = reach
        self.count += 1

    def hold(self, x: float, y: float) -> bool:
        """True if a place is in a circle. A place or circle of NaN counts as in."""
        for k in range(self.count):
            dx = x - self.x[k]
            dy = y - self.y[k]
            is_outside = sqrt(dx * dx + dy * dy) > self.reach[k]
            if not is_outside:
                return True
        return False


@cython.cclass
class Constraints:
    """The constraints of one decision, made of the placed points."""

    rows: ConstraintRows
    placed: PlacedPoints
    told: ToldPlaces
    axes: SpeedAxes
    touch: TouchSector
    _chunk: Chunk
    _outline: Outline
    _assumptions: Assumptions

    def __init__(self, assumptions: Assumptions, outline: Outline, touch: TouchSector) -> None:
        self._assumptions = assumptions
        self._outline = outline
        self.rows = ConstraintRows()
        self.placed = PlacedPoints()
        self.told = ToldPlaces()
        self.axes = SpeedAxes()
        self.touch = touch
        self._chunk = Chunk()
        self.axes.angular_limit = assumptions.angular_limit

    def check_indices(self) -> None:
        """ValueError unless the counts of rows are within the arrays."""
        rows: ConstraintRows = self.rows
        if not (0 <= rows.count <= len(rows.x) and 0 <= rows.all <= len(rows.x)):
            raise ValueError(f"{rows.count} rows of {rows.all} in {len(rows.x)}")

    def begin(self, near: NearObstacles, discs: int, furthest: float) -> None:
        """Drop all constraints, and make room for the points and constraints of a decision.

        The points are those of `near` with a gap below `furthest` m, and `discs` discs.
        """
        points: Points = near.points
        count = 0  # points before `end` that count; their gaps rise
        end = points.count
        while count < end:
            middle = (count + end) // 2
            if points.gap[middle] >= furthest:
                end = middle
            else:
                count = middle + 1
        contacts = min(near.contacts, count)
        touch_rows = len(self.touch.corners) if self.touch.is_granted else 0
        rows_of_a_point = ROWS_OF_A_POINT + self._outline.edges
        self.placed.reserve(count + discs)
        self.rows.reserve((count + discs) * rows_of_a_point + contacts + touch_rows + ENVELOPE_ROWS)
        self.rows.count = 0
        self.placed.seen = count
        self.placed.contacts = contacts
        self.placed.discs = discs

    def add_seen(
        self, near: NearObstacles, frame: PlanarPose, age: float, free: float, bare_free: float
    ) -> None:
        """Place the first `placed.seen` returns of the scan, and add their constraints.

        A return too far away to constrain any command within the limits is left out. So the call
        lowers `placed.seen`, which `begin` has set, to the number of returns that were placed.

        Args:
            near: the near returns of the scan, contacts first.
            frame: the pose of the scan in the predicted base frame.
            age: s from the newest ray until the command takes effect.
            free: m that must stay free around each return.
            bare_free: m, the same around a return of the kind BARE_WALL outside of all `told`.
        """
        chunk: Chunk = self._chunk
        placed: PlacedPoints = self.placed
        assumptions: Assumptions = self._assumptions
        count = placed.seen
        taken = 0  # returns that were examined so far
        placed_count = 0
        cos_yaw = cos(frame.yaw)
        sin_yaw = sin(frame.yaw)
        gaps = checked(near.points.gap, count)
        ages = checked(near.points.age, count)
        xs = checked(near.points.x, count)
        ys = checked(near.points.y, count)
        kinds = checked_indices(near.points.kind, count)
        while taken < count:
            # 1. Transforms the next returns that may constrain the robot into the chunk. `begin`
            # has left out returns by the oldest ray. The obstacle of a younger ray has less time to
            # come near, so the age of each ray leaves out a tenth of the returns. A gap of NaN is
            # not beyond any range.
            in_chunk = 0
            while taken < count and in_chunk < CHUNK:
                ray_age = age + ages[taken]
                is_beyond = gaps[taken] >= assumptions.binding_range(ray_age)
                if not is_beyond:
                    x = xs[taken]
                    y = ys[taken]
                    chunk.x[in_chunk] = frame.x + cos_yaw * x - sin_yaw * y
                    chunk.y[in_chunk] = frame.y + sin_yaw * x + cos_yaw * y
                    chunk.free[in_chunk] = free
                    chunk.age[in_chunk] = ray_age
                    kind = kinds[taken]
                    if kind == BARE_WALL:
                        if self.told.hold(chunk.x[in_chunk], chunk.y[in_chunk]):
                            kind = WALL
                        else:
                            chunk.free[in_chunk] = bare_free
                    chunk.radius[in_chunk] = 0.0
                    chunk.kind[in_chunk] = kind
                    chunk.others[in_chunk] = assumptions.speed_of(kind)
                    placed.scan_gap[placed_count + in_chunk] = gaps[taken]
                    placed.near_index[placed_count + in_chunk] = taken
                    in_chunk += 1
                taken += 1
            # 2. Adds the constraints of the chunk. The contacts come first in the chunk, and get no
            # constraints of corners: `_add_contacts` forbids all motion towards contacts.
            chunk.count = in_chunk
            self._add_chunk(placed_count, assumptions.blind_radius)
            contacts_in_chunk = max(placed.contacts - placed_count, 0)
            if assumptions.unseen_extent > 0.0:
                self._add_corners(placed_count, contacts_in_chunk)
            if assumptions.has_keep_out():
                self._add_keep_out(placed_count)
            placed_count += chunk.count
        placed.seen = placed_count
        self._add_contacts(near.rays, cos_yaw, sin_yaw)

    def _add_contacts(self, rays: Points, cos_yaw: float, sin_yaw: float) -> None:
        """Forbid all motion towards contacts, and slow down motion along their rays.

        A contact is a return too close to measure, or a remembered obstacle in the blind zone. The
        cap of its first constraint, across the outline, becomes 0. A second constraint with the cap
        CREEP_SPEED is added in the direction of the ray: its cap was 0, and held robots side by
        side for good, since the rays to a flank in contact span 47 to 105 degrees, so that motion
        ahead and motion back both close along one of them.
        """
        axes: SpeedAxes = self.axes
        placed: PlacedPoints = self.placed
        for i in range(placed.contacts):
            self.rows.cap[placed.first_row[i]] = 0.0
            nx = cos_yaw * rays.x[i] - sin_yaw * rays.y[i]
            ny = sin_yaw * rays.x[i] + cos_yaw * rays.y[i]
            lever = placed.x[i] * ny - placed.y[i] * nx
            self._add(nx * axes.along_x + ny * axes.along_y, lever, CREEP_SPEED, 0.0, i)

    def add_disc(
        self, point: int, x: float, y: float, radius: float, age: float, moved: float
    ) -> None:
        """Add the constraints of a disc in which an obstacle is.

        The gap to a disc is the gap to its centre less its radius. So the radius is added to the
        distance that must stay free around the centre.

        Args:
            point: the index of the disc in `placed`.
            x: m, the centre in the predicted base frame.
            y: m, of the same centre.
            radius: m.
            age: s from the measurement of the disc until this decision.
            moved: m that the outline may have moved since the newest odometry.
        """
        chunk: Chunk = self._chunk
        free = self._assumptions.margin + radius
        chunk.count = 1
        chunk.x[0] = x
        chunk.y[0] = y
        chunk.free[0] = free + moved
        chunk.age[0] = age + REACTION  # when the command takes effect
        chunk.radius[0] = radius
        chunk.kind[0] = OTHER
        chunk.others[0] = self._assumptions.others_speed
        self._add_chunk(point, 0.0)  # 0: no blind zone, since the lidar does not measure discs
        self._add_corners(point, 0)  # 0: from the first point of the chunk on

    def _add_chunk(self, first: int, blind: float) -> None:
        """Copy the points of the chunk to `placed`, and add their constraints.

        The first constraint of each point limits the speed at which the nearest place of the
        outline closes on the point. `_add_approaching` and `_add_sides` then add constraints for
        obstacles beside the robot.

        `first`: the index in `placed` of the chunk's first point. `blind`: m, the radius of the
        lidar's blind zone, in which a part of the obstacle may be hidden; 0: no part is hidden.
        """
        chunk: Chunk = self._chunk
        rows: ConstraintRows = self.rows
        axes: SpeedAxes = self.axes
        assumptions: Assumptions = self._assumptions
        count = chunk.count
        first_row = rows.count
        nx = chunk.normal_x
        ny = chunk.normal_y
        lever = chunk.lever
        gap = chunk.gap
        free = chunk.free
        age = chunk.age
        cap = chunk.cap
        radius = chunk.radius
        chunk_row_x = chunk.row_x
        chunk_row_y = chunk.row_y
        along_x = axes.along_x
        along_y = axes.along_y
        limit = axes.limit
        angular_limit = axes.angular_limit
        slowing = assumptions.braking_linear
        turning = assumptions.braking_angular
        others = chunk.others
        # 1. Finds the nearest place of the outline for each point, and the constraint.
        self._outline.separate(chunk, blind)
        for j in range(count):
            linear = nx[j] * along_x + ny[j] * along_y
            braking = closing_deceleration(linear, lever[j], slowing, turning)
            cap[j] = closing_cap(gap[j] - free[j], braking, age[j], others[j])
            chunk_row_x[j] = linear * limit
            chunk_row_y[j] = lever[j] * angular_limit
        if assumptions.has_kinds:
            _set_wall_caps(chunk, axes, assumptions)
        # 2. Writes the constraints behind the rows so far.
        row_x = checked(rows.x, first_row + count)
        row_y = checked(rows.y, first_row + count)
        row_cap = checked(rows.cap, first_row + count)
        row_gap = checked(rows.gap, first_row + count)
        for j in range(count):
            row_x[first_row + j] = chunk_row_x[j]
            row_y[first_row + j] = chunk_row_y[j]
            row_cap[first_row + j] = cap[j]
            row_gap[first_row + j] = gap[j] - radius[j]
        # 3. Stores the points, then counts the rows (`place` needs the count before).
        self.placed.place(chunk, first, rows)
        rows.count = first_row + count
        # 4. Adds the constraints for obstacles beside the robot.
        self._add_approaching(first)
        self._add_sides(first)

    def _add(self, linear: float, lever: float, cap: float, gap: float, source: int) -> None:
        """Add the constraint of one place of the outline in one direction.

        Args:
            linear: the part of the linear speed in this direction, from -1 to 1.
            lever: m, the speed of the place in this direction for each rad/s of the angular speed.
            cap: m/s, the highest speed of the place in this direction.
            gap: m to the obstacle, for reports.
            source: the index of the placed point.
        """
        axes: SpeedAxes = self.axes
        self.rows.add(linear * axes.limit, lever * axes.angular_limit, cap, gap, source)

    def _add_sides(self, first: int) -> None:
        """Add two side constraints for each point of the chunk whose cap is 0.

        A cap of 0 forbids the robot to close on the obstacle, but not to pass the obstacle
        sideways. But an obstacle that moves may have left the place that the scan showed: two
        robots may slide past the last seen place of each other until their corners meet. So this
        function limits two corners of the outline: the foremost corner in the direction SIDE_ANGLE
        to the left of the point, and the foremost corner in the direction SIDE_ANGLE to the right.

        `first` is the index in `placed` of the chunk's first point. The loops run over all points
        up to the last point with the cap 0: loops without branches are vectorised. `_add_side` then
        leaves out the points with other caps.
        """
        chunk: Chunk = self._chunk
        outline: Outline = self._outline
        count = chunk.count
        nx = chunk.normal_x
        ny = chunk.normal_y
        cap = chunk.cap
        foremost = chunk.foremost
        lever = chunk.side_lever
        side_x = chunk.side_x
        side_y = chunk.side_y
        while count > 0 and not (cap[count - 1] <= 0.0):
            count -= 1
        for side in range(2):
            sine = _side_sin if side == 0 else -_side_sin  # left, then right
            for j in range(count):
                side_x[j] = _side_cos * nx[j] - sine * ny[j]
                side_y[j] = sine * nx[j] + _side_cos * ny[j]
                foremost[j] = -INFINITY
                lever[j] = 0.0
            # For each point: the foremost corner in the side direction, and the lever of this
            # corner.
            for k in range(outline.edges):
                corner_x = outline.corner_x[k]
                corner_y = outline.corner_y[k]
                for j in range(count):
                    forward = corner_x * side_x[j] + corner_y * side_y[j]
                    corner_lever = corner_x * side_y[j] - corner_y * side_x[j]
                    previous_most = foremost[j]
                    previous_lever = lever[j]
                    lever[j] = corner_lever if forward > previous_most else previous_lever
                    foremost[j] = forward if forward > previous_most else previous_most
            self._add_side(first, count)

    def _add_side(self, first: int, count: int) -> None:
        """Add the side constraints of one side of the robot, for the points whose cap is 0.

        A side constraint limits the speed of the foremost corner in the side direction. Until the
        next decision, the corner may move by half of the gap beyond contact, which is the gap less
        the free distance and the hidden gap. A robot that comes from the opposite direction with
        the same limit uses the second half. `side_reserve` is subtracted from the limit, for an
        obstacle that moves towards the corner. The limit is at least CREEP_SPEED. A wall that
        stands gets no side constraint.

        `first` is the index in `placed` of the chunk's first point. `_add_sides` has stored the
        directions and the levers of the first `count` points of the chunk.
        """
        chunk: Chunk = self._chunk
        rows: ConstraintRows = self.rows
        axes: SpeedAxes = self.axes
        reserve = self._assumptions.side_reserve
        gap = chunk.gap
        cap = chunk.cap
        lever = chunk.side_lever
        side_x = chunk.side_x
        side_y = chunk.side_y
        row = rows.count
        row_x = checked(rows.x, row + count)
        row_y = checked(rows.y, row + count)
        row_cap = checked(rows.cap, row + count)
        row_gap = checked(rows.gap, row + count)
        source = checked_indices(rows.source, row + count)
        for j in range(count):
            if cap[j] <= 0.0 and chunk.kind[j] == OTHER:
                half_gap = 0.5 * (gap[j] - (chunk.free[j] + chunk.hidden[j]))
                # The obstacle may have moved since the scan, so the time begins at the scan.
                speed = half_gap / (chunk.age[j] + DECISION_PERIOD) - reserve
                linear = side_x[j] * axes.along_x + side_y[j] * axes.along_y
                row_x[row] = linear * axes.limit
                row_y[row] = lever[j] * axes.angular_limit
                row_cap[row] = maximum(speed, CREEP_SPEED)
                row_gap[row] = gap[j] - chunk.radius[j]
                source[row] = first + j
                row += 1
        rows.count = row

    def _add_approaching(self, first: int) -> None:
        """Limit the linear speed early, for obstacles that may approach from the side.

        The side constraints of an obstacle beside the robot (`_add_sides`) begin to hold once the
        cap of the obstacle is 0. To brake only then is too late: a Waffle Pi then still moved at
        0.09 m/s. So this function assumes that the obstacle approaches at `others_speed`, and
        limits the linear speed now to

            the speed that the side constraints will allow once the cap is 0
            + the speed that the brake can take off until then.

        The function adds at most two constraints: the strictest limit ahead and the strictest limit
        back. `first` is the index in `placed` of the chunk's first point.

        The angular speed is not limited here: braking a turn does not reduce the speed ahead, and
        the stop check (stopping.py) covers corners that swing outwards.
        """
        chunk: Chunk = self._chunk
        axes: SpeedAxes = self.axes
        touch: TouchSector = self.touch
        reserve = self._assumptions.side_reserve
        if reserve <= 0.0:
            return  # this rule is a part of the reserve, which some platforms set to 0
        others_speed = self._assumptions.others_speed
        slowing = self._assumptions.braking_linear
        # m that an obstacle moves while the robot brakes from its highest speed
        longest_approach = others_speed * axes.limit / slowing
        ahead_cap = axes.limit
        back_cap = axes.limit
        ahead_point = -1
        back_point = -1
        # 1. Finds the strictest limits below the limit of the platform. A point stays -1 without
        # such a limit.
        for j in range(chunk.count):
            if chunk.kind[j] != OTHER:
                continue  # such a wall does not approach
            nx = chunk.normal_x[j]
            ny = chunk.normal_y[j]
            age = chunk.age[j] + DECISION_PERIOD
            # m that the obstacle may still approach until its cap is 0
            approach_room = chunk.gap[j] - chunk.free[j] - others_speed * age
            if not approach_room > 0.0:
                continue  # the cap is 0 already: `_add_side` limits the corners
            if not approach_room < longest_approach:
                continue  # there is time to brake later
            if touch.is_granted and touch.holds(nx, ny):
                continue
            # m/s that `_add_side` will allow in the side directions once the cap is 0. The gap less
            # the free distance is then others_speed * age. The hidden gap is subtracted, and the
            # corner may use half of the rest within `age`.
            side_speed = 0.5 * (others_speed - chunk.hidden[j] / age)
            side_speed = maximum(side_speed - reserve, CREEP_SPEED)
            # m/s that the brake takes off until then
            braked_speed = slowing * approach_room / others_speed
            # The speed in a side direction as a share of the linear speed: the greater share of the
            # two side directions, for motion ahead and for motion back.
            along = _side_cos * (nx * axes.along_x + ny * axes.along_y)
            aside = _side_sin * fabs(nx * axes.along_y - ny * axes.along_x)
            ahead_share = aside + along
            back_share = aside - along
            if ahead_share > 0.0 and side_speed / ahead_share + braked_speed < ahead_cap:
                ahead_cap = side_speed / ahead_share + braked_speed
                ahead_point = j
            if back_share > 0.0 and side_speed / back_share + braked_speed < back_cap:
                back_cap = side_speed / back_share + braked_speed
                back_point = j
        # 2. Adds the strictest limit ahead, and the strictest limit back.
        if ahead_point >= 0:
            gap = chunk.gap[ahead_point] - chunk.radius[ahead_point]
            self._add(1.0, 0.0, ahead_cap, gap, first + ahead_point)
        if back_point >= 0:
            gap = chunk.gap[back_point] - chunk.radius[back_point]
            self._add(-1.0, 0.0, back_cap, gap, first + back_point)

    def _add_corners(self, first: int, begin: int) -> None:
        """Add a constraint for each pair of a near point and a corner of the outline.

        The constraint limits the speed at which the corner closes on the point, by the linear and
        the angular speed together, to `closing_cap` of the distance from the corner to the point
        less the free distance (`wall_cap` for a wall that stands). An obstacle may extend beyond
        the part that the scan shows (`unseen_extent`), so a corner that swings past the point may
        touch the obstacle. `_is_near_corners` tells by the gap of the outline which points are
        near. `_add_corner` leaves out pairs that no command within the limits can violate.

        `first`: the index in `placed` of the chunk's first point. `begin`: the index in the chunk
        of the first point to which constraints are added: contacts, before it, have constraints
        that forbid all motion towards them.
        """
        chunk: Chunk = self._chunk
        outline: Outline = self._outline
        axes: SpeedAxes = self.axes
        assumptions: Assumptions = self._assumptions
        end = chunk.count
        x = chunk.x
        y = chunk.y
        gap = chunk.gap
        free = chunk.free
        age = chunk.age
        new_x = chunk.row_x
        new_y = chunk.row_y
        new_cap = chunk.row_cap
        new_gap = chunk.row_gap
        along_x = axes.along_x
        along_y = axes.along_y
        limit = axes.limit
        angular_limit = axes.angular_limit
        slowing = assumptions.braking_linear
        turning = assumptions.braking_angular
        others = chunk.others
        # 1. Leaves out points at the end of the chunk that are not near: most gaps rise.
        while end > begin and not _is_near_corners(
            gap[end - 1], free[end - 1], age[end - 1], others[end - 1]
        ):
            end -= 1
        # 2. For each corner: the unit vector to each point, and the cap in this direction.
        for k in range(outline.edges):
            corner_x = outline.corner_x[k]
            corner_y = outline.corner_y[k]
            for j in range(begin, end):
                dx = x[j] - corner_x
                dy = y[j] - corner_y
                distance = at_least(sqrt(dx * dx + dy * dy), _NEAREST)
                dx /= distance
                dy /= distance
                linear = dx * along_x + dy * along_y
                lever = corner_x * dy - corner_y * dx
                braking = closing_deceleration(linear, lever, slowing, turning)
                new_cap[j] = closing_cap(distance - free[j], braking, age[j], others[j])
                new_x[j] = linear * limit
                new_y[j] = lever * angular_limit
                new_gap[j] = distance
            if assumptions.has_kinds:
                _set_corner_wall_caps(chunk, axes, assumptions, corner_x, corner_y, begin, end)
            self._add_corner(first, begin, end)

    def _add_corner(self, first: int, begin: int, end: int) -> None:
        """Add the constraints of one corner of the outline, which `_add_corners` has computed.

        The points are those of the chunk from `begin` to before `end`. `first` is the index in
        `placed` of the chunk's first point. Points that are not near get no constraint.
        """
        chunk: Chunk = self._chunk
        rows: ConstraintRows = self.rows
        others = chunk.others
        gap = chunk.gap
        free = chunk.free
        age = chunk.age
        new_x = chunk.row_x
        new_y = chunk.row_y
        new_cap = chunk.row_cap
        new_gap = chunk.row_gap
        radius = chunk.radius
        row = rows.count
        room = row + end - begin
        row_x = checked(rows.x, room)
        row_y = checked(rows.y, room)
        row_cap = checked(rows.cap, room)
        row_gap = checked(rows.gap, room)
        source = checked_indices(rows.source, room)
        for j in range(begin, end):
            # x and y of a constraint are from -1 to 1 for a command within the limits.
            fastest = fabs(new_x[j]) + fabs(new_y[j])
            if new_cap[j] > fastest + _SLACK:
                continue  # no command within the limits violates the constraint
            if _is_near_corners(gap[j], free[j], age[j], others[j]):
                row_x[row] = new_x[j]
                row_y[row] = new_y[j]
                row_cap[row] = new_cap[j]
                row_gap[row] = new_gap[j] - radius[j]
                source[row] = first + j
                row += 1
        rows.count = row

    def _add_keep_out(self, first: int) -> None:
        """Add a constraint for each point of the chunk that keeps a circle around the lidar free.

        The circle of `keep_out` m covers the blind zone of the lidar. Two robots that both use this
        constraint each use at most half of the distance to the circle. `first` is the index in
        `placed` of the chunk's first point.
        """
        chunk: Chunk = self._chunk
        axes: SpeedAxes = self.axes
        assumptions: Assumptions = self._assumptions
        lidar_x = self._outline.lidar_x
        lidar_y = self._outline.lidar_y
        for j in range(chunk.count):
            dx = chunk.x[j] - lidar_x
            dy = chunk.y[j] - lidar_y
            distance = at_least(sqrt(dx * dx + dy * dy), _NEAREST)
            dx /= distance
            dy /= distance
            linear = dx * axes.along_x + dy * axes.along_y
            lever = lidar_x * dy - lidar_y * dx
            braking = closing_deceleration(
                linear, lever, assumptions.braking_linear, assumptions.braking_angular
            )
            cap = reciprocal_cap(distance - assumptions.keep_out, braking, chunk.age[j])
            self._add(linear, lever, cap, chunk.gap[j] - chunk.radius[j], first + j)

    def allow_touch(self) -> None:
        """Raise the caps in a granted touch zone to its speed, and limit all motion in the zone.

        A touch zone is a range of directions in which the pattern may touch obstacles. A point is
        in the zone if the direction from the outline to the point is in the zone. The bearing from
        the axle is not used: seen from the axle, a pushed box is wider than any zone. No corner may
        move faster than the zone's speed in the directions of the zone, also without a return
        there, since the lidar may not see a pushed object.
        """
        rows: ConstraintRows = self.rows
        axes: SpeedAxes = self.axes
        placed: PlacedPoints = self.placed
        touch: TouchSector = self.touch
        corners = touch.corners
        # 1. Raises the caps of the returns in the zone.
        for i in range(placed.seen):
            placed.in_touch_zone[i] = touch.holds(placed.normal_x[i], placed.normal_y[i])
        for i in range(rows.count):
            if placed.in_touch_zone[rows.source[i]]:
                rows.cap[i] = maximum(rows.cap[i], touch.speed)
        # 2. Limits each corner in each direction. Rows: direction (x, y), corner (x, y) in m.
        for i in range(len(corners)):
            nx = corners[i, 0]
            ny = corners[i, 1]
            linear = nx * axes.along_x + ny * axes.along_y
            lever = corners[i, 2] * ny - corners[i, 3] * nx
            # Without an obstacle: the gap inf keeps the constraint, and point 0, out of reports.
            self._add(linear, lever, touch.speed, INFINITY, 0)
