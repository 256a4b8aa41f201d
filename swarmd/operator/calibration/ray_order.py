"""Measures the order in which a sensor measures its rays, by scans of a turning robot. Pure.

Many drivers of rotating lidars reverse their rays, but still give a positive `time_increment`, so
the messages do not tell the order.

1. Each sector of the surroundings appears displaced, against a scan at rest, by the turn between
   the mean ray and the ray that measured the sector. These turns depend on the order of the rays.
2. The displacements are compared with those that odometry predicts for each candidate: all rays at
   once; rising or falling order of the message, with several durations of a scan.
3. Orders that begin at another ray than the first ray of the message are candidates, too. If such a
   candidate fits best, there is no order: the platform has to give its sweep.
4. Errors are limited, since objects move (Huber, "Robust Estimation of a Location Parameter",
   1964). An order counts if a paired test finds each other candidate worse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array, Scan
from swarmd.operator.calibration.figures import SweepFigure

_TURN = 2.0 * math.pi
_CELLS = 360
_CELL = _TURN / _CELLS
_GRID: Array = _CELL * np.arange(_CELLS, dtype=np.float64)
_SECTORS = 18
_CENTRES: Array = _TURN / _SECTORS * (np.arange(_SECTORS, dtype=np.float64) + 0.5) - 0.5 * _CELL
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
_MIN_SKEW = 0.03  # rad, the turn of the robot during a scan
_MIN_SCANS = 8
_MIN_SCANS_OF_SIDE = 2  # of turns to the left, and of turns to the right
_STARTS = 16  # rays at which the order of a candidate may begin
_WHOLE_TURN = 0.95  # share of a turn; rays that cover more may begin anywhere
_SHARES = 0.1 * np.arange(2, 13)  # durations of candidates, as shares of the scan period
_SAME_DURATION = 0.15  # share by which a duration differs from the period that counts as it
_STANDARD_ERRORS = 5.0  # standard errors by which each other candidate must be worse,
_ERRORS_OF_NEIGHBOR = 2.0  # and those that differ only by one step of the start
_MIN_SPREAD = 0.3  # least standard deviation of the votes
_MIN_BETTER = 0.05  # share of the error by which each other candidate must be worse


class RayOrder:
    """Compares scans of one sensor with the surroundings as it has seen them at rest.

    All headings are in rad from the heading at rest, not wrapped. Times in s of one clock.
    """

    def __init__(
        self, looks: Sequence[Scan], offset: tuple[float, float], period: float, headings: Array
    ) -> None:
        """`looks`: scans at rest. `period`: of scans. `headings`: (k, 2) rising times, headings.

        `offset`: m, of the sensor in the base frame.
        """
        self._offset = offset
        self._period = period
        self._times, self._yaws = headings.T
        self._bearings = np.unwrap(looks[0].bearings)
        self._rows: list[Array] = []  # of each scan: (c,) rad, the mean errors of the candidates
        self._sides: list[float] = []  # of each scan: rad, the turn of the robot during the scan
        self._why = ""
        count = len(self._bearings)
        steps = np.diff(self._bearings)
        step = float(steps.mean()) if count > 1 else 1.0
        self._span = step * count  # rad that the rays cover
        if count < _MIN_RAYS or np.abs(steps - step).max() > _UNEVEN_SHARE * abs(step):
            self._why = "its rays are too few, or not spread evenly"
            return
        self._reference = np.median([self._cells(look, 0.0) for look in looks], axis=0)
        cover = min(abs(self._span) / _TURN, 1.0)
        # A scan of less than a turn begins beside the sector without rays.
        starts = _STARTS if cover > _WHOLE_TURN else 1
        self._candidates = np.array(
            [(0.0, 0.0, 0.0)]
            + [
                (direction, share * period * cover, k / _STARTS)
                for share in _SHARES
                for direction in (1.0, -1.0)
                for k in range(starts)
            ]
        )  # (c, 3): direction in the message, s of its rays, share of the message before the start

    def add(self, scan: Scan, at: float) -> None:
        """Compare a scan whose mean ray was measured at the time `at`."""
        if self._why:
            return
        half = 0.5 * self._period
        begin, yaw, end = np.interp((at - half, at, at + half), self._times, self._yaws).tolist()
        if abs(end - begin) < _MIN_SKEW:
            return
        moved = _displacements(self._reference, self._cells(scan, yaw))
        is_known = np.isfinite(moved)
        if np.count_nonzero(is_known) < _MIN_SECTORS:
            return
        # The turn (c, 18) from the mean ray to the ray in each sector, by candidate.
        direction, duration, start = self._candidates.T[:, :, None]
        place = self._place(_CENTRES - yaw)
        place = np.where(direction < 0.0, 1.0 - place, place)
        since = duration * ((place - start) % 1.0 - 0.5)
        turns = np.interp(at + since, self._times, self._yaws) - yaw
        errors = (moved + turns)[:, is_known]
        # A late or scaled heading of odometry displaces all sectors alike: subtract the median.
        errors -= np.median(errors, axis=1, keepdims=True)
        self._rows.append(np.minimum(np.abs(errors), _MAX_ERROR).mean(axis=1))
        self._sides.append(end - begin)

    def figure(self) -> SweepFigure:
        """The sweep that fits all scans, or the reason why no sweep fits."""
        if self._why:
            return SweepFigure(why=self._why)
        is_left = np.array(self._sides) > 0.0
        count = len(is_left)
        left_count = int(np.count_nonzero(is_left))
        if count < _MIN_SCANS or min(left_count, count - left_count) < _MIN_SCANS_OF_SIDE:
            return SweepFigure(why="too few scans during fast turns to both sides show it")
        rows = np.array(self._rows)
        best = int(rows.mean(axis=0).argmin())
        if not self._is_worse(rows, best, is_left).all():
            return SweepFigure(why="the turns do not tell one order of rays from another")
        direction, duration, start = self._candidates[best].tolist()
        if start:
            return SweepFigure(why="its rays do not follow one another in the message's order")
        if not direction:
            return SweepFigure("null", count)
        duration /= min(abs(self._span) / _TURN, 1.0)
        if abs(duration - self._period) < _SAME_DURATION * self._period:
            duration = self._period
        turn = "ccw" if direction * self._span > 0.0 else "cw"
        first = float(self._bearings[0 if direction > 0.0 else -1])
        start_deg = round(math.degrees(math.remainder(first, _TURN)), 1) + 0.0
        value = f"{{start_deg: {start_deg:g}, direction: {turn}, duration: {duration:.3g}}}"
        return SweepFigure(value, count)

    def _is_worse(self, rows: Array, best: int, is_left: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(c,) whether each candidate is worse than candidate `best`, by a paired test.

        `rows`: (m, c) rad, the mean error of each candidate for each scan. `is_left`: (m,) the
        scans of turns to the left. A candidate is worse if three measures say so: the mean vote,
        the mean error, and the mean errors of turns to each side. Each scan votes between -1
        (better) and 1 (worse) on each candidate. True, too, for candidates that differ from `best`
        only by the duration.
        """
        worse_by = rows - rows[:, best : best + 1]
        # Scans differ much in their errors. So a vote is the difference in units of the median
        # difference, limited to 1: it counts how often a candidate is worse, not by how much.
        usual_difference = np.maximum(np.median(np.abs(worse_by), axis=0), 1e-9)
        votes = np.clip(worse_by / usual_difference, -1.0, 1.0)
        standard_errors = np.maximum(votes.std(axis=0, ddof=1), _MIN_SPREAD) / math.sqrt(len(rows))
        # A neighbour, one step of the start away, fits nearly as well: fewer errors suffice.
        directions, _, starts = self._candidates.T
        apart = np.abs((starts - starts[best] + 0.5) % 1.0 - 0.5)
        is_neighbor = (directions == directions[best]) & (apart < 1.5 / _STARTS)
        needed = np.where(is_neighbor, _ERRORS_OF_NEIGHBOR, _STANDARD_ERRORS) * standard_errors
        is_worse = votes.mean(axis=0) > needed
        is_worse &= worse_by.mean(axis=0) > _MIN_BETTER * rows.mean(axis=0)[best]
        is_worse &= (worse_by[is_left].mean(axis=0) > 0.0) & (worse_by[~is_left].mean(axis=0) > 0.0)
        worse: NDArray[np.bool_] = is_worse | (is_neighbor & (apart == 0.0))
        return worse

    def _place(self, bearings: Array) -> Array:
        """(k,) where the rays of the bearings in rad are in the message: 0 first, 1 behind it."""
        past = (bearings - self._bearings[0]) % math.copysign(_TURN, self._span)
        return np.asarray(past / self._span)

    def _cells(self, scan: Scan, yaw: float) -> Array:
        """Ranges (360,) in m by heading, as seen from the place of the sensor at rest.

        All rays count as measured at the heading `yaw` in rad. NaN for headings outside the sector
        that the rays cover.
        """
        known = scan.ranges >= scan.range_min
        ranges = np.minimum(scan.ranges[known], min(scan.range_max, _MAX_RANGE))
        if not len(ranges):
            return np.full(_CELLS, math.nan)
        headings = scan.bearings[known] + yaw
        cos = math.cos(yaw)
        sin = math.sin(yaw)
        ahead, left = self._offset
        x = cos * ahead - sin * left - ahead + ranges * np.cos(headings)
        y = sin * ahead + cos * left - left + ranges * np.sin(headings)
        cells = np.interp(_GRID, np.arctan2(y, x), np.hypot(x, y), period=_TURN)
        cells[self._place(_GRID - yaw) > 1.0] = math.nan
        return np.asarray(cells)


