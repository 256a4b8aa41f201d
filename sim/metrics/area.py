"""How much floor a swarm has been at, and how much it spans. Only present robots count."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from swarmd.errors import ConfigError
from swarmd.sim.metrics.metric import Metric
from swarmd.sim.metrics.window import last, presence
from swarmd.sim.trace import Trace
from swarmd.sim.world.arena import parse_arena
from swarmd.values import Array

COVER = 0.5
"""A robot covers the floor within so many m of its axle."""
CELL = 0.1
"""Floor is counted in squares of so many m."""
_MANY_CELLS = 4_000_000


def covered_areas(trace: Trace, radius: float = COVER, cell: float = CELL) -> Array:
    """(T,) the floor in m2 that has been within `radius` m of a robot until each instant.

    Sweep coverage (Gage, Command Control for Many-Robot Systems, AUVS 1992) in squares of `cell` m,
    each counted by its centre, robots taken at the nearest one; walls do not shade, and what lies
    outside the arena does not count if the trace names its size. Squares are larger where the
    robots roam so far that there would be more than four million.
    """
    when, robot = np.nonzero(presence(trace))
    if len(when) == 0:
        return np.zeros(len(trace.t))
    place = trace.pose[when, robot, :2]
    while np.prod((np.ptp(place, axis=0) + 2.0 * radius) / cell + 3.0) > _MANY_CELLS:
        cell *= 2.0
    index = np.floor(place / cell).astype(np.int64)
    margin = math.ceil(radius / cell)
    low = index.min(axis=0) - margin
    shape = index.max(axis=0) + margin + 1 - low
    # Rows are in order of time, and unique gives the first of each: when a robot first came there.
    index, first = np.unique(index - low, axis=0, return_index=True)
    first_at = np.full(shape, len(trace.t), dtype=np.int64)
    for right in range(-margin, margin + 1):
        for up in range(-margin, margin + 1):
            if math.hypot(right, up) * cell <= radius:
                at = index[:, 0] + right, index[:, 1] + up
                first_at[at] = np.minimum(first_at[at], when[first])
    first_at[~_in_arena(trace, low, first_at.shape, cell)] = len(trace.t)
    new = np.bincount(first_at.ravel(), minlength=len(trace.t) + 1)[: len(trace.t)]
    areas: Array = np.cumsum(new).astype(np.float64) * cell**2
    return areas


def covered_area(trace: Trace, radius: float = COVER, cell: float = CELL) -> float | None:
    """That area at the end."""
    areas = covered_areas(trace, radius, cell)
    return float(areas[-1]) if len(areas) else None


def hull_areas(trace: Trace) -> Array:
    """(T,) the area in m2 of the convex hull of the robots' axle centres; NaN if none is present.

    Hull by Andrew's monotone chain (Andrew 1979, Inf. Process. Lett. 9), area by the shoelace
    formula; 0 for fewer than three robots or robots in a row.
    """
    is_here = presence(trace)
    areas = np.empty(len(trace.t))
    for at, place in enumerate(trace.pose[..., :2]):
        areas[at] = _hull_area(place[is_here[at]])
    return areas


def hull_area(trace: Trace) -> float | None:
    """That area at the last instant."""
    areas = hull_areas(last(trace))
    return float(areas[0]) if len(areas) and not np.isnan(areas[0]) else None


def _in_arena(
    trace: Trace, low: NDArray[np.int64], shape: tuple[int, ...], cell: float
) -> NDArray[np.bool_]:
    try:
        arena = parse_arena(str(trace.meta.get("arena", "")))
    except ConfigError:  # a trace from elsewhere: no walls are known
        return np.ones(shape, dtype=bool)
    x = (low[0] + np.arange(shape[0]) + 0.5) * cell
    y = (low[1] + np.arange(shape[1]) + 0.5) * cell
    is_in: NDArray[np.bool_] = (np.abs(x) <= arena.length / 2.0)[:, None] & (
        np.abs(y) <= arena.width / 2.0
    )
    return is_in


def _hull_area(place: Array) -> float:
    if len(place) == 0:
        return float("nan")
    points = sorted(map(tuple, place.tolist()))
    ring = [*_chain(points), *_chain(points[::-1])]
    twice = sum(
        ax * by - ay * bx for (ax, ay), (bx, by) in zip(ring, [*ring[1:], ring[0]], strict=True)
    )
    return twice / 2.0


def _chain(points: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """The lower half of the hull of sorted points, without its last point."""
    chain: list[tuple[float, ...]] = []
    for x, y in points:
        while len(chain) >= 2:
            (ax, ay), (bx, by) = chain[-2], chain[-1]
            if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:
                break
            chain.pop()
        chain.append((x, y))
    return chain[:-1] if len(chain) > 1 else chain


METRICS = (
    Metric(
        "covered_area",
        "m2",
        "floor that has been within 0.5 m of a robot",
        "Gage 1992, AUVS (sweep coverage)",
        covered_area,
        covered_areas,
    ),
    Metric(
        "hull_area_end",
        "m2",
        "convex hull of the robots at the end",
        "Andrew 1979, Inf. Process. Lett. 9 (hull)",
        hull_area,
        hull_areas,
    ),
)
