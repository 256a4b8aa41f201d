"""The simulated world: bodies in an arena, their sensors, and the truth for metrics alone.

One structure of arrays for real time and lockstep; deterministic: the same commands at the same
steps give bit-identical poses. Robot i of `ids` is row i of every array.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array, Odometry, Platform, Pose, Scan, Twist
from swarmd.sim.world import bodies
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.base_dynamics import Actuators, BaseDynamics
from swarmd.sim.world.contacts import Contact, ContactPoints, ContactReader
from swarmd.sim.world.geometry import Indices, radius, transform
from swarmd.sim.world.lidar import RangeSensors, Visibility
from swarmd.sim.world.movable_boxes import MovableBoxes
from swarmd.sim.world.noise import NoisyLidar
from swarmd.sim.world.odometer import Odometers
from swarmd.sim.world.realism import IDEAL, Realism
from swarmd.sim.world.scalar_fields import Field, readings_at


class World:
    """Planar MuJoCo bodies, their range sensors and odometry, and boxes that can be pushed.

    `movable_boxes` are the names of the movable boxes, row i of `box_poses()` and `box_shapes`
    (m, 4, 2), their outlines in their own frames. `scan_latency` (n,) s: how much later than it is
    taken a sweep of each robot is to arrive.
    """

    def __init__(
        self,
        robots: Mapping[str, Platform],
        arena: Arena,
        starts: Array,
        *,
        visibility: Visibility = "body",
        realism: Realism = IDEAL,
        seed: int = 0,
        fields: Sequence[Field] = (),
        dt: float = 0.01,
    ) -> None:
        """A world at rest. `starts` (n, 3) x, y, yaw in m and rad.

        `seed` is that of all that `realism` leaves to chance; `fields` are what `readings` samples.
        `visibility`: what a range sensor sees of another robot: its whole footprint, or only what
        the sensor's plane really meets. `body` is the default since the published behaviours need
        it: with true heights a Waffle Pi sees of another a lidar housing 0.11 m wide, 3 rays at
        2 m, and protection that asks for more than 5 rays begins to see it only at 1 m.
        """
        n = len(robots)
        if starts.shape != (n, 3):
            raise ConfigError(f"{n} robots, but start poses of shape {starts.shape}")
        self.ids, self.platforms = tuple(robots), tuple(robots.values())
        self.arena, self.dt = arena, dt
        self.model = bodies.build_model(robots, arena, dt)
        self.data = mujoco.MjData(self.model)
        # Windows on MuJoCo's own memory.
        self._qpos, self._qvel = self.data.qpos, self.data.qvel
        self._applied = self.data.qfrc_applied
        self._qpos[: 3 * n] = starts.ravel()
        self._movable_boxes = MovableBoxes(arena, self.model, self.data, n)
        self.movable_boxes, self.box_shapes = self._movable_boxes.names, self._movable_boxes.shapes
        mujoco.mj_forward(self.model, self.data)
        self._drives = BaseDynamics(self.platforms, dt)
        self._driven: Array | None = None
        self._actuators = Actuators(realism.actuation, self.platforms, dt)
        self._odometers = Odometers(realism.odometry, self.platforms, starts, self.ids, seed)
        self._noise = NoisyLidar(realism.lidar, self.platforms, self.ids, seed)
        self.scan_latency = self._noise.latency
        self._steps = 0
        self._seq, self._is_out = [0] * n, np.zeros(n, dtype=np.bool_)
        self._contacts = ContactReader(self.model, n)
        self._touching: list[ContactPoints] = []
        self._sensors = RangeSensors(self.platforms, arena, visibility)
        self._fields = tuple(fields)
        shapes = [platform.footprint for platform in self.platforms]
        self._widest = sum(
            max(map(radius, some), default=0.0) for some in (shapes, self.box_shapes)
        )

    @property
    def time(self) -> float:
        """Simulated time in s since the world was made."""
        return self._steps * self.dt

    def set_commands(self, twists: Array) -> None:
        """What the bases are to do from now on: (n, 3) linear, angular, lateral.

        Held within each platform's limits, as a base's firmware would; what is not finite is 0.
        The bases follow as late and as slowly as `realism` says.
        """
        self._actuators.put(twists)

    def step(self, k: int = 1) -> None:
        """Advance by `k` steps of `dt`."""
        self._touching = []
        for _ in range(k):
            self._step()

    def _step(self) -> None:
        data = self.data
        driven = self._actuators.now()
        if driven is not self._driven:  # an ideal base is driven with one array until the next
            self._driven = driven
            self._drives.set(driven)
        qpos, qvel = self._qpos.copy(), self._qvel.copy()
        n = len(self.ids)
        force = self._drives.forces(qpos.reshape(-1, 3)[:n], qvel.reshape(-1, 3)[:n])
        self._applied[: 3 * n] = force.ravel()
        if self.movable_boxes:
            self._movable_boxes.rub()
        mujoco.mj_step(self.model, data)
        self._steps += 1
        if data.ncon:
            self._touching.append(self._contacts.after_step(data, qpos, qvel))

    def poses(self) -> Array:
        """(n, 3) x, y in m and yaw in rad (not wrapped) in the world frame: truth.

        NaN for a robot that has been taken out of the arena.
        """
        poses = self._places()
        poses[self._is_out] = np.nan
        return poses

    def _places(self) -> Array:
        return np.array(self._qpos[: 3 * len(self.ids)], dtype=np.float64).reshape(-1, 3)

    def twists(self) -> Array:
        """(n, 3) linear, angular, lateral velocity in each base frame over the last step: truth."""
        n = len(self.ids)
        vx, vy, angular = self._qvel[: 3 * n].reshape(-1, 3).T
        yaw = self._qpos[2 : 3 * n : 3] - angular * (self.dt / 2.0)
        cos, sin = np.cos(yaw), np.sin(yaw)
        twists = np.empty((n, 3))
        twists[:, 0] = cos * vx + sin * vy
        twists[:, 1] = angular
        twists[:, 2] = cos * vy - sin * vx
        return twists

    def contacts(self) -> list[Contact]:
        """The pairs that touched during the last call of `step`, each with its fastest approach."""
        return self._contacts.contacts(self._touching)

    def scans(self, robots: Indices) -> list[Scan]:
        """A fresh sweep of each of `robots` (m,), taken in one instant: now.

        It is not there yet: who hands it on holds it back for the robot's `scan_latency`.
        """
        poses = self.poses()
        if self.movable_boxes:
            poses = np.concatenate((poses, self._movable_boxes.poses()))
        ranges = self._noise.apply(robots, self._sensors.cast(poses, robots))
        return [self._scan(row, seen) for row, seen in zip(robots.tolist(), ranges, strict=True)]

    def _scan(self, robot: int, ranges: Array) -> Scan:
        spec = self.platforms[robot].scan
        seq = self._seq[robot]
        self._seq[robot] += 1
        return Scan(seq, self.time, ranges, spec.bearings, spec.range_min, spec.range_max)

    def odometry(self, robots: Indices | None = None) -> list[Odometry]:
        """The next reading of each of `robots` (all if None), in the frame of its own start."""
        chosen = np.arange(len(self.ids)) if robots is None else robots
        poses, twists = self._odometers.read(chosen, self._places(), self.twists())
        return [
            Odometry(self.time, Pose(*pose), Twist(*twist))
            for pose, twist in zip(poses.tolist(), twists.tolist(), strict=True)
        ]

    def readings(self, robot: int) -> Mapping[str, float]:
        """What the scalar sensors on the robot's axle read, by name: the fields where it stands."""
        return readings_at(self._fields, self.poses()[robot, :2])

    def box_poses(self) -> Array:
        """(m, 3) x, y in m and yaw in rad of the movable boxes; NaN while not in the arena."""
        return self._movable_boxes.poses()

    def place(self, box: str, pose: tuple[float, float, float]) -> None:
        """Put a movable box at rest at x, y in m and yaw in rad, wherever it was.

        SwarmError if it would stand in a robot, a wall or another thing; ConfigError if there is
        no such box. Nothing has changed then.
        """
        at = np.array(pose, dtype=np.float64)
        outlines = [
            (self.ids[row], transform(self.platforms[row].footprint, own))
            for row, own in enumerate(self.poses())
            if math.dist(own[:2], at[:2]) <= self._widest
        ]
        self._movable_boxes.place(box, at, outlines)

    def take_out(self, robot: int) -> None:
        """Take a robot's body out of the arena for good: nothing touches or sees it any more."""
        self._is_out[robot] = True
        geom = self.model.geom(self.ids[robot]).id
        self.model.geom_contype[geom] = self.model.geom_conaffinity[geom] = 0

    def remove(self, box: str) -> None:
        """Take a movable box out of the arena; SwarmError if it is not in it."""
        self._movable_boxes.remove(box)
