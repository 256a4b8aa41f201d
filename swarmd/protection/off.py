"""Mode `off`: every wish passes. For simulated robots alone; a daemon refuses it for others."""

from __future__ import annotations

from swarmd.protection.footprint import Sight
from swarmd.protection.moment import Moment
from swarmd.protection.verdict import Decision
from swarmd.values import Platform, Scan, TouchZone, Twist


class Off:
    """Protects nothing. The front still holds the limits and gives zero under every hold."""

    mode = "off"

    def __init__(self, platform: Platform) -> None:
        """Nothing is read from the platform."""

    def berth(self, speed: float) -> None:
        """It never keeps a robot standing."""

    def observe(self, scan: Scan, sight: Sight, moment: Moment) -> None:
        """Look at nothing."""

    def decide(
        self, wish: Twist, moment: Moment, *, command: Twist, touch: TouchZone | None
    ) -> Decision:
        """The wish."""
        return Decision(wish, is_active=False)
