"""Attraction: the robots gather in one cluster.

Source of law "paper": Kaiser et al., ICRA 2022, pattern "attraction", and its code ROS2swarm: an
attractive potential field over all returns of the lidar, always at full speed. The robots never
settle, and walls attract more than robots.

Law "settling" is ours. An object attracts if it may be a robot: not wider than `object_width`, and
not partly hidden by a nearer object. The attraction grows with the distance, as in the paper. Near
obstacles limit only the speed towards them, so that the robot slides past. The robot rests once the
attraction is small.

Attraction alone would leave a row unchanged, since the robots of a row hide one another. So a robot
may roll: move along the outside of the group until three robots are adjacent, as atoms do on a
crystal. A robot rolls from time to time if fewer than three robots are adjacent, but more are in
sight or send messages. If all robots in sight lie in a line, the robot rolls before it settles. The
time until the next roll doubles with each roll, so that the swarm comes to rest. The robot starts
with the first time again when it sees more robots than ever before. A robot with few robots in
sight finally leads: it drives away to search for the rest of the swarm.

Limits: a robot within about 0.2 m of a wall is taken for a part of the wall, a pillar counts as a
robot, and groups farther apart than `range` meet only by chance.
"""

from __future__ import annotations

import cmath
import math
from typing import Annotated, NamedTuple, TypeAlias

from swarmd.api import (
    ZERO,
    Bias,
    Context,
    FieldParams,
    FieldPattern,
    Inputs,
    NearPoints,
    ObjectWidth,
    Scan,
    TurnIfAlone,
    Twist,
    about,
    clear_distance,
    closest_points,
    clusters,
    of_threshold,
    polar_from_base,
)

# Pull, as a share of full speed, below which a moving robot stops and above which it starts.
_STOP_PULL, _START_PULL = 0.12, 0.25
# Robots within so many times `spacing` are adjacent; on the rim of a hexagon each has three.
_ADJACENT_SPACINGS, _MIN_ADJACENT = 1.25, 3
# All robots lie in line if the mean of exp(2i bearing) is longer: within about 20 degrees.
_MIN_ALIGNMENT = 0.7
# Below this share of full speed a searching robot turns away from the obstacle instead.
_MIN_SEARCH_SPEED = 0.25
# Two adjacent robots are on different sides if the sine of the angle between them is larger.
_MIN_SIDE_SINE = 0.3
# s: duration of a roll.
_ROLL_TIME = 8.0
# With so few robots in sight the rest of the swarm may be lost: the robot leads (drives away to
# search) for so many s, at this share of full speed.
_FEW_ROBOTS = 2
_LEAD_TIME, _LEAD_SPEED = 12.0, 0.6
# The time at rest before a try doubles with each try. s before the first roll (drive around the
# group); s from which on the robot leads instead, if few robots are in sight; s from which on the
# robot tries no more.
_FIRST_REST_TIME = 0.5
_LEAD_REST_TIME = 10.0
_MAX_REST_TIME = 40.0
# While searching the heading drifts by up to so many rad, for so many s.
_MAX_DRIFT = 0.4
_DRIFT_TIMES = (2.0, 5.0)
# Beyond this share of `range` the lidar sees only parts of an object, such as a wall.
_MAX_RANGE_SHARE = 0.95

Vector: TypeAlias = tuple[float, float]


class AttractionParams(FieldParams, frozen=True, kw_only=True):
    """The reach of each law, the distances, and those of every FieldPattern."""

    paper_range: Annotated[
        float, about("law paper: reach of the field", ge=0.05, le=100.0, unit="m", source="paper")
    ] = 2.0
    bias: Bias = -1.0
    angular_if_alone: TurnIfAlone = 1.0
    range: Annotated[
        float,
        about(
            "distance up to which robots attract",
            ge=0.05,
            le=100.0,
            unit="m",
            source="ours: the range of the lidar, so that no group is left behind",
            derived=lambda platform: platform.scan.range_max,
        ),
    ]
    spacing: Annotated[
        float,
        about(
            "distance from the axle to a neighbour at which its pull ends",
            ge=0.05,
            le=20.0,
            unit="m",
            source="ours: 1.06 times the protection threshold plus 1.3 times the lidar's offset, "
            "so that turning in place does not activate protection",
            derived=clear_distance,
        ),
    ]
    slack: Annotated[
        float,
        about(
            "how much nearer than spacing another robot may come before this one backs off",
            ge=0.0,
            le=5.0,
            unit="m",
            source="ours: a twentieth of the protection threshold",
            derived=of_threshold(0.05),
        ),
    ]
    brake: Annotated[
        float,
        about(
            "distance over which the speed towards an obstacle falls to zero",
            ge=0.02,
            le=5.0,
            unit="m",
            source="ours: 0.6 times the protection threshold; two robots that meet need it",
            derived=of_threshold(0.6),
        ),
    ]
    object_width: ObjectWidth


