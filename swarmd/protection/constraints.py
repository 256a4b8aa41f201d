"""Half-planes of commands: what the rows of mode `barrier` are made of.

How fast a robot may close on something: the heart of mode `barrier`.

A cap s is the closing speed from which the robot can still stop before whatever it closes on has
used up the gap. The passive one follows the idea of the dynamic window with moving obstacles and
"passive safety" (Mitsch, Ghorbal, Vogelbacher and Platzer, IJRR 2017); the reciprocal one that of
barrier certificates that share the distance (Wang, Ames and Egerstedt, IEEE T-RO 2017).

How far off something may bind a robot: nobody looks at what is further than that.

The envelope: the twists with which no corner of a robot is faster than others rely on.

Each robot assumes that no surface around it moves faster than `others_speed`. This makes that true
of the robot itself, corners in a turn included (protection against others rests on a promise that
all of them keep; compare "passive safety" in Mitsch et al., IJRR 2017).

Rows for who slides along something that is near: what moves is met elsewhere than it was seen.

Along a face nothing of a robot closes on what it passes, if that stands. Two that slide towards the
same place each pass what stood there when they last looked, until their corners meet. So where the
room of a row is used up, how fast the outline comes nearer is bounded in other directions as well,
by what is left until the two touch.

What a touch zone covers, and how fast an outline presses into its directions.

A lidar does not show what touches the robot, and what is pushed moves along with it. So the speed
of a zone is not that of closing on what is seen, but of moving its way at all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array, Limits, Platform, Pose, TouchZone, Twist
from swarmd.protection.decision import Row
from swarmd.protection.footprint import Facing, Footprint
from swarmd.protection.projection import Point
from swarmd.protection.settings import BarrierSettings

MOST = 4
"""Rows that a verdict names."""


class Rows(NamedTuple):
    """Half-planes: closing speed = linear * v + lever * w <= cap, for points at x, y."""

    linear: Array
    lever: Array
    caps: Array
    x: Array
    y: Array
    gaps: Array


def joined(one: Rows, other: Rows) -> Rows:
    """The rows of both."""
    return Rows(*(np.concatenate(pair) for pair in zip(one, other, strict=True)))


def bounding(rows: Rows, tight: list[int], outline: Footprint) -> tuple[Row, ...]:
    """The rows that bound the command, those with the lowest caps first.

    A row may be that of a corner, which is further off than `outline` is: what it tells is the gap.
    """
    among = [i for i in tight if i < len(rows.caps)]  # the others are the envelope's
    seen = [i for i in among if rows.gaps[i] < math.inf]  # the others are of a touch zone
    order = sorted(seen, key=lambda i: (float(rows.caps[i]), float(rows.gaps[i])))
    shown = order[:MOST]
    gaps = outline.gaps(np.stack((rows.x[shown], rows.y[shown]), axis=1)) if shown else ()
    return tuple(
        Row(math.atan2(float(rows.y[i]), float(rows.x[i])), float(gap), float(rows.caps[i]))
        for i, gap in zip(shown, gaps, strict=True)
    )


def split(requested: Twist) -> tuple[Point, float]:
    """The direction of the linear motion and the speed along it; ahead if there is none."""
    if requested.lateral == 0.0:
        return (1.0, 0.0), requested.linear
    speed = math.hypot(requested.linear, requested.lateral)
    return (requested.linear / speed, requested.lateral / speed), speed


def most(limits: Limits, along: Point) -> float:
    """The limit of the linear speed in a direction, in m/s."""
    linear, lateral = abs(along[0]), abs(along[1])
    return min(
        limits.linear / linear if linear else math.inf,
        limits.lateral / lateral if lateral else math.inf,
    )


def placed(x: Array, y: Array, frame: Pose) -> tuple[Array, Array]:
    """The x and y of points of a frame."""
    cos, sin = math.cos(frame.yaw), math.sin(frame.yaw)
    return frame.x + cos * x - sin * y, frame.y + sin * x + cos * y


def passive_caps(
    room: Array, braking: Array, others_speed: float, unseen: Array | float, tick: float
) -> Array:
    """Closing speeds (k,) in m/s for obstacles that may come at `others_speed`.

    `room` (k,) m is the gap less what must stay free; `braking` (k,) m/s2 how fast the closing
    speed can be shed; `unseen` s (or (k,)) how long the obstacle has moved unseen; `tick` s until
    the next decision. Solves s tick + s^2 / 2b + V (unseen + tick + s / b) = room.
    """
    left = room - others_speed * (unseen + tick)
    linear = braking * tick + others_speed
    roots = np.sqrt(linear * linear + 2.0 * braking * np.maximum(left, 0.0)) - linear
    caps: Array = np.maximum(roots, 0.0)
    return caps


def reciprocal_caps(room: Array, braking: Array, unseen: Array | float, tick: float) -> Array:
    """Closing speeds (k,) in m/s towards others that do the same: each may use half the room.

    As `passive_caps`, with others at rest and a reaction of two ticks and the time unseen.
    """
    half: Array = 0.5 * np.maximum(room, 0.0)
    linear = braking * (2.0 * tick + unseen)
    caps: Array = np.maximum(np.sqrt(linear * linear + 2.0 * braking * half) - linear, 0.0)
    return caps


class Reach:
    """Gaps in m, of a platform whose next decision comes after `tick` s."""

    def __init__(self, platform: Platform, settings: BarrierSettings, tick: float) -> None:
        self._limits, self._settings, self._tick = platform.limits, settings, tick
        self._outer = float(np.hypot(*platform.footprint.T).max())
        own = max(self._limits.linear, self._limits.lateral)
        # The promise to others binds no robot that has nothing near.
        self._fastest = max(settings.surface_speed or settings.others_speed, own)
        self._idle = self.at_rest(self._fastest)

    def at_rest(self, speed: float) -> float:
        """The gap at which a row may bind a surface of that speed with a scan of this instant."""
        settings, tick = self._settings, self._tick
        spin = min(self._limits.angular, speed / self._outer)
        linear = min(speed, max(self._limits.linear, self._limits.lateral))
        braking = max(linear / settings.braking_linear, spin / settings.braking_angular)
        gap = speed * (tick + 0.5 * braking) + settings.others_speed * (tick + braking)
        return gap + settings.margin + settings.unseen_extent

    def after(self, age: float) -> float:
        """The same with one of that age in s: both have moved since, the robot perhaps towards."""
        settings, speed = self._settings, self._fastest
        gap = self._idle + (settings.others_speed + speed) * age
        if settings.keep_out is None:
            return gap
        half = speed * (2.0 * self._tick + age + 0.5 * speed / settings.braking_linear)
        return max(gap, settings.keep_out + 2.0 * half + speed * age)


BOX: tuple[Point, ...] = ((1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0))
"""All twists within the limits."""

_DIRECTIONS = 48  # multiples of 7.5 degrees: the corners of the box are among them


def envelope(corners: Array, along: Point, limits: Point, speed: float) -> tuple[Point, ...]:
    """The polygon of (linear, angular), each over its limit, with which no corner exceeds `speed`.

    `corners` (k, 2) in the base frame in m; `along` the direction of the linear motion, of length
    1; `limits` m/s and rad/s; `speed` m/s. An inner approximation: its corners are exact, and what
    it approximates is convex.
    """
    angles = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    ways = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    ways /= np.abs(ways).max(axis=1)[:, None]  # on the box of the limits
    linear, angular = (ways * limits).T[:, :, None]
    x = linear * along[0] - angular * corners[:, 1]
    y = linear * along[1] + angular * corners[:, 0]
    fastest = np.hypot(x, y).max(axis=1)
    shares = np.minimum(1.0, speed / np.maximum(fastest, 1e-12))
    return tuple((float(a), float(b)) for a, b in ways * shares[:, None])


def half_planes(polygon: Sequence[Point]) -> tuple[Array, Array]:
    """Normals (k, 2) and caps (k,): normals @ point <= caps for each point of a convex polygon."""
    corners = np.array(polygon)
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.stack((edges[:, 1], -edges[:, 0]), axis=1)
    normals /= np.hypot(normals[:, 0], normals[:, 1])[:, None]
    return normals, np.einsum("ka,ka->k", normals, corners)


_ASIDE = math.radians(60.0)
"""By how much it may be in another direction than it was seen: moving away stays free."""


def sliding(
    rows: Rows, facing: Facing, corners: Array, along: Point, rest: Array, creep: float
) -> Rows:
    """Two more for each of `rows` whose cap is 0; `facing` is how the outline faces them.

    They bound its corners (c, 2) that are foremost in these directions. `rest` (k,) m/s is how fast
    it may come nearer without a touch before it has looked again, where the other does the same;
    `creep` m/s is always allowed.
    """
    near = np.flatnonzero(rows.caps <= 0.0)
    x, y, gaps, nx, ny = (
        np.concatenate((part[near], part[near]))
        for part in (rows.x, rows.y, rows.gaps, facing.nx, facing.ny)
    )
    sin = np.repeat((math.sin(_ASIDE), -math.sin(_ASIDE)), len(near))
    ax, ay = math.cos(_ASIDE) * nx - sin * ny, sin * nx + math.cos(_ASIDE) * ny
    foremost = corners[(corners[:, :1] * ax + corners[:, 1:] * ay).argmax(axis=0)]
    lever = foremost[:, 0] * ay - foremost[:, 1] * ax
    caps = np.maximum(rest[near], creep)
    caps = np.concatenate((caps, caps))
    return Rows(ax * along[0] + ay * along[1], lever, caps, x, y, gaps)


_STEP = math.radians(15.0)  # between directions: what lies between is at most 1 % faster
_FACE = 1e-9  # m: corners that are as far out belong to one face


class Pressing(NamedTuple):
    """Directions `nx`, `ny` (n,) in which the outline's corners `x`, `y` (n,) in m may press."""

    nx: Array
    ny: Array
    x: Array
    y: Array


