"""Parts of mode `barrier`, each asked alone.

tests/protection/test_barrier_compiled.py holds both forms together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from swarmd.core.values import Array, Odometry, Platform, Pose, Twist
from swarmd.settings.platforms import load_platform
from tests.support import kernel_forms
from tests.support.filter_sim import under_barrier

Point = tuple[float, float]
BURGER = load_platform("burger")
barrier = kernel_forms.interpreted(
    "swarmd.protection.barrier", because="each part is a function or field of C"
)


def interpreted(platform: Platform = BURGER, **settings: object) -> Any:
    """An interpreted arbiter of mode `barrier`, whose private parts Python reaches."""
    return barrier.Barrier(under_barrier(platform, **settings))


_ANY = interpreted()


def passive_cap(room: float, braking: float, others_speed: float, unseen: float) -> float:
    """The cap in m/s for obstacles that approach."""
    cap: float = barrier._cap(room, braking, unseen, others_speed, True)
    return cap


def reciprocal_cap(room: float, braking: float, unseen: float) -> float:
    """The cap in m/s towards robots with the same rule."""
    cap: float = barrier._reciprocal_cap(room, braking, unseen)
    return cap


def braking(linear: float, lever: float, slowing: float, turning: float) -> float:
    """The m/s2 at which the closing speed of a constraint can fall."""
    rate: float = barrier._braking(linear, lever, slowing, turning)
    return rate


def nearest(polygon: Sequence[Point], requested: Point) -> Point:
    """The point of a convex polygon nearest to a requested one."""
    _set_polygon(polygon)
    _ANY._nearest(*requested)
    return _ANY._point_x, _ANY._point_y


def clipped(polygon: Sequence[Point], a: float, b: float, cap: float) -> list[Point]:
    """The part of a convex polygon where a x + b y <= cap."""
    _set_polygon(polygon)
    _ANY._clip(a, b, cap)
    return list(zip(_ANY._poly_x, _ANY._poly_y, strict=True))[: _ANY._sides]


def _set_polygon(polygon: Sequence[Point]) -> None:
    spare = 100 * [0.0]
    _ANY._poly_x = [x for x, _ in polygon] + spare
    _ANY._poly_y = [y for _, y in polygon] + spare
    _ANY._clip_x, _ANY._clip_y = len(_ANY._poly_x) * [0.0], len(_ANY._poly_x) * [0.0]
    _ANY._sides = len(polygon)


def nearest_feasible(requested: Point, normals: Array, caps: Array) -> tuple[Point, list[int]]:
    """The nearest point in the box of the limits with normals (k, 2) @ point <= caps (k,).

    Also the indices of the constraints on which the point lies.
    """
    one = interpreted()
    (one._row_x, one._row_y), one._row_cap = normals.T.tolist(), caps.tolist()
    one._all = len(caps)
    one._project(*requested)
    point = one._point_x, one._point_y
    tight = np.flatnonzero(normals @ point - caps >= -barrier.BINDING_TOLERANCE)
    return point, tight.tolist()


def envelope(platform: Platform, speed: float, along: Point) -> tuple[Array, Array, Array]:
    """Vertices (48, 2), normals (48, 2) and caps (48,) of the envelope for a speed in m/s."""
    one = interpreted(platform)
    (one._along_x, one._along_y), one._limit = along, platform.limits.linear
    one._find_envelope(0, speed)
    rows = [(one._envelope_x[i], one._envelope_y[i]) for i in range(48)]
    caps = [one._envelope_cap[i] for i in range(48)]
    return np.array((one._way_x, one._way_y)).T, np.array(rows), np.array(caps)


def separation(one: Any, x: float, y: float) -> tuple[float, float, float]:
    """The gap in m from the outline to a point, and the unit vector there."""
    hidden_gap(one, x, y)
    return one._at_gap[0], one._at_nx[0], one._at_ny[0]


def hidden_gap(one: Any, x: float, y: float) -> float:
    """The m by which the blind zone reaches beyond the outline towards a point."""
    one._at_x[0], one._at_y[0] = x, y
    one._separate(1, one._blind)
    hidden: float = one._at_hidden[0]
    return hidden


def with_outline(corners: Array, lidar: Point = (0.0, 0.0), blind: float = 0.0) -> Any:
    """An arbiter of a robot with that outline, and a lidar that is blind within a radius."""
    one = interpreted(replace(BURGER, footprint=corners, scan=replace(BURGER.scan, offset=lidar)))
    one._blind = blind
    return one


class DeadReckoning:
    """The poses that an arbiter computes from odometry."""

    def __init__(self) -> None:
        self._of = interpreted(braking_linear=1.0, braking_angular=3.0)

    @property
    def resets(self) -> int:
        """How often the clock went back or the pose jumped."""
        resets: int = self._of._resets
        return resets

    def update(self, odometry: Odometry) -> None:
        """Record a reading."""
        self._of._record(odometry)

    def pose(self, age: float, ago: float) -> Pose:
        """The pose `ago` s before now, `age` s after the last reading."""
        self._of._pose(age, ago)
        return self._found()

    def predicted_pose(self, age: float, command: Twist) -> Pose:
        """The pose at which the next command takes effect, after the present one."""
        self._of._predicted_pose(age, command.linear, command.angular, command.lateral)
        return self._found()

    def _found(self) -> Pose:
        return Pose(self._of._pose_x, self._of._pose_y, self._of._pose_yaw)


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
    one = interpreted(platform)
    one._others, one._is_passive, one._margin = others_speed, True, free
    one._braking_linear, one._braking_angular = braking
    (one._along_x, one._along_y), one._limit = along, platform.limits.linear
    one._count = len(points)
    one._reserve_placed(len(points))
    for i, (x, y) in enumerate(points):
        one._placed_x[i], one._placed_y[i] = x, y
        one._placed_gap[i], one._placed_free[i] = one._gap_of(x, y), free
    one._linear, one._angular = speeds
    one._limit_stop()
    return one._linear, one._angular
