"""The linear constraints on a command that mode `barrier` builds from near returns.

A constraint is a half-plane of twists: the speed at which a place of the outline closes on an
obstacle must not exceed a cap. The module holds, in this order: the constraints as arrays, the caps
(how fast the robot may close on an obstacle at a given gap), the range beyond which no obstacle can
bind, the envelope (a limit on the speed of the robot's own corners), extra constraints for
obstacles passed sideways, and the directions of a touch zone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swarmd.core.messages import LimitingObstacle
from swarmd.core.values import Array, Limits, Platform, Pose, TouchZone, Twist
from swarmd.protection.dead_reckoning import REACTION_TIME
from swarmd.protection.footprint import Footprint, Separations
from swarmd.protection.projection import Point
from swarmd.protection.settings import BarrierSettings

MAX_REPORTED = 4
"""Constraints that a decision reports."""

LIMIT_BOX: tuple[Point, ...] = ((1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0))
"""All twists within the limits, as a polygon of (linear, angular) over their limits."""

CREEP_SPEED = 0.015
"""m/s: the fastest corner in contact, where part of the obstacle may be unseen.

Also that of a robot that creeps towards an obstacle which stops any faster robot.
"""

SLOW_REQUEST = 3.0 * CREEP_SPEED
"""m/s: a robot that is asked for more does not creep towards an obstacle."""

CREEP_GAIN = 1e-6
"""By which creeping must be nearer to the requested command, in speeds over their limits."""

MIN_BRAKING = 0.02
"""m/s2, for constraints that hardly any motion closes."""

SIDE_ANGLE = math.radians(60.0)
"""rad between a return and its two side constraints."""
SIDE_RESERVE = 0.25
"""Share of `others_speed` by which a corner passes an obstacle more slowly, if none is given.

