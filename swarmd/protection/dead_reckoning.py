"""Dead reckoning: motion since a scan was taken, and until a command takes effect."""

from __future__ import annotations

import math
from collections import deque

from swarmd.core.values import Odometry, Pose, Twist
from swarmd.protection.decision import DecisionContext

REACTION_TIME = 0.05
"""Seconds from a decision to the first response of the base: one tick."""

MAX_EXTRAPOLATION = 0.15
"""Seconds for which the last measured twist is extrapolated: three odometry periods."""

HISTORY = 40
"""Readings that are kept."""


class DeadReckoning:
    """Poses from measured odometry, interpolated and extrapolated; times in s on its own clock.

    `clock_resets` counts how often that clock went back or the pose jumped: earlier poses are
    invalid after a reset.
    """

    def __init__(self, braking_linear: float, braking_angular: float) -> None:
        """The base changes its speeds at least at these rates, in m/s2 and rad/s2."""
        self._braking = braking_linear, braking_angular
        self._readings: deque[Odometry] = deque(maxlen=HISTORY)
        self.clock_resets = 0

    def update(self, context: DecisionContext) -> None:
        """Record the odometry of the context if it is new.

        A new reading whose stamp does not rise, or whose pose jumps, counts as a clock reset and
        clears the history.
        """
        odometry, readings = context.odometry, self._readings
        if odometry is None or (readings and odometry == readings[-1]):
            return
        if readings and (odometry.stamp <= readings[-1].stamp or odometry.jumps_from(readings[-1])):
            readings.clear()
            self.clock_resets += 1
        readings.append(odometry)

    def pose(self, context: DecisionContext, ago: float) -> Pose:
        """The pose `ago` s before the decision, in the odometry frame."""
        readings = self._readings
        if not readings:
            return Pose()
        at = readings[-1].stamp + (context.odometry_age or 0.0) - ago
        later = readings[-1]
        for reading in reversed(readings):
            if reading.stamp <= at:
                if reading is later:
                    return _moved(
                        reading.pose, reading.twist, min(at - reading.stamp, MAX_EXTRAPOLATION)
                    )
                return _between(reading, later, at)
            later = reading
        return _moved(later.pose, later.twist, at - later.stamp)

    def predicted_pose(self, context: DecisionContext, command: Twist) -> Pose:
        """The pose at which the next command takes effect, in the odometry frame.

        From the last reading on the robot approaches `command`, the present one, at the lowest
        rates of change.
        """
        if not self._readings:
            return Pose()
        last = self._readings[-1]
        seconds = min(context.odometry_age or 0.0, MAX_EXTRAPOLATION) + REACTION_TIME
        linear, angular = self._braking
        twist = Twist(
            _mean(last.twist.linear, command.linear, linear, seconds),
            _mean(last.twist.angular, command.angular, angular, seconds),
            _mean(last.twist.lateral, command.lateral, linear, seconds),
        )
        return _moved(last.pose, twist, seconds)


def relative(pose: Pose, frame: Pose) -> Pose:
    """`pose` relative to `frame`, both given in the same frame."""
    dx, dy = pose.x - frame.x, pose.y - frame.y
    cos, sin = math.cos(frame.yaw), math.sin(frame.yaw)
    return Pose(cos * dx + sin * dy, cos * dy - sin * dx, pose.yaw - frame.yaw)


def _moved(pose: Pose, twist: Twist, seconds: float) -> Pose:
    """The pose after `seconds` at a constant twist, along the chord of its arc."""
    turn = twist.angular * seconds
    yaw = pose.yaw + 0.5 * turn
    ahead, left = twist.linear * seconds, twist.lateral * seconds
    cos, sin = math.cos(yaw), math.sin(yaw)
    return Pose(
        pose.x + cos * ahead - sin * left, pose.y + sin * ahead + cos * left, pose.yaw + turn
    )


def _between(early: Odometry, late: Odometry, at: float) -> Pose:
    """The pose at a time between two readings, by linear interpolation."""
    share = (at - early.stamp) / (late.stamp - early.stamp)
    a, b = early.pose, late.pose
    turn = math.remainder(b.yaw - a.yaw, 2.0 * math.pi)
    return Pose(a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), a.yaw + share * turn)


def _mean(now: float, wanted: float, rate: float, seconds: float) -> float:
    """The mean speed over `seconds` on a ramp of `rate` from `now` to `wanted`."""
    change = wanted - now
    ramp = abs(change) / rate
    if ramp >= seconds:
        return now + math.copysign(0.5 * rate * seconds, change)
    return now + change * (1.0 - 0.5 * ramp / seconds)
