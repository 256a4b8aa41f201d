"""Errors of line and circle formations.

The best line is the fit of total least squares, by orthogonal distances (Pearson 1901, Phil. Mag.
2). Fredslund and Mataric 2002 (IEEE Trans. Robotics and Automation 18, 837) judge a line by this
fit and by the spacing. The best circle is the fit of algebraic least squares (Kasa 1976, IEEE
Trans. Instrum. Meas. 25). Only present robots count. `spacing` is the wanted distance of neighbours
in m.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.metrics.metric import Metric, late_mean
from swarmd.sim.metrics.window import between, presence
from swarmd.sim.trace import Trace


def line_offsets(trace: Trace) -> Array:
    """(T,) the root mean square of the robots' distances in m from the best line."""
    return _each(trace, lambda place: float(np.sqrt(np.mean(_along(place)[1] ** 2))), least=2)


def line_unevenness(trace: Trace, spacing: float | None = None) -> Array:
    """(T,) the rms deviation of the gaps along the best line from `spacing`, over `spacing`.

    Without `spacing` the mean gap takes its place.
    """

    def of(place: Array) -> float:
        gaps = np.diff(np.sort(_along(place)[0]))
        return _spread(gaps, float(gaps.mean()) if spacing is None else spacing)

    return _each(trace, of, least=2)


def line_errors(trace: Trace, spacing: float) -> Array:
    """(T,) how far the robots are from evenly spaced places on the best line, as a share.

    The larger of two shares: the distance from the line over `spacing` (`line_offsets`), and the
    deviation of the gaps along the line (`line_unevenness`). NaN for fewer than two robots.
    """
    larger: Array = np.maximum(line_offsets(trace) / spacing, line_unevenness(trace, spacing))
    return larger


def circle_offsets(trace: Trace, radius: float | None = None) -> Array:
    """(T,) the root mean square of the robots' distances in m from the best circle.

    With a `radius` in m: from the circle of that radius around the best circle's centre.
    """

    def of(place: Array) -> float:
        away = _around(place)[1]
        wanted = math.sqrt(float(np.mean(away**2))) if radius is None else radius
        return math.sqrt(float(np.mean((away - wanted) ** 2)))

    return _each(trace, of, least=3)


def circle_unevenness(trace: Trace) -> Array:
    """(T,) the rms deviation of angular gaps from 2 pi / n, as a share of 2 pi / n."""

    def of(place: Array) -> float:
        angles = np.sort(_around(place)[0])
        gaps = np.diff(np.concatenate((angles, angles[:1] + 2.0 * math.pi)))
        return _spread(gaps, 2.0 * math.pi / len(place))

    return _each(trace, of, least=3)


def circle_errors(trace: Trace, spacing: float) -> Array:
    """(T,) how far the robots are from evenly spaced places on the wanted circle, as a share.

    The larger of two shares: the distance from the circle over `spacing` (`circle_offsets`), and
    the deviation of the angular gaps (`circle_unevenness`). The wanted circle has the radius at
    which neighbours are `spacing` m apart. NaN for fewer than three robots.
    """
    errors = circle_unevenness(trace)
    counts = presence(trace).sum(axis=1)
    for count in np.unique(counts[counts > 2]).tolist():
        radius = spacing / (2.0 * math.sin(math.pi / count))
        offsets = circle_offsets(trace, radius) / spacing
        errors = np.where(counts == count, np.maximum(errors, offsets), errors)
    return errors


def largest_error(
    trace: Trace, errors: Callable[[Trace, float], Array], span: tuple[float, float], spacing: float
) -> float:
    """The largest of `errors` (`line_errors`, `circle_errors`) from one time to another, in s.

    0 without an instant between them.
    """
    return float(errors(between(trace, *span), spacing).max(initial=0.0))


def share_moving(trace: Trace, span: tuple[float, float], path: float) -> float:
    """The share of robots whose path from one time to another, in s, is longer than `path` m.

    Of the robots that are present all the time.
    """
    part = between(trace, *span)
    step = np.diff(part.pose[:, presence(part).all(axis=0), :2], axis=0)
    return float(np.mean(np.hypot(step[..., 0], step[..., 1]).sum(axis=0) > path))


def _each(trace: Trace, of: Callable[[Array], float], *, least: int) -> Array:
    """(T,) `of` the positions (k, 2) of present robots; NaN for fewer than `least`."""
    is_present = presence(trace)
    numbers = np.full(len(trace.t), np.nan)
    for at, place in enumerate(trace.pose[..., :2]):
        if np.count_nonzero(is_present[at]) >= least:
            numbers[at] = of(place[is_present[at]])
    return numbers


def _along(place: Array) -> tuple[Array, Array]:
    """The positions (k,) along the best line, and the distances from it, in m."""
    x, y = (place - place.mean(axis=0)).T
    angle = 0.5 * math.atan2(2.0 * float(x @ y), float(x @ x) - float(y @ y))
    cos = math.cos(angle)
    sin = math.sin(angle)
    return cos * x + sin * y, cos * y - sin * x


def _around(place: Array) -> tuple[Array, Array]:
    """The bearings (k,) in rad from the best circle's centre, and the distances in m."""
    middle = place.mean(axis=0)
    points = place - middle
    known = np.ones((len(points), 3))
    known[:, :2] = 2.0 * points
    centre = np.linalg.lstsq(known, (points**2).sum(axis=1), rcond=None)[0][:2]
    x, y = (points - centre).T
    return np.arctan2(y, x), np.hypot(x, y)


def _spread(gaps: Array, wanted: float) -> float:
    return math.sqrt(float(np.mean((gaps - wanted) ** 2))) / wanted if wanted > 0.0 else math.nan


_LINE = "Pearson 1901, Phil. Mag. 2; Fredslund and Mataric 2002"
_CIRCLE = "Kasa 1976, IEEE Trans. Instrum. Meas. 25"

METRICS = (
    Metric("line_offset", "m",
           "rms distance of the robots from the line that fits them best, mean of the last 60 s",
           _LINE, late_mean(line_offsets), line_offsets),
    Metric("line_unevenness", "share",
           "rms difference of gaps along that line from their mean, over it; mean of the last 60 s",
           _LINE, late_mean(line_unevenness), line_unevenness),
    Metric("circle_offset", "m",
           "rms distance of the robots from the circle that fits them best, mean of the last 60 s",
           _CIRCLE, late_mean(circle_offsets), circle_offsets),
    Metric("circle_unevenness", "share",
           "rms difference of angular gaps on it from equal ones, over these; mean of last 60 s",
           _CIRCLE, late_mean(circle_unevenness), circle_unevenness),
)  # fmt: skip
