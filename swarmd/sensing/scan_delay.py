"""How late scans arrive: measured by the stamps of one clock, and by turns. Pure.

The delay of a scan is the mean age of its rays when it arrives. Two methods measure it:

- Stamps. Where scan and odometry are stamped by one clock, the fastest odometry of the last second
  tells the time of that clock. The stamp of a scan is the time of its oldest ray, as in ROS. The
  delay of odometry itself goes unnoticed, and so does one that both have for more than a second.
- Turns. The turn between two scans, by circular correlation of their ranges, is compared with the
  turn by odometry at candidate delays, in least squares with a free scale of the odometry. It needs
  a rate of turn that changes: at a constant rate all delays explain the turns alike, and then there
  is no figure. After the temporal calibration of sensors by correlated rotations (Rehder, Siegwart
  and Furgale, IEEE T-RO 2016), with one axis and a grid.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from swarmd.core.messages import DelayFigure, ScanDelaySummary
from swarmd.core.values import Array, Odometry, Pose, Scan, ScanSpec, Twist
from swarmd.sensing.measured_sweep import Headings, MeasuredSweep

TOLERANCE = 0.01
"""Seconds beyond the declared latency that count as none: the clocks of a tick resolve no less."""

_CLEARS = 0.8  # share of the bound below which a late scan counts as in time again
_WINDOW = 20  # scans of which the third-latest is the delay: one late scan counts for itself alone
_RANK = 3
_MIN_STAMPS = 5  # scans before stamps give a figure
_PERIOD = 0.5  # s of odometry whose lowest lag is kept
_RESTART_TIME = 2.5  # s after which stamps tell again whether scan and odometry share a clock
_MAX_DRIFT = 0.005  # s between periods: beyond it, three times one way, the clock is no real time
_SHIFT = 0.1  # s by which odometry gets later at once, or earlier: its clock was set then
_MAX_AGE = 5.0  # s: a scan that seems older has another clock
_LONGEST = 1000.0  # s: what a clock that was set shows at most, so that a status can tell it
_MAX_LEAD = -0.05  # s: as one that seems to come from the future

_CANDIDATES = np.linspace(0.0, 1.2, 49)  # s
_STEP = float(_CANDIDATES[1])
_HISTORY = 96  # headings
_SPACING = 0.02  # s between two of them, at least
_MIN_RATE_CHANGE = 0.15  # rad/s
_MIN_TURN_SPREAD = 0.06  # rad by which candidates must differ for a pair of scans to tell anything
_SEARCHED = 0.25  # rad by which the search for the turn goes beyond the turns of all candidates
_MAX_SEARCHED = 1.2  # rad; beyond it a square room looks like itself
_MAX_SHIFT = 0.03  # m between two scans: a shift of near things looks like a turn
_MIN_RAYS = 90
_MAX_RANGE = 6.0  # m; farther returns count as if they were there
_MIN_RELIEF = 0.1  # m, standard deviation of ranges below which a scene has no features
_MIN_LIKENESS = 0.6  # correlation of two scans at the turn found
_FORGETTING = 0.98  # of earlier pairs, for each new one: some 50 count
_MIN_PAIRS = 8
_MIN_SPREAD = 0.015  # rad of one measured turn
_ALIKE = 2.0  # factor on the spread, as errors of pairs are not independent: 1.7 in simulation
_CERTAIN = 2.5  # spreads by which turns must exceed declaration and stamps
_MAX_INTERVAL = 0.2  # s of candidates within three deviations: a wider one is no figure
_SCALES = 0.85, 1.15  # of odometry
_ENOUGH_PAIRS = 20  # after which only each fourth scan is compared with the one before it
_EXPIRES = 60.0  # s after which turns no longer say that scans are late


class ScanDelay:
    """Measures the delay of one sensor's scans. Times in s on the robot's clock.

    `added` is what protection counts beyond the declared latency: an upper estimate, at least the
    age of the last scan by its stamp; 0 within TOLERANCE of the declared one. `is_late`: it exceeds
    the platform's `max_scan_delay`, until it falls below 0.8 of that. `restarts` counts how often
    stamps jumped, so that the clock of odometry or scan was set: stamps then count anew, and what
    was added before is not taken back until they tell the delay again. `sweep`: None if the
    platform tells how the sensor measures its rays.
    """

    def __init__(self, spec: ScanSpec) -> None:
        self._latency, self._bound = spec.latency, spec.max_scan_delay
        self._stamps, self._turns = _Stamps(spec), _Turns()
        self.sweep = MeasuredSweep(spec) if spec.measures_sweep else None
        self.added = self._added_before = 0.0
        self.is_late = False
        self.restarts = 0

    def on_odometry(self, odometry: Odometry, now: float) -> None:
        """Take in a reading that arrived at `now`."""
        if self._stamps.on_odometry(odometry.stamp, now):
            self._restart()
        self._turns.on_odometry(odometry)

    def on_scan(self, scan: Scan, now: float) -> None:
        """Take in a raw scan that arrived at `now` and is valid."""
        offset, latency, bound = self._stamps.offset, self._latency, self._bound
        if self._stamps.goes_back(scan.stamp, now):
            self._restart()
        if self.sweep is not None:
            scan = self._swept(scan, now, offset)
        stamps = self._stamps.on_scan(scan, now)
        if offset < math.inf:
            self._turns.on_scan(scan, now - offset, now)
        turns = self._turns
        added = stamps - latency
        if self._stamps.is_restarting:
            added = max(added, self._added_before)
        known = max(latency, stamps) + TOLERANCE
        if turns.delay is not None and turns.delay - _CERTAIN * turns.spread > known:
            upper = turns.delay + turns.spread - latency
            if upper > bound and now - turns.at > _EXPIRES:
                turns.forget()  # a robot that is held cannot turn to measure anew
            else:
                added = max(added, upper)
        self.added = added if added > TOLERANCE else 0.0
        self.is_late = self.added > (_CLEARS * bound if self.is_late else bound)

    def _swept(self, scan: Scan, now: float, offset: float) -> Scan:
        """The scan with the ages that turns tell, if they do."""
        sweep, turns = self.sweep, self._turns
        assert sweep is not None
        headings = turns.headings()
        if offset < math.inf and len(headings.times):
            measured = self._stamps.figure(now).delay if turns.delay is None else turns.delay
            delay = self._latency if measured is None else measured
            before = sweep.order
            sweep.on_scan(scan, now - offset, delay, headings, turns.pose)
            if sweep.order != before:
                self._stamps.forget_scans()  # the time from a stamp to the mean ray is another one
        return scan if sweep.order is None else replace(scan, ages=sweep.ages(scan))

    def _restart(self) -> None:
        self.restarts += 1
        self._added_before = self.added
        self._turns.forget_headings()
        if self.sweep is not None:
            self.sweep.forget_scans()

    def summary(self, now: float) -> ScanDelaySummary:
        """The figures of both methods, for the status."""
        return ScanDelaySummary(
            declared=self._latency,
            added=self.added,
            bound=self._bound,
            figures=(self._stamps.figure(now), self._turns.figure(now)),
            sweep=None if self.sweep is None else self.sweep.figure(),
        )


def delay_by_stamps(
    scans: Iterable[tuple[float, float]],
    odometries: Iterable[tuple[float, float]],
    scan: Scan | None,
    spec: ScanSpec,
) -> DelayFigure:
    """The delay of a few scans, from arrivals and stamps; `scan` is one of them."""
    offset = min((at - stamp for at, stamp in odometries), default=math.inf)
    ages = [at - offset - stamp for at, stamp in scans]
    if not ages or scan is None or offset == math.inf:
        return DelayFigure(method="stamps", text="no scan, or no odometry")
    ages = [age - _lead(scan, spec) for age in ages]
    if not _MAX_LEAD <= min(ages) <= max(ages) <= _MAX_AGE:
        return DelayFigure(method="stamps", text=_other_clock(ages[-1]))
    return _figure(ages, 0.0)


def _lead(scan: Scan, spec: ScanSpec) -> float:
    """How much later than the stamp the mean ray was measured, in s."""
    if scan.ages is None or not len(scan.ages):
        return 0.0 if spec.sweep is None else 0.5 * spec.sweep.duration
    return float(scan.ages.max() - scan.ages.mean())


def _other_clock(age: float) -> str:
    return f"scan and odometry have different clocks, {age:.3g} s apart"


def _figure(ages: Collection[float], since: float) -> DelayFigure:
    mean = sum(ages) / len(ages)
    spread = math.sqrt(sum((age - mean) ** 2 for age in ages) / len(ages))
    mean = max(mean, 0.0)
    return DelayFigure(method="stamps", delay=mean, spread=spread, samples=len(ages), age=since)


class _Stamps:
    """Delays by stamps. `offset`: the least arrival minus stamp of recent odometry; inf: none.

    `is_restarting`: stamps jumped a moment ago, and whether scan and odometry share a clock is to
    be found out. Until then a scan that seems late counts as late.
    """

    def __init__(self, spec: ScanSpec) -> None:
        self._spec = spec
        self.offset = math.inf
        self.is_restarting = False
        self._restart_ends, self._scans = -math.inf, 0  # and how many came since the restart
        self._stamp = self._scan_stamp = -math.inf
        self._lowest, self._before, self._until = math.inf, math.inf, -math.inf
        self._drifts = False
        self._minima: deque[float] = deque(maxlen=4)
        self._ages: deque[float] = deque(maxlen=_WINDOW)
        self._at = 0.0
        self._is_shared = False
        self._why = "no odometry yet"
        self._ages_of_rays: Array | None = None
        self._lead = 0.0 if spec.sweep is None else 0.5 * spec.sweep.duration

    def on_odometry(self, stamp: float, now: float) -> bool:
        """Take in the stamp of a reading; true if its clock was set."""
        if stamp == self._stamp:
            return False
        lag = now - stamp
        is_set = stamp < self._stamp or lag < self.offset - _SHIFT < math.inf
        self._stamp = stamp
        if is_set:
            self._minima.clear()
            self._lowest = self._before = math.inf
            self._until = now + _PERIOD
            self._drifts = False
            self._restart(now)
        elif now >= self._until:
            self._end_period(now)
        if lag < self._lowest:
            self._lowest = lag
        self.offset = self._lowest if self._lowest < self._before else self._before
        return is_set

    def forget_scans(self) -> None:
        """Tell the delay by the scans that come."""
        self._ages.clear()

    def goes_back(self, stamp: float, now: float) -> bool:
        """Take in the stamp of a scan; true if its clock was set back."""
        is_back, self._scan_stamp = stamp < self._scan_stamp, stamp
        if is_back:
            self._restart(now)
        return is_back

    def _restart(self, now: float) -> None:
        self._ages.clear()
        self.is_restarting, self._restart_ends, self._scans = True, now + _RESTART_TIME, 0

    def _end_period(self, now: float) -> None:
        minima = self._minima
        if self._lowest < math.inf:
            minima.append(self._lowest)
        self._lowest, self._until = math.inf, now + _PERIOD
        before, self._before = self._before, min(list(minima)[-2:], default=math.inf)
        if before + _SHIFT < self._before < math.inf:
            self._ages.clear()  # scan and odometry were late together, or their clock was set back
        changes = [later - earlier for earlier, later in pairwise(minima)]
        # A clock that is not real time, as that of a slow simulator.
        self._drifts = len(changes) == 3 and (
            min(changes) > _MAX_DRIFT or max(changes) < -_MAX_DRIFT
        )

    def on_scan(self, scan: Scan, now: float) -> float:
        """Take in a scan; the delay that counts, or 0 if stamps do not tell it."""
        if self.offset == math.inf:
            return 0.0
        if scan.ages is not self._ages_of_rays:  # mostly they are those of the last scan
            self._ages_of_rays, self._lead = scan.ages, _lead(scan, self._spec)
        age = now - self.offset - scan.stamp - self._lead
        self._scans += 1
        if self.is_restarting and now > self._restart_ends and self._scans > _MIN_STAMPS:
            self.is_restarting = self._is_shared = False
        if self._drifts:
            self._forget("the stamps of odometry do not run at real time")
        elif age < _MAX_LEAD or (age > _MAX_AGE and not self._is_shared):
            self._forget(_other_clock(age))
        else:
            self._ages.append(min(max(age, 0.0), _LONGEST))
            self._at = now
        ages = self._ages
        if not self._is_shared and (len(ages) < _MIN_STAMPS or len(self._minima) < 4):
            return 0.0
        self._is_shared = bool(ages)
        return max(sorted(ages)[-min(_RANK, len(ages))], ages[-1]) if ages else 0.0

    def figure(self, now: float) -> DelayFigure:
        """The mean delay of the last scans, with its deviation."""
        ages = self._ages
        if not self._is_shared or not ages:
            why = self._why if not ages else "too few scans yet"
            return DelayFigure(method="stamps", text=why)
        return _figure(ages, max(now - self._at, 0.0))

    def _forget(self, why: str) -> None:
        self._ages.clear()
        self._is_shared, self._why = False, why


_Spectrum = np.ndarray[tuple[int], np.dtype[np.complex128]]


class _Candidates(NamedTuple):
    """Sums over pairs of scans: of measured turns m, and of turns p (c,) by candidate delay."""

    mm: float
    mp: Array
    pp: Array
    pairs: float


def _no_pairs() -> _Candidates:
    return _Candidates(0.0, np.zeros(len(_CANDIDATES)), np.zeros(len(_CANDIDATES)), 0.0)


class _Seen:
    """A scan of `rays` that arrived `at` on the clock of odometry, and the pose then."""

    def __init__(self, at: float, pose: Pose, scan: Scan) -> None:
        self.at, self.pose = at, pose
        self.rays = len(scan.ranges)
        self._least, self._farthest = scan.range_min, min(scan.range_max, _MAX_RANGE)
        self._ranges = np.array(scan.ranges, np.float64)  # a driver may write to its own
        self._spectrum: tuple[_Spectrum, float] | None = None

    def spectrum(self) -> tuple[_Spectrum, float]:
        """The spectrum of the ranges about their mean, no return as far away, and their norm."""
        if self._spectrum is None:
            ranges, farthest = self._ranges, self._farthest
            is_return = (ranges >= self._least) & (ranges <= farthest)
            relief = np.where(is_return, ranges, farthest)
            relief -= relief.mean()
            self._spectrum = np.fft.rfft(relief), float(np.linalg.norm(relief))
        return self._spectrum


class _Turns:
    """Delay by turns: `delay` and `spread` in s (None: not known), of pairs of scans up to `at`."""

    def __init__(self) -> None:
        self.delay: float | None = None
        self.spread = 0.0
        self.at = 0.0
        self._times, self._yaws = np.empty(4 * _HISTORY), np.empty(4 * _HISTORY)
        self._first = self._end = 0  # of the headings kept
        self._stamp = -math.inf
        self._yaw = 0.0
        self._slow_rate = 0.0
        self._changed_at = -math.inf
        self._total = 0.0  # turned so far
        self._odometry = Odometry(0.0, Pose(), Twist())
        self._last: _Seen | None = None
        self._sums, self._pairs, self._scans = _no_pairs(), 0, 0
        self._bearings: Array | None = None
        self._ray = 0.0
        self._why = "it has not turned at a changing rate yet"

    def forget(self) -> None:
        """Measure anew."""
        self.delay, self._sums, self._pairs = None, _no_pairs(), 0
        self._why = "its last figure was older than a minute"

    def forget_headings(self) -> None:
        """The clock of odometry was set."""
        self._first = self._end = 0
        self._stamp, self._last = -math.inf, None

    @property
    def pose(self) -> Pose:
        """The last pose by odometry."""
        return self._odometry.pose

    def headings(self) -> Headings:
        """A copy of the headings kept."""
        kept = slice(self._first, self._end)
        return Headings(self._times[kept].copy(), self._yaws[kept].copy())

    def on_odometry(self, odometry: Odometry) -> None:
        """Keep a heading."""
        rate = odometry.twist.angular
        self._slow_rate += 0.1 * (rate - self._slow_rate)
        if abs(rate - self._slow_rate) > _MIN_RATE_CHANGE:
            self._changed_at = odometry.stamp
        self._odometry = odometry
        if odometry.stamp - self._stamp < _SPACING:
            return
        end, yaw = self._end, odometry.pose.yaw
        if end == len(self._times):
            kept = slice(end - _HISTORY, end)
            self._times[:_HISTORY], self._yaws[:_HISTORY] = self._times[kept], self._yaws[kept]
            self._first, end = 0, _HISTORY
        if end > self._first:
            self._total += math.remainder(yaw - self._yaw, 2.0 * math.pi)
        self._times[end], self._yaws[end] = odometry.stamp, self._total
        self._yaw, self._stamp, self._end = yaw, odometry.stamp, end + 1
        self._first = max(self._first, end + 1 - _HISTORY)

    def on_scan(self, scan: Scan, at: float, now: float) -> None:
        """Compare a scan with the last one; `at` is its arrival on the clock of odometry."""
        longest = _CANDIDATES[-1] + 0.5
        if at - self._changed_at > longest or not self._can_correlate(scan):
            self._last = None
            return
        last, self._last = self._last, None
        self._scans += 1
        if self._pairs >= _ENOUGH_PAIRS and self._scans % 4 > 1:
            return
        seen = self._last = _Seen(at, self._odometry.pose, scan)
        if last is None or (self._pairs >= _ENOUGH_PAIRS and self._scans % 4 == 0):
            return
        if at - last.at > 0.5 or self._end == self._first:
            return
        if math.hypot(seen.pose.x - last.pose.x, seen.pose.y - last.pose.y) > _MAX_SHIFT:
            return
        kept = slice(self._first, self._end)
        times, yaws = self._times[kept], self._yaws[kept]
        if last.at - _CANDIDATES[-1] < times[0]:
            return
        turns = np.interp(at - _CANDIDATES, times, yaws)
        turns -= np.interp(last.at - _CANDIDATES, times, yaws)
        low, high = float(turns.min()), float(turns.max())
        if high - low < _MIN_TURN_SPREAD or max(-low, high) + _SEARCHED > _MAX_SEARCHED:
            return
        turn = self._measured(last, seen, low - _SEARCHED, high + _SEARCHED)
        if turn is not None:
            self._add(turn, turns)
            self.at = now

    def figure(self, now: float) -> DelayFigure:
        """The delay with its deviation."""
        if self.delay is None:
            return DelayFigure(method="turns", text=self._why)
        return DelayFigure(
            method="turns",
            delay=self.delay,
            spread=self.spread,
            samples=self._pairs,
            age=max(now - self.at, 0.0),
        )

    def _can_correlate(self, scan: Scan) -> bool:
        """True if the rays cover a full turn evenly. `_ray`: the angle from one to the next."""
        if scan.bearings is not self._bearings:
            self._bearings, self._ray = scan.bearings, 0.0
            self._last = None
            steps = np.diff(np.unwrap(scan.bearings))
            if len(steps) + 1 >= _MIN_RAYS:
                step = float(steps.mean())
                is_even = float(np.abs(steps - step).max()) < 0.1 * abs(step)
                is_full = abs(abs(step) * (len(steps) + 1) - 2.0 * math.pi) < 1.5 * abs(step)
                self._ray = step if is_even and is_full else 0.0
            if self._ray == 0.0:
                self._why = "its rays do not cover a full turn evenly"
        return self._ray != 0.0

    def _measured(self, before: _Seen, after: _Seen, low: float, high: float) -> float | None:
        """The turn in rad from one scan to the next, between `low` and `high`; None: unclear.

        A turn by k rays to the left moves all that is seen k rays to the right.
        """
        one, size_one = before.spectrum()
        other, size_other = after.spectrum()
        n, ray = after.rays, abs(self._ray)
        least = _MIN_RELIEF * math.sqrt(n)
        if min(size_one, size_other) < least:
            self._why = "it sees no features to tell a turn by"
            return None
        likeness = np.fft.irfft(one * np.conj(other), n)
        if self._ray < 0.0:
            likeness = np.roll(likeness[::-1], 1)
        shifts = np.arange(math.floor(low / ray), math.ceil(high / ray) + 1)
        found = likeness[shifts % n]
        best = int(found.argmax())
        if not 0 < best < len(found) - 1 or found[best] < _MIN_LIKENESS * size_one * size_other:
            return None
        a, b, c = found[best - 1 : best + 2]
        return float(shifts[best] + 0.5 * (a - c) / (a - 2.0 * b + c)) * ray

    def _add(self, turn: float, turns: Array) -> None:
        """Add a measured turn, and what odometry says of it for each candidate (c,)."""
        keep, sums = _FORGETTING, self._sums
        sums = self._sums = _Candidates(
            keep * sums.mm + turn * turn,
            keep * sums.mp + turn * turns,
            keep * sums.pp + turns * turns,
            keep * sums.pairs + 1.0,
        )
        self._pairs += 1
        self.delay = None
        if sums.pairs < _MIN_PAIRS:
            self._why = "too few turns yet"
            return
        self._why = "its turns do not tell one delay from another"
        lowest, highest = _SCALES
        # np.clip takes several times as long.
        scales = np.minimum(np.maximum(sums.mp / np.maximum(sums.pp, 1e-12), lowest), highest)
        errors = sums.mm - 2.0 * scales * sums.mp + scales * scales * sums.pp
        best = int(errors.argmin())
        variance = max(float(errors[best]) / (sums.pairs - 2.0), _MIN_SPREAD**2)
        likely = np.flatnonzero(errors <= errors[best] + 9.0 * variance)
        low, high = int(likely[0]), int(likely[-1])
        if high == len(errors) - 1 or (high - low) * _STEP > _MAX_INTERVAL:
            return
        i = max(best, 1)
        a, b, c = (float(error) for error in errors[i - 1 : i + 2])
        bend = a - 2.0 * b + c
        if bend <= 0.0:
            return
        self.delay = max(float(_CANDIDATES[i]) + 0.5 * _STEP * (a - c) / bend, 0.0)
        self.spread = max(_ALIKE * _STEP * math.sqrt(2.0 * variance / bend), 0.005)
