"""The simulated world: bodies in an arena, their sensors, and the truth for metrics alone.

One structure of arrays for real time and lockstep; deterministic: the same commands at the same
steps give bit-identical poses. Robot i of `ids` is row i of every array.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from swarmd.errors import ConfigError
from swarmd.sim import bodies
from swarmd.sim.arena import Arena
from swarmd.sim.lidar import Indices, Lidar
from swarmd.sim.visibility import Scene
from swarmd.values import Array, Neighbor, Odometry, Platform, Pose, Scan, Twist

Visibility = Literal["body", "real"]


@dataclass(frozen=True, slots=True)
class Contact:
    """Two things that touch: robot ids, or `wall_east`, `box_0`, `pole_0` for `b`.

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


class World:
    """Planar MuJoCo bodies with ideal odometry and exact range sensors."""

    def __init__(
        self,
        robots: Mapping[str, Platform],
        arena: Arena,
        starts: Array,
        *,
        visibility: Visibility = "body",
        radio_range: float | None = None,
        dt: float = 0.01,
    ) -> None:
        """A world at rest. `starts` (n, 3) x, y, yaw; `radio_range` None: all hear each other.

        `visibility`: what a range sensor sees of another robot: its whole footprint, or only what
        the sensor's plane really meets. `body` is the default since the published behaviours need
        it: with true heights a Waffle Pi sees of another a lidar housing 0.11 m wide, 3 rays at
        2 m, and protection that counts more than 5 rays is blind beyond 0.9 m.
        """
        if starts.shape != (len(robots), 3):
            raise ConfigError(f"{len(robots)} robots but start poses of shape {starts.shape}")
        self.ids = tuple(robots)
        self.dt = dt
        self.platforms = tuple(robots.values())
        self.arena = arena
        self.radio_range = radio_range
        self.model = bodies.build_model(robots, arena, dt)
        self.data = mujoco.MjData(self.model)
        self._starts = np.array(starts, dtype=np.float64)
        self.data.qpos[:] = self._starts.ravel()
        mujoco.mj_forward(self.model, self.data)
        self._limits = np.array(
            [[p.limits.linear, p.limits.angular, p.limits.lateral] for p in self.platforms]
        ).reshape(-1, 3)
        self._gains = np.array([_accelerations(p) for p in self.platforms]).reshape(-1, 3) * dt
        self._wanted = np.zeros((len(robots), 3))
        self._driven = np.zeros((len(robots), 3))
        self._steps = 0
        self._seq = np.zeros(len(robots), dtype=np.int64)
        self._touching: dict[tuple[str, str], Contact] = {}
        self._owners = self.model.geom_bodyid - 1
        names = list(dict.fromkeys(p.name for p in self.platforms))
        self._kinds = np.array([names.index(p.name) for p in self.platforms], dtype=np.intp)
        first = [self.platforms[list(self._kinds).index(i)] for i in range(len(names))]
        self._lidars = [Lidar(platform.scan) for platform in first]
        self._scenes = [
            Scene(
                arena,
                self.platforms,
                plane=bodies.value(p, "scan_height") if visibility == "real" else None,
            )
            for p in first
        ]

    @property
    def time(self) -> float:
        """Simulated time in s since the world was made."""
        return self._steps * self.dt

    def set_commands(self, twists: Array) -> None:
        """What the bases are to do from now on: (n, 3) linear, angular, lateral.

        Held within each platform's limits, as a base's firmware would; what is not finite is 0.
        """
        self._wanted = np.clip(
            np.where(np.isfinite(twists), twists, 0.0), -self._limits, self._limits
        )

    def step(self, k: int = 1) -> None:
        """Advance by `k` steps of `dt`."""
        self._touching = {}
        for _ in range(k):
            self._step()

    def _step(self) -> None:
        data = self.data
        self._driven += np.clip(self._wanted - self._driven, -self._gains, self._gains)
        linear, angular, lateral = self._driven.T
        # Half a step ahead, the heading at which this step's displacement is a chord of the arc.
        yaw = data.qpos[2::3] + angular * (self.dt / 2.0)
        cos, sin = np.cos(yaw), np.sin(yaw)
        data.ctrl[0::3] = cos * linear - sin * lateral
        data.ctrl[1::3] = sin * linear + cos * lateral
        data.ctrl[2::3] = angular
        before = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_step(self.model, data)
        self._steps += 1
        if data.ncon:
            for contact in self._contacts_of(*before):
                known = self._touching.get((contact.a, contact.b))
                if known is None or contact.closing_speed > known.closing_speed:
                    self._touching[contact.a, contact.b] = contact

    def _contacts_of(self, qpos: Array, qvel: Array) -> Iterator[Contact]:
        """Each touching pair of geoms, at the poses and velocities before the step."""
        found = self.data.contact
        for geoms, depth, place, frame in zip(
            found.geom, found.dist, found.pos, found.frame, strict=True
        ):
            if depth > 0.0:
                continue
            a, b = (int(geom) for geom in geoms)
            speeds = (
                _speed_at(place, frame[:3], self._owners[a], qpos, qvel),
                -_speed_at(place, frame[:3], self._owners[b], qpos, qvel),
            )
            if (self._owners[b] < 0, b) < (self._owners[a] < 0, a):  # the robot first, then by row
                a, b, speeds = b, a, speeds[::-1]
            names = (self.model.geom(a).name, self.model.geom(b).name)
            yield Contact(*names, *speeds)

    def poses(self) -> Array:
        """(n, 3) x, y in m and yaw in rad (not wrapped) in the world frame: truth."""
        return np.array(self.data.qpos, dtype=np.float64).reshape(-1, 3)

    def twists(self) -> Array:
        """(n, 3) linear, angular, lateral velocity in each base frame over the last step: truth."""
        vx, vy, angular = self.data.qvel.reshape(-1, 3).T
        yaw = self.data.qpos[2::3] - angular * (self.dt / 2.0)
        cos, sin = np.cos(yaw), np.sin(yaw)
        return np.stack((cos * vx + sin * vy, angular, cos * vy - sin * vx), axis=-1)

    def contacts(self) -> list[Contact]:
        """The pairs that touched during the last call of `step`, each with its fastest approach."""
        return list(self._touching.values())

    def scans(self, robots: Indices) -> list[Scan]:
        """A fresh sweep of each of `robots` (m,), taken in one instant."""
        poses = self.poses()
        scans: dict[int, Scan] = {}
        for kind in np.unique(self._kinds[robots]):
            observers = robots[self._kinds[robots] == kind]
            targets = self._scenes[kind].targets(poses)
            ranges = self._lidars[kind].cast(poses[observers], observers, targets)
            for robot, row in zip(observers, ranges, strict=True):
                scans[int(robot)] = self._scan(int(robot), row)
        return [scans[int(robot)] for robot in robots]

    def _scan(self, robot: int, ranges: Array) -> Scan:
        spec = self.platforms[robot].scan
        seq = int(self._seq[robot])
        self._seq[robot] += 1
        return Scan(seq, self.time, ranges, spec.bearings, spec.range_min, spec.range_max)

    def odometry(self, robots: Indices | None = None) -> list[Odometry]:
        """Ideal odometry of each of `robots` (all if None), in the frame of its own start."""
        chosen = np.arange(len(self.ids)) if robots is None else robots
        poses, twists = self.poses(), self.twists()
        return [
            Odometry(self.time, _relative(poses[i], self._starts[i]), Twist(*map(float, twists[i])))
            for i in chosen
        ]

    def neighbors(self, robot: int) -> tuple[Neighbor, ...]:
        """The robots within radio range; a radio senses neither distance nor direction."""
        poses = self.poses()
        apart = np.hypot(*(poses[:, :2] - poses[robot, :2]).T)
        reach = math.inf if self.radio_range is None else self.radio_range
        return tuple(
            Neighbor(self.ids[i], 0.0)
            for i in range(len(self.ids))
            if i != robot and apart[i] <= reach
        )

    def readings(self, robot: int) -> Mapping[str, float]:
        """Scalar sensors by name: none of the platforms has one yet."""
        return {}


def _accelerations(platform: Platform) -> tuple[float, float, float]:
    linear = bodies.value(platform, "linear_acceleration")
    return linear, bodies.value(platform, "angular_acceleration"), linear


def _relative(pose: Array, start: Array) -> Pose:
    x, y = pose[:2] - start[:2]
    cos, sin = math.cos(start[2]), math.sin(start[2])
    yaw = (pose[2] - start[2] + math.pi) % (2.0 * math.pi) - math.pi
    return Pose(float(cos * x + sin * y), float(cos * y - sin * x), float(yaw))


def _speed_at(place: Array, normal: Array, robot: int, qpos: Array, qvel: Array) -> float:
    """The speed along `normal` of the robot's surface at `place`; 0 for the arena (-1)."""
    if robot < 0:
        return 0.0
    x, y, _ = qpos[3 * robot : 3 * robot + 3]
    vx, vy, angular = qvel[3 * robot : 3 * robot + 3]
    vx -= angular * (place[1] - y)
    vy += angular * (place[0] - x)
    return float(vx * normal[0] + vy * normal[1])
