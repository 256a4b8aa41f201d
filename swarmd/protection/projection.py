"""The command nearest to a requested one within half-planes: exact, for two variables.

The axes of the plane are the two speeds, each divided by its limit, so that "nearest" weighs them
alike. A polygon is a list of its corners, counter-clockwise. Each polygon contains the origin, the
zero command.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from swarmd.core.values import Array

Point = tuple[float, float]

TOLERANCE = 1e-12
"""By how much rounding may violate a constraint."""

BINDING_TOLERANCE = 1e-9
"""How near a constraint that counts as tight is to the point."""


def nearest_feasible(
    requested: Point, polygon: Sequence[Point], normals: Array, caps: Array
) -> tuple[Point, list[int]]:
    """The point nearest to `requested` in the polygon with normals @ point <= caps.

    Returns the point and the indices of the tight constraints, those that it lies on. `normals`
    (k, 2); `caps` (k,) are at least 0, so that the origin is feasible. The loop adds the most
    violated constraint each time: a point that is nearest within some of the constraints and
    violates no other is nearest within all.
    """
    point = nearest(polygon, requested)
    for _ in range(len(caps)):
        excess = _excess(point, normals, caps)
        worst = int(excess.argmax())
        if excess[worst] <= TOLERANCE:
            break
        a, b = normals[worst]
        polygon = clipped(polygon, float(a), float(b), float(caps[worst]))
        point = nearest(polygon, requested)
    if not len(caps):
        return point, []
    tight = np.flatnonzero(_excess(point, normals, caps) >= -BINDING_TOLERANCE)
    return point, tight.tolist()


def _excess(point: Point, normals: Array, caps: Array) -> Array:
    """(k,) by how much a point violates each constraint."""
    excess: Array = normals[:, 0] * point[0] + normals[:, 1] * point[1] - caps
    return excess


def clipped(polygon: Sequence[Point], a: float, b: float, cap: float) -> list[Point]:
    """The part of a convex polygon where a x + b y <= cap (Sutherland and Hodgman 1974)."""
    kept: list[Point] = []
    x0, y0 = polygon[-1]
    over0 = a * x0 + b * y0 - cap
    for x1, y1 in polygon:
        over1 = a * x1 + b * y1 - cap
        if (over0 > 0.0) != (over1 > 0.0):
            share = over0 / (over0 - over1)
            kept.append((x0 + share * (x1 - x0), y0 + share * (y1 - y0)))
        if over1 <= 0.0:
            kept.append((x1, y1))
        x0, y0, over0 = x1, y1, over1
    return kept or [(0.0, 0.0)]


def nearest(polygon: Sequence[Point], requested: Point) -> Point:
    """The point of a convex polygon nearest to `requested`: itself if it is inside.

    A degenerate polygon (a line or a point) has no inside.
    """
    x, y = requested
    best, best_square = (0.0, 0.0), math.inf
    is_inside = True
    x0, y0 = polygon[-1]
    for x1, y1 in polygon:
        dx, dy = x1 - x0, y1 - y0
        px, py = x - x0, y - y0
        if dx * py - dy * px <= 0.0:
            is_inside = False
        square = dx * dx + dy * dy
        share = (px * dx + py * dy) / square if square > 0.0 else 0.0
        share = min(max(share, 0.0), 1.0)
        on_x, on_y = x0 + share * dx, y0 + share * dy
        away = (x - on_x) * (x - on_x) + (y - on_y) * (y - on_y)
        if away < best_square:
            best, best_square = (on_x, on_y), away
        x0, y0 = x1, y1
    return requested if is_inside or best_square <= TOLERANCE * TOLERANCE else best
