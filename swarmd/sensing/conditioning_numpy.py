"""The memory of each ray and the meaning of its range, with numpy: the reference of scan_kernel.

`conditioning.py` says what a conditioned range is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swarmd.core.angles import wrap
from swarmd.core.values import Array, ScanSpec
from swarmd.sensing.rays_numpy import nearest_bearings

BLIND_SHARE = 0.1  # of the rays: this many far returns do not vanish from one scan to the next
BLIND_RETURNS = 8  # fewer than this many far returns may vanish: those of a ring of few sensors
NEAR_MARGIN = 0.10  # m above range_min: an LDS ray this near may turn into a zero
NEAR_SECTOR = math.radians(3.0)  # beside a near ray in which zeros may mean near
NEAR_MEMORY = 1.0  # s for which a near ray explains zeros
PACKET_RAYS = 6  # rays that an LDS loses together

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


@dataclass(slots=True)
class _KnownRays:
    """Per ray: the last known range, when it was known, and when it was last near."""

    bearings: Array
    ranges: Array
    known_at: Array
    near_at: Array

    def at(self, bearings: Array, turned: float) -> _KnownRays:
        """The memory at other bearings, after the sensor has `turned` by that many rad.

        Each ray takes the memory of the nearest remembered ray.
        """
        if not turned and (bearings is self.bearings or np.array_equal(bearings, self.bearings)):
            return self
        if not len(self.bearings):
            return _blank(bearings)
        turn = 2.0 * math.pi
        nearest, off = nearest_bearings(self.bearings, (bearings + turned) % turn)
        too_far = off > 2.0 * turn / len(self.bearings)
        known_at = np.where(too_far, -np.inf, self.known_at[nearest])
        near_at = np.where(too_far, -np.inf, self.near_at[nearest])
        return _KnownRays(bearings, self.ranges[nearest], known_at, near_at)


def _blank(bearings: Array) -> _KnownRays:
    n = len(bearings)
    never = np.full(n, -np.inf)
    return _KnownRays(bearings, np.full(n, np.nan), never, never.copy())


class RayMemory:
    """The memory of each ray, and what it makes of a scan's ranges.

    `known_at`: see ScanConditioner.
    """

    def __init__(self, spec: ScanSpec, *, guesses_near: bool) -> None:
        self.known_at = -math.inf
        self._spec, self._guesses_near = spec, guesses_near
        self._memory = _blank(np.empty(0))
        self._far_returns = 0  # far returns in the last scan that had any return
        self._yaw = math.nan

    def condition(self, raw: Array, bearings: Array, yaw: float, now: float) -> Array | None:
        """The conditioned ranges (n,) of a scan; None if it is invalid.

        Bearings (n,) that are the same object as before are not looked at again. `yaw` of the
        robot in rad, NaN if unknown; `now` in s.
        """
        raw = np.asarray(raw, np.float64)  # float32 would round the limits that it is compared to
        if self._goes_blind(raw):
            return None
        memory = self._memory.at(bearings, self._turned(yaw))
        ranges = self._interpreted(raw, memory, now)
        unknown = np.isnan(ranges)
        count = int(np.count_nonzero(unknown))
        self._remember(raw, bearings, ranges, unknown if count else None, memory, now)
        if 2 * count > len(ranges):
            return None
        self.known_at = now
        if count:
            self.known_at = self._lost_since(raw, unknown, memory, now)
            is_recent = unknown & (memory.known_at >= now - self._spec.stale_after)
            ranges = np.where(is_recent, memory.ranges, ranges)
            if np.isnan(ranges).any():
                ranges = _bridge(ranges, bearings, self._spec.max_gap)
                if np.isnan(ranges).any():
                    return None
        return ranges

    def _turned(self, yaw: float) -> float:
        """The turn of the sensor since the last call, in whole rays; the remainder is kept."""
        turned = wrap(yaw - self._yaw)
        if not math.isfinite(turned):
            self._yaw = yaw
            return 0.0
        step = 2.0 * math.pi / len(self._spec.bearings)
        turned = step * round(turned / step)
        self._yaw += turned
        return turned

    def _goes_blind(self, raw: Array) -> bool:
        """True if the scan has no return although the last one with returns had many far ones.

        Then the sensor is blind; the robot has not reached an open field. An obstacle in the blind
        zone may hide everything else, but then its returns were near before.
        """
        spec = self._spec
        if ((raw > 0.0) & (raw <= spec.range_max) | (raw == -np.inf)).any():
            is_far = (raw > spec.range_min + NEAR_MARGIN) & (raw < 0.8 * spec.range_max)
            self._far_returns = int(np.count_nonzero(is_far))
            return False
        return self._far_returns >= max(BLIND_SHARE * len(raw), BLIND_RETURNS)

    def _lost_since(self, raw: Array, unknown: Mask, memory: _KnownRays, now: float) -> float:
        """The latest time from which on no sector wider than `max_gap` is unknown.

        A zero of an LDS counts as known: it may be a drop-out, and after `stale_after` it stands
        for no return.
        """
        is_lost = unknown & (raw != 0.0) if self._spec.zero == "lds" else unknown
        most = self._spec.max_gap + 1e-9
        if _widest(is_lost, memory.bearings) <= most:
            return now
        for time in np.unique(memory.known_at[is_lost])[::-1].tolist():
            if _widest(is_lost & (memory.known_at < time), memory.bearings) <= most:
                return float(time)
        return -math.inf

    def _interpreted(self, raw: Array, memory: _KnownRays, now: float) -> Array:
        """Each ray as +inf, -inf, NaN (unknown) or a distance within the sensor's range."""
        spec = self._spec
        ranges = np.array(raw, dtype=np.float64)
        odd = np.flatnonzero(~((raw >= spec.range_min) & (raw <= spec.range_max)))
        if not len(odd):
            return ranges
        values = ranges[odd]
        meanings = np.where(values > spec.range_max, np.inf, np.nan)
        meanings[(values > 0.0) & (values < spec.range_min) | (values == -np.inf)] = -np.inf
        is_zero = values == 0.0
        if is_zero.any():
            meanings[is_zero] = self._interpreted_zeros(odd[is_zero], memory, now)
        ranges[odd] = meanings
        return ranges

    def _interpreted_zeros(self, rays: Indices, memory: _KnownRays, now: float) -> Array:
        """The meaning of a range of exactly 0 for each of `rays`."""
        if self._spec.zero != "lds":
            meaning = {"too_close": -np.inf, "unknown": np.nan, "no_return": np.inf}
            return np.full(len(rays), meaning[self._spec.zero])
        since = now - NEAR_MEMORY if self._guesses_near else np.inf
        near = np.flatnonzero(memory.near_at >= since)
        was_near = _is_beside(memory.bearings[rays], memory.bearings[near])
        is_recent = memory.known_at[rays] >= now - self._spec.stale_after
        had_return = is_recent & np.isfinite(memory.ranges[rays])
        # A short run over recent returns is a lost packet; a near obstacle hides more rays.
        was_near &= ~(had_return & (_run_lengths(rays, len(memory.bearings)) <= PACKET_RAYS))
        return np.where(was_near, -np.inf, np.where(had_return, np.nan, np.inf))

    def _remember(
        self,
        raw: Array,
        bearings: Array,
        ranges: Array,
        unknown: Mask | None,
        memory: _KnownRays,
        now: float,
    ) -> None:
        """Store the known rays; `unknown` rays (None: all are known) keep their memory.

        A zero does not count as a near ray. Otherwise one passing obstacle would turn an open field
        into near returns, ray by ray and for good.
        """
        if unknown is None:
            kept, known_at = ranges, np.full(len(ranges), now)
        else:
            kept = np.where(unknown, memory.ranges, ranges)
            known_at = np.where(unknown, memory.known_at, now)
        is_near = ranges < self._spec.range_min + NEAR_MARGIN  # false where unknown
        is_near &= raw != 0.0
        near_at = np.where(is_near, now, memory.near_at) if is_near.any() else memory.near_at
        self._memory = _KnownRays(bearings, kept, known_at, near_at)


