"""How the robot has moved since a sweep was taken, and will have when a command takes effect."""

from __future__ import annotations

import math
from collections import deque

from swarmd.core.values import Odometry, Pose, Twist
from swarmd.protection.decision import DecisionContext

REACTION = 0.05
"""Seconds from a decision to the base's first move: one tick."""

TRUSTED = 0.15
"""Seconds for which the last measured twist says how the robot moves on: three periods."""

_HISTORY = 40


class Motion:
    """Dead reckoning with measured odometry; times in s on the odometry's own clock.

    Call `update` whenever a moment is at hand: it remembers the readings. `restarts` counts how
    often its clock was set back: poses from before are worth nothing then.
    """

    def __init__(self, braking_linear: float, braking_angular: float) -> None:
        """The base changes its speeds at least so fast, in m/s2 and rad/s2."""
        self._braking = braking_linear, braking_angular
        self._readings: deque[Odometry] = deque(maxlen=_HISTORY)
        self.restarts = 0

    def update(self, moment: DecisionContext) -> None:
        """Remember the odometry of this moment, if it is new. A clock set back starts anew.

        One that stands still while what it stamps changes is no better.
        """
        odometry, readings = moment.odometry, self._readings
        if odometry is None or (readings and odometry == readings[-1]):
            return
        if readings and odometry.stamp <= readings[-1].stamp:
            readings.clear()
            self.restarts += 1
        readings.append(odometry)

    def pose(self, moment: DecisionContext, ago: float) -> Pose:
        """Where the robot was `ago` s before the moment, in the odometry's frame."""
        readings = self._readings
        if not readings:
            return Pose()
        at = readings[-1].stamp + (moment.odometry_age or 0.0) - ago
        later = readings[-1]
        for reading in reversed(readings):
            if reading.stamp <= at:
                if reading is later:
                    return _moved(reading.pose, reading.twist, min(at - reading.stamp, TRUSTED))
                return _between(reading, later, at)
            later = reading
        return _moved(later.pose, later.twist, at - later.stamp)

    def ahead(self, moment: DecisionContext, command: Twist) -> Pose:
        """Where the robot will be when the next command takes effect.

        From the last reading on it is taken to change over to `command`, the one in force, as
        slowly as it may.
        """
        if not self._readings:
            return Pose()
        last = self._readings[-1]
        seconds = min(moment.odometry_age or 0.0, TRUSTED) + REACTION
        linear, angular = self._braking
        twist = Twist(
            _mean(last.twist.linear, command.linear, linear, seconds),
            _mean(last.twist.angular, command.angular, angular, seconds),
            _mean(last.twist.lateral, command.lateral, linear, seconds),
        )
        return _moved(last.pose, twist, seconds)


def relative(pose: Pose, frame: Pose) -> Pose:
    """A pose seen from another, both in the same frame."""
    dx, dy = pose.x - frame.x, pose.y - frame.y
    cos, sin = math.cos(frame.yaw), math.sin(frame.yaw)
    return Pose(cos * dx + sin * dy, cos * dy - sin * dx, pose.yaw - frame.yaw)


def _moved(pose: Pose, twist: Twist, seconds: float) -> Pose:
    """A pose after so long with a constant twist, along the chord of its arc."""
    turn = twist.angular * seconds
    yaw = pose.yaw + 0.5 * turn
    ahead, left = twist.linear * seconds, twist.lateral * seconds
    cos, sin = math.cos(yaw), math.sin(yaw)
    return Pose(
        pose.x + cos * ahead - sin * left, pose.y + sin * ahead + cos * left, pose.yaw + turn
    )


def _between(early: Odometry, late: Odometry, at: float) -> Pose:
    share = (at - early.stamp) / (late.stamp - early.stamp)
    a, b = early.pose, late.pose
    turn = math.remainder(b.yaw - a.yaw, 2.0 * math.pi)
    return Pose(a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), a.yaw + share * turn)


def _mean(now: float, wanted: float, rate: float, seconds: float) -> float:
    """The mean speed over so long, on a ramp from `now` to `wanted`."""
    change = wanted - now
    ramp = abs(change) / rate
    if ramp >= seconds:
        return now + math.copysign(0.5 * rate * seconds, change)
    return now + change * (1.0 - 0.5 * ramp / seconds)
