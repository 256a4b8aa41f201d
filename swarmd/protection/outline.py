"""The robot's outline in the kernel `barrier`: gaps from it to points.

Part of the library of barrier.py; footprint.py has the same distances for code in Python. Units: m,
s, rad, in the base frame.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.values import Platform
from swarmd.protection.buffers import maximum, view
from swarmd.protection.footprint import Footprint

if TYPE_CHECKING:  # Cython reads this import, CPython the other one
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import INFINITY, sqrt
else:
    from swarmd.core.cython_shadow import INFINITY, sqrt

CHUNK = cython.declare(cython.Py_ssize_t, 64)
"""Points of a chunk at most."""

_ON_OUTLINE = cython.declare(cython.double, 1e-9)  # m: the direction from the outline is rounding
_ALONG_EDGE = cython.declare(cython.double, 1e-12)  # approach of a ray that never leaves an edge


@cython.final
@cython.cclass
class Chunk:
    """Up to CHUNK points near the outline, and what is computed for each; `count` are in use.

    The arrays of C have a fixed length, so that the compiler vectorises the loops over them.
    """

    count: cython.Py_ssize_t
    # Place in m, m that must stay free around it, age in s, and radius in m of each point.
    x: cython.double[64]
    y: cython.double[64]
    free: cython.double[64]
    age: cython.double[64]
    radius: cython.double[64]
    # From `Outline.separate`: gap in m, unit vector from the outline to the point, lever in m of
    # the nearest place about the axle, and m by which the blind zone reaches beyond the outline.
    gap: cython.double[64]
    normal_x: cython.double[64]
    normal_y: cython.double[64]
    lever: cython.double[64]
    hidden: cython.double[64]
    # The cap in m/s on the speed at which the nearest place closes on each point.
    cap: cython.double[64]
    # Results so far in loops over edges and corners; see `_find_nearest_edges`.
    least: cython.double[64]
    highest: cython.double[64]
    far: cython.double[64]
    high: cython.double[64]
    edge_x: cython.double[64]
    edge_y: cython.double[64]
    foot_x: cython.double[64]
    foot_y: cython.double[64]
    # A constraint of each point, before those that bind are chosen.
    row_x: cython.double[64]
    row_y: cython.double[64]
    row_cap: cython.double[64]
    row_gap: cython.double[64]

    def check_indices(self) -> None:
        """ValueError unless `count` is within the arrays."""
        if not 0 <= self.count <= CHUNK:
            raise ValueError(f"{self.count} points in a chunk of {CHUNK}")


@cython.final
@cython.cclass
class Outline:
    """The convex outline of one robot, with the place of its lidar."""

    corners: object  # (k, 2), counter-clockwise
    edges: cython.Py_ssize_t  # k
    corner_x: cython.double[::1]
    corner_y: cython.double[::1]
    # (2k,) the direction of each edge, then its outward normal; and where each edge begins on it.
    axis_x: cython.double[::1]
    axis_y: cython.double[::1]
    origin: cython.double[::1]
    length: cython.double[::1]  # (k,) of each edge
    is_box: cython.bint  # a rectangle along the axes, between these places
    front: cython.double
    rear: cython.double
    left: cython.double
    right: cython.double
    radius: cython.double  # from the axle to the outermost corner
    # The lidar, and the radii of the circles around it within and about the outline.
    lidar_x: cython.double
    lidar_y: cython.double
    inner: cython.double
    outer: cython.double

    def __init__(self, platform: Platform) -> None:
        footprint = Footprint(platform.footprint)
        self.corners = corners = footprint.corners
        self.edges = len(corners)
        self.corner_x, self.corner_y = (view(column) for column in corners.T)
        self.axis_x, self.axis_y = (view(column) for column in footprint.axes.T)
        self.origin, self.length = view(footprint.origins), view(footprint.lengths)
        self.rear, self.right = corners.min(axis=0)
        self.front, self.left = corners.max(axis=0)
        is_along_axes = np.isin(footprint.axes, (-1.0, 0.0, 1.0)).all()
        self.is_box = self.edges == 4 and bool(is_along_axes)
        self.radius = float(np.hypot(*platform.footprint.T).max())
        self.lidar_x, self.lidar_y = platform.scan.offset
        self.inner, self.outer = footprint.circles(platform.scan.offset)

    def check_indices(self) -> None:
        """ValueError unless the number of edges is that of the arrays."""
        if not 0 <= self.edges <= min(len(self.corner_x), len(self.length)):
            raise ValueError(f"{self.edges} edges of {len(self.corner_x)} corners")

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def gap_of(self, x: cython.double, y: cython.double) -> cython.double:
        """The distance in m from the outline to a point; 0 for a point inside.

        A rectangle along the axes needs fewer operations; its result differs by 1e-16.
        """
        k: cython.Py_ssize_t
        edges: cython.Py_ssize_t = self.edges
        least: cython.double = INFINITY
        if self.is_box and x == x and y == y:
            ahead: cython.double = x - self.front if x > self.front else self.rear - x
            aside: cython.double = y - self.left if y > self.left else self.right - y
            ahead = ahead if ahead > 0.0 else 0.0
            aside = aside if aside > 0.0 else 0.0
            return sqrt(aside * aside + ahead * ahead)
        for k in range(edges):
            above: cython.double = (
                self.axis_x[edges + k] * x + self.axis_y[edges + k] * y - self.origin[edges + k]
            )
            if above <= 0.0:
                continue
            along: cython.double = self.axis_x[k] * x + self.axis_y[k] * y - self.origin[k]
            beyond: cython.double = 0.0
            if along < 0.0:
                beyond = along
            elif along > self.length[k]:
                beyond = along - self.length[k]
            square: cython.double = beyond * beyond + above * above
            if square < least or square != square:
                least = square
        return 0.0 if least == INFINITY else sqrt(least)

    @cython.cfunc
    @cython.exceptval(-1)
    def separate(self, chunk: Chunk, blind: cython.double) -> cython.int:
        """Set gap, direction, lever and hidden gap of the points of a chunk.

        The hidden gap is how far the blind zone, a circle of `blind` m around the lidar, reaches
        beyond the outline on the shortest line from the outline to the point. An obstacle with a
        return at the point may extend unseen into the blind zone, but not beyond it.
        """
        self._find_nearest_edges(chunk)
        j: cython.Py_ssize_t
        x: cython.p_double = chunk.x
        y: cython.p_double = chunk.y
        least: cython.p_double = chunk.least
        highest: cython.p_double = chunk.highest
        far: cython.p_double = chunk.far
        high: cython.p_double = chunk.high
        edge_x: cython.p_double = chunk.edge_x
        edge_y: cython.p_double = chunk.edge_y
        foot_x: cython.p_double = chunk.foot_x
        foot_y: cython.p_double = chunk.foot_y
        to_gap: cython.p_double = chunk.gap
        to_nx: cython.p_double = chunk.normal_x
        to_ny: cython.p_double = chunk.normal_y
        to_lever: cython.p_double = chunk.lever
        to_hidden: cython.p_double = chunk.hidden
        lidar_x: cython.double = self.lidar_x
        lidar_y: cython.double = self.lidar_y
        for j in range(chunk.count):
            is_inside: cython.bint = (highest[j] <= 0.0) & (least[j] == least[j])
            gap: cython.double = sqrt(least[j])
            gap = 0.0 if is_inside else gap
            is_on: cython.bint = gap < _ON_OUTLINE
            inverse: cython.double = 1.0 / (1.0 if is_on else gap)
            out: cython.double = far[j] * inverse
            up: cython.double = high[j] * inverse
            out = 0.0 if is_on else out
            up = 1.0 if is_on else up
            nx: cython.double = out * edge_x[j] + up * edge_y[j]
            ny: cython.double = out * edge_y[j] - up * edge_x[j]
            dx: cython.double = x[j] - lidar_x
            dy: cython.double = y[j] - lidar_y
            across: cython.double = dx * ny - dy * nx
            half: cython.double = blind * blind - across * across  # square of half of the chord
            hidden: cython.double = sqrt(half) - (dx * nx + dy * ny - gap)
            hidden = hidden if (half > 0.0) & (hidden > 0.0) else 0.0
            to_gap[j], to_hidden[j] = gap, hidden
            to_nx[j], to_ny[j] = nx, ny
            to_lever[j] = foot_x[j] * ny - foot_y[j] * nx
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _find_nearest_edges(self, chunk: Chunk) -> cython.int:
        """Find the place of the outline nearest to each point of a chunk (`foot_x`, `foot_y`).

        `least` is the square of the distance. `far` and `high` are the components of the distance
        along and perpendicular to the nearest edge. `highest` is the greatest signed distance from
        the line of any edge; a point inside the outline has none above 0.
        """
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        count: cython.Py_ssize_t = chunk.count
        x: cython.p_double = chunk.x
        y: cython.p_double = chunk.y
        least: cython.p_double = chunk.least
        highest: cython.p_double = chunk.highest
        far: cython.p_double = chunk.far
        high: cython.p_double = chunk.high
        edge_x: cython.p_double = chunk.edge_x
        edge_y: cython.p_double = chunk.edge_y
        foot_x: cython.p_double = chunk.foot_x
        foot_y: cython.p_double = chunk.foot_y
        for j in range(count):
            least[j], highest[j], far[j], high[j] = INFINITY, -INFINITY, 0.0, 0.0
            edge_x[j] = edge_y[j] = foot_x[j] = foot_y[j] = 0.0
        for k in range(self.edges):
            ax: cython.double = self.axis_x[k]
            ay: cython.double = self.axis_y[k]
            bx: cython.double = self.axis_x[self.edges + k]
            by: cython.double = self.axis_y[self.edges + k]
            start: cython.double = self.origin[k]
            base: cython.double = self.origin[self.edges + k]
            length: cython.double = self.length[k]
            corner_x: cython.double = self.corner_x[k]
            corner_y: cython.double = self.corner_y[k]
            for j in range(count):
                along: cython.double = ax * x[j] + ay * y[j] - start
                above: cython.double = bx * x[j] + by * y[j] - base
                on: cython.double = along if along > 0.0 else 0.0
                on = length if on > length else on
                beyond: cython.double = along - on
                square: cython.double = beyond * beyond + above * above
                is_nearer: cython.bint = (square < least[j]) | (square != square)
                # A choice between values that are known before is one that a compiler vectorises.
                was_far: cython.double = far[j]
                was_high: cython.double = high[j]
                was_edge_x: cython.double = edge_x[j]
                was_edge_y: cython.double = edge_y[j]
                was_foot_x: cython.double = foot_x[j]
                was_foot_y: cython.double = foot_y[j]
                was_least: cython.double = least[j]
                was_highest: cython.double = highest[j]
                far[j] = beyond if is_nearer else was_far
                high[j] = above if is_nearer else was_high
                edge_x[j] = ax if is_nearer else was_edge_x
                edge_y[j] = ay if is_nearer else was_edge_y
                foot_x[j] = corner_x + on * ax if is_nearer else was_foot_x
                foot_y[j] = corner_y + on * ay if is_nearer else was_foot_y
                least[j] = square if is_nearer else was_least
                highest[j] = above if above > was_highest else was_highest
        return 0

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def along_ray(self, ray_x: cython.double, ray_y: cython.double) -> cython.double:
        """m from the lidar to the outline along a ray; 0 if the lidar is outside the outline."""
        k: cython.Py_ssize_t
        least: cython.double = INFINITY
        for k in range(self.edges, 2 * self.edges):
            approach: cython.double = ray_x * self.axis_x[k] + ray_y * self.axis_y[k]
            if approach > _ALONG_EDGE:
                height: cython.double = self.origin[k] - (
                    self.axis_x[k] * self.lidar_x + self.axis_y[k] * self.lidar_y
                )
                if height / approach < least:
                    least = height / approach
        return maximum(least, 0.0)

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def nearest_within(self, nearest: cython.double, range_min: cython.double) -> cython.double:
        """The greatest range in m that the return nearest to the outline can have.

        `nearest` in m is the least range of the scan. The outline lies between two circles around
        the lidar, so the return of the least range need not be the nearest to the outline. -inf
        without a measured return.
        """
        if nearest == INFINITY or nearest == -INFINITY:
            return -INFINITY
        nearest = nearest if nearest > range_min else range_min
        return maximum(nearest - self.inner, 0.0) + self.outer
