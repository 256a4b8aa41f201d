"""Compares what mode `barrier` assumes of base and surroundings with what happens. Pure.

Braking: each time the safe command falls clearly, the deceleration that odometry shows until the
base has followed is compared with the assumed one. It is taken between readings of which the base
already brakes, by their own stamps: neither late nor rare odometry makes brakes look weak. The
reaction time is not told from the delay of odometry, and is not judged.

Others: the speed at which the gap to the nearest return falls, less all that the robot itself has
moved, is compared with `others_speed`. A thing that approaches is seen so, one that passes is not.

A violation makes the robot slower by `speed_share`, for good: nothing that happens later proves the
assumption. The share is the measured braking over the assumed one: with it the speed s and braking
b keep s / b, the time to stop, in which others approach, and shorten the way. For others it is the
assumed speed over the measured one.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import msgspec
import numpy as np

from swarmd.core.values import ZERO, Odometry, Platform, Pose, Twist
from swarmd.protection.settings import BarrierSettings

MIN_SHARE = 0.2
"""The lowest `speed_share`."""

_WEAK = 0.8  # share of the assumed braking; noise of odometry is some 6 %
_WEAKER = 0.95  # share of what is known that is worth another event
_JUDGED = 3  # stops of which two must be weak: in one, another may have pushed the robot
_MIN_DROP = 0.08, 0.4  # m/s and rad/s by which the command must fall at once
_MIN_DROP_TIME = 0.1  # s of assumed braking that it takes at least
_FOLLOWED = 0.15  # share of the command that the speed may be off it before
_MIN_DROP_SHARE = 0.5  # of the speed: noise of odometry grows with it
_BEGUN, _ENDS = 0.85, 0.15  # shares of the drop that is left: between them the base brakes
_MIN_READINGS = 3
_MIN_TIME = 0.09  # s between the first and the last of them
_RISE = 0.1  # share of the speed by which noise may raise it while the base brakes
_MAX_WAIT = 1.5  # s in which a stop is judged

_NEAR = 1.0  # m within which an approach counts
_STEPS = 4  # between consecutive scans
_MIN_APPROACH = 0.35  # s
_MAX_GAP_TIME = 0.6  # s between scans
_FASTER, _NOISE = 1.15, 0.05  # times others_speed, plus m/s: what clearly is faster
_STEADY = 0.6  # share of the mean speed that each step must have: things appear, and are lost
_APART = 5.0  # s between two approaches


class _Stop(NamedTuple):
    """A fall of the command from speed `begin` to `target`, both in direction `sign`."""

    sign: float
    begin: float
    target: float
    at: float
    readings: list[tuple[float, float]]


class _Brake:
    """Judges the stops of one axis with an assumed braking in m/s2 or rad/s2.

    `min_drop` in m/s or rad/s is the least fall of the command that begins a stop. `stop` is the
    one under way, `measured` the weakest braking that is certain, or the assumed one.
    `is_weaker`: that has changed.
    """

    def __init__(self, assumed: float, min_drop: float) -> None:
        self._assumed = assumed
        self.min_drop = max(min_drop, _MIN_DROP_TIME * assumed)
        self.stop: _Stop | None = None
        self._judged: deque[float] = deque(maxlen=_JUDGED)
        self.measured, self.is_weaker = assumed, False

    def on_command(self, before: float, command: float, speed: float, stamp: float) -> None:
        """The command changes; `speed` was measured last, at `stamp`."""
        sign = 1.0 if speed >= 0.0 else -1.0
        target, begin = max(sign * command, 0.0), sign * speed
        stop = self.stop
        if stop is not None and (stop.sign != sign or target > stop.target + 1e-6):
            self._judge(stop.readings)
            self.stop = stop = None
        has_followed = abs(begin - sign * before) <= _FOLLOWED * abs(before)
        min_drop = max(self.min_drop, _MIN_DROP_SHARE * begin)
        if stop is None and has_followed and begin - target >= min_drop:
            self.stop = _Stop(sign, begin, target, stamp, [])

    def on_speed(self, speed: float, stamp: float) -> None:
        """A reading arrived after a stop began."""
        stop = self.stop
        assert stop is not None
        speed *= stop.sign
        left, readings = (speed - stop.target) / (stop.begin - stop.target), stop.readings
        is_pushed = speed > (readings[-1][1] if readings else stop.begin) + _RISE * stop.begin
        if is_pushed or stamp <= stop.at:
            self.stop = None
        elif left <= _ENDS or stamp - stop.at > _MAX_WAIT:
            self.stop = None
            self._judge(readings)
        elif left < _BEGUN:
            readings.append((stamp, speed))

    def _judge(self, readings: list[tuple[float, float]]) -> None:
        if len(readings) < _MIN_READINGS or readings[-1][0] - readings[0][0] < _MIN_TIME:
            return  # a good stop is often too short to judge
        (begin, first), (end, last) = readings[0], readings[-1]
        braking = (first - last) / (end - begin)
        self._judged.append(braking)
        weak = sorted(one for one in self._judged if one < _WEAK * self._assumed)
        if len(weak) > 1 and weak[0] < _WEAKER * self.measured:
            self.measured, self.is_weaker = max(weak[0], 1e-3), True


class AssumptionMonitor:
    """Watches braking and the speed of others for one robot.

    Its methods return the text of an event for the robot's log, else an empty one. `speed_share` in
    [MIN_SHARE, 1]: the share of the safe command that the base may get.
    """

    def __init__(self, platform: Platform) -> None:
        self.speed_share = 1.0
        settings = msgspec.convert(platform.protection["barrier"], BarrierSettings)
        self._settings = settings
        self._radius = float(np.hypot(*platform.footprint.T).max())
        self._linear = _Brake(settings.braking_linear, _MIN_DROP[0])
        self._angular = _Brake(settings.braking_angular, _MIN_DROP[1])
        self._command, self._odometry = ZERO, Odometry(-math.inf, Pose(), ZERO)
        self._moved = 0.0  # m that any corner may have moved while a thing comes near
        self._steps: deque[tuple[float, float, float]] = deque(maxlen=_STEPS + 1)
        self._approaches: list[float] = []
        self._approached_at = -math.inf

    def on_command(self, command: Twist) -> None:
        """The safe command that the driver gets."""
        if command is self._command:
            return
        before, self._command = self._command, command
        measured, stamp = self._odometry.twist, self._odometry.stamp
        linear, angular = self._linear, self._angular
        # Most commands neither begin nor continue a stop, so the brakes need no look.
        if linear.stop or abs(command.linear - measured.linear) >= linear.min_drop:
            linear.on_command(before.linear, command.linear, measured.linear, stamp)
        if angular.stop or abs(command.angular - measured.angular) >= angular.min_drop:
            angular.on_command(before.angular, command.angular, measured.angular, stamp)

    def on_odometry(self, odometry: Odometry) -> str:
        """A reading arrived."""
        last, self._odometry = self._odometry, odometry
        if odometry.stamp <= last.stamp:
            return ""
        if self._steps:
            pose, before = odometry.pose, last.pose
            turned = abs(math.remainder(pose.yaw - before.yaw, math.tau))
            self._moved += math.hypot(pose.x - before.x, pose.y - before.y) + self._radius * turned
        linear, angular = self._linear, self._angular
        if linear.stop:
            linear.on_speed(odometry.twist.linear, odometry.stamp)
        if angular.stop:
            angular.on_speed(odometry.twist.angular, odometry.stamp)
        if linear.is_weaker:
            linear.is_weaker = False
            return self._braked(linear.measured, self._settings.braking_linear, "m/s2")
        if angular.is_weaker:
            angular.is_weaker = False
            return self._braked(angular.measured, self._settings.braking_angular, "rad/s2")
        return ""

    def on_scan(self, stamp: float, gap: float | None) -> str:
        """A scan arrived, with its own stamp in s and the gap to its nearest return in m."""
        steps = self._steps
        if gap is None or gap > _NEAR or (steps and not 0.0 < stamp - steps[-1][0] < _MAX_GAP_TIME):
            steps.clear()
        if gap is None or gap > _NEAR:
            return ""
        steps.append((stamp, gap, self._moved))
        if len(steps) <= _STEPS or stamp - steps[0][0] < _MIN_APPROACH:
            return ""
        first, assumed = steps[0], self._settings.others_speed
        way = first[1] - gap - (self._moved - first[2])
        speed = way / (stamp - first[0])
        if speed < _FASTER * assumed + _NOISE or stamp - self._approached_at < _APART:
            return ""
        for i in range(_STEPS):
            (t0, gap0, moved0), (t1, gap1, moved1) = steps[i], steps[i + 1]
            if gap0 - gap1 - (moved1 - moved0) < _STEADY * speed * (t1 - t0):
                return ""
        self._approached_at = stamp
        self._approaches.append(speed)
        text = f"something came at {speed:.2f} m/s, assumed at most {assumed:.2f}"
        if len(self._approaches) < 2:
            return text
        return self._reduce(text, assumed / sorted(self._approaches)[-2])

    def _braked(self, measured: float, assumed: float, unit: str) -> str:
        text = f"braked at {measured:.2f} {unit}, assumed {assumed:.2f}"
        return self._reduce(text, measured / assumed)

    def _reduce(self, text: str, share: float) -> str:
        self.speed_share = min(max(share, MIN_SHARE), self.speed_share)
        return f"{text}: speed reduced to {self.speed_share:.0%}"
