"""The range sensors of a whole swarm: one caster for each kind of platform."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from swarmd.sim.world.arena import Arena
from swarmd.sim.world.bodies import value
from swarmd.sim.world.lidar import Indices, Lidar
from swarmd.sim.world.visibility import shapes_of
from swarmd.values import Array, Platform

Visibility = Literal["body", "real"]


class RangeSensors:
    """Casts for any set of robots at once, platform by platform."""

    def __init__(self, platforms: Sequence[Platform], arena: Arena, visibility: Visibility) -> None:
        """`platforms` (n,) in the order of rows; `visibility` as `World` explains it."""
        kinds = {platform.name: platform for platform in platforms}
        names = list(kinds)
        self._kinds = np.array([names.index(p.name) for p in platforms], dtype=np.intp)
        self._lidars = []
        for platform in kinds.values():
            plane = value(platform, "scan_height") if visibility == "real" else None
            shapes = shapes_of(arena, platforms, plane=plane)
            self._lidars.append(Lidar(platform.scan, shapes))

    def cast(self, poses: Array, robots: Indices) -> list[Array]:
        """Ranges (rays,) for each of `robots` (m,) with all robots at base `poses` (n, 3)."""
        if len(self._lidars) == 1:
            return list(self._lidars[0].cast(poses, robots))
        rows: dict[int, Array] = {}
        for kind in np.unique(self._kinds[robots]):
            observers = robots[self._kinds[robots] == kind]
            ranges = self._lidars[kind].cast(poses, observers)
            rows.update(zip(observers.tolist(), ranges, strict=True))
        return [rows[robot] for robot in robots.tolist()]
