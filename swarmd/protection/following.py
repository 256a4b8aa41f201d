"""Compares the motion of a base with its commands, which a base may refuse or change. Pure.

Two models bound the speed of a base that follows its commands: a fast base has the speed of any
command of the last WINDOW, and a slow base responds DELAY late with a quarter of the declared
braking. A base does not follow its commands if its speed is outside these bounds for MIN_DURATION,
by more than SLIP times the commanded speed.

The comparison changes no motion: a reflex, a stuck wheel and another node that drives look alike.
"""

from __future__ import annotations

import math
from collections import deque

import msgspec

from swarmd.core.values import ZERO, Odometry, Platform, Twist
from swarmd.protection.settings import BarrierSettings

MIN_DURATION = 0.7
"""Seconds for which the speed must be outside the bounds."""
WINDOW = 1.0
"""Seconds for which a command counts for the fast base."""
DELAY = 0.3
"""Seconds after a command at which the slow base begins to respond."""
SLIP = 0.5
"""Share of the commanded speed by which the speed may be outside the bounds."""

# m/s, rad/s and m/s to the left: slower commands may not overcome the friction of a base.
_LEAST = 0.05, 0.25, 0.05
_BRAKING = 1.0, 3.0  # m/s2 and rad/s2 where the platform declares none
_SLOW = 0.25  # share of the declared braking
_MAX_PERIOD = 0.3  # s between two readings
_MIN_READINGS = 4
_UNITS = "m/s", "rad/s", "m/s to the left"
_WHY = "a reflex of the base, a stuck wheel, or another node drives"


class _Axis:
    """Commands and motion of one axis; times are stamps of odometry in s."""

    def __init__(self, least: float, acceleration: float, unit: str) -> None:
        self._least, self._acceleration, self._unit = least, acceleration, unit
        # Stamps since which a command holds: until where the slow base is, and after.
        self._early, self._later = deque[tuple[float, float]](), deque[tuple[float, float]]()
        self.reset(0.0, -math.inf)

    def reset(self, command: float, stamp: float) -> None:
        """Begin again; for WINDOW, the base may be at any speed."""
        self._early.clear()
        self._later.clear()
        self._early.append((stamp, command))
        self._slow = self._command = command
        self._begun = stamp
        self._off_since, self._readings = math.inf, 0
        self.text = ""

    def on_command(self, command: float, stamp: float) -> None:
        """The command changes after the reading at `stamp`."""
        if command != self._command:
            self._command = command
            self._later.append((stamp, command))

    def on_reading(self, period: float, stamp: float, speeds: tuple[float, float]) -> None:
        """The base moved at one of these speeds, by its twist and by its pose, for `period` s."""
        early, later = self._early, self._later
        # Commands have the stamp of the reading before, and hold from the end of a period on.
        begin = stamp - DELAY - 2.0 * period
        while later and later[0][0] <= begin:
            early.append(later.popleft())
        while len(early) > 1 and early[-1][0] > begin:  # the period has grown
            later.appendleft(early.pop())
        while len(early) > 1 and early[1][0] <= stamp - WINDOW:
            early.popleft()
        step, off = self._acceleration * period, early[-1][1] - self._slow
        self._slow += -step if off < -step else step if off > step else off
        # Mostly the speed is near the last command and the slow base: the bounds are no narrower.
        low, high, least = self._slow, self._command, self._least
        if low > high:
            low, high = high, low
        one, other = speeds
        if low - least <= one <= high + least or low - least <= other <= high + least:
            self._off_since, self._readings, self.text = math.inf, 0, ""
            return
        values = [self._slow, *(command for _, command in (*early, *later))]
        low, high = min(values), max(values)
        allowed = max(least, SLIP * max(abs(low), abs(high)))
        measured = min(speeds, key=lambda speed: max(low - speed, speed - high))
        is_off = not low - allowed <= measured <= high + allowed
        if not is_off or stamp - self._begun < WINDOW:
            self._off_since, self._readings, self.text = math.inf, 0, ""
            return
        self._off_since = min(self._off_since, stamp - period)
        self._readings += 1
        duration = stamp - self._off_since
        if duration >= MIN_DURATION - 1e-9 and self._readings >= _MIN_READINGS:
            moves = f"{measured:.2f} {self._unit}"
            self.text = (
                f"the base does not follow: commanded {self._command:.2f} {self._unit}, moves"
                f" {moves} since {duration:.1f} s: {_WHY}"
            )


class FollowingMonitor:
    """Watches whether the base of one robot follows its safe commands while it runs.

    Forward, in turns, and sideways where the platform's `limits.lateral` lets the base slide.
    `text`: how it does not; empty while it does.
    """

    def __init__(self, platform: Platform) -> None:
        braking, given = _BRAKING, platform.protection.get("barrier")
        if given is not None:
            settings = msgspec.convert(given, BarrierSettings)
            braking = settings.braking_linear, settings.braking_angular
        linear, angular = (_SLOW * one for one in braking)
        axes = map(_Axis, _LEAST, (linear, angular, linear), _UNITS)
        self._linear, self._angular, lateral = axes
        self._lateral = lateral if platform.limits.lateral > 0.0 else None
        self._command = ZERO
        self._odometry: Odometry | None = None
        self.text = ""

    def reset(self) -> None:
        """Drop the last command and reading, as for a robot that does not run."""
        if self._odometry is None:
            return
        self._odometry, self._command, self.text = None, ZERO, ""

    def on_command(self, command: Twist) -> None:
        """The safe command that the driver gets."""
        if command is self._command:
            return
        self._command = command
        if self._odometry is not None:
            stamp = self._odometry.stamp
            self._linear.on_command(command.linear, stamp)
            self._angular.on_command(command.angular, stamp)
            if self._lateral is not None:
                self._lateral.on_command(command.lateral, stamp)

    def on_odometry(self, odometry: Odometry) -> None:
        """A reading arrived."""
        last, self._odometry = self._odometry, odometry
        if last is not None and odometry.stamp == last.stamp:
            return
        if (
            last is None
            or not 0.0 < odometry.stamp - last.stamp <= _MAX_PERIOD
            or odometry.jumps_from(last)
        ):
            self._linear.reset(self._command.linear, odometry.stamp)
            self._angular.reset(self._command.angular, odometry.stamp)
            if self._lateral is not None:
                self._lateral.reset(self._command.lateral, odometry.stamp)
            self.text = ""
            return
        period = odometry.stamp - last.stamp
        here, there = odometry.pose, last.pose
        turned = math.remainder(here.yaw - there.yaw, math.tau)
        yaw = there.yaw + 0.5 * turned
        x, y, ahead, aside = here.x - there.x, here.y - there.y, math.cos(yaw), math.sin(yaw)
        twist, stamp, way = odometry.twist, odometry.stamp, ahead * x + aside * y
        self._linear.on_reading(period, stamp, (twist.linear, way / period))
        self._angular.on_reading(period, stamp, (twist.angular, turned / period))
        self.text = self._linear.text or self._angular.text  # the first axis that is off
        if self._lateral is not None:
            way = ahead * y - aside * x
            self._lateral.on_reading(period, stamp, (twist.lateral, way / period))
            self.text = self.text or self._lateral.text
