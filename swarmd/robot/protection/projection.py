"""The feasible pair of speeds nearest to a requested pair: exact projection in mode `barrier`.

Part of the unit of barrier.py. A point is a pair (x, y): linear and angular speed over their
limits.
"""

from __future__ import annotations

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import checked, doubles
from swarmd.core.cython_shadow import INFINITY, Doubles
from swarmd.robot.protection.constraints import ConstraintRows

TOLERANCE = 1e-12
"""By how much rounding may violate a constraint."""

_FEW_ROWS = 24
"""Rows that are compared with the worst row at once. 16 to 32 take equal times, 64 a fifth more."""


@cython.cclass
class Projection:
    """A polygon of feasible speeds, and its point nearest to a requested point."""

    x: float  # the nearest point
    y: float
    # The corners of the polygon, `_sides` of them, and those of a polygon clipped from it.
    _sides: int
    _corner_x: Doubles
    _corner_y: Doubles
    _clipped_x: Doubles
    _clipped_y: Doubles

    def __init__(self) -> None:
        self._corner_x = doubles(64)
        self._corner_y = doubles(64)
        self._clipped_x = doubles(64)
        self._clipped_y = doubles(64)

    def check_indices(self) -> None:
        """ValueError unless the corners are within each array."""
        if not 0 <= self._sides <= min(len(self._corner_x), len(self._corner_y)):
            raise ValueError(f"a polygon of {self._sides} sides in {len(self._corner_x)}")

    def project(self, rows: ConstraintRows, x: float, y: float) -> None:
        """Set `x`, `y` to the feasible point nearest to the requested point x, y. Exact.

        A point is the linear and the angular speed over their limits. A constraint (row) is a
        half-plane a x + b y <= cap. A polygon begins as the box of the limits. Each round clips the
        polygon by the constraint that the nearest point violates most, and finds the nearest point
        of the rest. The rounds end once the nearest point violates no constraint. The polygon
        always contains the origin, since the zero command is feasible.
        """
        self._begin_with_box()
        self._find_nearest(x, y)
        # A row by which the polygon was clipped is not violated again, so these rounds suffice.
        for _ in range(rows.all):
            worst_row = self._most_violated(rows)
            if worst_row < 0:
                break
            self._clip(rows.x[worst_row], rows.y[worst_row], rows.cap[worst_row])
            self._find_nearest(x, y)

    def _most_violated(self, rows: ConstraintRows) -> int:
        """The row that the nearest point violates most; -1 if no row is violated.

        A row with an excess of NaN counts as the most violated: to clip by such a row leaves only
        the origin.
        """
        first = 0
        row_count = rows.all
        row_x = checked(rows.x, row_count)
        row_y = checked(rows.y, row_count)
        row_cap = checked(rows.cap, row_count)
        px = self.x
        py = self.y
        worst_row = -1
        worst_excess = TOLERANCE
        while first < row_count:
            last = min(first + _FEW_ROWS, row_count)
            # 1. How many of a few rows are worse than all rows before them: mostly none. The
            # compiler vectorises this loop, which stores nothing.
            worse = 0
            for i in range(first, last):
                if not (row_x[i] * px + row_y[i] * py - row_cap[i] <= worst_excess):
                    worse += 1
            # 2. The worst of these rows.
            if worse > 0:
                for i in range(first, last):
                    excess = row_x[i] * px + row_y[i] * py - row_cap[i]
                    if not (excess <= worst_excess):
                        worst_excess = excess
                        worst_row = i
                        if worst_excess != worst_excess:
                            return worst_row
            first = last
        return worst_row

    def _begin_with_box(self) -> None:
        """Take the box of the limits as the polygon."""
        self._corner_x[0] = 1.0
        self._corner_x[1] = 1.0
        self._corner_y[1] = 1.0
        self._corner_y[2] = 1.0
        self._corner_x[2] = -1.0
        self._corner_x[3] = -1.0
        self._corner_y[0] = -1.0
        self._corner_y[3] = -1.0
        self._sides = 4

    def _clip(self, a: float, b: float, cap: float) -> None:
        """Cut off the part of the polygon where a x + b y > cap (Sutherland and Hodgman 1974).

        If nothing is left, the polygon is the origin.
        """
        if len(self._clipped_x) < 2 * self._sides:
            self._clipped_x = doubles(4 * self._sides)
            self._clipped_y = doubles(4 * self._sides)
        count = 0
        # Corner 0 begins and corner 1 ends the present side of the polygon.
        x0 = self._corner_x[self._sides - 1]
        y0 = self._corner_y[self._sides - 1]
        excess0 = a * x0 + b * y0 - cap
        for i in range(self._sides):
            x1 = self._corner_x[i]
            y1 = self._corner_y[i]
            excess1 = a * x1 + b * y1 - cap
            if (excess0 > 0.0) != (excess1 > 0.0):  # the side crosses the line: add the crossing
                fraction = excess0 / (excess0 - excess1)
                self._clipped_x[count] = x0 + fraction * (x1 - x0)
                self._clipped_y[count] = y0 + fraction * (y1 - y0)
                count += 1
            if excess1 <= 0.0:
                self._clipped_x[count] = x1
                self._clipped_y[count] = y1
                count += 1
            x0 = x1
            y0 = y1
            excess0 = excess1
        if count == 0:
            self._clipped_x[0] = 0.0
            self._clipped_y[0] = 0.0
            count = 1

        # Exchanges the buffers: the clipped polygon becomes the polygon.
        self._sides = count
        self._corner_x, self._clipped_x = self._clipped_x, self._corner_x
        self._corner_y, self._clipped_y = self._clipped_y, self._corner_y

    def _find_nearest(self, x: float, y: float) -> None:
        """Set `self.x`, `self.y` to the point of the polygon nearest to the requested point x, y.

        A point inside the polygon, or nearer than TOLERANCE, stays as requested. The polygon may
        have shrunk to a line or a point; then no requested point is inside.
        """
        nearest_x = 0.0
        nearest_y = 0.0
        nearest_square = INFINITY
        is_inside = True
        x0 = self._corner_x[self._sides - 1]
        y0 = self._corner_y[self._sides - 1]
        for i in range(self._sides):
            x1 = self._corner_x[i]
            y1 = self._corner_y[i]
            side_x = x1 - x0
            side_y = y1 - y0
            px = x - x0
            py = y - y0

            # 1. The point is inside if it is to the left of all sides (counter-clockwise corners).
            if side_x * py - side_y * px <= 0.0:
                is_inside = False

            # 2. The nearest place on this side.
            length_square = side_x * side_x + side_y * side_y
            fraction = (px * side_x + py * side_y) / length_square if length_square > 0.0 else 0.0
            if fraction < 0.0:
                fraction = 0.0
            if fraction > 1.0:
                fraction = 1.0
            foot_x = x0 + fraction * side_x
            foot_y = y0 + fraction * side_y
            square = (x - foot_x) * (x - foot_x) + (y - foot_y) * (y - foot_y)
            if square < nearest_square:
                nearest_x = foot_x
                nearest_y = foot_y
                nearest_square = square
            x0 = x1
            y0 = y1
        if is_inside or nearest_square <= TOLERANCE * TOLERANCE:
            self.x = x
            self.y = y
        else:
            self.x = nearest_x
            self.y = nearest_y


def is_feasible(rows: ConstraintRows, x: float, y: float) -> bool:
    """True if a point violates no constraint."""
    row_x = checked(rows.x, rows.all)
    row_y = checked(rows.y, rows.all)
    row_cap = checked(rows.cap, rows.all)
    for i in range(rows.all):  # noqa: SIM110  # Cython makes no loop of C of a generator
        if not (row_x[i] * x + row_y[i] * y - row_cap[i] <= TOLERANCE):
            return False
    return True
