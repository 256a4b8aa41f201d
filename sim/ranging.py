"""The range sensors of a whole swarm: one caster and one scene for each kind of platform."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from swarmd.sim.arena import Arena
from swarmd.sim.bodies import value
from swarmd.sim.lidar import Indices, Lidar
from swarmd.sim.visibility import Scene
from swarmd.values import Array, Platform

Visibility = Literal["body", "real"]


class RangeSensors:
    """Casts for any set of robots at once, platform by platform."""

    def __init__(self, platforms: Sequence[Platform], arena: Arena, visibility: Visibility) -> None:
        """`platforms` (n,) in the order of rows; `visibility` as `World` explains it."""
        kinds = {platform.name: platform for platform in platforms}
        names = list(kinds)
        self._kinds = np.array([names.index(p.name) for p in platforms], dtype=np.intp)
        self._lidars = [Lidar(platform.scan) for platform in kinds.values()]
        planes = [value(p, "scan_height") for p in kinds.values()]
        self._scenes = [
            Scene(arena, platforms, plane=plane if visibility == "real" else None)
            for plane in planes
        ]

    def cast(self, poses: Array, robots: Indices) -> list[Array]:
        """Ranges (rays,) for each of `robots` (m,) with all robots at base `poses` (n, 3)."""
        rows: dict[int, Array] = {}
        for kind in np.unique(self._kinds[robots]):
            observers = robots[self._kinds[robots] == kind]
            targets = self._scenes[kind].targets(poses)
            ranges = self._lidars[kind].cast(poses[observers], observers, targets)
            rows.update(zip(observers.tolist(), ranges, strict=True))
        return [rows[robot] for robot in robots.tolist()]
