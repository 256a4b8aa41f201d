"""The gap beyond which no obstacle constrains a robot in mode `barrier`."""

from __future__ import annotations

import math

import numpy as np

from swarmd.core.values import Platform
from swarmd.robot.protection.settings import BarrierSettings

REACTION_TIME = 0.05
"""Seconds from a decision to the first response of the base: one tick."""


class BindingRange:
    """Gaps in m beyond which no obstacle constrains the robot, so that returns are left out.

    Attributes:
        own: m/s, the highest speed of the base in any direction.
        surface: m/s, the highest speed of any place of the robot's surface near obstacles.
        fastest: m/s, the highest speed of any place of the robot's surface anywhere.
        fresh: m, the gap for a scan of age 0.
        stale: s, the longest time from the middle of a scan until a command by this scan acts.
    """

    def __init__(self, platform: Platform, settings: BarrierSettings, tick: float) -> None:
        """`tick`: s between two decisions."""
        self._limits = platform.limits
        self._settings = settings
        self._tick = tick
        self._scan = platform.scan
        self._footprint = platform.footprint
        self._outer = float(np.hypot(*platform.footprint.T).max())
        self.own = math.hypot(self._limits.linear, self._limits.lateral)
        self.surface = settings.surface_speed or settings.others_speed
        # Far from obstacles the envelope does not apply, so the own limit may be the higher one.
        self.fastest = max(self.surface, self.own)
        self.fresh = self.for_fresh_scan(self.fastest)
        self.stale = platform.scan.stale_after + platform.scan.latency + REACTION_TIME

    def for_fresh_scan(self, speed: float) -> float:
        """The gap for a scan of age 0 and a surface of the robot that moves at `speed` m/s."""
        settings = self._settings
        tick = self._tick
        spin = min(self._limits.angular, speed / self._outer)
        linear = min(speed, self.own)
        braking = max(linear / settings.braking_linear, spin / settings.braking_angular)
        gap = speed * (tick + 0.5 * braking) + settings.others_speed * (tick + braking)
        return gap + settings.margin + settings.unseen_extent

    def for_age(self, age: float) -> float:
        """The gap for an obstacle seen `age` s ago: since then, both may have approached."""
        return self.fresh + (self._settings.others_speed + self.fastest) * age

    def for_scan_age(self, age: float) -> float:
        """As `for_age`, for returns of a scan; they must also stay out of the keep_out circle."""
        settings = self._settings
        speed = self.fastest
        gap = self.for_age(age)
        if settings.keep_out is None:
            return gap
        half = speed * (2.0 * self._tick + age + 0.5 * speed / settings.braking_linear)
        return max(gap, settings.keep_out + 2.0 * half + speed * age)

    def for_envelope(self) -> float:
        """The gap within which the surface must not exceed `surface`, for a scan of any age."""
        return self.for_fresh_scan(self.surface) + self._settings.others_speed * self.stale

    def for_sensor(self) -> float:
        """Distance in m from the sensor at which an obstacle must be visible.

        A ray may be half a sweep older than the middle of its scan.
        """
        scan = self._scan
        sweep = 1.0 / scan.rate if scan.sweep is None else scan.sweep.duration
        outermost = float(np.hypot(*(self._footprint - scan.offset).T).max())
        return outermost + self.for_scan_age(self.stale + 0.5 * sweep)
