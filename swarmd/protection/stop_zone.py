"""Mode `stop_zone`: two zones around the outline, one that slows the robot and one that stops it.

As collision monitors of navigation stacks do it (Macenski et al., "The Marathon 2", IROS 2020, and
the collision monitor of that project): it knows nothing of where the robot goes, so all motion is
slowed or stopped alike. It cannot leave a stop zone by itself; the wish is not turned around.
"""

from __future__ import annotations

import msgspec
import numpy as np

from swarmd.protection.footprint import Footprint, Sight
from swarmd.protection.moment import Moment
from swarmd.protection.settings import StopZoneSettings
from swarmd.protection.unstick import Berth
from swarmd.protection.verdict import Decision, Row
from swarmd.values import ZERO, Platform, Scan, TouchZone, Twist


class StopZone:
    """Stops within `stop` m of the outline, gives a share of the wish within `slow` m."""

    mode = "stop_zone"

    def __init__(self, platform: Platform) -> None:
        self._settings = msgspec.convert(platform.protection["stop_zone"], StopZoneSettings)
        self._outline = Footprint(platform.footprint)
        self._limit = platform.limits.linear
        self._nearest: tuple[float, float] | None = None

    def berth(self, speed: float) -> Berth:
        """Out of both zones."""
        front, half = self._outline.corners[:, 0].max(), np.abs(self._outline.corners[:, 1]).max()
        slow = self._settings.slow
        return Berth(float(front) + slow, float(half) + slow)

    def observe(self, scan: Scan, sight: Sight, moment: Moment) -> None:
        """Find the nearest return."""
        self._nearest = self._outline.nearest(scan, sight)

    def decide(
        self, wish: Twist, moment: Moment, *, command: Twist, touch: TouchZone | None
    ) -> Decision:
        """The wish, a share of it, or zero."""
        settings = self._settings
        if self._nearest is None or wish.is_zero:
            return Decision(wish, is_active=False)
        gap, bearing = self._nearest
        if gap <= settings.stop:
            return Decision(ZERO, is_active=True, rows=(Row(bearing, gap, 0.0),))
        if gap > settings.slow:
            return Decision(wish, is_active=False)
        share = settings.slow_share
        twist = Twist(share * wish.linear, share * wish.angular, share * wish.lateral)
        return Decision(twist, is_active=True, rows=(Row(bearing, gap, share * self._limit),))
