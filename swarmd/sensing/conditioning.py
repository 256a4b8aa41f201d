"""Conditioning: one function makes every driver's scan mean the same thing.

Afterwards a range is a distance within [range_min, range_max], +inf (nothing seen) or -inf (too
close to measure); no ray is unknown any more.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from swarmd.core.angles import wrap
from swarmd.core.messages import Reason
from swarmd.core.values import Array, Odometry, Scan, ScanSpec

FROZEN_AFTER = 3  # times that a noisy sensor repeats itself
RING = 4  # sweeps that it may repeat: drivers give what is in their buffers
TELLING = 8  # returns that a noisy sensor does not give twice, even of a scene that stands
RESTARTED_AFTER = 3  # sweeps in order: then one that counts from below has been started anew
DARK = 0.1  # of the rays: so many returns well within its range do not vanish from one sweep on
MOVES_LINEAR = 0.02
MOVES_ANGULAR = 0.05
NEAR_MARGIN = 0.10  # an LDS ray that was this close to range_min may vanish into a zero
NEAR_SECTOR = math.radians(3.0)
NEAR_MEMORY = 1.0
PACKET = 6  # rays that an LDS loses together

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


@dataclass(slots=True)
class _Memory:
    """Per direction: the last known range, when it was known, and when it was last near."""

    bearings: Array
    ranges: Array
    known_at: Array
    near_at: Array

    def at(self, bearings: Array, turned: float) -> _Memory:
        """The memory seen along other bearings by a sensor that has `turned` by that many rad.

        Each is that of the nearest remembered ray.
        """
        if not turned and (bearings is self.bearings or np.array_equal(bearings, self.bearings)):
            return self
        if not len(self.bearings):
            return _blank(bearings)
        turn = 2.0 * math.pi
        order = np.argsort(self.bearings % turn)
        sorted_bearings = (self.bearings % turn)[order]
        wanted = (bearings + turned) % turn
        right = np.searchsorted(sorted_bearings, wanted) % len(order)
        left = right - 1
        off_right = np.abs((sorted_bearings[right] - wanted + math.pi) % turn - math.pi)
        off_left = np.abs((sorted_bearings[left] - wanted + math.pi) % turn - math.pi)
        nearest = order[np.where(off_left < off_right, left, right)]
        too_far = np.minimum(off_left, off_right) > 2.0 * turn / len(order)
        known_at = np.where(too_far, -np.inf, self.known_at[nearest])
        near_at = np.where(too_far, -np.inf, self.near_at[nearest])
        return _Memory(bearings, self.ranges[nearest], known_at, near_at)


def _blank(bearings: Array) -> _Memory:
    n = len(bearings)
    never = np.full(n, -np.inf)
    return _Memory(bearings, np.full(n, np.nan), never, never.copy())


class ScanConditioner:
    """Conditions the scans of one sensor, remembering each ray for a moment.

    What it remembers stays where it was as the sensor turns, as far as odometry tells.

    `take` returns the conditioned scan, or the reason why this one is none: INVALID_SCAN (lengths
    differ, no rays, fewer than half known, a sector wider than `max_gap` unknown or, unless the
    sensor never has any there, without rays; nothing seen any more where much was in the sweep
    before) or FROZEN_SCAN (stamp or sequence does not rise; bit-identical scans of a noisy sensor).

    `known_at` is the time in s as of which the last scan it gave can be relied on: that of its
    arrival, unless a sector wider than `max_gap` is remembered in it from earlier, or it only
    repeats one that came before.
    """

    def __init__(self, spec: ScanSpec, *, guesses_near: bool = True) -> None:
        """`guesses_near`: zeros of an LDS beside what was near are taken for too close."""
        self.known_at = -math.inf
        self._spec, self._guesses_near = spec, guesses_near
        self._most = max(spec.max_gap, _widest_between(spec.bearings)) + 1e-9
        self._memory = _blank(np.empty(0))
        self._last: Scan | None = None
        self._newest = (-math.inf, -math.inf)  # sequence and stamp
        self._in_order = 0
        self._recent: deque[bytes] = deque(maxlen=RING)
        self._identical = 0
        self._far = 0  # returns well within its range, when it last saw anything
        self._yaw = math.nan

    def take(self, scan: Scan, odometry: Odometry | None, now: float) -> Scan | Reason:
        """Condition one scan that arrived at `now` (s on this machine's clock)."""
        if scan.ranges.ndim != 1 or len(scan.ranges) == 0:
            return Reason.INVALID_SCAN
        if scan.ranges.shape != scan.bearings.shape:
            return Reason.INVALID_SCAN
        is_known = scan.bearings is self._memory.bearings
        if not is_known and not self._looks_around(scan.bearings):
            return Reason.INVALID_SCAN
        if not self._follows(scan):
            return Reason.FROZEN_SCAN
        if self._repeats(scan, odometry):
            now = self.known_at  # it tells nothing new
            if self._identical >= FROZEN_AFTER:
                return Reason.FROZEN_SCAN
        if self._goes_dark(scan.ranges):
            return Reason.INVALID_SCAN
        memory = self._memory.at(scan.bearings, self._turned(odometry))
        ranges = self._meanings(scan.ranges, memory, now)
        unknown = np.isnan(ranges)
        count = int(np.count_nonzero(unknown))
        self._remember(scan, ranges, unknown if count else None, memory, now)
        if 2 * count > len(ranges):
            return Reason.INVALID_SCAN
        self.known_at = now
        if count:
            self.known_at = self._known_at(scan, unknown, memory, now)
            is_recent = unknown & (memory.known_at >= now - self._spec.stale_after)
            ranges = np.where(is_recent, memory.ranges, ranges)
            if np.isnan(ranges).any():
                ranges = _bridge(ranges, scan.bearings, self._spec.max_gap)
                if np.isnan(ranges).any():
                    return Reason.INVALID_SCAN
        spec = self._spec
        ranges.flags.writeable = False  # it is remembered, and an inline pattern shares it
        return Scan(scan.seq, scan.stamp, ranges, scan.bearings, spec.range_min, spec.range_max)

    def _turned(self, odometry: Odometry | None) -> float:
        """How far the sensor has turned since the memory was; in whole rays, the rest is kept."""
        yaw = math.nan if odometry is None else odometry.pose.yaw
        turned = wrap(yaw - self._yaw)
        if not math.isfinite(turned):
            self._yaw = yaw
            return 0.0
        step = 2.0 * math.pi / len(self._spec.bearings)
        turned = step * round(turned / step)
        self._yaw += turned
        return turned

    def _looks_around(self, bearings: Array) -> bool:
        """Whether rays go wherever this sensor has any: where none goes nothing would be seen."""
        return bool(np.isfinite(bearings).all()) and _widest_between(bearings) <= self._most

    def _follows(self, scan: Scan) -> bool:
        """Whether it was taken after all others; of a sensor that starts anew, after a few."""
        last, self._last = self._last, scan
        if not (scan.seq > self._newest[0] and scan.stamp > self._newest[1]):
            is_next = last is not None and scan.seq > last.seq and scan.stamp > last.stamp
            self._in_order = self._in_order + 1 if is_next else 0
            if self._in_order < RESTARTED_AFTER:
                return False
        self._in_order, self._newest = 0, (scan.seq, scan.stamp)
        return True

    def _repeats(self, scan: Scan, odometry: Odometry | None) -> bool:
        """Whether the same comes again of a noisy sensor, which cannot be.

        Where it sees next to nothing it can, unless it moves.
        """
        if not self._spec.is_noisy:
            return False
        raw = scan.ranges.tobytes()
        if raw not in self._recent:
            self._recent.append(raw)
            self._identical = 0
            return False
        returns = int(np.count_nonzero(np.isfinite(scan.ranges) & (scan.ranges != 0.0)))
        is_moving = odometry is not None and _moves(odometry)
        repeats = returns >= (1 if is_moving else TELLING)
        self._identical += repeats
        return repeats

    def _goes_dark(self, raw: Array) -> bool:
        """Whether it sees nothing since a sweep in which it saw much that was not near.

        That is a sensor that is blind, not an open field. What comes nearer than it can see may
        hide all the rest, but then that was near before.
        """
        spec = self._spec
        if ((raw > 0.0) & (raw <= spec.range_max) | (raw == -np.inf)).any():
            is_far = (raw > spec.range_min + NEAR_MARGIN) & (raw < 0.8 * spec.range_max)
            self._far = int(np.count_nonzero(is_far))
            return False
        return self._far >= DARK * len(raw)

    def _known_at(self, scan: Scan, unknown: Mask, memory: _Memory, now: float) -> float:
        """The latest time since when no sector wider than `max_gap` has gone unseen.

        A zero that an LDS gives counts as seen: it may be a drop-out, and once it has lasted for
        `stale_after` it means that nothing is there.
        """
        is_lost = unknown & (scan.ranges != 0.0) if self._spec.zero == "lds" else unknown
        most = self._spec.max_gap + 1e-9
        if _widest(is_lost, scan.bearings) <= most:
            return now
        for time in np.unique(memory.known_at[is_lost])[::-1].tolist():
            if _widest(is_lost & (memory.known_at < time), scan.bearings) <= most:
                return float(time)
        return -math.inf

    def _meanings(self, raw: Array, memory: _Memory, now: float) -> Array:
        """+inf, -inf, NaN or a distance within the sensor's range, for each ray."""
        spec = self._spec
        ranges = np.array(raw, dtype=np.float64)
        odd = np.flatnonzero(~((raw >= spec.range_min) & (raw <= spec.range_max)))
        if not len(odd):
            return ranges
        said = ranges[odd]
        means = np.where(said > spec.range_max, np.inf, np.nan)
        means[(said > 0.0) & (said < spec.range_min) | (said == -np.inf)] = -np.inf
        is_zero = said == 0.0
        if is_zero.any():
            means[is_zero] = self._zeros(odd[is_zero], memory, now)
        ranges[odd] = means
        return ranges

    def _zeros(self, rays: Indices, memory: _Memory, now: float) -> Array:
        """What a range of exactly 0 means, for each of `rays`."""
        if self._spec.zero != "lds":
            meaning = {"too_close": -np.inf, "unknown": np.nan, "no_return": np.inf}
            return np.full(len(rays), meaning[self._spec.zero])
        since = now - NEAR_MEMORY if self._guesses_near else np.inf
        near = np.flatnonzero(memory.near_at >= since)
        was_near = _is_beside(memory.bearings[rays], memory.bearings[near])
        is_recent = memory.known_at[rays] >= now - self._spec.stale_after
        had_return = is_recent & np.isfinite(memory.ranges[rays])
        # What is near hides more rays than a packet has; what was near in a lost one still is.
        was_near &= ~(had_return & (_run_lengths(rays, len(memory.bearings)) <= PACKET))
        return np.where(was_near, -np.inf, np.where(had_return, np.nan, np.inf))

    def _remember(
        self, scan: Scan, ranges: Array, unknown: Mask | None, memory: _Memory, now: float
    ) -> None:
        """Keep what is known; what is not (`unknown`, None: all is known) stays as it was.

        A zero does not renew what made it mean something near: else one passer-by would make an
        open field too close, ray by ray and for good.
        """
        if unknown is None:
            kept, known_at = ranges, np.full(len(ranges), now)
        else:
            kept = np.where(unknown, memory.ranges, ranges)
            known_at = np.where(unknown, memory.known_at, now)
        is_near = ranges < self._spec.range_min + NEAR_MARGIN  # false where unknown
        is_near &= scan.ranges != 0.0
        near_at = np.where(is_near, now, memory.near_at) if is_near.any() else memory.near_at
        self._memory = _Memory(scan.bearings, kept, known_at, near_at)


def _moves(odometry: Odometry) -> bool:
    twist = odometry.twist
    return (
        abs(twist.linear) > MOVES_LINEAR
        or abs(twist.lateral) > MOVES_LINEAR
        or abs(twist.angular) > MOVES_ANGULAR
    )


def _run_lengths(rays: Indices, n: int) -> Indices:
    """(k,) how many of the rising `rays` (k,) of n around are side by side with each."""
    starts = np.flatnonzero(np.diff(rays, prepend=-2) > 1)
    lengths = np.diff(starts, append=len(rays))
    if len(starts) > 1 and rays[0] == 0 and rays[-1] == n - 1:
        lengths[[0, -1]] = lengths[0] + lengths[-1]
    return np.repeat(lengths, np.diff(starts, append=len(rays)))


def _is_beside(bearings: Array, near: Array) -> Mask:
    """True for each of the bearings (k,) that is within NEAR_SECTOR of one of `near` (m,)."""
    if not len(near):
        return np.zeros(len(bearings), dtype=np.bool_)
    off = np.abs((bearings[:, None] - near + math.pi) % (2.0 * math.pi) - math.pi)
    return np.asarray(off.min(axis=1) <= NEAR_SECTOR + 1e-9)


def _widest_between(bearings: Array) -> float:
    """The widest sector in rad between two rays side by side; a full turn with a single one."""
    turn = 2.0 * math.pi
    rising = np.sort(bearings % turn)
    return float(np.diff(rising, append=rising[0] + turn).max())


def _widest(unknown: Mask, bearings: Array) -> float:
    """The widest unknown sector in rad, from known ray to known ray; 0 without one."""
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
    return float((turn - back).max())  # a full turn, not none, where a single ray is known


def _bridge(ranges: Array, bearings: Array, max_gap: float) -> Array:
    """Unknown sectors up to `max_gap` rad filled with the nearer of their edges."""
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
