"""Memory of obstacles in the blind zone of a sensor that reports nothing closer than range_min.

Such a sensor gives no return for an obstacle inside its blind zone. So a ray with a return proves
its part of the zone empty; a ray without one may be hidden or see nothing. `BlindZoneMemory` works
by these rules:

- An obstacle becomes hidden when it was near the rim, may have crossed it, no return lies near its
  place any more, and the rays there are empty. It then approaches unseen at the assumed speed.
- An obstacle too wide to vanish continues inside where returns show it crossing the rim: at one
  end of an empty sector, the part seen there last becomes hidden; at both ends, the obstacle fills
  the sector, no nearer than a square corner between the ends.
- A hidden obstacle moves with its empty sector and fills it unless the sector is too wide.
- It is forgotten once returns show its place to be empty, once it reappears, or once the robot has
  moved away; without these exits a memory would hold the robot for ever. It does not expire by
  time, since a robot may be held in contact for minutes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from swarmd.core.values import Array, Pose, Scan
from swarmd.protection.footprint import ScanGeometry

NARROW_MEMORY = 2.0  # s for which an empty sector too narrow for a robot is remembered
FORGET_DISTANCE = 2.0  # of range_min: a robot that moved this far has left hidden obstacles behind
RANGE_NOISE = 0.03  # m
MIN_HIDDEN_RANGE = 0.6  # of range_min: closer than this, obstacles do not move sideways
SHAPE_CHANGE = 0.05  # m by which the visible part of an obstacle may change beside its motion
MAX_POINTS = 720  # near returns compared: they lie within 1 cm of one another then
MIN_EMPTY_RUN = 4  # rays side by side without a return; fewer are drop-outs
MIN_WIDTH = 0.07  # m: no robot that a lidar sees is narrower
MAX_SECTOR = math.radians(120.0)  # a wider empty sector is open space
MAX_FACE = math.pi  # a near face hides less of the horizon than this
EDGE_RAYS = 8  # beside an empty sector, at most, from which a face is extrapolated
MIN_APPROACH = 0.02  # m by which a face approaches over these rays, more than noise does
MAX_SLOPE = 0.06  # m per ray by which a face approaches at most
FLAT = math.radians(20.0)  # half width: an obstacle in a narrower sector is level at its ends

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


class _EmptySector(NamedTuple):
    """Neighbouring rays without a return, and at how many of its ends a face crosses the rim.

    A face that crosses the rim at both ends is no nearer to the sensor than `corner` m.
    """

    rays: Indices
    crossings: int
    corner: float


class _Hidden(NamedTuple):
    """Hidden obstacles, one element (n,) per ray or bearing.

    `ages` in s spent in a narrow sector, `nearest` m that it may be from the sensor; `is_face`: it
    is the middle of a face whose ends are visible.
    """

    ages: Array
    nearest: Array
    is_face: Mask

    def at(self, which: Mask | Indices) -> _Hidden:
        """The selected elements."""
        return _Hidden(self.ages[which], self.nearest[which], self.is_face[which])


_NONE = _Hidden(np.empty(0), np.empty(0), np.empty(0, np.bool_))


class BlindZoneMemory:
    """Hidden obstacles by their `bearings` (n,), in rad in the base frame of the last scan."""

    def __init__(self, range_min: float, speed: float, period: float) -> None:
        """Blind within `range_min` m; obstacles approach at up to `speed` m/s; `period` s."""
        self._blind, self._speed, self._period = range_min, speed, period
        self._narrow = narrow_sector(range_min)
        self._near = np.empty((0, 2))
        self._empty_bearings = np.empty(0)
        self._order, self._given, self._rising = np.empty(0, np.intp), np.empty(0), np.empty(0)
        self._entered_at = np.zeros(2)  # place of the robot at the last entry, in the base frame
        self._hidden = _NONE
        self.bearings = np.empty(0)

    @property
    def nearest(self) -> Array:
        """(n,) m from the sensor: no hidden obstacle along the bearings is nearer."""
        return self._hidden.nearest

    def update(self, scan: Scan, geometry: ScanGeometry, moved: Pose, seconds: float) -> None:
        """Take in a scan, taken `seconds` after the last one; `moved` is the motion since then."""
        scan = self._ordered(scan)
        step = self._speed * min(seconds, 5.0 * self._period) + RANGE_NOISE
        is_near = (scan.ranges <= self._blind + 2.0 * step) & (scan.ranges > -np.inf)
        points = geometry.points_of_rays(scan, np.flatnonzero(is_near))
        if len(points) or len(self._near) or len(self.bearings):
            found = self._find(scan, geometry, points, moved, seconds, step)
            self.bearings, self._hidden = found
        self._near, self._empty_bearings = points, scan.bearings[np.isinf(scan.ranges)]

    def _ordered(self, scan: Scan) -> Scan:
        """The scan with its rays in the order of their bearings."""
        if scan.bearings is not self._given:  # most sensors keep theirs
            self._given = self._rising = scan.bearings
            self._order = np.argsort(scan.bearings % (2.0 * np.pi), kind="stable")
            if (np.diff(self._order) != 1).any():
                self._rising = scan.bearings[self._order]
        if self._rising is scan.bearings:
            return scan
        return replace(scan, ranges=scan.ranges[self._order], bearings=self._rising)

    def _find(
        self,
        scan: Scan,
        geometry: ScanGeometry,
        points: Array,
        moved: Pose,
        seconds: float,
        step: float,
    ) -> tuple[Array, _Hidden]:
        """The bearings of hidden obstacles now; `step` is the m an obstacle can move per scan."""
        cos, sin = math.cos(moved.yaw), math.sin(moved.yaw)
        turn = np.array(((cos, sin), (-sin, cos)))
        self._entered_at = turn @ (self._entered_at - (moved.x, moved.y))
        # -inf counts as empty, too: that a ray is too close to measure may be a guess for a while.
        is_empty = _in_runs(np.isinf(scan.ranges))
        if not is_empty.any():
            return np.empty(0), _NONE
        sectors = self._empty_sectors(is_empty, scan.ranges)
        inside = np.zeros(len(is_empty), np.bool_)
        for sector in sectors:
            inside[sector.rays] = sector.crossings > 0
        lost, is_gone = self._vanished(points, moved, geometry, step, scan.bearings, inside)
        bearings = np.concatenate((self.bearings - moved.yaw, lost))
        if len(lost) or inside.any():
            self._entered_at = np.zeros(2)
        hidden = self._aged(seconds, is_gone, step)
        shift = min(step / (MIN_HIDDEN_RANGE * self._blind), 0.25 * math.pi)
        empty = np.flatnonzero(is_empty)
        place, off = _nearest_bearings(scan.bearings[empty], bearings)
        is_hidden = (off <= shift) & (hidden.ages < NARROW_MEMORY)
        is_hidden &= bool(np.hypot(*self._entered_at) < FORGET_DISTANCE * self._blind)
        out = self._reappeared(scan, moved.yaw, step)
        if len(out):
            is_old = np.arange(len(bearings)) < len(self.bearings)
            is_hidden &= ~is_old | (_nearest_bearings(out, bearings)[1] > shift)
        rays, exact = empty[place[is_hidden]], scan.bearings.copy()
        found = _by_ray(len(exact), rays, hidden.at(is_hidden))
        stays = off[is_hidden] <= math.pi / len(exact)  # a slow turn would be lost in whole rays
        exact[rays[stays]] = bearings[is_hidden][stays]
        _fill(found, sectors, self._narrow, seconds)
        which = np.flatnonzero(found.ages < np.inf)
        return exact[which], found.at(which)

    def _aged(self, seconds: float, is_gone: Mask, step: float) -> _Hidden:
        """What was hidden before, `seconds` later, then what has vanished since (k,)."""
        ages, nearest, is_face = self._hidden
        nearest = np.maximum(nearest - self._speed * seconds, 0.0)
        within = np.full(len(is_gone), self._blind - step)
        return _Hidden(
            np.concatenate((ages, np.zeros(len(is_gone)))),
            np.concatenate((nearest, within)),
            np.concatenate((is_face & (nearest > 0.0), ~is_gone)),
        )

    def _empty_sectors(self, is_empty: Mask, ranges: Array) -> list[_EmptySector]:
        """The empty sectors of a scan."""
        n = len(is_empty)
        start = int(is_empty.argmin())  # a ray with a return, if there is one
        order = (np.arange(n) + start) % n
        edges = np.flatnonzero(np.diff(np.concatenate(([0], is_empty[order].view(np.int8), [0]))))
        sectors = []
        for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            ends = (first - 1, -1), (end, 1)
            half = (end - first) * math.pi / n
            is_flat = half < FLAT
            crossings = sum(
                self._crosses_rim(ranges, order[ray % n], direction, is_flat)
                for ray, direction in ends
            )
            corner = max(self._blind * (math.cos(half) - math.sin(half)), 0.0)
            sectors.append(_EmptySector(order[first:end], crossings, corner))
        return sectors

    def _crosses_rim(self, ranges: Array, ray: int, direction: int, is_flat: bool) -> bool:
        """True if the face seen beside an empty sector lies within the rim one ray further in.

        The face is extrapolated from the rays beside `ray`, those in `direction`; a face that does
        not approach there ends there. `is_flat`: the approach need not be visible.
        """
        if is_flat:
            return bool(ranges[ray] <= self._blind + MAX_SLOPE)
        near = ranges[(ray + direction * np.arange(EDGE_RAYS + 1)) % len(ranges)]
        near = np.where(np.isfinite(near), near, 1e9)
        is_smooth = np.abs(np.diff(near)) < 2.0 * MAX_SLOPE  # false beside a ray without a return
        count = int(is_smooth.argmin()) if not is_smooth.all() else EDGE_RAYS
        approach = float(near[count] - near[0])
        if count < 3 or approach < MIN_APPROACH:
            return False
        return float(near[0]) - min(approach / count, MAX_SLOPE) <= self._blind + RANGE_NOISE

    def _reappeared(self, scan: Scan, turned: float, step: float) -> Array:
        """(k,) bearings of returns near the rim whose rays were empty in the last scan."""
        is_out = (scan.ranges <= self._blind + step) & (scan.ranges > -np.inf)
        bearings = scan.bearings[is_out]
        if not len(bearings) or not len(self._empty_bearings):
            return np.empty(0)
        off = _nearest_bearings(self._empty_bearings - turned, bearings)[1]
        return bearings[off <= math.pi / len(is_out)]

    def _vanished(
        self,
        points: Array,
        moved: Pose,
        geometry: ScanGeometry,
        step: float,
        rays: Array,
        inside: Mask,
    ) -> tuple[Array, Mask]:
        """(k,) bearings of earlier returns that may have crossed the rim and are not seen any more.

        A return that is still seen near its place counts, too, if its ray lies in an empty sector
        which a face enters (`inside` (n,), for `rays` (n,)). The second array (k,) is false for it:
        the obstacle has not vanished as a whole.
        """
        cos, sin = math.cos(moved.yaw), math.sin(moved.yaw)
        x, y = self._near[:, 0] - moved.x, self._near[:, 1] - moved.y
        x, y = cos * x + sin * y, cos * y - sin * x
        ahead, left = geometry.offset
        is_lost = np.hypot(x - ahead, y - left) < self._blind + step
        x, y = x[is_lost], y[is_lost]
        points = points[:: 1 + len(points) // MAX_POINTS]
        away = np.hypot(points[:, 0] - x[:, None], points[:, 1] - y[:, None])
        is_gone = away.min(axis=1, initial=np.inf) > step + SHAPE_CHANGE
        bearings = np.arctan2(y - left, x - ahead)
        is_within = is_gone.copy()
        if inside.any():
            is_within |= inside[_nearest_bearings(rays, bearings)[0]]
        return bearings[is_within], is_gone[is_within]


def narrow_sector(range_min: float) -> float:
    """The width in rad of the narrowest sector in which a robot may be hidden."""
    return 2.0 * math.asin(min(0.5 * MIN_WIDTH / range_min, 1.0))


def _by_ray(count: int, rays: Indices, hidden: _Hidden) -> _Hidden:
    """The hidden obstacle along each of `count` rays; `ages` is inf for a ray without one."""
    ages, nearest = np.full(count, np.inf), np.full(count, np.inf)
    is_face = np.ones(count, np.bool_)
    np.minimum.at(ages, rays, hidden.ages)
    np.minimum.at(nearest, rays, hidden.nearest)
    np.logical_and.at(is_face, rays, hidden.is_face)
    return _Hidden(ages, nearest, is_face)


def _fill(found: _Hidden, sectors: list[_EmptySector], narrow: float, seconds: float) -> None:
    """Extend each hidden obstacle over its empty sector, in place.

    A sector too narrow for a robot ages, like that of an edge that has turned away.
    """
    n = len(found.ages)
    for run, crossings, corner in sectors:
        youngest = found.ages[run].min()
        width = len(run) * 2.0 * math.pi / n
        if crossings == 2 and width < MAX_FACE:
            found.ages[run] = 0.0
            found.nearest[run[found.is_face[run]]] = corner
        elif youngest < np.inf and width <= MAX_SECTOR:
            found.ages[run] = 0.0 if crossings or width >= narrow else youngest + seconds
            found.nearest[run] = found.nearest[run].min()


def _in_runs(is_empty: Mask) -> Mask:
    """True for empty rays in a run of at least `MIN_EMPTY_RUN` side by side."""
    n = len(is_empty)
    if n < MIN_EMPTY_RUN or not is_empty.any():
        return np.zeros(n, np.bool_)
    length = MIN_EMPTY_RUN
    around = np.concatenate((is_empty[1 - length :], is_empty, is_empty[: length - 1]))
    windows = np.asarray(sliding_window_view(around, length).all(axis=1))
    found: Mask = np.asarray(sliding_window_view(windows, length).any(axis=1))
    return found


def _nearest_bearings(bearings: Array, wanted: Array) -> tuple[NDArray[np.intp], Array]:
    """For each of `wanted` (k,), the index of the nearest of `bearings` (n,) and the distance."""
    order = np.argsort(bearings % (2.0 * np.pi), kind="stable")
    rising = bearings[order] % (2.0 * np.pi)
    after = np.searchsorted(rising, wanted % (2.0 * np.pi)) % len(rising)
    pair = np.stack((after, after - 1))
    off = np.abs((rising[pair] - wanted + np.pi) % (2.0 * np.pi) - np.pi)
    nearer = off.argmin(axis=0)
    column = np.arange(len(wanted))
    return order[pair[nearer, column]], off[nearer, column]
