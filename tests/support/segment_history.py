"""One robot whose lidar measures its rays one after the other, among discs that move; exact.

The judge of segments (swarmd/protection/fresh_rays.py): all places and times are known. It shares
no code with protection.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from swarmd.core.values import ZERO, Array, Odometry, Platform, Pose, Scan, Twist
from swarmd.protection.decision import ModeDecision
from swarmd.protection.footprint import ScanGeometry
from swarmd.robot.sensors import Sensors
from swarmd.settings.platforms import load_platform

TURN = 0.2  # s
RAYS = 360
SEGMENTS = 8
OTHERS_SPEED = 0.30  # m/s
TRANSPORT = 0.001  # s
ROOM = 2.5  # m, radius of the room
NEAREST = 0.24  # m from the axle that a disc keeps
_STEP = 0.0025  # s
_BURGER = load_platform("burger")
PLATFORM: Platform = replace(
    _BURGER,
    scan=replace(
        _BURGER.scan,
        segments=SEGMENTS,
        near="reported",
        zero="no_return",
        range_min=0.05,
        is_noisy=False,
    ),
)


@dataclass(frozen=True, slots=True)
class Arrival:
    """What arrives at `at` s: odometry, a segment or a whole turn."""

    at: float
    kind: str
    value: Any


class SegmentHistory:
    """A random history: the robot, the discs, and what the lidar measures of them."""

    def __init__(self, seed: int, seconds: float, discs: int = 4) -> None:
        self._rng = np.random.default_rng(seed)
        self.seconds = seconds
        self._count = int(seconds / _STEP) + 200
        self._poses = self._drive()
        self.radii = self._rng.uniform(0.04, 0.1, discs)
        self._places = self._move(discs)
        self.measured: list[Array] = []  # (k, 3) s, x and y of the returns of each turn

    def _drive(self) -> Array:
        poses, (x, y, yaw), twist = np.empty((self._count, 3)), (0.0, 0.0, 0.0), (0.0, 0.0)
        for k in range(self._count):
            if k % 80 == 0:
                twist = self._rng.uniform(-0.22, 0.22), self._rng.uniform(-2.0, 2.0)
            poses[k] = x, y, yaw
            x += twist[0] * _STEP * math.cos(yaw)
            y += twist[0] * _STEP * math.sin(yaw)
            yaw += twist[1] * _STEP
        return poses

    def _move(self, discs: int) -> Array:
        """(steps, discs, 2) places: discs circle around the robot, or move anyhow."""
        angles = self._rng.uniform(0.0, 2.0 * math.pi, discs)
        places = np.empty((self._count, discs, 2))
        places[0] = np.column_stack((np.cos(angles), np.sin(angles)))
        places[0] *= self._rng.uniform(0.4, 0.8, (discs, 1))
        headings = angles.copy()
        for k in range(1, self._count):
            offsets = places[k - 1] - self._poses[k - 1, :2]
            if k % 40 == 1:
                around = np.arctan2(offsets[:, 1], offsets[:, 0])
                sides = self._rng.choice([-0.5, 0.5], discs) * math.pi
                free = self._rng.uniform(-math.pi, math.pi, discs)
                circles = self._rng.random(discs) < 0.6
                headings = np.where(circles, around + sides, free)
            ways = np.column_stack((np.cos(headings), np.sin(headings)))
            far = np.hypot(offsets[:, 0], offsets[:, 1])
            is_near = far < NEAREST + self.radii
            ways[is_near] = offsets[is_near] / far[is_near, None]
            places[k] = places[k - 1] + OTHERS_SPEED * _STEP * ways
        return places

    def _at(self, table: Array, times: Array) -> Array:
        steps = times / _STEP
        before = np.clip(np.floor(steps).astype(int), 0, self._count - 2)
        share = (steps - before).reshape(-1, *(1,) * (table.ndim - 1))
        between: Array = table[before] * (1.0 - share) + table[before + 1] * share
        return between

    def pose(self, now: float) -> Array:
        """(3,) x, y in m and yaw in rad of the robot."""
        pose: Array = self._at(self._poses, np.array([now]))[0]
        return pose

    def discs(self, now: float) -> Array:
        """(discs, 2) the middles in m."""
        places: Array = self._at(self._places, np.array([now]))[0]
        return places

    def lidar(self, now: float) -> Array:
        """(2,) the place of the lidar in m."""
        x, y, yaw = self.pose(now)
        along, aside = PLATFORM.scan.offset
        cos, sin = math.cos(yaw), math.sin(yaw)
        return np.array((x + cos * along - sin * aside, y + sin * along + cos * aside))

    def _ranges(self, times: Array, bearings: Array) -> tuple[Array, Array]:
        """(n,) ranges in m of rays, and (n, 2) the places of their returns."""
        poses, discs = self._at(self._poses, times), self._at(self._places, times)
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        along, aside = PLATFORM.scan.offset
        start = poses[:, :2] + np.column_stack(
            (cos * along - sin * aside, sin * along + cos * aside)
        )
        rays = np.column_stack((np.cos(bearings + poses[:, 2]), np.sin(bearings + poses[:, 2])))
        to_discs = discs - start[:, None]
        ahead = (to_discs * rays[:, None]).sum(axis=2)
        beside = np.abs(to_discs[:, :, 1] * rays[:, :1] - to_discs[:, :, 0] * rays[:, 1:])
        chord = np.sqrt(np.maximum(self.radii**2 - beside**2, 0.0))
        hits = np.where((beside < self.radii) & (ahead > 0.0), ahead - chord, np.inf).min(axis=1)
        middle = (start * rays).sum(axis=1)
        wall = np.sqrt(middle**2 - (start**2).sum(axis=1) + ROOM**2) - middle
        ranges = np.minimum(hits, wall)
        return ranges, start + ranges[:, None] * rays

    def arrivals(self, lost: float = 0.0) -> Iterator[Arrival]:
        """All inputs in order; a share `lost` of the segments, and a quarter of it of the turns."""
        inputs = [
            Arrival(0.05 * k, "odometry", self._odometry(0.05 * k))
            for k in range(int(self.seconds / 0.05))
        ]
        for turn in range(int(self.seconds / TURN)):
            inputs += self._turn(turn, lost)
        yield from sorted(inputs, key=lambda arrival: arrival.at)

    def _odometry(self, now: float) -> Odometry:
        pose, later = self.pose(now), self.pose(now + _STEP)
        way = (later - pose) / _STEP
        ahead = way[0] * math.cos(pose[2]) + way[1] * math.sin(pose[2])
        return Odometry(now, Pose(*pose.tolist()), Twist(float(ahead), float(way[2])))

    def _turn(self, turn: int, lost: float) -> Iterator[Arrival]:
        spec, begin = PLATFORM.scan, turn * TURN
        order = np.argsort((-spec.bearings - math.radians(0.5)) % (2.0 * math.pi), kind="stable")
        times = begin + TURN / RAYS * np.arange(RAYS, dtype=np.float64)
        ranges, places = self._ranges(times, spec.bearings[order])
        self.measured.append(np.column_stack((times, places)))
        limits = spec.range_min, spec.range_max
        for number in range(SEGMENTS - 1):
            own = slice(number * RAYS // SEGMENTS, (number + 1) * RAYS // SEGMENTS)
            ages = times[own][-1] - times[own]
            part = Scan(turn, times[own][0], ranges[own], spec.bearings[order[own]], *limits, ages)
            if self._rng.random() >= lost:
                yield Arrival(times[own][-1] + TRANSPORT, "segment", part)
                if self._rng.random() < 0.05:
                    yield Arrival(times[own][-1] + 0.03, "segment", part)
        all_ranges, ages = np.empty(RAYS), np.empty(RAYS)
        all_ranges[order], ages[order] = ranges, times[-1] - times
        if self._rng.random() >= 0.25 * lost:
            whole = Scan(turn, begin, all_ranges, spec.bearings, *limits, ages)
            yield Arrival(times[-1] + TRANSPORT, "scan", whole)


class Watched:
    """A barrier that takes the inputs, and the near returns that it holds, in the world."""

    def __init__(self, barrier: Any, *, takes_segments: bool = True) -> None:
        """`barrier`: interpreted, so that its parts can be read."""
        self._barrier, self._takes_segments = barrier, takes_segments
        self._sensors, self._geometry = Sensors(PLATFORM), ScanGeometry(PLATFORM.scan)
        self.taken = 0  # segments
        self.ignored: list[str] = []

    def take(self, arrival: Arrival) -> None:
        """Take an input."""
        sensors, now = self._sensors, arrival.at
        if arrival.kind == "odometry":
            sensors.on_odometry(arrival.value, now)
        elif arrival.kind == "scan":
            if sensors.on_scan(arrival.value, now):
                assert sensors.scan is not None
                self._barrier.observe(sensors.scan, self._geometry, sensors.context(now))
        elif self._takes_segments:
            segment = sensors.on_segment(arrival.value, now)
            if isinstance(segment, str):
                self.ignored.append(segment)
            elif segment is not None:
                self.taken += 1
                self._barrier.observe_segment(segment, sensors.context(now))

    def decide(self, requested: Twist, now: float) -> ModeDecision:
        """The decision at `now` for a robot that stands."""
        context = self._sensors.context(now)
        decision: ModeDecision = self._barrier.decide(requested, context, ZERO, None)
        return decision

    def returns(self, lidar: SegmentHistory) -> Array:
        """(k, 3) x, y in m in the world, and the time in s, of the near returns."""
        feasible = self._barrier._feasible
        motion, points = feasible.motion, feasible.near.points
        if not math.isfinite(motion.measured_at):
            return np.empty((0, 3))
        x, y, yaw = lidar.pose(motion.measured_at)
        cos, sin = math.cos(yaw), math.sin(yaw)
        rows = [
            (
                x + cos * points.x[i] - sin * points.y[i],
                y + sin * points.x[i] + cos * points.y[i],
                motion.measured_at - points.age[i],
            )
            for i in range(points.count)
        ]
        return np.array(rows).reshape(-1, 3)
