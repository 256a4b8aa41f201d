"""Parts of mode `barrier`, each asked alone.

tests/robot/protection/test_barrier_compiled.py holds both forms together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from swarmd.core.values import Array, Odometry, Platform, Pose, Twist
from swarmd.settings.platforms import load_platform
from tests.support import kernel_forms
from tests.support.filter_sim import under_barrier

Point = tuple[float, float]
BURGER = load_platform("burger")
KERNEL = "swarmd.robot.protection.barrier"
interpreted_kernel = kernel_forms.interpreted(
    KERNEL, because="each part is a function or field of C"
)


def part(name: str) -> Any:
    """The module of a part, interpreted like the mode."""
    return kernel_forms.interpreted(
        f"swarmd.robot.protection.{name}", because="each part is a function or field of C"
    )


def interpreted(platform: Platform = BURGER, **settings: object) -> Any:
    """An interpreted mode of mode `barrier`, whose private parts Python reaches."""
    return interpreted_kernel.Barrier(under_barrier(platform, **settings))


def closing_cap(room: float, braking: float, others_speed: float, unseen: float) -> float:
    """The cap in m/s for obstacles that approach."""
    cap: float = part("closing_speed").closing_cap(room, braking, unseen, others_speed)
    return cap


def wall_cap(room: float, braking: float, error_speed: float, unseen: float) -> float:
    """The cap in m/s for a wall that stands."""
    cap: float = part("closing_speed").wall_cap(room, braking, unseen, error_speed)
    return cap


def reciprocal_cap(room: float, braking: float, unseen: float) -> float:
    """The cap in m/s towards robots with the same rule."""
    cap: float = part("closing_speed").reciprocal_cap(room, braking, unseen)
    return cap


def braking(linear: float, lever: float, slowing: float, turning: float) -> float:
    """The m/s2 at which the closing speed of a constraint can fall."""
    rate: float = part("closing_speed").closing_deceleration(linear, lever, slowing, turning)
    return rate


def nearest(polygon: Sequence[Point], requested: Point) -> Point:
    """The point of a convex polygon nearest to a requested one."""
    projection = _with_polygon(polygon)
    projection._find_nearest(*requested)
    return projection.x, projection.y


def clipped(polygon: Sequence[Point], a: float, b: float, cap: float) -> list[Point]:
    """The part of a convex polygon where a x + b y <= cap."""
    projection = _with_polygon(polygon)
    projection._clip(a, b, cap)
    corners = zip(projection._corner_x, projection._corner_y, strict=True)
    return list(corners)[: projection._sides]


def _with_polygon(polygon: Sequence[Point]) -> Any:
    projection = part("projection").Projection()
    for i, (x, y) in enumerate(polygon):
        projection._corner_x[i], projection._corner_y[i] = x, y
    projection._sides = len(polygon)
    return projection


def nearest_feasible(requested: Point, normals: Array, caps: Array) -> tuple[Point, list[int]]:
    """The nearest point in the box of the limits with normals (k, 2) @ point <= caps (k,).

    Also the indices of the constraints on which the point lies.
    """
    rows, projection = part("constraints").ConstraintRows(), part("projection").Projection()
    (rows.x, rows.y), rows.cap = normals.T.tolist(), caps.tolist()
    rows.all = len(caps)
    projection.project(rows, *requested)
    point = projection.x, projection.y
    tolerance = part("limiting_obstacles").BINDING_TOLERANCE
    tight = np.flatnonzero(normals @ point - caps >= -tolerance)
    return point, tight.tolist()


def speed_axes(along: Point, platform: Platform) -> Any:
    """The plane of the two speeds for a direction of the linear speed."""
    axes = part("constraints").SpeedAxes()
    (axes.along_x, axes.along_y), axes.limit = along, platform.limits.linear
    axes.angular_limit = platform.limits.angular
    return axes


def envelope(platform: Platform, speed: float, along: Point) -> tuple[Array, Array, Array]:
    """Vertices (48, 2), normals (48, 2) and caps (48,) of the envelope for a speed in m/s."""
    outline = part("outline").Outline(under_barrier(platform))
    rows = part("envelope").Envelope(outline, speed)
    rows.find_rows(speed_axes(along, platform))
    vertices = np.array((rows.vertex_x, rows.vertex_y)).T
    return vertices, np.array((rows.row_x, rows.row_y)).T, np.array(rows.row_cap)


class Separation(NamedTuple):
    """How an outline and a point are separated."""

    gap: float  # m
    direction: Point  # a unit vector from the outline to the point
    hidden: float  # m by which the blind zone reaches beyond the outline towards the point


def separation(outline: Any, x: float, y: float, blind: float = 0.0) -> Separation:
    """The separation of an outline and a point, with a lidar that is blind within a radius."""
    chunk = part("outline").Chunk()
    chunk.x[0], chunk.y[0], chunk.count = x, y, 1
    outline.separate(chunk, blind)
    return Separation(chunk.gap[0], (chunk.normal_x[0], chunk.normal_y[0]), chunk.hidden[0])


def outline_of(corners: Array, lidar: Point = (0.0, 0.0)) -> Any:
    """The outline of a robot with a lidar at a place."""
    scan = replace(BURGER.scan, offset=lidar)
    return part("outline").Outline(replace(BURGER, footprint=corners, scan=scan))


class DeadReckoning:
    """The poses that a mode computes from odometry."""

    def __init__(self) -> None:
        self._reckoning = interpreted(braking_linear=1.0, braking_angular=3.0)._feasible.reckoning
        self._pose = part("dead_reckoning").PlanarPose()

    @property
    def resets(self) -> int:
        """How often the clock went back or the pose jumped."""
        resets: int = self._reckoning.resets
        return resets

    def update(self, odometry: Odometry) -> None:
        """Record a reading."""
        self._reckoning.record(odometry)

    def pose(self, age: float, ago: float) -> Pose:
        """The pose `ago` s before now, `age` s after the last reading."""
        self._reckoning.find_pose(age, ago, self._pose)
        return Pose(self._pose.x, self._pose.y, self._pose.yaw)

    def predicted_pose(self, age: float, command: Twist) -> Pose:
        """The pose at which the next command takes effect, after the present one."""
        self._reckoning.predict_pose(
            age, command.linear, command.angular, command.lateral, self._pose
        )
        return Pose(self._pose.x, self._pose.y, self._pose.yaw)


def after_stop_check(
    platform: Platform,
    speeds: Point,
    points: Sequence[Point],
    *,
    along: Point,
    free: float,
    others_speed: float,
    braking: Point,
) -> Point:
    """The speeds that the stop check leaves beside points in the base frame.

    `free` m stay free around each point, which grow at `others_speed`.
    """
    barrier = interpreted(platform)
    stop, feasible = barrier._stop, barrier._feasible
    assumptions, constraints = feasible.assumptions, feasible.constraints
    assumptions.others_speed = others_speed
    assumptions.margin = free
    assumptions.braking_linear, assumptions.braking_angular = braking
    constraints.axes.along_x, constraints.axes.along_y = along
    constraints.axes.limit = platform.limits.linear
    placed = constraints.placed
    placed.reserve(len(points))
    placed.seen = len(points)
    for i, (x, y) in enumerate(points):
        placed.x[i], placed.y[i] = x, y
        placed.gap[i], placed.free[i] = feasible.outline.gap_of(x, y), free
        placed.others[i] = others_speed
    checked = part("stopping").Speeds()
    checked.linear, checked.angular = speeds
    stop.limit(checked)
    return checked.linear, checked.angular