With 0 attackers met a Waffle Pi at up to 5.2 cm/s at a corner that slid past them, with 0.1 at 3.4,
with 0.25 at 1.5.
"""

AT_AXLE = 1e-9
"""m from the axle: rounding decides the direction of a nearer place."""

_TOUCH_STEP = math.radians(15.0)  # directions between two of these are at most 1 % faster
_SAME_FACE = 1e-9  # m by which corners of one face may differ


class Constraints(NamedTuple):
    """Half-planes linear * v + lever * w <= caps for obstacles at x, y (k,) with gaps in m."""

    linear: Array
    lever: Array
    caps: Array
    x: Array
    y: Array
    gaps: Array


def _envelope_directions() -> Array:
    angles = 2.0 * np.pi * np.arange(48) / 48
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    directions /= np.abs(directions).max(axis=1)[:, None]
    return directions


ENVELOPE_DIRECTIONS = _envelope_directions()
"""(48, 2) directions of the envelope, on the box of the limits, whose corners are among them."""


def concatenated(one: Constraints, other: Constraints) -> Constraints:
    """The constraints of both."""
    return Constraints(*(np.concatenate(pair) for pair in zip(one, other, strict=True)))


def report(rows: Constraints, tight: list[int], outline: Footprint) -> tuple[LimitingObstacle, ...]:
    """The constraints that bind the command, those with the lowest caps first.

    The gap of a reported constraint is measured from the outline, also where the constraint is
    that of one corner. `tight` are the indices of the binding constraints. Indices beyond
    `rows` belong to the envelope and are not reported. Nor are constraints with an infinite gap,
    which belong to a touch zone. The bearing of a place at the axle is 0.
    """
    among = [i for i in tight if i < len(rows.caps)]
    seen = [i for i in among if rows.gaps[i] < math.inf]
    order = sorted(seen, key=lambda i: (float(rows.caps[i]), float(rows.gaps[i])))
    shown = order[:MAX_REPORTED]
    gaps = outline.gaps(np.stack((rows.x[shown], rows.y[shown]), axis=1)) if shown else ()
    return tuple(
        LimitingObstacle(
            _bearing(float(rows.x[i]), float(rows.y[i])), float(gap), float(rows.caps[i])
        )
        for i, gap in zip(shown, gaps, strict=True)
    )


def _bearing(x: float, y: float) -> float:
    return 0.0 if math.hypot(x, y) < AT_AXLE else math.atan2(y, x)


def direction_and_speed(twist: Twist) -> tuple[Point, float]:
    """The unit direction of the linear motion and the speed along it; ahead if it is zero."""
    if twist.lateral == 0.0:
        return (1.0, 0.0), twist.linear
    speed = math.hypot(twist.linear, twist.lateral)
    return (twist.linear / speed, twist.lateral / speed), speed


def linear_limit(limits: Limits, along: Point) -> float:
    """The limit of the linear speed in m/s in a direction."""
    linear, lateral = abs(along[0]), abs(along[1])
    return min(
        limits.linear / linear if linear else math.inf,
        limits.lateral / lateral if lateral else math.inf,
    )


def placed(x: Array, y: Array, frame: Pose) -> tuple[Array, Array]:
    """Points of a frame at a pose, in the frame of that pose."""
    cos, sin = math.cos(frame.yaw), math.sin(frame.yaw)
    return frame.x + cos * x - sin * y, frame.y + sin * x + cos * y


def passive_caps(
    room: Array, braking: Array, others_speed: float, unseen: Array | float, tick: float
) -> Array:
    """Caps (k,) in m/s on the closing speed for obstacles that approach at `others_speed`.

    From a cap the robot can still stop before the two use up `room` (k,), the gap in m less the
    clearance. `braking` (k,) m/s2 is the rate at which the closing speed can fall, `unseen` s the
    time since each obstacle was seen, `tick` s the time until the next decision. Solves
    s tick + s^2 / 2b + V (unseen + tick + s / b) = room. After the dynamic window with moving
    obstacles and "passive safety" (Mitsch, Ghorbal, Vogelbacher and Platzer, IJRR 2017).
    """
    left = room - others_speed * (unseen + tick)
    linear = braking * tick + others_speed
    roots = np.sqrt(linear * linear + 2.0 * braking * np.maximum(left, 0.0)) - linear
    caps: Array = np.maximum(roots, 0.0)
    return caps


def reciprocal_caps(room: Array, braking: Array, unseen: Array | float, tick: float) -> Array:
    """Caps (k,) in m/s towards robots with the same rule: each may use half of the room.

    As `passive_caps`, with others at rest and a reaction of two ticks plus the time unseen. After
    barrier certificates that share the distance (Wang, Ames and Egerstedt, IEEE T-RO 2017).
    """
    half: Array = 0.5 * np.maximum(room, 0.0)
    linear = braking * (2.0 * tick + unseen)
    caps: Array = np.maximum(np.sqrt(linear * linear + 2.0 * braking * half) - linear, 0.0)
    return caps


class BindingRange:
    """Gaps in m beyond which no obstacle constrains the robot; farther returns are ignored.

    `own` m/s is the highest speed of the base in any direction, `fastest` m/s that of the robot's
    surface, `fresh` m the gap for it at age 0. `surface` m/s is the highest speed of the surface
    near obstacles. A command takes effect at most `stale` s after the middle of its scan.
    """

    def __init__(self, platform: Platform, settings: BarrierSettings, tick: float) -> None:
        """The next decision comes after `tick` s."""
        self._limits, self._settings, self._tick = platform.limits, settings, tick
        self._scan, self._footprint = platform.scan, platform.footprint
        self._outer = float(np.hypot(*platform.footprint.T).max())
        self.own = math.hypot(self._limits.linear, self._limits.lateral)
        self.surface = settings.surface_speed or settings.others_speed
        # Far from obstacles the envelope does not apply, so the own limit may be the higher one.
        self.fastest = max(self.surface, self.own)
        self.fresh = self.for_fresh_scan(self.fastest)
        self.stale = platform.scan.stale_after + platform.scan.latency + REACTION_TIME

    def for_fresh_scan(self, speed: float) -> float:
        """The gap for a scan of age 0 and a surface of the robot that moves at `speed` m/s."""
        settings, tick = self._settings, self._tick
        spin = min(self._limits.angular, speed / self._outer)
        linear = min(speed, self.own)
        braking = max(linear / settings.braking_linear, spin / settings.braking_angular)
        gap = speed * (tick + 0.5 * braking) + settings.others_speed * (tick + braking)
        return gap + settings.margin + settings.unseen_extent

    def for_age(self, age: float) -> float:
        """The gap for an obstacle of that age in s: it and the robot may have approached since."""
        return self.fresh + (self._settings.others_speed + self.fastest) * age

    def for_scan_age(self, age: float) -> float:
        """As `for_age`, for returns of a scan: they must stay out of the keep_out circle, too."""
        settings, speed = self._settings, self.fastest
        gap = self.for_age(age)
        if settings.keep_out is None:
            return gap
        half = speed * (2.0 * self._tick + age + 0.5 * speed / settings.braking_linear)
        return max(gap, settings.keep_out + 2.0 * half + speed * age)

    def for_envelope(self) -> float:
        """The gap within which the surface must not exceed `surface`, for a scan of any age."""
        return self.for_fresh_scan(self.surface) + self._settings.others_speed * self.stale

    def for_sensor(self) -> float:
        """Distance in m from the sensor at which an obstacle must be visible.

        A ray may be half a sweep older than the middle of its scan.
        """
        scan = self._scan
        sweep = 1.0 / scan.rate if scan.sweep is None else scan.sweep.duration
        outermost = float(np.hypot(*(self._footprint - scan.offset).T).max())
        return outermost + self.for_scan_age(self.stale + 0.5 * sweep)


def envelope(corners: Array, along: Point, limits: Point, speed: float) -> tuple[Point, ...]:
    """The polygon of (linear, angular), each over its limit, in which no corner exceeds `speed`.

    Every robot assumes that no surface around it moves faster than `others_speed`; the envelope
    makes that true of this robot, corners in a turn included (compare "passive safety" in Mitsch et
    al., IJRR 2017). `corners` (k, 2) in the base frame in m, `along` the unit direction of the
    linear motion, `limits` in m/s and rad/s, `speed` in m/s. The polygon is an inner approximation
    of a convex set; its vertices are exact.
    """
    linear, angular = (ENVELOPE_DIRECTIONS * limits).T[:, :, None]
    x = linear * along[0] - angular * corners[:, 1]
    y = linear * along[1] + angular * corners[:, 0]
    fastest = np.hypot(x, y).max(axis=1)
    shares = np.minimum(1.0, speed / np.maximum(fastest, 1e-12))
    return tuple((float(a), float(b)) for a, b in ENVELOPE_DIRECTIONS * shares[:, None])


def half_planes(polygon: Sequence[Point]) -> tuple[Array, Array]:
    """Normals (k, 2) and caps (k,) of a convex polygon: normals @ point <= caps inside."""
    corners = np.array(polygon)
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.stack((edges[:, 1], -edges[:, 0]), axis=1)
    normals /= np.hypot(normals[:, 0], normals[:, 1])[:, None]
    return normals, normals[:, 0] * corners[:, 0] + normals[:, 1] * corners[:, 1]


def side_constraints(
    rows: Constraints,
    separations: Separations,
    corners: Array,
    along: Point,
    rest: Array,
    creep: float,
) -> Constraints:
    """Extra constraints for obstacles passed sideways, two for each of `rows` whose cap is 0.

    A robot that slides along a face does not close on it, as long as the face stands still. Two
    robots that slide towards the same place each pass what they saw there last, until their corners
    meet: a moving obstacle may no longer be where it was seen. So the corners (c, 2) that are
    foremost 60 degrees to either side of the obstacle may approach at no more than `rest` (k,) m/s,
    with which two such robots do not touch before both have a new scan. `creep` m/s is always
    allowed. Moving away stays free. `separations` are those of `rows`.
    """
    near = np.flatnonzero(rows.caps <= 0.0)
    x, y, gaps, nx, ny = (
        np.concatenate((part[near], part[near]))
        for part in (rows.x, rows.y, rows.gaps, separations.nx, separations.ny)
    )
    sin = np.repeat((math.sin(SIDE_ANGLE), -math.sin(SIDE_ANGLE)), len(near))
    ax, ay = math.cos(SIDE_ANGLE) * nx - sin * ny, sin * nx + math.cos(SIDE_ANGLE) * ny
    foremost = corners[(corners[:, :1] * ax + corners[:, 1:] * ay).argmax(axis=0)]
    lever = foremost[:, 0] * ay - foremost[:, 1] * ax
    caps = np.maximum(rest[near], creep)
    caps = np.concatenate((caps, caps))
    return Constraints(ax * along[0] + ay * along[1], lever, caps, x, y, gaps)


def hidden_gaps(separations: Separations, x: Array, y: Array, lidar: Point, blind: float) -> Array:
    """(k,) m by which the blind zone reaches beyond the outline towards points at `x`, `y` (k,).

    An obstacle that is seen at one of the points continues unseen only within the blind zone, the
    circle of `blind` m around the lidar. It is left at this gap on the shortest line from the
    outline to the point. `separations` are those of the points.
    """
    gap, nx, ny, _ = separations
    dx, dy = x - lidar[0], y - lidar[1]
    across = dx * ny - dy * nx
    half = blind * blind - across * across  # square of half of the chord on the line
    ahead = dx * nx + dy * ny - gap  # from the middle of the chord to the outline
    gaps: Array = np.maximum(np.where(half > 0.0, np.sqrt(np.maximum(half, 0.0)) - ahead, 0.0), 0.0)
    return gaps


def in_touch_zone(separations: Separations, zone: TouchZone) -> NDArray[np.bool_]:
    """(k,) true for points whose direction from the outline lies in the sector of the zone."""
    cos, sin = math.cos(zone.bearing), math.sin(zone.bearing)
    found: NDArray[np.bool_] = separations.nx * cos + separations.ny * sin >= math.cos(
        zone.half_width
    )
    return found


def touch_directions(corners: Array, zone: TouchZone) -> tuple[Array, Array, Array, Array]:
    """Directions nx, ny (n,) of the zone, and the corners x, y (n,) in m foremost in each.

    A lidar does not show what touches the robot, and a pushed object moves with it. So the speed
    of a touch zone limits any motion in its directions, not only motion towards a return.
    """
    count = math.ceil(2.0 * zone.half_width / _TOUCH_STEP)
    angles = np.linspace(zone.bearing - zone.half_width, zone.bearing + zone.half_width, count + 1)
    edges = np.roll(corners, -1, axis=0) - corners
    faces = np.arctan2(-edges[:, 0], edges[:, 1])  # outward normals of a counter-clockwise outline
    off = (faces - zone.bearing + np.pi) % (2.0 * np.pi) - np.pi
    angles = np.concatenate((angles, faces[np.abs(off) <= zone.half_width]))
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    heights = directions @ corners.T
    direction, corner = np.nonzero(heights >= heights.max(axis=1, keepdims=True) - _SAME_FACE)
    return (*directions[direction].T, *corners[corner].T)
