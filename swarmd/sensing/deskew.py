"""De-skew: the rays of a rotating sensor as it would see them all at the time of the newest ray.

A rotating sensor measures its rays one after the other, and the robot moves meanwhile. Odometry
gives the motion between each ray and the newest one; each return is moved by it (motion distortion
correction: Zhang and Singh, "LOAM: Lidar odometry and mapping in real-time", RSS 2014).

A robot that turns against the sensor leaves a sector unmeasured in each scan: rays of the scan
before fill it. A robot that turns with the sensor measures a sector twice, and both stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from swarmd.core.kernels import load_kernel
from swarmd.core.values import Array, Odometry, Scan, ScanSpec, Sweep
from swarmd.sensing.measured_sweep import MeasuredSweep

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
        self._motion = load_kernel("swarmd.sensing.scans").RayMotion(spec)
        self.on_odometry: Callable[[Odometry], None] = self._motion.update
        """Takes in a measured pose."""
        self._rays: Rays | None = None
        self._last: Scan | None = None
        self._last_at = -math.inf  # the time of its newest ray
        self._filled = 0  # its first rays, which are those of the scan before it

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
        arrays = None
        if odometry_age is not None:
            stamp = self._motion.latest + odometry_age - ago
            seconds = now - ago - self._last_at
            arrays = self._motion.move(scan, stamp, self._last, seconds, self._filled)
        ranges, bearings, ages = arrays or (scan.ranges, scan.bearings, rays.ages)
        limits = scan.range_min, scan.range_max
        result = Scan(scan.seq, scan.stamp, ranges, bearings, *limits, ages, rays.newest_age)
        self._filled = len(result.ranges) - len(scan.ranges)
        self._last, self._last_at = result, now - ago
        return result

    def _rays_of(self, scan: Scan) -> Rays | None:
        """The rays of the scan; the same object for the same bearings and ages."""
        sweep = self._spec.sweep
        if scan.ages is None and sweep is None:
            return None
        rays = self._rays
        if rays is None or rays.bearings is not scan.bearings or rays.given is not scan.ages:
            rays = self._rays = Rays(scan, sweep, self._spec.latency)
            self._motion.set_rays(rays)
        return rays


class Rays:
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
