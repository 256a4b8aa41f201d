"""De-skew: the rays of a rotating sensor as it would see them all at the time of the newest ray.

A rotating sensor measures its rays one after the other, and the robot moves meanwhile. Odometry
gives the motion between each ray and the newest one; each return is moved by it (motion distortion
correction: Zhang and Singh, "LOAM: Lidar odometry and mapping in real-time", RSS 2014).

A robot that turns against the sensor leaves a sector unmeasured in each scan: rays of the scan
before fill it. A robot that turns with the sensor measures a sector twice, and both stay.

`Deskewer` is a class of the kernel of scans.
"""

from __future__ import annotations

import math

import numpy as np

from swarmd.core.values import Array, Sweep

_TURN = 2.0 * math.pi


class Rays:
    """The bearings of a scan with the ages (n,) of its rays in s, and what derives from them.

    `given` and `sweep`: of which the ages derive. `cos` and `sin` of the bearings. `span`: the age
    of the oldest ray, whose bearing is `oldest`. `direction` in which the sensor turns: 1.0
    counter-clockwise, -1.0 clockwise, 0.0 neither. `spacing` between neighbouring rays in rad.
    """

    def __init__(self, bearings: Array, ages: Array | None, sweep: Sweep | None) -> None:
        """`ages` as the driver gives them; None: by the `sweep`."""
        self.bearings, self.given, self.sweep = bearings, ages, sweep
        self.cos, self.sin = np.cos(bearings), np.sin(bearings)
        if ages is None:
            assert sweep is not None
            ages = _ages_of_sweep(bearings, sweep)
        self.ages: Array = ages - ages.min()
        self.ages.flags.writeable = False
        self.span = float(self.ages.max())
        self.mean_age = float(self.ages.mean())
        rising = np.sort(bearings % _TURN)
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
