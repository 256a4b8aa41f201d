"""The obstacles that limit a command of mode `barrier`, for a report.

Part of the unit of barrier.py. "Rows" are constraints, see constraints.py. Units: m, s, rad.
"""

from __future__ import annotations

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import checked
from swarmd.core.cython_shadow import INFINITY, atan2, hypot
from swarmd.core.messages import LimitingObstacle
from swarmd.robot.protection.barrier_assumptions import REACTION, WALL, Assumptions
from swarmd.robot.protection.closing_speed import closing_cap, closing_deceleration, wall_cap
from swarmd.robot.protection.comparisons import maximum
from swarmd.robot.protection.constraints import ConstraintRows, Constraints, PlacedPoints, SpeedAxes
from swarmd.robot.protection.outline import Outline

BINDING_TOLERANCE = 1e-9
"""A constraint a x + b y <= cap counts as tight if both sides differ by less than this."""
MAX_REPORTED = 4
"""Constraints that a decision reports."""

# m: rounding decides the direction of a nearer place
_AT_AXLE = 1e-9


@cython.cclass
class LimitingRows:
    """The constraints that limit a command, ranked by rising caps, then by rising gaps."""

    count: int
    row: cython.Py_ssize_t[4]
    _assumptions: Assumptions
    _constraints: Constraints
    _outline: Outline

    def __init__(
        self, assumptions: Assumptions, constraints: Constraints, outline: Outline
    ) -> None:
        self._assumptions = assumptions
        self._constraints = constraints
        self._outline = outline

    def check_indices(self) -> None:
        """ValueError unless the ranked rows are within the array."""
        if not 0 <= self.count <= MAX_REPORTED:
            raise ValueError(f"{self.count} rows are ranked")

    def report(self, x: float, y: float) -> tuple[LimitingObstacle, ...]:
        """The obstacles whose constraints are tight at the speeds x, y; at most four.

        `x` and `y` are the linear and the angular speed over their limits. A constraint a x + b y
        <= cap is tight if both sides are equal. Obstacles with the lowest caps come first.
        Constraints of the envelope and of a touch zone have no obstacle, and are left out. If no
        constraint is tight, the stop check alone limits the command: the result is then the nearest
        obstacle.

        The gap is measured from the outline, also for a constraint of a single corner. A place at
        the axle has no direction, so its bearing is given as 0.
        """
        rows: ConstraintRows = self._constraints.rows
        placed: PlacedPoints = self._constraints.placed
        tight_count = 0
        row_x = checked(rows.x, rows.all)
        row_y = checked(rows.y, rows.all)
        row_cap = checked(rows.cap, rows.all)
        row_gap = checked(rows.gap, rows.all)

        # 1. Ranks the tight constraints that have an obstacle. The rows from `rows.count` on are of
        # the envelope, and have none. A robot at rest in a crowd has a hundred tight rows of cap 0.
        # So a row that `_rank` would put behind a full ranking is skipped first.
        self.count = 0
        last_cap = INFINITY  # cap and gap of the last row of a full ranking
        last_gap = INFINITY
        for i in range(rows.all):
            if row_cap[i] > last_cap or (row_cap[i] == last_cap and row_gap[i] >= last_gap):
                continue
            if not row_x[i] * x + row_y[i] * y - row_cap[i] >= -BINDING_TOLERANCE:
                continue
            tight_count += 1
            if i < rows.count:
                self._rank(rows, i)
                if self.count == MAX_REPORTED:
                    last_cap = row_cap[self.row[MAX_REPORTED - 1]]
                    last_gap = row_gap[self.row[MAX_REPORTED - 1]]

        # 2. Without a tight constraint: the first constraint of the nearest point.
        points = placed.seen + placed.discs
        if tight_count == 0 and points:
            nearest_row = placed.first_row[0]
            for i in range(1, points):
                if rows.gap[placed.first_row[i]] < rows.gap[nearest_row]:
                    nearest_row = placed.first_row[i]
            self._rank(rows, nearest_row)

        # 3. Makes the report.
        obstacles: list[LimitingObstacle] = []
        for i in range(self.count):
            obstacles.append(self._obstacle(rows, placed, self.row[i]))
        return tuple(obstacles)

    def _obstacle(self, rows: ConstraintRows, placed: PlacedPoints, row: int) -> LimitingObstacle:
        """The report of the obstacle of a constraint."""
        point = rows.source[row]
        radius = placed.radius[point]
        x = placed.x[point] - radius * placed.normal_x[point]
        y = placed.y[point] - radius * placed.normal_y[point]
        bearing = 0.0 if hypot(x, y) < _AT_AXLE else atan2(y, x)
        gap = self._outline.gap_of(x, y)
        age = maximum(placed.age[point] - REACTION, 0.0)
        cost = self._age_cost(rows, placed, row)
        return LimitingObstacle(bearing, gap, rows.cap[row], age, cost)

    def _age_cost(self, rows: ConstraintRows, placed: PlacedPoints, row: int) -> float:
        """The m/s by which the cap of a constraint would be higher for an obstacle seen just now.

        0 for constraints that do not limit the closing speed, such as side constraints.
        """
        point = rows.source[row]
        cap = self._closing_cap(rows, placed, row, placed.age[point])
        if row != placed.first_row[point] and cap != rows.cap[row]:
            return 0.0
        return maximum(self._closing_cap(rows, placed, row, REACTION) - rows.cap[row], 0.0)

    def _closing_cap(
        self, rows: ConstraintRows, placed: PlacedPoints, row: int, unseen: float
    ) -> float:
        """The cap in m/s of a constraint as Constraints sets it, for a point not seen for s."""
        assumptions: Assumptions = self._assumptions
        axes: SpeedAxes = self._constraints.axes
        point = rows.source[row]
        others = placed.others[point]
        room = rows.gap[row] + placed.radius[point] - placed.free[point]
        braking = closing_deceleration(
            rows.x[row] / axes.limit,
            rows.y[row] / axes.angular_limit,
            assumptions.braking_linear,
            assumptions.braking_angular,
        )
        if placed.kind[point] == WALL:
            return wall_cap(room, braking, unseen, others)
        return closing_cap(room, braking, unseen, others)

    def _rank(self, rows: ConstraintRows, row: int) -> None:
        """Insert a constraint into the ranking by rising caps, then by rising gaps.

        A constraint without a finite gap is left out. The ranking holds MAX_REPORTED constraints:
        if the ranking is full, its last constraint is dropped.
        """
        cap = rows.cap[row]
        gap = rows.gap[row]
        if not gap < INFINITY:
            return
        rank = self.count
        while rank > 0:
            before = self.row[rank - 1]
            if rows.cap[before] < cap or (rows.cap[before] == cap and rows.gap[before] <= gap):
                break
            rank -= 1
        if rank == MAX_REPORTED:
            return
        self.count = min(self.count + 1, MAX_REPORTED)
        for place in range(self.count - 1, rank, -1):
            self.row[place] = self.row[place - 1]
        self.row[rank] = row
