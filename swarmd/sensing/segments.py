"""Segments of a turn: checks and dates the rays that a lidar measures before its turn is whole.

A segment tells nothing about other rays, and a whole turn follows. So a segment that is in doubt is
ignored. Times in s, angles in rad.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from msgspec import Struct

from swarmd.core.values import Array, Scan, ScanSpec
from swarmd.sensing.angles import TURN

_MAX_RAY_AGE = 10.0  # s: more is garbage
_MAX_SWEEP = 0.5 * TURN  # rad from the first to the last ray of a segment
_LATEST = 1.25  # turns behind the last whole turn, within which the turn in progress ends
_ROUNDING = 1e-6  # s, of stamps
_MAX_STEPS = 3.0  # steps between two segments without a ray in between
_DISTINCT_RETURNS = 8  # a noisy sensor never gives this many equal returns twice
_KEPT_CHECKS = 16  # directions of segments
_REMEMBERED_TURNS = 2  # turns whose segments are compared with a new one


class ScanSegment(Struct, frozen=True, eq=False):
    """The rays of a segment in the order of their measurement.

    `ranges` (n,) in m as the driver gave them, `bearings` (n,) in rad in the base frame.
    """

    ranges: Array
    bearings: Array
    ages: Array  # (n,) s against the newest ray; they fall to 0
    age: float  # s of the newest ray on arrival
    # s from the ray before to the first ray; inf if rays between the two are missing
    gap: float


class SegmentCheck:
    """The turn in progress of one lidar: takes its segments in order."""

    def __init__(self, spec: ScanSpec) -> None:
        """Wait for a whole turn. `spec.sweep` must be given."""
        assert spec.sweep is not None
        self._sweep, self._ray_count = spec.sweep, len(spec.bearings)
        self._step = TURN / max(self._ray_count, 1)
        self._max_step = max(spec.max_gap, self._step) + 1e-9
        self._period = max(1.0 / spec.rate, spec.sweep.duration)
        self._is_noisy = spec.is_noisy
        # Bearings and ages that were checked, with the ages against the newest ray.
        self._checked = deque[tuple[Array, Array | None, Array]](maxlen=_KEPT_CHECKS)
        self._recent = deque[bytes](maxlen=max(_REMEMBERED_TURNS * spec.segments, 1))
        # The last whole turn: its number, and the stamp and the time of its newest ray. None: no
        # turn, or a turn that dates no segment.
        self._whole: tuple[int, float, float] | None = None
        # The turn in progress: its number (None before its first segment), and the stamp and the
        # bearing of its newest ray.
        self._seq: int | None = None
        self._newest_stamp, self._newest_bearing = -math.inf, 0.0

    def on_turn(self, scan: Scan, span: float, newest_at: float) -> None:
        """Take in a whole turn, whose newest ray was measured at `newest_at` on the robot's clock.

        `span`: s from its oldest ray, which has the stamp of the scan, to its newest ray.
        """
        self._whole = scan.seq, scan.stamp + span, newest_at
        self._seq, self._newest_stamp = None, scan.stamp + span
        self._newest_bearing = self._sweep.start - self._sweep.direction * self._step

    def forget(self) -> None:
        """Ignore segments until the next whole turn."""
        self._whole = None

    def take(self, scan: Scan, now: float, delay: float) -> ScanSegment | str | None:
        """The segment that arrived at `now`; else the reason to ignore the segment.

        None before the first whole turn, by which segments are dated. `delay`: s that the newest
        ray is old on arrival, by the platform's latency and the measured delay.
        """
        if self._whole is None:
            return None
        ranges, bearings = scan.ranges, scan.bearings
        count = len(ranges) if ranges.ndim == 1 else 0
        if not 0 < count <= self._ray_count or bearings.shape != (count,):
            return f"{count} ranges, {bearings.size} bearings and {self._ray_count} rays of a turn"
        ages = self._ages(bearings, scan.ages)
        if isinstance(ages, str):
            return ages
        newest_stamp = scan.stamp + float(ages[0])  # ages[0]: s from the first to the newest ray
        if fault := self._order_fault(scan, newest_stamp):
            return fault
        _, end_stamp, end_at = self._whole
        newest_at = end_at + newest_stamp - end_stamp  # on the robot's clock, by the whole turn
        age = max(delay, now - newest_at)
        if not age <= self._period:  # true also for NaN
            return f"it arrived {age:.2f} s late"
        if self._is_frozen(ranges):
            return "its ranges are those of a segment before"
        gap = self._gap(scan.stamp, float(bearings[0]))
        self._seq, self._newest_stamp = scan.seq, newest_stamp
        self._newest_bearing = float(bearings[-1])
        return ScanSegment(ranges, bearings, ages, age, gap)

    def _order_fault(self, scan: Scan, newest_stamp: float) -> str:
        """Why a segment cannot follow the rays so far; empty if it can.

        `newest_stamp`: s, of its newest ray. Each comparison also refuses a NaN.
        """
        assert self._whole is not None
        whole_seq, end_stamp, _ = self._whole
        is_of_turn = self._seq is None or scan.seq == self._seq
        if not (scan.seq > whole_seq and is_of_turn):
            return f"it belongs to turn {scan.seq}, and the last whole turn is {whole_seq}"
        if not scan.stamp >= self._newest_stamp - _ROUNDING:
            return "its stamp is older than a ray before"
        if not newest_stamp <= end_stamp + _LATEST * self._period:
            return "its stamp is more than a turn after the last whole turn"
        return ""

    def _gap(self, stamp: float, bearing: float) -> float:
        """Seconds from the newest ray so far to the first ray of the next segment.

        `stamp`, `bearing`: s and rad, of the first ray. inf if rays between the two are missing.
        """
        turned = self._sweep.direction * (bearing - self._newest_bearing)
        step = math.remainder(turned, TURN)
        is_next = -self._step <= step <= _MAX_STEPS * self._step
        return max(stamp - self._newest_stamp, 0.0) if is_next else math.inf

    def _steps(self, differences: Array) -> Array:
        """(k,) the differences of bearings in the direction of the sweep, from -pi to pi."""
        steps: Array = (self._sweep.direction * differences + math.pi) % TURN - math.pi
        return steps

    def _ages(self, bearings: Array, given: Array | None) -> Array | str:
        """(n,) s by which each ray is older than the newest ray; or the fault of the arrays.

        `given`: (n,) s, the ages by the driver; None if the platform's sweep gives the ages. A
        lidar measures the same directions in each turn: arrays that nothing can change are checked
        once, and their ages are kept.
        """
        for kept_bearings, kept_given, kept_ages in self._checked:
            if kept_bearings is bearings and kept_given is given:
                return kept_ages
        if not np.isfinite(bearings).all():
            return "a bearing is not finite"
        steps = self._steps(np.diff(bearings))
        if fault := self._bearing_fault(steps) or _age_fault(given, len(bearings)):
            return fault
        if given is None:
            s_per_rad = self._sweep.duration / TURN
            ages = np.append(s_per_rad * np.cumsum(steps[::-1])[::-1], 0.0)
        else:
            ages = given - given[-1]
        if not (bearings.flags.writeable or (given is not None and given.flags.writeable)):
            self._checked.append((bearings, given, ages))
        return ages

    def _bearing_fault(self, steps: Array) -> str:
        """Why bearings, with `steps` (k,) rad between them, are no part of a sweep; else empty."""
        if steps.sum() > _MAX_SWEEP or not (steps > 0.0).all():
            return "its bearings do not follow the sweep"
        if steps.max(initial=0.0) > self._max_step:
            return f"no ray for {math.degrees(steps.max()):.0f} degrees"
        return ""

    def _is_frozen(self, ranges: Array) -> bool:
        """Store a segment's ranges; True if a noisy sensor gave them in a recent segment, too."""
        raw = ranges.tobytes()
        is_repeat = raw in self._recent
        self._recent.append(raw)
        if not (is_repeat and self._is_noisy):
            return False
        return int(np.count_nonzero(np.isfinite(ranges) & (ranges != 0.0))) >= _DISTINCT_RETURNS


def _age_fault(given: Array | None, count: int) -> str:
    """Why the ages that a driver gives `count` rays are not valid; empty if valid or None."""
    if given is None:
        return ""
    if given.shape != (count,) or not ((given >= 0.0) & (given <= _MAX_RAY_AGE)).all():
        return f"an age of a ray is not within 0 to {_MAX_RAY_AGE:g} s"
    return "" if (np.diff(given) <= 0.0).all() else "its ages do not fall"
