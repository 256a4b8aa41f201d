"""What a scan plane meets: whole bodies, or what really stands at the plane's height."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swarmd.sim.arena import Arena
from swarmd.sim.bodies import value
from swarmd.sim.lidar import Targets
from swarmd.values import Array, Platform


class Scene:
    """All that one kind of sensor can meet, placed anew for each set of poses."""

    def __init__(self, arena: Arena, platforms: Sequence[Platform], *, plane: float | None) -> None:
        """`plane`: the height in m at which the sensor looks; None: it sees every body whole.

        At a plane within a body's height its footprint is seen, above that only the housing of
        its lidar, above that nothing. Walls, boxes and poles reach any plane.
        """
        whole = [i for i, p in enumerate(platforms) if plane is None or plane <= value(p, "height")]
        housed = [
            i
            for i, p in enumerate(platforms)
            if i not in whole and plane is not None and plane <= value(p, "target_top")
        ]
        corners = [platforms[i].footprint for i in whole]
        self._start = _stack(corners)
        self._end = _stack([np.roll(polygon, -1, axis=0) for polygon in corners])
        counts = [len(polygon) for polygon in corners]
        self._owners = np.repeat(np.array(whole, dtype=np.intp), counts)
        self._centers = np.array([platforms[i].scan.offset for i in housed]).reshape(-1, 2)
        self._housed = np.array(housed, dtype=np.intp)
        self._radii = np.array([value(platforms[i], "target_radius") for i in housed])
        self._fixed = arena.segments
        self._poles = arena.circles
        self._all_owners = np.concatenate((np.full(len(self._fixed), -1), self._owners))
        self._all_housed = np.concatenate((np.full(len(self._poles), -1), self._housed))

    def targets(self, poses: Array) -> Targets:
        """Everything in the world frame, with the robots at base `poses` (n, 3)."""
        at = poses[self._owners]
        moving = np.stack((_place(self._start, at), _place(self._end, at)), axis=1)
        centers = _place(self._centers, poses[self._housed])
        housings = np.concatenate((centers, self._radii[:, None]), axis=1)
        return Targets(
            segments=np.concatenate((self._fixed, moving)),
            segment_owners=self._all_owners,
            circles=np.concatenate((self._poles, housings)),
            circle_owners=self._all_housed,
        )


def _place(points: Array, poses: Array) -> Array:
    """One point (k, 2) in each of the frames at `poses` (k, 3), in the world frame."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = poses[:, 0] + cos * points[:, 0] - sin * points[:, 1]
    y = poses[:, 1] + sin * points[:, 0] + cos * points[:, 1]
    return np.stack((x, y), axis=-1)


def _stack(polygons: Sequence[Array]) -> Array:
    return np.concatenate(polygons) if polygons else np.zeros((0, 2))
