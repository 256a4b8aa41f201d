"""Measures the delay of scans by stamps, where one clock stamps scan and odometry.

The least difference of arrival and stamp of odometry in the last second gives the offset between
the clock of the stamps and the robot's clock. The stamp of a scan is the time of its oldest ray, as
in ROS. Two delays cannot be measured: the delay of odometry itself, and a common delay of scan and
odometry that lasts for longer than a second.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import INFINITY
from swarmd.core.messages import DelayFigure
from swarmd.core.values import Scan, ScanSpec

if TYPE_CHECKING:
    from swarmd.core.values import Array

LONGEST_SHARED = 5.0
"""Seconds: a scan with a greater age by its stamp counts as stamped by another clock."""
MAX_LEAD = -0.05
"""Seconds: a scan with a lower age by its stamp counts as stamped by another clock."""

_STAMPS = 20  # scans: the delay is their third greatest age
_MIN_STAMPS = 5  # scans before stamps give a figure
# The lowest lags of odometry are kept for so many periods of so many s.
_PERIODS = 4
_PERIOD_TIME = 0.5
# s after a jump of the stamps until it is judged again whether scan and odometry share a clock.
_RESTART_TIME = 2.5
# s: if the lag changes by more from each period to the next, the clock is not real time.
_MAX_DRIFT = 0.005
# s by which odometry gets later at once, or earlier: its clock was set then.
_CLOCK_JUMP = 0.1
_MAX_AGE = LONGEST_SHARED
# s, the greatest age that is kept, so that a status can show the age after a clock was set.
_LONGEST_AGE = 1000.0
_MAX_LEAD = MAX_LEAD


@cython.cclass
class DelayByStamps:
    """The delay of one sensor's scans by stamps. Times in s."""

    offset: float  # the least arrival minus stamp of recent odometry; inf: none
    # True after a jump of the stamps, until it is known again whether scan and odometry share a
    # clock. Meanwhile a scan that seems late counts as late.
    is_restarting: bool
    _spec: ScanSpec
    _restart_ends: float
    _scan_count: int  # that came since the restart
    _stamp: float  # of the last reading of odometry
    _scan_stamp: float
    # Lags of odometry: its arrival minus its stamp.
    _lowest: float  # of this period
    _lowest_before: float  # of the two periods before it
    _period_ends: float  # the end of this period
    _drifts: bool  # the clock of odometry does not run at real time
    _minima: cython.double[4]  # of the last periods
    _period_count: int
    # Ages of the last scans, the oldest at `_oldest`; when the last one arrived.
    _ages: cython.double[20]
    _age_count: int
    _oldest: int
    _last_scan_at: float
    _is_shared: bool  # scan and odometry have one clock
    _reason_text: str  # why stamps give no delay
    _ages_of_rays: Array | None  # those of the last scan
    _lead: float  # of scans with these ages

    def __init__(self, spec: ScanSpec) -> None:
        self._spec = spec
        self._reason_text = "no odometry yet"
        self.offset = INFINITY
        self._lowest = INFINITY
        self._lowest_before = INFINITY
        self._restart_ends = -INFINITY
        self._stamp = -INFINITY
        self._scan_stamp = -INFINITY
        self._period_ends = -INFINITY
        self._lead = 0.0 if spec.sweep is None else 0.5 * spec.sweep.duration

    def check_indices(self) -> None:
        """ValueError unless its counts are of its arrays, for a serialised robot."""
        is_of_ages = 0 <= self._age_count <= _STAMPS and 0 <= self._oldest < _STAMPS
        if not (is_of_ages and 0 <= self._period_count <= _PERIODS):
            raise ValueError(
                f"{self._age_count} ages from {self._oldest}, {self._period_count} periods"
            )

    def read(self, stamp: float, now: float) -> bool:
        """Take in the stamp of a reading of odometry; True if its clock was set."""
        if stamp == self._stamp:
            return False
        lag = now - stamp
        is_set = stamp < self._stamp or lag < self.offset - _CLOCK_JUMP < INFINITY
        self._stamp = stamp
        if is_set:
            self._period_count = 0
            self._lowest = INFINITY
            self._lowest_before = INFINITY
            self._period_ends = now + _PERIOD_TIME
            self._drifts = False
            self._restart(now)
        elif now >= self._period_ends:
            self._end_period(now)
        self._lowest = min(lag, self._lowest)
        self.offset = min(self._lowest, self._lowest_before)
        return is_set

    def goes_back(self, stamp: float, now: float) -> bool:
        """Take in the stamp of a scan; true if its clock was set back."""
        is_back = stamp < self._scan_stamp
        self._scan_stamp = stamp
        if is_back:
            self._restart(now)
        return is_back

    def _restart(self, now: float) -> None:
        """Drop all ages, and judge the clocks again after _RESTART_TIME."""
        self._age_count = 0
        self._scan_count = 0
        self.is_restarting = True
        self._restart_ends = now + _RESTART_TIME

    def _end_period(self, now: float) -> None:
        """End a period of odometry: store its lowest lag, and begin the next period.

        A lag is the arrival minus the stamp of a reading. Sets `_lowest_before`, the lowest lag of
        the last two periods, and `_drifts`: the lowest lags of all periods rise or fall steadily,
        so the clock of odometry does not run at real time.
        """

        # 1. Appends the lowest lag; the oldest lag is dropped.
        if self._lowest < INFINITY:
            if self._period_count == _PERIODS:
                self._period_count -= 1
                for k in range(self._period_count):
                    self._minima[k] = self._minima[k + 1]
            self._minima[self._period_count] = self._lowest
            self._period_count += 1
        self._lowest = INFINITY
        self._period_ends = now + _PERIOD_TIME

        # 2. The lowest lag of the last two periods (inf: no period has had a reading so far).
        previous_lowest = self._lowest_before
        self._lowest_before = INFINITY
        for k in range(max(self._period_count - 2, 0), self._period_count):
            self._lowest_before = min(self._lowest_before, self._minima[k])
        # A jump: scan and odometry were late together, or their clock was set back. The ages of
        # the last scans are wrong then, since they were computed with `previous_lowest`.
        if previous_lowest + _CLOCK_JUMP < self._lowest_before < INFINITY:
            self._age_count = 0

        # 3. A clock that does not run at real time, such as the clock of a slow simulator.
        rise_count = 0
        fall_count = 0
        for k in range(1, self._period_count):
            change = self._minima[k] - self._minima[k - 1]
            rise_count += change > _MAX_DRIFT
            fall_count += change < -_MAX_DRIFT
        self._drifts = rise_count == _PERIODS - 1 or fall_count == _PERIODS - 1

    def take(self, scan: Scan, now: float) -> float:
        """Take in a scan that arrived at `now`; its delay in s, 0 if stamps do not give a delay."""
        if self.offset == INFINITY:
            return 0.0
        ages = scan.ages
        if ages is not self._ages_of_rays:  # usually the same object as in the last scan
            self._ages_of_rays = ages
            self._lead = lead(scan, self._spec)
        stamp = scan.stamp
        age = now - self.offset - stamp - self._lead
        self._scan_count += 1
        if self.is_restarting and now > self._restart_ends and self._scan_count > _MIN_STAMPS:
            self.is_restarting = False
            self._is_shared = False
        if self._drifts:
            self._forget("the stamps of odometry do not run at real time")
        elif age < _MAX_LEAD or (age > _MAX_AGE and not self._is_shared):
            self._forget(wrong_stamps(age, self._lead))
        else:
            self._store_age(min(max(age, 0.0), _LONGEST_AGE))
            self._last_scan_at = now
        if not self._is_shared and (self._age_count < _MIN_STAMPS or self._period_count < _PERIODS):
            return 0.0
        self._is_shared = self._age_count > 0
        return self._delay()

    def _store_age(self, age: float) -> None:
        """Keep the age of a scan, in place of the oldest one if the array is full."""
        if self._age_count < _STAMPS:
            self._ages[(self._oldest + self._age_count) % _STAMPS] = age
            self._age_count += 1
        else:
            self._ages[self._oldest] = age
            self._oldest = (self._oldest + 1) % _STAMPS

    def _delay(self) -> float:
        """The third-greatest age of the last scans, and at least the age of the last scan."""
        # The three greatest ages so far.
        first = -INFINITY
        second = -INFINITY
        third = -INFINITY
        age = 0.0
        for k in range(self._age_count):
            age = self._ages[(self._oldest + k) % _STAMPS]
            if age > first:
                third = second
                second = first
                first = age
            elif age > second:
                third = second
                second = age
            elif age > third:
                third = age
        if self._age_count < 3:
            third = second if self._age_count == 2 else first
        return max(third, age)

    def figure(self, now: float) -> DelayFigure:
        """The mean delay of the last scans with its standard deviation, or why there is none."""
        if not self._is_shared or not self._age_count:
            why = "too few scans yet" if self._age_count else self._reason_text
            return DelayFigure(method="stamps", text=why)
        ages = [self._ages[(self._oldest + k) % _STAMPS] for k in range(self._age_count)]
        return figure_of(ages, max(now - self._last_scan_at, 0.0))

    def _forget(self, why: str) -> None:
        self._age_count = 0
        self._is_shared = False
        self._reason_text = why


