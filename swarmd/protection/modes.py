"""Mode `off`: every wish passes. For simulated robots alone; a daemon refuses it for others.

Mode `potential_field`: the paper's hardware protection layer.

Source: Kaiser et al., ICRA 2022, section III: any obstacle within the threshold suppresses the
pattern's command, and a repulsive potential field drives instead, at full speed. It promises
nothing; it is here because it is the paper's. Our deviations: rays below range_min count as
range_min (in the original they count as free), and the front holds the command within the limits.

Mode `stop_zone`: two zones around the outline, one that slows the robot and one that stops it.

As collision monitors of navigation stacks do it (Macenski et al., "The Marathon 2", IROS 2020, and
the collision monitor of that project): it knows nothing of where the robot goes, so all motion is
slowed or stopped alike. It cannot leave a stop zone by itself; the wish is not turned around.
"""

from __future__ import annotations

import msgspec
import numpy as np

from swarmd.core.values import ZERO, Platform, Scan, TouchZone, Twist
from swarmd.protection.decision import DecisionContext, ModeDecision, Row
from swarmd.protection.footprint import Footprint, Sight
from swarmd.protection.recovery import Clearance
from swarmd.protection.settings import StopZoneSettings
from swarmd.sensing.potential_field import field_twist, potential_field


class Off:
    """Protects nothing. The front still holds the limits and gives zero under every hold."""

    mode = "off"

    def __init__(self, platform: Platform) -> None:
        """Nothing is read from the platform."""

    def clearance(self, speed: float) -> None:
        """It never keeps a robot standing."""

    def observe(self, scan: Scan, sight: Sight, moment: DecisionContext) -> None:
        """Look at nothing."""

    def decide(
        self, requested: Twist, moment: DecisionContext, *, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The wish."""
        return ModeDecision(requested, is_active=False)


class PotentialField:
    """Evades while more than `rays` rays are nearer than `threshold` m (from the lidar)."""

    mode = "potential_field"

    def __init__(self, platform: Platform) -> None:
        settings = platform.protection
        self._limits = platform.limits
        self._threshold = float(settings["threshold"])
        self._rays = int(settings["rays"])
        self._forward_bias = float(settings["forward_bias"])
        self._evasion: Twist | None = None

    def clearance(self, speed: float) -> None:
        """It never keeps a robot standing."""

    def observe(self, scan: Scan, sight: Sight, moment: DecisionContext) -> None:
        """Compute the evading command, or that there is nothing to evade."""
        field = potential_field(
            scan.ranges,
            scan.bearings,
            range_max=self._threshold,
            range_min=scan.range_min,
            bias=self._forward_bias,
            ray_threshold=self._rays,
        )
        if field.is_alone:
            self._evasion = None
            return
        self._evasion = field_twist(field.vector, self._limits.linear, self._limits.angular)

    def decide(
        self, requested: Twist, moment: DecisionContext, *, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The evading command if there is something to evade, else the wish."""
        if self._evasion is None:
            return ModeDecision(requested, is_active=False)
        return ModeDecision(self._evasion, is_active=True)


class StopZone:
    """Stops within `stop` m of the outline, gives a share of the wish within `slow` m."""

    mode = "stop_zone"

    def __init__(self, platform: Platform) -> None:
        self._settings = msgspec.convert(platform.protection["stop_zone"], StopZoneSettings)
        self._outline = Footprint(platform.footprint)
        self._limit = platform.limits.linear
        self._nearest: tuple[float, float] | None = None

    def clearance(self, speed: float) -> Clearance:
        """Out of both zones."""
        front, half = self._outline.corners[:, 0].max(), np.abs(self._outline.corners[:, 1]).max()
        slow = self._settings.slow
        return Clearance(float(front) + slow, float(half) + slow)

    def observe(self, scan: Scan, sight: Sight, moment: DecisionContext) -> None:
        """Find the nearest return."""
        self._nearest = self._outline.nearest(scan, sight)

    def decide(
        self, requested: Twist, moment: DecisionContext, *, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The wish, a share of it, or zero."""
        settings = self._settings
        if self._nearest is None or requested.is_zero:
            return ModeDecision(requested, is_active=False)
        gap, bearing = self._nearest
        if gap <= settings.stop:
            return ModeDecision(ZERO, is_active=True, rows=(Row(bearing, gap, 0.0),))
        if gap > settings.slow:
            return ModeDecision(requested, is_active=False)
        share = settings.slow_share
        twist = Twist(
            share * requested.linear, share * requested.angular, share * requested.lateral
        )
        return ModeDecision(twist, is_active=True, rows=(Row(bearing, gap, share * self._limit),))
