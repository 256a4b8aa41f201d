"""Source seeking: up a gradient that one sensor reads, by runs and tumbles.

Source: Berg and Brown, "Chemotaxis in Escherichia coli analysed by three-dimensional tracking",
Nature 239, 1972: a bacterium runs on while the concentration rises, and tumbles sooner while the
concentration falls. A tumble is a turn by a random angle. Ours: a robot runs as long as the reading
rises, and tumbles once the reading has fallen. The robot turns away from obstacles, and stands
where the reading is high enough.
"""

from __future__ import annotations

import math
from typing import Annotated

from swarmd.api import (
    Ahead,
    Context,
    Inputs,
    Params,
    Recovery,
    TimedPattern,
    TopSpeed,
    TopTurn,
    Twist,
    about,
    away_from,
    of_threshold,
    turn_time,
)


class SourceSeekingParams(Params, frozen=True, kw_only=True):
    """The comparison, the tumbles, the end and the motion."""

    period: Annotated[
        float,
        about(
            "time between two readings that are compared",
            ge=0.1,
            le=60.0,
            unit="s",
            source="ours: a robot moves a body's length in it",
        ),
    ] = 1.0
    least_angle: Annotated[
        float, about("least angle of a tumble", ge=0.0, le=math.pi, unit="rad", source="ours")
    ] = 0.6
    most_angle: Annotated[
        float,
        about(
            "largest angle of a tumble, to either side",
            ge=0.0,
            le=math.pi,
            unit="rad",
            source="Berg and Brown 1972: 68 degrees on average",
        ),
    ] = 1.8
    enough: Annotated[
        float,
        about(
            "stands where the reading is as high; 0: never stands",
            ge=0.0,
            le=1e6,
            source="ours: bacteria do not stop",
        ),
    ] = 0.0
    speed: TopSpeed
    turn: TopTurn
    clearance: Annotated[
        float,
        about(
            "turns away from nearer obstacles ahead",
            ge=0.0,
            le=20.0,
            unit="m",
            source="ours: as near as protection lets it",
            derived=of_threshold(1.0),
        ),
    ]
    recovery: Recovery = False

    def __post_init__(self) -> None:
        """Check that least_angle is at most most_angle."""
        if self.least_angle > self.most_angle:
            raise ValueError(
                f"least_angle is {self.least_angle:g}, most_angle {self.most_angle:g} rad"
            )


class SourceSeeking(TimedPattern[SourceSeekingParams]):
    """Runs straight while `concentration` rises, and tumbles where it has fallen."""

    group = "search"
    params_type = SourceSeekingParams
    needs = frozenset({"scan", "reading:concentration"})
    default_state = "run"

    def __init__(self, params: SourceSeekingParams, context: Context) -> None:
        super().__init__(params, context)
        self._last = -math.inf
        self._compare_at = -math.inf
        self._side = 1.0
        self._ahead = Ahead()

    def drive(self, inputs: Inputs) -> Twist:
        """Straight, or a turn on the spot."""
        params = self.params
        now = inputs.now
        value = inputs.readings["concentration"]
        if 0.0 < params.enough <= value:
            self.begin(now, arrived=params.period)
            return Twist()
        state = self.state(now)
        if state == "tumble":
            self._last = value
            self._compare_at = now + params.period
            return Twist(angular=self._side * params.turn)
        is_falling = False
        if now >= self._compare_at:
            is_falling = value < self._last
            self._last = value
            self._compare_at = now + params.period
        blocking = self._ahead.within(params.clearance, inputs.scan)
        if not is_falling and blocking is None:
            return Twist(linear=params.speed)
        self._side = away_from(blocking, self.context.rng)
        angle = float(self.context.rng.uniform(params.least_angle, params.most_angle))
        self.begin(now, tumble=turn_time(angle, params.turn))
        return Twist(angular=self._side * params.turn)
