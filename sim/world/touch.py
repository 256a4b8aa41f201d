"""Touches of bodies as the physics sees them: who, and how fast each surface came."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from swarmd.values import Array


class Contact(Struct, frozen=True):
    """Two that touch: a robot `a`, and a robot or `wall/east`, `box/0`, `pole/0`, `segment/0`.

    `speed_a` and `speed_b` in m/s: how fast each one's surface moves towards the other.
    """

    a: str
    b: str
    speed_a: float
    speed_b: float

    @property
    def closing_speed(self) -> float:
        """The speed of approach in m/s, negative while they separate."""
        return self.speed_a + self.speed_b


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """The touching points of one step: geoms (c, 2), robots first, and speeds (c, 2)."""

    geoms: NDArray[np.intp]
    speeds: Array


class Touches:
    """Reads the touching pairs of planar bodies out of a model's contacts: those of robots."""

    def __init__(self, model: mujoco.MjModel, robots: int) -> None:
        """Of the bodies, the first so many are `robots`."""
        # Body 0 is the arena; row i is body i + 1. Robots come first, in order of their rows.
        self._rows = np.array(model.geom_bodyid, dtype=np.intp) - 1
        self._order = np.where(self._rows < 0, model.nbody, self._rows)
        self._is_robot = self._order < robots
        self._names = [model.geom(geom).name for geom in range(model.ngeom)]

    def after_step(self, data: mujoco.MjData, qpos: Array, qvel: Array) -> Touch:
        """The points in touch in the step that was just made.

        `qpos` and `qvel` are those before the step: MuJoCo finds contacts there, and the solver
        has not yet stopped what was about to collide.
        """
        found = data.contact
        is_touching = (found.dist <= 0.0) & self._is_robot[found.geom].any(axis=1)
        geoms = found.geom[is_touching].astype(np.intp)
        place, normal = found.pos[is_touching, :2], found.frame[is_touching, :2]
        poses = np.concatenate((qpos.reshape(-1, 3), np.zeros((1, 3))))
        twists = np.concatenate((qvel.reshape(-1, 3), np.zeros((1, 3))))
        speeds = np.empty((len(geoms), 2))
        for side, sign in ((0, 1.0), (1, -1.0)):
            row = self._rows[geoms[:, side]]  # -1, the row of zeros, is the arena's
            lever = place - poses[row, :2]
            vx = twists[row, 0] - twists[row, 2] * lever[:, 1]
            vy = twists[row, 1] + twists[row, 2] * lever[:, 0]
            speeds[:, side] = sign * (vx * normal[:, 0] + vy * normal[:, 1])
        turned = self._order[geoms[:, 1]] < self._order[geoms[:, 0]]
        geoms[turned] = geoms[turned, ::-1]
        speeds[turned] = speeds[turned, ::-1]
        return Touch(geoms, speeds)

    def contacts(self, steps: Sequence[Touch]) -> list[Contact]:
        """Each pair once, with its fastest approach in any of the steps; robots in order."""
        if not steps:
            return []
        geoms = np.concatenate([step.geoms for step in steps])
        speeds = np.concatenate([step.speeds for step in steps])
        pair = geoms[:, 0] * len(self._names) + geoms[:, 1]
        order = np.lexsort((-speeds.sum(axis=1), pair))
        chosen = order[np.flatnonzero(np.diff(pair[order], prepend=-1))]
        return [
            Contact(self._names[a], self._names[b], speed_a, speed_b)
            for (a, b), (speed_a, speed_b) in zip(
                geoms[chosen].tolist(), speeds[chosen].tolist(), strict=True
            )
        ]
