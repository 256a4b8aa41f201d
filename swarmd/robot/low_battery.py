"""Decides from the readings of the charge whether the battery of a robot is low. Pure.

1. The battery becomes low once all readings of CONFIRM_TIME are below `below`: a start of the
   motors lowers the voltage for a moment.
2. The battery stays low until one reading is at least `until`, which is above `below`: a charge
   that varies around `below` acts once.
3. A robot without a fresh reading keeps what it knows. Without any reading the battery is not low.
"""

from __future__ import annotations

import math

from swarmd.core.low_battery import LowBatterySettings

CONFIRM_TIME = 5.0
"""Seconds for which each reading must be below the bound."""


class LowBattery:
    """The battery of one robot. `charge`: the present reading; None without a fresh reading."""

    def __init__(self) -> None:
        self.charge: float | None = None
        self.is_low = False
        self._below_since = math.inf  # s, own clock

    @property
    def remark(self) -> str:
        """For the answer to a run; empty if the battery is not low."""
        return f"its battery is low{self.charge_text}" if self.is_low else ""

    @property
    def charge_text(self) -> str:
        """The charge in brackets; empty without a fresh reading."""
        return "" if self.charge is None else f" ({self.charge:.2f})"

    def take(self, charge: float | None, settings: LowBatterySettings, now: float) -> bool:
        """Take in the charge, None without a fresh reading; True if `is_low` has changed."""
        self.charge = charge
        if charge is None or charge >= settings.below:
            self._below_since = math.inf
        elif self._below_since == math.inf:
            self._below_since = now
        was_low = self.is_low
        if was_low:
            self.is_low = charge is None or charge < settings.until
        else:
            self.is_low = now - self._below_since >= CONFIRM_TIME
        return self.is_low is not was_low
