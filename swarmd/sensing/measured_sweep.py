"""In which order a sensor measures its rays, found out while the robot turns. Pure.

Many drivers of rotating lidars reverse their rays and give a positive `time_increment` all the
same. So the ages of rays that a driver gives count for the duration of a scan only, where the
platform has no `scan.sweep`, and the order of the rays is measured. Between two scans with half a
radian of turn between them, each sector of the surroundings is displaced by the turn between its
two rays, which is not the turn between the scans: the displacements by heading tell the order. Each
pair of scans compares them with those that odometry predicts for each candidate: all rays at once,
and rising and falling order of the message, with the duration that the driver gives, with the scan
period and half of it. The same orders, begun elsewhere than at the message's first ray, are
candidates by which no scan is de-skewed: if one of them fits best, the platform has to give its
sweep. Errors are limited, since things move (Huber, "Robust Estimation of a Location Parameter",
1964). A candidate is true if it fits better than each other one in a paired test, after turns to
both sides.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swarmd.core.messages import SweepFigure
from swarmd.core.values import Array, Pose, Scan, ScanSpec

_TURN = 2.0 * math.pi
_CELLS = 360
_CELL = _TURN / _CELLS
_GRID = _CELL * np.arange(_CELLS)
_SECTORS = 18
_CENTRES = _TURN / _SECTORS * (np.arange(_SECTORS) + 0.5) - 0.5 * _CELL
_SHIFTS = 20  # cells to each side by which a sector may be displaced
_MAX_RANGE = 6.0  # m; farther returns count as if they were there, and so does no return
_CLIP = 0.3  # m by which two ranges differ at most
_MIN_CONTRAST = 0.02  # m by which a sector differs more, on the mean, when it is displaced wrongly
_MAX_MISFIT = 0.5  # share of that difference which may be left at the best displacement
_MIN_SECTORS = 8
_MAX_ERROR = 0.1  # rad that a displacement is wrong by at most
_MIN_RAYS = 90
_UNEVEN_SHARE = 0.1  # of the mean step, by which each step may differ
# What may differ between scans of one sensor: shares of the claim and of a turn, and rad.
_CLAIM_SHARE, _COVER_SHARE = 0.2, 0.05
_FIRST_BEARING = 0.1
_MIN_COVER = 0.2  # share of a turn
_MIN_TURN, _MAX_TURN = 0.5, 1.2  # rad from one scan to the other. Less: wheels that turn in the
# air look like a sensor that measures all rays at once. More: a square room looks like itself.
_MIN_SKEW, _MAX_SKEW = 0.03, 0.4  # rad between the turns during one of the two and the other
_MAX_SHIFT = 0.1  # m between the two
_HISTORY = 20  # scans
_SKIPPED = 4  # of so many scans one is taken, once the order is known,
_CHECKED = 2.0  # rad of turns after which two are compared
_AT_REST = 0.01  # rad
_SPACING = 0.1  # rad of turn between scans that are kept, and between pairs
_MAX_APART = 2.0  # s
_ALIKE = 0.8, 1.25  # durations between these ratios are one candidate
_SHORTEST = 0.25  # of the period: a shorter duration cannot be told from all rays at once
_STARTS = 16
_MAX_DELAY_CHANGE = 0.05  # s
_KEPT = 48  # pairs
_MIN_PAIRS = 8
_MIN_PAIRS_OF_SIDE = 2
_CERTAIN = 5.0  # standard errors by which each other candidate must be worse,
_CERTAIN_OF_NEIGHBOR = 2.0  # and by which the same order must be, begun a sixteenth apart
_MIN_SPREAD = 0.3  # of votes
_MIN_BETTER = 0.05  # share by which it must be worse


class Order(NamedTuple):
    """The order of a message's rays in time.

    `direction`: 1.0 rising, -1.0 falling, 0.0 all at once. It takes `duration` s, and begins at the
    share `start` of the way through the message.
    """

    direction: float
    duration: float = 0.0
    start: float = 0.0

    def ages(self, count: int) -> Array:
        """(count,) s by which each ray is older than the newest one; read-only."""
        place = np.arange(count, dtype=np.float64)
        if self.direction < 0.0:
            place = place[::-1]
        since = (place - round(self.start * count)) % count
        ages = (self.duration / count) * (count - 1.0 - since)
        ages.flags.writeable = False
        return ages


AT_ONCE = Order(0.0)


class Headings(NamedTuple):
    """Headings by odometry: rising `times` (k,) s on its clock, `yaws` (k,) rad, not wrapped."""

    times: Array
    yaws: Array


class _Layout(NamedTuple):
    """How the rays of a scan lie, `step` rad from one to the next, and the driver's `claim` in s.

    `claim` None: it says nothing; 0: it says that all rays are measured at once. `bearings` (n,)
    are not wrapped. `fault`: why no order can be measured; empty if one can.
    """

    bearings: Array
    step: float
    claim: float | None
    fault: str

    @property
    def cover(self) -> float:
        """The share of a turn that the rays cover; 1 where their spacing is not known."""
        return 1.0 if self.step == 0.0 else min(abs(self.step) * len(self.bearings) / _TURN, 1.0)

    def is_as(self, before: _Layout) -> bool:
        """True if both are scans of one sensor; the number of rays may vary."""
        if (self.claim is None) != (before.claim is None):
            return False
        claim, claim_before = self.claim or 0.0, before.claim or 0.0
        turned = math.remainder(self.bearings[0] - before.bearings[0], _TURN)
        return (
            abs(claim - claim_before) <= _CLAIM_SHARE * max(claim, claim_before)
            and self.step * before.step >= 0.0
            and abs(self.cover - before.cover) < _COVER_SHARE
            and abs(turned) < _FIRST_BEARING
        )


class _Seen:
    """A scan whose rays were measured about the time `at` of odometry's clock.

    `x`, `y` in m of the sensor then, `yaw` in rad, not wrapped; `skew` in rad: the turn while it
    was measured.
    """

    def __init__(
        self, scan: Scan, layout: _Layout, at: float, headings: Headings, sensor: Pose, skew: float
    ) -> None:
        self.at, self.skew = at, skew
        self._layout, self._headings = layout, headings
        self.x, self.y = sensor.x, sensor.y
        self.yaw = sensor.yaw
        known = np.flatnonzero(scan.ranges >= scan.range_min)
        self._known = known if layout.step > 0.0 else known[::-1]
        self._ranges = np.minimum(scan.ranges, min(scan.range_max, _MAX_RANGE))[self._known]

    def cells(self, x: float, y: float) -> Array:
        """Ranges (360,) by heading from a place, as if measured at once; NaN: nothing is seen."""
        if not len(self._known):
            return np.full(_CELLS, math.nan)
        ahead, left = self.x - x, self.y - y
        headings = self._layout.bearings[self._known] + self.yaw
        cos, sin = np.cos(headings), np.sin(headings)
        along, across = self._ranges + ahead * cos + left * sin, left * cos - ahead * sin
        headings += np.arctan2(across, along)
        at = headings[0] + (_GRID - headings[0]) % _TURN
        right = math.nan if self._layout.cover < 1.0 else None
        cells: Array = np.interp(at, headings, np.hypot(along, across), right=right)
        return cells

    def is_comparable(self, after: _Seen) -> bool:
        """True if another scan shows the same surroundings, from another heading."""
        return (
            0.0 < after.at - self.at < _MAX_APART
            and _MIN_TURN < abs(after.yaw - self.yaw) < _MAX_TURN
            and abs(after.skew - self.skew) < _MAX_SKEW
            and math.hypot(after.x - self.x, after.y - self.y) < _MAX_SHIFT
        )

    def turns(self, candidates: _Candidates) -> Array:
        """The turn (c, 18) in rad from the time of the mean ray to that of each sector's ray."""
        layout = self._layout
        span = layout.step * len(layout.bearings)
        place = ((_CENTRES - self.yaw - layout.bearings[0]) % math.copysign(_TURN, span)) / span
        times = self.at + candidates.since(place)
        turns: Array = np.interp(times, *self._headings) - self.yaw
        return turns


