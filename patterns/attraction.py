"""Attraction: the robots gather in one cluster.

Source of law "paper": Kaiser et al., ICRA 2022, pattern "attraction", and its code ROS2swarm: an
attractive potential field over all that the lidar sees, always at full speed, so that it never
settles and is drawn to walls more than to robots.

Law "settling" is ours. It is drawn only to what may be a robot: objects no wider than
`object_width` that nothing nearer hides. The pull of each falls to nothing at `spacing`, what is
near only limits the speed towards it, and the robot stands once little pull is left. One that has
stood for a while with few others in sight, and hears of more, looks for them. Limits: a robot
within some 0.2 m of a wall is not told from it, a pillar is taken for a robot, and groups of four
and more that are further apart than `range` do not find each other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
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
    Scalar,
    Scan,
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
# A robot that sees so few others may stand in a line, which hides the rest, or in a group that
# has lost the rest. It first steps aside, then leads its group away to look, each for so many s,
# at such a share of the speed; its patience doubles from try to try, until it is content.
_FEW = 2
_SIDESTEP_TIME, _SIDESTEP_SPEED = 3.0, 0.6
_LEAD_TIME, _LEAD_SPEED = 12.0, 0.6
_PATIENCE, _PATIENCE_MAX = 3.0, 40.0
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
    speed: Annotated[
        float,
        about(
            "highest speed",
            ge=0.0,
            le=2.0,
            unit="m/s",
            source="ROS2swarm: the platform's limit, 0.5 m/s at most",
        ),
    ] = 0.2
    turn: Annotated[
        float,
        about(
            "highest turn rate",
            ge=0.0,
            le=4.0,
            unit="rad/s",
            source="ROS2swarm: the platform's limit",
        ),
    ] = 1.82
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
            source="ours: 1.3 times the protection threshold plus the lidar's offset, so that "
            "turning on the spot does not wake protection",
        ),
    ] = 0.65
    slack: Annotated[
        float,
        about(
            "how much nearer than spacing another may come before it is given way",
            ge=0.0,
            le=5.0,
            unit="m",
            source="ours: a tenth of the protection threshold",
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
        self._side = 1.0
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
            "spacing": 1.3 * threshold + math.hypot(*platform.scan.offset),
            "slack": 0.1 * threshold,
            "brake": 0.6 * threshold,
            "object_width": 2.0 * diagonal,
        }

    def report(self) -> Mapping[str, Scalar]:
        """What it is doing: search, gather, settled, sidestep or lead."""
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
        params = self.params
        offset = self.context.platform.scan.offset
        spacing = params.spacing - params.slack
        reach = spacing + params.brake + math.hypot(*offset)
        points = from_base(closest_points(scan, within=reach), offset)
        robots, seen = self._robots(scan)
        robots = from_base(robots, offset)
        pull = keep_clear(self._pull(robots), points, spacing=spacing, brake=params.brake)
        is_few = seen <= _FEW and not 0 < heard <= seen
        self._enter(self._next_state(now, len(robots), seen, is_few, math.hypot(*pull)), now)
        if self._state == "settled":
            return ZERO
        vector = pull
        if self._state == "search":
            vector = self._wander(now)
        elif self._state == "lead":
            vector = _LEAD_SPEED * self._wander(now) - self._nearest(robots)
        elif self._state == "sidestep":
            vector = self._aside(robots)
        vector = keep_clear(vector, points, spacing=spacing, brake=params.brake)
        if self._state in ("search", "lead") and math.hypot(*vector) < _WAKE:
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
        """The sum over the robots, each 0 at `spacing` and 1 from twice that; at most 1 long."""
        weights = np.minimum(np.maximum(robots[:, 0] / self.params.spacing - 1.0, 0.0), 1.0)
        x = float(weights @ np.cos(robots[:, 1]))
        y = float(weights @ np.sin(robots[:, 1]))
        return np.array([x, y]) / max(1.0, math.hypot(x, y))

    def _next_state(self, now: float, robots: int, seen: int, is_few: bool, pull: float) -> str:
        if robots == 0:
            return "search"
        if seen > self._most_seen:
            self._most_seen, self._patience = seen, _PATIENCE
            self._state = "gather" if self._state == "lead" else self._state
        for state, time in (("sidestep", _SIDESTEP_TIME), ("lead", _LEAD_TIME)):
            if self._state == state and now - self._since < time:
                return state
        if pull > (_DOZE if self._state == "gather" else _WAKE):
            return "gather"
        is_bored = self._state == "settled" and now - self._since > self._patience
        if is_few and is_bored and self._patience < _PATIENCE_MAX:
            return "sidestep" if self._patience == _PATIENCE else "lead"
        return "settled"

    def _enter(self, state: str, now: float) -> None:
        if state == self._state:
            return
        self._state, self._since = state, now
        if state in ("sidestep", "lead"):
            self._patience *= 2.0
            self._side = float(self.context.rng.choice((-1.0, 1.0)))

    def _nearest(self, robots: Array) -> Array:
        """Towards the nearest robot if it is near: who leads goes where the others are not."""
        near, bearing = robots[np.argmin(robots[:, 0])].tolist()
        weight = min(max(2.0 - near / self.params.spacing, 0.0), 1.0)
        return np.array([weight * math.cos(bearing), weight * math.sin(bearing)])

    def _aside(self, robots: Array) -> Array:
        """Around the nearest robot, so that a line of robots folds up."""
        bearing = float(robots[np.argmin(robots[:, 0]), 1]) + self._side * math.pi / 2.0
        return _SIDESTEP_SPEED * np.array([math.cos(bearing), math.sin(bearing)])

    def _wander(self, now: float) -> Array:
        """Ahead with a drift that changes now and then."""
        if now >= self._drift_until:
            rng = self.context.rng
            self._drift_until = now + float(rng.uniform(*_DRIFT_TIME))
            self._drift = float(rng.uniform(-_DRIFT, _DRIFT))
        return np.array([math.cos(self._drift), math.sin(self._drift)])
