"""True distances of robots to walls, boxes, poles and inner walls.

Absent robots count too: they stand in the arena. Distances of convex polygons: Ericson, Real-Time
Collision Detection, 2005, chapters 5 and 9.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.metrics import pairs
from swarmd.sim.metrics.metric import Metric
from swarmd.sim.metrics.window import arena_of, tall_boxes
from swarmd.sim.trace import Trace
from swarmd.sim.world.arena import Arena, Pole
from swarmd.sim.world.geometry import apart, gaps, radius, transform

Measure: TypeAlias = Callable[[Array, NDArray[np.int64]], Array]
"""The distances of outlines (p, k, 2) at instants (p,) from one obstacle."""


def clearances(trace: Trace) -> Array | None:
    """(T,) m from the nearest outline of a robot to the arena's walls or obstacles.

    0 in contact; inf without a robot. None if the arena is unknown.
    """
    arena = arena_of(trace)
    if arena is None:
        return None
    smallest = np.full(len(trace.t), np.inf)
    for span in pairs.spans(*trace.pose.shape[:2]):
        for name in sorted(set(trace.platforms)):
            _note_nearest(smallest[span], trace, span, name, arena)
    return smallest


def clearance(trace: Trace) -> float | None:
    """The smallest clearance of the run in m; None if the arena is unknown."""
    smallest = clearances(trace)
    return None if smallest is None else float(smallest.min(initial=np.inf))


def _note_nearest(best: Array, trace: Trace, span: slice, platform: str, arena: Arena) -> None:
    """Lower `best` (T,) in place to the clearance of one platform's robots in a span."""
    shape = trace.footprints[platform]
    pose = trace.pose[span][:, [name == platform for name in trace.platforms]]
    corners = transform(shape, pose)
    walls = np.array([arena.length, arena.width]) / 2.0 - np.abs(corners)
    nearest = np.maximum(walls, 0.0).min(axis=(2, 3))
    np.minimum(best, np.fmin.reduce(nearest, axis=1, initial=np.inf), out=best)
    instants = np.indices(pose.shape[:2])[0]
    for centre, size, distance in _obstacles(trace, span, arena):
        away = np.hypot(*np.moveaxis(pose[..., :2] - centre, -1, 0)) - radius(shape) - size
        is_near = away < best[:, None]  # false for an obstacle that is not in the arena: NaN
        distances = distance(corners[is_near], instants[is_near])
        np.minimum.at(best, instants[is_near], distances)


def _obstacles(trace: Trace, span: slice, arena: Arena) -> Iterator[tuple[Array, float, Measure]]:
    """Yield each obstacle: its centre (2,) or (T, 1, 2), its radius, and a distance function.

    The radius is that of a circle around the centre that holds the obstacle.
    """
    for _, box in arena.fixed:
        yield np.array([box.x, box.y]), radius(box.shape), _from_fixed(box.corners)
    for pole in arena.poles:
        yield np.array([pole.x, pole.y]), pole.radius, _from_pole(pole)
    movable = tall_boxes(trace)
    if movable is None:
        return
    for shape, poses in zip(movable[0], movable[1].swapaxes(0, 1), strict=True):
        pose = poses[span]
        yield pose[:, None, :2], radius(shape), _from_moving(transform(shape, pose))


def _from_fixed(corners: Array) -> Measure:
    return lambda outlines, instants: gaps(outlines, corners)


def _from_moving(corners: Array) -> Measure:
    return lambda outlines, instants: gaps(outlines, corners[instants])


def _from_pole(pole: Pole) -> Measure:
    centre = np.array([pole.x, pole.y])

    def distance(outlines: Array, instants: NDArray[np.int64]) -> Array:
        following = np.roll(outlines, -1, axis=-2)
        edge = following - outlines
        to = centre - outlines
        is_inside = (edge[..., 0] * to[..., 1] >= edge[..., 1] * to[..., 0]).all(axis=-1)
        nearest = apart(centre, outlines, following).min(axis=-1) - pole.radius
        return np.where(is_inside, 0.0, np.maximum(nearest, 0.0))

    return distance


METRICS = (
    Metric("clearance", "m", "smallest distance of a robot's footprint from walls, boxes and poles",
           "Ericson 2005, Real-Time Collision Detection", clearance, clearances, "more"),
)  # fmt: skip
