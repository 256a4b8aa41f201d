"""Contacts in the physics of a world, and contact episodes.

`bodies.py` models the collision itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from swarmd.core.values import Array

if TYPE_CHECKING:  # metrics count episodes without a physics engine
    import mujoco

EPISODE_GAP = 0.5
"""Seconds without contact after which the same pair begins a new episode."""


class ContactEpisodes:
    """Counts the contact episodes of pairs; `add` is called in order of time."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, str], float] = {}
        self._counts: dict[tuple[str, str], int] = {}

    @property
    def counts(self) -> dict[tuple[str, str], int]:
        """The number of episodes of each pair, whose names are sorted."""
        return dict(self._counts)

    def add(self, time: float, a: str, b: str) -> bool:
        """Add a contact of two bodies at `time` s; True if it begins a new episode."""
        pair = (a, b) if a <= b else (b, a)
        last = self._last.get(pair)
        self._last[pair] = time
        if last is not None and time - last <= EPISODE_GAP:
            return False
        self._counts[pair] = self._counts.get(pair, 0) + 1
        return True


class Contact(Struct, frozen=True):
    """A contact of robot `a` with `b`: a robot, `wall/east`, `box/0`, `pole/0` or `segment/0`.

    `speed_a` and `speed_b`: the speed in m/s of each surface towards the other surface.
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
class ContactPoints:
    """The contact points of one step: geoms (c, 2), robots first, and speeds (c, 2) in m/s."""

    geoms: NDArray[np.intp]
    speeds: Array


class ContactReader:
    """Reads the contacts of robots from the contacts of a model."""

    def __init__(self, model: mujoco.MjModel, robots: int, counted: int) -> None:
        """`robots`: the number of robots, which are the first bodies of the model.

        `counted`: the number of bodies, from the first on, whose contacts with robots are read.
        """
        # Body 0 is the arena, and row i is body i + 1. The arena gets the last row, so that a pair,
        # which is sorted by row, has the arena last.
        row = np.array(model.geom_bodyid, dtype=np.intp) - 1
        self._rows = np.where(row < 0, model.nbody - 1, row)
        self._robots = robots
        is_left_out = row >= counted
        self._is_left_out = is_left_out if is_left_out.any() else None
        self._names = [model.geom(geom).name for geom in range(model.ngeom)]

    def after_step(self, data: mujoco.MjData, qpos: Array, qvel: Array) -> ContactPoints:
        """The contact points of robots in the last step, with the speeds towards each other.

        `qpos` and `qvel` (3 k,): poses and velocities of all k bodies before the step. MuJoCo
        detects contacts at these poses, before the solver stops the colliding bodies.
        """
        contact = data.contact
        geoms = np.asarray(contact.geom, dtype=np.intp)  # (c, 2)
        rows = self._rows.take(geoms)
        # Robots have the first rows, so a contact with a robot has a row below `_robots`.
        is_touching = (contact.dist <= 0.0) & (rows.min(axis=1) < self._robots)
        if self._is_left_out is not None:
            is_touching &= ~self._is_left_out.take(geoms).any(axis=1)
        touching = is_touching.nonzero()[0]
        geoms = geoms.take(touching, axis=0)
        rows = rows.take(touching, axis=0)
        points = contact.pos.take(touching, axis=0)
        normals = contact.frame.take(touching, axis=0)
        speeds = _speeds_along(normals, points, rows, qpos, qvel)
        # Each pair in order of rows: robots first.
        reversed_pairs = (rows[:, 1] < rows[:, 0]).nonzero()[0]
        if len(reversed_pairs):
            geoms[reversed_pairs] = geoms[reversed_pairs, ::-1]
            speeds[reversed_pairs] = speeds[reversed_pairs, ::-1]
        return ContactPoints(geoms, speeds)

    def contacts(self, steps: Sequence[ContactPoints]) -> list[Contact]:
        """Each pair once, with its highest closing speed over the steps, in order of geoms."""
        if not steps:
            return []
        geoms = np.concatenate([step.geoms for step in steps])
        speeds = np.concatenate([step.speeds for step in steps])
        pair = geoms[:, 0] * len(self._names) + geoms[:, 1]
        # By pair, and within a pair the highest closing speed first.
        order = np.lexsort((-speeds.sum(axis=1), pair))
        pair = pair.take(order)
        is_first = np.ones(len(pair), dtype=np.bool_)
        np.not_equal(pair[1:], pair[:-1], out=is_first[1:])
        chosen = order[is_first]
        return [
            Contact(self._names[a], self._names[b], speed_a, speed_b)
            for (a, b), (speed_a, speed_b) in zip(
                geoms[chosen].tolist(), speeds[chosen].tolist(), strict=True
            )
        ]


def _speeds_along(
    normals: Array, points: Array, rows: NDArray[np.intp], qpos: Array, qvel: Array
) -> Array:
    """(c, 2) m/s of each surface at a contact towards the other surface.

    `normals`: x and y of the unit vector from the first body to the second, in the first two
    columns. `points`: x and y of the contacts. `rows` (c, 2): the rows of both bodies; the arena
    has the row after the last body. `qpos`, `qvel` (3 k,): poses and velocities of all k bodies.
    """
    arena = np.zeros((1, 3))  # neither moves nor turns
    poses = np.concatenate((qpos.reshape(-1, 3), arena)).take(rows, axis=0)
    twists = np.concatenate((qvel.reshape(-1, 3), arena)).take(rows, axis=0)
    # The velocity of a point of a body: that of its axle, plus that of the turn about the axle.
    angular = twists[..., 2]
    vx = twists[..., 0] - angular * (points[:, 1:2] - poses[..., 1])
    vy = twists[..., 1] + angular * (points[:, 0:1] - poses[..., 0])
    speeds: Array = vx * normals[:, 0:1] + vy * normals[:, 1:2]
    speeds[:, 1] *= -1.0  # the second body moves towards the first against the normal
    return speeds
