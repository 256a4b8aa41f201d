"""Attraction: the robots gather in one cluster.

Source of law "paper": Kaiser et al., ICRA 2022, pattern "attraction", and its code ROS2swarm: an
attractive potential field over all returns of the lidar, always at full speed. The robots never
settle, and walls attract more than robots.

Law "settling" is ours. An object attracts if it may be a robot: not wider than `object_width`, and
not partly hidden by a nearer object. The attraction grows with the distance, as in the paper, and
beyond all bounds at `range`, so that a robot between two others keeps the farther one in sight.
Near obstacles limit only the speed towards them, so that the robot slides past. The robot rests
once the attraction is small.

Attraction alone would leave a row unchanged, since the robots of a row hide one another. So a robot
may roll: move along the outside of the group until three robots are adjacent, as atoms do on a
crystal. A robot rolls from time to time if fewer than three robots are adjacent, but more are in
sight or send messages. If all robots in sight lie in a line, the robot rolls before it settles. The
time until the next roll doubles with each roll, so that the swarm comes to rest. The robot starts
with the first time again when it sees more robots than ever before. A robot with few robots in
sight finally leads: it drives away to search for the rest of the swarm. A robot that rolls or leads
keeps the robots in sight that it sees.

Robots that search, and groups with robots out of sight, drive to the middle of the free space
around them. In a room that the lidar sees whole they meet there. In the open there is no middle.

With `kin: true` a robot that names peers by their motion takes for robots what is at their places.

Limits: a robot within about 0.2 m of a wall is taken for a part of the wall, a pillar counts as a
robot where no peer is named, and groups farther apart than `range` meet only by chance where there
are no walls.
"""

from __future__ import annotations

import math
from operator import itemgetter
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
    RobotsInSight,
    Scan,
    TurnIfAlone,
    Twist,
    about,
    clear_distance,
    clusters,
    near_points,
    of_threshold,
    to_middle,
)

# Pull, as a share of full speed, below which a moving robot stops and above which it starts.
_STOP_PULL = 0.12
_START_PULL = 0.25
# Robots within so many times `spacing` are adjacent; on the rim of a hexagon each has three.
_ADJACENT_SPACINGS = 1.25
_MIN_ADJACENT = 3
# All robots lie in line if the mean of exp(2i bearing) is longer: within about 20 degrees.
_MIN_ALIGNMENT = 0.7
# Below this share of full speed a searching robot turns away from the obstacle instead.
_MIN_SEARCH_SPEED = 0.25
# Two adjacent robots are on different sides if the sine of the angle between them is larger.
_MIN_SIDE_SINE = 0.3
# s: duration of a roll.
_ROLL_TIME = 8.0
# With so few robots in sight the rest of the swarm may be lost: the robot leads (drives away to
# search) for so many s.
_FEW_ROBOTS = 2
_LEAD_TIME = 12.0
# Per m: how much stronger the way to the middle of the free space is than the heading of a search.
_MIDDLE_GAIN = 6.0
# Share of full speed at which a group that may be incomplete drives to the middle, at most.
_GROUP_SPEED = 0.5
# The time at rest before a try doubles with each try. s before the first roll (drive around the
# group); s from which on the robot leads instead, if few robots are in sight; s from which on the
# robot tries no more.
_FIRST_REST_TIME = 0.5
_LEAD_REST_TIME = 10.0
_MAX_REST_TIME = 40.0
# While searching the heading drifts by up to so many rad, for so many s.
_MAX_DRIFT = 0.4
_DRIFT_TIMES = (2.0, 5.0)
# s up to which an object at the known place of a neighbor is this neighbor.
_MAX_AGE = 2.0
# Beyond this share of its range the lidar sees only parts of an object, such as a wall.
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
            "distance from the axle to a neighbour at which its pull ends; at most range - brake",
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
            source="ours: 0.15 times the protection threshold: swarms are denser and rest",
            derived=of_threshold(0.15),
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
    kin: Annotated[
        bool,
        about(
            "only what a robot names as a peer by its motion attracts it, once it names any; from"
            " the start of a run on",
            source="ours: off, as in the paper, since peers then tell their motion",
        ),
    ] = False


class _Surroundings(NamedTuple):
    """The robots and near surfaces in one scan, in the base frame."""

    scan: Scan
    points: NearPoints  # of near surfaces
    robots: RobotsInSight
    adjacent: int  # number of robots that are near
    pull: Vector  # the sum of all attraction and of the way to the middle, at most 1 long
    free: float  # length of the pull that is left once it keeps clear of `points`
    is_line: bool  # all robots lie on one line through this robot
    middle: Vector  # towards the middle of the free space, where few robots are in sight; else 0


