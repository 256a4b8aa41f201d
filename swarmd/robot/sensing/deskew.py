"""De-skew: corrects the rays of a rotating sensor for the motion of the robot during the scan.

A rotating sensor measures its rays one after the other, while the robot moves. Odometry gives the
motion between each ray and the newest ray. Each return is moved by this motion, to where the sensor
would see the return at the time of the newest ray (motion distortion correction: Zhang and Singh,
"LOAM: Lidar odometry and mapping in real-time", RSS 2014).

If the robot turns against the direction in which the sensor turns, each scan leaves a sector
unmeasured; rays of the scan before fill this sector. If both turn in the same direction, a sector
is measured twice, and both measurements stay.
"""

from __future__ import annotations

import math
from array import array
from typing import Any

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import TURN
from swarmd.core.buffers import view_of
from swarmd.core.cython_shadow import INFINITY, Doubles
from swarmd.core.values import Array, Scan, ScanSpec, Sweep
from swarmd.robot.sensing.odometry_history import OdometryHistory
from swarmd.robot.sensing.ray_motion import move_rays, rays_in_sector

_MAX_TIMED_RAYS = 8  # objects that are kept


class TimedRays:
    """The bearings of a scan with the ages of its rays in s, and what derives from them."""

    def __init__(self, bearings: Array, ages: Array | None, sweep: Sweep | None) -> None:
        """`ages` as the driver gives them; None: by the `sweep`."""
        self.bearings = bearings
        self.given = ages
        self.sweep = sweep
        self.cos = np.cos(bearings)
        self.sin = np.sin(bearings)
        if ages is None:
            assert sweep is not None
            ages = _ages_of_sweep(bearings, sweep)
        self.ages: Array = ages - ages.min()
        self.ages.flags.writeable = False
        self.span = float(self.ages.max())
        self.mean_age = float(self.ages.mean())
        rising = np.sort(bearings % TURN)
        # rad between neighbouring rays.
        self.spacing = _median(np.diff(rising)) if len(rising) > 1 else TURN
        # How the sensor turns: 1.0 counter-clockwise, -1.0 clockwise, 0.0 neither.
        self.direction, self.oldest = self._direction()

    def _direction(self) -> tuple[float, float]:
        """The direction, and the bearing of the oldest ray."""
        # A driver may give one age to a whole sector: the first ray of each age counts.
        ages, first = np.unique(-self.ages, return_index=True)
        steps = _wrap_each(np.diff(self.bearings[first]))
        if len(steps) < 2 or not (np.all(steps > 0.0) or np.all(steps < 0.0)):
            return 0.0, 0.0
        direction = math.copysign(1.0, steps[0])
        oldest = self.bearings[-self.ages == ages[0]]
        begin = int((direction * _wrap_each(oldest - oldest[0])).argmin())
        return direction, float(oldest[begin])