class _Candidates:
    """The orders that are compared; those with a start are no order to de-skew by."""

    def __init__(self, orders: tuple[Order, ...]) -> None:
        self.orders = orders
        columns = np.array(orders)[:, :, None]
        self._directions, self._durations, self._starts = columns.swapaxes(0, 1)

    def is_neighbor(self, index: int) -> NDArray[np.bool_]:
        """(c,) which orders differ from that one by their start alone, and by one step of it."""
        apart = np.abs((self._starts - self._starts[index] + 0.5) % 1.0 - 0.5) < 1.5 / _STARTS
        alike = (self._directions == self._directions[index]) & apart
        return np.ravel(alike & (self._durations == self._durations[index]))

    def since(self, place: Array) -> Array:
        """s (c, k) from the mean ray to the ray that lies at `place` (k,), 0 to 1, in the scan."""
        is_falling = self._directions < 0.0
        place = np.where(is_falling, 1.0 - place, place)
        since: Array = self._durations * ((place - self._starts) % 1.0 - 0.5)
        return since


class MeasuredSweep:
    """Measures the order of one sensor's rays. Times in s.

    `order`: None while it is not known; AT_ONCE also where the driver says that all rays are
    measured at once. A sensor whose rays lie otherwise than before is another one, and measured
    anew. An order that later turns contradict is not known any more.
    """

    def __init__(self, spec: ScanSpec) -> None:
        self._period, self._offset = 1.0 / spec.rate, spec.offset
        self.order: Order | None = None
        self._layout: _Layout | None = None
        self._given: tuple[Array | None, Array | None] = None, None
        self._ages: Array | None = None
        self._candidates = _Candidates((AT_ONCE,))
        self._seen: deque[_Seen] = deque(maxlen=_HISTORY)
        self._yaw = self._turned = 0.0  # rad turned since the last pair
        self._scans = self._samples = 0  # so far; and pairs that told the order
        self._fits: deque[Array] = deque(maxlen=_KEPT)
        self._sides: deque[float] = deque(maxlen=_KEPT)  # of the same pairs: 1.0 left, -1.0 right
        self._delay = 0.0
        self._why = ""

    def ages(self, scan: Scan) -> Array:
        """(n,) s by which its rays are older than the newest one; the same object for equal scans.

        While the order is not known: by which any ray may be older than the mean of all.
        """
        self._look_at(scan)
        if self._ages is None:
            count = len(scan.ranges)
            if self.order is None:
                self._ages = np.full(count, 0.5 * self._longest())
                self._ages.flags.writeable = False
            else:
                self._ages = self.order.ages(count)
        return self._ages

    def on_scan(self, scan: Scan, at: float, delay: float, headings: Headings, place: Pose) -> None:
        """Compare a raw scan with an earlier one.

        It arrived `at` on the clock of odometry at `place`, `delay` s after its mean ray.
        """
        layout, half = self._look_at(scan), 0.5 * self._longest()
        self._scans += 1
        if abs(delay - self._delay) > _MAX_DELAY_CHANGE:  # earlier pairs were of other headings
            self._delay = delay
            self._forget_pairs()
        if self.order is not None and self._scans % _SKIPPED:
            return
        at -= delay
        if layout.fault or layout.claim == 0.0 or at - half < headings.times[0]:
            return
        begin, yaw, end = np.interp((at - half, at, at + half), *headings).tolist()
        kept, skew = self._seen, end - begin
        turned = abs(yaw - kept[-1].yaw) if kept else math.inf
        self._turned += min(abs(yaw - self._yaw), _MAX_TURN)
        self._yaw = yaw
        if turned + abs(skew) < _AT_REST and 0.0 < at - kept[-1].at < 0.5 * _MAX_APART:
            return
        cos, sin = math.cos(place.yaw), math.sin(place.yaw)
        ahead, left = self._offset
        sensor = Pose(place.x + cos * ahead - sin * left, place.y + sin * ahead + cos * left, yaw)
        seen = _Seen(scan, layout, at, headings, sensor, skew)
        before, greatest = None, _MIN_SKEW
        for earlier in kept:
            difference = abs(skew - earlier.skew)
            if difference > greatest and earlier.is_comparable(seen):
                before, greatest = earlier, difference
        if len(kept) > 1 and abs(yaw - kept[-2].yaw) < _SPACING:
            kept.pop()
        kept.append(seen)
        if before is not None and self._turned > (_SPACING if self.order is None else _CHECKED):
            self._turned = 0.0
            self._compare(before, seen)

    def forget_scans(self) -> None:
        """The clock of odometry was set."""
        self._seen.clear()

    def figure(self) -> SweepFigure:
        """The measured order, or why it is not known."""
        order, layout = self.order, self._layout
        if layout is None or order is None:
            return SweepFigure(samples=len(self._fits), text=self._why or "no scan yet")
        if order == AT_ONCE:
            return SweepFigure(direction="at once", samples=self._samples)
        first = layout.bearings[0 if order.direction > 0.0 else -1]
        return SweepFigure(
            direction="ccw" if order.direction * layout.step > 0.0 else "cw",
            start_deg=round(math.degrees(math.remainder(float(first), _TURN)), 1),
            duration=order.duration / layout.cover,
            samples=self._samples,
        )

    def _longest(self) -> float:
        """s that a scan takes at most, by its driver and by its rate."""
        assert self._layout is not None
        return max(self._layout.claim or 0.0, self._period * self._layout.cover)

    def _look_at(self, scan: Scan) -> _Layout:
        """The layout of a scan; one of another sensor begins the measurement anew."""
        given, layout = self._given, self._layout
        is_known = layout is not None and _is_same(given[0], scan.bearings)
        if layout is not None and is_known and _is_same(given[1], scan.ages):
            return layout
        before, layout = layout, _layout_of(scan)
        self._given, self._layout = (scan.bearings, scan.ages), layout
        if self.order is None or before is None or len(before.bearings) != len(layout.bearings):
            self._ages = None
        if before is None or not layout.is_as(before):
            self._begin(layout)
        return layout

    def _begin(self, layout: _Layout) -> None:
        """Measure anew, among orders with these durations: by the driver, a period, half of it."""
        self.order = AT_ONCE if layout.claim == 0.0 else None
        self._ages, self._samples = None, 0
        self._forget_pairs()
        self._why = layout.fault or "it has not turned enough to both sides yet"
        period, claim = self._period * layout.cover, layout.claim or 0.0
        durations = [period, 0.5 * period]
        if claim > _SHORTEST * period:
            unlike = [time for time in durations if not _ALIKE[0] < claim / time < _ALIKE[1]]
            durations = [claim, *unlike]
        starts = [i / _STARTS for i in range(_STARTS)]
        orders = [
            Order(direction, duration, start)
            for duration in durations
            for direction in (1.0, -1.0)
            for start in starts
        ]
        self._candidates = _Candidates((AT_ONCE, *orders))

    def _forget_pairs(self) -> None:
        self._seen.clear()
        self._fits.clear()
        self._sides.clear()

    def _compare(self, before: _Seen, after: _Seen) -> None:
        """Add how well each candidate explains the displacements between two scans."""
        moved = _displacements(before.cells(before.x, before.y), after.cells(before.x, before.y))
        is_known = np.isfinite(moved)
        if np.count_nonzero(is_known) < _MIN_SECTORS:
            return
        candidates = self._candidates
        errors = moved + after.turns(candidates) - before.turns(candidates)
        errors = errors[:, is_known]
        # Odometry's heading may be late, and scaled: all sectors are displaced by the same then.
        errors -= np.median(errors, axis=1, keepdims=True)
        self._fits.append(np.minimum(np.abs(errors), _MAX_ERROR).mean(axis=1))
        self._sides.append(math.copysign(1.0, after.yaw - before.yaw))
        self._decide()

    def _decide(self) -> None:
        """Set the order that is better than each other candidate; None if there is none."""
        rows, sides = np.array(self._fits), np.array(self._sides)
        left = sides > 0.0
        lefts = int(np.count_nonzero(left))
        if len(rows) < _MIN_PAIRS or min(lefts, len(rows) - lefts) < _MIN_PAIRS_OF_SIDE:
            return
        means = rows.mean(axis=0)
        best = int(means.argmin())
        worse = rows - rows[:, best : best + 1]
        # Turns differ in what they tell: by how much counts less than how often.
        usual = np.maximum(np.median(np.abs(worse), axis=0), 1e-9)
        votes = np.minimum(np.maximum(worse / usual, -1.0), 1.0)
        errors = np.maximum(votes.std(axis=0, ddof=1), _MIN_SPREAD) / math.sqrt(len(rows))
        certain = np.where(self._candidates.is_neighbor(best), _CERTAIN_OF_NEIGHBOR, _CERTAIN)
        is_worse = votes.mean(axis=0) > certain * errors
        is_worse &= worse.mean(axis=0) > _MIN_BETTER * means[best]
        is_worse &= (worse[left].mean(axis=0) > 0.0) & (worse[~left].mean(axis=0) > 0.0)
        orders, order = self._candidates.orders, None
        if np.count_nonzero(is_worse) == len(is_worse) - 1:
            order = orders[best] if orders[best].start == 0.0 else None
            self._why = "" if order else "its rays do not follow one another in the message's order"
        elif self.order is None or not is_worse[orders.index(self.order)]:
            order = self.order
            self._why = "its turns do not tell one order of rays from another yet"
        if order != self.order:
            self.order, self._ages = order, None
            self._samples = len(rows)
            self._forget_pairs()