class _Surroundings(NamedTuple):
    """The robots and near surfaces in one scan, in the base frame."""

    scan: Scan
    points: NearPoints  # of near surfaces
    robots: list[tuple[float, float]]  # range and bearing of each fully visible robot
    seen: int  # number of robots in sight: those of `robots`, and partly hidden robots
    adjacent: int  # number of robots of `robots` that are near
    pull: Vector  # the sum of all attraction, at most 1 long
    free: float  # length of the pull that is left once it keeps clear of `points`
    is_line: bool  # all robots lie on one line through this robot

    @property
    def nearest(self) -> tuple[float, float]:
        """The range and bearing of the nearest robot."""
        return min(self.robots, key=_range)


def _range(robot: tuple[float, float]) -> float:
    return robot[0]


def _may_be_lost(view: _Surroundings, received: int) -> bool:
    """True if few robots are in sight, and further robots may be out of sight.

    `received`: the number of robots that are heard. No robot is out of sight if robots are heard,
    and as many are in sight.
    """
    are_all_in_sight = 0 < received <= view.seen
    return view.seen <= _FEW_ROBOTS and not are_all_in_sight


def _is_incomplete(view: _Surroundings, received: int) -> bool:
    """True if too few robots are adjacent to this robot, although there are or may be more.

    `received`: the number of robots that are heard.
    """
    are_more_heard = received > view.seen
    are_some_apart = view.adjacent < len(view.robots)
    has_more = are_more_heard or are_some_apart or _may_be_lost(view, received)
    return view.adjacent < _MIN_ADJACENT and has_more