def _displacements(earlier: Array, later: Array) -> Array:
    """The displacement (18,) in rad of each sector from one scan to a later scan.

    `earlier` and `later`: (360,) ranges in m, one for each degree of heading (`RayOrder._cells`); a
    sector has 20 of these. The displacement of a sector is the shift at which the ranges of both
    scans differ least (mean squared difference), refined by a parabola. Counter-clockwise is
    positive. NaN: the minimum is not clear.
    """
    wrapped = np.concatenate((earlier[-_SHIFTS:], earlier, earlier[:_SHIFTS]))
    differences = np.lib.stride_tricks.sliding_window_view(wrapped, _CELLS) - later
    errors = np.minimum(differences**2, _MAX_RANGE_DIFFERENCE**2)
    errors = errors.reshape(len(errors), _SECTORS, -1).mean(axis=2)
    best = errors.argmin(axis=0)
    inner = np.clip(best, 1, len(errors) - 2)
    sectors = np.arange(_SECTORS)
    before, least, after = (errors[inner + offset, sectors] for offset in (-1, 0, 1))
    contrast = errors.mean(axis=0)
    is_clear = (inner == best) & (least <= _MAX_MISFIT * contrast) & (contrast >= _MIN_CONTRAST**2)
    curvature = np.where(is_clear, before - 2.0 * least + after, math.nan)
    displacements: Array = _CELL * (
        _SHIFTS - inner - 0.5 * (before - after) / np.where(curvature > 0.0, curvature, math.nan)
    )
    return displacements
