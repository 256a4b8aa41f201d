"""The shapes in a scan plane: whole footprints, or the cross-section at the plane's height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swarmd.core.values import Array, Platform
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.bodies import value
from swarmd.sim.world.geometry import Indices


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """The shapes that one kind of sensor detects; lengths in m.

    Fixed, in the world frame: `walls` (w, 2, 2), flat surfaces by start and end with the solid on
    their left, visible from the right alone; `poles` (p, 3) x, y, radius. Moving, in the frames of
    their owners: `polygons` (b, k, 2), convex and counter-clockwise, padded by repeating the last
    corner, and `discs` (d, 3) x, y, radius. `polygon_owners` (b,) and `disc_owners` (d,) are the
    rows of robots, then of boxes. No robot sees its own shapes.
    """

    walls: Array
    poles: Array
    polygons: Array
    polygon_owners: Indices
    discs: Array
    disc_owners: Indices


def shapes_of(arena: Arena, platforms: Sequence[Platform], *, plane: float | None) -> Shapes:
    """The shapes for one kind of sensor; row i is the robot of `platforms[i]`, then come boxes.

    `plane`: the height in m of the scan plane; None: every footprint is visible. A plane within a
    robot's height shows its footprint, above that the housing of its lidar, above that nothing.
    Walls, boxes and poles reach any plane.
    """
    whole = [i for i, p in enumerate(platforms) if plane is None or plane <= value(p, "height")]
    housed = [
        i
        for i, p in enumerate(platforms)
        if i not in whole and plane is not None and plane <= value(p, "target_top")
    ]
    boxes = [box.shape for _, box in arena.movable_boxes]
    box_rows = range(len(platforms), len(platforms) + len(boxes))
    outlines = [*(platforms[i].footprint for i in whole), *boxes]
    discs = [(*platforms[i].scan.offset, value(platforms[i], "target_radius")) for i in housed]
    return Shapes(
        walls=arena.surfaces,
        poles=arena.circles,
        polygons=_padded(outlines),
        polygon_owners=np.array([*whole, *box_rows], dtype=np.intp),
        discs=np.array(discs, dtype=np.float64).reshape(-1, 3),
        disc_owners=np.array(housed, dtype=np.intp),
    )


def _padded(polygons: Sequence[Array]) -> Array:
    """(b, k, 2) with the last corner of those of fewer than k repeated."""
    most = max((len(polygon) for polygon in polygons), default=0)
    padded = [
        np.concatenate((polygon, np.repeat(polygon[-1:], most - len(polygon), axis=0)))
        for polygon in polygons
    ]
    return np.array(padded, dtype=np.float64).reshape(len(polygons), most, 2)
