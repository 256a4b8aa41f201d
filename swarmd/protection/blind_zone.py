"""Where something has come too near to be seen, for a sensor that says nothing of it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from swarmd.core.values import Array, Pose, Scan, ScanSpec
from swarmd.protection.footprint import Sight

_BRIEFLY = 2.0  # s for which something is remembered in a shadow too narrow for a robot
_LEFT = 2.0  # of range_min: who has gone that far has left behind what was within it
_NOISE = 0.03  # m
_DEEP = 0.6  # of range_min: nearer to the sensor than that nothing is expected to move about
_SHAPE = 0.05  # m that what is seen of something may change beside its motion
_ENOUGH = 720  # returns nearby are enough: they are within 1 cm of one another then
_RUN = 4  # rays side by side without a return: fewer are lost ones
_LEAST = 0.07  # m across: no robot that a lidar sees is smaller
_WIDEST = math.radians(120.0)  # a shadow wider than that is open space
_FACE = math.pi  # a face that is near hides less of the horizon than that
_BESIDE = 8  # rays, at most, that tell how what is seen goes on
_COMES = 0.02  # m by which it comes nearer over these, more than noise does
_STEEP = 0.06  # m a ray at most by which it does
_FLAT = math.radians(20.0)  # half a shadow: what fills a narrower one is nearly level at its ends

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


class _Shadow(NamedTuple):
    """Rays without a return, side by side, and at how many of its ends what is seen goes inside.

    What goes inside at both ends comes no nearer to the sensor than `corner` m.
    """

    rays: Indices
    crossings: int
    corner: float


class _Hidden(NamedTuple):
    """What hides, ray by ray or bearing by bearing (n,).

    For how long it has in a narrow shadow, in s; how near to the sensor it may be, in m; whether it
    is the middle of a face whose ends are seen.
    """

    worn: Array
    nearest: Array
    is_face: Mask

    def at(self, which: Mask | Indices) -> _Hidden:
        """Some of them."""
        return _Hidden(self.worn[which], self.nearest[which], self.is_face[which])


_NONE = _Hidden(np.empty(0), np.empty(0), np.empty(0, np.bool_))


class NearMemory:
    """Where something hides in a blind zone, and how near it may be.

    `bearings` (n,) rad are in the base frame of the last scan, `nearest` (n,) m from the sensor.

    A sensor that is blind nearby gives no return for what is there. So a ray that has a return
    proves its part of the blind zone empty, and one that has none may be hidden or see nothing.
    Something is hidden once what was near the rim may have come inside, nothing is seen near its
    place any more, and rays there have no return; unseen it comes nearer at the assumed speed.
    What is too wide to vanish goes on inside where it is seen to cross the rim: at one end of a
    shadow, what was seen in it last is hidden, at both ends it fills the shadow, and is no nearer
    than a square corner between them. What is hidden moves with its shadow, fills it if that is not
    too wide, and is forgotten once returns show its place to be empty, or it to be out again, or
    once the robot has left: a memory that nothing clears would hold it for ever. It is not
    forgotten in time, for who is held in touch may be so for minutes.
    """

    def __init__(self, range_min: float, speed: float, period: float) -> None:
        """Blind within `range_min` m; things come nearer at up to `speed` m/s; `period` in s."""
        self._blind, self._speed, self._period = range_min, speed, period
        self._narrow = 2.0 * math.asin(min(0.5 * _LEAST / range_min, 1.0))
        self._near = np.empty((0, 2))
        self._shadows = np.empty(0)
        self._order, self._given, self._rising = np.empty(0, np.intp), np.empty(0), np.empty(0)
        self._from = np.zeros(2)  # where it was when something came in last, in its own frame
        self._hidden = _NONE
        self.bearings = np.empty(0)

    @property
    def nearest(self) -> Array:
        """(n,) m from the sensor: nothing that is hidden along the bearings can be nearer."""
        return self._hidden.nearest

    def update(self, scan: Scan, sight: Sight, moved: Pose, seconds: float) -> None:
        """Take in a scan, taken `seconds` after the one before; `moved` is the base since then."""
        scan = self._ordered(scan)
        step = self._speed * min(seconds, 5.0 * self._period) + _NOISE
        is_near = (scan.ranges <= self._blind + 2.0 * step) & (scan.ranges > -np.inf)
        points = sight.ends(scan, np.flatnonzero(is_near))
        if len(points) or len(self._near) or len(self.bearings):
            self.bearings, self._hidden = self._find(scan, sight, points, moved, seconds, step)
        self._near, self._shadows = points, scan.bearings[np.isinf(scan.ranges)]

    def _ordered(self, scan: Scan) -> Scan:
        """The scan with its rays side by side as they lie side by side."""
        if scan.bearings is not self._given:  # most sensors never change theirs
            self._given = self._rising = scan.bearings
            self._order = np.argsort(scan.bearings % (2.0 * np.pi), kind="stable")
            if (np.diff(self._order) != 1).any():
                self._rising = scan.bearings[self._order]
        if self._rising is scan.bearings:
            return scan
        return replace(scan, ranges=scan.ranges[self._order], bearings=self._rising)

    def _find(
        self, scan: Scan, sight: Sight, points: Array, moved: Pose, seconds: float, step: float
    ) -> tuple[Array, _Hidden]:
        """Where something hides now."""
        cos, sin = math.cos(moved.yaw), math.sin(moved.yaw)
        self._from = np.array(((cos, sin), (-sin, cos))) @ (self._from - (moved.x, moved.y))
        # That a ray is too close to measure can be but a guess, which does not last.
        is_empty = _in_runs(np.isinf(scan.ranges))
        if not is_empty.any():
            return np.empty(0), _NONE
        shadows = self._cast(is_empty, scan.ranges)
        inside = np.zeros(len(is_empty), np.bool_)
        for shadow in shadows:
            inside[shadow.rays] = shadow.crossings > 0
        lost, is_gone = self._lost(points, moved, sight, step, scan.bearings, inside)
        bearings = np.concatenate((self.bearings - moved.yaw, lost))
        if len(lost) or inside.any():
            self._from = np.zeros(2)
        hidden = self._aged(seconds, is_gone, step)
        shift = min(step / (_DEEP * self._blind), 0.25 * math.pi)
        empty = np.flatnonzero(is_empty)
        place, off = _nearest(scan.bearings[empty], bearings)
        is_hidden = (off <= shift) & (hidden.worn < _BRIEFLY)
        is_hidden &= bool(np.hypot(*self._from) < _LEFT * self._blind)
        out = self._come_out(scan, moved.yaw, step)
        if len(out):
            is_old = np.arange(len(bearings)) < len(self.bearings)
            is_hidden &= ~is_old | (_nearest(out, bearings)[1] > shift)
        rays, exact = empty[place[is_hidden]], scan.bearings.copy()
        found = _by_ray(len(exact), rays, hidden.at(is_hidden))
        stays = off[is_hidden] <= math.pi / len(exact)  # else slow turns would be lost
        exact[rays[stays]] = bearings[is_hidden][stays]
        _fill(found, shadows, self._narrow, seconds)
        which = np.flatnonzero(found.worn < np.inf)
        return exact[which], found.at(which)

    def _aged(self, seconds: float, is_gone: Mask, step: float) -> _Hidden:
        """What hid before, so much later, and then what was lost since, gone or of a face (k,)."""
        worn, nearest, is_face = self._hidden
        nearest = np.maximum(nearest - self._speed * seconds, 0.0)
        within = np.full(len(is_gone), self._blind - step)
        return _Hidden(
            np.concatenate((worn, np.zeros(len(is_gone)))),
            np.concatenate((nearest, within)),
            np.concatenate((is_face & (nearest > 0.0), ~is_gone)),
        )

    def _cast(self, is_empty: Mask, ranges: Array) -> list[_Shadow]:
        """The shadows of a scan."""
        n = len(is_empty)
        start = int(is_empty.argmin())  # a ray with a return, if there is one
        order = (np.arange(n) + start) % n
        edges = np.flatnonzero(np.diff(np.concatenate(([0], is_empty[order].view(np.int8), [0]))))
        shadows = []
        for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            ends = (first - 1, -1), (end, 1)
            half = (end - first) * math.pi / n
            is_flat = half < _FLAT
            crossings = sum(
                self._goes_inside(ranges, order[ray % n], way, is_flat) for ray, way in ends
            )
            corner = max(self._blind * (math.cos(half) - math.sin(half)), 0.0)
            shadows.append(_Shadow(order[first:end], crossings, corner))
        return shadows

    def _goes_inside(self, ranges: Array, ray: int, way: int, is_flat: bool) -> bool:
        """Whether what a ray beside a shadow sees is within the rim one ray further into that.

        It goes on as it has come over the rays before, which are those in direction `way`; what
        does not come nearer there ends there. `is_flat`: it need not be seen to come nearer.
        """
        if is_flat:
            return bool(ranges[ray] <= self._blind + _STEEP)
        near = ranges[(ray + way * np.arange(_BESIDE + 1)) % len(ranges)]
        near = np.where(np.isfinite(near), near, 1e9)
        goes_on = np.abs(np.diff(near)) < 2.0 * _STEEP  # false beside what is not seen
        count = int(goes_on.argmin()) if not goes_on.all() else _BESIDE
        comes = float(near[count] - near[0])
        if count < 3 or comes < _COMES:
            return False
        return float(near[0]) - min(comes / count, _STEEP) <= self._blind + _NOISE

    def _come_out(self, scan: Scan, turned: float, step: float) -> Array:
        """(k,) bearings of returns near the rim where there was none in the scan before."""
        is_out = (scan.ranges <= self._blind + step) & (scan.ranges > -np.inf)
        bearings = scan.bearings[is_out]
        if not len(bearings) or not len(self._shadows):
            return np.empty(0)
        return bearings[_nearest(self._shadows - turned, bearings)[1] <= math.pi / len(is_out)]

    def _lost(
        self,
        points: Array,
        moved: Pose,
        sight: Sight,
        step: float,
        rays: Array,
        inside: Mask,
    ) -> tuple[Array, Mask]:
        """(k,) bearings of what was near, may have come inside, and is not seen near by.

        What is seen near by is part of it where its ray (n,) is in a shadow into which something
        goes on: `inside` (n,). Then it is false of it (k,) that it has gone altogether.
        """
        cos, sin = math.cos(moved.yaw), math.sin(moved.yaw)
        x, y = self._near[:, 0] - moved.x, self._near[:, 1] - moved.y
        x, y = cos * x + sin * y, cos * y - sin * x
        ahead, left = sight.offset
        is_lost = np.hypot(x - ahead, y - left) < self._blind + step
        x, y = x[is_lost], y[is_lost]
        points = points[:: 1 + len(points) // _ENOUGH]
        away = np.hypot(points[:, 0] - x[:, None], points[:, 1] - y[:, None])
        is_gone = away.min(axis=1, initial=np.inf) > step + _SHAPE
        bearings = np.arctan2(y - left, x - ahead)
        is_within = is_gone.copy()
        if inside.any():
            is_within |= inside[_nearest(rays, bearings)[0]]
        return bearings[is_within], is_gone[is_within]


def near_memory(spec: ScanSpec, speed: float) -> NearMemory | None:
    """What a sensor needs that tells nothing of what is too close; things come at `speed` m/s."""
    if spec.near == "reported" or spec.range_min <= 0.0:
        return None
    return NearMemory(spec.range_min, speed, 1.0 / spec.rate)


def _by_ray(count: int, rays: Indices, hidden: _Hidden) -> _Hidden:
    """What hides along each of so many rays; `worn` is inf where nothing does."""
    worn, nearest = np.full(count, np.inf), np.full(count, np.inf)
    is_face = np.ones(count, np.bool_)
    np.minimum.at(worn, rays, hidden.worn)
    np.minimum.at(nearest, rays, hidden.nearest)
    np.logical_and.at(is_face, rays, hidden.is_face)
    return _Hidden(worn, nearest, is_face)


def _fill(found: _Hidden, shadows: list[_Shadow], narrow: float, seconds: float) -> None:
    """Let what hides in a shadow fill it.

    A shadow too narrow to be a robot's fades soon, as that of an edge that has turned away.
    """
    n = len(found.worn)
    for run, crossings, corner in shadows:
        youngest = found.worn[run].min()
        width = len(run) * 2.0 * math.pi / n
        if crossings == 2 and width < _FACE:
            found.worn[run] = 0.0
            found.nearest[run[found.is_face[run]]] = corner
        elif youngest < np.inf and width <= _WIDEST:
            found.worn[run] = 0.0 if crossings or width >= narrow else youngest + seconds
            found.nearest[run] = found.nearest[run].min()


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
