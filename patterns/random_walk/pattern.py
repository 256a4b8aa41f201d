"""Random walk: straight for a random time, then a turn of random speed and duration.

Source: pattern "random walk" of Kaiser et al., ICRA 2022, with the times of ROS2swarm.

Law "avoiding" is ours: the robot starts at once, and turns away from obstacles ahead before
protection acts. With law "paper" the robot starts after 5 s and uses no sensor: only protection
keeps the robot from obstacles.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from swarmd.api import (
    ZERO,
    Ahead,
    Context,
    Inputs,
    MovementPattern,
    Params,
    Ray,
    Scalar,
    TopSpeed,
    Twist,
    about,
    away_from,
    of_threshold,
)

# s for which law "paper" stands before it starts (ROS2swarm).
_START_DELAY = 5.0


class RandomWalkParams(Params, frozen=True, kw_only=True):
    """The law, speeds, times and the clearance."""

    law: Annotated[
        Literal["avoiding", "paper"],
        about(
            "avoiding: turns away from obstacles ahead; paper: the original states",
            source="ours: the original leaves walls to protection",
        ),
    ] = "avoiding"
    speed: TopSpeed
    turn: Annotated[
        float,
        about(
            "turn rates are drawn between a fifth and four fifths of it",
            ge=0.0,
            le=4.0,
            unit="rad/s",
            source="ROS2swarm: the platform's limit",
            derived=lambda platform: min(platform.limits.angular, 4.0),
        ),
    ]
    turn_time: Annotated[
        float,
        about(
            "longest duration of a turn",
            ge=0.0,
            le=60.0,
            unit="s",
            source="ours: 6 rad / turn, near ROS2swarm's 2.0, 3.5 and 1.0 s by platform",
            derived=lambda platform: 6.0 / platform.limits.angular,
        ),
    ]
    straight_min: Annotated[
        float, about("shortest straight", ge=0.0, le=600.0, unit="s", source="ROS2swarm")
    ] = 10.0
    straight_max: Annotated[
        float, about("longest straight", ge=0.0, le=600.0, unit="s", source="ROS2swarm")
    ] = 15.0
    clearance: Annotated[
        float,
        about(
            "law avoiding: turns away from nearer obstacles ahead; 0: never",
            ge=0.0,
            le=20.0,
            unit="m",
            source="ours: 1.6 times the protection threshold, to turn before it acts",
            derived=of_threshold(1.6),
        ),
    ]

    def __post_init__(self) -> None:
        """Check that straight_min is at most straight_max."""
        if self.straight_min > self.straight_max:
            raise ValueError(
                f"straight_min is {self.straight_min:g} s, straight_max {self.straight_max:g} s"
            )


class RandomWalk(MovementPattern[RandomWalkParams]):
    """Alternates between a straight of random time and a turn of random rate and time."""

    group = "search"
    params_type = RandomWalkParams

    def __init__(self, params: RandomWalkParams, context: Context) -> None:
        super().__init__(params, context)
        self._rate = 0.0
        self._until: float | None = None  # before the first step
        self._is_turning = False
        self._begin: float | None = None
        self._ahead = Ahead()

    def report(self) -> Mapping[str, Scalar]:
        """Its state: straight, turn or wait."""
        if self._until is None:
            return {"state": "wait"}
        return {"state": "turn" if self._is_turning else "straight"}

    def drive(self, inputs: Inputs) -> Twist:
        """Straight or a turn; changes when its time is over or an obstacle is ahead."""
        is_original = self.params.law == "paper"
        self._begin = inputs.now if self._begin is None else self._begin
        if is_original and self._until is None and inputs.now < self._begin + _START_DELAY:
            return ZERO
        clearance = self.params.clearance
        blocking = None if is_original else self._ahead.within(clearance, inputs.scan)
        is_over = self._until is None or inputs.now >= self._until
        may_go_straight = self._is_turning or self._until is None
        if may_go_straight and is_over and blocking is None:
            self._go_straight(inputs.now)
        elif not self._is_turning and (blocking is not None or is_over):
            self._start_turn(inputs.now, blocking)
        if self._is_turning:
            return Twist(angular=self._rate)
        return Twist(linear=self.params.speed)

    def _go_straight(self, now: float) -> None:
        self._is_turning = False
        low = self.params.straight_min
        high = self.params.straight_max
        self._until = now + float(self.context.rng.uniform(low, high))

    def _start_turn(self, now: float, blocking: Ray | None) -> None:
        self._is_turning = True
        rng = self.context.rng
        self._until = now + float(rng.uniform(0.0, self.params.turn_time))
        self._rate = away_from(blocking, rng) * float(rng.uniform(0.2, 0.8)) * self.params.turn
