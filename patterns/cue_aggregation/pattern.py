"""Cue aggregation (BEECLUST): the robots gather where it is warm, without memory or messages.

Source: Schmickl, Thenius, Moeslinger, Radspieler, Kernbach, Szymanski and Crailsheim, "Get in
touch: cooperative decision making based on robot-to-robot collisions", Autonomous Agents and
Multi-Agent Systems 18, 2009; Kernbach, Thenius, Kernbach and Schmickl, "Re-embodiment of honeybee
aggregation behavior in an artificial micro-robotic system", Adaptive Behavior 17, 2009. A robot
that meets another robot measures the cue c, here the warmth. The robot waits for the time
w_max c^2 / (c^2 + theta^2) and turns away. At an obstacle the robot turns away at once.

Ours: the cue is the reading `temperature` above `cold`. An object of the scan that is as narrow as
a robot counts as a robot. After a wait the robot does not wait again for `refractory` s.
"""

from __future__ import annotations

import math
from typing import Annotated

from swarmd.api import (
    AHEAD_HALF_WIDTH,
    ZERO,
    Ahead,
    Context,
    Inputs,
    Params,
    Ray,
    Recovery,
    Scan,
    TimedPattern,
    TopSpeed,
    TopTurn,
    Twist,
    about,
    away_from,
    of_threshold,
    robots_near,
    turn_time,
)


class CueAggregationParams(Params, frozen=True, kw_only=True):
    """The cue, the waiting time and the motion."""

    cold: Annotated[
        float,
        about(
            "no wait at or below",
            ge=-100.0,
            le=1e6,
            unit="degC",
            source="ours: the source's cue is a light, dark at 0",
        ),
    ] = 20.0
    half: Annotated[
        float,
        about(
            "half of the longest wait at so much above `cold`",
            ge=0.001,
            le=1e6,
            unit="degC",
            source="Schmickl et al. 2009, theta; the value: ours",
        ),
    ] = 8.0
    wait: Annotated[
        float,
        about(
            "longest wait",
            ge=0.0,
            le=3600.0,
            unit="s",
            source="Schmickl et al. 2009, w_max; the value: ours, for a dozen slow robots",
        ),
    ] = 120.0
    refractory: Annotated[
        float,
        about(
            "time after a turn in which no robot is met",
            ge=0.0,
            le=60.0,
            unit="s",
            source="ours: to get away from the robot that it met",
        ),
    ] = 2.0
    speed: TopSpeed
    turn: TopTurn
    near: Annotated[
        float,
        about(
            "nearer robots are met, nearer obstacles are turned from",
            ge=0.05,
            le=20.0,
            unit="m",
            source="ours: 0.9 times the protection threshold, to meet before it acts",
            derived=of_threshold(0.9),
        ),
    ]
    recovery: Recovery = False


class CueAggregation(TimedPattern[CueAggregationParams]):
    """Drives, waits at a meeting of two robots, the longer the warmer the place, and turns away."""

    group = "gather"
    params_type = CueAggregationParams
    needs = frozenset({"scan", "reading:temperature"})

    def __init__(self, params: CueAggregationParams, context: Context) -> None:
        super().__init__(params, context)
        self._side = 1.0
        self._alone_until = -math.inf
        self._scan: Scan | None = None  # that the meeting is from
        self._met: Ray | None = None
        self._ahead = Ahead()

    def drive(self, inputs: Inputs) -> Twist:
        """Zero in state wait, a turn on the spot in state turn, else straight."""
        params = self.params
        now = inputs.now
        state = self.state(now)
        if state == "wait":
            return ZERO
        if state == "turn":
            self._alone_until = now + params.refractory
            return Twist(angular=self._side * params.turn)
        ahead = self._ahead.within(params.near, inputs.scan)
        met = None if now < self._alone_until else self._meet(inputs.scan, ahead)
        blocking = met or ahead
        if blocking is None:
            return Twist(linear=params.speed)
        self._side = away_from(blocking, self.context.rng)
        turn = turn_time(float(self.context.rng.uniform(0.5, 1.0)) * math.pi, params.turn)
        if met is None:
            self.begin(now, turn=turn)
            return Twist(angular=self._side * params.turn)
        warmth = max(inputs.readings["temperature"] - params.cold, 0.0) ** 2
        self.begin(now, wait=params.wait * warmth / (warmth + params.half**2), turn=turn)
        return ZERO

    def _meet(self, scan: Scan | None, ahead: Ray | None) -> Ray | None:
        """The nearest robot ahead that is near, of the latest scan."""
        if scan is not None and scan is not self._scan:
            self._scan = scan
            robots = []
            if ahead is not None:
                within = self.params.near
                half = AHEAD_HALF_WIDTH
                platform = self.context.platform
                robots = robots_near(scan, platform, within=within, half_width=half)
            self._met = robots[0] if robots else None
        return self._met
