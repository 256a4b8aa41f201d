"""Odometry readings of the last seconds, and poses between them."""

from __future__ import annotations

import math
from collections import deque

from swarmd.core.values import Odometry, Pose, Twist

MAX_EXTRAPOLATION = 0.15
"""Seconds for which the last measured twist is extrapolated: three odometry periods."""

HISTORY = 40
"""Readings that are kept."""

_MIN_STEP = 1e-9  # s between two poses of a path


class OdometryHistory:
    """Poses in the odometry frame, interpolated and extrapolated; times are stamps in s.

    `resets` counts how often the stamps went back or the pose jumped: earlier poses are invalid
    after a reset.
    """

    def __init__(self) -> None:
        self.readings: deque[Odometry] = deque(maxlen=HISTORY)
        self.resets = 0

    def update(self, odometry: Odometry) -> None:
        """Record a reading if it is new.

        A new reading whose stamp does not rise, or whose pose jumps, counts as a reset and clears
        the history.
        """
        readings = self.readings
        if readings and odometry == readings[-1]:
            return
        if readings and (odometry.stamp <= readings[-1].stamp or odometry.jumps_from(readings[-1])):
            readings.clear()
            self.resets += 1
        readings.append(odometry)

    @property
    def latest(self) -> Odometry | None:
        """The last reading."""
        return self.readings[-1] if self.readings else None

    def covers(self, at: float) -> bool:
        """True if the readings reach back to a time."""
        return bool(self.readings) and at >= self.readings[0].stamp - MAX_EXTRAPOLATION

    def pose(self, at: float) -> Pose:
        """The pose at a time; that of the origin without a reading."""
        readings = self.readings
        if not readings:
            return Pose()
        later = readings[-1]
        for reading in reversed(readings):
            if reading.stamp <= at:
                if reading is later:
                    seconds = min(at - reading.stamp, MAX_EXTRAPOLATION)
                    return moved(reading.pose, reading.twist, seconds)
                return _between(reading, later, at)
            later = reading
        return moved(later.pose, later.twist, at - later.stamp)

    def path(self, at: float, seconds: float) -> list[tuple[float, float, float, float]] | None:
        """The way to the pose at a time: rows of s before it, x and y in m and yaw in rad.

        Relative to that pose, from it back to the pose `seconds` earlier; between two rows the pose
        changes linearly. None if the readings do not reach back that far.
        """
        if not self.covers(at - seconds):
            return None
        end = self.pose(at)
        cos, sin = math.cos(end.yaw), math.sin(end.yaw)
        steps = [(0.0, end)]
        for reading in reversed(self.readings):
            ago = at - reading.stamp
            if ago >= seconds - _MIN_STEP:
                break
            if ago > _MIN_STEP:
                steps.append((ago, reading.pose))
        steps.append((seconds, self.pose(at - seconds)))
        rows, turned = [], 0.0
        for ago, pose in steps:
            dx, dy = pose.x - end.x, pose.y - end.y
            turned += math.remainder(pose.yaw - end.yaw - turned, 2.0 * math.pi)
            rows.append((ago, cos * dx + sin * dy, cos * dy - sin * dx, turned))
        return rows


def relative(pose: Pose, frame: Pose) -> Pose:
    """`pose` relative to `frame`, both given in the same frame."""
    dx, dy = pose.x - frame.x, pose.y - frame.y
    cos, sin = math.cos(frame.yaw), math.sin(frame.yaw)
    return Pose(cos * dx + sin * dy, cos * dy - sin * dx, pose.yaw - frame.yaw)


def moved(pose: Pose, twist: Twist, seconds: float) -> Pose:
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