def _may_be_lost(seen: int, received: int) -> bool:
    """True if few robots are in sight (`seen`), and further robots may be out of sight.

    `received`: the number of robots that are heard. If robots are heard, but no more than are in
    sight, no further robot is assumed.
    """
    return seen <= _FEW_ROBOTS and not 0 < received <= seen


def _limited(x: float, y: float) -> Vector:
    """The vector (x, y), at most 1 long."""
    length = max(1.0, math.hypot(x, y))
    return x / length, y / length


def _is_incomplete(view: _Surroundings, received: int) -> bool:
    """True if too few robots are adjacent to this robot, although there are or may be more.

    `received`: the number of robots that are heard.
    """
    seen = len(view.robots.objects)
    are_some_apart = view.adjacent < len(view.robots.polar)
    has_more = received > seen or are_some_apart or _may_be_lost(seen, received)
    return view.adjacent < _MIN_ADJACENT and has_more


class Attraction(FieldPattern[AttractionParams]):
    """Drives to other robots and stands next to them; alone it searches."""

    group = "gather"
    params_type = AttractionParams
    field_kind = "attraction"
    is_symmetric = True

    def __init__(self, params: AttractionParams, context: Context) -> None:
        super().__init__(params, context)
        self.update(params)
        self.uses_places = params.kin and params.law == "settling"
        self.state = "search"
        self._since = 0.0  # s, the time at which `state` began
        self._rest_time = _FIRST_REST_TIME  # s in a state before the next try to roll or lead
        self._has_tried = False  # since `_rest_time` was reset
        self._most_seen = 0  # robots in one scan so far
        self._side = float(context.rng.choice((-1.0, 1.0)))  # of a roll: 1 left, -1 right
        self._drift = 0.0  # rad, the heading of a search
        self._drift_until = -math.inf  # s, the time at which `_drift` changes

    def update(self, params: AttractionParams) -> None:
        """Apply changed parameters, and evaluate the scan again."""
        super().update(params)
        self._view: _Surroundings | None = None  # of the last scan
        # For this view and state; neither `params` nor `_side` changes within both.
        self._command: Twist | None = None
        # `spacing`, so far within `range` that a robot which drifts away is still in sight.
        self._spacing = min(params.spacing, max(params.range - params.brake, 0.0))

    def settle(self, inputs: Inputs, scan: Scan) -> Twist:
        """Change the state (search, gather, settled, roll or lead); the command of the state."""
        now = inputs.now
        received = len(inputs.neighbors)
        if self._view is None or self._view.scan is not scan:
            self._view = self._look(scan, inputs)
            self._command = None
        view = self._view
        is_in_line = received > len(view.robots.objects) and view.is_line
        state = self._next_state(view, now, received, is_in_line)
        if state != self.state:
            self.state = state
            self._since = now
            self._command = None
        if state == "settled":
            return ZERO
        if state in ("search", "lead"):
            return self._follow(view, self._in_sight(view.robots, self._explore(view, now)))
        if self._command is None:  # two steps of a scan mostly have the same command
            vector = self._around(view) if state == "roll" else view.pull
            self._command = self._follow(view, vector)
        return self._command

    def _look(self, scan: Scan, inputs: Inputs) -> _Surroundings:
        """The robots and near surfaces in a scan, and the pull of the robots."""
        params = self.params
        received = len(inputs.neighbors)
        brake = params.brake
        offset = self.context.platform.scan.offset
        points = near_points(
            scan, within=params.spacing + brake + math.hypot(*offset), offset=offset
        )
        # Cut at `range`, a wall would be as narrow as a robot.
        objects = clusters(scan, within=scan.range_max).objects
        furthest = min(params.range, _MAX_RANGE_SHARE * scan.range_max)
        named = [
            (one.distance, one.bearing)
            for one in (inputs.neighbors if self.uses_places else ())
            if one.distance is not None and one.bearing is not None and one.age < _MAX_AGE
        ]
        robots = RobotsInSight(objects, params.object_width, furthest, offset, named)
        seen = len(robots.objects)
        middle = to_middle(scan, robots.narrow) if seen <= _FEW_ROBOTS else (0.0, 0.0)
        pull = _limited(*robots.pull(self._spacing, brake, params.range))
        if robots.polar and _may_be_lost(seen, received):
            x, y = _limited(_MIDDLE_GAIN * middle[0], _MIDDLE_GAIN * middle[1])
            vector = pull[0] + _GROUP_SPEED * x, pull[1] + _GROUP_SPEED * y
            pull = _limited(*self._in_sight(robots, vector))
        adjacent, alignment = robots.arrangement(_ADJACENT_SPACINGS * self._spacing)
        is_line = alignment > _MIN_ALIGNMENT * len(robots.polar)
        free = math.hypot(
            *points.keep_clear(*pull, spacing=self._spacing - params.slack, brake=brake)
        )
        return _Surroundings(scan, points, robots, adjacent, pull, free, is_line, middle)

    def _follow(self, view: _Surroundings, vector: Vector) -> Twist:
        """The command along `vector` (base frame, share of full speed), clear of near surfaces."""
        params = self.params
        points = view.points
        is_searching = self.state in ("search", "lead")
        # Nearer to a wall protection may hold the robot before it turns away.
        spacing = params.spacing if is_searching else self._spacing - params.slack
        brake = params.brake
        x, y = points.keep_clear(*vector, spacing=spacing, brake=brake)
        if is_searching and math.hypot(x, y) < _MIN_SEARCH_SPEED:
            return Twist(angular=math.copysign(0.5 * params.turn, self._drift))
        return points.steer(
            x,
            y,
            params.speed,
            params.turn,
            spacing=spacing,
            brake=brake,
            may_back=points.nearest < spacing,
        )

    def _in_sight(self, robots: RobotsInSight, vector: Vector) -> Vector:
        """The vector, limited so that it leads no farther than `range` from `robots`."""
        params = self.params
        return robots.keep_in_sight(*vector, reach=params.range, brake=params.brake)

    def _next_state(self, view: _Surroundings, now: float, received: int, is_in_line: bool) -> str:
        """The next state: search, gather, settled, roll or lead.

        `received`: the number of robots that are heard. `is_in_line`: all fully visible robots lie
        on one line through this robot, and more robots are heard than are in sight.
        """
        if not view.robots.polar:
            return "search"
        # 1. A roll or a lead continues for its time, unless it has reached its aim.
        in_state_s = now - self._since
        seen = len(view.robots.objects)
        sees_more_than_ever = seen > self._most_seen
        if sees_more_than_ever:
            self._most_seen = seen
            self._rest_time = _FIRST_REST_TIME
            self._has_tried = False
        is_incomplete = _is_incomplete(view, received)
        if self.state == "roll" and is_incomplete and in_state_s < _ROLL_TIME:
            return "roll"
        has_found_more = self.state == "lead" and sees_more_than_ever
        if self.state == "lead" and not has_found_more and in_state_s < _LEAD_TIME:
            return "lead"
        # 2. The pull moves the robot; a robot at rest needs a stronger pull.
        is_gathering = self.state == "gather" or has_found_more
        is_pulled = view.free > (_STOP_PULL if is_gathering else _START_PULL)
        # 3. A robot in a line rolls once before it settles. A settled robot tries again and again
        # to roll or to lead, until `_rest_time`, which each try doubles, is too long.
        rolls_in_line = is_in_line and is_gathering and not self._has_tried
        is_settled = self.state == "settled" and not is_pulled
        tries_again = is_settled and self._rest_time < _MAX_REST_TIME
        if (rolls_in_line or tries_again) and in_state_s > self._rest_time:
            if self._rest_time > _LEAD_REST_TIME and _may_be_lost(seen, received):
                return self._try("lead", view)
            if rolls_in_line or is_incomplete:
                return self._try("roll", view)
        return "gather" if is_pulled else "settled"

    def _try(self, state: str, view: _Surroundings) -> str:
        """Begin to roll or lead: sets the side of the roll and the time until the next try.

        If two robots are adjacent, the robot rolls around the nearer one, away from the other.
        """
        self._rest_time = 2.0 * self._rest_time
        self._has_tried = True
        if view.adjacent > 1:
            (_, first), (_, second) = sorted(view.robots.polar, key=itemgetter(0))[:2]
            turn = math.sin(second - first)
            self._side = -math.copysign(1.0, turn) if abs(turn) > _MIN_SIDE_SINE else self._side
        return state

    def _around(self, view: _Surroundings) -> Vector:
        """A vector around the nearest robot plus the pull of all robots, at most 1 long.

        It keeps all robots in sight.
        """
        ahead = min(view.robots.polar, key=itemgetter(0))[1] + self._side * math.pi / 2.0
        x = math.cos(ahead) + view.pull[0]
        y = math.sin(ahead) + view.pull[1]
        return _limited(*self._in_sight(view.robots, _limited(x, y)))

    def _explore(self, view: _Surroundings, now: float) -> Vector:
        """A unit vector to the middle of the free space; in the open and near the middle, ahead."""
        (ahead, left) = self._wander(now)
        (x, y) = view.middle
        x = ahead + _MIDDLE_GAIN * x
        y = left + _MIDDLE_GAIN * y
        length = math.hypot(x, y)
        return (x / length, y / length) if length else (1.0, 0.0)

    def _wander(self, now: float) -> Vector:
        """A unit vector ahead, with a random drift that changes from time to time."""
        if now >= self._drift_until:
            rng = self.context.rng
            self._drift_until = now + float(rng.uniform(*_DRIFT_TIMES))
            self._drift = float(rng.uniform(-_MAX_DRIFT, _MAX_DRIFT))
        return math.cos(self._drift), math.sin(self._drift)
