"""Half-planes of velocities without collision (ORCA), and the nearest velocity within all. Pure.

A track (moving object) or a wall forbids a half-plane of velocities (optimal reciprocal collision
avoidance, ORCA: van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance", ISRR
2009). A linear programme in two variables finds the permitted velocity nearest to a requested one
(de Berg et al., "Computational geometry", chapter 4).

A kernel (see `core/kernels.py`), since each decision passes it. avoidance.py calls it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import INFINITY, fabs, hypot, sqrt
else:
    from swarmd.core.cython_shadow import INFINITY, fabs, hypot, sqrt

_EPSILON = cython.declare(cython.double, 1e-9)


@cython.final
@cython.cclass
class Line:
    """Velocities to the left of the direction `dx`, `dy` through the point `x`, `y` are allowed."""

    x = cython.declare(cython.double, visibility="readonly")
    y = cython.declare(cython.double, visibility="readonly")
    dx = cython.declare(cython.double, visibility="readonly")
    dy = cython.declare(cython.double, visibility="readonly")

    def __init__(
        self, x: cython.double, y: cython.double, dx: cython.double, dy: cython.double
    ) -> None:
        self.x, self.y, self.dx, self.dy = x, y, dx, dy


@cython.ccall
def excess(line: Line, x: cython.double, y: cython.double) -> cython.double:
    """By how much the velocity violates a line, in m/s; at most 0 if it does not."""
    return line.dx * (line.y - y) - line.dy * (line.x - x)


@cython.ccall
def line_of(
    px: cython.double,
    py: cython.double,
    vx: cython.double,
    vy: cython.double,
    own_x: cython.double,
    own_y: cython.double,
    radius: cython.double,
    share: cython.double,
    horizon: cython.double,
) -> Line:
    """The border of the velocities that keep `radius` m away from a place for `horizon` s.

    Args:
        px, py: the place in m.
        vx, vy: the present velocity of the robot relative to the place in m/s.
        own_x, own_y: the present velocity of the robot in m/s.
        radius: m.
        share: the share of the necessary change of velocity that this robot makes.
        horizon: s.
    """
    square: cython.double = max(px * px + py * py, _EPSILON)
    # A robot nearer than `radius` may pass aside, and need not move away.
    radius = min(radius, max(sqrt(square) - 1e-3, 1e-3))
    wx: cython.double = vx - px / horizon
    wy: cython.double = vy - py / horizon
    length: cython.double = hypot(wx, wy)
    along: cython.double = wx * px + wy * py
    dx: cython.double
    dy: cython.double
    ux: cython.double
    uy: cython.double
    # The velocity obstacle is a cone with a round cap. Project the velocity on the cap, else on the
    # nearer leg of the cone.
    if along < 0.0 and along * along > radius * radius * length * length:
        nx: cython.double = wx / max(length, _EPSILON)
        ny: cython.double = wy / max(length, _EPSILON)
        off: cython.double = radius / horizon - length
        dx, dy, ux, uy = ny, -nx, off * nx, off * ny
    else:
        leg: cython.double = sqrt(max(square - radius * radius, 0.0))
        if px * wy - py * wx > 0.0:
            dx, dy = (px * leg - py * radius) / square, (px * radius + py * leg) / square
        else:
            dx, dy = -(px * leg + py * radius) / square, -(py * leg - px * radius) / square
        way: cython.double = vx * dx + vy * dy
        ux, uy = way * dx - vx, way * dy - vy
    return Line(own_x + share * ux, own_y + share * uy, dx, dy)


@cython.cfunc
def _rows(places):
    """Places (k, 2) as the kernel reads them: in CPython a memoryview, faster than an array."""
    places = np.ascontiguousarray(places, np.float64)
    return places if cython.compiled else memoryview(places)


def wall_lines(
    walls,
    lead: cython.double,
    own_x: cython.double,
    own_y: cython.double,
    radius: cython.double,
    reach: cython.double,
    horizon: cython.double,
) -> list:
    """A line for each place of `walls` (k, 2) within `reach` m of a point `lead` m ahead."""
    i: cython.Py_ssize_t
    places: cython.double[:, ::1] = _rows(walls)
    lines: list = []
    for i in range(len(places)):
        x: cython.double = places[i, 0] - lead
        y: cython.double = places[i, 1]
        if x * x + y * y < reach * reach:
            lines.append(line_of(x, y, own_x, own_y, own_x, own_y, radius, 1.0, horizon))
    return lines


def track_lines(
    tracks: tuple,
    lead: cython.double,
    own_x: cython.double,
    own_y: cython.double,
    radius: cython.double,
    share: cython.double,
    stands: cython.double,
    horizon: cython.double,
) -> list:
    """A line for each track, for a point `lead` m ahead.

    The robot makes a `share` of the change of velocity for an object that moves, and the whole
    change for an object slower than `stands` m/s. `radius` in m is that of the robot alone.
    """
    lines: list = []
    for track in tracks:
        x: cython.double = track.x
        y: cython.double = track.y
        vx: cython.double = track.vx
        vy: cython.double = track.vy
        wide: cython.double = track.radius
        part: cython.double = 1.0 if hypot(vx, vy) < stands else share
        vx, vy, wide = own_x - vx, own_y - vy, radius + wide
        lines.append(line_of(x - lead, y, vx, vy, own_x, own_y, wide, part, horizon))
    return lines


def most_violated(
    lines: list, first: cython.Py_ssize_t, x: cython.double, y: cython.double
) -> cython.Py_ssize_t:
    """The index of the line, from `first` on, that a velocity violates most; -1 without one."""
    i: cython.Py_ssize_t
    worst: cython.Py_ssize_t = -1
    most: cython.double = 0.0
    for i in range(first, len(lines)):
        by: cython.double = excess(lines[i], x, y)
        if by > most:
            worst, most = i, by
    return worst


def width_between(
    walls, first: cython.double, last: cython.double, widest: cython.double
) -> cython.double:
    """The least distance in m between a place of a wall to the left and one to the right.

    Only places from `first` to `last` m ahead and within `widest` m to the side count. inf without
    places on both sides.
    """
    i: cython.Py_ssize_t
    k: cython.Py_ssize_t
    places: cython.double[:, ::1] = _rows(walls)
    near: list = []
    least: cython.double = INFINITY
    for i in range(len(places)):
        x: cython.double = places[i, 0]
        y: cython.double = places[i, 1]
        if first < x < last and fabs(y) < widest:
            near.append(i)
    for i in near:
        if places[i, 1] > 0.0:
            for k in near:
                if places[k, 1] <= 0.0:
                    dx: cython.double = places[i, 0] - places[k, 0]
                    dy: cython.double = places[i, 1] - places[k, 1]
                    least = min(least, hypot(dx, dy))
    return least


def nearest(
    lines: list, fixed: cython.Py_ssize_t, x: cython.double, y: cython.double, most: cython.double
) -> tuple:
    """The velocity nearest to `x`, `y` that keeps all lines and is at most `most` m/s fast.

    If no velocity keeps all lines: the velocity that keeps the first `fixed` lines and minimises
    the greatest violation of the others.
    """
    programme: _Programme = _Programme()
    programme.most = most
    failed: cython.Py_ssize_t = programme.solve(lines, x, y, False)
    if failed < len(lines):
        programme.relax(lines, fixed, failed)
    return programme.x, programme.y


@cython.final
@cython.cclass
class _Programme:
    """A linear programme: the velocity `x`, `y` within lines and a circle of radius `most`."""

    most: cython.double
    x: cython.double
    y: cython.double

    @cython.cfunc
    def solve(
        self, lines: list, x: cython.double, y: cython.double, is_direction: cython.bint
    ) -> cython.Py_ssize_t:
        """Set the best velocity; the result is the number of lines that it keeps, in order.

        The best velocity is the nearest to `x`, `y`; or, if `is_direction`, the farthest in the
        direction of the unit vector `x`, `y`.
        """
        i: cython.Py_ssize_t
        line: Line
        most: cython.double = self.most
        length: cython.double = hypot(x, y)
        if is_direction:
            self.x, self.y = x * most, y * most
        elif length > most:
            self.x, self.y = x * most / length, y * most / length
        else:
            self.x, self.y = x, y
        for i in range(len(lines)):
            line = lines[i]
            if excess(line, self.x, self.y) > 0.0 and not self._place(lines, i, x, y, is_direction):
                return i
        return len(lines)

    @cython.cfunc
    def _place(
        self,
        lines: list,
        count: cython.Py_ssize_t,
        x: cython.double,
        y: cython.double,
        is_direction: cython.bint,
    ) -> cython.bint:
        """Set the best velocity on line `count` that keeps all lines before; False without one."""
        i: cython.Py_ssize_t
        line: Line = lines[count]
        before: Line
        along: cython.double = line.x * line.dx + line.y * line.dy
        inside: cython.double = along * along + self.most * self.most
        inside = inside - line.x * line.x - line.y * line.y
        if inside < 0.0:
            return False
        half: cython.double = sqrt(inside)
        low: cython.double = -along - half
        high: cython.double = -along + half
        for i in range(count):
            before = lines[i]
            cross: cython.double = line.dx * before.dy - line.dy * before.dx
            above: cython.double = before.dx * (line.y - before.y) - before.dy * (line.x - before.x)
            if fabs(cross) <= _EPSILON:
                if above < 0.0:
                    return False
                continue
            if cross >= 0.0:
                high = min(high, above / cross)
            else:
                low = max(low, above / cross)
            if low > high:
                return False
        best: cython.double
        if is_direction:
            best = high if x * line.dx + y * line.dy > 0.0 else low
        else:
            best = min(max(line.dx * (x - line.x) + line.dy * (y - line.y), low), high)
        self.x, self.y = line.x + best * line.dx, line.y + best * line.dy
        return True

    @cython.cfunc
    def relax(self, lines: list, fixed: cython.Py_ssize_t, begin: cython.Py_ssize_t) -> cython.int:
        """Set the velocity that minimises the greatest violation of the lines from `fixed` on.

        The velocity keeps the first `fixed` lines. `begin` is the first line that is not kept.
        """
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        line: Line
        before: Line
        worst: cython.double = 0.0
        for i in range(begin, len(lines)):
            line = lines[i]
            if excess(line, self.x, self.y) <= worst:
                continue
            projected: list = lines[:fixed]
            for k in range(fixed, i):
                before = lines[k]
                cross: cython.double = line.dx * before.dy - line.dy * before.dx
                x: cython.double
                y: cython.double
                if fabs(cross) <= _EPSILON:
                    if line.dx * before.dx + line.dy * before.dy > 0.0:
                        continue
                    x, y = 0.5 * (line.x + before.x), 0.5 * (line.y + before.y)
                else:
                    at: cython.double = before.dx * (line.y - before.y)
                    at = (at - before.dy * (line.x - before.x)) / cross
                    x, y = line.x + at * line.dx, line.y + at * line.dy
                dx: cython.double = before.dx - line.dx
                dy: cython.double = before.dy - line.dy
                length: cython.double = max(hypot(dx, dy), _EPSILON)
                projected.append(Line(x, y, dx / length, dy / length))
            before_x: cython.double = self.x
            before_y: cython.double = self.y
            if self.solve(projected, -line.dy, line.dx, True) < len(projected):
                self.x, self.y = before_x, before_y
            worst = excess(line, self.x, self.y)
        return 0
