"""Dead reckoning: motion since a scan was taken, and until a command takes effect."""

from __future__ import annotations

import math

from swarmd.core.values import Pose, Twist
from swarmd.protection.decision import DecisionContext
from swarmd.sensing.odometry_history import MAX_EXTRAPOLATION, OdometryHistory, moved

REACTION_TIME = 0.05
"""Seconds from a decision to the first response of the base: one tick."""


class DeadReckoning:
    """Poses from measured odometry, interpolated and extrapolated; times in s on its own clock.

    After a clock reset, earlier poses are invalid.
    """

    def __init__(self, braking_linear: float, braking_angular: float) -> None:
        """The base changes its speeds at least at these rates, in m/s2 and rad/s2."""
        self._braking = braking_linear, braking_angular
        self._history = OdometryHistory()

    @property
    def clock_resets(self) -> int:
        """How often the clock went back or the pose jumped."""
        return self._history.resets

    def update(self, context: DecisionContext) -> None:
        """Record the odometry of the context if it is new."""
        if context.odometry is not None:
            self._history.update(context.odometry)

    def pose(self, context: DecisionContext, ago: float) -> Pose:
        """The pose `ago` s before the decision, in the odometry frame."""
        latest = self._history.latest
        if latest is None:
            return Pose()
        return self._history.pose(latest.stamp + (context.odometry_age or 0.0) - ago)

    def predicted_pose(self, context: DecisionContext, command: Twist) -> Pose:
        """The pose at which the next command takes effect, in the odometry frame.

        From the last reading on the robot approaches `command`, the present one, at the lowest
        rates of change.
        """
        last = self._history.latest
        if last is None:
            return Pose()
        seconds = min(context.odometry_age or 0.0, MAX_EXTRAPOLATION) + REACTION_TIME
        linear, angular = self._braking
        twist = Twist(
            _mean(last.twist.linear, command.linear, linear, seconds),
            _mean(last.twist.angular, command.angular, angular, seconds),
            _mean(last.twist.lateral, command.lateral, linear, seconds),
        )
        return moved(last.pose, twist, seconds)


def _mean(now: float, wanted: float, rate: float, seconds: float) -> float:
    """The mean speed over `seconds` on a ramp of `rate` from `now` to `wanted`."""
    change = wanted - now
    ramp = abs(change) / rate
    if ramp >= seconds:
        return now + math.copysign(0.5 * rate * seconds, change)
    return now + change * (1.0 - 0.5 * ramp / seconds)
