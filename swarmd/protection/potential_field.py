"""Mode `potential_field`: the paper's hardware protection layer.

Source: Kaiser et al., ICRA 2022, section III: any obstacle within the threshold suppresses the
pattern's command, and a repulsive potential field drives instead, at full speed. It promises
nothing; it is here because it is the paper's. Our deviations: rays below range_min count as
range_min (in the original they count as free), and the front holds the command within the limits.
"""

from __future__ import annotations

from swarmd.protection.footprint import Sight
from swarmd.protection.moment import Moment
from swarmd.protection.verdict import Decision
from swarmd.scans.fields import field_twist, potential_field
from swarmd.values import Platform, Scan, TouchZone, Twist


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

    def berth(self, speed: float) -> None:
        """It never keeps a robot standing."""

    def observe(self, scan: Scan, sight: Sight, moment: Moment) -> None:
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
        self, wish: Twist, moment: Moment, *, command: Twist, touch: TouchZone | None
    ) -> Decision:
        """The evading command if there is something to evade, else the wish."""
        if self._evasion is None:
            return Decision(wish, is_active=False)
        return Decision(self._evasion, is_active=True)
