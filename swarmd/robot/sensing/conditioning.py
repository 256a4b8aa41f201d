"""Conditioning: gives the scans of every driver one meaning, or rejects them.

A conditioned range is a distance within [range_min, range_max], +inf (no return) or -inf (too close
to measure). A conditioned scan has no unknown ray (NaN): an unknown ray is filled from memory, or
the scan is rejected.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import view_of
from swarmd.core.cython_shadow import INFINITY, NAN, Doubles, isfinite
from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Array, Odometry, Scan, ScanSpec
from swarmd.robot.sensing.blind_sector import BlindSectors
from swarmd.robot.sensing.ray_memory import RayMemory

MAX_REPEATS = 3  # repeats of a noisy sensor after which its scan counts as frozen
COMPARED_SCANS = 4  # with which a repeat is compared: a driver may resend any of its buffers
MIN_DISTINCT_RETURNS = 8  # a noisy sensor never gives this many equal returns twice

# Scans in order after which a lower sequence or stamp counts as a restart.
_RESTART_SCANS = 3
_MAX_RAY_AGE = 10.0  # s: more is garbage
_MOVES_LINEAR = 0.02  # m/s above which the robot counts as moving
_MOVES_ANGULAR = 0.05  # rad/s
# s within which a driver knows of a second source of scans; behind a bridge of ROS 0.6 to 1.7 s.
_NOTICE = 4.0


@cython.cclass
class ScanConditioner:
    """Conditions the scans of one sensor; fills unknown rays from a short memory of each ray.

    When the robot turns by odometry, the memory turns back and so stays with the surroundings.

    `take` returns the conditioned scan or the reason to reject the scan:

    - INVALID_SCAN: lengths differ, no rays, a stamp that is not finite, or an impossible age of a
      ray
    - INVALID_SCAN: fewer than half of the rays known, or a sector wider than `max_gap` with unknown
      rays alone, or a sector without rays that is wider than `max_gap` and than every sector
      without rays of the platform
    - INVALID_SCAN: no return at all after a scan with many far returns
    - FROZEN_SCAN: the sequence number does not rise, or stamp and ranges are those of the scan
      before, or a noisy sensor sends bit-identical ranges again and again
    - FROZEN_STAMP: a new sequence number and other ranges, but the stamp of the scan before
    - CLOCK_SET: a new sequence number, but a stamp below an earlier stamp
    """

    _max_sector: float  # rad without rays
    _range_min: Any
    _range_max: Any
    _latency: Any
    _is_noisy: bool
    _spec: ScanSpec
    _bearings: Array  # (n,) rad, of the last scan whose bearings were valid
    _ages: (
        Array | None
    )  # (n,) s, of the last scan whose ages were valid; None: the scan had no ages
    _blind: BlindSectors
    _rays: RayMemory
    # Ranges, number and stamp of the last scan; the greatest number and stamp so far.
    _last_ranges: Array
    _last_seq: Any
    _last_stamp: float
    _newest_seq: Any
    _newest_stamp: float
    _rising_scans: int  # scans that follow each other, below the greatest
    _recent_bytes: list[bytes]  # the bytes of the last different ranges
    _repeat_count: int  # repeats in a row
    _has_conflict: bool  # scans or odometry come from two sources
    # Blind sectors and far returns at `_kept_at`, and at least _NOTICE s before.
    _kept: tuple[Any, int]
    _kept_before: tuple[Any, int]
    _kept_at: float

    def __init__(self, spec: ScanSpec, *, guesses_near: bool = True) -> None:
        """`guesses_near`: a zero of an LDS beside a near ray counts as too close."""
        self._max_sector = max(spec.max_gap, widest_between_rays(spec.bearings)) + 1e-9
        self._range_min = spec.range_min
        self._range_max = spec.range_max
        self._latency = spec.latency
        self._is_noisy = spec.is_noisy
        self._spec = spec
        self._bearings = np.empty(0)
        self._recent_bytes = []
        self._blind = BlindSectors(spec)
        self._rays = RayMemory(spec, guesses_near=guesses_near)
        self._last_seq = -INFINITY
        self._newest_seq = -INFINITY
        self._last_stamp = -INFINITY
        self._newest_stamp = -INFINITY
        self._kept = self._kept_before = (self._blind.kinds.copy(), 0)
        self._kept_at = -INFINITY

    @property
    def known_at(self) -> float:
        """The time in s at which the data of the last returned scan were known.

        This is the arrival of the scan, or an earlier time if the scan repeats an earlier scan, or
        if the memory of the rays has filled a sector wider than `max_gap`.
        """
        return self._rays.known_at

    @property
    def blind_text(self) -> str:
        """The blind sectors of the sensor, whose rays count as unknown; empty without one."""
        return self._blind.text

    def on_blocked(self, bearing: float, now: float) -> None:
        """Doubt rays without a return in a direction (rad) into which the base does not move."""
        self._blind.on_blocked(bearing, now)

    def forget_motion(self) -> None:
        """Forget what is compared by the motion of the robot, as when odometry was reset.

        The memory of rays still turns by the yaw: a base may turn faster than its twist says.
        """
        self._blind.forget_motion()

    def on_new_run(self, now: float) -> None:
        """End the doubts of `on_blocked`."""
        self._blind.on_new_run(now)

    def on_conflict(self, has_conflict: bool, now: float) -> None:
        """Scans or odometry come from two sources from now on, or no longer.

        Meanwhile no sector becomes blind, and none returns. As the driver learns late of a second
        source, the blind sectors and the far returns are again those of 4 to 8 s before.
        """
        self._has_conflict = has_conflict
        kinds, self._rays.far_returns = self._kept_before
        if has_conflict:
            self._blind.restore(kinds, now)
        self._kept = self._kept_before
        self._kept_at = now

    def take(self, scan: Scan, odometry: Odometry | None, now: float) -> Scan | Reason:
        """Condition a scan; return the conditioned scan, or the reason to reject the scan.

        `scan`: the raw scan of the driver. `odometry`: the last reading; None without a reading.
        `now`: s on this machine's clock, the arrival of the scan.
        """
        stamp = scan.stamp
        # `_has_form` also stores the scan's bearings and ages, as `_bearings` and `_ages`.
        if not isfinite(stamp) or not self._has_form(scan):
            return Reason.INVALID_SCAN
        reason = self._not_newer(scan.seq, stamp, scan.ranges)
        if reason is not None:
            return reason

        # A frozen sensor sends the same ranges again and again. With noise (`_is_noisy`) an exact
        # repeat is implausible for a sensor that measures. `_is_repeat` also counts the repeats in
        # `_repeat_count`.
        ranges = np.array(scan.ranges, np.float64)  # a copy, which the steps below change
        values: Doubles = view_of(ranges)  # the same numbers as a buffer
        measured_at = now
        if self._is_noisy and self._is_repeat(ranges, values, odometry):
            if self._repeat_count >= MAX_REPEATS:
                return Reason.FROZEN_SCAN
            measured_at = self._rays.known_at  # a repeat has no new data

        yaw = NAN
        if odometry is not None:
            yaw = odometry.pose.yaw
        # Both steps write into `values`, and so into `ranges`: `mark` makes rays of blind sectors
        # unknown (NaN), and `interpret` replaces the raw ranges by conditioned ranges.
        if not self._has_conflict:
            self._blind.mark(values, self._bearings, odometry, measured_at)
            if now - self._kept_at >= _NOTICE:
                self._kept_before = self._kept
                self._kept = (self._blind.kinds.copy(), self._rays.far_returns)
                self._kept_at = now
        if self._spec.mask:
            ranges[self._spec.masked(self._bearings)] = NAN
        if not self._rays.interpret(values, self._bearings, yaw, measured_at):
            return Reason.INVALID_SCAN
        ranges.setflags(write=False)  # pattern and memory share the array
        limits = self._range_min, self._range_max
        filled = self._rays.filled
        if filled is not None:
            filled.setflags(write=False)
        bearings = self._bearings
        ages = self._ages
        latency = self._latency
        return Scan(scan.seq, stamp, ranges, bearings, *limits, ages, latency, filled)

    def _has_form(self, scan: Scan) -> bool:
        """Store the bearings and ages of a scan; False if lengths, bearings or ages are wrong."""
        ranges = scan.ranges
        bearings = scan.bearings
        if ranges.ndim != 1 or len(ranges) == 0:
            return False
        # The array of an earlier scan was checked with that scan.
        is_new = bearings is not self._bearings
        if is_new and (ranges.shape != bearings.shape or not self._takes_bearings(bearings)):
            return False
        n = len(ranges)
        return n == len(self._bearings) and self._takes_ages(scan.ages, n)

    def _takes_bearings(self, bearings: Array) -> bool:
        """Store the bearings as `_bearings`; False, and nothing is stored, if they are not valid.

        They are not valid if one is not finite, or if they leave a sector without rays. `_bearings`
        stays the same object while bearings have equal values, since later stages compare bearings
        by identity. It is a copy if the driver may write to the given array.
        """
        if not np.array_equal(bearings, self._bearings):
            if not np.isfinite(bearings).all() or widest_between_rays(bearings) > self._max_sector:
                return False
            if bearings.flags.writeable or not bearings.flags.owndata:
                bearings = np.array(bearings, np.float64)
                bearings.setflags(write=False)
            self._bearings = bearings
        return True

    def _takes_ages(self, ages: Array | None, n: int) -> bool:
        """Store the ages of `n` rays, or that no ray has one; False for a wrong number or age."""
        if ages is not None and ages is not self._ages:
            if ages.shape != (n,) or not ((ages >= 0.0) & (ages <= _MAX_RAY_AGE)).all():
                return False
            if self._ages is not None and np.array_equal(ages, self._ages):
                return True
            if ages.flags.writeable or not ages.flags.owndata:
                ages = np.array(ages, np.float64)
                ages.setflags(write=False)
        self._ages = ages
        return ages is None or len(ages) == n

    def _not_newer(self, seq: Any, stamp: float, ranges: Array) -> Reason | None:
        """Store number, stamp and ranges of a scan; the reason to reject it, or None.

        None: the scan is newer than all scans before. The reasons are FROZEN_SCAN, FROZEN_STAMP and
        CLOCK_SET (see the class). A sensor that was restarted has lower numbers and stamps: it is
        accepted once _RESTART_SCANS scans in a row have rising numbers and stamps again.
        """
        # Newer than the last scan; a number above all numbers so far.
        is_next = stamp > self._last_stamp and seq > self._last_seq
        has_same_stamp = stamp == self._last_stamp
        is_new_message = seq > self._newest_seq
        before = self._last_ranges
        self._last_ranges = ranges
        self._last_seq = seq
        self._last_stamp = stamp
        if not (stamp > self._newest_stamp and seq > self._newest_seq):
            self._rising_scans = self._rising_scans + 1 if is_next else 0
            if self._rising_scans < _RESTART_SCANS:
                if is_new_message and has_same_stamp and ranges.tobytes() != before.tobytes():
                    return Reason.FROZEN_STAMP
                if is_new_message and not has_same_stamp and stamp < self._newest_stamp:
                    return Reason.CLOCK_SET
                return Reason.FROZEN_SCAN
        self._rising_scans = 0
        self._newest_seq = seq
        self._newest_stamp = stamp
        return None

    def _is_repeat(self, ranges: Array, values: Doubles, odometry: Odometry | None) -> bool:
        """Count a repeat of a noisy sensor in `_repeat_count`; False if the scan is no repeat.

        A repeat has the ranges of one of the last COMPARED_SCANS different scans. A repeat with
        hardly any return is not counted, and gives False: it may come by chance if the robot
        stands. `ranges` and `values` (n,) m are the same array, as numpy array and as buffer.
        """
        # 1. New ranges.
        raw = ranges.tobytes()
        if raw not in self._recent_bytes:
            self._recent_bytes.append(raw)
            if len(self._recent_bytes) > COMPARED_SCANS:
                self._recent_bytes.pop(0)
            self._repeat_count = 0
            return False

        # 2. Repeated ranges count if the scan has enough returns.
        return_count = 0
        for i in range(len(values)):
            return_count += isfinite(values[i]) and values[i] != 0.0
        twist = ZERO if odometry is None else odometry.twist
        is_moving = (
            max(abs(twist.linear), abs(twist.lateral)) > _MOVES_LINEAR
            or abs(twist.angular) > _MOVES_ANGULAR
        )
        needed_returns = 1 if is_moving else MIN_DISTINCT_RETURNS
        if return_count < needed_returns:
            return False
        self._repeat_count += 1
        return True


def widest_between_rays(bearings: Array) -> float:
    """The widest angle in rad between neighbouring rays; a full turn for a single ray."""
    turn = 2.0 * math.pi
    rising = np.sort(bearings % turn)
    return float(np.diff(rising, append=rising[0] + turn).max())
