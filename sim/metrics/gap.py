"""The smallest distance between the exact footprints of two robots.

Absent robots count too: they stand in the arena. Lower and upper bounds find the pairs that may be
the nearest, and exact distances are computed only for these pairs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.metrics import pairs
from swarmd.sim.metrics.metric import Metric
from swarmd.sim.metrics.pairs import Pairs
from swarmd.sim.metrics.window import reaches
from swarmd.sim.trace import Trace
from swarmd.sim.world.geometry import gaps, transform

_BLOCK = 2048  # footprints compared at once
_ROUNDING = 1e-12


def minimum_gap(trace: Trace) -> float:
    """The smallest distance in m between two robots' footprints; inf for a single robot.

    Only the trace's instants are examined. 0 if footprints touch or overlap. Distance of convex
    polygons and separating axes: Ericson, Real-Time Collision Detection, 2005, chapters 5 and 9.
    """
    best = np.inf
    for span in pairs.spans(*trace.pose.shape[:2]):
        # Pairs farther apart than an upper bound, or than the best pair so far, do not matter.
        bound = _bounds(trace, span).min(initial=np.inf) if np.isinf(best) else best
        near, lower = _candidates(trace, span, float(bound))
        order = np.argsort(lower, kind="stable")
        for start in range(0, len(order), _BLOCK):
            block = order[start : start + _BLOCK]
            block = block[lower[block] < best - _ROUNDING]
            if len(block) == 0:
                break
            best = min(best, float(_exact(trace, span, near, block).min()))
    return best


def minimum_gaps(trace: Trace) -> Array:
    """(T,) the smallest distance in m between two footprints; inf for a single robot."""
    smallest = np.full(len(trace.t), np.inf)
    for span in pairs.spans(*trace.pose.shape[:2]):
        best = smallest[span]
        near, lower = _candidates(trace, span, float(_bounds(trace, span).max(initial=0.0)))
        # First, at each instant, the pair with the least lower bound; then all pairs whose lower
        # bound is below the exact distance of that pair.
        order = np.lexsort((lower, near.instant))
        leading = order[np.unique(near.instant[order], return_index=True)[1]]
        np.minimum.at(best, near.instant[leading], _exact(trace, span, near, leading))
        rest = np.flatnonzero(lower < best[near.instant] - _ROUNDING)
        np.minimum.at(best, near.instant[rest], _exact(trace, span, near, rest))
    return smallest


def _bounds(trace: Trace, span: slice) -> Array:
    """(T,) an upper bound in m of the smallest gap at each instant; inf for a single robot.

    The bound is the distance of the nearest two origins plus two radii of footprints.
    """
    place = trace.pose[span, :, :2]
    nearest = pairs.nearest(place, _is_in_arena(place))
    least = np.fmin.reduce(nearest, axis=1, initial=np.inf)
    bounds: Array = least + 2.0 * reaches(trace).max(initial=0.0)
    return bounds


def _candidates(trace: Trace, span: slice, bound: float) -> tuple[Pairs, Array]:
    """Pairs whose footprints may be as near as `bound`, and a lower bound of their distance."""
    place = trace.pose[span, :, :2]
    reach = reaches(trace)
    near = pairs.near(place, _is_in_arena(place), bound + 2.0 * reach.max(initial=0.0))
    near = pairs.chosen(near, near.distance - reach[near.a] - reach[near.b] <= bound)
    return near, _along(trace, span, near)


def _is_in_arena(place: Array) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(place).all(axis=-1))


def _along(trace: Trace, span: slice, near: Pairs) -> Array:
    """(p,) a lower bound in m of the distance of the footprints of each pair.

    The bound is the gap between the projections of both footprints onto the line through both
    origins; it is negative if the projections overlap.
    """
    pose = trace.pose[span]
    a = pose[near.instant, near.a]
    b = pose[near.instant, near.b]
    bearing = np.arctan2(b[:, 1] - a[:, 1], b[:, 0] - a[:, 0])
    ahead = bearing - a[:, 2]
    back = bearing - b[:, 2] + np.pi
    kind = np.array(trace.platforms)
    # How far each footprint reaches from its origin towards the other robot's origin.
    shadow = np.empty(len(near.instant))
    total = near.distance.copy()
    for robot, angle in ((near.a, ahead), (near.b, back)):
        for name in sorted(set(trace.platforms)):
            of = kind[robot] == name
            x = np.cos(angle[of])
            y = np.sin(angle[of])
            corners = trace.footprints[name]
            shadow[of] = np.max([x * cx + y * cy for cx, cy in corners], axis=0)
        total -= shadow
    return total


def _exact(trace: Trace, span: slice, near: Pairs, chosen: pairs.Ints) -> Array:
    """The exact distances in m of the footprints of the pairs `chosen` (c,) of `near`."""
    names = sorted(set(trace.platforms))
    kind = np.array([names.index(name) for name in trace.platforms], dtype=np.int64)
    pose = trace.pose[span]
    instant = near.instant[chosen]
    a = near.a[chosen]
    b = near.b[chosen]
    result = np.empty(len(chosen))
    both = kind[a] * len(names) + kind[b]  # a number for each pair of platforms
    for code in np.unique(both):
        of = np.flatnonzero(both == code)
        for start in range(0, len(of), _BLOCK):
            block = of[start : start + _BLOCK]
            shapes = [
                transform(trace.footprints[names[which]], pose[instant[block], robot[block]])
                for which, robot in ((code // len(names), a), (code % len(names), b))
            ]
            result[block] = gaps(shapes[0], shapes[1])
    return result


METRICS = (
    Metric("minimum_gap", "m", "smallest distance between two robots' footprints",
           "Ericson 2005, Real-Time Collision Detection", minimum_gap, minimum_gaps, "more"),
)  # fmt: skip
