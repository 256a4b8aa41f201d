"""Conditioning: gives the scans of every driver one meaning, or rejects them.

A conditioned range is a distance within [range_min, range_max], +inf (no return) or -inf (too close
to measure). No ray is unknown.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from swarmd.core.kernels import load_kernel
from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Array, Odometry, Scan, ScanSpec
from swarmd.sensing.blind_sector import BlindSectors

MAX_REPEATS = 3  # repeats of a noisy sensor after which its scan counts as frozen
COMPARED_SCANS = 4  # with which a repeat is compared: a driver may resend any of its buffers
MIN_DISTINCT_RETURNS = 8  # a noisy sensor never gives this many equal returns twice
RESTART_SCANS = 3  # scans in order after which a lower sequence or stamp counts as a restart
MAX_AGE = 10.0  # s of a ray: more is garbage
MOVES_LINEAR = 0.02  # m/s above which the robot counts as moving
MOVES_ANGULAR = 0.05  # rad/s


class ScanConditioner:
    """Conditions the scans of one sensor; fills unknown rays from a short memory of each ray.

    The memory turns against the sensor, as far as odometry is available.

    `take` returns the conditioned scan or the reason to reject it. INVALID_SCAN: lengths differ, no
    rays, a stamp that is not finite, an impossible age of a ray, fewer than half of the rays known,
    an unknown sector wider than `max_gap`, such a sector without rays (unless the sensor never has
    rays there), or no return at all after a scan with many far returns. FROZEN_SCAN: stamp or
    sequence does not rise, or a noisy sensor sends bit-identical scans.

    `known_at` is the time in s to which the last returned scan is valid: its arrival, unless a
    sector wider than `max_gap` comes from the memory, or the scan repeats an earlier one.
    """

    def __init__(self, spec: ScanSpec, *, guesses_near: bool = True) -> None:
        """`guesses_near`: a zero of an LDS beside a near ray counts as too close."""
        self._spec = spec
        self._max_sector = max(spec.max_gap, _widest_between_rays(spec.bearings)) + 1e-9
        self._bearings = np.empty(0)  # the last valid ones
        self._ages: Array | None = None
        self._blind = BlindSectors(spec)
        kernel = load_kernel("swarmd.sensing.scans")
        self._rays = kernel.RayMemory(spec, guesses_near=guesses_near)
        self._last: Scan | None = None
        self._newest = (-math.inf, -math.inf)  # sequence and stamp
        self._in_order = 0
        self._recent: deque[bytes] = deque(maxlen=COMPARED_SCANS)
        self._identical = 0

    @property
    def known_at(self) -> float:
        """The time in s to which the last returned scan is valid."""
        known_at: float = self._rays.known_at
        return known_at

    @property
    def blind_text(self) -> str:
        """The blind sectors of the sensor, whose rays count as unknown; empty without one."""
        return self._blind.text

    def take(self, scan: Scan, odometry: Odometry | None, now: float) -> Scan | Reason:
        """Condition one scan that arrived at `now` (s on this machine's clock)."""
        if scan.ranges.ndim != 1 or len(scan.ranges) == 0:
            return Reason.INVALID_SCAN
        if scan.ranges.shape != scan.bearings.shape or not math.isfinite(scan.stamp):
            return Reason.INVALID_SCAN
        if scan.bearings is not self._bearings and not self._has_no_gap(scan.bearings):
            return Reason.INVALID_SCAN
        if not self._has_ages(scan):
            return Reason.INVALID_SCAN
        if not self._is_newer(scan):
            return Reason.FROZEN_SCAN
        if self._repeats(scan, odometry):
            now = self.known_at  # a repeat holds nothing new
            if self._identical >= MAX_REPEATS:
                return Reason.FROZEN_SCAN
        yaw = math.nan if odometry is None else odometry.pose.yaw
        raw = self._blind.take(scan.ranges, self._bearings, odometry, now)
        ranges: Array | None = self._rays.condition(raw, self._bearings, yaw, now)
        if ranges is None:
            return Reason.INVALID_SCAN
        ranges.flags.writeable = False  # the memory and an inline pattern share it
        spec = self._spec
        return Scan(
            *(scan.seq, scan.stamp, ranges, self._bearings, spec.range_min, spec.range_max),
            *(self._ages, spec.latency),
        )

    def _has_no_gap(self, bearings: Array) -> bool:
        """True if no sector lacks rays; keeps the bearings.

        A copy, if a driver may write others to the same array: all that follows takes the same
        object for the same bearings.
        """
        if not np.array_equal(bearings, self._bearings):
            if not np.isfinite(bearings).all() or _widest_between_rays(bearings) > self._max_sector:
                return False
            if bearings.flags.writeable or not bearings.flags.owndata:
                bearings = np.array(bearings, np.float64)
                bearings.flags.writeable = False
            self._bearings = bearings
        return True

    def _has_ages(self, scan: Scan) -> bool:
        """True if each ray has a possible age, or none has one; keeps a copy of the ages."""
        ages = scan.ages
        if ages is not None and ages is not self._ages:
            if ages.shape != scan.ranges.shape or not ((ages >= 0.0) & (ages <= MAX_AGE)).all():
                return False
            if self._ages is not None and np.array_equal(ages, self._ages):
                return True
            if ages.flags.writeable or not ages.flags.owndata:
                ages = np.array(ages, np.float64)
                ages.flags.writeable = False
        self._ages = ages
        return ages is None or len(ages) == len(scan.ranges)

    def _is_newer(self, scan: Scan) -> bool:
        """True if the scan is newer than every scan before, or the sensor has restarted.

        A restart shows in consecutive scans whose numbers and stamps rise again. Keeps the scan.
        """
        last, self._last = self._last, scan
        if not (scan.seq > self._newest[0] and scan.stamp > self._newest[1]):
            is_next = last is not None and scan.seq > last.seq and scan.stamp > last.stamp
            self._in_order = self._in_order + 1 if is_next else 0
            if self._in_order < RESTART_SCANS:
                return False
        self._in_order, self._newest = 0, (scan.seq, scan.stamp)
        return True

    def _repeats(self, scan: Scan, odometry: Odometry | None) -> bool:
        """True if a noisy sensor sends the same ranges again.

        With hardly any return a repeat is possible, unless the robot moves.
        """
        if not self._spec.is_noisy:
            return False
        raw = scan.ranges.tobytes()
        if raw not in self._recent:
            self._recent.append(raw)
            self._identical = 0
            return False
        returns = int(np.count_nonzero(np.isfinite(scan.ranges) & (scan.ranges != 0.0)))
        twist = ZERO if odometry is None else odometry.twist
        is_moving = max(abs(twist.linear), abs(twist.lateral)) > MOVES_LINEAR
        is_moving |= abs(twist.angular) > MOVES_ANGULAR
        repeats = returns >= (1 if is_moving else MIN_DISTINCT_RETURNS)
        self._identical += repeats
        return repeats


def _widest_between_rays(bearings: Array) -> float:
    """The widest angle in rad between neighbouring rays; a full turn for a single ray."""
    turn = 2.0 * math.pi
    rising = np.sort(bearings % turn)
    return float(np.diff(rising, append=rising[0] + turn).max())
