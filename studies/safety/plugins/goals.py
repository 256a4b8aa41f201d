"""Drives from goal to goal and counts them, without regard to obstacles.

Two readings give the robot's position. No reading gives the heading. So the pattern estimates the
angle between the frame of the odometry, which drifts, and the frame of the arena from the robot's
displacements in both frames.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal

from swarmd.api import (
    ZERO,
    Context,
    Inputs,
    MovementPattern,
    Params,
    Scalar,
    Twist,
    about,
    difference,
    wrap,
)

Place = tuple[float, float]
_WAY = 0.15  # least displacement in m for an estimate of the angle
_TRUST = 0.3  # weight of one displacement in the estimate
_GAIN = 3.0  # 1/s, of the heading


class GoalsParams(Params, frozen=True):
    """The choice of goals, and the distance at which one is reached."""

    choice: Annotated[
        Literal["anywhere", "opposite", "centre"],
        about(
            "anywhere: a uniformly drawn place in the arena; opposite: through the centre to the"
            " other side and back; centre: to the centre, without end"
        ),
    ] = "anywhere"
    length: Annotated[
        float, about("of the area of goals, along x", ge=0.1, le=1000.0, unit="m")
    ] = 3.0
    width: Annotated[float, about("the same along y", ge=0.1, le=1000.0, unit="m")] = 3.0
    reach: Annotated[
        float, about("distance at which a goal is reached", ge=0.01, le=10.0, unit="m")
    ] = 0.2


class Compass:
    """The angle from the frame of the odometry to the arena's, in rad."""

    def __init__(self) -> None:
        self.angle = 0.0
        self._is_known = False
        self._from: tuple[Place, Place] | None = None

    def learn(self, place: Place, measured: Place) -> None:
        """Update the angle from the position in the arena and by odometry, both in m."""
        if self._from is None:
            self._from = place, measured
        (x, y), (u, v) = self._from
        way, by_odometry = (place[0] - x, place[1] - y), (measured[0] - u, measured[1] - v)
        if math.hypot(*way) < _WAY or math.hypot(*by_odometry) < _WAY:
            return
        angle = math.atan2(way[1], way[0]) - math.atan2(by_odometry[1], by_odometry[0])
        share = _TRUST if self._is_known else 1.0
        self.angle = wrap(self.angle + share * difference(angle, self.angle))
        self._is_known, self._from = True, (place, measured)


class Goals(MovementPattern[GoalsParams]):
    """Turns to its goal and drives at full speed; at the goal it takes the next."""

    params_type = GoalsParams
    needs = frozenset({"odometry", "reading:x", "reading:y"})

    def __init__(self, params: GoalsParams, context: Context) -> None:
        super().__init__(params, context)
        self._compass = Compass()
        self._goal: Place | None = None
        self._reached = 0

    def report(self) -> Mapping[str, Scalar]:
        """The number of goals reached; nothing if the goal is the centre."""
        return {} if self.params.choice == "centre" else {"goals": self._reached}

    def drive(self, inputs: Inputs) -> Twist:
        """Towards the goal."""
        if inputs.odometry is None or not {"x", "y"} <= inputs.readings.keys():
            return ZERO
        place, pose = (inputs.readings["x"], inputs.readings["y"]), inputs.odometry.pose
        self._compass.learn(place, (pose.x, pose.y))
        if self._goal is None:
            self._goal = self._next(place)
        elif self.params.choice != "centre" and math.dist(place, self._goal) < self.params.reach:
            self._reached += 1
            self._goal = self._next(self._goal)
        return self._towards(self._goal, place, wrap(pose.yaw + self._compass.angle))

    def _next(self, place: Place) -> Place:
        """The goal after `place`, which is the last goal or the start of the robot."""
        if self.params.choice == "centre":
            return (0.0, 0.0)
        if self.params.choice == "opposite":
            return (-place[0], -place[1])
        half = self.params.length / 2.0, self.params.width / 2.0
        x, y = (float(self.context.rng.uniform(-one, one)) for one in half)
        return (x, y)

    def _towards(self, goal: Place, place: Place, heading: float) -> Twist:
        limits = self.context.platform.limits
        error = difference(math.atan2(goal[1] - place[1], goal[0] - place[0]), heading)
        turn = min(max(_GAIN * error, -limits.angular), limits.angular)
        return Twist(linear=limits.linear * max(math.cos(error), 0.0) ** 2, angular=turn)
