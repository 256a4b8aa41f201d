"""The robot's outline in the kernel `barrier`: gaps from it to points.

Part of the unit of barrier.py; footprint.py has the same distances for code in Python. Units: m,
s, rad, in the base frame.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import checked, view
from swarmd.core.cython_shadow import INFINITY, Doubles, cos, sin, sqrt
from swarmd.core.values import Platform
from swarmd.robot.protection.comparisons import maximum
from swarmd.robot.protection.footprint import Footprint

if TYPE_CHECKING:
    from swarmd.core.values import Array, Scan

CHUNK = 64
"""Points of a chunk at most."""

_ON_OUTLINE = 1e-9  # m: the direction from the outline is rounding
_ALONG_EDGE = 1e-12  # approach of a ray that never leaves an edge


@cython.cclass
class Chunk:
    """Up to CHUNK points near the outline, and what is computed for each; `count` are in use.

    The arrays of C have a fixed length, so that the compiler vectorises the loops over them.
    """

    count: int
    # Of each point: place in m, distance in m that must stay free around the point, age in s,
    # radius in m, and m/s at which the obstacle may approach.
    x: cython.double[64]
    y: cython.double[64]
    free: cython.double[64]
    age: cython.double[64]
    radius: cython.double[64]
    others: cython.double[64]
    kind: cython.longlong[64]
    # From `Outline.separate`: gap in m, unit vector from the outline to the point, lever in m of
    # the nearest place about the axle, and m by which the blind zone reaches beyond the outline.
    gap: cython.double[64]
    normal_x: cython.double[64]
    normal_y: cython.double[64]
    lever: cython.double[64]
    hidden: cython.double[64]
    # The cap in m/s on the speed at which the nearest place closes on each point.
    cap: cython.double[64]
    # Results so far in loops over edges; see `_find_nearest_edges`.
    nearest_square: cython.double[64]
    greatest_height: cython.double[64]
    edge_number: cython.double[64]
    along_edge: cython.double[64]
    above_edge: cython.double[64]
    edge_x: cython.double[64]
    edge_y: cython.double[64]
    foot_x: cython.double[64]
    foot_y: cython.double[64]
    # For the side constraints of constraints.py: the unit vector of a side direction, how far in m
    # the foremost corner is in this direction, and the lever in m of this corner.
    side_x: cython.double[64]
    side_y: cython.double[64]
    foremost: cython.double[64]
    side_lever: cython.double[64]
    # A constraint of each point, before those that bind are chosen.
    row_x: cython.double[64]
    row_y: cython.double[64]
    row_cap: cython.double[64]
    row_gap: cython.double[64]

    def check_indices(self) -> None:
        """ValueError unless `count` is within the arrays."""
        if not 0 <= self.count <= CHUNK:
            raise ValueError(f"{self.count} points in a chunk of {CHUNK}")


@cython.cclass
class Outline:
    """The convex outline of one robot, with the place of its lidar."""

    corners: Array  # (k, 2), counter-clockwise
    edges: int  # k
    corner_x: Doubles
    corner_y: Doubles
    # (2k,) unit vectors: the directions of the k edges, then their k outward normals. `origin`:
    # the place in m of the first corner of the edge along each of these vectors.
    axis_x: Doubles
    axis_y: Doubles
    origin: Doubles
    length: Doubles  # (k,) of each edge
    is_box: bool  # a rectangle along the axes, between these places
    front: float
    rear: float
    left: float
    right: float
    radius: float  # from the axle to the outermost corner
    # The lidar, and the radii of the circles around it within and about the outline.
    lidar_x: float
    lidar_y: float
    inner: float
    outer: float

    def __init__(self, platform: Platform) -> None:
        footprint = Footprint(platform.footprint)
        self.corners = footprint.corners
        corners = footprint.corners
        self.edges = len(corners)
        self.corner_x, self.corner_y = (view(column) for column in corners.T)
        self.axis_x, self.axis_y = (view(column) for column in footprint.axes.T)
        self.origin = view(footprint.origins)
        self.length = view(footprint.lengths)
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

    def gap_of(self, x: float, y: float) -> float:
        """The distance in m from the outline to a point; 0 for a point inside.

        A rectangle along the axes (`is_box`) needs fewer operations; its result differs by 1e-16.
        """
        # A box, and a point that is not NaN: distances beyond front or rear, and a side.
        if self.is_box and x == x and y == y:
            ahead = x - self.front if x > self.front else self.rear - x
            aside = y - self.left if y > self.left else self.right - y
            ahead = ahead if ahead > 0.0 else 0.0
            aside = aside if aside > 0.0 else 0.0
            return sqrt(aside * aside + ahead * ahead)
        return self._gap_of_polygon(x, y)

    def min_gap(self, scan: Scan) -> float | None:
        """The gap in m to the nearest return of a scan; None without a return.

        A return too close to measure has the gap 0. Bit by bit the gap of `Footprint.nearest`, for
        modes that look at no return otherwise.
        """
        ranges: Doubles = view(scan.ranges)
        bearings: Doubles = view(scan.bearings)
        count = len(ranges)
        if len(bearings) != count:
            raise IndexError(f"{count} ranges, but {len(bearings)} bearings")
        range_min = scan.range_min
        least_range = INFINITY
        for i in range(count):
            if ranges[i] < least_range:
                least_range = ranges[i]
        if least_range == INFINITY:
            return None
        if least_range == -INFINITY:
            return 0.0
        farthest = self.nearest_within(least_range, range_min)
        least_gap = INFINITY
        for i in range(count):
            if ranges[i] <= farthest:
                distance = ranges[i] if ranges[i] > range_min else range_min
                x = self.lidar_x + distance * cos(bearings[i])
                y = self.lidar_y + distance * sin(bearings[i])
                gap = self._gap_of_polygon(x, y)
                if gap < least_gap:
                    least_gap = gap
        return least_gap

    def _gap_of_polygon(self, x: float, y: float) -> float:
        """The least distance in m to the edges that have the point on their outer side."""
        edges = self.edges
        least_square = INFINITY
        # `beyond_end` in m: how far the point is beyond an end of the edge.
        for k in range(edges):
            above_edge = (
                self.axis_x[edges + k] * x + self.axis_y[edges + k] * y - self.origin[edges + k]
            )
            if above_edge <= 0.0:
                continue
            along_edge = self.axis_x[k] * x + self.axis_y[k] * y - self.origin[k]
            beyond_end = 0.0
            if along_edge < 0.0:
                beyond_end = along_edge
            elif along_edge > self.length[k]:
                beyond_end = along_edge - self.length[k]
            square = beyond_end * beyond_end + above_edge * above_edge
            if square < least_square or square != square:  # a NaN of the point stays
                least_square = square
        return 0.0 if least_square == INFINITY else sqrt(least_square)

    def separate(self, chunk: Chunk, blind: float) -> None:
        """Set gap, direction, lever and hidden gap of each point of a chunk.

        - Gap: m from the nearest place of the outline to the point.
        - Direction: the unit vector from this place to the point.
        - Lever: m, the speed of this place in the direction for each rad/s of the angular speed.
        - Hidden gap: the m of the gap that lie in the blind zone, a circle of `blind` m around the
          lidar. An obstacle with a return at the point may extend unseen into this part.
        """
        self._find_nearest_edges(chunk)
        x = chunk.x
        y = chunk.y
        square = chunk.nearest_square
        height = chunk.greatest_height
        along_edge = chunk.along_edge
        above_edge = chunk.above_edge
        edge_x = chunk.edge_x
        edge_y = chunk.edge_y
        foot_x = chunk.foot_x
        foot_y = chunk.foot_y
        gaps = chunk.gap
        normals_x = chunk.normal_x
        normals_y = chunk.normal_y
        levers = chunk.lever
        hidden_gaps = chunk.hidden
        lidar_x = self.lidar_x
        lidar_y = self.lidar_y
        for j in range(chunk.count):
            # 1. The gap: 0 inside, NaN for a point that is NaN. (`&` is no branch, so the compiler
            # vectorises the loop.)
            is_number = square[j] == square[j]
            is_inside = (height[j] <= 0.0) & is_number
            gap = sqrt(square[j])
            gap = 0.0 if is_inside else gap

            # 2. The direction. For a point on the outline: the normal of the edge.
            is_on_outline = gap < _ON_OUTLINE
            inverse = 1.0 / (1.0 if is_on_outline else gap)
            along_share = along_edge[j] * inverse
            above_share = above_edge[j] * inverse
            along_share = 0.0 if is_on_outline else along_share
            above_share = 1.0 if is_on_outline else above_share
            nx = along_share * edge_x[j] + above_share * edge_y[j]
            ny = along_share * edge_y[j] - above_share * edge_x[j]

            # 3. The hidden gap: on the line in the direction from the outline to the point, the m
            # from the place where the line leaves the outline to the place where the line leaves
            # the blind zone. Both places are in m along the line, from the foot of the lidar on the
            # line. The line leaves the blind zone at half of the chord of the circle. The root is
            # NaN, and not used, if the line misses the circle.
            ray_x = x[j] - lidar_x
            ray_y = y[j] - lidar_y
            lidar_off_line = ray_x * ny - ray_y * nx
            half_chord_square = blind * blind - lidar_off_line * lidar_off_line
            end_of_blind_zone = sqrt(half_chord_square)
            end_of_outline = ray_x * nx + ray_y * ny - gap
            hidden = end_of_blind_zone - end_of_outline
            hidden = hidden if (half_chord_square > 0.0) & (hidden > 0.0) else 0.0

            # 4. Stores the results.
            gaps[j] = gap
            hidden_gaps[j] = hidden
            normals_x[j] = nx
            normals_y[j] = ny
            levers[j] = foot_x[j] * ny - foot_y[j] * nx

    def _find_nearest_edges(self, chunk: Chunk) -> None:
        """Find the place of the outline nearest to each point of a chunk.

        Sets the arrays of the chunk, for each point:

        - `foot_x`, `foot_y`: the nearest place in m; `edge_x`, `edge_y`: the direction of its edge.
        - `nearest_square`: the square of the distance to this place.
        - `along_edge`, `above_edge`: the components of this distance along and perpendicular to the
          edge.
        - `greatest_height`: the greatest signed distance from the line of any edge. For a point
          inside the outline this distance is not above 0.
        """
        count = chunk.count
        edges = self.edges
        x = chunk.x
        y = chunk.y
        nearest = chunk.nearest_square
        greatest_height = chunk.greatest_height
        edge_number = chunk.edge_number
        axis_x = checked(self.axis_x, 2 * edges)
        axis_y = checked(self.axis_y, 2 * edges)
        origin = checked(self.origin, 2 * edges)
        lengths = checked(self.length, edges)
        corner_x = checked(self.corner_x, edges)
        corner_y = checked(self.corner_y, edges)
        for j in range(count):
            nearest[j] = INFINITY
            greatest_height[j] = -INFINITY
            edge_number[j] = -1.0

        # 1. For each edge: finds the points that are nearer to this edge than to all edges before.
        # A point that is NaN is nearer to each edge.
        for k in range(edges):
            direction_x = axis_x[k]
            direction_y = axis_y[k]
            normal_x = axis_x[edges + k]
            normal_y = axis_y[edges + k]
            direction_origin = origin[k]
            normal_origin = origin[edges + k]
            length = lengths[k]
            number = k  # a double, as the squares: the compiler vectorises the loop
            for j in range(count):
                along = direction_x * x[j] + direction_y * y[j] - direction_origin
                above = normal_x * x[j] + normal_y * y[j] - normal_origin
                along_clamped = along if along > 0.0 else 0.0
                along_clamped = length if along_clamped > length else along_clamped
                beyond = along - along_clamped
                edge_square = beyond * beyond + above * above
                is_nearer = (edge_square < nearest[j]) | (edge_square != edge_square)
                # Plain choices between two known values: the compiler vectorises such a loop.
                previous_number = edge_number[j]
                previous_square = nearest[j]
                previous_height = greatest_height[j]
                edge_number[j] = number if is_nearer else previous_number
                nearest[j] = edge_square if is_nearer else previous_square
                greatest_height[j] = above if above > previous_height else previous_height

        # 2. The place on the nearest edge. A point at infinity is nearest to no edge, and gets 0.
        for j in range(count):
            if edge_number[j] < 0.0:
                chunk.along_edge[j] = 0.0
                chunk.above_edge[j] = 0.0
                chunk.edge_x[j] = 0.0
                chunk.edge_y[j] = 0.0
                chunk.foot_x[j] = 0.0
                chunk.foot_y[j] = 0.0
                continue
            k = cython.cast(cython.Py_ssize_t, edge_number[j])
            along = axis_x[k] * x[j] + axis_y[k] * y[j] - origin[k]
            above = axis_x[edges + k] * x[j] + axis_y[edges + k] * y[j] - origin[edges + k]
            along_clamped = along if along > 0.0 else 0.0
            along_clamped = lengths[k] if along_clamped > lengths[k] else along_clamped
            chunk.along_edge[j] = along - along_clamped
            chunk.above_edge[j] = above
            chunk.edge_x[j] = axis_x[k]
            chunk.edge_y[j] = axis_y[k]
            chunk.foot_x[j] = corner_x[k] + along_clamped * axis_x[k]
            chunk.foot_y[j] = corner_y[k] + along_clamped * axis_y[k]

    def along_ray(self, ray_x: float, ray_y: float) -> float:
        """m from the lidar to the outline along a ray; 0 if the lidar is outside the outline."""
        least = INFINITY
        for k in range(self.edges, 2 * self.edges):
            approach = ray_x * self.axis_x[k] + ray_y * self.axis_y[k]
            if approach > _ALONG_EDGE:
                height = self.origin[k] - (
                    self.axis_x[k] * self.lidar_x + self.axis_y[k] * self.lidar_y
                )
                if height / approach < least:
                    least = height / approach
        return maximum(least, 0.0)

    def nearest_within(self, nearest: float, range_min: float) -> float:
        """The greatest range in m that the return nearest to the outline can have.

        `nearest` in m is the least range of the scan. The outline lies between two circles around
        the lidar. So the return with the least range need not be the return nearest to the outline.
        The result is -inf if the scan has no return (no gap is known), or a return too close to
        measure (the gap is 0): then no range needs to be examined.
        """
        if nearest == INFINITY or nearest == -INFINITY:
            return -INFINITY
        nearest = nearest if nearest > range_min else range_min
        return maximum(nearest - self.inner, 0.0) + self.outer