def _run_lengths(rays: Indices, n: int) -> Indices:
    """(k,) how many consecutive ray indices the run around each of `rays` (k,) has.

    `rays` ascend; ray n - 1 is beside ray 0.
    """
    starts = np.flatnonzero(np.diff(rays, prepend=-2) > 1)
    lengths = np.diff(starts, append=len(rays))
    if len(starts) > 1 and rays[0] == 0 and rays[-1] == n - 1:
        lengths[[0, -1]] = lengths[0] + lengths[-1]
    return np.repeat(lengths, np.diff(starts, append=len(rays)))


def _is_beside(bearings: Array, near: Array) -> Mask:
    """True for each of the bearings (k,) within NEAR_SECTOR of one of `near` (m,)."""
    if not len(near):
        return np.zeros(len(bearings), dtype=np.bool_)
    off = np.abs((bearings[:, None] - near + math.pi) % (2.0 * math.pi) - math.pi)
    return np.asarray(off.min(axis=1) <= NEAR_SECTOR + 1e-9)


def _widest(unknown: Mask, bearings: Array) -> float:
    """The widest unknown sector in rad, between known rays; 0 without unknown rays."""
    known = np.flatnonzero(~unknown)
    if not len(known):
        return math.inf
    before = np.flatnonzero(np.diff(known, append=known[0] + len(bearings)) > 1)
    if not len(before):
        return 0.0
    turn = 2.0 * math.pi
    direction = math.copysign(1.0, math.remainder(bearings[-1] - bearings[-2], turn))
    ends = bearings[known[(before + 1) % len(known)]]
    back = (direction * (bearings[known[before]] - ends)) % turn
    return float((turn - back).max())  # a full turn where a single ray is known


def _bridge(ranges: Array, bearings: Array, max_gap: float) -> Array:
    """The ranges with unknown sectors up to `max_gap` rad filled with the nearer edge."""
    unknown = np.isnan(ranges)
    if not unknown.any() or unknown.all():
        return ranges
    start = int(np.argmin(unknown))  # a known ray, so that no sector wraps around the end
    rolled = np.roll(ranges, -start)
    angles = np.unwrap(np.roll(bearings, -start))
    unknown = np.roll(unknown, -start)
    edges = np.diff(np.concatenate(([0], unknown.view(np.int8), [0])))
    direction = math.copysign(2.0 * math.pi, angles[-1] - angles[0])
    for begin, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        after = angles[end] if end < len(angles) else angles[0] + direction
        if abs(after - angles[begin - 1]) <= max_gap + 1e-9:
            rolled[begin:end] = min(rolled[begin - 1], rolled[end % len(rolled)])
    return np.roll(rolled, start)
