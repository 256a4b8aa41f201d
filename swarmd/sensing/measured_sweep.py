"""Measures the order in which a sensor measures its rays, while the robot turns. Pure.

Many drivers of rotating lidars reverse their rays, but still give a positive `time_increment`. So
where the platform has no `scan.sweep`, only the duration of a scan is taken from the ages that a
driver gives its rays, and this module measures the order of the rays:

1. Two scans with half a radian of turn between them are compared. Each sector of the surroundings
   appears displaced by the turn between the two rays that measured it. These turns depend on the
   order of the rays.
2. The displacements are compared with those that odometry predicts for each candidate. Candidates:
   all rays at once; rising or falling order of the message, for the duration that the driver gives,
   for the scan period and for half of it.
3. Orders that begin at another ray than the first ray of the message are candidates, too. If such a
   candidate fits best, no order is set: the platform has to give its sweep.
4. Errors are limited, since objects move (Huber, "Robust Estimation of a Location Parameter",
   1964). After turns to both sides, an order is set if a paired test finds its candidate better
   than each other candidate.
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
_MAX_RANGE = 6.0  # m; farther returns, and rays without a return, count as this range
_MAX_RANGE_DIFFERENCE = 0.3  # m; greater differences of two ranges count as this difference
# m (root of the mean square): the least mean difference over all displacements of a sector.
_MIN_CONTRAST = 0.02
_MAX_MISFIT = 0.5  # share of the mean difference that may remain at the best displacement
_MIN_SECTORS = 8  # with a clear displacement
_MAX_ERROR = 0.1  # rad; greater errors of a displacement count as this error
_MIN_RAYS = 90
_UNEVEN_SHARE = 0.1  # of the mean step, by which each step may differ
# What may differ between scans of one sensor: shares of the claim and of a turn, and rad.
_CLAIM_SHARE, _COVER_SHARE = 0.2, 0.05
_FIRST_BEARING = 0.1
_MIN_COVER = 0.2  # share of a turn
# rad between the two scans of a pair. Less: wheels that turn in the air look like a sensor that
# measures all rays at once. More: a square room looks like itself.
_MIN_TURN, _MAX_TURN = 0.5, 1.2
# rad by which the turn during one scan of a pair differs from the turn during the other.
_MIN_SKEW, _MAX_SKEW = 0.03, 0.4
_MAX_SHIFT = 0.1  # m between the two scans of a pair
_MAX_SCANS = 20  # scans
_SCAN_STRIDE = 4  # once the order is known, every fourth scan is taken,
_CHECK_TURN = 2.0  # and a pair is compared after so many rad of turns
_AT_REST = 0.01  # rad
_SPACING = 0.1  # rad of turn between scans that are kept, and between pairs
_MAX_SCAN_PERIOD = 2.0  # s between the two scans of a pair
_SAME_DURATIONS = 0.8, 1.25  # durations whose ratio is between these are one candidate
_MIN_DURATION_SHARE = 0.25  # of the period: a shorter duration looks like all rays at once
_STARTS = 16  # rays at which the order of a candidate may begin
_MAX_DELAY_CHANGE = 0.05  # s; a greater change of the delay drops all pairs
_MAX_PAIRS = 48  # pairs
_MIN_PAIRS = 8
_MIN_PAIRS_OF_SIDE = 2  # of turns to the left, and of turns to the right
_STANDARD_ERRORS = 5.0  # standard errors by which each other candidate must be worse,
_ERRORS_OF_NEIGHBOR = 2.0  # and those that differ only by one step of the start
_MIN_SPREAD = 0.3  # least standard deviation of the votes
_MIN_BETTER = 0.05  # share of the error by which each other candidate must be worse


class Order(NamedTuple):
    """The order in which a sensor measures the rays of a message."""

    direction: float  # 1.0: from the first ray to the last, -1.0: backwards, 0.0: all at once
    duration: float = 0.0  # s
    start: float = 0.0  # share of the message before the ray that is measured first

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
    """How the rays of a scan lie, and how long a scan takes by its driver."""

    bearings: Array  # (n,) rad, not wrapped
    step: float  # rad from one ray to the next; 0: not known
    claim: float | None  # s by the driver; 0: all rays at once; None: the driver gives no ages
    fault: str  # why no order can be measured; empty if one can

    @property
    def cover(self) -> float:
        """The share of a turn that the rays cover; 1 where their spacing is not known."""
        return 1.0 if self.step == 0.0 else min(abs(self.step) * len(self.bearings) / _TURN, 1.0)

    def is_as(self, before: _Layout) -> bool:
        """True if both layouts may be of the same sensor; the number of rays may vary."""
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


class _ScanAtPose:
    """A scan with the pose of the sensor at its mean ray.

    `at`: s on the clock of odometry, the time of the mean ray. `yaw`: rad, not wrapped, the heading
    at the time `at`. `x`, `y`: m, the place of the sensor; the place at the arrival of the scan is
    used, since a pair of scans needs a robot that hardly moves. `skew`: rad, the turn of the robot
    during the scan.
    """

    def __init__(
        self, scan: Scan, layout: _Layout, at: float, headings: Headings, sensor: Pose, skew: float
    ) -> None:
        self.at, self.skew = at, skew
        self._layout, self._headings = layout, headings
        self.x, self.y = sensor.x, sensor.y
        self.yaw = sensor.yaw
        known = np.flatnonzero(scan.ranges >= scan.range_min)
        self._known = known if layout.step > 0.0 else known[::-1]  # by rising bearing
        self._ranges = np.minimum(scan.ranges, min(scan.range_max, _MAX_RANGE))[self._known]

    def cells(self, x: float, y: float) -> Array:
        """Ranges (360,) in m by heading, as seen from a place, if all rays had the same time.

        NaN for headings outside the sector that the rays cover.
        """
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

    def is_comparable(self, after: _ScanAtPose) -> bool:
        """True if this scan and a later scan make a pair: turned enough, and hardly moved."""
        return (
            0.0 < after.at - self.at < _MAX_SCAN_PERIOD
            and _MIN_TURN < abs(after.yaw - self.yaw) < _MAX_TURN
            and abs(after.skew - self.skew) < _MAX_SKEW
            and math.hypot(after.x - self.x, after.y - self.y) < _MAX_SHIFT
        )

    def turns(self, candidates: _Candidates) -> Array:
        """The turn (c, 18) in rad from the mean ray to the ray in each sector, by candidate."""
        layout = self._layout
        span = layout.step * len(layout.bearings)
        place = ((_CENTRES - self.yaw - layout.bearings[0]) % math.copysign(_TURN, span)) / span
        times = self.at + candidates.since(place)
        turns: Array = np.interp(times, *self._headings) - self.yaw
        return turns


class _Candidates:
    """The candidate orders. An order whose `start` is not 0 is compared, but never set."""

    def __init__(self, orders: tuple[Order, ...]) -> None:
        self.orders = orders
        columns = np.array(orders)[:, :, None]
        self._directions, self._durations, self._starts = columns.swapaxes(0, 1)

    def is_neighbor(self, index: int) -> NDArray[np.bool_]:
        """(c,) which candidates equal candidate `index`, or differ by one step of the start."""
        apart = np.abs((self._starts - self._starts[index] + 0.5) % 1.0 - 0.5) < 1.5 / _STARTS
        alike = (self._directions == self._directions[index]) & apart
        return np.ravel(alike & (self._durations == self._durations[index]))

    def since(self, place: Array) -> Array:
        """(c, k) s from the mean ray to the ray at the share `place` (k,) of the message."""
        is_falling = self._directions < 0.0
        place = np.where(is_falling, 1.0 - place, place)
        since: Array = self._durations * ((place - self._starts) % 1.0 - 0.5)
        return since


class MeasuredSweep:
    """Measures the order of one sensor's rays. Times in s.

    `order` is None while the order is not known. If the driver says that all rays are measured at
    once, the order is AT_ONCE. If the layout of the rays changes, the measurement begins anew. If
    later turns contradict the order, the order is None again.
    """

    def __init__(self, spec: ScanSpec) -> None:
        self._period, self._offset = 1.0 / spec.rate, spec.offset
        self.order: Order | None = None
        self._layout: _Layout | None = None  # of the last scan
        self._given_rays: tuple[Array | None, Array | None] = None, None  # its bearings and ages
        self._ages: Array | None = None  # the result of `ages`; None: not computed yet
        self._candidates = _Candidates((AT_ONCE,))
        self._stored_scans: deque[_ScanAtPose] = deque(maxlen=_MAX_SCANS)
        self._yaw = 0.0  # rad, the heading at the last scan
        self._turned = 0.0  # rad of turns since the last pair
        self._scan_count = 0
        self._pair_count = 0  # the pairs by which the order was set
        self._mean_errors: deque[Array] = deque(maxlen=_MAX_PAIRS)  # of each pair: (c,) rad
        self._sides: deque[float] = deque(maxlen=_MAX_PAIRS)  # of these pairs: 1.0 left, -1.0 right
        self._delay = 0.0  # s, by which the stored scans got their times
        self._reason = ""  # why the order is not known

    def ages(self, scan: Scan) -> Array:
        """(n,) s by which each ray is older than the newest ray.

        While the order is not known, all rays get the same age: half of the duration of a scan,
        the most by which a ray can be older than the mean ray. The array stays the same object
        until the layout of the rays or the order changes.
        """
        self._update_layout(scan)
        if self._ages is None:
            count = len(scan.ranges)
            if self.order is None:
                self._ages = np.full(count, 0.5 * self._longest_scan())
                self._ages.flags.writeable = False
            else:
                self._ages = self.order.ages(count)
        return self._ages

    def on_scan(
        self, scan: Scan, arrival: float, delay: float, headings: Headings, base: Pose
    ) -> None:
        """Take in a raw scan: compare it with the stored scan whose skew differs most.

        The skew is the turn of the robot during a scan. Two scans with different skews show in
        which order the sensor measures its rays. Ignores scans that show nothing new, and most
        scans once the order is known.

        Args:
            scan: the raw scan.
            arrival: s on the clock of odometry.
            delay: s from the mean ray of the scan to the arrival.
            headings: the headings of the robot by odometry.
            base: the pose of the base when the scan arrived.
        """
        layout = self._update_layout(scan)
        half = 0.5 * self._longest_scan()  # s from the mean ray to the oldest and the newest ray
        self._scan_count += 1
        if abs(delay - self._delay) > _MAX_DELAY_CHANGE:
            # The stored scans got their times, and so their headings, by a wrong delay.
            self._delay = delay
            self._forget_pairs()
        if self.order is not None and self._scan_count % _SCAN_STRIDE:
            return
        time = arrival - delay  # of the mean ray
        are_all_at_once = layout.claim == 0.0  # by the driver
        began_before_headings = time - half < headings.times[0]
        if layout.fault or are_all_at_once or began_before_headings:
            return
        begin_yaw, yaw, end_yaw = np.interp((time - half, time, time + half), *headings).tolist()
        skew = end_yaw - begin_yaw
        # A jump of the heading counts as _MAX_TURN at most.
        self._turned += min(abs(yaw - self._yaw), _MAX_TURN)
        self._yaw = yaw
        if self._repeats_last(time, yaw, skew):
            return
        cos, sin = math.cos(base.yaw), math.sin(base.yaw)
        ahead, left = self._offset
        sensor = Pose(base.x + cos * ahead - sin * left, base.y + sin * ahead + cos * left, yaw)
        scan_at_pose = _ScanAtPose(scan, layout, time, headings, sensor, skew)
        partner = self._partner_of(scan_at_pose)
        self._store(scan_at_pose)
        needed_turn = _SPACING if self.order is None else _CHECK_TURN
        if partner is not None and self._turned > needed_turn:
            self._turned = 0.0
            self._compare(partner, scan_at_pose)

    def _repeats_last(self, time: float, yaw: float, skew: float) -> bool:
        """True for a scan that repeats the newest stored scan, since the robot is at rest.

        `time`: s, of the mean ray. `yaw`, `skew`: rad. False after half of _MAX_SCAN_PERIOD: then a
        repeat is stored, so that a scan of a later turn has a partner.
        """
        if not self._stored_scans:
            return False
        newest = self._stored_scans[-1]
        is_fresh = 0.0 < time - newest.at < 0.5 * _MAX_SCAN_PERIOD
        return is_fresh and abs(yaw - newest.yaw) + abs(skew) < _AT_REST

    def _partner_of(self, scan: _ScanAtPose) -> _ScanAtPose | None:
        """The comparable stored scan whose skew differs most, and by more than _MIN_SKEW."""
        partner, greatest_difference = None, _MIN_SKEW
        for earlier in self._stored_scans:
            difference = abs(scan.skew - earlier.skew)
            if difference > greatest_difference and earlier.is_comparable(scan):
                partner, greatest_difference = earlier, difference
        return partner

    def _store(self, scan: _ScanAtPose) -> None:
        """Store the newest scan. All scans before the newest stay _SPACING apart in heading."""
        stored = self._stored_scans
        if len(stored) > 1:
            before_newest = stored[-2]
            is_newest_needed = abs(scan.yaw - before_newest.yaw) >= _SPACING
            if not is_newest_needed:
                stored.pop()
        stored.append(scan)

    def forget_scans(self) -> None:
        """Drop the kept scans, as when the clock of odometry was set."""
        self._stored_scans.clear()

    def figure(self) -> SweepFigure:
        """The measured order for the status, or the reason why the order is not known."""
        order, layout = self.order, self._layout
        if layout is None or order is None:
            return SweepFigure(samples=len(self._mean_errors), text=self._reason or "no scan yet")
        if order == AT_ONCE:
            return SweepFigure(direction="at once", samples=self._pair_count)
        first = layout.bearings[0 if order.direction > 0.0 else -1]
        return SweepFigure(
            direction="ccw" if order.direction * layout.step > 0.0 else "cw",
            start_deg=round(math.degrees(math.remainder(float(first), _TURN)), 1),
            duration=order.duration / layout.cover,
            samples=self._pair_count,
        )

    def _longest_scan(self) -> float:
        """The longest time in s that a scan may take, by its driver and by its rate."""
        assert self._layout is not None
        return max(self._layout.claim or 0.0, self._period * self._layout.cover)

    def _update_layout(self, scan: Scan) -> _Layout:
        """The layout of a scan; a layout of another sensor begins the measurement anew."""
        given, layout = self._given_rays, self._layout
        is_known = layout is not None and _is_same(given[0], scan.bearings)
        if layout is not None and is_known and _is_same(given[1], scan.ages):
            return layout
        before, layout = layout, _layout_of(scan)
        self._given_rays, self._layout = (scan.bearings, scan.ages), layout
        if self.order is None or before is None or len(before.bearings) != len(layout.bearings):
            self._ages = None
        if before is None or not layout.is_as(before):
            self._begin(layout)
        return layout

    def _begin(self, layout: _Layout) -> None:
        """Begin the measurement anew, with the candidates for a layout (module docstring, 2, 3)."""
        self.order = AT_ONCE if layout.claim == 0.0 else None
        self._ages, self._pair_count = None, 0
        self._forget_pairs()
        self._reason = layout.fault or "it has not turned enough to both sides yet"
        period, claim = self._period * layout.cover, layout.claim or 0.0
        durations = [period, 0.5 * period]
        if claim > _MIN_DURATION_SHARE * period:
            unlike = [
                time
                for time in durations
                if not _SAME_DURATIONS[0] < claim / time < _SAME_DURATIONS[1]
            ]
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
        self._stored_scans.clear()
        self._mean_errors.clear()
        self._sides.clear()

    def _compare(self, before: _ScanAtPose, after: _ScanAtPose) -> None:
        """Add the mean error of each candidate for the displacements between two scans."""
        moved = _displacements(before.cells(before.x, before.y), after.cells(before.x, before.y))
        is_known = np.isfinite(moved)
        if np.count_nonzero(is_known) < _MIN_SECTORS:
            return
        candidates = self._candidates
        errors = moved + after.turns(candidates) - before.turns(candidates)
        errors = errors[:, is_known]
        # A late or scaled heading of odometry displaces all sectors alike: subtract the median.
        errors -= np.median(errors, axis=1, keepdims=True)
        self._mean_errors.append(np.minimum(np.abs(errors), _MAX_ERROR).mean(axis=1))
        self._sides.append(math.copysign(1.0, after.yaw - before.yaw))
        self._decide()

    def _decide(self) -> None:
        """Set the order if a single candidate fits better than all others in a paired test.

        The order is unknown again if the pairs of scans contradict the present order.
        """
        # (p, c) the mean error of each candidate for each pair, and the side of each turn.
        rows, sides = np.array(self._mean_errors), np.array(self._sides)
        is_left = sides > 0.0
        left_count = int(np.count_nonzero(is_left))
        if len(rows) < _MIN_PAIRS or min(left_count, len(rows) - left_count) < _MIN_PAIRS_OF_SIDE:
            return

        best = int(rows.mean(axis=0).argmin())
        is_worse = self._is_worse(rows, best, is_left)
        order = self._order_by(best, is_worse)
        if order != self.order:
            self.order, self._ages = order, None
            self._pair_count = len(rows)
            self._forget_pairs()

    def _is_worse(self, rows: Array, best: int, is_left: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(c,) whether each candidate is worse than candidate `best`, by a paired test.

        `rows`: (p, c) rad, the mean error of each candidate for each pair of scans. `is_left`: (p,)
        the pairs of turns to the left. A candidate is worse if three measures say so: the mean
        vote, the mean error, and the mean errors of turns to each side. Each pair votes between -1
        (better) and 1 (worse) on each candidate.
        """
        worse_by = rows - rows[:, best : best + 1]
        # Pairs differ much in their errors. So a vote is the difference in units of the median
        # difference, limited to 1: it counts how often a candidate is worse, not by how much.
        usual_difference = np.maximum(np.median(np.abs(worse_by), axis=0), 1e-9)
        votes = np.minimum(np.maximum(worse_by / usual_difference, -1.0), 1.0)
        standard_errors = np.maximum(votes.std(axis=0, ddof=1), _MIN_SPREAD) / math.sqrt(len(rows))
        # A neighbour, one step of the start away, fits nearly as well: fewer errors suffice.
        needed_errors = np.where(
            self._candidates.is_neighbor(best), _ERRORS_OF_NEIGHBOR, _STANDARD_ERRORS
        )
        is_worse: NDArray[np.bool_] = votes.mean(axis=0) > needed_errors * standard_errors
        is_worse &= worse_by.mean(axis=0) > _MIN_BETTER * rows.mean(axis=0)[best]
        is_worse &= (worse_by[is_left].mean(axis=0) > 0.0) & (worse_by[~is_left].mean(axis=0) > 0.0)
        return is_worse

    def _order_by(self, best: int, is_worse: NDArray[np.bool_]) -> Order | None:
        """The order by the candidate `best`, and by which candidates are worse; sets the reason."""
        orders = self._candidates.orders
        if np.count_nonzero(is_worse) == len(is_worse) - 1:  # all other candidates are worse
            if orders[best].start == 0.0:
                self._reason = ""
                return orders[best]
            self._reason = "its rays do not follow one another in the message's order"
            return None
        is_contradicted = self.order is not None and is_worse[orders.index(self.order)]
        if is_contradicted:
            return None
        self._reason = "its turns do not tell one order of rays from another yet"
        return self.order


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


