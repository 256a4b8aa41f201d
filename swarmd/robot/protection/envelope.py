"""The speed limit of all corners near obstacles in mode `barrier` (the envelope), and creeping.

Part of the unit of barrier.py. "Rows" are constraints, see constraints.py. Units: m, s, rad.
"""

from __future__ import annotations

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import checked, checked_indices, doubles, view
from swarmd.core.cython_shadow import Doubles, Table, hypot
from swarmd.core.values import Array
from swarmd.robot.protection.barrier_assumptions import Assumptions
from swarmd.robot.protection.closing_speed import CREEP_SPEED, DECISION_PERIOD
from swarmd.robot.protection.comparisons import maximum
from swarmd.robot.protection.constraints import (
    ENVELOPE_ROWS,
    ConstraintRows,
    Constraints,
    PlacedPoints,
    SpeedAxes,
)
from swarmd.robot.protection.obstacles import NearObstacles
from swarmd.robot.protection.outline import Outline
from swarmd.robot.protection.projection import is_feasible

SURFACE_GAP = 0.0125
"""m that a locked robot keeps to what it closes on, as the scan shows it."""
SURFACE_TIME = 0.5
"""s in which a locked robot may use up the rest of the gap to what it closes on."""
LOCKED_SHARE = 0.5
"""The share of the creep speed with which a robot counts as locked: it may move no faster."""
PART_SPEED = 0.004
"""m/s at which the nearest place of a robot that nothing else frees may close on a narrow obstacle.

A flank of a Burger that moves at the creep speed along a pole of 0.3 m closes on the returns beyond
its ends at 1.3 to 2.5 mm/s. The rest is a reserve for noise, which turns a normal by some degrees.
"""

_LOCKED_STEP = 4  # vertices from one tried direction to the next
_SLOWEST = 1e-12  # m/s of a corner, by which a speed is divided


def _box_directions() -> Array:
    angles = 2.0 * np.pi * np.arange(ENVELOPE_ROWS) / ENVELOPE_ROWS
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    directions /= np.abs(directions).max(axis=1)[:, None]
    return directions


_BOX_DIRECTIONS = view(_box_directions())
"""(48, 2) directions of the envelope, on the box of the limits, whose corners are among them."""


@cython.cclass
class Envelope:
    """The constraints within which no corner of the robot moves faster than `speed`.

    Every robot assumes that no surface around it moves faster than `others_speed`. The envelope
    lets this robot keep what its peers assume, also for corners in a turn. In the plane of the two
    speeds the permitted set is convex. The constraints are the sides of a polygon inside this set;
    the vertices of the polygon lie on the border of the set.
    """

    speed: float  # m/s
    vertex_x: Doubles
    vertex_y: Doubles
    row_x: Doubles
    row_y: Doubles
    row_cap: Doubles
    _outline: Outline
    # The direction of the linear speed for which `find_rows` was called; (0, 0): none yet.
    _along_x: float
    _along_y: float

    def __init__(self, outline: Outline, speed: float) -> None:
        self._outline = outline
        self.speed = speed
        self.vertex_x = doubles(ENVELOPE_ROWS)
        self.vertex_y = doubles(ENVELOPE_ROWS)
        self.row_x = doubles(ENVELOPE_ROWS)
        self.row_y = doubles(ENVELOPE_ROWS)
        self.row_cap = doubles(ENVELOPE_ROWS)

    def check_indices(self) -> None:
        """ValueError unless each array has a number for each row."""
        lengths = len(self.row_x), len(self.row_y), len(self.row_cap)
        if min(lengths) < ENVELOPE_ROWS:
            raise ValueError(f"arrays of {lengths} for {ENVELOPE_ROWS} rows")

    def put(self, rows: ConstraintRows, axes: SpeedAxes) -> None:
        """Put the constraints of the envelope behind all others in `rows`."""
        self.prepare(axes)
        first = rows.count
        rows.all = first + ENVELOPE_ROWS
        to_x = checked(rows.x, rows.all)
        to_y = checked(rows.y, rows.all)
        to_cap = checked(rows.cap, rows.all)
        x = checked(self.row_x, ENVELOPE_ROWS)
        y = checked(self.row_y, ENVELOPE_ROWS)
        cap = checked(self.row_cap, ENVELOPE_ROWS)
        for i in range(ENVELOPE_ROWS):
            to_x[first + i] = x[i]
            to_y[first + i] = y[i]
            to_cap[first + i] = cap[i]

    def prepare(self, axes: SpeedAxes) -> None:
        """Find the vertices and the constraints, unless they are known for these axes."""
        if not (self._along_x == axes.along_x and self._along_y == axes.along_y):
            self.find_rows(axes)
            self._along_x = axes.along_x
            self._along_y = axes.along_y

    def find_rows(self, axes: SpeedAxes) -> None:
        """Find the vertices and the constraints for a direction of the linear speed.

        `axes` has the direction and the limits of the speeds. A vertex is the longest vector in a
        direction (a row of _BOX_DIRECTIONS) that lies within the box of the limits, and for which
        no corner of the outline moves faster than `speed`. A constraint is the line through two
        neighbouring vertices.
        """
        directions: Table = _BOX_DIRECTIONS

        # 1. Vertices: each direction is a place on the border of the box of the limits. If a corner
        # is faster than `speed` there, the place moves inwards until no corner is faster.
        for i in range(ENVELOPE_ROWS):
            fastest = self.fastest_corner(
                directions[i, 0] * axes.limit, directions[i, 1] * axes.angular_limit, axes
            )
            scale = self.speed / maximum(fastest, _SLOWEST)
            if scale > 1.0:
                scale = 1.0
            self.vertex_x[i] = directions[i, 0] * scale
            self.vertex_y[i] = directions[i, 1] * scale

        # 2. Constraints: the outward unit normal of each side of the polygon.
        for i in range(ENVELOPE_ROWS):
            following = i + 1 if i + 1 < ENVELOPE_ROWS else 0
            side_x = self.vertex_x[following] - self.vertex_x[i]
            side_y = self.vertex_y[following] - self.vertex_y[i]
            length = hypot(side_y, -side_x)
            normal_x = side_y / length
            normal_y = -side_x / length
            self.row_x[i] = normal_x
            self.row_y[i] = normal_y
            self.row_cap[i] = normal_x * self.vertex_x[i] + normal_y * self.vertex_y[i]

    def fastest_corner(self, linear: float, angular: float, axes: SpeedAxes) -> float:
        """The m/s of the fastest corner of a base that moves at these speeds in m/s and rad/s."""
        outline: Outline = self._outline
        fastest = 0.0
        for k in range(outline.edges):
            corner_vx = linear * axes.along_x - angular * outline.corner_y[k]
            corner_vy = linear * axes.along_y + angular * outline.corner_x[k]
            fastest = maximum(fastest, hypot(corner_vx, corner_vy))
        return fastest


