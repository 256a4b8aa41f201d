"""De-skew: the rays of a rotating sensor as it would see them all at the time of the newest ray.

A rotating sensor measures its rays one after the other, and the robot moves meanwhile. Odometry
gives the motion between each ray and the newest one; each return is moved by it (motion distortion
correction: Zhang and Singh, "LOAM: Lidar odometry and mapping in real-time", RSS 2014).

A robot that turns against the sensor leaves a sector unmeasured in each scan: rays of the scan
before fill it. A robot that turns with the sensor measures a sector twice, and both stay.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from swarmd.core.kernels import load_kernel
from swarmd.core.values import Array, Odometry, Scan, ScanSpec, Sweep
from swarmd.sensing.measured_sweep import MeasuredSweep
from swarmd.sensing.odometry_history import OdometryHistory, relative

AT_REST = 5e-4
"""m and rad during one scan: a robot that moves less is at rest, and its scan is not changed."""

_TURN = 2.0 * math.pi


class Deskewer:
    """De-skews the conditioned scans of one sensor. Times in s.

    The returned scan has `ages` and `newest_age`. The ages are those of the driver, else those of
    the platform's `sweep`; without either the scan is returned as it is. With `measured` the ages
    are those of the measured sweep; while the sweep is not known, the rays stay where they were
    measured, the scan has the time of its mean ray, and each ray counts as old as the oldest one
    may be. Without odometry that reaches back over the whole scan the rays stay where they were
    measured, and the ages alone say how old each one is. At rest the scan keeps its bearings, the
    same object.
    """

    def __init__(self, spec: ScanSpec, measured: MeasuredSweep | None = None) -> None:
        self._spec, self._measured = spec, measured
        self._limits = *spec.offset, spec.range_min, spec.range_max
        self._history = OdometryHistory()
        self._rays: _Rays | None = None
        self._last: Scan | None = None
        self._last_at = -math.inf  # the time of its newest ray
        self._filled = 0  # its first rays, which are those of the scan before it
        self._kernel = load_kernel("swarmd.sensing.scans")

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a measured pose."""
        self._history.update(odometry)

    def deskew(
        self, scan: Scan, now: float, odometry_age: float | None, delay: float = 0.0
    ) -> Scan:
        """The scan that arrived at `now`, as seen at the time of its newest ray.

        `odometry_age`: s since the last reading arrived; None without a fresh one. `delay`: s by
        which the scan is older than the platform's `latency` says.
        """
        if self._measured is not None:
            ages, is_known = self._measured.ages(scan), self._measured.order is not None
            scan = replace(scan, ages=ages, newest_age=self._spec.latency)
            if not is_known:
                self._last, self._last_at = scan, now - self._spec.latency - delay
                self._filled = 0
                return scan
        rays = self._rays_of(scan)
        if rays is None:
            return scan
        ago = rays.newest_age + delay
        result, latest = None, self._history.latest
        if odometry_age is not None and latest is not None:
            stamp = latest.stamp + odometry_age - ago
            result = self._moved(scan, rays, stamp, now - ago)
        if result is None:
            result = rays.scan(scan, scan.ranges, scan.bearings, rays.ages)
        self._filled = len(result.ranges) - len(scan.ranges)
        self._last, self._last_at = result, now - ago
        return result

    def _rays_of(self, scan: Scan) -> _Rays | None:
        """The rays of the scan; the same object for the same bearings and ages."""
        sweep = self._spec.sweep
        if scan.ages is None and sweep is None:
            return None
        rays = self._rays
        if rays is None or rays.bearings is not scan.bearings or rays.given is not scan.ages:
            rays = self._rays = _Rays(scan, sweep, self._spec.latency)
        return rays

    def _moved(self, scan: Scan, rays: _Rays, stamp: float, at: float) -> Scan | None:
        """The scan with each return moved to the time of the newest ray: `stamp` of odometry, `at`.

        None at rest, without odometry, if all rays are of one instant, and if nothing fills an
        unmeasured sector.
        """
        path = self._history.path(stamp, rays.span) if rays.span else None
        if path is None or _is_at_rest(path):
            return None
        ages, way = rays.ages, np.array(path)
        ranges, bearings = self._kernel.move_rays(
            scan.ranges, rays.bearings, rays.cos, rays.sin, ages, way, self._limits
        )
        unmeasured = rays.direction * path[-1][3]
        if unmeasured > 0.5 * rays.spacing:
            before = self._before(rays, unmeasured, stamp, at)
            if before is None:
                return None
            ranges = np.concatenate((before[0], ranges))
            bearings = np.concatenate((before[1], bearings))
            ages = np.concatenate((before[2], ages))
        for array in ranges, bearings, ages:
            array.flags.writeable = False
        return rays.scan(scan, ranges, bearings, ages)

    def _before(
        self, rays: _Rays, unmeasured: float, stamp: float, at: float
    ) -> tuple[Array, Array, Array] | None:
        """Ranges, bearings and ages of the last scan's rays in the sector that this scan lacks.

        The sector begins at the bearing of the oldest ray and is `unmeasured` rad wide.
        """
        last, elapsed = self._last, at - self._last_at
        if last is None or last.ages is None or not 0.0 < elapsed <= self._spec.stale_after:
            return None
        if not self._history.covers(stamp - elapsed):
            return None
        way = relative(self._history.pose(stamp - elapsed), self._history.pose(stamp))
        sector = rays.oldest - 0.5 * rays.direction * rays.spacing, rays.direction, unmeasured
        ranges, bearings, ages = self._kernel.rays_in_sector(
            *(last.ranges, last.bearings, last.ages),
            self._filled,  # or a ray could be passed on for ever
            *((way.x, way.y, way.yaw), sector, self._limits),
        )
        return ranges, bearings, ages + elapsed