def _median(values: Array) -> float:
    """The median of at least one finite value, as `np.median`, which loads numpy.ma: 7 ms, 1.1 MB.

    It would do so at the first scan, between two decisions of the robot.
    """
    rising = np.sort(values)
    count = len(rising)
    return 0.5 * float(rising[(count - 1) // 2] + rising[count // 2])


def _wrap_each(angles: Array) -> Array:
    wrapped: Array = (angles + math.pi) % TURN - math.pi
    return wrapped


def _ages_of_sweep(bearings: Array, sweep: Sweep) -> Array:
    """(n,) s from the time at which a sweep measures each ray to its end."""
    rounding = 1e-9  # rad: the first ray must not count as the last one
    turned = (sweep.direction * (bearings - sweep.start) + rounding) % TURN
    ages: Array = sweep.duration * (1.0 - turned / TURN)
    return ages


@cython.cclass
class Deskewer:
    """De-skews the conditioned scans of one sensor. Times in s.

    The returned scan has the ages of its rays, and the age of its newest ray (`newest_age`). The
    ages come from the driver, or else from the platform's `sweep`. Rays are moved except in these
    cases:

    - Without ages, the scan is returned unchanged.
    - If the platform's sweep is unknown, the scan counts as measured at the time of its mean ray,
      unless the driver gives all rays one age. Each ray then has the greatest age against the mean
      ray that is possible: half of the scan period, or of the time that the driver gives a scan.
    - Without odometry that reaches back over the whole scan, rays have ages, but are not moved.
    - At rest, the scan keeps its bearings (the same object).
    """

    _sweep: Sweep | None
    _latency: float
    _stale_after: float
    _unknown_span: float  # s, the scan period if the sweep is unknown, else 0
    _bounds: Array  # (n,) s: the ages of a scan whose sweep is unknown
    _history: OdometryHistory
    _limits: Doubles  # m: x, y of the sensor in the base frame, range_min, range_max
    _sector_args: Doubles  # rad: `sector` of `rays_in_sector`: start, direction, width
    # TimedRays of the bearings and ages of the last scan, which mostly are the same objects again.
    _bearings_of_scan: Array | None
    _ages_of_scan: Array | None
    _ray_ages: Array  # the array of `_ages`
    _bearings: Doubles
    _cos: Doubles
    _sin: Doubles
    _ages: Doubles
    _span: float
    _newest_age: float
    _direction: float
    _oldest: float
    _spacing: float
    _last_scan: Scan | None  # the scan that was returned last
    _last_at: float  # the time of its newest ray
    _filled_count: int  # its first rays, which are those of the scan before it

    def __init__(self, spec: ScanSpec, history: OdometryHistory) -> None:
        self._sweep = spec.sweep
        self._bounds = np.empty(0)
        self._unknown_span = 1.0 / spec.rate if spec.is_sweep_unknown else 0.0
        self._latency = spec.latency
        self._stale_after = spec.stale_after
        self._history = history
        self._last_at = -INFINITY
        self._limits = array("d", (*spec.offset, spec.range_min, spec.range_max))
        self._sector_args = array("d", 3 * [0.0])
        self._bearings = self._limits
        self._cos = self._limits
        self._sin = self._limits
        self._ages = self._limits

    def deskew(self, scan: Scan, now: float, odometry_age: Any, delay: float = 0.0) -> Scan:
        """The scan that arrived at `now`, as the sensor would see it at the time of its newest ray.

        See the class for the ages of the rays, and for cases in which rays are not moved.

        Args:
            scan: the conditioned scan.
            now: s on the robot's clock.
            odometry_age: s since the last reading arrived; None without a fresh reading.
            delay: s by which the scan is older than the platform's `latency` says.
        """
        # 1. The ages of the rays: None if the driver does not give them.
        ages = scan.ages
        if self._unknown_span > 0.0 and not _are_at_once(ages):
            # The order of the rays is not known: no ray is moved, and the platform's latency is the
            # age of the mean ray, for which the whole scan counts.
            bounds = self._bounds_of(len(scan.ranges), ages)
            return _scan_with(scan, scan.ranges, scan.bearings, bounds, self._latency, scan.filled)
        if ages is None and self._sweep is None:
            return scan
        ranges = scan.ranges
        bearings = scan.bearings
        if bearings is not self._bearings_of_scan or ages is not self._ages_of_scan:
            self._set_rays(bearings, ages)

        # 2. Moves the rays to the time of the newest ray, if odometry is fresh. This time includes
        # the measured `delay`; the `newest_age` of the returned scan does not.
        newest_age = self._newest_age + delay
        newest_at = now - newest_age
        moved = None
        if odometry_age is not None:
            seconds_since_reading = odometry_age
            # `now` on the clock of odometry, less the age of the newest ray.
            newest_stamp = self._history.trail.latest + seconds_since_reading - newest_age
            moved = self._move_scan_rays(ranges, newest_stamp, newest_at - self._last_at)

        # 3. The new scan. Its first rays may come from the scan before, see `_move_scan_rays`.
        if moved is None:
            result = _scan_with(
                scan, ranges, bearings, self._ray_ages, self._newest_age, scan.filled
            )
            self._filled_count = 0
        else:
            self._filled_count = len(moved[0]) - len(ranges)
            filled = _behind_borrowed(scan.filled, self._filled_count)
            result = _scan_with(
                scan,
                moved[0],
                moved[1],
                moved[2],
                self._newest_age,
                filled,
                self._filled_count,
            )
        self._last_scan = result
        self._last_at = newest_at
        return result

    def _bounds_of(self, count: int, ages: Array | None) -> Array:
        """(count,) half of the longest time that a scan may take; the same object if it is equal.

        `ages`: as the driver gives them, from which only the time between first and last is taken.
        """
        longest = self._unknown_span
        if ages is not None:
            longest = max(longest, ages.max(initial=0.0))
        if len(self._bounds) != count or (count and self._bounds[0] != 0.5 * longest):
            self._bounds = np.full(count, 0.5 * longest)
            self._bounds.flags.writeable = False
        return self._bounds

    def _set_rays(self, bearings: Array, ages: Array | None) -> None:
        """Take other bearings and ages; with None as ages, the platform's sweep gives them."""
        rays = _timed_rays(bearings, ages, self._sweep)
        self._bearings_of_scan = bearings
        self._ages_of_scan = ages
        self._ray_ages = rays.ages
        self._bearings = view_of(bearings)
        self._ages = view_of(rays.ages)
        self._cos = view_of(rays.cos)
        self._sin = view_of(rays.sin)
        self._span = rays.span
        self._newest_age = max(self._latency - rays.mean_age, 0.0)
        self._direction = rays.direction
        self._oldest = rays.oldest
        self._spacing = rays.spacing

    def _move_scan_rays(self, ranges_of_scan: Array, stamp: float, seconds: float) -> Any:
        """Ranges, bearings and ages (k,) of a scan, moved to the stamp of its newest ray.

        The rays that fill an unmeasured sector come first, so k may exceed n. None if the rays are
        not to be moved: at rest, if odometry does not reach back over the scan, if all rays have
        the same age, or if an unmeasured sector cannot be filled.

        Args:
            ranges_of_scan: (n,) m, the ranges of the scan.
            stamp: s on the clock of odometry, of the newest ray.
            seconds: s from the newest ray of the scan before to the newest ray of this scan.
        """
        history: OdometryHistory = self._history
        path_rows = history.set_path(stamp, self._span)
        if path_rows == 0:
            return None  # at rest, odometry does not reach back, or all rays have one age (span 0)
        # 1. The width in rad of the unmeasured sector; below 0 if the robot turns with the sensor.
        # The last row has the pose at the begin of the scan; the pose at its end has yaw 0.
        yaw_at_begin = history.path[path_rows - 1, 3]
        unmeasured = self._direction * yaw_at_begin
        # A sector below half the angle between two rays lacks no ray.
        lacks_rays = unmeasured > 0.5 * self._spacing
        if lacks_rays and not self._can_fill(stamp, seconds):
            return None

        # 2. Fills the sector with rays of the scan before, the first rays of the result.
        # `_fill_sector` writes the ages of these rays, and behind them those of this scan.
        count = len(self._ages)
        filled_count = 0
        last = self._last_scan if lacks_rays else None
        capacity = count + (0 if last is None else len(last.ranges))
        ages = self._ray_ages  # of this scan; with rays of the scan before: a new array, see below
        ranges = np.empty(capacity)
        bearings = np.empty(capacity)
        distances: Doubles = view_of(ranges)
        angles: Doubles = view_of(bearings)
        if last is not None:
            history.set_motion(stamp - seconds, stamp)
            ages = np.empty(capacity)
            filled_count = self._fill_sector(
                last, unmeasured, seconds, distances, angles, view_of(ages)
            )
            ranges = ranges[: filled_count + count]
            bearings = bearings[: filled_count + count]
            ages = ages[: filled_count + count]

        # 3. Moves the rays of this scan, which follow.
        move_rays(
            view_of(ranges_of_scan),
            self._bearings,
            self._cos,
            self._sin,
            self._ages,
            history.path,
            path_rows,
            self._limits,
            distances[filled_count:],
            angles[filled_count:],
        )
        for values in (ranges, bearings, ages):
            values.setflags(write=False)
        return ranges, bearings, ages

    def _can_fill(self, stamp: float, seconds: float) -> bool:
        """True if the scan before is recent enough to fill the unmeasured sector of this scan."""
        last = self._last_scan
        if last is None or last.ages is None or not 0.0 < seconds <= self._stale_after:
            return False
        return self._history.covers(stamp - seconds)

    def _fill_sector(
        self,
        last: Scan,
        unmeasured: float,
        seconds: float,
        distances: Doubles,
        angles: Doubles,
        ages: Doubles,
    ) -> int:
        """Fill the unmeasured sector with rays of the scan before; the number of these rays.

        Sets distances, angles and ages of these rays, and behind them the ages of this scan. The
        caller must have set the motion between the scans (`set_motion` of the history).

        Args:
            last: the scan before, which has ages.
            unmeasured: rad, the width of the sector.
            seconds: s from the newest ray of the scan before to the newest ray of this scan.
            distances, angles, ages: (k,) m, rad, s; the arrays to fill.
        """
        # The oldest ray was measured at the bearing `_oldest`, and de-skew moves this ray by
        # `unmeasured` in the direction of the sweep. The sector has the bearings that this ray
        # leaves behind. A ray covers half the angle between two rays to each side of its bearing,
        # so the sector begins half this angle before `_oldest`.
        start = self._oldest - 0.5 * self._direction * self._spacing
        self._sector_args[0] = start
        self._sector_args[1] = self._direction
        self._sector_args[2] = unmeasured
        count = rays_in_sector(
            view_of(last.ranges),
            view_of(last.bearings),
            view_of(np.asarray(last.ages)),
            self._filled_count,  # skips rays that filled that scan: else a ray could stay for ever
            self._history.motion,
            self._sector_args,
            self._limits,
            distances,
            angles,
            ages,
        )
        for i in range(count):
            ages[i] += seconds
        for i in range(len(self._ages)):
            ages[count + i] = self._ages[i]
        return count


def _are_at_once(ages: Array | None) -> bool:
    """True if the driver gives all rays one age; `ages` may be None."""
    return ages is not None and len(ages) > 1 and ages.max() == 0.0


# The latest objects: simulated robots of one kind share them, which saves memory.
_kept_rays: list[TimedRays] = []


def _timed_rays(bearings: Array, ages: Array | None, sweep: Sweep | None) -> TimedRays:
    """The `TimedRays` of bearings and ages; kept, and returned again for the same objects."""
    for rays in _kept_rays:
        if rays.bearings is bearings and rays.given is ages and rays.sweep == sweep:
            return rays
    if len(_kept_rays) == _MAX_TIMED_RAYS:
        _kept_rays.pop()
    _kept_rays.insert(0, TimedRays(bearings, ages, sweep))
    return _kept_rays[0]


def _scan_with(
    scan: Scan,
    ranges: Array,
    bearings: Array,
    ages: Array | None,
    newest_age: float,
    filled: Array | None,
    borrowed: int = 0,
) -> Scan:
    """A copy of a scan with other ranges, bearings and ages, and other unmeasured rays."""
    limits = scan.range_min, scan.range_max
    return Scan(scan.seq, scan.stamp, ranges, bearings, *limits, ages, newest_age, filled, borrowed)


def _behind_borrowed(filled: Array | None, borrowed: int) -> Any:
    """`Scan.filled` of a scan before whose rays there are `borrowed` rays of the scan before."""
    if borrowed == 0 or filled is None:
        return filled
    whole = np.concatenate((np.zeros(borrowed), filled))
    whole.setflags(write=False)
    return whole
