"""Mode `barrier` with its compiled kernel: the same decisions as barrier.py in microseconds."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from swarmd.core.kernels import compiled_kernel
from swarmd.core.messages import LimitingObstacle
from swarmd.core.values import ZERO, Array, Odometry, Platform, Pose, Scan, TouchZone, Twist
from swarmd.protection.barrier import Barrier
from swarmd.protection.blind_zone import BlindZoneMemory
from swarmd.protection.constraints import direction_and_speed, linear_limit, touch_directions
from swarmd.protection.decision import DecisionContext, ModeDecision, ToldObstacle
from swarmd.protection.footprint import ScanGeometry
from swarmd.sensing.rays import unit_vectors

PASSES, LIMITS, REPEATS, STOPS = range(4)  # what the kernel's `decide` returns
_NOTHING_HIDDEN = np.empty((0, 3))
_NO_AGES = np.empty(0)


class Derived(NamedTuple):
    """What the kernel needs beside the settings and the outline; units: m, s, rad."""

    angular: float
    offset: tuple[float, float]
    radius: float
    blind: float
    surface_speed: float
    fresh: float
    fastest: float
    within: float
    stale: float
    side_reserve: float
    may_creep: bool


def make_barrier(platform: Platform) -> Barrier:
    """The arbiter of mode `barrier`: with its kernel where that was compiled."""
    kernel = compiled_kernel("swarmd.protection.barrier_kernel")
    return Barrier(platform) if kernel is None else CompiledBarrier(platform, kernel)


class CompiledBarrier(Barrier):
    """As `Barrier`; scans, dead reckoning and decisions are the kernel's. Units: m, s, rad."""

    def __init__(self, platform: Platform, kernel: Any) -> None:
        """`kernel` is the module barrier_kernel."""
        super().__init__(platform)
        derived = Derived(
            angular=platform.limits.angular,
            offset=platform.scan.offset,
            radius=self._radius,
            blind=self._blind,
            surface_speed=self._surface_speed,
            fresh=self._binding_range.fresh,
            fastest=self._binding_range.fastest,
            within=self._within,
            stale=self._stale,
            side_reserve=self._side_reserve,
            may_creep=self._may_creep,
        )
        self._kernel = kernel.BarrierKernel(self._settings, self._outline, derived)
        self._directions: Array | None = None
        self._odometry: Odometry | None = None
        self._touch: TouchZone | None = None
        self._told: tuple[ToldObstacle, ...] = ()
        self._decision = ModeDecision(ZERO, is_active=False)

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """As `Barrier.observe`."""
        kernel = self._kernel
        if context.odometry is not None:
            self._record(context.odometry)
        directions = geometry.directions(scan)
        if directions is not self._directions:
            self._directions = directions
            kernel.set_rays(np.ascontiguousarray(directions, np.float64))
        ranges = np.asarray(scan.ranges, np.float64)
        ages = _NO_AGES if scan.ages is None else np.asarray(scan.ages, np.float64)
        age, odometry_age = context.scan_age or 0.0, context.odometry_age or 0.0
        newest, delay = self._newest_age(scan), context.scan_delay
        if not kernel.begin_scan(context.now, age, newest, delay, odometry_age, ages):
            kernel.find_min_gap(ranges, scan.range_min)
            return
        hidden = _NOTHING_HIDDEN
        if self._memory is not None:
            moved = Pose(kernel.moved_x, kernel.moved_y, kernel.moved_yaw)
            self._memory.update(scan, geometry, moved, kernel.seconds)
            if len(self._memory.bearings):
                hidden = _rays_and_ranges(self._memory)
        kernel.take_scan(ranges, scan.range_min, ages, hidden)

    @property
    def min_gap(self) -> float | None:
        """The m from the outline to the nearest return of the last scan; None without a return."""
        gap: float | None = self._kernel.min_gap
        return gap

    def decide(
        self, requested: Twist, context: DecisionContext, *, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """As `Barrier.decide`."""
        odometry = context.odometry
        if odometry is not None and odometry is not self._odometry:
            self._record(odometry)
        if touch is not self._touch:
            self._grant(touch)
        told = context.told + context.near if context.near else context.told
        if told != self._told:
            self._told = told
            table = [(one.x, one.y, one.radius, one.age) for one in self._told]
            self._kernel.set_told(np.array(table, np.float64).reshape(-1, 4))
        if requested.lateral == 0.0:
            along, speed, limit = (1.0, 0.0), requested.linear, self._limits.linear
        else:
            along, speed = direction_and_speed(requested)
            limit = linear_limit(self._limits, along)
        kernel = self._kernel
        result = kernel.decide(
            context.now,
            math.nan if context.scan_age is None else context.scan_age,
            math.nan if context.odometry_age is None else context.odometry_age,
            odometry is not None,
            along[0],
            along[1],
            limit,
            speed,
            requested.angular,
            command.linear,
            command.angular,
            command.lateral,
        )
        if result == PASSES:
            return ModeDecision(requested, is_active=False)
        if result == REPEATS:
            return self._decision
        if result == STOPS:
            return ModeDecision(ZERO, is_active=True)
        twist = Twist(kernel.linear * along[0], kernel.angular, kernel.linear * along[1])
        rows = tuple([LimitingObstacle(*row) for row in kernel.report()])
        self._decision = ModeDecision(twist, is_active=True, rows=rows)
        return self._decision

    def _record(self, odometry: Odometry) -> None:
        """Hand a reading to the dead reckoning."""
        self._odometry = odometry
        pose, twist = odometry.pose, odometry.twist
        self._kernel.reading(
            odometry.stamp, pose.x, pose.y, pose.yaw, twist.linear, twist.angular, twist.lateral
        )

    def _grant(self, touch: TouchZone | None) -> None:
        """Grant a touch zone, or none."""
        if touch is None:
            self._kernel.end_touch()
        else:
            table = np.stack(touch_directions(self._outline.corners, touch), axis=1)
            self._kernel.set_touch(touch.bearing, touch.half_width, touch.speed, table)
        self._touch = touch


def _rays_and_ranges(memory: BlindZoneMemory) -> Array:
    """(n, 3) unit vectors to hidden obstacles, and the m that each may be from the lidar."""
    bearings = memory.bearings
    table = np.empty((len(bearings), 3))
    table[:, :2], table[:, 2] = unit_vectors(bearings), memory.nearest
    return table
