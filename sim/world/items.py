"""Items on the floor: flat items that robots pick up and drop, and pucks that robots push.

Items are low: they block no lidar, lamp or radio, and protection does not know them. The readings
of a robot include the items near it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array, Platform
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.geometry import overlaps
from swarmd.sim.world.item_kind import DELIVERED, HELD, ItemKind
from swarmd.sim.world.movable_boxes import FRICTION, GRAVITY
from swarmd.sim.world.seeding import generator

GRIP = 0.08
"""Metres from the middle of a robot's front edge within which a gripper takes an item."""
_TRIES = 1000  # draws of one place


class Items:
    """All items of a world; row i of every array is item `names[i]`, in the order of the kinds.

    `shapes` (q, 4, 2) are squares as large as the items.
    """

    def __init__(
        self, kinds: Sequence[ItemKind], arena: Arena, platforms: Sequence[Platform], seed: int
    ) -> None:
        """Make the items; they have no places before `begin`.

        `kinds`: the kinds of the items in `arena`, in the same order. `platforms` (n,): of the
        robots. `seed`: of random places.
        """
        self._kinds = tuple(kinds)
        self._arena = arena
        # Outlines (c, 2) of the arena's solid parts, which no item may overlap.
        self._solid = [box.corners for _, box in arena.fixed]
        self._solid += [pole.corners for pole in arena.poles]
        items = [item for kind in kinds for item in kind.things]
        self.names = tuple(item.name for item in items)
        self.shapes = np.array([item.shape for item in items]).reshape(-1, 4, 2)
        # (q,) the index of each item's kind.
        self._kind_of = np.repeat(np.arange(len(kinds)), [len(kind.things) for kind in kinds])
        self._places = np.zeros((len(self.names), 3))  # x, y and yaw of each item
        self._rngs = [generator(seed, "items", kind.name) for kind in kinds]
        # An item without a mass is flat, and carried by robots; a puck has a mass, and is pushed.
        self._is_flat = np.array([kind.mass is None for kind in kinds], np.bool_)[self._kind_of]
        self.has_flat = bool(self._is_flat.any())
        self._pucks = np.flatnonzero(~self._is_flat)
        inert = np.array([_inertia(kind) for kind in kinds]).reshape(-1, 3)
        self._inert = inert[self._kind_of][self._pucks]
        self._dofs = slice(0, 0)  # of the pucks in MuJoCo's memory; `begin` sets it
        # (n,) m from the axle of each robot to the middle of its front edge.
        self._front = np.array([platform.footprint[:, 0].max() for platform in platforms])
        self._is_closed = np.zeros(len(platforms), dtype=np.bool_)  # the gripper of each robot
        self._held = np.full(len(platforms), -1)  # the item that each robot holds; -1: no item
        self.delivered = np.zeros(len(platforms), dtype=np.int64)

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData, outlines: Sequence[Array]) -> None:
        """Put all items in their places; the pucks are the last bodies of the model.

        `outlines`: (c, 2) of each robot and box, which no puck may overlap. ConfigError if there is
        no room.
        """
        self._data = data
        self._dt = float(model.opt.timestep)
        self._dofs = slice(model.nv - 3 * len(self._pucks), model.nv)
        solid = self._solid
        for number, kind in enumerate(self._kinds):
            rows = np.flatnonzero(self._kind_of == number)
            # A flat item may lie under a robot or box, a puck may not.
            others = solid if kind.mass is None else [*solid, *outlines]
            for row, place in zip(rows.tolist(), kind.at or (None,) * len(rows), strict=True):
                if place is None:
                    self._places[row, :2] = self._drawn(number, others, self._places[:row, :2])
                else:
                    self._places[row, :2] = place
        if len(self._pucks):
            data.qpos[self._dofs] = self._places[self._pucks].ravel()

    def poses(self) -> Array:
        """(q, 3) x, y in m and yaw in rad of the items."""
        if len(self._pucks):
            self._places[self._pucks] = self._data.qpos[self._dofs].reshape(-1, 3)
        return self._places.copy()

    def apply_friction(self) -> None:
        """Set the floor's friction on the pucks for the next step.

        The force stops a slow puck within the step, and brakes a faster puck with full friction. It
        is an applied force and no constraint of MuJoCo's solver, so a puck at rest costs next to
        nothing.
        """
        if not len(self._pucks):
            return
        speed = self._data.qvel[self._dofs].reshape(-1, 3)
        size = np.hypot(speed[:, 0], speed[:, 1])[:, None]
        # The share of its speed that a puck loses in a second: 1 / dt stops it within the step.
        lost = np.minimum(FRICTION * GRAVITY / np.maximum(size, 1e-12), 1.0 / self._dt)
        self._data.qfrc_applied[self._dofs] = (-self._inert * lost * speed).ravel()

    def follow(self, poses: Array, is_closed: NDArray[np.bool_]) -> None:
        """Carry, pick up and drop flat items, with robots at `poses` (n, 3).

        `is_closed` (n,): the command of each gripper. A gripper that closes takes the nearest item
        within GRIP m of the front edge. A gripper that opens drops its item.
        """
        changed = np.flatnonzero(is_closed != self._is_closed).tolist()
        if not changed and not (self._held >= 0).any():
            return
        front = poses[:, :2] + self._front[:, None] * np.stack(
            (np.cos(poses[:, 2]), np.sin(poses[:, 2])), axis=-1
        )
        for robot in changed:
            self._is_closed[robot] = is_closed[robot]
            if is_closed[robot]:
                self._pick(robot, front[robot])
            elif self._held[robot] >= 0:
                self._drop(robot)
        holding = np.flatnonzero(self._held >= 0)
        self._places[self._held[holding], :2] = front[holding]

    def readings(self, robot: int, pose: Array) -> dict[str, float]:
        """The readings of items of `robot` at `pose` (3,); see ItemKind."""
        readings = {}
        places = self.poses()[:, :2]
        away = places - pose[:2]
        distance = np.hypot(away[:, 0], away[:, 1])
        distance[self._held[self._held >= 0]] = np.inf  # items that robots hold are left out
        for number, kind in enumerate(self._kinds):
            near = np.flatnonzero((self._kind_of == number) & (distance <= kind.range))
            readings[kind.name] = float(len(near))
            bearing = 0.0
            reach = 0.0
            if len(near):
                nearest = near[distance[near].argmin()]
                x, y = away[nearest]
                reach = float(distance[nearest])
                bearing = math.remainder(math.atan2(y, x) - float(pose[2]), 2.0 * math.pi)
            readings[f"{kind.name}_distance"] = reach
            readings[f"{kind.name}_bearing"] = bearing
        if self.has_flat:
            readings[HELD] = float(self._held[robot] >= 0)
            readings[DELIVERED] = float(self.delivered[robot])
        return readings

    def release(self, robot: int) -> None:
        """Release the item of a robot that is taken out of the arena; the item stays in place."""
        self._held[robot] = -1
        self._is_closed[robot] = False

    def _pick(self, robot: int, front: Array) -> None:
        distance = np.hypot(*(self._places[:, :2] - front).T)
        distance[~self._is_flat] = np.inf
        distance[self._held[self._held >= 0]] = np.inf
        nearest = int(distance.argmin())
        if distance[nearest] <= GRIP:
            self._held[robot] = nearest

    def _drop(self, robot: int) -> None:
        item = int(self._held[robot])
        self._held[robot] = -1
        number = int(self._kind_of[item])
        nest = self._kinds[number].nest
        if nest is not None and math.dist(self._places[item, :2], nest[:2]) <= nest[2]:
            self.delivered[robot] += 1
            self._places[item, :2] = self._drawn(number, self._solid, self._places[:0, :2])

    def _drawn(self, number: int, solid: Sequence[Array], taken: Array) -> Array:
        """A free place (2,) in the source of a kind; ConfigError if there seems to be none."""
        kind = self._kinds[number]
        rng = self._rngs[number]
        assert kind.source is not None
        x, y, radius = kind.source
        walls = np.array([self._arena.length, self._arena.width]) / 2.0 - kind.size / 2.0
        for _ in range(_TRIES):
            # Uniform over the disc, whose area grows with the square of the radius.
            away = radius * math.sqrt(rng.random())
            angle = 2.0 * math.pi * rng.random()
            place = np.array([x + away * math.cos(angle), y + away * math.sin(angle)])
            if (np.abs(place) > walls).any():
                continue
            if len(taken) and np.hypot(*(taken - place).T).min() < kind.size:
                continue
            square = place + self.shapes[self._kind_of == number][0]
            if not any(overlaps(square, body) for body in solid):
                return place
        raise ConfigError(f"items {kind.name}: no room in the source {list(kind.source)}")


def _inertia(kind: ItemKind) -> tuple[float, float, float]:
    """Inertia of a puck along x, y and yaw: the mass twice, and m r^2 / 2 of a disc; 0 if flat."""
    mass = kind.mass or 0.0
    return mass, mass, mass * kind.size**2 / 8.0
