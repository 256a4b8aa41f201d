"""Mode `barrier`: the command nearest to the requested one from which the robot can still stop.

The speed at which the outline closes on a near return is linear in the twist. It must not exceed a
cap from which the robot can still stop before the two touch, while the obstacle approaches at its
assumed speed (constraints.py). The command is the one within these half-planes that is nearest to
the requested one (projection.py), reduced if the outline would not stay clear while the robot
brakes (stopping.py). The zero command always satisfies the constraints, moving away is free except
for a creep speed in contact, and far from obstacles a requested command passes bit by bit.

Sources: control barrier functions as command filters (Ames, Xu, Grizzle and Tabuada, IEEE TAC
2017); for swarms Wang, Ames and Egerstedt, IEEE T-RO 2017; "passive safety", no own fault at
contact: Mitsch, Ghorbal, Vogelbacher and Platzer, IJRR 2017. Unlike theirs, all inputs come from
the robot's own lidar and odometry. docs/safety.md states what holds and under which assumptions.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from swarmd.core.clock import TICK
from swarmd.core.errors import ConfigError
from swarmd.core.messages import NarrowestPassage
from swarmd.core.values import ZERO, Array, Platform, Pose, Scan, TouchZone, Twist
from swarmd.protection.blind_zone import BlindZoneMemory, blind_zone_memory
from swarmd.protection.constraints import (
    CREEP_GAIN,
    CREEP_SPEED,
    LIMIT_BOX,
    MIN_BRAKING,
    SIDE_ANGLE,
    SIDE_RESERVE,
    SLOW_REQUEST,
    BindingRange,
    Constraints,
    concatenated,
    direction_and_speed,
    envelope,
    half_planes,
    hidden_gaps,
    in_touch_zone,
    linear_limit,
    passive_caps,
    placed,
    reciprocal_caps,
    report,
    side_constraints,
    touch_directions,
)
from swarmd.protection.dead_reckoning import REACTION_TIME, DeadReckoning
from swarmd.protection.decision import DecisionContext, ModeDecision, ToldObstacle
from swarmd.protection.footprint import Footprint, ScanGeometry, Separations
from swarmd.protection.projection import TOLERANCE, Point, nearest_feasible
from swarmd.protection.recovery import Clearance
from swarmd.protection.settings import BarrierSettings
from swarmd.protection.stopping import SPEED_SHARES, StopCheck
from swarmd.sensing.odometry_history import MAX_EXTRAPOLATION, relative

AGE_TOLERANCE = 1e-6  # s, for the rounding of ages
_PASSAGE_SLACK = 0.03  # m per side by which a passage must be wider: noise, a turning lidar
_CORRIDOR_SPEED = 0.08  # m/s: what counts as passing a corridor
_PLACES_BESIDE = 33  # along each wall of a corridor, odd: one lies beside a lidar in the middle
_MAX_ENVELOPES = 8  # kept at a time: a holonomic base moves in any direction


class _NearObstacles(NamedTuple):
    """The near obstacles of one scan, in the base frame at the time it was taken.

    Points `x`, `y` (k,) m in the order of rising `gaps` (k,) m, measured `ages` (k,) s before that
    time. The first c of them lie on the outline, along the unit vectors `rays` (c, 2) of returns
    that are too close to measure. `is_near`: an obstacle is so near that the envelope applies.
    `oldest` is the greatest age of a ray of the scan in s.
    """

    x: Array
    y: Array
    gaps: Array
    ages: Array
    rays: Array
    is_near: bool
    oldest: float


class _Placed(NamedTuple):
    """All obstacles (o,) in the base frame at which a command takes effect: seen, then told ones.

    Points `x`, `y` m at `gaps` m from the outline, measured `ages` s before; `free` m must stay
    free around each. Within `contact` m unseen parts may touch the robot. `rows`: the index of the
    first constraint of each.
    """

    rows: NDArray[np.intp]
    x: Array
    y: Array
    gaps: Array
    ages: Array
    free: Array
    contact: Array

    def beyond(self, first: int) -> _Placed:
        """Those from an index on."""
        return _Placed(self.rows[first:], *(part[first:] for part in self[1:]))

    def followed_by(self, other: _Placed) -> _Placed:
        """These, then the others."""
        rows = np.concatenate((self.rows, other.rows))
        pairs = zip(self[1:], other[1:], strict=True)
        return _Placed(rows, *(np.concatenate(pair) for pair in pairs))


_Situation: TypeAlias = tuple[DecisionContext, Point, TouchZone | None]


class _Feasible(NamedTuple):
    """The feasible commands of a situation, with its obstacles and their constraints `rows`.

    The first `seen` obstacles were seen, the others told. `normals` (r, 2) and `caps` (r,): the
    constraints and the envelope, in speeds over their limits. `creeping`: both for a robot that
    creeps instead; None where it must not.
    """

    situation: _Situation
    rows: Constraints
    placed: _Placed
    seen: int
    normals: Array
    caps: Array
    creeping: tuple[Array, Array] | None


_NO_RAYS = np.empty((0, 2))
_NO_OBSTACLES = _NearObstacles(
    np.empty(0), np.empty(0), np.empty(0), np.empty(0), _NO_RAYS, is_near=False, oldest=0.0
)


class Barrier:
    """The arbiter of mode `barrier`. Units: m, s, rad."""

    mode = "barrier"

    def __init__(self, platform: Platform) -> None:
        given = platform.protection["barrier"]
        if given is None:
            raise ConfigError(
                f"platform {platform.name}: protection mode barrier has no settings; expected"
                " protection.barrier with others_speed and unseen_extent"
            )
        self._settings = settings = msgspec.convert(given, BarrierSettings)
        self._limits, self._spec = platform.limits, platform.scan
        self._outline = Footprint(platform.footprint)
        self._offset = platform.scan.offset
        self._envelopes: dict[tuple[Point, float], tuple[Array, Array]] = {}
        self._feasible: _Feasible | None = None
        self._decided: tuple[_Feasible, Twist, ModeDecision] | None = None
        self._dead_reckoning = DeadReckoning(settings.braking_linear, settings.braking_angular)
        self._binding_range = BindingRange(platform, settings, TICK)
        self._surface_speed = self._binding_range.surface
        self._memory: BlindZoneMemory | None = None
        if self._spec.near == "lost" and self._spec.range_min > 0.0:
            speed = settings.others_speed + self._binding_range.own
            self._memory = blind_zone_memory(self._spec.range_min, speed, 1.0 / self._spec.rate)
        self._radius = float(np.hypot(*platform.footprint.T).max())
        self._stop_check = StopCheck(
            self._outline, settings.braking_linear, settings.braking_angular, TICK
        )
        can_hide = platform.scan.near != "reported" and settings.keep_out is None
        self._blind = platform.scan.range_min if can_hide else 0.0
        reserve = settings.side_reserve
        reserve = SIDE_RESERVE * settings.others_speed if reserve is None else reserve
        self._side_reserve = reserve if settings.responsibility == "passive" else 0.0
        # Where a disc may touch the robot is not known well enough to creep past it.
        self._may_creep = platform.ranges is None and settings.keep_out is None
        self._may_creep &= settings.responsibility == "passive"
        self._obstacles, self._taken_at, self._taken = _NO_OBSTACLES, Pose(), -math.inf
        self._lag, self._clock_resets = 0.0, 0
        self._outer = float(np.hypot(*(platform.footprint - self._offset).T).max())
        self._stale, given_within = self._binding_range.stale, settings.envelope_within
        self._within = self._binding_range.for_envelope() if given_within is None else given_within

    def clearance(self, speed: float) -> Clearance:
        """The clearance needed to drive at `speed`: ahead, and to each side."""
        settings, braking = self._settings, np.array([self._settings.braking_linear])
        age = 0.5 / self._spec.rate + self._spec.latency + REACTION_TIME

        def fastest(distance: float) -> float:
            """The speed ahead that an obstacle at a distance from the axle allows."""
            gap = distance - float(self._outline.corners[:, 0].max())
            room = np.array([gap - settings.margin - settings.unseen_extent])
            caps = self._caps(room, braking, age)
            if settings.keep_out is not None:
                left = np.array([distance - self._offset[0] - settings.keep_out])
                caps = np.minimum(caps, reciprocal_caps(left, braking, age, TICK))
            return float(caps[0])

        ahead = next((d for d in np.arange(0.0, 5.0, 0.05) if fastest(d) >= speed), 5.0)
        beside = float(np.abs(self._outline.corners[:, 1]).max())
        body = beside
        beside += settings.margin + settings.unseen_extent + 0.06
        return Clearance(float(ahead), max(beside, settings.keep_out or 0.0), body)

    def narrowest_passage(self) -> NarrowestPassage:
        """The narrowest door, corridor and meeting that protection lets this robot through.

        At a door, the corners pass posts that may approach while they are not seen, unless the
        robot may creep. Along the sides of a corridor the gap also leaves the side constraints
        `_CORRIDOR_SPEED`. Each gap is `_PASSAGE_SLACK` wider: the nearest of noisy returns is
        nearer than the surface. A robot that is seen whole creeps past it even in contact.
        """
        settings = self._settings
        width = 2.0 * float(np.abs(self._outline.corners[:, 1]).max())
        age = self._spec.latency + REACTION_TIME
        others = settings.others_speed if settings.responsibility == "passive" else 0.0
        post = settings.margin + settings.unseen_extent + others * (age + TICK) + _PASSAGE_SLACK
        mean_age = age + 0.5 / self._spec.rate
        contact = self._contact_gap_beside()
        rest = _CORRIDOR_SPEED * math.sin(SIDE_ANGLE) + self._side_reserve
        side = contact + 2.0 * (mean_age + TICK) * rest + _PASSAGE_SLACK
        creeping = post
        if self._may_creep:
            slack = _PASSAGE_SLACK if settings.unseen_extent > 0.0 else 0.0
            creeping = contact + 2.0 * (mean_age + TICK) * CREEP_SPEED + slack
        if settings.keep_out is not None:
            side = post = max(side, post, settings.keep_out + _PASSAGE_SLACK - 0.5 * width)
        door = width + 2.0 * min(creeping, post)
        corridor = max(door, width + 2.0 * side)
        return NarrowestPassage(door, corridor, corridor + width + post)

    def _contact_gap_beside(self) -> float:
        """m from the outline within which a wall along the way may touch the robot unseen."""
        corners = self._outline.corners[:, 0]
        places = np.linspace(corners.min(), corners.max(), _PLACES_BESIDE)
        x = np.concatenate((places, places))
        y = np.repeat((-2.0 * self._outer, 2.0 * self._outer), _PLACES_BESIDE)
        hidden = hidden_gaps(self._outline.separations(x, y), x, y, self._offset, self._blind)
        return self._settings.margin + self._settings.unseen_extent + float(hidden.max())

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """Take in a new scan: find the returns that are near enough to constrain the robot.

        The time of a scan is that of its newest ray. A scan that lacks a sector has the age of what
        the conditioner remembers of that sector. A scan that is not newer than the last one by this
        age is ignored: the last one is dead-reckoned, the remembered sector is not.
        """
        self._dead_reckoning.update(context)
        ages = np.zeros(len(scan.ranges)) if scan.ages is None else scan.ages
        oldest = float(ages.max(initial=0.0))
        latency = self._newest_age(scan) + context.scan_delay
        age = context.scan_age or 0.0
        taken = context.now - latency - age
        if age > 0.0 and taken < self._taken + AGE_TOLERANCE:
            return
        pose = self._dead_reckoning.pose(context, latency)
        if self._memory is not None:
            seconds, last = max(taken - self._taken, 0.0), self._taken_at
            if self._clock_resets != self._dead_reckoning.clock_resets:  # by the speed alone
                last = self._dead_reckoning.pose(context, latency + min(seconds, self._stale))
            self._memory.update(scan, geometry, relative(pose, last), seconds)
        self._taken_at, self._taken = pose, taken
        self._lag, self._clock_resets = age, self._dead_reckoning.clock_resets
        late = context.scan_delay + oldest
        self._obstacles = self._near_obstacles(scan, geometry, ages, oldest, late)
        self._feasible = None

    def _newest_age(self, scan: Scan) -> float:
        """How old the newest ray of a scan was on arrival in s, by the platform's latency.

        Rays of the scan before, which fill a sector that a turn left unmeasured, change the mean of
        the ages, but not this age; so conditioning tells it.
        """
        if scan.newest_age is not None:
            return scan.newest_age
        ages = scan.ages
        mean = float(ages.mean()) if ages is not None and len(ages) else 0.0
        return max(self._spec.latency - mean, 0.0)

    def decide(
        self, requested: Twist, context: DecisionContext, *, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The feasible command nearest to `requested`; `requested` itself if it is feasible."""
        self._dead_reckoning.update(context)
        obstacles = self._obstacles
        is_free = touch is None and not (obstacles.is_near or len(obstacles.x))
        is_free = is_free and not self._told_near(context)
        if requested.is_zero or is_free:
            return ModeDecision(requested, is_active=False)
        if self._clock_resets != self._dead_reckoning.clock_resets:
            return ModeDecision(ZERO, is_active=True)  # the last scan has no valid pose any more
        along, speed = direction_and_speed(requested)
        limits = linear_limit(self._limits, along), self._limits.angular
        feasible = self._feasible_commands((context, along, touch), command, limits)
        if (
            self._decided is None
            or self._decided[0] is not feasible
            or self._decided[1] != requested
        ):
            self._decided = feasible, requested, self._limited(requested, speed, limits, feasible)
        return self._decided[2]

    def _limited(
        self, requested: Twist, speed: float, limits: Point, feasible: _Feasible
    ) -> ModeDecision:
        """The decision on a request at a linear `speed` in m/s in the direction of `feasible`."""
        along = feasible.situation[1]
        wanted = speed / limits[0], requested.angular / limits[1]
        point, tight = nearest_feasible(wanted, LIMIT_BOX, feasible.normals, feasible.caps)
        s, angular = point[0] * limits[0], point[1] * limits[1]
        s, angular = self._with_clear_stop(s, angular, limits, feasible)
        if point == wanted and (s, angular) == (point[0] * limits[0], point[1] * limits[1]):
            return ModeDecision(requested, is_active=False)
        rows = feasible.rows
        if feasible.creeping is not None and 0.0 < abs(speed) <= SLOW_REQUEST:
            slow, by = nearest_feasible(wanted, LIMIT_BOX, *feasible.creeping)
            off = math.hypot(s / limits[0] - wanted[0], angular / limits[1] - wanted[1])
            if math.hypot(slow[0] - wanted[0], slow[1] - wanted[1]) < off - CREEP_GAIN:
                s, angular, tight = slow[0] * limits[0], slow[1] * limits[1], by
                rows = rows._replace(caps=feasible.creeping[1][: len(rows.caps)])
        if not tight and len(feasible.placed.rows):  # limited by the stop: the nearest obstacle
            first = feasible.placed.rows
            tight = [int(first[rows.gaps[first].argmin()])]
        twist = Twist(s * along[0], angular, s * along[1])
        return ModeDecision(twist, is_active=True, rows=report(rows, tight, self._outline))

    def _feasible_commands(self, situation: _Situation, command: Twist, limits: Point) -> _Feasible:
        """The feasible commands, computed once for all requested commands of one situation."""
        if self._feasible is None or self._feasible.situation != situation:
            context, along, touch = situation
            rows, seen = self._constraints(self._obstacles, context, command, along, touch)
            placed, told = seen, self._told_near(context)
            for one in told:
                rows, placed = self._with_told(rows, placed, one, context, command, along)
            is_touching = bool(((seen.gaps <= seen.contact) & (rows.caps[seen.rows] <= 0.0)).any())
            is_touching |= self._may_touch(placed.beyond(len(seen.rows)))
            speed = CREEP_SPEED if is_touching else self._surface_speed
            normals = np.array((rows.linear * limits[0], rows.lever * limits[1])).T
            bounds, creeping = (normals, rows.caps), None
            is_near = self._obstacles.is_near
            if is_near or told:
                bounds = self._with_envelope(normals, rows.caps, along, limits, speed)
            rest = 0.5 * (seen.gaps - seen.contact) / (seen.ages + TICK)
            least = float(rest.min(initial=CREEP_SPEED))
            if self._may_creep and least > 0.0 and touch is None and not told and is_near:
                caps = np.maximum(rows.caps, least)
                creeping = self._with_envelope(normals, caps, along, limits, CREEP_SPEED)
            self._feasible = _Feasible(situation, rows, placed, len(seen.rows), *bounds, creeping)
        return self._feasible

    def _with_clear_stop(
        self, s: float, angular: float, limits: Point, feasible: _Feasible
    ) -> tuple[float, float]:
        """The speeds, or less if the outline would not stay clear while the robot brakes."""
        _, along, touch = feasible.situation
        settings, first = self._settings, len(self._obstacles.rays)
        placed = feasible.placed
        seconds = TICK + max(
            abs(s) / settings.braking_linear, abs(angular) / settings.braking_angular
        )
        others = settings.others_speed if settings.responsibility == "passive" else 0.0
        need = placed.free + others * placed.ages
        reached = need + others * seconds + (abs(s) + abs(angular) * self._radius) * seconds
        near = np.flatnonzero(placed.gaps[first:] <= reached[first:]) + first
        if touch is not None:
            separations = self._outline.separations(placed.x[near], placed.y[near])
            near = near[~in_touch_zone(separations, touch) | (near >= feasible.seen)]
        if not len(near):
            return s, angular
        # Of two speeds, one of which opens what the other closes, a share of one may close.
        wanted = np.array((s / limits[0], angular / limits[1]))
        excess = (SPEED_SHARES * wanted) @ feasible.normals.T - feasible.caps
        shares = SPEED_SHARES[(excess <= TOLERANCE).all(axis=1)]
        points = np.stack((placed.x[near], placed.y[near]), axis=1)
        speeds = self._stop_check.limited(
            np.array((s, angular)),
            np.array(along),
            points,
            placed.gaps[near],
            need[near],
            need[near] - settings.margin,
            others,
            shares,
        )
        return float(speeds[0]), float(speeds[1])

    def _may_touch(self, told: _Placed) -> bool:
        """Whether a told obstacle may touch the robot.

        It is somewhere in its disc. Once the disc may have reached the outline, the direction to
        its middle does not show on which side the obstacle is.
        """
        settings = self._settings
        left = told.gaps - (told.free - settings.margin)
        return bool((left <= settings.others_speed * (told.ages + TICK)).any())

    def _with_envelope(
        self, normals: Array, caps: Array, along: Point, limits: Point, speed: float
    ) -> tuple[Array, Array]:
        """Normals and caps, with those of the envelope for a speed in m/s."""
        key = along, speed
        if key not in self._envelopes:
            if len(self._envelopes) > _MAX_ENVELOPES:
                self._envelopes.clear()
            self._envelopes[key] = half_planes(
                envelope(self._outline.corners, along, limits, speed)
            )
        more, others = self._envelopes[key]
        return np.concatenate((normals, more)), np.concatenate((caps, others))

    def _constraints(
        self,
        obstacles: _NearObstacles,
        context: DecisionContext,
        command: Twist,
        along: Point,
        touch: TouchZone | None,
    ) -> tuple[Constraints, _Placed]:
        """All constraints of seen obstacles, first one for each near point, and these points."""
        frame = relative(self._taken_at, self._dead_reckoning.predicted_pose(context, command))
        age = context.now - self._taken + REACTION_TIME
        furthest = self._binding_range.for_scan_age(age + obstacles.oldest)
        count = int(obstacles.gaps.searchsorted(furthest))
        ages = age + obstacles.ages[:count]
        x, y = placed(obstacles.x[:count], obstacles.y[:count], frame)
        separations = self._outline.separations(x, y)
        frees = np.full(count, self._free(context))
        contact = frees + hidden_gaps(separations, x, y, self._offset, self._blind)
        seen = _Placed(np.arange(count), x, y, separations.gap, ages, frees, contact)
        rows = self._obstacle_constraints(separations, seen, along)
        if self._settings.unseen_extent > 0.0:
            contacts = len(obstacles.rays)  # their places on the outline are a guess
            rows = concatenated(rows, self._corner_constraints(seen.beyond(contacts), along))
        if len(obstacles.rays):
            rows = self._with_contacts(rows, obstacles, frame, along)
        if self._settings.keep_out is not None:
            rows = self._with_keep_out(rows, self._settings.keep_out, along, ages)
        if touch is not None:
            rows = self._with_touch_zone(rows, touch, along)
        return rows, seen

    def _told_near(self, context: DecisionContext) -> list[ToldObstacle]:
        """The obstacles that the robot is told of which can bind it; far ones change nothing."""
        radius = self._radius
        return [
            one
            for one in context.told + context.near
            if not math.hypot(one.x, one.y) - one.radius - radius
            > self._binding_range.for_age(one.age + REACTION_TIME)
        ]

    def _with_told(
        self, rows: Constraints, placed_ones: _Placed, told: ToldObstacle,
        context: DecisionContext, command: Twist, along: Point,
    ) -> tuple[Constraints, _Placed]:  # fmt: skip
        """The constraints and obstacles with those of a disc that the robot is told of.

        The gap to a disc is that to its centre less its radius, along the same line. So its radius
        adds to what must stay free around the centre, as that of unseen parts does for returns.
        """
        predicted = self._dead_reckoning.predicted_pose(context, command)
        frame = relative(self._dead_reckoning.pose(context, told.age), predicted)
        x, y = placed(np.array([told.x]), np.array([told.y]), frame)
        separations = self._outline.separations(x, y)
        least = self._settings.margin + told.radius
        free = np.array([least + self._late(context) * self._surface_speed])
        ages, first = np.array([told.age + REACTION_TIME]), np.array([len(rows.caps)])
        disc = _Placed(first, x, y, separations.gap, ages, free, free)
        more = self._obstacle_constraints(separations, disc, along)
        more = concatenated(more, self._corner_constraints(disc, along))
        rim_x, rim_y = x - told.radius * separations.nx, y - told.radius * separations.ny
        count = len(more.caps)
        more = more._replace(
            x=np.repeat(rim_x, count), y=np.repeat(rim_y, count), gaps=more.gaps - told.radius
        )
        return concatenated(rows, more), placed_ones.followed_by(disc)

    def _obstacle_constraints(
        self, separations: Separations, placed: _Placed, along: Point
    ) -> Constraints:
        """One constraint for each obstacle, then the side constraints."""
        x, y, ages = placed.x, placed.y, placed.ages
        rows = self._point_constraints(
            separations, separations.gap - placed.free, x, y, along, ages
        )
        rest = 0.5 * (separations.gap - placed.contact) / (ages + TICK)
        rest -= self._side_reserve
        corners = self._outline.corners
        return concatenated(
            rows, side_constraints(rows, separations, corners, along, rest, CREEP_SPEED)
        )

    def _point_constraints(
        self, separations: Separations, room: Array, x: Array, y: Array, along: Point, ages: Array
    ) -> Constraints:
        """The constraints of points at `x`, `y` (k,) with so much room (k,) in m."""
        linear = separations.nx * along[0] + separations.ny * along[1]
        caps = self._caps(room, self._braking(linear, separations.lever), ages)
        return Constraints(linear, separations.lever, caps, x, y, separations.gap)

    def _corner_constraints(self, placed: _Placed, along: Point) -> Constraints:
        """Constraints of each own corner, for obstacles that extend beyond their visible part.

        Then the nearest place of the outline is not the only one that can touch the obstacle: a
        corner that swings past it can, too.
        """
        reach = 2.0 * placed.free + self._settings.others_speed * (placed.ages + TICK)
        near = np.flatnonzero(placed.gaps <= reach)
        corners = self._outline.corners
        x, y, ages, free = (
            np.tile(part[near], len(corners))
            for part in (placed.x, placed.y, placed.ages, placed.free)
        )
        own_x, own_y = np.repeat(corners[:, 0], len(near)), np.repeat(corners[:, 1], len(near))
        dx, dy = x - own_x, y - own_y
        distance = np.maximum(np.hypot(dx, dy), 1e-9)
        nx, ny = dx / distance, dy / distance
        separations = Separations(distance, nx, ny, own_x * ny - own_y * nx)
        return self._point_constraints(separations, distance - free, x, y, along, ages)

    def _braking(self, linear: Array, lever: Array) -> Array:
        """(k,) m/s2: the rate at which the closing speeds of constraints (k,) can fall."""
        braking: Array = np.abs(linear) * self._settings.braking_linear
        braking += np.abs(lever) * self._settings.braking_angular
        np.maximum(braking, MIN_BRAKING, out=braking)
        return braking

    def _caps(self, room: Array, braking: Array, unseen: Array | float) -> Array:
        settings = self._settings
        if settings.responsibility == "reciprocal":
            return reciprocal_caps(room, braking, unseen, TICK)
        return passive_caps(room, braking, settings.others_speed, unseen, TICK)

    def _with_contacts(
        self, rows: Constraints, obstacles: _NearObstacles, frame: Pose, along: Point
    ) -> Constraints:
        """Returns too close to measure count as contact: cap 0, also along their rays.

        Without the constraint along the ray, a corner that grazes a slanted surface would have only
        a constraint across its path.
        """
        count = len(obstacles.rays)
        caps = rows.caps.copy()
        caps[:count] = 0.0
        cos, sin = math.cos(frame.yaw), math.sin(frame.yaw)
        nx = cos * obstacles.rays[:, 0] - sin * obstacles.rays[:, 1]
        ny = sin * obstacles.rays[:, 0] + cos * obstacles.rays[:, 1]
        x, y = rows.x[:count], rows.y[:count]
        zeros = np.zeros(len(x))
        return concatenated(
            rows._replace(caps=caps),
            Constraints(nx * along[0] + ny * along[1], x * ny - y * nx, zeros, x, y, zeros),
        )

    def _with_keep_out(
        self, rows: Constraints, radius: float, along: Point, ages: Array
    ) -> Constraints:
        """Constraints that keep the circle around a sensor with a blind zone free.

        Each of two robots keeps out of the circle by half of the distance. The first of `rows` are
        those of the points, which were seen `ages` (k,) s ago.
        """
        x, y, gaps = (part[: len(ages)] for part in (rows.x, rows.y, rows.gaps))
        dx, dy = x - self._offset[0], y - self._offset[1]
        distance = np.maximum(np.hypot(dx, dy), 1e-9)
        nx, ny = dx / distance, dy / distance
        linear = nx * along[0] + ny * along[1]
        lever = self._offset[0] * ny - self._offset[1] * nx  # of the centre: a circle has no corner
        caps = reciprocal_caps(distance - radius, self._braking(linear, lever), ages, TICK)
        return concatenated(rows, Constraints(linear, lever, caps, x, y, gaps))

    def _with_touch_zone(self, rows: Constraints, touch: TouchZone, along: Point) -> Constraints:
        """The constraints with the speed of the touch zone granted for obstacles in its sector.

        The direction from the outline decides, not the bearing from the axle: seen from the axle a
        pushed box is wider than any sector. No corner may move faster in the zone's directions,
        since a pushed object is not always seen.
        """
        separations = self._outline.separations(rows.x, rows.y)
        is_inside = in_touch_zone(separations, touch)
        caps = np.where(is_inside, np.maximum(rows.caps, touch.speed), rows.caps)
        nx, ny, x, y = touch_directions(self._outline.corners, touch)
        speeds, gaps = np.full(len(x), touch.speed), np.full(len(x), np.inf)  # without a return
        linear, lever = nx * along[0] + ny * along[1], x * ny - y * nx
        return concatenated(
            rows._replace(caps=caps), Constraints(linear, lever, speeds, x, y, gaps)
        )

    def _near_obstacles(
        self, scan: Scan, geometry: ScanGeometry, ages: Array, oldest: float, late: float
    ) -> _NearObstacles:
        """The returns that can bind the robot, and the rays that are too close to measure.

        `ages` (n,) and `oldest` in s are those of the rays; `late` s more than the platform's
        latency may have passed since the oldest.
        """
        furthest = self._binding_range.for_scan_age(self._stale + late)
        within = self._within + self._settings.others_speed * late
        outermost = max(within, furthest) + self._outer
        shown = np.flatnonzero((scan.ranges <= outermost) & (scan.ranges > -np.inf))
        points, since = geometry.points_of_rays(scan, shown), ages[shown]
        gaps = self._outline.gaps(points)
        is_close = scan.ranges == -np.inf
        rays, close_since = geometry.directions(scan)[is_close], ages[is_close]
        if self._memory is not None and len(self._memory.bearings):
            touching, hidden = self._remembered(self._memory)
            rays = np.concatenate((rays, touching))
            close_since = np.concatenate((close_since, np.full(len(touching), oldest)))
            points = np.concatenate((points, hidden))
            since = np.concatenate((since, np.full(len(hidden), oldest)))
            gaps = np.concatenate((gaps, self._outline.gaps(hidden)))
        is_near = bool(len(rays)) or float(gaps.min(initial=np.inf)) <= within
        order = np.argsort(gaps, kind="stable")[: np.count_nonzero(gaps <= furthest)]
        gaps, since, (x, y) = gaps.take(order), since.take(order), points.take(order, axis=0).T
        if not len(rays):
            return _NearObstacles(x, y, gaps, since, _NO_RAYS, is_near, oldest)
        depths = self._outline.along_rays(self._offset, rays)
        contacts = (self._offset + depths[:, None] * rays).T
        x, y = np.concatenate((contacts[0], x)), np.concatenate((contacts[1], y))
        gaps = np.concatenate((np.zeros(len(rays)), gaps))
        since = np.concatenate((close_since, since))
        return _NearObstacles(x, y, gaps, since, rays, is_near, oldest)

    def _remembered(self, memory: BlindZoneMemory) -> tuple[Array, Array]:
        """Rays (k, 2) to hidden obstacles that may touch the robot, points (m, 2) of others."""
        rays = np.stack((np.cos(memory.bearings), np.sin(memory.bearings)), axis=1)
        outline = self._outline.along_rays(self._offset, rays)
        is_beyond = memory.nearest > outline
        points = self._offset + memory.nearest[is_beyond, None] * rays[is_beyond]
        return rays[~is_beyond], points

    def _free(self, context: DecisionContext) -> float:
        """m that must stay free around each return, for unseen parts and unknown motion.

        Odometry may be old, and the remembered part of a scan is not dead-reckoned.
        """
        blurred = (self._late(context) + self._lag) * self._surface_speed
        return self._settings.margin + self._settings.unseen_extent + blurred

    def _late(self, context: DecisionContext) -> float:
        """s for which the motion of the robot is not known."""
        return max((context.odometry_age or 0.0) - MAX_EXTRAPOLATION, 0.0)
