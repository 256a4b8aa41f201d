"""Estimators of a calibration, from recorded samples. Pure.

A stop is measured by its stopping distance alone. After the command zero, a base that cruises at
the speed v travels d = v (delay + v / 2b) with the deceleration b. So d / v rises linearly with v:
the intercept is the delay, the slope is 1 / 2b. Stops from two speeds give both, however slowly
odometry is sampled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from swarmd.calibration.figures import Figure
from swarmd.core.values import Array

CRUISE = 0.5
"""Seconds of a drive before its stop whose speed must be steady."""

_STEADY = 0.08  # share by which the speeds of the two halves of a cruise may differ
_MAX_DELAY = 1.2  # s, of a scan
_DELAY_STEP = 0.005  # s
_LEAST_TURN_RATE = 0.1  # rad/s (root mean square), below which a turn gives no delay


class Braking(NamedTuple):
    """A stop from a cruise at `speed` (m/s or rad/s).

    `seconds`: the stopping distance divided by `speed`.
    """

    speed: float
    seconds: float


def is_steady(times: Array, way: Array) -> bool:
    """True if the speed over the last CRUISE s is steady.

    `way`: (n,) travelled m or rad at `times` (n,) s.
    """
    if len(times) < 3 or times[0] > times[-1] - CRUISE:
        return False
    a, b, c = np.interp(times[-1] - CRUISE * np.array((1.0, 0.5, 0.0)), times, way)
    return bool(abs((c - b) - (b - a)) <= _STEADY * abs(c - a) / 2.0)


def stop_of(times: Array, way: Array, at: float) -> Braking | None:
    """The stop after the command zero at `at` s; None without a cruise before it.

    `way`: (n,) travelled m or rad at `times` (n,) s of one clock, up to standstill, positive in the
    direction of the drive.
    """
    before = np.flatnonzero(times <= at)
    cruise = before[times[before] >= at - CRUISE]
    if len(cruise) < 3:
        return None
    first, last = cruise[0], cruise[-1]
    speed = float((way[last] - way[first]) / (times[last] - times[first]))
    if speed <= 0.0:
        return None
    rolled = float(way[-1] - way[last]) - speed * (at - float(times[last]))
    return Braking(speed, rolled / speed)


def stopping(stops: Sequence[Braking]) -> tuple[Figure, Figure]:
    """The deceleration in m/s2 or rad/s2 and the delay in s, from stops at two or more speeds."""
    if len(stops) < 4:
        none = Figure(why="fewer than four stops")
        return none, none
    speeds, seconds = np.array(stops).T
    off = speeds - speeds.mean()
    slope = float(off @ seconds / (off @ off))
    delay = float(seconds.mean() - slope * speeds.mean())
    errors = seconds - delay - slope * speeds
    scatter = math.sqrt(float(errors @ errors) / (len(stops) - 2))
    deviation = scatter / math.sqrt(float(off @ off))
    late = Figure(delay, scatter, len(stops))
    if slope <= 3.0 * deviation:
        return Figure(why="it brakes within the scatter of its odometry"), late
    is_fast = speeds > speeds.mean()
    # To first order, the scatter of `seconds` gives the scatter of the deceleration.
    shares = errors[is_fast] / (slope * speeds[is_fast])
    brake = 0.5 / slope
    spread = brake * max(float(np.std(shares)), deviation / slope)
    return Figure(brake, spread, int(is_fast.sum())), late


def mean_of(values: Sequence[float], why: str) -> Figure:
    """Mean and standard deviation; without values a figure with the reason `why`."""
    if not values:
        return Figure(why=why)
    return Figure(float(np.mean(values)), float(np.std(values)), len(values))


def scale_of(ways: Sequence[tuple[float, float]], why: str) -> Figure:
    """The scale of odometry: distance by odometry over distance by scans; `why` without a pair.

    `ways`: pairs of both distances in m. The value is the slope of least squares, with its
    deviation: a place by a scan is some mm off at any distance, so a short way tells less.
    """
    if not ways:
        return Figure(why=why)
    odometry, seen = np.array(ways).T
    weights = seen**2 / float(seen @ seen)
    ratios = odometry / seen
    value = float(weights @ ratios)
    return Figure(value, float(np.sqrt(weights @ (ratios - value) ** 2)), len(ways))


def turn_delay(
    arrivals: Array, seen: Array, times: Array, measured: Array
) -> tuple[Figure, Figure]:
    """The scan delay in s, and the scale of odometry: its turn over the turn seen by scans.

    `seen`: (m,) headings in rad from scans that arrived at `arrivals` (m,) s. `measured`: (n,)
    headings in rad by odometry at `times` (n,) s of the same clock. No heading is wrapped.

    For each candidate delay, scale and offset are fitted by least squares; the delay with the least
    error is taken. After Rehder, Siegwart and Furgale, IEEE T-RO 2016, with one axis.
    """
    usable = arrivals - _MAX_DELAY >= times[0]
    arrivals, seen = arrivals[usable], seen[usable]
    if len(arrivals) < 8:
        none = Figure(why="fewer than eight scans of the turns could be matched")
        return none, none
    delays = np.arange(0.0, _MAX_DELAY, _DELAY_STEP)
    fits = [_scaled(np.interp(arrivals - d, times, measured), seen) for d in delays]
    errors = np.array([error for _, error in fits])
    best = int(errors.argmin())
    if best == len(delays) - 1:
        none = Figure(why=f"no delay below {_MAX_DELAY:g} s explains the turns that scans show")
        return none, none
    delay = float(delays[best])
    if best > 0:  # refine by a parabola through the three least errors
        a, b, c = errors[best - 1 : best + 2]
        delay += _DELAY_STEP * 0.5 * float((a - c) / (a - 2.0 * b + c))
    rates = np.interp(arrivals - delay + 0.02, times, measured)
    rates -= np.interp(arrivals - delay - 0.02, times, measured)
    rate = float(np.sqrt(np.mean((rates / 0.04) ** 2)))
    if rate < _LEAST_TURN_RATE:
        none = Figure(why="the robot did not turn")
        return none, none
    count = len(arrivals)
    error = math.sqrt(float(errors[best]) / (count - 3))
    scale = fits[best][0]
    turned = float(np.std(seen))
    return (
        Figure(delay, error / rate, count),
        Figure(1.0 / scale, error / (turned * math.sqrt(count)), count),
    )


def _scaled(measured: Array, seen: Array) -> tuple[float, float]:
    """The least-squares scale from `measured` to `seen`, means removed, and the squared error."""
    x, y = measured - measured.mean(), seen - seen.mean()
    scale = float(x @ y / max(float(x @ x), 1e-12))
    rest = y - scale * x
    return max(scale, 1e-6), float(rest @ rest)
