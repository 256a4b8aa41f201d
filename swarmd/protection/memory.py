"""Where something has come too near to be seen, for a sensor that says nothing of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from swarmd.protection.footprint import Sight
from swarmd.values import Array, Pose, Scan

LASTS = 30.0
"""Seconds for which it is remembered where nothing shows that it has gone."""

_PLAIN = 0.25  # of a second is a second in a shadow between things that are seen
_BRIEFLY = 2.0  # s for which it is remembered in a narrow one
_NOISE = 0.03  # m
_DEEP = 0.6  # of range_min: nearer to the sensor than that nothing is expected to move about
_SHAPE = 0.05  # m that what is seen of something may change beside its motion
_RUN = 4  # rays side by side without a return: fewer are lost ones
_LEAST = 0.1  # m across: no robot that a lidar sees is smaller
_WIDEST = math.radians(120.0)  # a shadow wider than that is open space

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


class NearMemory:
    """The bearings (n,) rad, in the base frame of the last scan, along which something is hidden.

    A sensor that is blind nearby gives no return for what is there. So a ray that has a return
    proves its part of the blind zone empty, and one that has none may be hidden or see nothing.
    Something is hidden once what was near the rim may have come inside, nothing is seen near its
    place any more, and rays there have no return. It moves with that shadow, fills it if that is
    not too wide, and is forgotten once returns show its place to be empty, or it to be out again.
    A memory that is not cleared so would hold the robot for ever.
    """

    def __init__(self, range_min: float, speed: float, period: float) -> None:
        """Blind within `range_min` m; things come nearer at up to `speed` m/s; `period` in s."""
        self._blind, self._speed, self._period = range_min, speed, period
        self._narrow = 2.0 * math.asin(min(0.5 * _LEAST / range_min, 1.0))
        self._near = np.empty((0, 2))
        self._shadows = np.empty(0)
        self.bearings = np.empty(0)
        self.ages = np.empty(0)

    def update(self, scan: Scan, sight: Sight, moved: Pose, seconds: float) -> None:
        """Take in a scan, taken `seconds` after the one before; `moved` is the base since then."""
        step = self._speed * min(seconds, 5.0 * self._period) + _NOISE
        is_near = (scan.ranges <= self._blind + 2.0 * step) & (scan.ranges > -np.inf)
        points = sight.ends(scan, np.flatnonzero(is_near))
        if len(self._near) or len(self.bearings):
            self.bearings, self.ages = self._hidden(scan, sight, points, moved, seconds, step)
        self._near, self._shadows = points, scan.bearings[np.isinf(scan.ranges)]

    def _hidden(
        self, scan: Scan, sight: Sight, points: Array, moved: Pose, seconds: float, step: float
    ) -> tuple[Array, Array]:
        """Where something hides now, and for how long."""
        # That a ray is too close to measure can be but a guess, which does not last.
        is_empty = _in_runs(np.isinf(scan.ranges))
        if not is_empty.any():
            return np.empty(0), np.empty(0)
        lost = self._lost(points, moved, sight, step)
        bearings = np.concatenate((self.bearings - moved.yaw, lost))
        ages = np.concatenate((self.ages + seconds, np.zeros(len(lost))))
        shift = min(step / (_DEEP * self._blind), 0.25 * math.pi)
        empty = np.flatnonzero(is_empty)
        place, off = _nearest(scan.bearings[empty], bearings)
        is_hidden = (off <= shift) & (ages < LASTS)
        out = self._come_out(scan, moved.yaw, step)
        if len(out):
            is_old = np.arange(len(bearings)) < len(self.bearings)
            is_hidden &= ~is_old | (_nearest(out, bearings)[1] > shift)
        since, exact = np.full(len(scan.bearings), np.inf), scan.bearings.copy()
        rays = empty[place[is_hidden]]
        np.minimum.at(since, rays, ages[is_hidden])
        stays = off[is_hidden] <= math.pi / len(scan.bearings)  # else slow turns would be lost
        exact[rays[stays]] = bearings[is_hidden][stays]
        _fill(since, is_empty, self._narrow, seconds)
        found = np.flatnonzero(since < np.inf)
        return exact[found], since[found]

    def _come_out(self, scan: Scan, turned: float, step: float) -> Array:
        """(k,) bearings of returns near the rim where there was none in the scan before."""
        is_out = (scan.ranges <= self._blind + step) & (scan.ranges > -np.inf)
        bearings = scan.bearings[is_out]
        if not len(bearings) or not len(self._shadows):
            return np.empty(0)
        return bearings[_nearest(self._shadows - turned, bearings)[1] <= math.pi / len(is_out)]

    def _lost(self, points: Array, moved: Pose, sight: Sight, step: float) -> Array:
        """(k,) bearings of what was near, may have come inside, and is not seen near by."""
        cos, sin = math.cos(moved.yaw), math.sin(moved.yaw)
        x, y = self._near[:, 0] - moved.x, self._near[:, 1] - moved.y
        x, y = cos * x + sin * y, cos * y - sin * x
        ahead, left = sight.offset
        is_lost = np.hypot(x - ahead, y - left) < self._blind + step
        x, y = x[is_lost], y[is_lost]
        away = np.hypot(points[:, 0] - x[:, None], points[:, 1] - y[:, None])
        is_gone = away.min(axis=1, initial=np.inf) > step + _SHAPE
        bearings: Array = np.arctan2(y[is_gone] - left, x[is_gone] - ahead)
        return bearings


def _fill(since: Array, is_empty: Mask, narrow: float, seconds: float) -> None:
    """Let what hides in a shadow fill it; `since` (n,) s is inf where nothing does.

    A shadow too narrow to be a robot's fades soon, as that of an edge that has turned away; a
    plain one, between things that are seen, more slowly than open space.
    """
    n = len(is_empty)
    start = int(is_empty.argmin())  # a ray with a return, if there is one
    order = (np.arange(n) + start) % n
    edges = np.flatnonzero(np.diff(np.concatenate(([0], is_empty[order].view(np.int8), [0]))))
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        run = order[first:end]
        youngest = since[run].min()
        width = (end - first) * 2.0 * math.pi / n
        if youngest < np.inf and width <= _WIDEST:
            rate = _PLAIN if width >= narrow else LASTS / _BRIEFLY
            since[run] = max(youngest + (rate - 1.0) * seconds, 0.0)


def _nearest(bearings: Array, wanted: Array) -> tuple[Indices, Array]:
    """For each of `wanted` (k,) the nearest of `bearings` (n,), and how far off it is, in rad."""
    turn = 2.0 * np.pi
    order = np.argsort(bearings % turn)
    rising = bearings[order] % turn
    after = np.searchsorted(rising, wanted % turn) % len(rising)
    pair = np.stack((after, after - 1))
    off = np.abs((rising[pair] - wanted + np.pi) % turn - np.pi)
    nearer = off.argmin(axis=0)
    column = np.arange(len(wanted))
    return order[pair[nearer, column]], off[nearer, column]


def _in_runs(is_empty: Mask) -> Mask:
    """True for rays without a return among at least `_RUN` such side by side."""
    n = len(is_empty)
    if n < _RUN or not is_empty.any():
        return np.zeros(n, np.bool_)
    around = np.concatenate((is_empty[1 - _RUN :], is_empty, is_empty[: _RUN - 1]))
    windows = np.asarray(sliding_window_view(around, _RUN).all(axis=1))
    found: Mask = np.asarray(sliding_window_view(windows, _RUN).any(axis=1))
    return found