def _displacements(earlier: Array, later: Array) -> Array:
    """The displacement (18,) in rad of each sector from one scan to a later scan.

    `earlier` and `later`: (360,) ranges in m, one for each degree of heading (`_ScanAtPose.cells`);
    a sector has 20 of these. The displacement of a sector is the shift at which the ranges of both
    scans differ least (mean squared difference), refined by a parabola. Counter-clockwise is
    positive. NaN: the minimum is not clear.
    """
    wrapped = np.concatenate((earlier[-_SHIFTS:], earlier, earlier[:_SHIFTS]))
    differences = np.lib.stride_tricks.sliding_window_view(wrapped, _CELLS) - later
    np.multiply(differences, differences, out=differences)
    np.minimum(differences, _MAX_RANGE_DIFFERENCE**2, out=differences)
    errors = differences.reshape(len(differences), _SECTORS, -1).mean(axis=2)
    best = errors.argmin(axis=0)
    inner = np.minimum(np.maximum(best, 1), len(errors) - 2)
    sectors = np.arange(_SECTORS)
    before, least, after = (errors[inner + offset, sectors] for offset in (-1, 0, 1))
    contrast = errors.mean(axis=0)
    is_clear = (inner == best) & (least <= _MAX_MISFIT * contrast) & (contrast >= _MIN_CONTRAST**2)
    curvature = np.where(is_clear, before - 2.0 * least + after, math.nan)
    displacements: Array = _CELL * (
        _SHIFTS - inner - 0.5 * (before - after) / np.where(curvature > 0.0, curvature, math.nan)
    )
    return displacements
