"""Attraction: the robots gather in one cluster.

Source of law "paper": Kaiser et al., ICRA 2022, pattern "attraction", and its code ROS2swarm: an
attractive potential field over all returns of the lidar, always at full speed. It never settles,
and walls attract more than robots.

Law "settling" is ours. An object attracts if it may be a robot: it is not wider than `object_width`
and nothing nearer hides part of it. The attraction grows with the distance, as in the paper. Near
obstacles limit only the speed towards them, so that the robot slides past. The robot rests once the
attraction is small.

Attraction alone would leave a row unchanged, since its robots hide one another. Therefore a robot
with fewer than three adjacent robots, but with more in sight or more that send messages, moves
along the outside of the group from time to time until three are adjacent, as atoms do on a crystal.
It does so before it settles if all robots in sight lie in a line. The time between tries doubles
with each try, so that the swarm comes to rest. It is reset when more robots are in sight than ever
before. A robot with few others in sight finally drives away to search for the rest.

Limits: a robot within about 0.2 m of a wall is not distinguished from it, a pillar counts as a
robot, and groups farther apart than `range` meet only by chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from swarmd.api import (
    ZERO,
    Array,
    Bias,
    Context,
    FieldParams,
    FieldPattern,
    Inputs,
    ObjectWidth,
    Scan,
    TurnIfAlone,
    Twist,
    about,
    clear_distance,
    closest_points,
    clusters,
    from_base,
    keep_clear,
    of_threshold,
    steer,
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
# With so few robots in sight the rest may be lost. s and share of full speed for which it leads.
_FEW_ROBOTS = 2
_LEAD_TIME, _LEAD_SPEED = 12.0, 0.6
# s at rest before it rolls the first time; above which it leads instead, if few are in sight; and
# above which it tries no more. Each try doubles it.
_FIRST_REST_TIME, _LEAD_REST_TIME, _MAX_REST_TIME = 0.5, 10.0, 40.0
# While searching the heading drifts by up to so many rad, for so many s.
_MAX_DRIFT = 0.4
_DRIFT_TIMES = (2.0, 5.0)
# Beyond this share of `range` the lidar sees only parts of an object, such as a wall.
_MAX_RANGE_SHARE = 0.95


class AttractionParams(FieldParams, frozen=True, kw_only=True):
    """The reach of each law, the distances, and those of every FieldPattern."""

    paper_range: Annotated[
        float,
        about("law paper: reach of the field", ge=0.1, le=100.0, unit="m", source="paper"),
    ] = 2.0
    bias: Bias = -1.0
    angular_if_alone: TurnIfAlone = 1.0
    range: Annotated[
        float,
        about(
            "distance up to which robots attract",
            ge=0.1,
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
            ge=0.1,
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
            ge=0.05,
            le=5.0,
            unit="m",
            source="ours: 0.6 times the protection threshold; two robots that meet need it",
            derived=of_threshold(0.6),
        ),
    ]
    object_width: ObjectWidth


@dataclass(frozen=True, slots=True, eq=False)
class _Surroundings:
    """The robots and near surfaces in one scan, in the base frame.

    `points` (p, 2) of near surfaces and `robots` (k, 2): range, bearing. `seen` counts the robots
    and those partly hidden, `adjacent` the near ones. `pull` (2,) is the sum of all attraction, at
    most 1 long; `free` is its length after `keep_clear`. `is_line`: all robots lie on one line
    through this one.
    """

    scan: Scan
    points: Array
    robots: Array
    seen: int
    adjacent: int
    pull: Array
    free: float
    is_line: bool

    @property
    def nearest(self) -> float:
        """The bearing of the nearest robot."""
        return float(self.robots[np.argmin(self.robots[:, 0]), 1])


class Attraction(FieldPattern[AttractionParams]):
    """Drives to other robots and stands next to them; alone it searches."""

    params_type = AttractionParams
    field_kind = "attraction"
    is_symmetric = True

    def __init__(self, params: AttractionParams, context: Context) -> None:
        super().__init__(params, context)
        self.state = "search"
        self._since = 0.0
        self._rest_time = _FIRST_REST_TIME
        self._most_seen = 0
        self._side = float(context.rng.choice((-1.0, 1.0)))
        self._view: _Surroundings | None = None
        self._drift = 0.0
        self._drift_until = -math.inf

    def update(self, params: AttractionParams) -> None:
        """Apply changed parameters, and evaluate the scan again."""
        super().update(params)
        self._view = None

    def settle(self, inputs: Inputs, scan: Scan) -> Twist:
        """Change its state (search, gather, settled, roll or lead) and follow it."""
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
            return self._follow(view, _LEAD_SPEED * self._wander(now) - self._toward(view))
        return self._follow(view, self._around(view) if state == "roll" else view.pull)

    def _look(self, scan: Scan) -> _Surroundings:
        params = self.params
        offset = self.context.platform.scan.offset
        spacing = params.spacing - params.slack
        reach = spacing + params.brake + math.hypot(*offset)
        points = from_base(closest_points(scan, within=reach), offset)
        robots, seen = self._robots(scan)
        robots = from_base(robots, offset)
        adjacent = int(np.count_nonzero(robots[:, 0] < _ADJACENT_SPACINGS * params.spacing))
        pull = self._pull(robots)
        free = keep_clear(pull, points, spacing=spacing, brake=params.brake)
        axis = complex(np.exp(2j * robots[:, 1]).sum())
        is_line = abs(axis) > _MIN_ALIGNMENT * len(robots)
        return _Surroundings(scan, points, robots, seen, adjacent, pull, math.hypot(*free), is_line)

    def _follow(self, view: _Surroundings, vector: Array) -> Twist:
        params = self.params
        spacing, points = params.spacing - params.slack, view.points
        vector = keep_clear(vector, points, spacing=spacing, brake=params.brake)
        if self.state in ("search", "lead") and math.hypot(*vector) < _MIN_SEARCH_SPEED:
            return Twist(angular=math.copysign(0.5 * params.turn, self._drift))
        return steer(
            vector,
            params.speed,
            params.turn,
            points=points,
            spacing=spacing,
            brake=params.brake,
            may_back=bool(len(points)) and float(points[:, 0].min()) < spacing,
        )

    def _robots(self, scan: Scan) -> tuple[Array, int]:
        """Robots (k, 2) as range, bearing, and their number with those partly hidden."""
        objects = clusters(scan, within=self.params.range)
        is_narrow = objects.widths <= self.params.object_width
        is_narrow &= objects.ranges <= _MAX_RANGE_SHARE * self.params.range
        is_robot = is_narrow & objects.is_free
        robots = np.array((objects.ranges[is_robot], objects.bearings[is_robot])).T
        return robots, int(np.count_nonzero(is_narrow))

    def _pull(self, robots: Array) -> Array:
        """The sum over the robots, each 0 at `spacing` and growing with its range; at most 1."""
        weights = np.maximum((robots[:, 0] - self.params.spacing) / self.params.brake, 0.0)
        x = float(weights @ np.cos(robots[:, 1]))
        y = float(weights @ np.sin(robots[:, 1]))
        return np.array([x, y]) / max(1.0, math.hypot(x, y))

    def _next_state(self, view: _Surroundings, now: float, received: int, is_in_line: bool) -> str:
        if len(view.robots) == 0:
            return "search"
        is_going = self.state
        if view.seen > self._most_seen:
            self._most_seen, self._rest_time = view.seen, _FIRST_REST_TIME
            is_going = "gather" if is_going == "lead" else is_going
        age = now - self._since
        is_few = view.seen <= _FEW_ROBOTS and not 0 < received <= view.seen
        is_all = view.adjacent == len(view.robots) and received <= view.seen
        is_incomplete = view.adjacent < _MIN_ADJACENT and (is_few or not is_all)
        if is_going == "roll" and is_incomplete and age < _ROLL_TIME:
            return "roll"
        if is_going == "lead" and age < _LEAD_TIME:
            return "lead"
        is_pulled = view.free > (_STOP_PULL if is_going == "gather" else _START_PULL)
        is_first = is_in_line and is_going == "gather" and self._rest_time == _FIRST_REST_TIME
        is_rested = is_going == "settled" and not is_pulled and self._rest_time < _MAX_REST_TIME
        if (is_first or is_rested) and age > self._rest_time:
            if is_few and self._rest_time > _LEAD_REST_TIME:
                return self._try("lead", view)
            if is_first or is_incomplete:
                return self._try("roll", view)
        return "gather" if is_pulled else "settled"

    def _try(self, state: str, view: _Surroundings) -> str:
        """Start to roll or lead: away from the second robot if two are adjacent."""
        self._rest_time *= 2.0
        order = np.argsort(view.robots[:, 0])
        if view.adjacent > 1:
            turn = math.sin(float(view.robots[order[1], 1] - view.robots[order[0], 1]))
            self._side = -math.copysign(1.0, turn) if abs(turn) > _MIN_SIDE_SINE else self._side
        return state

    def _toward(self, view: _Surroundings) -> Array:
        """Towards the nearest robot if it is near; a leading robot drives the opposite way."""
        near, bearing = float(view.robots[:, 0].min()), view.nearest
        weight = min(max(2.0 - near / self.params.spacing, 0.0), 1.0)
        return np.array([weight * math.cos(bearing), weight * math.sin(bearing)])

    def _around(self, view: _Surroundings) -> Array:
        """Around the nearest robot, and along the pull of the others."""
        ahead = view.nearest + self._side * math.pi / 2.0
        along = np.array([math.cos(ahead), math.sin(ahead)])
        way = along + view.pull
        return way / max(1.0, math.hypot(*way))

    def _wander(self, now: float) -> Array:
        """Ahead, with a drift that changes from time to time."""
        if now >= self._drift_until:
            rng = self.context.rng
            self._drift_until = now + float(rng.uniform(*_DRIFT_TIMES))
            self._drift = float(rng.uniform(-_MAX_DRIFT, _MAX_DRIFT))
        return np.array([math.cos(self._drift), math.sin(self._drift)])
