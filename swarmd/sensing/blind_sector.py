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
from numpy.typing import NDArray

from swarmd.core.values import Array, Odometry, ScanSpec

SECTORS = 90
"""Sectors of 4 degrees, of the sensor and of the directions around it."""

MISSED = 8
"""Directions, each a sector wide, in which a blind sector has missed something."""

_WIDTH = 2.0 * math.pi / SECTORS
_PERIOD = 0.95  # s between two looks, at least: a look takes longer than the rest of conditioning
_MAX_TIME = 15.0  # s for which what is seen counts as static
_MAX_MOTION = 0.25  # of the range by which the robot may move: things change their direction
_LIKE = 0.25  # of the range by which a thing may seem to move, and
_LIKE_M = 0.1  # m
_STREAK = 3  # looks in a row in which a static thing is seen, before and after it is missed
_CLEARING = 3  # scans in a row with a return, after which a blind sector is trusted again

Mask = NDArray[np.bool_]


class BlindSectors:
    """Finds the blind sectors of one sensor. Times in s, poses in the odometry frame.

    `text` names the blind sectors; empty without one.
    """

    def __init__(self, spec: ScanSpec) -> None:
        self._spec = spec
        self._is_used = len(spec.bearings) >= SECTORS
        self._bearings = np.empty(0)
        self._sector = np.empty(0, np.intp)  # of each ray
        self._is_blind = np.zeros(SECTORS, np.bool_)
        self._returns = np.zeros(SECTORS, np.intp)  # scans in a row with a return
        self._returned_at = np.full(SECTORS, math.nan)
        # By direction: the thing last seen there, and the sectors that have missed it since.
        self._range = np.zeros(SECTORS)
        self._place = np.zeros((2, SECTORS))
        self._streak = np.zeros(SECTORS, np.intp)  # looks in a row in which it was seen
        self._seen_at = np.full(SECTORS, -math.inf)
        self._pending: dict[int, set[int]] = {}
        self._missed: dict[int, set[int]] = {}  # by sector: the directions in which it has missed
        self._looked_at = -math.inf
        self._yaw = math.nan
        self.text = ""

    def take(self, ranges: Array, bearings: Array, odometry: Odometry | None, now: float) -> Array:
        """The raw ranges (n,) of a scan, with NaN for rays of blind sectors without a return."""
        is_due = self._is_used and odometry is not None and self._is_due(odometry, now)
        if not (is_due or self.text):
            return ranges
        if bearings is not self._bearings:
            self._bearings, self._sector = bearings, _sectors(bearings)
        is_return = (ranges > 0.0) & (ranges <= self._spec.range_max) | (ranges == -np.inf)
        if self._spec.zero == "too_close":
            is_return |= ranges == 0.0
        returned = np.bincount(self._sector[is_return], minlength=SECTORS) > 0
        self._returned_at[returned | np.isnan(self._returned_at)] = now
        self._returns = np.where(returned, self._returns + 1, 0)
        was_blind = self._is_blind
        self._is_blind = was_blind & (self._returns < _CLEARING)
        if is_due and odometry is not None:
            self._look(ranges, is_return, returned, odometry, now)
        if not np.array_equal(was_blind, self._is_blind):
            self.text = self._text(now)
        if not self.text:
            return ranges
        is_unknown = self._is_blind[self._sector] & ~is_return
        return np.where(is_unknown, np.nan, ranges) if is_unknown.any() else ranges

    def _is_due(self, odometry: Odometry, now: float) -> bool:
        """True once the robot has turned by a sector since the last look."""
        turned = abs(math.remainder(odometry.pose.yaw - self._yaw, 2.0 * math.pi))
        if now - self._looked_at < _PERIOD or turned < _WIDTH:
            return False
        self._looked_at, self._yaw = now, odometry.pose.yaw
        return True

    def _look(
        self, ranges: Array, is_return: Mask, returned: Mask, odometry: Odometry, now: float
    ) -> None:
        """Compare what each ray returns with what others returned in its direction."""
        pose = odometry.pose
        silent = set(np.flatnonzero(~returned).tolist())
        self._missed = {one: some for one, some in self._missed.items() if one in silent}
        self._pending = {one: some & silent for one, some in self._pending.items()}
        direction = _sectors(self._bearings + pose.yaw)
        rays = np.bincount(direction, minlength=SECTORS)
        hits = np.bincount(direction[is_return], minlength=SECTORS)
        distances = np.maximum(ranges[is_return], self._spec.range_min)
        sums = np.bincount(direction[is_return], weights=distances, minlength=SECTORS)
        is_seen = (hits == rays) & (rays > 0)
        seen = sums / np.maximum(hits, 1)
        x, y = self._place
        is_known = now - self._seen_at <= _MAX_TIME
        is_known &= np.hypot(pose.x - x, pose.y - y) <= _MAX_MOTION * self._range
        is_like = is_seen & (np.abs(seen - self._range) <= _LIKE_M + _LIKE * self._range)
        self._streak = np.where(is_like, self._streak + 1, is_seen)
        is_static = is_known & (self._streak >= _STREAK)
        is_over = is_static | ~is_known | (is_seen & ~is_like)
        for one in [one for one in self._pending if is_over[one]]:
            sectors = self._pending.pop(one)
            for sector in sectors if is_static[one] else ():
                self._missed.setdefault(sector, set()).add(one)
        self._seen_at[self._streak >= _STREAK] = now
        renewed = is_seen & (~is_like | (self._streak >= _STREAK))
        self._range[renewed] = seen[renewed]
        self._place[:, renewed] = np.array(((pose.x,), (pose.y,)))
        self._seen_at[is_seen & ~is_like] = -math.inf
        missing = np.flatnonzero((is_known & (hits == 0))[direction] & ~returned[self._sector])
        missed = direction[missing].tolist(), self._sector[missing].tolist()
        for one, sector in zip(*missed, strict=True):
            self._pending.setdefault(one, set()).add(sector)
        self._is_blind[[one for one, some in self._missed.items() if len(some) >= MISSED]] = True

    def _text(self, now: float) -> str:
        """The blind sectors in degrees, and since when."""
        if not self._is_blind.any():
            return ""
        start = int(self._is_blind.argmin())  # one that is not blind, so that none wraps around
        blind = np.roll(self._is_blind, -start)
        edges = np.flatnonzero(np.diff(np.concatenate(([False], blind, [False])).astype(np.int8)))
        width = 360 // SECTORS
        names = [
            f"{(first + start) * width % 360}..{(end + start) * width % 360}"
            for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
        ]
        since = now - float(self._returned_at[self._is_blind].max())
        return (
            f"rays {', '.join(names)} deg have not returned anything for {since:.0f} s while others"
            " did: they count as unknown; clean or uncover the sensor"
        )


def _sectors(angles: Array) -> NDArray[np.intp]:
    """The sector (n,) of each angle in rad."""
    return np.floor(angles * (1.0 / _WIDTH) + 1e-6).astype(np.intp) % SECTORS
