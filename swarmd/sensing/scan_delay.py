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

from swarmd.core.kernels import load_kernel
from swarmd.core.messages import DelayFigure, ScanDelaySummary
from swarmd.core.values import Array, Odometry, Scan, ScanSpec
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

_CERTAIN = 2.5  # spreads by which turns must exceed declaration and stamps
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
        self._stamps = _Stamps(spec)
        self._turns = load_kernel("swarmd.sensing.scans").Turns()
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
        if turns.delay - _CERTAIN * turns.spread > known:  # false of NaN: there is no figure
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
        headings = Headings(*turns.headings())
        if offset < math.inf and len(headings.times):
            has_turns = not math.isnan(turns.delay)
            measured = turns.delay if has_turns else self._stamps.figure(now).delay
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
            figures=(self._stamps.figure(now), self._figure_of_turns(now)),
            sweep=None if self.sweep is None else self.sweep.figure(),
        )

    def _figure_of_turns(self, now: float) -> DelayFigure:
        turns = self._turns
        if math.isnan(turns.delay):
            return DelayFigure(method="turns", text=turns.why)
        return DelayFigure(
            method="turns",
            delay=turns.delay,
            spread=turns.spread,
            samples=turns.pairs,
            age=max(now - turns.at, 0.0),
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