def _is_at_rest(path: list[tuple[float, float, float, float]]) -> bool:
    return all(
        -AT_REST <= x <= AT_REST and -AT_REST <= y <= AT_REST and -AT_REST <= yaw <= AT_REST
        for _, x, y, yaw in path
    )


class _Rays:
    """The bearings of a scan with the ages (n,) of its rays in s, and what derives from them.

    `given`: the driver's ages. `span`: the age of the oldest ray, whose bearing is `oldest`.
    `direction` in which the sensor turns: 1.0 counter-clockwise, -1.0 clockwise, 0.0 neither.
    `spacing` between neighbouring rays in rad.
    """

    def __init__(self, scan: Scan, sweep: Sweep | None, latency: float) -> None:
        self.bearings, self.given = scan.bearings, scan.ages
        if scan.ages is None:
            assert sweep is not None
            ages = _ages_of_sweep(scan.bearings, sweep)
        else:
            ages = scan.ages
        self.ages: Array = ages - ages.min()
        self.ages.flags.writeable = False
        self.span = float(self.ages.max())
        self.newest_age = max(latency - float(self.ages.mean()), 0.0)
        self.cos, self.sin = np.cos(scan.bearings), np.sin(scan.bearings)
        rising = np.sort(scan.bearings % _TURN)
        self.spacing = float(np.median(np.diff(rising))) if len(rising) > 1 else _TURN
        self.direction, self.oldest = self._direction()

    def scan(self, raw: Scan, ranges: Array, bearings: Array, ages: Array) -> Scan:
        """The scan with other rays, at the time of its newest ray."""
        limits = raw.range_min, raw.range_max
        return Scan(raw.seq, raw.stamp, ranges, bearings, *limits, ages, self.newest_age)

    def _direction(self) -> tuple[float, float]:
        """The direction, and the bearing of the oldest ray."""
        # Rays of one age, if the driver tells the ages of whole sectors, count as one.
        ages, first = np.unique(-self.ages, return_index=True)
        steps = _wrap(np.diff(self.bearings[first]))
        if len(steps) < 2 or not (np.all(steps > 0.0) or np.all(steps < 0.0)):
            return 0.0, 0.0
        direction = math.copysign(1.0, steps[0])
        oldest = self.bearings[-self.ages == ages[0]]
        begin = int((direction * _wrap(oldest - oldest[0])).argmin())
        return direction, float(oldest[begin])


def _wrap(angles: Array) -> Array:
    wrapped: Array = (angles + math.pi) % _TURN - math.pi
    return wrapped


def _ages_of_sweep(bearings: Array, sweep: Sweep) -> Array:
    """(n,) s from the time at which a sweep measures each ray to its end."""
    rounding = 1e-9  # rad: the first ray must not count as the last one
    turned = (sweep.direction * (bearings - sweep.start) + rounding) % _TURN
    ages: Array = sweep.duration * (1.0 - turned / _TURN)
    return ages
