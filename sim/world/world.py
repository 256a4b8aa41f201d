"""The simulated world: robots in an arena, their sensors, and ground truth for metrics.

Live runs and lockstep use this class. Equal commands at equal steps give bit-identical poses. Robot
i of `ids` is row i of every array.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import repeat

import mujoco
import numpy as np

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array, Odometry, Platform, Pose, Scan, SharedPose, Twist
from swarmd.sim.world import base, bodies
from swarmd.sim.world.active_faults import ActiveFaults
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.batteries import charge, has_battery
from swarmd.sim.world.contacts import Contact, ContactPoints, ContactReader
from swarmd.sim.world.delay_queue import ScanTransport
from swarmd.sim.world.detector import ObjectsAround
from swarmd.sim.world.faults import FaultKind
from swarmd.sim.world.geometry import Indices, radius, transform
from swarmd.sim.world.hovering import Hovering
from swarmd.sim.world.item_kind import ItemKind
from swarmd.sim.world.items import Items
from swarmd.sim.world.lidar import LidarModel, RangeSensors
from swarmd.sim.world.light import IsClear, LightField, Shadows
from swarmd.sim.world.movable_boxes import MovableBoxes
from swarmd.sim.world.noise import NoisyLidar
from swarmd.sim.world.odometer import Odometers
from swarmd.sim.world.realism import IDEAL, Realism
from swarmd.sim.world.rolling import RollingScans
from swarmd.sim.world.scalar_fields import Field, readings_at

TIME_STEP = 0.01  # s of a step
# m and rad, as of motion capture
_POSE_ERROR = 0.01
_POSE_YAW_ERROR = 0.01


class World:
    """Planar MuJoCo bodies with range sensors and odometry, movable boxes, and items.

    - `movable_boxes`: names of the movable boxes; name i is row i of `box_poses()` and of
      `box_shapes` (m, 4, 2), the outlines in the frames of the boxes.
    - `loose`, `loose_shapes` and `loose_poses()`: names, outlines and poses of the movable boxes
      and, behind them, of the items.
    - `grips` (n,): the command of each gripper, True to close.
    - `rings`: the rows of robots with a ring of range sensors; `ring_rates` (r,): the rate of each
      ring in Hz.
    - `posed`: the rows of robots whose pose in the world is measured.
    - `measures_late`: of the rolling scans in progress, True lets `arrived_scans` measure only the
      scans that end. The caller then measures the others by `measure_rays`. The ranges are equal.
    """

    def __init__(
        self,
        robots: Mapping[str, Platform],
        arena: Arena,
        starts: Array,
        *,
        lidars: LidarModel = LidarModel(),  # noqa: B008  # it is frozen
        realism: Realism = IDEAL,
        seed: int = 0,
        fields: Sequence[Field] = (),
        items: Sequence[ItemKind] = (),
    ) -> None:
        """Start a world with all robots at rest.

        `robots`: the platform of each of n robots by its id. `starts` (n, 3): x, y, yaw in m and
        rad. `lidars`: what lidars detect of robots. `realism`: delays and errors of bases and
        sensors. `seed`: of these errors and of random places of `items`. `fields`: sampled by
        `readings`. `items`: the kinds of the items in `arena`.
        """
        n = len(robots)
        if starts.shape != (n, 3):
            raise ConfigError(f"{n} robots, but start poses of shape {starts.shape}")
        self.ids = tuple(robots)
        self.platforms = tuple(robots.values())
        self.arena = arena
        self.dt = TIME_STEP
        self._steps = 0
        self.time = 0.0
        """Simulated time in s."""
        self.fields = tuple(fields)
        self.faults = ActiveFaults(self.ids, seed, self.platforms, self.dt, bodies.value)
        # Each part needs the parts before it.
        self._begin_bodies(robots, starts)
        self._items = Items(items, arena, self.platforms, seed)
        self._begin_items(starts)
        self._begin_bases(realism, starts, seed)
        self._begin_lidars(lidars, realism, seed)
        self._begin_rings(realism, seed)
        # Delays scans on their way to the robots.
        self._transport = ScanTransport(realism.lidar, self.platforms, self.ids, seed)

    def _begin_bodies(self, robots: Mapping[str, Platform], starts: Array) -> None:
        """Build the model of MuJoCo, with robots and boxes at their start poses."""
        n = len(robots)
        arena = self.arena
        pucks = tuple(item for item in arena.items if item.mass is not None)
        self.model = bodies.build_model(robots, replace(arena, items=pucks), self.dt)
        self.data = mujoco.MjData(self.model)
        # Views of MuJoCo's memory.
        self._qpos = self.data.qpos
        self._qvel = self.data.qvel
        self._qpos[: 3 * n] = starts.ravel()
        self._robot_poses = self._qpos[: 3 * n].reshape(-1, 3)
        self._movable_boxes = MovableBoxes(arena, self.model, self.data, n)
        self.movable_boxes = self._movable_boxes.names
        self.box_shapes = self._movable_boxes.shapes
        self._contacts = ContactReader(self.model, n, n + len(self.movable_boxes))
        self._touching: list[ContactPoints] = []
        # Robots that were taken out of the arena.
        self._is_out = np.zeros(n, dtype=np.bool_)
        self._are_all_in = True
        shapes = [platform.footprint for platform in self.platforms]
        # m: the largest distance of the centres of a robot and a box that touch.
        self._widest = sum(
            max(map(radius, some), default=0.0) for some in (shapes, self.box_shapes)
        )
        self._shadows: Shadows | None = None  # made for the first line of sight

    def _begin_items(self, starts: Array) -> None:
        outlines = [
            transform(platform.footprint, start)
            for platform, start in zip(self.platforms, starts, strict=True)
        ]
        boxes = self.box_poses()
        is_there = np.isfinite(boxes[:, 0])
        outlines += list(transform(self.box_shapes[is_there], boxes[is_there]))
        self._items.begin(self.model, self.data, outlines)
        self.loose = (*self.movable_boxes, *self._items.names)
        self.loose_shapes = np.concatenate((self.box_shapes, self._items.shapes))
        self.grips = np.zeros(len(starts), dtype=np.bool_)
        mujoco.mj_forward(self.model, self.data)

    def _begin_bases(self, realism: Realism, starts: Array, seed: int) -> None:
        memory = self.data.qpos, self.data.qvel, self.data.qfrc_applied
        self._bases = base.Bases(realism.actuation, self.platforms, memory, self.dt)
        self._hovering = Hovering(self.platforms, self.ids, self._bases.drift, self.dt, seed)
        self._odometers = Odometers(realism.odometry, self.platforms, starts, self.ids, seed)
        self._commanded: Array = np.zeros_like(starts)
        self.posed = frozenset[int]()  # set by the caller

    def _begin_lidars(self, model: LidarModel, realism: Realism, seed: int) -> None:
        n = len(self.ids)
        self._noise = NoisyLidar(realism.lidar, self.platforms, self.ids, seed)
        # The ages of the rays of lidars that measure all rays at once, by row.
        self._at_once = [np.zeros(len(platform.scan.bearings)) for platform in self.platforms]
        for ages in self._at_once:
            ages.flags.writeable = False
        self._seq = [0] * n
        self._sensors = RangeSensors(self.platforms, self.arena, model.visibility)
        self._rolling: list[RollingScans] = []
        self._rolling_of: list[RollingScans | None] = [None] * n  # by row
        self._is_rolled = False  # the rolling rays of this step have been measured
        self.measures_late = False
        # A lidar of a platform with a sweep is rolling: its rays are measured one after the other.
        for lidar, rows in self._sensors.lidars if realism.lidar.rolling else ():
            platform = self.platforms[rows[0]]
            if platform.scan.sweep is not None:
                rolling = RollingScans(lidar, platform, n, self.dt, model.sectors)
                self._rolling.append(rolling)
                for row in rows.tolist():
                    self._rolling_of[row] = rolling

    def _begin_rings(self, realism: Realism, seed: int) -> None:
        """Set up the rings of range sensors."""
        n = len(self.ids)
        self._ring_seq = [0] * n
        self.rings = [row for row in range(n) if self.platforms[row].ranges is not None]
        specs = [platform.ranges or platform.scan for platform in self.platforms]
        rates = [specs[row].rate for row in self.rings]
        self.ring_rates: Array = np.array(rates, dtype=np.float64)
        if self.rings:
            ringed = [
                replace(platform, scan=scan)
                for platform, scan in zip(self.platforms, specs, strict=True)
            ]
            # The sensors of a ring are lower than lidars, and detect whole bodies.
            self._ring_sensors = RangeSensors(ringed, self.arena, "body")
            names = [f"ring of {robot}" for robot in self.ids]
            self._ring_noise = NoisyLidar(realism.lidar, ringed, names, seed)

    def set_commands(self, twists: Array) -> None:
        """Set the commands (n, 3) linear, angular, lateral of the bases in m/s and rad/s.

        Commands are clipped to the platform's limits, as firmware does. Non-finite values become 0.
        `realism` sets the delay and the acceleration limits of the bases.
        """
        self._commanded = twists.copy()
        self._bases.put(twists)

    def change_fault(self, kind: FaultKind, rows: Sequence[int], *, is_on: bool) -> None:
        """Begin or end a fault of robots `rows`, except one of processes, from now on."""
        if is_on:
            self.faults.begin(kind, rows, self.time)
        else:
            self.faults.end(kind, rows)
            self._bases.put(self._commanded)

    def step(self, k: int = 1) -> None:
        """Advance by `k` steps of `dt`."""
        self._touching = []
        for _ in range(k):
            self._step()

    def _step(self) -> None:
        data = self.data
        self.measure_rays()
        self._hovering.step()
        if faulty := self.faults.rows("base"):
            followed = self._commanded.copy()
            for row in faulty:
                followed[row] = self.faults.command(row, followed[row])
            self._bases.put(followed)
        self._bases.drive()
        if self.movable_boxes:
            self._movable_boxes.apply_friction()
        self._items.apply_friction()
        mujoco.mj_step(self.model, data)
        self._steps += 1
        self.time = self._steps * self.dt
        if self._items.has_flat:
            self._items.follow(self._robot_poses, self.grips)
        if data.ncon:
            self._touching.append(self._contacts.after_step(data, *self._bases.before))
        self._is_rolled = False

    def measure_rays(self, *, ends_only: bool = False) -> None:
        """Measure the rays of this step of all rolling scans, unless already done.

        `ends_only`: of scans that end at this step, and no others. `step` measures what is left.
        """
        if self._is_rolled or not self._rolling:
            return
        self._is_rolled = not ends_only
        poses = self._all_poses()
        for rolling in self._rolling:
            for scan in rolling.advance(poses, self._steps, ends_only=ends_only):
                ranges = self._noise.measured(scan.row, scan.ranges)
                sent = self._scan(scan.row, ranges, scan.begun * self.dt, scan.ages)
                self._send(scan.row, sent)

    def poses(self) -> Array:
        """(n, 3) x, y in m and yaw in rad (not wrapped), world frame, ground truth.

        NaN for a robot that was taken out of the arena.
        """
        poses = self._places()
        if not self._are_all_in:
            poses[self._is_out] = np.nan
        return poses

    def _places(self) -> Array:
        places: Array = self._robot_poses.copy()
        return places

    def twists(self) -> Array:
        """(n, 3) linear, angular, lateral velocity in each base frame over the last step, exact."""
        n = len(self.ids)
        vx, vy, angular = self._qvel[: 3 * n].reshape(-1, 3).T
        yaw = self._qpos[2 : 3 * n : 3] - angular * (self.dt / 2.0)
        cos = np.cos(yaw)
        sin = np.sin(yaw)
        twists = np.empty((n, 3))
        twists[:, 0] = cos * vx + sin * vy
        twists[:, 1] = angular
        twists[:, 2] = cos * vy - sin * vx
        return twists

    def contacts(self) -> list[Contact]:
        """The pairs in contact during the last `step`, each with its highest closing speed."""
        return self._contacts.contacts(self._touching)

    def begin_scans(self, robots: Indices) -> None:
        """Begin a scan of each of `robots` (m,) now; call this before `arrived_scans`.

        The rays of a rolling lidar are measured over the following steps. All other lidars measure
        their rays at once.
        """
        at_once = []
        for row in robots.tolist():
            rolling = self._rolling_of[row]
            if rolling is None:
                at_once.append(row)
            else:
                rolling.begin(row)
        if at_once:
            scans = self.scans(np.array(at_once, dtype=np.intp))
            for row, scan in zip(at_once, scans, strict=True):
                self._send(row, scan)

    def _send(self, row: int, scan: Scan) -> None:
        """Send a scan whose last ray is measured now to its robot, with the faults of its lidar."""
        seen, delay = self.faults.scan(row, scan) if self.faults.have_effect else (scan, 0.0)
        if seen is not None:
            self._transport.send(row, seen, self.time + delay)

    def arrived_scans(self) -> list[tuple[int, Scan]]:
        """The scans that have arrived since the last call, with their rows, in order of rows."""
        self.measure_rays(ends_only=self.measures_late)
        return self._transport.arrived(self.time)

    def scans(self, robots: Indices) -> list[Scan]:
        """A scan of each of `robots` (m,), with all rays measured now, without transport delay."""
        ranges = self._noise.apply(robots, self._sensors.cast(self._all_poses(), robots))
        return [
            self._scan(row, seen, self.time)
            for row, seen in zip(robots.tolist(), ranges, strict=True)
        ]

    def _all_poses(self) -> Array:
        """(n + m, 3) poses of the robots, then of the movable boxes."""
        poses = self.poses()
        if self.movable_boxes:
            poses = np.concatenate((poses, self._movable_boxes.poses()))
        return poses

    def ring_scan(self, robot: int) -> Scan:
        """A scan of the robot's ring of range sensors, with all sensors measured now."""
        spec = self.platforms[robot].ranges
        assert spec is not None, f"{self.ids[robot]} has no ring"
        (seen,) = self._ring_sensors.cast(self._all_poses(), np.array([robot], dtype=np.intp))
        ranges = self._ring_noise.measured(robot, seen)
        seq = self._ring_seq[robot]
        self._ring_seq[robot] += 1
        return Scan(seq, self.time, ranges, spec.bearings, spec.range_min, spec.range_max)

    def _scan(self, robot: int, ranges: Array, stamp: float, ages: Array | None = None) -> Scan:
        spec = self.platforms[robot].scan
        seq = self._seq[robot]
        self._seq[robot] += 1
        is_rolling = spec.sweep is not None or spec.is_sweep_unknown  # by the platform
        if ages is None and is_rolling:
            ages = self._at_once[robot]
        return Scan(seq, stamp, ranges, spec.bearings, spec.range_min, spec.range_max, ages)

    def odometry(self, robots: Indices | None = None) -> list[Odometry]:
        """The next reading of each of `robots` (all if None), in the frame of its own start."""
        chosen = np.arange(len(self.ids)) if robots is None else robots
        now = self.time
        poses, twists = self._odometers.read(chosen, self._places(), self.twists())
        places = map(Pose, *poses.T.tolist())
        speeds = map(Twist, *twists.T.tolist())
        readings = list(map(Odometry, repeat(now), places, speeds))
        if self.faults.have_effect:
            readings = list(map(self.faults.odometry, chosen.tolist(), readings))
        return readings

    def readings(self, robot: int) -> Mapping[str, float]:
        """The readings of a robot by name: fields at its sensors or axle, and items near it."""
        is_clear = None
        if any(isinstance(field, LightField) and field.shadows for field in self.fields):
            is_clear = self._clear_around(robot)
        pose = self.poses()[robot]
        of_fields = readings_at(self.fields, self.platforms[robot].sensors, pose, is_clear)
        of_fields |= self._hovering.readings(robot)
        of_fields |= self.faults.charge(robot, charge(self.platforms[robot], self.time))
        return of_fields | self._items.readings(robot, pose) if self._items.names else of_fields

    @property
    def has_readings(self) -> bool:
        """Whether robots read anything besides their scans and odometry."""
        has_more = self._hovering or any(map(has_battery, self.platforms))
        return bool(self.fields or self._items.names or has_more)

    def shared_pose(self, robot: int, stamp: float) -> SharedPose:
        """The robot's pose in the frame `world`, without an error but those of `faults`."""
        tracked = self.faults.pose(robot, self.poses()[robot], self.time)
        pose = Pose(*tracked.tolist())
        return SharedPose(stamp, pose, _POSE_ERROR, _POSE_YAW_ERROR, "world")

    def objects_around(self, robot: int) -> ObjectsAround:
        """The objects that a robot may recognise: all other robots, boxes and lamps."""
        poses = self._all_poses()
        names = [("robot", name) for name in self.ids]
        names += [("box", name) for name in self.movable_boxes]
        shapes = [*(platform.footprint for platform in self.platforms), *self.box_shapes]
        lamps = [field for field in self.fields if isinstance(field, LightField)]
        places = np.array([*poses[:, :2], *(lamp.center for lamp in lamps)])
        places[robot] = np.nan  # no robot recognises itself
        extents = np.array([*map(radius, shapes), *(0.0 for _ in lamps)])
        names += [("lamp", lamp.name) for lamp in lamps]
        return ObjectsAround(poses[robot], names, places, extents, self._clear_around(robot))

    def _clear_around(self, robot: int) -> IsClear:
        """The test for lines of sight from a robot, which its own body does not block."""
        if self._shadows is None:
            shapes = [platform.footprint for platform in self.platforms]
            self._shadows = Shadows([*shapes, *self.box_shapes], self.arena)
        return self._shadows.around(robot, self._all_poses())

    def change_fields(self, fields: Sequence[Field]) -> None:
        """Replace all fields that have the name of one of `fields`."""
        names = {field.name for field in fields}
        self.fields = (*(field for field in self.fields if field.name not in names), *fields)

    def box_poses(self) -> Array:
        """(m, 3) x, y in m and yaw in rad of the movable boxes; NaN for one outside the arena."""
        return self._movable_boxes.poses()

    def loose_poses(self) -> Array:
        """(m + q, 3) x, y in m and yaw in rad of the movable boxes and the items."""
        return np.concatenate((self.box_poses(), self._items.poses()))

    def place(self, box: str, pose: tuple[float, float, float]) -> None:
        """Put a movable box at rest at x, y in m and yaw in rad.

        Raises SwarmError if the box would overlap a robot or obstacle, and ConfigError for an
        unknown box; the world is then unchanged.
        """
        at = np.array(pose, dtype=np.float64)
        outlines = [
            (self.ids[row], transform(self.platforms[row].footprint, own))
            for row, own in enumerate(self.poses())
            if math.dist(own[:2], at[:2]) <= self._widest
        ]
        self._movable_boxes.place(box, at, outlines)

    def take_out(self, robot: int) -> None:
        """Remove a robot from contacts and scans for good."""
        self._is_out[robot] = True
        self._are_all_in = False
        self._items.release(robot)
        self.grips[robot] = False
        geom = self.model.geom(self.ids[robot]).id
        self.model.geom_contype[geom] = 0
        self.model.geom_conaffinity[geom] = 0

    def remove(self, box: str) -> None:
        """Take a movable box out of the arena; SwarmError if it is not there."""
        self._movable_boxes.remove(box)
