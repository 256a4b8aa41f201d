"""Attraction: the robots gather in one cluster.

Source of law "paper": Kaiser et al., ICRA 2022, pattern "attraction", and its code ROS2swarm: an
attractive potential field over all that the lidar sees, always at full speed, so that it never
settles and is drawn to walls more than to robots.

Law "settling" is ours. A robot is drawn only to what may be a robot: objects no wider than
`object_width` that nothing nearer hides, the farther the more, as in the paper. What is near only
limits the speed towards it, so that it slides past, and once little pull is left it rests.

That alone would leave a row a row, for its robots hide one another. So one that has fewer than
three others beside it, though it sees or hears of more, now and then rolls along the outside of
the group until it has three, as atoms do on a crystal; the first time even on its way, if all that
it sees lies in line. Its patience doubles from try to try and only seeing more than ever renews it,
so that the swarm comes to rest. One with few in sight at last leads away to look for the others.

Limits: a robot within some 0.2 m of a wall is not told from it, a pillar is taken for a robot, and
groups that are further apart than `range` find each other by chance alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from swarmd.api import (
    ZERO,
    Array,
    Context,
    Inputs,
    MovementPattern,
    Params,
    Platform,
    Recovery,
    Scalar,
    Scan,
    TopSpeed,
    TopTurn,
    Twist,
    Value,
    about,
    closest_points,
    clusters,
    field_twist,
    from_base,
    keep_clear,
    potential_field,
    steer,
)

# Pull, as a share of full speed, below which a moving robot stops and above which it starts.
_DOZE, _WAKE = 0.12, 0.25
# Within so many times `spacing` another is beside it; on the rim of a hexagon each has three.
_BESIDE, _ENOUGH = 1.25, 3
# All that it sees lies in line if the mean of exp(2i bearing) is longer: within some 20 degrees.
_IN_LINE = 0.7
# Slower than this share of full speed it turns away from what is in its way while it searches.
_SLOW = 0.25
# Two others are to its sides if the sine between them is larger.
_ASIDE = 0.3
# How long it rolls, in s.
_ROLL_TIME = 8.0
# With so few in sight it may have lost the rest. How long it then leads, in s, and how fast.
_FEW = 2
_LEAD_TIME, _LEAD_SPEED = 12.0, 0.6
# How long, in s, it rests before it rolls: the first time; when it leads instead, if it sees few;
# and when it never tries again. Each try doubles it.
_PATIENCE, _PATIENCE_LEAD, _PATIENCE_MAX = 0.5, 10.0, 40.0
# While searching the heading drifts by up to so much, rad, for so long, s.
_DRIFT = 0.4
_DRIFT_TIME = (2.0, 5.0)
# Nearer than this share of `range` an object is seen with what is beside it: beyond, a wall that
# is half out of range comes in pieces.
_SURE = 0.95


class AttractionParams(Params, frozen=True):
    """The law, speeds and distances; those of law "paper" come last."""

    law: Annotated[
        Literal["settling", "paper"],
        about(
            "settling: comes to rest at a spacing; paper: the original equations",
            source="ours: the original drives at full speed for ever",
        ),
    ] = "settling"
    speed: TopSpeed = 0.2
    turn: TopTurn = 1.82
    range: Annotated[
        float,
        about(
            "how far it is drawn to robots",
            ge=0.1,
            le=100.0,
            unit="m",
            source="ours: all that the lidar reaches, so that no group is left behind",
        ),
    ] = 3.5
    spacing: Annotated[
        float,
        about(
            "distance from the axle to a neighbour at which its pull ends",
            ge=0.1,
            le=20.0,
            unit="m",
            source="ours: 1.06 times the protection threshold plus 1.3 times the lidar's offset, "
            "so that turning on the spot does not wake protection",
        ),
    ] = 0.65
    slack: Annotated[
        float,
        about(
            "how much nearer than spacing another may come before it is given way",
            ge=0.0,
            le=5.0,
            unit="m",
            source="ours: a twentieth of the protection threshold",
        ),
    ] = 0.05
    brake: Annotated[
        float,
        about(
            "distance over which the speed towards something falls to zero",
            ge=0.05,
            le=5.0,
            unit="m",
            source="ours: 0.6 times the protection threshold; two robots that meet need it",
        ),
    ] = 0.3
    object_width: Annotated[
        float,
        about(
            "what is wider is no robot",
            ge=0.05,
            le=10.0,
            unit="m",
            source="ours: twice the footprint's diagonal",
        ),
    ] = 0.8
    paper_range: Annotated[
        float,
        about("law paper: reach of the field", ge=0.1, le=100.0, unit="m", source="paper"),
    ] = 2.0
    bias: Annotated[
        float,
        about("law paper: forward bias", ge=-100.0, le=100.0, source="ROS2swarm"),
    ] = -1.0
    rays: Annotated[
        int,
        about("law paper: alone if no more rays see anything", ge=0, le=10000, source="ROS2swarm"),
    ] = 1
    linear_if_alone: Annotated[
        float,
        about("law paper: speed if alone", ge=-2.0, le=2.0, unit="m/s", source="ROS2swarm"),
    ] = 0.0
    angular_if_alone: Annotated[
        float,
        about("law paper: turn rate if alone", ge=-4.0, le=4.0, unit="rad/s", source="ROS2swarm"),
    ] = 1.0
    recovery: Recovery = False


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """What one scan shows, seen from the base.

    `points` (p, 2) where surfaces are near and `robots` (k, 2) what may be robots: range, bearing.
    `seen` counts these with the half hidden, `beside` those that are near. `pull` (2,) is all that
    draws it, at most 1 long; `free` is the length of what near surfaces leave of it. `is_line`:
    all robots lie on one line through this one.
    """

    scan: Scan
    points: Array
    robots: Array
    seen: int
    beside: int
    pull: Array
    free: float
    is_line: bool

    @property
    def nearest(self) -> float:
        """The bearing of the nearest robot."""
        return float(self.robots[np.argmin(self.robots[:, 0]), 1])


class Attraction(MovementPattern[AttractionParams]):
    """Drives to where other robots are and stands beside them; alone it searches."""

    params_type = AttractionParams
    is_symmetric = True

    def __init__(self, params: AttractionParams, context: Context) -> None:
        super().__init__(params, context)
        self._state = "search"
        self._since = 0.0
        self._patience = _PATIENCE
        self._most_seen = 0
        self._side = float(context.rng.choice((-1.0, 1.0)))
        self._view: _View | None = None
        self._drift = 0.0
        self._drift_until = -math.inf

    @classmethod
    def defaults(cls, platform: Platform) -> Mapping[str, Value]:
        """Speeds from the limits, reach from the lidar, distances from the protection."""
        threshold = float(platform.protection["threshold"])
        diagonal = float(np.hypot(*np.ptp(platform.footprint, axis=0)))
        return {
            "speed": min(platform.limits.linear, 0.5),
            "turn": min(platform.limits.angular, 4.0),
            "range": platform.scan.range_max,
            "spacing": 1.06 * threshold + 1.3 * math.hypot(*platform.scan.offset),
            "slack": 0.05 * threshold,
            "brake": 0.6 * threshold,
            "object_width": 2.0 * diagonal,
        }

    def update(self, params: AttractionParams) -> None:
        """Take over changed parameters, and look at the scan anew with them."""
        super().update(params)
        self._view = None

    def report(self) -> Mapping[str, Scalar]:
        """What it is doing: search, gather, settled, roll or lead."""
        return {"state": "paper" if self.params.law == "paper" else self._state}

    def drive(self, inputs: Inputs) -> Twist:
        """One command from the latest scan."""
        if inputs.scan is None:
            return ZERO
        if self.params.law == "paper":
            return self._follow_field(inputs.scan)
        return self._settle(inputs.scan, inputs.now, len(inputs.neighbors))

    def _follow_field(self, scan: Scan) -> Twist:
        params = self.params
        field = potential_field(
            scan.ranges,
            scan.bearings,
            range_max=params.paper_range,
            range_min=scan.range_min,
            bias=params.bias,
            ray_threshold=params.rays,
            kind="attraction",
            ignore_near=True,
        )
        if field.is_alone:
            return Twist(linear=params.linear_if_alone, angular=params.angular_if_alone)
        return field_twist(field.vector, params.speed, params.turn)

    def _settle(self, scan: Scan, now: float, heard: int) -> Twist:
        if self._view is None or self._view.scan is not scan:
            self._view = self._look(scan)
        view = self._view
        is_in_line = heard > view.seen and view.is_line
        state = self._next_state(view, now, heard, is_in_line)
        if state != self._state:
            self._state, self._since = state, now
        if state == "settled":
            return ZERO
        if state == "search":
            return self._follow(view, self._wander(now))
        if state == "lead":
            return self._follow(view, _LEAD_SPEED * self._wander(now) - self._toward(view))
        return self._follow(view, self._around(view) if state == "roll" else view.pull)

    def _look(self, scan: Scan) -> _View:
        params = self.params
        offset = self.context.platform.scan.offset
        spacing = params.spacing - params.slack
        reach = spacing + params.brake + math.hypot(*offset)
        points = from_base(closest_points(scan, within=reach), offset)
        robots, seen = self._robots(scan)
        robots = from_base(robots, offset)
        beside = int(np.count_nonzero(robots[:, 0] < _BESIDE * params.spacing))
        pull = self._pull(robots)
        free = keep_clear(pull, points, spacing=spacing, brake=params.brake)
        axis = complex(np.exp(2j * robots[:, 1]).sum())
        is_line = abs(axis) > _IN_LINE * len(robots)
        return _View(scan, points, robots, seen, beside, pull, math.hypot(*free), is_line)

    def _follow(self, view: _View, vector: Array) -> Twist:
        params = self.params
        spacing, points = params.spacing - params.slack, view.points
        vector = keep_clear(vector, points, spacing=spacing, brake=params.brake)
        if self._state in ("search", "lead") and math.hypot(*vector) < _SLOW:
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
        """(k, 2) range and bearing of what may be robots, and how many with the half hidden."""
        objects = clusters(scan, within=self.params.range)
        is_narrow = objects.widths <= self.params.object_width
        is_narrow &= objects.ranges <= _SURE * self.params.range
        is_robot = is_narrow & objects.is_free
        robots = np.array((objects.ranges[is_robot], objects.bearings[is_robot])).T
        return robots, int(np.count_nonzero(is_narrow))

    def _pull(self, robots: Array) -> Array:
        """The sum over the robots, each 0 at `spacing` and growing with its range; at most 1."""
        weights = np.maximum((robots[:, 0] - self.params.spacing) / self.params.brake, 0.0)
        x = float(weights @ np.cos(robots[:, 1]))
        y = float(weights @ np.sin(robots[:, 1]))
        return np.array([x, y]) / max(1.0, math.hypot(x, y))

    def _next_state(self, view: _View, now: float, heard: int, is_in_line: bool) -> str:
        if len(view.robots) == 0:
            return "search"
        is_going = self._state
        if view.seen > self._most_seen:
            self._most_seen, self._patience = view.seen, _PATIENCE
            is_going = "gather" if is_going == "lead" else is_going
        age = now - self._since
        is_few = view.seen <= _FEW and not 0 < heard <= view.seen
        is_all = view.beside == len(view.robots) and heard <= view.seen
        is_loose = view.beside < _ENOUGH and (is_few or not is_all)
        if is_going == "roll" and is_loose and age < _ROLL_TIME:
            return "roll"
        if is_going == "lead" and age < _LEAD_TIME:
            return "lead"
        is_woken = view.free > (_DOZE if is_going == "gather" else _WAKE)
        is_first = is_in_line and is_going == "gather" and self._patience == _PATIENCE
        is_bored = is_going == "settled" and not is_woken and self._patience < _PATIENCE_MAX
        if (is_first or is_bored) and age > self._patience:
            if is_few and self._patience > _PATIENCE_LEAD:
                return self._try("lead", view)
            if is_first or is_loose:
                return self._try("roll", view)
        return "gather" if is_woken else "settled"

    def _try(self, state: str, view: _View) -> str:
        """Start to roll or lead: away from the second robot if there are two beside it."""
        self._patience *= 2.0
        order = np.argsort(view.robots[:, 0])
        if view.beside > 1:
            turn = math.sin(float(view.robots[order[1], 1] - view.robots[order[0], 1]))
            self._side = -math.copysign(1.0, turn) if abs(turn) > _ASIDE else self._side
        return state

    def _toward(self, view: _View) -> Array:
        """Towards the nearest robot if it is near: who leads goes where the others are not."""
        near, bearing = float(view.robots[:, 0].min()), view.nearest
        weight = min(max(2.0 - near / self.params.spacing, 0.0), 1.0)
        return np.array([weight * math.cos(bearing), weight * math.sin(bearing)])

    def _around(self, view: _View) -> Array:
        """Around the nearest robot, and where the others draw it."""
        ahead = view.nearest + self._side * math.pi / 2.0
        along = np.array([math.cos(ahead), math.sin(ahead)])
        way = along + view.pull
        return way / max(1.0, math.hypot(*way))

    def _wander(self, now: float) -> Array:
        """Ahead with a drift that changes now and then."""
        if now >= self._drift_until:
            rng = self.context.rng
            self._drift_until = now + float(rng.uniform(*_DRIFT_TIME))
            self._drift = float(rng.uniform(-_DRIFT, _DRIFT))
        return np.array([math.cos(self._drift), math.sin(self._drift)])
