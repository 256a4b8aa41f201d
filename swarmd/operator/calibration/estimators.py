"""Estimators of a calibration, from recorded samples. Pure.

A stop is measured by its stopping distance alone. After the command zero, a base that cruises at
the speed v travels d = v (delay + v / 2b) with the deceleration b. So d / v rises linearly with v:
the intercept is the delay, the slope is 1 / 2b. Stops from two speeds give delay and deceleration,
however slowly odometry is sampled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from swarmd.core.values import Array
from swarmd.operator.calibration.figures import Figure

CRUISE = 0.5
"""Seconds of a drive before its stop whose speed must be steady."""

_LEAST_SPREAD = 0.1  # share of the top speed by which speeds of stops must differ
_STEADY = 0.08  # share by which the speeds of the two halves of a cruise may differ
_MAX_DELAY = 1.2  # s, of a scan
_DELAY_STEP = 0.005  # s
_RATE_STEP = 0.02  # s to each side, over which a turn rate is measured
_LEAST_TURN = 1e-6  # rad (standard deviation), of turns that scans show
_LEAST_TURN_RATE = 0.1  # rad/s (root mean square), below which a turn gives no delay


class Braking(NamedTuple):
    """A stop from a cruise (a drive at steady speed)."""

    speed: float  # of the cruise, m/s or rad/s
    seconds: float  # stopping distance divided by `speed`


def is_steady(times: Array, distances: Array) -> bool:
    """True if the speeds in the two halves of the last CRUISE s are nearly equal.

    `distances`: (n,) travelled m or rad since the start, at `times` (n,) s.
    """
    if len(times) < 3 or times[0] > times[-1] - CRUISE:
        return False
    cruise_times = times[-1] - CRUISE * np.array((1.0, 0.5, 0.0))
    start, middle, end = np.interp(cruise_times, times, distances)
    return bool(abs((end - middle) - (middle - start)) <= _STEADY * abs(end - start) / 2.0)


def stop_of(times: Array, distances: Array, stop_time: float) -> Braking | None:
    """The stop after the command zero at `stop_time` s; None without a cruise before.

    `distances`: (n,) travelled m or rad at `times` (n,) s of one clock, up to standstill, positive
    in the direction of the drive.
    """
    before = np.flatnonzero(times <= stop_time)
    cruise = before[times[before] >= stop_time - CRUISE]
    if len(cruise) < 3:
        return None
    first = cruise[0]
    last = cruise[-1]
    if not times[last] > times[first]:
        return None
    speed = float((distances[last] - distances[first]) / (times[last] - times[first]))
    if not speed > 0.0:
        return None
    # The stopping distance begins at `stop_time`, which lies after the last sample of the cruise.
    distance = float(distances[-1] - distances[last]) - speed * (stop_time - float(times[last]))
    return Braking(speed, distance / speed)


def stopping(stops: Sequence[Braking]) -> tuple[Figure, Figure]:
    """The deceleration in m/s2 or rad/s2 and the delay in s, from stops at two or more speeds.

    A line is fitted to `Braking.seconds` (distance over speed) as a function of speed, see the head
    of the file. With fewer than four stops, or stops from one speed, neither figure has a value. If
    the slope is within three standard deviations of 0, the deceleration has no value.
    """
    if len(stops) < 4:
        return (Figure(why="fewer than four stops"),) * 2

    # 1. The line by least squares: intercept = delay, slope = 1 / (2 deceleration).
    speeds, seconds = np.array(stops).T
    if not np.ptp(speeds) > _LEAST_SPREAD * speeds.max():
        why = "all stops are from one speed: the base does not follow its commands"
        return (Figure(why=why),) * 2
    centred = speeds - speeds.mean()
    slope = float(centred @ seconds / (centred @ centred))
    delay = float(seconds.mean() - slope * speeds.mean())
    errors = seconds - delay - slope * speeds
    scatter = math.sqrt(float(errors @ errors) / (len(stops) - 2))  # a line has 2 parameters
    slope_deviation = scatter / math.sqrt(float(centred @ centred))
    delay_figure = Figure(delay, scatter, len(stops))
    if slope <= 3.0 * slope_deviation:
        return Figure(why="it brakes within the scatter of its odometry"), delay_figure

    # 2. The deceleration. To first order its relative deviation is that of the slope. The greater
    # of two estimates counts: of the scatter of the fast stops, and of the fit. The braking takes
    # `slope * speed` of a stop's `seconds`, so errors are divided by this part.
    is_fast = speeds > speeds.mean()
    braking_seconds = slope * speeds[is_fast]
    scatter_share = float(np.std(errors[is_fast] / braking_seconds))
    fit_share = slope_deviation / slope
    deceleration = 0.5 / slope
    spread = deceleration * max(scatter_share, fit_share)
    return Figure(deceleration, spread, int(is_fast.sum())), delay_figure


def mean_of(values: Sequence[float], why: str) -> Figure:
    """Mean and standard deviation; without values a figure with the reason `why`."""
    if not values:
        return Figure(why=why)
    return Figure(float(np.mean(values)), float(np.std(values)), len(values))


def scale_of(distances: Sequence[tuple[float, float]], why: str) -> Figure:
    """The scale of odometry: distance by odometry over distance by scans.

    `distances`: of each drive, the distance by odometry and the distance by scans, in m. The value
    is the slope of least squares, in which a short drive has little weight: a place by a scan has
    an error of some mm at any distance. Without a drive that scans show a figure with the reason
    `why`.
    """
    seen = [pair for pair in distances if pair[1] > 0.0]
    if not seen:
        return Figure(why=why)
    by_odometry, by_scans = np.array(seen).T
    weights = by_scans**2 / float(by_scans @ by_scans)
    ratios = by_odometry / by_scans
    value = float(weights @ ratios)
    return Figure(value, float(np.sqrt(weights @ (ratios - value) ** 2)), len(seen))


def turn_delay(
    arrivals: Array, scan_headings: Array, times: Array, odometry_headings: Array
) -> tuple[Figure, Figure]:
    """The scan delay in s, and the scale of odometry: turn by odometry over turn by scans.

    The scan delay is the time from the measurement of a scan to its arrival. A figure without a
    value says why. A negative scale: scans show turns in the other direction than odometry.

    For each candidate delay, scale and offset are fitted by least squares, and the delay with the
    least error is taken. After Rehder, Siegwart and Furgale, IEEE T-RO 2016, with one axis.

    Args:
        arrivals: (m,) s, of scans while the robot turned to and fro.
        scan_headings: (m,) rad, not wrapped, by these scans.
        times: (n,) s of the same clock.
        odometry_headings: (n,) rad, not wrapped, at `times`.
    """
    # With each candidate delay the time of measurement must lie within the odometry.
    usable = arrivals - _MAX_DELAY >= times.min(initial=math.inf)
    arrivals = arrivals[usable]
    scan_headings = scan_headings[usable]
    are_numbers = bool(np.isfinite(scan_headings).all() and np.isfinite(odometry_headings).all())
    if len(arrivals) < 8 or not are_numbers:
        return (Figure(why="fewer than eight scans of the turns could be matched"),) * 2

    # 1. The candidate delay with the least squared error, refined by a parabola.
    delays = np.arange(0.0, _MAX_DELAY, _DELAY_STEP)
    fits = [
        _fit_scale(np.interp(arrivals - candidate, times, odometry_headings), scan_headings)
        for candidate in delays
    ]
    errors = np.array([error for _, error in fits])
    best = int(errors.argmin())
    if best == len(delays) - 1:
        text = f"no delay below {_MAX_DELAY:g} s explains the turns that scans show"
        no_figure = Figure(why=text)
        return no_figure, no_figure
    delay = float(delays[best])
    if best > 0:
        before, least, after = errors[best - 1 : best + 2]
        delay += _DELAY_STEP * 0.5 * float((before - after) / (before - 2.0 * least + after))
    turn_rate = _turn_rate(arrivals - delay, times, odometry_headings)
    if turn_rate < _LEAST_TURN_RATE:
        return (Figure(why="the robot did not turn"),) * 2

    # 2. The deviations. `error`: rad, of the headings; the fit has 3 parameters.
    count = len(arrivals)
    error = math.sqrt(float(errors[best]) / (count - 3))
    scans_per_odometry = fits[best][0]
    heading_deviation = float(np.std(scan_headings))
    if not heading_deviation > _LEAST_TURN:
        return (
            Figure(why="scans show no turn: the lidar repeats a scan, or turns not with it"),
        ) * 2
    return (
        # The deviation of a single scan, since a delay must hold for each scan.
        Figure(delay, error / turn_rate, count),
        # The standard error of a fitted slope.
        Figure(1.0 / scans_per_odometry, error / (heading_deviation * math.sqrt(count)), count),
    )


def _turn_rate(at: Array, times: Array, headings: Array) -> float:
    """The turn rate in rad/s at the times `at`, by central differences (root mean square).

    `headings`: (n,) rad at `times` (n,) s.
    """
    turns = np.interp(at + _RATE_STEP, times, headings)
    turns -= np.interp(at - _RATE_STEP, times, headings)
    return float(np.sqrt(np.mean((turns / (2.0 * _RATE_STEP)) ** 2)))


def _fit_scale(odometry_headings: Array, scan_headings: Array) -> tuple[float, float]:
    """The least-squares scale from odometry to scans, means removed, and the squared error."""
    x = odometry_headings - odometry_headings.mean()
    y = scan_headings - scan_headings.mean()
    scale = float(x @ y / max(float(x @ x), 1e-12))
    residuals = y - scale * x
    return scale or 1e-6, float(residuals @ residuals)
