"""Line of sight between two places past obstacles, for the radio and for lamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.geometry import apart, crossings

MAX_BATCH = 65_536
"""Pairs of path and obstacle in one batch of the line of sight, which bounds memory."""


class LineOfSight:
    """Line of sight between places past boxes, inner walls and poles; robots do not block it."""

    def __init__(self, arena: Arena) -> None:
        """Take the fixed obstacles of the arena."""
        self._walls = arena.surfaces
        self._poles = arena.circles

    def is_clear(self, a: Array, b: Array, movable_boxes: Array | None = None) -> NDArray[np.bool_]:
        """(k,) True where the line from a to b (k, 2), in m in the world frame, is clear.

        `movable_boxes` (boxes, corners, 2) in m; NaN for a box outside the arena.
        """
        walls = self._walls
        poles = self._poles
        if movable_boxes is not None and len(movable_boxes):
            edges = np.stack((movable_boxes, np.roll(movable_boxes, -1, axis=1)), axis=2).reshape(
                -1, 2, 2
            )
            walls = np.concatenate((walls, edges))
        is_clear = np.ones(len(a), dtype=np.bool_)
        stride = max(1, MAX_BATCH // max(1, len(walls) + len(poles)))
        for first in range(0, len(a), stride):
            some = slice(first, first + stride)
            here = a[some, None]
            there = b[some, None]
            is_behind = crossings(here, there, walls[:, 0], walls[:, 1]).any(axis=1)
            if len(poles):
                is_behind |= (apart(poles[:, :2], here, there) < poles[:, 2]).any(axis=1)
            is_clear[some] = ~is_behind
        return is_clear