class Attraction(FieldPattern[AttractionParams]):
    """Drives to other robots and stands next to them; alone it searches."""

    group = "gather"
    params_type = AttractionParams
    field_kind = "attraction"
    is_symmetric = True

    def __init__(self, params: AttractionParams, context: Context) -> None:
        super().__init__(params, context)
        self.state = "search"
        self._since = 0.0  # s, the time at which `state` began
        self._rest_time = _FIRST_REST_TIME  # s in a state before the next try to roll or lead
        self._has_tried = False  # since `_rest_time` was reset
        self._most_seen = 0  # robots in one scan so far
        self._side = float(context.rng.choice((-1.0, 1.0)))  # of a roll: 1 left, -1 right
        self._view: _Surroundings | None = None  # of the last scan
        self._drift = 0.0  # rad, the heading of a search
        self._drift_until = -math.inf  # s, the time at which `_drift` changes

    def update(self, params: AttractionParams) -> None:
        """Apply changed parameters, and evaluate the scan again."""
        super().update(params)
        self._view = None

    def settle(self, inputs: Inputs, scan: Scan) -> Twist:
        """Change the state (search, gather, settled, roll or lead); the command of the state."""
        now, received = inputs.now, len(inputs.neighbors)
        if self._view is None or self._view.scan is not scan:
            self._view = self._look(scan)
        view = self._view
        is_in_line = received > view.seen and view.is_line
        state = self._next_state(view, now, received, is_in_line)
        if state != self.state:
            self.state, self._since = state, now
        if state == "settled":
            return ZERO
        if state == "search":
            return self._follow(view, self._wander(now))
        if state == "lead":
            (x, y), (back_x, back_y) = self._wander(now), self._toward(view)
            return self._follow(view, (_LEAD_SPEED * x - back_x, _LEAD_SPEED * y - back_y))
        return self._follow(view, self._around(view) if state == "roll" else view.pull)

    def _look(self, scan: Scan) -> _Surroundings:
        """The robots and near surfaces in a scan, and the pull of the robots."""
        params = self.params
        offset = self.context.platform.scan.offset
        spacing = params.spacing - params.slack
        reach = spacing + params.brake + math.hypot(*offset)
        surfaces = closest_points(scan, within=reach).tolist()
        points = NearPoints(polar_from_base(surfaces, offset))
        robots, seen = self._robots(scan)
        robots = polar_from_base(robots, offset)
        near = _ADJACENT_SPACINGS * params.spacing
        adjacent, axis = 0, 0j
        for distance, bearing in robots:
            adjacent += distance < near
            axis += cmath.rect(1.0, 2.0 * bearing)  # doubled: ahead and behind are one line
        pull = self._pull(robots)
        free = math.hypot(*points.keep_clear(*pull, spacing=spacing, brake=params.brake))
        is_line = abs(axis) > _MIN_ALIGNMENT * len(robots)
        return _Surroundings(scan, points, robots, seen, adjacent, pull, free, is_line)

    def _follow(self, view: _Surroundings, vector: Vector) -> Twist:
        """The command along `vector` (base frame, share of full speed), clear of near surfaces."""
        params = self.params
        points = view.points
        spacing, brake = params.spacing - params.slack, params.brake
        x, y = points.keep_clear(*vector, spacing=spacing, brake=brake)
        if self.state in ("search", "lead") and math.hypot(x, y) < _MIN_SEARCH_SPEED:
            return Twist(angular=math.copysign(0.5 * params.turn, self._drift))
        may_back = points.nearest < spacing
        return points.steer(
            x, y, params.speed, params.turn, spacing=spacing, brake=brake, may_back=may_back
        )

    def _robots(self, scan: Scan) -> tuple[list[tuple[float, float]], int]:
        """Range and bearing of each visible robot, and the number with those partly hidden."""
        params = self.params
        objects = clusters(scan, within=params.range).objects
        furthest = _MAX_RANGE_SHARE * params.range
        robots, seen = [], 0
        for distance, bearing, width, _, is_free in objects:
            if width <= params.object_width and distance <= furthest:
                seen += 1
                if is_free:
                    robots.append((distance, bearing))
        return robots, seen

    def _pull(self, robots: list[tuple[float, float]]) -> Vector:
        """The sum of the attraction of all robots: a vector in the base frame, at most 1 long.

        The attraction of a robot is 0 at `spacing` and grows with its range.
        """
        spacing, brake = self.params.spacing, self.params.brake
        x = y = 0.0
        for distance, bearing in robots:
            if distance > spacing:
                weight = (distance - spacing) / brake
                x += weight * math.cos(bearing)
                y += weight * math.sin(bearing)
        length = max(1.0, math.hypot(x, y))
        return x / length, y / length

    def _next_state(self, view: _Surroundings, now: float, received: int, is_in_line: bool) -> str:
        """The next state: search, gather, settled, roll or lead.

        `received`: the number of robots that are heard. `is_in_line`: all fully visible robots lie
        on one line through this robot, and more robots are heard than are in sight.
        """
        if len(view.robots) == 0:
            return "search"
        in_state_s = now - self._since
        sees_more_than_ever = view.seen > self._most_seen
        if sees_more_than_ever:
            self._most_seen = view.seen
            self._rest_time, self._has_tried = _FIRST_REST_TIME, False
        is_incomplete = _is_incomplete(view, received)
        if self.state == "roll" and is_incomplete and in_state_s < _ROLL_TIME:
            return "roll"
        # A robot that leads gathers once it sees more robots: it has found the rest of the swarm.
        if self.state == "lead" and not sees_more_than_ever and in_state_s < _LEAD_TIME:
            return "lead"
        is_gathering = self.state == "gather" or (self.state == "lead" and sees_more_than_ever)
        is_pulled = view.free > (_STOP_PULL if is_gathering else _START_PULL)
        # A robot in a line rolls once before it settles. A settled robot tries several times.
        is_line_roll = is_in_line and is_gathering and not self._has_tried
        may_try_again = (
            self.state == "settled" and not is_pulled and self._rest_time < _MAX_REST_TIME
        )
        if (is_line_roll or may_try_again) and in_state_s > self._rest_time:
            if self._rest_time > _LEAD_REST_TIME and _may_be_lost(view, received):
                return self._try("lead", view)
            if is_line_roll or is_incomplete:
                return self._try("roll", view)
        return "gather" if is_pulled else "settled"

    def _try(self, state: str, view: _Surroundings) -> str:
        """Begin to roll or lead: sets the side of the roll and the time until the next try.

        If two robots are adjacent, the robot rolls around the nearer one, away from the other.
        """
        self._rest_time, self._has_tried = 2.0 * self._rest_time, True
        if view.adjacent > 1:
            (_, first), (_, second) = sorted(view.robots, key=_range)[:2]
            turn = math.sin(second - first)
            self._side = -math.copysign(1.0, turn) if abs(turn) > _MIN_SIDE_SINE else self._side
        return state

    def _toward(self, view: _Surroundings) -> Vector:
        """A vector towards the nearest robot, 0 beyond twice `spacing`."""
        near, bearing = view.nearest
        weight = min(max(2.0 - near / self.params.spacing, 0.0), 1.0)
        return weight * math.cos(bearing), weight * math.sin(bearing)

    def _around(self, view: _Surroundings) -> Vector:
        """A vector around the nearest robot plus the pull of all robots, at most 1 long."""
        ahead = view.nearest[1] + self._side * math.pi / 2.0
        x, y = math.cos(ahead) + view.pull[0], math.sin(ahead) + view.pull[1]
        length = max(1.0, math.hypot(x, y))
        return x / length, y / length

    def _wander(self, now: float) -> Vector:
        """A unit vector ahead, with a random drift that changes from time to time."""
        if now >= self._drift_until:
            rng = self.context.rng
            self._drift_until = now + float(rng.uniform(*_DRIFT_TIMES))
            self._drift = float(rng.uniform(-_MAX_DRIFT, _MAX_DRIFT))
        return math.cos(self._drift), math.sin(self._drift)
