"""How far off something may bind a robot: nobody looks at what is further than that."""

from __future__ import annotations

import numpy as np

from swarmd.protection.settings import BarrierSettings
from swarmd.values import Platform


class Reach:
    """Gaps in m, of a platform whose next decision comes after `tick` s."""

    def __init__(self, platform: Platform, settings: BarrierSettings, tick: float) -> None:
        self._limits, self._settings, self._tick = platform.limits, settings, tick
        self._outer = float(np.hypot(*platform.footprint.T).max())
        own = max(self._limits.linear, self._limits.lateral)
        # The promise to others binds no robot that has nothing near.
        self._fastest = max(settings.surface_speed or settings.others_speed, own)
        self._idle = self.at_rest(self._fastest)

    def at_rest(self, speed: float) -> float:
        """The gap at which a row may bind a surface of that speed with a scan of this instant."""
        settings, tick = self._settings, self._tick
        spin = min(self._limits.angular, speed / self._outer)
        linear = min(speed, max(self._limits.linear, self._limits.lateral))
        braking = max(linear / settings.braking_linear, spin / settings.braking_angular)
        gap = speed * (tick + 0.5 * braking) + settings.others_speed * (tick + braking)
        return gap + settings.margin + settings.unseen_extent

    def after(self, age: float) -> float:
        """The same with one of that age in s: both have moved since, the robot perhaps towards."""
        settings, speed = self._settings, self._fastest
        gap = self._idle + (settings.others_speed + speed) * age
        if settings.keep_out is None:
            return gap
        half = speed * (2.0 * self._tick + age + 0.5 * speed / settings.braking_linear)
        return max(gap, settings.keep_out + 2.0 * half + speed * age)
