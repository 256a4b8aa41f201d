"""Measures the delay of scans by turns of the robot.

The turn between two scans is measured by circular correlation of their ranges. For each candidate
delay, odometry predicts this turn. The delay is the candidate with the least squared errors, where
the scale of odometry is free. At a constant rate of turn all delays predict the same turns, so only
turns at a changing rate are used, and without such turns the delay is not known. After the temporal
calibration of sensors by correlated rotations (Rehder, Siegwart and Furgale, IEEE T-RO 2016), with
one axis and a grid of candidates.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import TURN
from swarmd.core.buffers import scratch, view
from swarmd.core.cython_shadow import (
    INFINITY,
    NAN,
    Doubles,
    ceil,
    fabs,
    floor,
    hypot,
    isnan,
    remainder,
    sqrt,
)
from swarmd.core.messages import DelayFigure

if TYPE_CHECKING:
    from swarmd.core.values import Array, Pose, Scan

# Candidate delays: 0 to _LONGEST_DELAY s.
_CANDIDATES = 49
_LONGEST_DELAY = 1.2
_DELAY_STEP = 1.2 / 48
# Headings that are kept, and s between two of them, at least.
_HISTORY = 96
_SPACING = 0.02
# The rate of turn changes if it differs by so many rad/s from its running mean; the mean follows
# each reading by this share of the difference.
_MIN_RATE_CHANGE = 0.15
_MEAN_WEIGHT = 0.1
_CHANGE_LASTS = 1.2 + 0.5  # s for which such a change counts
_MAX_SCAN_PERIOD = 0.5  # s from one scan to the next
# rad by which the turns of the candidates must differ, or a pair of scans is not used.
_MIN_TURN_SPREAD = 0.06
# rad by which the search for the turn goes beyond the turns of all candidates.
_MARGIN = 0.25
# rad; beyond it a square room looks like itself.
_MAX_SEARCHED = 1.2
# m between two scans: a shift of near things looks like a turn.
_MAX_SHIFT = 0.03
_MIN_RAYS = 90
# Rays are even if each step differs by less than this share from the mean, and if they miss a full
# turn by less than so many steps.
_UNEVEN_SHARE = 0.1
_MISSED_STEPS = 1.5
# m; farther returns count as this range.
_MAX_RANGE = 6.0
# m, standard deviation of ranges below which a scene has no features.
_MIN_RELIEF = 0.1
# Correlation of two scans at the turn that was measured.
_MIN_CORRELATION = 0.6
# Weight of earlier pairs, for each new one: some 50 count.
_FORGETTING = 0.98
_MIN_PAIRS = 8.0
# rad, least standard deviation of a measured turn: moving objects turn a scene so far, for seconds.
_MIN_SPREAD = 0.025
# Factor on the spread, as errors of pairs are not independent: 1.7 in simulation.
_ALIKE = 2.0
_MIN_DELAY_SPREAD = 0.005  # s
_SQUARED_DEVIATIONS = 9.0  # three deviations
# s of candidates within three deviations: a wider one is no figure.
_MAX_INTERVAL = 0.2
_LOWEST_SCALE = 0.85  # of odometry
_HIGHEST_SCALE = 1.15
_MIN_SQUARE = 1e-12  # rad2: a scale needs turns
# Pairs after which only each fourth scan is compared with the one before it.
_ENOUGH_PAIRS = 20


@cython.cclass
class DelayByTurns:
    """The delay of one sensor's scans by turns. Times in s, angles in rad, ranges in m."""

    delay: float  # NaN while not known
    spread: float
    at: float  # when the last pair of scans was compared
    pairs: int  # of scans compared
    why: str  # why the delay is not known
    _pose: Pose  # the last one by odometry
    # The headings kept: places `_first` to `_end` of the arrays.
    _times: Doubles
    _yaws: Doubles  # turned since the start, not wrapped
    _first: int
    _end: int
    _stamp: float  # of the last heading
    _yaw: float
    _turned: float  # turned so far
    _mean_rate: float
    _changed_at: float
    _bearings: Array | None
    _rays: int
    _ray_step: float  # from ray to ray; 0: rays do not cover a full turn evenly
    # The last scan: arrival on the clock of odometry, place of the robot, and the ranges less their
    # mean (repeated twice, for a circular correlation) with their norm. Then the ranges and the
    # norm of the scan before.
    _scan_count: int
    _has_last: bool
    _scan_at: float
    _x: float
    _y: float
    _relief: Doubles
    _norm: float
    _old_relief: Doubles
    _old_norm: float
    # By candidate delay: the turn by odometry, and the squared error of all pairs.
    _turns: cython.double[49]
    _errors: cython.double[49]
    # Weighted sums over pairs of products of the measured turn m and the predicted turn p.
    _mm: float
    _mp: cython.double[49]
    _pp: cython.double[49]
    _weight: float

    def __init__(self) -> None:
        self.delay = NAN
        self.why = "it has not turned at a changing rate yet"
        self._times = scratch(4 * _HISTORY)
        self._yaws = scratch(4 * _HISTORY)
        self._stamp = -INFINITY
        self._changed_at = -INFINITY
        self._relief = self._old_relief = scratch(0)

    def check_indices(self) -> None:
        """ValueError unless its ranges are those of its rays, as `_correlation` reads them."""
        ray = fabs(self._ray_step)
        lengths = len(self._relief), len(self._old_relief), 2 * self._rays
        is_even = ray == 0.0 or fabs(ray * self._rays - TURN) < _MISSED_STEPS * ray
        if self._rays < 0 or min(lengths) != max(lengths) or not is_even:
            raise ValueError(f"{self._rays} rays at steps of {ray} rad, {lengths} ranges")

    def figure(self, now: float) -> DelayFigure:
        """The delay, or why it is not known."""
        if isnan(self.delay):
            return DelayFigure(method="turns", text=self.why)
        return DelayFigure(
            method="turns",
            delay=self.delay,
            spread=self.spread,
            samples=self.pairs,
            age=max(now - self.at, 0.0),
        )

    def forget(self) -> None:
        """Drop the delay and all pairs, and begin the measurement anew."""
        self.delay = NAN
        self.pairs = 0
        self._mm = 0.0
        self._weight = 0.0
        for k in range(_CANDIDATES):
            self._mp[k] = 0.0
            self._pp[k] = 0.0
        self.why = "its last figure was older than a minute"

    def forget_headings(self) -> None:
        """Drop the headings, as when the clock of odometry was set."""
        self._first = 0
        self._end = 0
        self._stamp = -INFINITY
        self._has_last = False

    def read(self, stamp: float, yaw: float, rate: float, pose: Pose) -> None:
        """Take in a reading of odometry: its heading, and whether the rate of turn changes."""
        self._mean_rate += _MEAN_WEIGHT * (rate - self._mean_rate)
        if fabs(rate - self._mean_rate) > _MIN_RATE_CHANGE:
            self._changed_at = stamp
        self._pose = pose
        if stamp - self._stamp < _SPACING:
            return
        if self._end == 4 * _HISTORY:
            for i in range(_HISTORY):
                self._times[i] = self._times[3 * _HISTORY + i]
                self._yaws[i] = self._yaws[3 * _HISTORY + i]
            self._first = 0
            self._end = _HISTORY
        if self._end > self._first:
            self._turned += remainder(yaw - self._yaw, TURN)
        self._times[self._end] = stamp
        self._yaws[self._end] = self._turned
        self._yaw = yaw
        self._stamp = stamp
        self._end += 1
        self._first = max(self._first, self._end - _HISTORY)

    def compare(self, scan: Scan, arrival: float, now: float) -> None:
        """Compare a scan with the scan before: the measured turn of the robot updates the delay.

        A pair of scans is used only if the rate of turn changed lately, the robot hardly moved, and
        the candidate delays predict turns that differ enough.

        `scan`: the conditioned scan. `arrival`: s, the arrival of the scan on the clock of
        odometry. `now`: s on the robot's clock.
        """
        had_last = self._has_last
        self._has_last = False  # two scans in a row are a pair: a return in 1 or 2 breaks the row

        # 1. Without a changing rate of turn, or without even rays, no delay can be measured.
        if arrival - self._changed_at > _CHANGE_LASTS:
            return
        if scan.bearings is not self._bearings:
            self._set_bearings(scan.bearings)
            had_last = False
        if self._ray_step == 0.0:
            return

        # 2. With enough pairs, only the first two of four scans make a pair, to save time.
        self._scan_count += 1
        saves_time = self.pairs >= _ENOUGH_PAIRS
        place_in_four = self._scan_count % 4
        if saves_time and place_in_four > 1:
            return
        is_first = not had_last or (saves_time and place_in_four == 0)

        # 3. Stores this scan. Skips a pair that is too far apart in time or place.
        previous_arrival = self._scan_at
        previous_x = self._x
        previous_y = self._y
        self._store_ranges(scan)
        self._scan_at = arrival
        self._has_last = True
        self._x = self._pose.x
        self._y = self._pose.y
        if is_first:
            return
        if arrival - previous_arrival > _MAX_SCAN_PERIOD or self._end == self._first:
            return  # too far apart, or no reading of odometry
        if previous_arrival - _LONGEST_DELAY < self._times[self._first]:
            return  # odometry does not reach back over the longest delay
        if hypot(self._x - previous_x, self._y - previous_y) > _MAX_SHIFT:
            return

        # 4. The turns that the candidates predict must differ, and be small enough to measure.
        self._predict_turns(previous_arrival, arrival)
        least = INFINITY
        most = -INFINITY
        for k in range(_CANDIDATES):
            least = min(least, self._turns[k])
            most = max(most, self._turns[k])
        if most - least < _MIN_TURN_SPREAD or max(-least, most) + _MARGIN > _MAX_SEARCHED:
            return
        turn = self._measured_turn(least - _MARGIN, most + _MARGIN)
        if not isnan(turn):
            self._add(turn)
            self.at = now

    def _predict_turns(self, before: float, at: float) -> None:
        """Set the turn by odometry between the arrivals of two scans, for each candidate delay."""
        begin = self._end - 1
        end = self._end - 1
        for k in range(_CANDIDATES):
            delay = _DELAY_STEP * k
            while end > self._first and self._times[end] > at - delay:
                end -= 1
            while begin > self._first and self._times[begin] > before - delay:
                begin -= 1
            self._turns[k] = self._heading(end, at - delay) - self._heading(begin, before - delay)

    def _set_bearings(self, bearings: Array) -> None:
        """Take other bearings, with the angle from one ray to the next if they are even."""
        self._bearings = bearings
        self._rays = len(bearings)
        self._ray_step = 0.0
        steps = np.diff(np.unwrap(bearings))
        if self._rays >= _MIN_RAYS:
            step = steps.mean()
            is_even = np.abs(steps - step).max() < _UNEVEN_SHARE * fabs(step)
            if is_even and fabs(fabs(step) * self._rays - TURN) < _MISSED_STEPS * fabs(step):
                self._ray_step = step
        if self._ray_step == 0.0:
            self.why = "its rays do not cover a full turn evenly"
        self._relief = scratch(2 * self._rays)
        self._old_relief = scratch(2 * self._rays)

    def _store_ranges(self, scan: Scan) -> None:
        """Store the relief of a scan (its ranges less their mean), and the norm of the relief.

        The relief is stored twice in a row, so that a circular correlation needs no modulo. It is 0
        for a ray without a return: a far range there would count as a feature of the room, but lost
        rays and a blind sector do not turn with the room. The relief before becomes `_old_relief`.
        """
        ranges: Doubles = view(scan.ranges)
        range_min = scan.range_min
        range_max = scan.range_max
        count = self._rays
        return_count = 0
        mean = 0.0
        square_sum = 0.0
        self._relief, self._old_relief = self._old_relief, self._relief
        self._old_norm = self._norm
        relief = self._relief
        for i in range(count):
            if range_min <= ranges[i] <= range_max:
                mean += min(ranges[i], _MAX_RANGE)
                return_count += 1
        mean /= max(return_count, 1)
        for i in range(count):
            is_return = range_min <= ranges[i] <= range_max
            relief[i] = min(ranges[i], _MAX_RANGE) - mean if is_return else 0.0
            relief[count + i] = relief[i]
            square_sum += relief[i] * relief[i]
        self._norm = sqrt(square_sum)

    def _heading(self, k: int, at: float) -> float:
        """The heading at a time between heading k and the next heading, interpolated."""
        before = self._times[k]
        if at <= before or k == self._end - 1:
            return self._yaws[k]
        slope = (self._yaws[k + 1] - self._yaws[k]) / (self._times[k + 1] - before)
        return slope * (at - before) + self._yaws[k]

    def _measured_turn(self, low: float, high: float) -> float:
        """The turn in rad between the last two scans, by circular correlation of their ranges.

        Only turns from `low` to `high` are tried. A turn of the robot by k rays to the left shifts
        all returns by k rays to the right. NaN if the scene has too few features, or if the scans
        do not fit.
        """
        least_norm = _MIN_RELIEF * sqrt(self._rays)
        if min(self._norm, self._old_norm) < least_norm:
            self.why = "it sees no features to tell a turn by"
            return NAN

        # 1. The shift in rays with the greatest correlation.
        step = fabs(self._ray_step)
        first = cython.cast(cython.Py_ssize_t, floor(low / step))
        last = cython.cast(cython.Py_ssize_t, ceil(high / step))
        best = first
        greatest = -INFINITY
        for shift in range(first, last + 1):
            correlation = self._correlation(shift)
            if correlation > greatest:
                greatest = correlation
                best = shift
        # A maximum at the edge of the searched turns may continue beyond the edge.
        if not first < best < last or greatest < _MIN_CORRELATION * self._old_norm * self._norm:
            return NAN

        # 2. The top of the parabola through the best shift and its two neighbours.
        before = self._correlation(best - 1)
        after = self._correlation(best + 1)
        return (best + 0.5 * (before - after) / (before - 2.0 * greatest + after)) * step

    def _correlation(self, shift: int) -> float:
        """The correlation of the last two scans for a turn by `shift` rays, at most n."""
        n = self._rays
        first = shift if self._ray_step > 0.0 else -shift
        if first < 0:
            first += n
        old = self._old_relief
        new = self._relief
        a = 0.0
        b = 0.0
        c = 0.0
        d = 0.0
        for i in range(0, n - 3, 4):  # four sums: a processor adds to them at the same time
            a += old[first + i] * new[i]
            b += old[first + i + 1] * new[i + 1]
            c += old[first + i + 2] * new[i + 2]
            d += old[first + i + 3] * new[i + 3]
        for i in range(n - n % 4, n):
            a += old[first + i] * new[i]
        return (a + b) + (c + d)

    def _add(self, turn: float) -> None:
        """Add a measured turn and the predicted turns; sets the errors of candidates, `delay`."""
        best = 0
        self._mm = _FORGETTING * self._mm + turn * turn
        self._weight = _FORGETTING * self._weight + 1.0
        for k in range(_CANDIDATES):
            self._mp[k] = _FORGETTING * self._mp[k] + turn * self._turns[k]
            self._pp[k] = _FORGETTING * self._pp[k] + self._turns[k] * self._turns[k]
            scale = self._mp[k] / max(self._pp[k], _MIN_SQUARE)
            scale = min(max(scale, _LOWEST_SCALE), _HIGHEST_SCALE)
            self._errors[k] = self._mm - 2.0 * scale * self._mp[k] + scale * scale * self._pp[k]
            if self._errors[k] < self._errors[best]:
                best = k
        self.pairs += 1
        self.delay = NAN
        if self._weight < _MIN_PAIRS:
            self.why = "too few turns yet"
            return
        self.why = "its turns do not tell one delay from another"
        self._set_delay(best)

    def _set_delay(self, best: int) -> None:
        """Set delay and spread by a parabola through the errors around the best candidate.

        `best` is the index of the candidate delay with the least squared error. Nothing is set if
        candidates far from each other, or the longest candidate, fit nearly as well as the best.
        """
        # 1. The candidates, from `lowest` to `highest`, that fit nearly as well as the best.
        # `_weight` is the number of pairs, of which two are spent on fitting scale and delay.
        variance = self._errors[best] / (self._weight - 2.0)
        variance = max(variance, _MIN_SPREAD * _MIN_SPREAD)
        error_limit = self._errors[best] + _SQUARED_DEVIATIONS * variance
        lowest = 0
        highest = _CANDIDATES - 1
        while self._errors[lowest] > error_limit:
            lowest += 1
        while self._errors[highest] > error_limit:
            highest -= 1
        if highest == _CANDIDATES - 1 or (highest - lowest) * _DELAY_STEP > _MAX_INTERVAL:
            return

        # 2. The minimum of the parabola through the best candidate and its two neighbours. If the
        # first candidate is the best, the second is the middle. The last candidate is never the
        # best here: step 1 returns then. The curvature gives the standard deviation, which _ALIKE
        # widens.
        middle = max(best, 1)
        error_before = self._errors[middle - 1]
        error_after = self._errors[middle + 1]
        curvature = error_before - 2.0 * self._errors[middle] + error_after
        if curvature > 0.0:
            change = 0.5 * _DELAY_STEP * (error_before - error_after) / curvature
            self.delay = max(_DELAY_STEP * middle + change, 0.0)
            spread = _ALIKE * _DELAY_STEP * sqrt(2.0 * variance / curvature)
            self.spread = max(spread, _MIN_DELAY_SPREAD)