def covered(facing: Facing, zone: TouchZone) -> NDArray[np.bool_]:
    """(k,) true for what an outline faces in the sector of the zone."""
    off = np.arctan2(facing.ny, facing.nx) - zone.bearing
    found: NDArray[np.bool_] = np.abs((off + np.pi) % (2.0 * np.pi) - np.pi) <= zone.half_width
    return found


def pressing(corners: Array, zone: TouchZone) -> Pressing:
    """The corners (k, 2) of a convex outline that are foremost in directions of the zone."""
    count = math.ceil(2.0 * zone.half_width / _STEP)
    ways = np.linspace(zone.bearing - zone.half_width, zone.bearing + zone.half_width, count + 1)
    edges = np.roll(corners, -1, axis=0) - corners
    faces = np.arctan2(-edges[:, 0], edges[:, 1])  # outward normals of a counter-clockwise outline
    off = (faces - zone.bearing + np.pi) % (2.0 * np.pi) - np.pi
    ways = np.concatenate((ways, faces[np.abs(off) <= zone.half_width]))
    directions = np.stack((np.cos(ways), np.sin(ways)), axis=1)
    heights = directions @ corners.T
    way, corner = np.nonzero(heights >= heights.max(axis=1, keepdims=True) - _FACE)
    return Pressing(*directions[way].T, *corners[corner].T)