@cython.cclass
class Creeping:
    """Raises the caps, so that a robot may creep towards an obstacle that stops a faster robot.

    Two robots creep: one that is asked for a slow speed (`begin`), and one that is locked, whatever
    it is asked for (`begin_out`). A robot is locked if it may move in no direction, as by a wall
    beside it: each return may belong to something that reaches `unseen_extent` farther, so that a
    turn swings a corner towards a return, and a straight line closes on those ahead and behind. A
    robot that is both gets the higher of the two caps.
    """

    is_possible: bool  # in the present situation
    is_touching: bool  # an obstacle may touch the robot: it keeps the slow envelope
    cap: float  # m/s, set by `allow`
    is_active: bool
    _kept_cap: Doubles  # the caps of all constraints before they were raised
    # The envelope while the robot creeps or touches, and the usual envelope near obstacles.
    slow: Envelope
    usual: Envelope

    def __init__(self, assumptions: Assumptions, outline: Outline) -> None:
        self._kept_cap = doubles(384)
        self.slow = Envelope(outline, CREEP_SPEED)
        self.usual = Envelope(outline, assumptions.surface_speed)

    def check_indices(self) -> None:
        """Nothing is refused: `checked` compares each length with the count of its loop.

        An index that an array states is bounded where it is read, or is the index of a view.
        """

    def allow(self, placed: PlacedPoints) -> None:
        """Set `cap`: the speed in m/s at which a robot that creeps may close on any obstacle.

        The cap is CREEP_SPEED, or less near an obstacle: until the next decision, the robot may use
        half of the gap beyond contact, since the obstacle may use the other half. The cap is 0 or
        less within contact. `placed`: the points of the decision.
        """
        self.cap = CREEP_SPEED
        for i in range(placed.seen):
            allowed = 0.5 * (placed.gap[i] - placed.contact[i])
            allowed /= placed.age[i] + DECISION_PERIOD
            self.cap = min(self.cap, allowed)

    def begin(self, rows: ConstraintRows, axes: SpeedAxes) -> None:
        """Use the caps and the envelope of a robot that creeps by a slow request."""
        self._keep(rows)
        for i in range(rows.count):
            rows.cap[i] = maximum(rows.cap[i], self.cap)
        self.is_active = True
        self.slow.put(rows, axes)

    def is_locked(self, constraints: Constraints) -> bool:
        """True if the robot may move in no direction, not even at LOCKED_SHARE of the creep speed.

        The directions are those of the slow envelope: ahead, back, both turns, and between them.
        """
        rows: ConstraintRows = constraints.rows
        self.slow.prepare(constraints.axes)
        for i in range(0, ENVELOPE_ROWS, _LOCKED_STEP):
            x = LOCKED_SHARE * self.slow.vertex_x[i]
            y = LOCKED_SHARE * self.slow.vertex_y[i]
            if is_feasible(rows, x, y):
                return False
        return True

    def begin_out(self, constraints: Constraints, near: NearObstacles, least: float) -> None:
        """Use the caps and the envelope of a locked robot.

        The slow envelope bounds each place of the outline by CREEP_SPEED, whatever is requested.
        The caps keep the robot from touching what it sees:

        - The constraint of a contact across the outline stays, with the cap 0.
        - Towards an obstacle the robot may use, until the next decision, half of the gap beyond the
          distance within which the obstacle may touch it unseen, since the obstacle may use the
          other half. Within this distance the nearest place of the robot does not close on it;
          other corners pass it.
        - A wide surface is a wall, or several bodies. What reaches out of it unseen must not hold
          the robot for good, so the robot may come as near as SURFACE_GAP. To a surface that may be
          a peer that was heard it keeps PEER_RESERVE more.
        - A robot that is locked under these caps, too, and has heard no peer, may close on a narrow
          obstacle at PART_SPEED, and as near as SURFACE_GAP: the returns of a pole beside its flank
          forbid both turns, and those beyond the ends of the flank forbid to go straight. Among
          peers a narrow obstacle may be the head of a peer, whose body reaches farther.

        Args:
            constraints: of the decision.
            near: the near returns of which they were made.
            least: m/s, a lower bound of the caps of points that are no contacts: `cap` of a slow
                request, else 0.
        """
        near.find_surfaces()
        self._keep(constraints.rows)
        self._raise(constraints, near, least)
        if near.longest_peer == 0.0 and self.is_locked(constraints):
            self._raise_narrow(constraints, near)
        self.is_active = True
        self.slow.put(constraints.rows, constraints.axes)

    def _raise(self, constraints: Constraints, near: NearObstacles, least: float) -> None:
        """Raise the caps of points that are no contacts to those of a locked robot.

        A cap is the m/s at which a place of the robot may close on a point.
        """
        rows: ConstraintRows = constraints.rows
        placed: PlacedPoints = constraints.placed
        source = checked_indices(rows.source, rows.count)
        place_gap = checked(rows.gap, rows.count)
        row_cap = checked(rows.cap, rows.count)
        near_index = checked_indices(placed.near_index, placed.seen)
        first_row = checked_indices(placed.first_row, placed.seen)
        gap = checked(placed.gap, placed.seen)
        scan_gap = checked(placed.scan_gap, placed.seen)
        contact = checked(placed.contact, placed.seen)
        age = checked(placed.age, placed.seen)
        contacts = placed.contacts
        seen = placed.seen
        highest = maximum(CREEP_SPEED, least)
        for i in range(rows.count):
            # No cap is raised above `highest`, so that two of three rows beside eight robots keep
            # theirs. A row of a point or a gap of NaN has the cap NaN, and is not left out.
            if row_cap[i] >= highest:
                continue
            point = source[i]
            if not contacts <= point < seen:
                continue
            surface = near.surface_gap[near_index[point]]
            if surface == surface:
                kept = place_gap[i] + (surface - scan_gap[point])  # less noise
                cap = (kept - SURFACE_GAP) / SURFACE_TIME
            elif not gap[point] <= contact[point]:
                cap = 0.5 * (place_gap[i] - contact[point]) / (age[point] + DECISION_PERIOD)
            elif i != first_row[point]:
                cap = CREEP_SPEED
            else:  # the nearest place: `_raise_narrow`
                cap = min((place_gap[i] - SURFACE_GAP) / SURFACE_TIME, 0.0)
            cap = maximum(min(cap, CREEP_SPEED), least)
            row_cap[i] = maximum(row_cap[i], cap)

    def _raise_narrow(self, constraints: Constraints, near: NearObstacles) -> None:
        """Raise the caps of the nearest places towards narrow obstacles that may touch unseen."""
        rows: ConstraintRows = constraints.rows
        placed: PlacedPoints = constraints.placed
        gap = checked(placed.gap, placed.seen)
        contact = checked(placed.contact, placed.seen)
        for point in range(placed.contacts, placed.seen):
            if not gap[point] <= contact[point]:
                continue
            surface = near.surface_gap[placed.near_index[point]]
            if surface == surface:
                continue
            row = placed.first_row[point]
            cap = min((rows.gap[row] - SURFACE_GAP) / SURFACE_TIME, PART_SPEED)
            rows.cap[row] = maximum(rows.cap[row], cap)

    def _keep(self, rows: ConstraintRows) -> None:
        """Store the caps, which `end` gives back."""
        if len(self._kept_cap) < rows.count:
            self._kept_cap = doubles(len(rows.cap))
        kept = checked(self._kept_cap, rows.count)
        cap = checked(rows.cap, rows.count)
        for i in range(rows.count):
            kept[i] = cap[i]

    def end(self, rows: ConstraintRows, axes: SpeedAxes) -> None:
        """Use the caps and the envelope of a robot that does not creep, as before `begin`."""
        for i in range(rows.count):
            rows.cap[i] = self._kept_cap[i]
        self.is_active = False
        envelope: Envelope = self.slow if self.is_touching else self.usual
        envelope.put(rows, axes)
