"""Metric of the floor that a swarm has covered.

Only present robots count.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.metrics.metric import Metric
from swarmd.sim.metrics.window import arena_of, presence
from swarmd.sim.trace import Trace

COVER = 0.5
"""Radius in m around the axle that a robot covers."""
CELL = 0.1
"""Side in m of the squares in which floor is counted."""
_MANY_CELLS = 4_000_000


def covered_areas(trace: Trace, radius: float = COVER, cell: float = CELL) -> Array:
    """(T,) the floor in m2 that has been within `radius` m of a robot up to each instant.

    Sweep coverage (Gage, Command Control for Many-Robot Systems, AUVS 1992) on a grid of squares of
    `cell` m. A square is covered when its centre is covered. Walls do not block. If the trace names
    an arena, floor outside the arena does not count. The side of the squares doubles until the grid
    has at most four million squares.

    Of the positions in one cell of a grid ten times finer, only the first is examined. This saves
    time, and makes the effective radius up to 0.15 `cell` too small.
    """
    instants, robots = np.nonzero(presence(trace))
    if len(instants) == 0:
        return np.zeros(len(trace.t))
    places = trace.pose[instants, robots, :2]  # (k, 2) of all robots at all instants
    # The product is at least the number of squares of the grid.
    while np.prod((np.ptp(places, axis=0) + 2.0 * radius) / cell + 3.0) > _MANY_CELLS:
        cell *= 2.0
    never = len(trace.t)
    lowest, covered_at = _first_cover(instants, places, radius, cell, never)
    covered_at[~_in_arena(trace, lowest, covered_at.shape, cell)] = never
    new_squares = np.bincount(covered_at.ravel(), minlength=never + 1)[:never]
    areas: Array = np.cumsum(new_squares).astype(np.float64) * cell**2
    return areas


def _first_cover(
    instants: NDArray[np.intp], places: Array, radius: float, cell: float, never: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first instant at which each square of a grid is covered, and where the grid begins.

    A square with sides of `cell` m is covered when a position is within `radius` m of its centre.
    `places` (k, 2): positions in m. `instants` (k,): the index of the instant of each position.

    Squares have numbers along x and y; square 0 begins at the origin. Returns the numbers (2,) of
    the square at the low end of the grid along x and y, and an array (columns, rows) of indices of
    instants; `never` for a square that no position covers.
    """
    own_squares = np.floor(places / cell).astype(np.int64)  # (k, 2) of each position
    from_centres = places - (own_squares + 0.5) * cell
    margin = math.ceil(radius / cell)
    lowest = own_squares.min(axis=0) - margin
    shape = own_squares.max(axis=0) + margin + 1 - lowest
    # Examined positions: the first in each square, or in each cell of a ten times finer grid.
    first_in_square = _firsts(own_squares)
    first_in_fine_cell = _firsts(np.floor(places / (cell / 10.0)).astype(np.int64))
    covered_at = np.full(shape, never, dtype=np.int64)
    # Each pass looks at squares that lie `right` and `up` squares from the positions' own squares.
    for right in range(-margin, margin + 1):
        for up in range(-margin, margin + 1):
            # If all positions in the own square cover the other square, the first decides.
            farthest_corner = math.hypot(abs(right) + 0.5, abs(up) + 0.5) * cell
            covers_always = farthest_corner <= radius
            rows = first_in_square if covers_always else first_in_fine_cell
            x = right * cell - from_centres[rows, 0]
            y = up * cell - from_centres[rows, 1]
            near = rows[np.hypot(x, y) <= radius]
            at = own_squares[near, 0] - lowest[0] + right, own_squares[near, 1] - lowest[1] + up
            covered_at[at] = np.minimum(covered_at[at], instants[near])
    return lowest, covered_at


def _firsts(index: NDArray[np.int64]) -> NDArray[np.int64]:
    """The rows of `index` (k, 2) at which each square appears first, in reverse order.

    If several of these rows write one element of an array, the earliest row then writes last.
    """
    low = index.min(axis=0)
    high = index.max(axis=0)
    key = (index[:, 0] - low[0]) * (high[1] - low[1] + 1) + index[:, 1] - low[1]
    rows: NDArray[np.int64] = np.sort(np.unique(key, return_index=True)[1])
    return rows[::-1]


def covered_area(trace: Trace, radius: float = COVER, cell: float = CELL) -> float | None:
    """`covered_areas` at the last instant; None for a trace without instants."""
    areas = covered_areas(trace, radius, cell)
    return float(areas[-1]) if len(areas) else None


def _in_arena(
    trace: Trace, low: NDArray[np.int64], shape: tuple[int, ...], cell: float
) -> NDArray[np.bool_]:
    arena = arena_of(trace)
    if arena is None:
        return np.ones(shape, dtype=bool)
    x = (low[0] + np.arange(shape[0]) + 0.5) * cell
    y = (low[1] + np.arange(shape[1]) + 0.5) * cell
    is_in: NDArray[np.bool_] = (np.abs(x) <= arena.length / 2.0)[:, None] & (
        np.abs(y) <= arena.width / 2.0
    )
    return is_in


METRICS = (
    Metric("covered_area", "m2", "floor that has been within 0.5 m of a robot",
           "Gage 1992, AUVS (sweep coverage)", covered_area, covered_areas),
)  # fmt: skip