def delay_by_stamps(
    scans: Iterable[tuple[float, float]],
    odometries: Iterable[tuple[float, float]],
    scan: Scan | None,
    spec: ScanSpec,
) -> DelayFigure:
    """The delay of a few scans, from (arrival, stamp) pairs; `scan` is one of these scans."""
    offset = min((at - stamp for at, stamp in odometries), default=math.inf)
    ages = [at - offset - stamp for at, stamp in scans]
    if not ages or scan is None or offset == math.inf:
        return DelayFigure(method="stamps", text="no scan, or no odometry")
    ahead = lead(scan, spec)
    ages = [age - ahead for age in ages]
    if not MAX_LEAD <= min(ages) <= max(ages) <= LONGEST_SHARED:
        return DelayFigure(method="stamps", text=wrong_stamps(ages[len(ages) - 1], ahead))
    return figure_of(ages, 0.0)


def lead(scan: Scan, spec: ScanSpec) -> float:
    """The time in s from the stamp of a scan to its mean ray."""
    if scan.ages is None or not len(scan.ages):
        return 0.0 if spec.sweep is None else 0.5 * spec.sweep.duration
    return float(scan.ages.max() - scan.ages.mean())


def wrong_stamps(age: float, ahead: float) -> str:
    """Why stamps give no delay: text for a mean ray that seems `age` s old; `ahead` is `lead`."""
    if MAX_LEAD - ahead <= age < MAX_LEAD:
        return (
            f"scans are stamped {-age:.2g} s or more after their oldest ray, as at their"
            " publication, or their clock is ahead of that of odometry"
        )
    return f"scan and odometry have different clocks, {age:.3g} s apart"


def figure_of(ages: Collection[float], since: float) -> DelayFigure:
    """The mean delay by stamps, with its deviation; the last of `ages` is `since` s old."""
    mean = sum(ages) / len(ages)
    spread = math.sqrt(sum((age - mean) ** 2 for age in ages) / len(ages))
    mean = max(mean, 0.0)
    return DelayFigure(method="stamps", delay=mean, spread=spread, samples=len(ages), age=since)