def _is_same(before: Array | None, now: Array | None) -> bool:
    return before is now or (before is not None and now is not None and np.array_equal(before, now))


def _layout_of(scan: Scan) -> _Layout:
    ages, count = scan.ages, len(scan.bearings)
    claim = None
    if ages is not None and count > 1:
        claim = float(ages.max() - ages.min()) * count / (count - 1.0)
    bearings = np.unwrap(scan.bearings)
    if count < _MIN_RAYS:
        return _Layout(bearings if count else np.zeros(1), 0.0, claim, "it has too few rays")
    steps = np.diff(bearings)
    step = float(steps.mean())
    layout = _Layout(bearings, step, claim, "")
    if float(np.abs(steps - step).max()) > _UNEVEN_SHARE * abs(step):
        return layout._replace(fault="its rays are not spread evenly")
    if layout.cover < _MIN_COVER:
        return layout._replace(fault="its rays cover too narrow a sector")
    return layout


def _displacements(before: Array, after: Array) -> Array:
    """How far each sector (18,) of a scan in cells is displaced in a later one, in rad.

    Counter-clockwise is positive; NaN: unclear.
    """
    around = np.concatenate((before[-_SHIFTS:], before, before[:_SHIFTS]))
    apart = np.lib.stride_tricks.sliding_window_view(around, _CELLS) - after
    np.multiply(apart, apart, out=apart)
    np.minimum(apart, _CLIP**2, out=apart)
    errors = apart.reshape(len(apart), _SECTORS, -1).mean(axis=2)
    best = errors.argmin(axis=0)
    inner = np.minimum(np.maximum(best, 1), len(errors) - 2)
    sectors = np.arange(_SECTORS)
    a, b, c = (errors[inner + by, sectors] for by in (-1, 0, 1))
    contrast = errors.mean(axis=0)
    is_clear = (inner == best) & (b <= _MAX_MISFIT * contrast) & (contrast >= _MIN_CONTRAST**2)
    bend = np.where(is_clear, a - 2.0 * b + c, math.nan)
    places: Array = _CELL * (_SHIFTS - inner - 0.5 * (a - c) / np.where(bend > 0.0, bend, math.nan))
    return places
