"""Simulated batteries: the charge falls evenly with time, also at rest, and stays at 0.

A robot with a battery has `body: {battery_time: ..., battery_start: ...}`: s from full to empty,
and its charge at time 0 (default 1). The charge is a reading; an empty battery stops nothing.
"""

from __future__ import annotations

from collections.abc import Mapping

from swarmd.core.low_battery import READING
from swarmd.core.values import Platform


def has_battery(platform: Platform) -> bool:
    """True if robots of this platform have a reading of their charge."""
    return platform.body.get("battery_time", 0.0) > 0.0


def charge(platform: Platform, now: float) -> Mapping[str, float]:
    """The reading of the charge, a share 0 to 1, at `now` in s; empty without a battery."""
    if not has_battery(platform):
        return {}
    left = platform.body.get("battery_start", 1.0) - now / platform.body["battery_time"]
    return {READING: min(max(left, 0.0), 1.0)}
