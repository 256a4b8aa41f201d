"""What every protection mode implements, and how a mode is made from a platform."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Protocol

from swarmd.errors import ConfigError, unknown
from swarmd.protection.barrier import Barrier
from swarmd.protection.footprint import Sight
from swarmd.protection.moment import Moment
from swarmd.protection.off import Off
from swarmd.protection.potential_field import PotentialField
from swarmd.protection.stop_zone import StopZone
from swarmd.protection.unstick import Berth
from swarmd.protection.verdict import Decision
from swarmd.values import Platform, Scan, TouchZone, Twist


class Arbiter(Protocol):
    """One mode. It is asked only when the fail-safe front has found nothing that forbids motion."""

    mode: str

    def berth(self, speed: float) -> Berth | None:
        """The room that it takes to drive at `speed` m/s unhindered; None: it never blocks."""

    def observe(self, scan: Scan, sight: Sight, moment: Moment) -> None:
        """Take in a new scan: all its geometry, once. `sight` says where its rays end."""

    def decide(
        self, wish: Twist, moment: Moment, *, command: Twist, touch: TouchZone | None
    ) -> Decision:
        """The safe command for a wish within limits; the moment has a scan.

        `command` is the one in force. `touch`: where the running pattern may touch what is near.
        """


MODES: Mapping[str, Callable[[Platform], Arbiter]] = MappingProxyType(
    {
        "barrier": Barrier,
        "potential_field": PotentialField,
        "stop_zone": StopZone,
        "off": Off,
    }
)
"""How the arbiter of each mode is made."""


def make_arbiter(platform: Platform) -> Arbiter:
    """The mode that the platform's file names; ConfigError if there is none such."""
    mode = str(platform.protection.get("mode", "barrier"))
    if mode not in MODES:
        raise ConfigError(f"platform {platform.name}: {unknown('protection mode', mode, MODES)}")
    return MODES[mode](platform)
