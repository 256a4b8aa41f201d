"""Blind sectors: rays that return nothing although others return something in the same direction.

A covered or broken part of a range sensor looks like open space. While the robot turns, its rays
pass over the same things: where a static thing returns other rays before and after, a ray without a
return has missed it. A sector is blind once its rays have missed things in many directions and have
returned nothing meanwhile. An open field, a door and a surface that no ray sees give no return to
any ray; a thing that moves is not the same before and after; and one return clears its sector.
"""

from __future__ import annotations

import math

import numpy as np

from swarmd.core.kernels import load_kernel
from swarmd.core.values import Array, Odometry, ScanSpec

SECTORS = 90
"""Sectors of 4 degrees, of the sensor and of the directions around it."""

_PERIOD = 0.95  # s between two looks, at least


class BlindSectors:
    """Finds the blind sectors of one sensor. Times in s, poses in the odometry frame.

    `text` names the blind sectors; empty without one.
    """

    def __init__(self, spec: ScanSpec) -> None:
        self._is_used = len(spec.bearings) >= SECTORS
        self._sectors = load_kernel("swarmd.sensing.scans").SectorMemory(spec)
        self._looked_at = -math.inf
        self._yaw = math.nan
        self.text = ""

    def take(self, ranges: Array, bearings: Array, odometry: Odometry | None, now: float) -> Array:
        """The raw ranges (n,) of a scan, with NaN for rays of blind sectors without a return."""
        is_due = self._is_used and odometry is not None and self._is_due(odometry, now)
        if not (is_due or self.text):
            return ranges
        pose = odometry.pose if is_due and odometry is not None else None
        known: Array = self._sectors.take(ranges, bearings, pose, now)
        if self._sectors.has_changed:
            self.text = self._text(now)
        return known

    def _is_due(self, odometry: Odometry, now: float) -> bool:
        """True once the robot has turned by a sector since the last look."""
        turned = abs(math.remainder(odometry.pose.yaw - self._yaw, 2.0 * math.pi))
        if now - self._looked_at < _PERIOD or turned < 2.0 * math.pi / SECTORS:
            return False
        self._looked_at, self._yaw = now, odometry.pose.yaw
        return True

    def _text(self, now: float) -> str:
        """The blind sectors in degrees, and since when."""
        is_blind = self._sectors.is_blind
        if not is_blind.any():
            return ""
        start = int(is_blind.argmin())  # one that is not blind, so that none wraps around
        blind = np.roll(is_blind, -start)
        edges = np.flatnonzero(np.diff(np.concatenate(([False], blind, [False])).astype(np.int8)))
        width = 360 // SECTORS
        names = [
            f"{(first + start) * width % 360}..{(end + start) * width % 360}"
            for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
        ]
        since = now - float(self._sectors.returned_at[is_blind].max())
        return (
            f"rays {', '.join(names)} deg have not returned anything for {since:.0f} s while others"
            " did: they count as unknown; clean or uncover the sensor"
        )
