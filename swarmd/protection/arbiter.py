"""What every protection mode implements, and how a mode is made from a platform."""

from __future__ import annotations

from typing import Protocol

from swarmd.errors import ConfigError, unknown
from swarmd.protection.footprint import Sight
from swarmd.protection.moment import Moment
from swarmd.protection.potential_field import PotentialField
from swarmd.protection.verdict import Decision
from swarmd.values import Odometry, Platform, Scan, TouchZone, Twist

MODES = ("potential_field",)


class Arbiter(Protocol):
    """One mode. It is asked only when the fail-safe front has found nothing that forbids motion."""

    mode: str

    def observe(self, scan: Scan, sight: Sight, odometry: Odometry | None) -> None:
        """Take in a new scan: all its geometry, once. `sight` says where its rays end."""

    def decide(self, wish: Twist, moment: Moment, touch: TouchZone | None) -> Decision:
        """The safe command for a wish within limits; the moment has a scan.

        `touch`: where the running pattern may touch what is near.
        """


def make_arbiter(platform: Platform) -> Arbiter:
    """The mode that the platform's file names; ConfigError if there is none such."""
    mode = str(platform.protection.get("mode", "potential_field"))
    if mode == "potential_field":
        return PotentialField(platform)
    raise ConfigError(f"platform {platform.name}: {unknown('protection mode', mode, MODES)}")
