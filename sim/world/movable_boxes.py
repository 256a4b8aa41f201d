"""Movable boxes, which slide on the floor with dry friction and can be placed and removed."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np

from swarmd.core.errors import ConfigError, SwarmError, unknown
from swarmd.core.values import Array
from swarmd.sim.world.arena import Arena, Box
from swarmd.sim.world.bodies import ARENA_TYPE, SOLID_BIT, moment
from swarmd.sim.world.geometry import overlaps, transform

GRAVITY = 9.81
FRICTION = 0.4
"""Coefficient of dry friction of boxes and pucks on the floor."""


class MovableBoxes:
    """The movable boxes of a model; row i of every array is box `names[i]`."""

    def __init__(
        self, arena: Arena, model: mujoco.MjModel, data: mujoco.MjData, robots: int
    ) -> None:
        """Put the arena's movable boxes at their start poses.

        `robots`: the number of robots; the boxes are the bodies behind them in the model. Raises
        ConfigError if a box starts outside the walls or overlaps another body.
        """
        boxes = [box for _, box in arena.movable_boxes]
        m = len(boxes)
        self._arena = arena
        self._model = model
        self._data = data
        self._dofs = slice(3 * robots, 3 * (robots + m))  # of the boxes in MuJoCo's memory
        self.names = tuple(name for name, _ in arena.movable_boxes)
        self.shapes = np.array([box.shape for box in boxes]).reshape(m, 4, 2)
        self.is_there = np.zeros(m, dtype=np.bool_)  # False: out of the arena
        self._geoms = [model.geom(f"box/{name}").id for name in self.names]
        # (m,) the force of friction in N.
        self._grip = np.array([FRICTION * GRAVITY * (box.mass or 0.0) for box in boxes])
        # (m, 3) the greatest friction along x, along y and about yaw for each N of this force: 1, 1
        # and the lever in m.
        lever = np.array([_lever(box) for box in boxes])
        self._lever = np.stack((np.ones(m), np.ones(m), lever), axis=-1).reshape(m, 3)
        # (m, 3) inertia along x, y and yaw: the mass in kg twice, the moment in kg m2.
        self._inert = np.array([(b.mass, b.mass, moment(b)) for b in boxes]).reshape(m, 3)
        starts = np.array([(box.x, box.y, box.yaw) for box in boxes]).reshape(m, 3)
        for row, box in enumerate(boxes):
            self._put(row, starts[row], is_there=box.is_placed)
        for row in np.flatnonzero(self.is_there).tolist():
            # Checked once all boxes are placed. Robots are not checked: their layout keeps them off
            # the boxes.
            fault = self._fault(row, starts[row], robots=())
            if fault:
                where = f"box {self.names[row]} starts at ({starts[row, 0]:g}, {starts[row, 1]:g})"
                raise ConfigError(f"{where}: {fault}")

    def poses(self) -> Array:
        """(m, 3) x, y in m and yaw in rad, world frame; NaN for a box that is not in the arena."""
        poses = np.array(self._data.qpos[self._dofs], dtype=np.float64).reshape(-1, 3)
        poses[~self.is_there] = np.nan
        return poses

    def place(self, name: str, pose: Array, robots: Iterable[tuple[str, Array]]) -> None:
        """Put a box at rest at `pose` (3,); `robots` are their names and outlines (k, 2).

        Raises SwarmError if the box would overlap something, ConfigError for an unknown box.
        """
        row = self._row(name)
        fault = self._fault(row, pose, robots)
        if fault:
            raise SwarmError(f"box {name} cannot be placed at ({pose[0]:g}, {pose[1]:g}): {fault}")
        self._put(row, pose, is_there=True)

    def remove(self, name: str) -> None:
        """Take a box out of the arena; SwarmError if it is not there, ConfigError if unknown."""
        row = self._row(name)
        if not self.is_there[row]:
            raise SwarmError(f"box {name} cannot be removed: it is not in the arena")
        self._put(row, self._data.qpos[self._dofs][3 * row : 3 * row + 3], is_there=False)

    def apply_friction(self) -> None:
        """Set the floor's isotropic friction for the next step.

        Dry friction limits force and torque together, by an ellipsoid (Howe and Cutkosky 1996). Its
        half axes are the friction force and, for the torque, this force times the box's lever.
        MuJoCo limits the friction of each coordinate of a box (x, y, yaw) separately. So the three
        limits are set to a point on the ellipsoid: the point in the direction of the force and
        torque that would stop the box.
        """
        if not self.is_there.any():
            return
        # The force that would stop the box within the step; friction limits it.
        momentum = self._data.qvel[self._dofs].reshape(-1, 3) * self._inert
        against = (momentum / self._model.opt.timestep + self._pushes()) / self._lever
        size = np.sqrt((against * against).sum(axis=1))[:, None]
        # The coordinates of the point as shares of the half axes; equal for a box that needs no
        # force.
        share = np.where(size > 0.0, np.abs(against) / np.maximum(size, 1e-300), 3.0**-0.5)
        # Above 0, so that the number of friction constraints does not change between steps.
        force = self._grip[:, None] * self._lever * np.maximum(share, 1e-3)
        self._model.dof_frictionloss[self._dofs] = force.ravel()

    def _pushes(self) -> Array:
        """The contact forces (m, 3) on the boxes in the last step."""
        data = self._data
        force = np.array(data.qfrc_constraint)
        friction = slice(data.ne, data.ne + data.nf)
        force[data.efc_id[friction]] -= data.efc_force[friction]
        pushes: Array = force[self._dofs].reshape(-1, 3)
        return pushes

    def _fault(self, row: int, pose: Array, robots: Iterable[tuple[str, Array]]) -> str:
        """Why box `row` cannot be at a pose; empty if it can."""
        if not np.isfinite(pose).all():
            return "x, y and yaw must be finite"
        corners = transform(self.shapes[row], pose)
        if (np.abs(corners) > np.array([self._arena.length, self._arena.width]) / 2.0).any():
            return "it would be outside the walls"
        for name, outline in (*robots, *self._obstacles(row)):
            if overlaps(corners, outline):
                return f"it would overlap {name}"
        return ""

    def _obstacles(self, row: int) -> list[tuple[str, Array]]:
        """Names and outlines of all obstacles except robots, outer walls and box `row`."""
        arena = self._arena
        poses = self.poses()
        fixed = [(name, box.corners) for name, box in arena.fixed]
        fixed += [(f"pole/{index}", pole.corners) for index, pole in enumerate(arena.poles)]
        others = [i for i in range(len(self.names)) if i != row and self.is_there[i]]
        return fixed + [
            (f"box/{self.names[i]}", transform(self.shapes[i], poses[i])) for i in others
        ]

    def _put(self, row: int, pose: Array, *, is_there: bool) -> None:
        """Set box `row` at rest at a pose, with or without contacts."""
        self.is_there[row] = is_there
        self._data.qpos[self._dofs][3 * row : 3 * row + 3] = pose
        self._data.qvel[self._dofs][3 * row : 3 * row + 3] = 0.0
        self._model.geom_contype[self._geoms[row]] = ARENA_TYPE if is_there else 0
        self._model.geom_conaffinity[self._geoms[row]] = SOLID_BIT if is_there else 0

    def _row(self, name: str) -> int:
        if name not in self.names:
            raise ConfigError(unknown("movable box", name, self.names))
        return self.names.index(name)


def _lever(box: Box) -> float:
    """The mean distance in m of a box's floor area from its centre: the lever of friction."""
    share = (np.arange(64) + 0.5) / 64.0 - 0.5
    return float(np.hypot(share[:, None] * box.length, share * box.width).mean())
