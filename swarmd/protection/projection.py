"""The feasible pair of speeds nearest to a requested pair: exact projection in mode `barrier`.

Part of the library of barrier.py. The axes are the two speeds over their limits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.protection.buffers import checked, doubles
from swarmd.protection.constraints import ConstraintRows
from swarmd.protection.outline import CHUNK

if TYPE_CHECKING:  # Cython reads this import, CPython the other one
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import INFINITY
else:
    from swarmd.core.cython_shadow import INFINITY

TOLERANCE = cython.declare(cython.double, 1e-12)
"""By how much rounding may violate a constraint."""


@cython.final
@cython.cclass
class Projection:
    """A polygon of feasible speeds, and its point nearest to a requested point."""

    x: cython.double  # the nearest point
    y: cython.double
    # The corners of the polygon, `_sides` of them, and those of a polygon clipped from it.
    _sides: cython.Py_ssize_t
    _corner_x: cython.double[::1]
    _corner_y: cython.double[::1]
    _clipped_x: cython.double[::1]
    _clipped_y: cython.double[::1]
    _excess: cython.double[64]  # by which the point violates each row of a chunk

    def __init__(self) -> None:
        self._corner_x, self._corner_y = doubles(64), doubles(64)
        self._clipped_x, self._clipped_y = doubles(64), doubles(64)

    def check_indices(self) -> None:
        """ValueError unless the corners are within each array."""
        if not 0 <= self._sides <= min(len(self._corner_x), len(self._corner_y)):
            raise ValueError(f"a polygon of {self._sides} sides in {len(self._corner_x)}")

    @cython.cfunc
    @cython.exceptval(-1)
    def project(self, rows: ConstraintRows, x: cython.double, y: cython.double) -> cython.int:
        """Set `x`, `y` to the feasible point nearest to the requested point x, y. Exact.

        The axes are the two speeds over their limits, so both speeds weigh alike. The loop begins
        with the box of the limits. Each round clips the polygon by the constraint (row) that the
        nearest point violates most. Once the nearest point violates no constraint, it is the
        nearest within all constraints. Each polygon contains the origin.
        """
        i: cython.Py_ssize_t
        n: cython.Py_ssize_t = rows.all
        first: cython.Py_ssize_t
        worst: cython.Py_ssize_t
        self._begin_with_box()
        row_x: cython.p_double = checked(rows.x, n)
        row_y: cython.p_double = checked(rows.y, n)
        row_cap: cython.p_double = checked(rows.cap, n)
        excess: cython.p_double = self._excess
        self._find_nearest(x, y)
        for _ in range(n):
            worst = 0
            most: cython.double = -INFINITY
            px: cython.double = self.x
            py: cython.double = self.y
            first = 0
            while first < n:
                count: cython.Py_ssize_t = min(CHUNK, n - first)
                for i in range(count):
                    excess[i] = row_x[first + i] * px + row_y[first + i] * py - row_cap[first + i]
                for i in range(count):
                    if not (excess[i] <= most):
                        most, worst = excess[i], first + i
                        if most != most:
                            break
                if most != most:
                    break
                first += count
            if most <= TOLERANCE:
                break
            self._clip(row_x[worst], row_y[worst], row_cap[worst])
            self._find_nearest(x, y)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _begin_with_box(self) -> cython.int:
        """Take the box of the limits as the polygon."""
        self._corner_x[0] = self._corner_x[1] = self._corner_y[1] = self._corner_y[2] = 1.0
        self._corner_x[2] = self._corner_x[3] = self._corner_y[0] = self._corner_y[3] = -1.0
        self._sides = 4
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _clip(self, a: cython.double, b: cython.double, cap: cython.double) -> cython.int:
        """Cut off the part of the polygon where a x + b y > cap (Sutherland and Hodgman 1974)."""
        if len(self._clipped_x) < 2 * self._sides:
            self._clipped_x, self._clipped_y = doubles(4 * self._sides), doubles(4 * self._sides)
        i: cython.Py_ssize_t
        kept: cython.Py_ssize_t = 0
        x0: cython.double = self._corner_x[self._sides - 1]
        y0: cython.double = self._corner_y[self._sides - 1]
        over0: cython.double = a * x0 + b * y0 - cap
        for i in range(self._sides):
            x1: cython.double = self._corner_x[i]
            y1: cython.double = self._corner_y[i]
            over1: cython.double = a * x1 + b * y1 - cap
            if (over0 > 0.0) != (over1 > 0.0):
                share: cython.double = over0 / (over0 - over1)
                self._clipped_x[kept] = x0 + share * (x1 - x0)
                self._clipped_y[kept] = y0 + share * (y1 - y0)
                kept += 1
            if over1 <= 0.0:
                self._clipped_x[kept], self._clipped_y[kept] = x1, y1
                kept += 1
            x0, y0, over0 = x1, y1, over1
        if kept == 0:
            self._clipped_x[0] = self._clipped_y[0] = 0.0
            kept = 1
        self._sides = kept
        self._corner_x, self._clipped_x = self._clipped_x, self._corner_x
        self._corner_y, self._clipped_y = self._clipped_y, self._corner_y
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _find_nearest(self, x: cython.double, y: cython.double) -> cython.int:
        """Set `x`, `y` to the point of the polygon nearest to a requested point.

        The polygon may have shrunk to a line or a point; then no requested point is inside.
        """
        i: cython.Py_ssize_t
        best_x: cython.double = 0.0
        best_y: cython.double = 0.0
        best: cython.double = INFINITY  # square of the distance
        is_inside: cython.bint = True
        x0: cython.double = self._corner_x[self._sides - 1]
        y0: cython.double = self._corner_y[self._sides - 1]
        for i in range(self._sides):
            x1: cython.double = self._corner_x[i]
            y1: cython.double = self._corner_y[i]
            dx: cython.double = x1 - x0
            dy: cython.double = y1 - y0
            px: cython.double = x - x0
            py: cython.double = y - y0
            if dx * py - dy * px <= 0.0:
                is_inside = False
            square: cython.double = dx * dx + dy * dy
            share: cython.double = (px * dx + py * dy) / square if square > 0.0 else 0.0
            if share < 0.0:
                share = 0.0
            if share > 1.0:
                share = 1.0
            on_x: cython.double = x0 + share * dx
            on_y: cython.double = y0 + share * dy
            away: cython.double = (x - on_x) * (x - on_x) + (y - on_y) * (y - on_y)
            if away < best:
                best_x, best_y, best = on_x, on_y, away
            x0, y0 = x1, y1
        if is_inside or best <= TOLERANCE * TOLERANCE:
            self.x, self.y = x, y
        else:
            self.x, self.y = best_x, best_y
        return 0


@cython.cfunc
@cython.exceptval(-1)
def is_feasible(rows: ConstraintRows, x: cython.double, y: cython.double) -> cython.int:
    """1 if a point violates no constraint."""
    i: cython.Py_ssize_t
    row_x: cython.p_double = checked(rows.x, rows.all)
    row_y: cython.p_double = checked(rows.y, rows.all)
    row_cap: cython.p_double = checked(rows.cap, rows.all)
    for i in range(rows.all):
        if not (row_x[i] * x + row_y[i] * y - row_cap[i] <= TOLERANCE):
            return 0
    return 1
