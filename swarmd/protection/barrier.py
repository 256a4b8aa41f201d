"""Mode `barrier`: the command nearest to the wish with which the robot can always still stop.

For every return of the lidar that is near, the speed at which the outline closes on it is linear
in the twist, A (v, w), and must not exceed a cap (`caps.py`) from which the robot can still stop
before the two touch, while the other comes on at its assumed speed. The command is the one within
these half-planes that is nearest to the wish, less what would not stay clear until the robot stands
(`sweep.py`). To stand still always is one of them, moving away is free but for a creep in touch,
and where nothing is near a wish passes as it is, to the last bit.

Sources: control barrier functions as filters of a wish (Ames, Xu, Grizzle and Tabuada, IEEE TAC
2017); for swarms Wang, Ames and Egerstedt, IEEE T-RO 2017; no fault of one's own at contact,
"passive safety": Mitsch, Ghorbal, Vogelbacher and Platzer, IJRR 2017. Unlike theirs, all is taken
from the robot's own lidar and odometry. What is promised, and what is not, is in docs/safety.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import msgspec
import numpy as np

from swarmd.core.errors import ConfigError
from swarmd.core.values import ZERO, Array, Platform, Pose, Scan, ScanSpec, TouchZone, Twist
from swarmd.protection.blind_zone import NearMemory, near_memory
from swarmd.protection.constraints import (
    BOX,
    Reach,
    Rows,
    bounding,
    covered,
    envelope,
    half_planes,
    joined,
    most,
    passive_caps,
    placed,
    pressing,
    reciprocal_caps,
    sliding,
    split,
)
from swarmd.protection.dead_reckoning import REACTION, TRUSTED, Motion, relative
from swarmd.protection.decision import DecisionContext, ModeDecision
from swarmd.protection.footprint import Facing, Footprint, Sight
from swarmd.protection.projection import Point, nearest_feasible
from swarmd.protection.recovery import Clearance
from swarmd.protection.settings import BarrierSettings
from swarmd.protection.stopping import Braking

TICK = 0.05
"""Seconds until the next decision, at the latest."""

CREEP = 0.015
"""m/s: the fastest that any corner moves in touch, where not all is seen of what it touches."""

_LEAST_BRAKING = 0.02  # m/s2, for rows that hardly any motion closes
_SAME_TIME = 1e-6  # s, for the rounding of ages


class _Seen(NamedTuple):
    """What one scan shows of what is near, in the base frame of the moment it was taken.

    Points `x`, `y` (k,) m, those with the smallest `gaps` (k,) m first. The first c of them lie on
    the outline, along rays that are too close to measure; `ways` (c, 2) are the directions of
    these rays. `is_near`: the envelope is in force.
    """

    x: Array
    y: Array
    gaps: Array
    ways: Array
    is_near: bool


_Occasion: TypeAlias = tuple[DecisionContext, Point, TouchZone | None]


class _Bounds(NamedTuple):
    """What bounds a command on an occasion: `rows`, the first `points` of them one for each point.

    `normals` (r, 2) and `caps` (r,) hold the rows and the envelope, in speeds over their limits.
    """

    occasion: _Occasion
    rows: Rows
    points: int
    normals: Array
    caps: Array


_NO_WAYS = np.empty((0, 2))
_NOTHING = _Seen(np.empty(0), np.empty(0), np.empty(0), _NO_WAYS, is_near=False)


class Barrier:
    """See the module. Units: m, s, rad."""

    mode = "barrier"

    def __init__(self, platform: Platform) -> None:
        given = platform.protection["barrier"]
        if given is None:
            raise ConfigError(
                f"platform {platform.name}: protection mode barrier has no settings; wanted is"
                " protection.barrier with others_speed and unseen_extent"
            )
        self._settings = settings = msgspec.convert(given, BarrierSettings)
        self._limits, self._spec = platform.limits, platform.scan
        self._outline = Footprint(platform.footprint)
        self._offset = platform.scan.offset
        self._speed = settings.surface_speed or settings.others_speed
        self._envelopes: dict[tuple[Point, float], tuple[Array, Array]] = {}
        self._known: _Bounds | None = None
        self._motion = Motion(settings.braking_linear, settings.braking_angular)
        own = max(self._limits.linear, self._limits.lateral)
        self._memory = near_memory(platform.scan, settings.others_speed + own)
        self._radius = float(np.hypot(*platform.footprint.T).max())
        self._braking = Braking(
            self._outline, settings.braking_linear, settings.braking_angular, TICK
        )
        self._touched = settings.margin + settings.unseen_extent + self._hidden_gap(platform.scan)
        self._seen, self._taken_at, self._taken = _NOTHING, Pose(), -math.inf
        self._lag, self._restarts = 0.0, 0
        self._outer = float(np.hypot(*(platform.footprint - self._offset).T).max())
        self._reach = Reach(platform, settings, TICK)
        stale = platform.scan.stale_after + platform.scan.latency + REACTION
        self._furthest = self._reach.after(stale)
        within = self._reach.at_rest(self._speed) + settings.others_speed * stale
        given_within = settings.envelope_within
        self._within = within if given_within is None else given_within

    def clearance(self, speed: float) -> Clearance:
        """Where a row would not yet keep it below that speed ahead, nor hold it up beside."""
        settings, braking = self._settings, np.array([self._settings.braking_linear])
        age = 0.5 / self._spec.rate + self._spec.latency + REACTION

        def fastest(distance: float) -> float:
            """The speed ahead that something at a distance from the axle leaves."""
            gap = distance - float(self._outline.corners[:, 0].max())
            room = np.array([gap - settings.margin - settings.unseen_extent])
            caps = self._caps(room, braking, age)
            if settings.keep_out is not None:
                left = np.array([distance - self._offset[0] - settings.keep_out])
                caps = np.minimum(caps, reciprocal_caps(left, braking, age, TICK))
            return float(caps[0])

        ahead = next((d for d in np.arange(0.0, 5.0, 0.05) if fastest(d) >= speed), 5.0)
        beside = float(np.abs(self._outline.corners[:, 1]).max())
        beside += settings.margin + settings.unseen_extent + 0.06
        return Clearance(float(ahead), max(beside, settings.keep_out or 0.0))

    def observe(self, scan: Scan, sight: Sight, moment: DecisionContext) -> None:
        """Take in a new scan: which of its points are near enough to matter.

        One that lacks a sector is as old as what is remembered of that. Unless it is newer than the
        one before even so, that one stays: dead-reckoned, which what is remembered is not.
        """
        self._motion.update(moment)
        latency, age = self._spec.latency, moment.scan_age or 0.0
        taken = moment.now - latency - age
        if age > 0.0 and taken < self._taken + _SAME_TIME:
            return
        pose = self._motion.pose(moment, latency)
        if self._memory is not None:
            moved = relative(pose, self._taken_at)
            self._memory.update(scan, sight, moved, max(taken - self._taken, 0.0))
        self._taken_at, self._taken = pose, taken
        self._lag, self._restarts = age, self._motion.restarts
        self._seen, self._known = self._look(scan, sight), None

    def decide(
        self, requested: Twist, moment: DecisionContext, *, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The command nearest to the wish within all rows; the wish itself if it violates none."""
        self._motion.update(moment)
        seen = self._seen
        is_free = touch is None and not (seen.is_near or len(seen.x))
        if requested.is_zero or is_free:
            return ModeDecision(requested, is_active=False)
        if self._restarts != self._motion.restarts:
            return ModeDecision(ZERO, is_active=True)  # until a scan is placed anew
        along, speed = split(requested)
        limits = most(self._limits, along), self._limits.angular
        bounds = self._bounds((moment, along, touch), command, limits)
        wanted = speed / limits[0], requested.angular / limits[1]
        point, tight = nearest_feasible(wanted, BOX, bounds.normals, bounds.caps)
        s, angular = point[0] * limits[0], point[1] * limits[1]
        s, angular = self._swept(s, angular, bounds)
        if point == wanted and (s, angular) == (point[0] * limits[0], point[1] * limits[1]):
            return ModeDecision(requested, is_active=False)
        if not tight and bounds.points:  # what is met only while braking: the nearest, most likely
            tight = [int(bounds.rows.gaps[: bounds.points].argmin())]
        twist = Twist(s * along[0], angular, s * along[1])
        return ModeDecision(twist, is_active=True, rows=bounding(bounds.rows, tight, self._outline))

    def _bounds(self, occasion: _Occasion, command: Twist, limits: Point) -> _Bounds:
        """What bounds any command now; worked out once for all wishes of the same time."""
        if self._known is None or self._known.occasion != occasion:
            moment, along, touch = occasion
            rows, count = self._rows(self._seen, moment, command, along, touch)
            half_planes = self._half_planes(rows, along, limits)
            self._known = _Bounds(occasion, rows, count, *half_planes)
        return self._known

    def _swept(self, s: float, angular: float, bounds: _Bounds) -> tuple[float, float]:
        """The speeds, or less if the outline would not stay clear while the robot brakes."""
        moment, along, touch = bounds.occasion
        settings, first = self._settings, len(self._seen.ways)
        radius, age = self._radius, moment.now - self._taken + REACTION
        seconds = TICK + max(
            abs(s) / settings.braking_linear, abs(angular) / settings.braking_angular
        )
        free = self._free(moment)
        others = settings.others_speed if settings.responsibility == "passive" else 0.0
        reached = free + others * (age + seconds) + (abs(s) + abs(angular) * radius) * seconds
        rows = bounds.rows
        near = np.flatnonzero(rows.gaps[first : bounds.points] <= reached) + first
        if not len(near):
            return s, angular
        if touch is not None:
            near = near[~covered(self._outline.facing(rows.x[near], rows.y[near]), touch)]
        points = np.stack((rows.x[near], rows.y[near]), axis=1)
        need = np.array((free + others * age, others))
        speeds = self._braking.clear(
            np.array((s, angular)), np.array(along), points, rows.gaps[near], need
        )
        return float(speeds[0]), float(speeds[1])

    def _half_planes(self, rows: Rows, along: Point, limits: Point) -> tuple[Array, Array]:
        """Those of the rows and then those of the envelope, in speeds over their limits."""
        normals = np.array((rows.linear * limits[0], rows.lever * limits[1])).T
        if not self._seen.is_near:
            return normals, rows.caps
        is_touching = bool(((rows.gaps <= self._touched) & (rows.caps <= 0.0)).any())
        key = along, CREEP if is_touching else self._speed
        if key not in self._envelopes:
            if len(self._envelopes) > 8:  # of a base that moves in any direction
                self._envelopes.clear()
            self._envelopes[key] = half_planes(
                envelope(self._outline.corners, along, limits, key[1])
            )
        more, caps = self._envelopes[key]
        return np.concatenate((normals, more)), np.concatenate((rows.caps, caps))

    def _rows(
        self,
        seen: _Seen,
        moment: DecisionContext,
        command: Twist,
        along: Point,
        touch: TouchZone | None,
    ) -> tuple[Rows, int]:
        """All rows, those of the near points first, and how many these are."""
        frame = relative(self._taken_at, self._motion.ahead(moment, command))
        age = moment.now - self._taken + REACTION
        some = int(seen.gaps.searchsorted(self._reach.after(age)))
        x, y = placed(seen.x[:some], seen.y[:some], frame)
        facing = self._outline.facing(x, y)
        free = self._free(moment)
        room = facing.gap - free
        rows = self._limit(facing, room, x, y, along, age)
        rest = 0.5 * (facing.gap - self._touched) / (age + TICK)
        rows = joined(rows, sliding(rows, facing, self._outline.corners, along, rest, CREEP))
        if self._settings.unseen_extent > 0.0:
            touched = len(seen.ways)  # where these are on the outline is a guess
            beyond = facing.gap[touched:], x[touched:], y[touched:]
            rows = joined(rows, self._corners(*beyond, along, age, free))
        if len(seen.ways):
            rows = self._with_contacts(rows, seen, frame, along)
        if self._settings.keep_out is not None:
            rows = self._with_keep_out(rows, self._settings.keep_out, along, age)
        if touch is not None:
            rows = self._allowed(rows, touch, along)
        return rows, len(x)

    def _limit(
        self, facing: Facing, room: Array, x: Array, y: Array, along: Point, age: float
    ) -> Rows:
        """The rows of points at `x`, `y` (k,) that the outline faces so, with so much room (k,)."""
        linear = facing.nx * along[0] + facing.ny * along[1]
        braking = np.abs(linear) * self._settings.braking_linear
        braking += np.abs(facing.lever) * self._settings.braking_angular
        np.maximum(braking, _LEAST_BRAKING, out=braking)
        caps = self._caps(room, braking, age)
        return Rows(linear, facing.lever, caps, x, y, facing.gap)

    def _corners(
        self, gaps: Array, x: Array, y: Array, along: Point, age: float, free: float
    ) -> Rows:
        """Rows of the robot's own corners for what reaches further than is seen of it.

        Then the nearest place of the outline is not the only one that can meet it: a corner that
        sweeps past may as well.
        """
        near = np.flatnonzero(gaps <= 2.0 * free + self._settings.others_speed * (age + TICK))
        corners = self._outline.corners
        count = len(near)
        x, y = np.tile(x[near], len(corners)), np.tile(y[near], len(corners))
        own_x, own_y = np.repeat(corners[:, 0], count), np.repeat(corners[:, 1], count)
        dx, dy = x - own_x, y - own_y
        distance = np.maximum(np.hypot(dx, dy), 1e-9)
        nx, ny = dx / distance, dy / distance
        facing = Facing(distance, nx, ny, own_x * ny - own_y * nx)
        return self._limit(facing, distance - free, x, y, along, age)

    def _caps(self, room: Array, braking: Array, unseen: float) -> Array:
        settings = self._settings
        if settings.responsibility == "reciprocal":
            return reciprocal_caps(room, braking, unseen, TICK)
        return passive_caps(room, braking, settings.others_speed, unseen, TICK)

    def _with_contacts(self, rows: Rows, seen: _Seen, frame: Pose, along: Point) -> Rows:
        """What is too close to measure counts as touching, and may not be closed on along its ray.

        Without the latter a corner that grazes a slanted surface has only a row across its way.
        """
        count = len(seen.ways)
        caps = rows.caps.copy()
        caps[:count] = 0.0
        cos, sin = math.cos(frame.yaw), math.sin(frame.yaw)
        nx = cos * seen.ways[:, 0] - sin * seen.ways[:, 1]
        ny = sin * seen.ways[:, 0] + cos * seen.ways[:, 1]
        x, y = rows.x[:count], rows.y[:count]
        zeros = np.zeros(len(x))
        return joined(
            rows._replace(caps=caps),
            Rows(nx * along[0] + ny * along[1], x * ny - y * nx, zeros, x, y, zeros),
        )

    def _with_keep_out(self, rows: Rows, radius: float, along: Point, age: float) -> Rows:
        """Nothing is let into the circle around a sensor that is blind nearby, by half each."""
        dx, dy = rows.x - self._offset[0], rows.y - self._offset[1]
        distance = np.maximum(np.hypot(dx, dy), 1e-9)
        nx, ny = dx / distance, dy / distance
        linear = nx * along[0] + ny * along[1]
        lever = self._offset[0] * ny - self._offset[1] * nx  # of the circle's own turn: none else
        settings = self._settings
        braking = np.abs(linear) * settings.braking_linear
        braking += np.abs(lever) * settings.braking_angular
        np.maximum(braking, _LEAST_BRAKING, out=braking)
        caps = reciprocal_caps(distance - radius, braking, age, TICK)
        return joined(rows, Rows(linear, lever, caps, rows.x, rows.y, rows.gaps))

    def _allowed(self, rows: Rows, touch: TouchZone, along: Point) -> Rows:
        """The rows, with what the outline faces in the sector closed on as fast as is granted.

        By the way the outline faces it: from the axle a box that is being pushed is wider than any
        sector. Nothing may be faster that way, for what is pushed is not always seen.
        """
        facing = self._outline.facing(rows.x, rows.y)
        caps = np.where(covered(facing, touch), np.maximum(rows.caps, touch.speed), rows.caps)
        nx, ny, x, y = pressing(self._outline.corners, touch)
        speeds, gaps = np.full(len(x), touch.speed), np.full(len(x), np.inf)  # of nothing seen
        linear, lever = nx * along[0] + ny * along[1], x * ny - y * nx
        return joined(rows._replace(caps=caps), Rows(linear, lever, speeds, x, y, gaps))

    def _look(self, scan: Scan, sight: Sight) -> _Seen:
        """What matters of a scan: returns within reach, and rays that are too close to measure."""
        within = max(self._within, self._furthest) + self._outer
        shown = np.flatnonzero((scan.ranges <= within) & (scan.ranges > -np.inf))
        points = sight.ends(scan, shown)
        gaps = self._outline.gaps(points)
        bearings = scan.bearings[scan.ranges == -np.inf]
        if self._memory is not None and len(self._memory.bearings):
            touching, hidden = self._remembered(self._memory)
            bearings = np.concatenate((bearings, touching))
            points = np.concatenate((points, hidden))
            gaps = np.concatenate((gaps, self._outline.gaps(hidden)))
        is_near = bool(len(bearings)) or float(gaps.min(initial=np.inf)) <= self._within
        order = np.argsort(gaps)[: np.count_nonzero(gaps <= self._furthest)]
        gaps, (x, y) = gaps.take(order), points.take(order, axis=0).T
        if not len(bearings):
            return _Seen(x, y, gaps, _NO_WAYS, is_near)
        ways = np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
        depths = self._outline.along_rays(self._offset, ways)
        touched = (self._offset + depths[:, None] * ways).T
        x, y = np.concatenate((touched[0], x)), np.concatenate((touched[1], y))
        return _Seen(x, y, np.concatenate((np.zeros(len(ways)), gaps)), ways, is_near)

    def _remembered(self, memory: NearMemory) -> tuple[Array, Array]:
        """Bearings (k,) of what may touch the robot in its blind zone, and where (m, 2) else."""
        ways = np.stack((np.cos(memory.bearings), np.sin(memory.bearings)), axis=1)
        outline = self._outline.along_rays(self._offset, ways)
        is_beyond = memory.nearest > outline
        points = self._offset + memory.nearest[is_beyond, None] * ways[is_beyond]
        return memory.bearings[~is_beyond], points

    def _hidden_gap(self, spec: ScanSpec) -> float:
        """m from the outline up to which something may be while it touches it where none sees."""
        if spec.near == "reported" or self._settings.keep_out is not None:
            return 0.0
        angles = np.linspace(-np.pi, np.pi, 73)
        ways = np.stack((np.cos(angles), np.sin(angles)), axis=1)
        nearest = float(self._outline.along_rays(self._offset, ways).min())
        return max(spec.range_min - nearest, 0.0)

    def _free(self, moment: DecisionContext) -> float:
        """m that must stay free beside what is seen, for what is not and where it may be instead.

        Odometry may be old, and what a lacking sector holds is not dead-reckoned to the scan.
        """
        late = max((moment.odometry_age or 0.0) - TRUSTED, 0.0)
        blurred = (late + self._lag) * self._speed
        return self._settings.margin + self._settings.unseen_extent + blurred
