"""Memory of obstacles in the blind zone of a sensor that reports nothing closer than range_min.

The blind zone is the circle of range_min around the sensor; its border is the rim. A ray with a
return proves that the part of the ray inside the zone is free. An empty ray (without a return) may
end at an obstacle inside the zone, or see nothing. An empty sector is a run of empty rays.
`BlindZoneMemory` works by these rules:

1. An obstacle becomes hidden if it was near the rim, may have crossed it since, has no return near
   its place any more, and the rays there are empty. A hidden obstacle then approaches at the
   assumed speed.
2. An obstacle too wide to vanish may cross the rim, which returns at the end of an empty sector
   show. If it crosses at one end, the part seen there last becomes hidden. If obstacles cross at
   both ends, they count as one obstacle that fills the sector, and is no nearer than a square
   corner between the ends.
3. A hidden obstacle moves with its empty sector, and fills the sector unless that is too wide.
4. A hidden obstacle is forgotten once returns show its place free, once it reappears, or once the
   robot has moved away by its own commands. Motion without commands does not count, since an
   obstacle that pushes the robot moves with it. Without these exits the memory would hold the robot
   for ever. There is no expiry by time (except by rule 5, and in a sector too narrow for a robot),
   since a robot may be held in contact for minutes.
5. An obstacle has reappeared once more of it came into view beside the rim than noise can show. The
   hidden obstacles near that place are forgotten. Hidden obstacles farther away, which may have
   been the same obstacle, become doubtful, as do obstacles that only continue a face. In the open,
   empty rays cannot show that a doubtful obstacle has left, so it expires there by time.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.values import Pose, Scan
from swarmd.protection.footprint import ScanGeometry

if TYPE_CHECKING:  # Cython reads this import, CPython the other one
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import (
        INFINITY,
        atan2,
        cos,
        fabs,
        fmod,
        hypot,
        isfinite,
        isinf,
        sin,
    )
else:
    from swarmd.core.cython_shadow import (
        INFINITY,
        atan2,
        cos,
        fabs,
        fmod,
        hypot,
        isfinite,
        isinf,
        sin,
    )

# s for which an empty sector too narrow for a robot, and a doubtful obstacle, are remembered
_NARROW_MEMORY = cython.declare(cython.double, 2.0)
# s: the age of an obstacle that becomes doubtful; in the open, only ages above 0 grow
_DOUBTFUL = cython.declare(cython.double, 1e-3)
# of range_min: a robot that moved this far has left hidden obstacles behind
_FORGET_DISTANCE = cython.declare(cython.double, 2.0)
_RANGE_NOISE = cython.declare(cython.double, 0.03)  # m
# of range_min: closer than this, obstacles do not move sideways
_MIN_HIDDEN_RANGE = cython.declare(cython.double, 0.6)
# m by which the visible part of an obstacle may change beside its motion
_SHAPE_CHANGE = cython.declare(cython.double, 0.05)
# near returns that are compared at most: with so many, neighbours lie within 1 cm
_MAX_POINTS = cython.declare(cython.Py_ssize_t, 720)
# empty rays side by side that are an empty sector; fewer are drop-outs
_MIN_EMPTY_RUN = cython.declare(cython.Py_ssize_t, 4)
_MIN_WIDTH = cython.declare(cython.double, 0.07)  # m: no robot that a lidar sees is narrower
# m of an obstacle that come into view as it leaves the zone: noise at a rim shows 1 cm in and out
_MIN_EMERGED = cython.declare(cython.double, 0.035)
# a wider empty sector is open space
_MAX_SECTOR = cython.declare(cython.double, math.radians(120.0))
# a near face hides less of the horizon than this
_MAX_FACE = cython.declare(cython.double, math.pi)
# rays beside an empty sector, at most, from which a face is extrapolated
_EDGE_RAYS = cython.declare(cython.Py_ssize_t, 8)
# m by which a face approaches over these rays, more than noise does
_MIN_APPROACH = cython.declare(cython.double, 0.02)
_MAX_SLOPE = cython.declare(cython.double, 0.06)  # m per ray by which a face approaches at most
# half width: an obstacle in a narrower sector is level at its ends
_FLAT = cython.declare(cython.double, math.radians(20.0))

_PI = cython.declare(cython.double, math.pi)
_TURN = cython.declare(cython.double, 2.0 * math.pi)


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _mod(angle: cython.double) -> cython.double:
    """The angle modulo a full turn, with the bits of numpy's %."""
    if 0.0 <= angle < _TURN:
        return angle
    if -_TURN < angle < 0.0:  # as fmod, which is exact and slow
        return angle + _TURN
    if _TURN <= angle < 2.0 * _TURN:
        return angle - _TURN
    rest: cython.double = fmod(angle, _TURN)
    if rest < 0.0:
        rest += _TURN
    return rest


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _apart(angle: cython.double, direction: cython.double) -> cython.double:
    """The angle between two directions."""
    return fabs(_mod(angle - direction + _PI) - _PI)


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _wrapped(i: cython.Py_ssize_t, n: cython.Py_ssize_t) -> cython.Py_ssize_t:
    """i modulo n, for i below 2 n, without a slow division."""
    return i - n if i >= n else i


@cython.cfunc
def _nearest(
    rising: cython.double[::1], n: cython.Py_ssize_t, wanted: cython.double
) -> cython.Py_ssize_t:
    """The index of the angle nearest to `wanted`, of n > 0 rising angles."""
    angle: cython.double = _mod(wanted)
    low: cython.Py_ssize_t = 0
    high: cython.Py_ssize_t = n
    middle: cython.Py_ssize_t
    while low < high:
        middle = (low + high) // 2
        if rising[middle] < angle:
            low = middle + 1
        else:
            high = middle
    after: cython.Py_ssize_t = low if low < n else 0
    before: cython.Py_ssize_t = after - 1 if after else n - 1
    if _apart(rising[before], wanted) < _apart(rising[after], wanted):
        return before
    return after


@cython.cfunc
def _has_near(ranges: cython.const[cython.double][::1], limit: cython.double) -> cython.bint:
    """True if a ray has a return with a range up to `limit` m."""
    i: cython.Py_ssize_t
    for i in range(ranges.shape[0] if cython.compiled else len(ranges)):
        if -INFINITY < ranges[i] <= limit:
            return True
    return False


_NOTHING = np.empty(0)


def _zeros(n, kind=np.float64):
    """A buffer of n zeros; in CPython a list."""
    return np.zeros(n, kind) if cython.compiled else np.zeros(n, kind).tolist()


def _grown(old, n):
    """A buffer of n numbers that begins with those of `old`."""
    new = _zeros(n)
    new[: len(old)] = old
    return new


@cython.cclass
class BlindZoneMemory:
    """The hidden obstacles of one sensor, in the base frame of the last scan.

    `bearings` (n,) in rad: a hidden obstacle may lie along each. `nearest` (n,) in m from the
    sensor: the obstacle along the bearing is no nearer.
    """

    bearings = cython.declare(object, visibility="readonly")
    nearest = cython.declare(object, visibility="readonly")
    _blind: cython.double
    _speed: cython.double
    _period: cython.double
    _narrow: cython.double
    _given: object
    _n: cython.Py_ssize_t
    _reserved: cython.Py_ssize_t
    # Per ray, in the order of rising bearings.
    _order: cython.longlong[::1]
    _bearing: cython.double[::1]
    _rising: cython.double[::1]
    _range: cython.double[::1]
    _is_empty: cython.uchar[::1]
    _inside: cython.uchar[::1]
    _age_of: cython.double[::1]
    _nearest_of: cython.double[::1]
    _face_of: cython.uchar[::1]
    _exact: cython.double[::1]
    # Empty sectors: the first ray, the number of rays, at how many ends (0 to 2) an obstacle
    # crosses the rim, and m to the square corner of rule 2.
    _sectors: cython.Py_ssize_t
    _first: cython.Py_ssize_t[::1]
    _width: cython.Py_ssize_t[::1]
    _crossings: cython.Py_ssize_t[::1]
    _corner: cython.double[::1]
    # Near points of this scan, of the last one, and rays without return of the last one.
    _points: cython.Py_ssize_t
    _x: cython.double[::1]
    _y: cython.double[::1]
    _old_points: cython.Py_ssize_t
    _old_x: cython.double[::1]
    _old_y: cython.double[::1]
    _were_empty: cython.Py_ssize_t
    _empty_bearing: cython.double[::1]
    _turned: cython.double[::1]
    # `_found` rising angles, in which `_nearest` searches, and the rays to which they belong.
    _found: cython.Py_ssize_t
    _angle: cython.double[::1]
    _ray: cython.Py_ssize_t[::1]
    # Hidden obstacles, then those that have vanished since.
    _hidden: cython.Py_ssize_t
    _candidates: cython.Py_ssize_t
    _bearings: object
    _ranges: object
    _hidden_at: cython.double[::1]
    _age: cython.double[::1]
    _near: cython.double[::1]
    _is_face: cython.double[::1]
    _is_hidden: cython.uchar[::1]
    _entered_x: cython.double
    _entered_y: cython.double
    # m beside the rim that came into view since the memory was empty, and that went out of view
    _emerged: cython.double
    _vanished: cython.double

    def __init__(self, range_min: float, speed: float, period: float) -> None:
        """Begin without hidden obstacles.

        `range_min` in m is the radius of the blind zone, `speed` in m/s the highest speed at which
        obstacles approach, `period` in s the time between two scans.
        """
        self._blind, self._speed, self._period = range_min, speed, period
        # rad: the narrowest sector in which a robot may be hidden
        self._narrow = 2.0 * math.asin(min(0.5 * _MIN_WIDTH / range_min, 1.0))
        self._given = None
        self._n = self._reserved = self._points = self._old_points = self._were_empty = (
            self._hidden
        ) = 0
        self._entered_x = self._entered_y = self._emerged = self._vanished = 0.0
        self._x = self._y = self._old_x = self._old_y = self._empty_bearing = _NOTHING
        self._hidden_at = self._age = self._near = self._is_face = _NOTHING
        self.bearings = self.nearest = _NOTHING
        self._order = self._first = self._width = self._crossings = self._ray = None
        self._bearing = self._rising = self._range = self._age_of = self._nearest_of = None
        self._exact = self._corner = self._turned = self._angle = None
        self._is_empty = self._inside = self._face_of = self._is_hidden = None

    def update(
        self, scan: Scan, geometry: ScanGeometry, moved: Pose, driven: Pose, seconds: float
    ) -> None:
        """Take in a scan, taken `seconds` after the scan before.

        `moved` is the motion since the scan before. `driven` is the part of this motion that the
        robot's own commands explain; only this part counts as moving away (rule 4).
        """
        table = np.ascontiguousarray(scan.ranges, np.float64)
        given: cython.const[cython.double][::1] = table if cython.compiled else table.tolist()
        step: cython.double = self._speed * min(seconds, 5.0 * self._period) + _RANGE_NOISE
        limit: cython.double = self._blind + 2.0 * step
        self._x, self._old_x = self._old_x, self._x
        self._y, self._old_y = self._old_y, self._y
        self._old_points, self._points = self._points, 0
        if not (self._old_points or self._hidden or _has_near(given, limit)):
            return  # the usual case: no obstacle is near, was near or is hidden
        if scan.bearings is not self._given:
            self._set_bearings(scan.bearings)
        n: cython.Py_ssize_t = self._n
        least: cython.double = scan.range_min
        ahead: cython.double = geometry.offset[0]
        left: cython.double = geometry.offset[1]
        i: cython.Py_ssize_t
        ray: cython.Py_ssize_t
        for i in range(n):
            ray = self._order[i]
            distance = self._range[i] = given[ray]
            if -INFINITY < distance <= limit:
                distance = max(distance, least)
                self._x[self._points] = ahead + distance * cos(self._bearing[i])
                self._y[self._points] = left + distance * sin(self._bearing[i])
                self._points += 1
        self._leave(driven.x, driven.y, moved.yaw)
        self._find(moved.x, moved.y, moved.yaw, ahead, left, seconds, step)
        self._were_empty = 0
        for i in range(n):
            if isinf(self._range[i]):
                self._empty_bearing[self._were_empty] = self._bearing[i]
                self._were_empty += 1

    @cython.cfunc
    def _set_bearings(self, bearings):
        """Take new bearings of the rays, and sort the rays by them."""
        table = np.ascontiguousarray(bearings, np.float64)
        values: cython.const[cython.double][::1] = table if cython.compiled else table.tolist()
        n: cython.Py_ssize_t = len(values)
        if n > self._reserved:
            self._reserve(n + n // 4)
        self._given, self._n = bearings, n
        i: cython.Py_ssize_t
        for i in range(n):
            self._turned[i] = _mod(values[i])
        if not self._sort(values):
            sorted_rays: cython.longlong[::1] = np.argsort(table % _TURN, kind="stable")
            self._order[:n] = sorted_rays
        for i in range(n):
            self._bearing[i] = values[self._order[i]]
            self._rising[i] = self._turned[self._order[i]]

    @cython.cfunc
    def _sort(self, values: cython.const[cython.double][::1]) -> cython.bint:
        """Order the rays by rising angles with a stable insertion sort; False if this is too slow.

        The angles of most sensors rise or fall from the lowest angle on, with few exceptions, so an
        insertion sort from there is fast.
        """
        n: cython.Py_ssize_t = self._n
        first: cython.Py_ssize_t = 0
        rises: cython.Py_ssize_t = 0
        moves: cython.Py_ssize_t = 0
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        ray: cython.Py_ssize_t
        for i in range(1, n):
            rises += 1 if values[i] > values[i - 1] else -1
            if self._turned[i] < self._turned[first]:
                first = i
        for i in range(n):
            ray = _wrapped(first + i if rises >= 0 else first - i + n, n)
            angle, k = self._turned[ray], i
            while k > 0 and (
                self._rising[k - 1] > angle
                or (self._rising[k - 1] == angle and self._order[k - 1] > ray)
            ):
                self._rising[k], self._order[k] = self._rising[k - 1], self._order[k - 1]
                k -= 1
            self._rising[k], self._order[k] = angle, ray
            moves += i - k
            if moves > 8 * n:
                return False
        return True

    @cython.cfunc
    def _reserve(self, size: cython.Py_ssize_t):
        """Make room for `size` rays; the hidden obstacles and the near points are kept."""
        self._reserved = size
        self._order = _zeros(size, np.int64)
        self._bearing, self._rising = _zeros(size), _zeros(size)
        self._range, self._exact, self._corner = _zeros(size), _zeros(size), _zeros(size)
        self._age_of, self._nearest_of = _zeros(size), _zeros(size)
        self._is_empty, self._inside = _zeros(size, np.uint8), _zeros(size, np.uint8)
        self._face_of = _zeros(size, np.uint8)
        self._first, self._width = _zeros(size, np.intp), _zeros(size, np.intp)
        self._crossings, self._ray = _zeros(size, np.intp), _zeros(size, np.intp)
        self._x, self._y = _grown(self._x, size), _grown(self._y, size)
        self._old_x, self._old_y = _grown(self._old_x, size), _grown(self._old_y, size)
        self._empty_bearing = _grown(self._empty_bearing, size)
        self._angle, self._turned = _zeros(size), _zeros(size)
        # Candidates: at most a hidden obstacle for each ray, and one for each earlier near point.
        self._bearings = self._hidden_at = _grown(self._hidden_at, 2 * size)
        self._ranges = self._near = _grown(self._near, 2 * size)
        self._age, self._is_face = _grown(self._age, 2 * size), _grown(self._is_face, 2 * size)
        self._is_hidden = _zeros(2 * size, np.uint8)

    @cython.cfunc
    def _leave(
        self, driven_x: cython.double, driven_y: cython.double, turned: cython.double
    ) -> cython.int:
        """Update the place at which the last obstacle became hidden, in the base frame."""
        c: cython.double = cos(turned)
        s: cython.double = sin(turned)
        x: cython.double = self._entered_x - driven_x
        y: cython.double = self._entered_y - driven_y
        self._entered_x, self._entered_y = c * x + s * y, c * y - s * x
        return 0

    @cython.cfunc
    def _find(
        self,
        moved_x: cython.double,
        moved_y: cython.double,
        turned: cython.double,
        ahead: cython.double,
        left: cython.double,
        seconds: cython.double,
        step: cython.double,
    ):
        """Find the obstacles that are hidden now; `step` in m is their motion between two scans."""
        n: cython.Py_ssize_t = self._n
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        c: cython.double = cos(turned)
        s: cython.double = sin(turned)
        self._find_sectors()
        if not self._sectors:
            self._keep(0)
            return
        # Mark the rays of sectors that an obstacle enters across the rim.
        is_entered: cython.bint = False
        for i in range(n):
            self._inside[i] = False
        for k in range(self._sectors):
            if self._crossings[k]:
                is_entered = True
                for i in range(self._first[k], self._first[k] + self._width[k]):
                    self._inside[_wrapped(i, n)] = True
        # Let the hidden obstacles approach, and add those that have vanished.
        for i in range(self._hidden):
            self._hidden_at[i] -= turned
            self._near[i] = max(self._near[i] - self._speed * seconds, 0.0)
            if self._near[i] == 0.0:
                self._is_face[i] = 0.0
        self._candidates = self._hidden
        self._vanish(moved_x, moved_y, c, s, ahead, left, step, is_entered)
        if not (self._candidates or is_entered):
            self._keep(0)
            return
        if self._candidates > self._hidden or is_entered:
            self._entered_x = self._entered_y = 0.0
        # Give each candidate a ray, extend the obstacles over their sectors, and keep the rays.
        self._place(turned, step)
        self._fill(seconds)
        k = 0
        for i in range(n):
            if self._age_of[i] < INFINITY:
                self._hidden_at[k], self._age[k] = self._exact[i], self._age_of[i]
                self._near[k], self._is_face[k] = self._nearest_of[i], self._face_of[i]
                k += 1
        self._keep(k)

    @cython.cfunc
    def _keep(self, count: cython.Py_ssize_t):
        """Keep the first `count` hidden obstacles, and publish them in `bearings`, `nearest`."""
        self._hidden = count
        if not count:
            self._emerged = self._vanished = 0.0
        self.bearings = np.array(self._bearings[:count]) if count else _NOTHING
        self.nearest = np.array(self._ranges[:count]) if count else _NOTHING

    @cython.cfunc
    def _find_sectors(self) -> cython.int:
        """Find the empty sectors: runs of at least `_MIN_EMPTY_RUN` empty rays."""
        n: cython.Py_ssize_t = self._n
        i: cython.Py_ssize_t
        first: cython.Py_ssize_t = 0
        end: cython.Py_ssize_t
        self._sectors = 0
        for i in range(n):
            self._is_empty[i] = False
        while first < n and isinf(self._range[first]):
            first += 1
        if first == n:  # a ring without any return
            if n >= _MIN_EMPTY_RUN:
                self._add_sector(0, n)
            return 0
        # Begin at a ray with a return, so that no run spans the end of the arrays.
        last: cython.Py_ssize_t = first + n
        i = first
        while i < last:
            end = i
            while end < last and isinf(self._range[_wrapped(end, n)]):
                end += 1
            if end - i >= _MIN_EMPTY_RUN:
                self._add_sector(_wrapped(i, n), end - i)
            i = end + 1
        return 0

    @cython.cfunc
    def _add_sector(self, first: cython.Py_ssize_t, width: cython.Py_ssize_t) -> cython.int:
        n: cython.Py_ssize_t = self._n
        k: cython.Py_ssize_t = self._sectors
        i: cython.Py_ssize_t
        for i in range(first, first + width):
            self._is_empty[_wrapped(i, n)] = True
        half: cython.double = width * _PI / n
        is_flat: cython.bint = half < _FLAT
        self._first[k], self._width[k] = first, width
        self._crossings[k] = 0
        if self._crosses_rim((first + n - 1) % n, -1, is_flat):
            self._crossings[k] += 1
        if self._crosses_rim((first + width) % n, 1, is_flat):
            self._crossings[k] += 1
        self._corner[k] = max(self._blind * (cos(half) - sin(half)), 0.0)
        self._sectors += 1
        return 0

    @cython.cfunc
    def _crosses_rim(
        self, ray: cython.Py_ssize_t, direction: cython.Py_ssize_t, is_flat: cython.bint
    ) -> cython.bint:
        """True if an obstacle beside an empty sector crosses the rim into the sector.

        `ray` is the ray beside the sector, `direction` (1 or -1) leads away from the sector. In a
        narrow sector (`is_flat`) the range at the ray must be near the rim. In a wide sector the
        ranges must fall towards the sector, so that the face lies within the rim one ray further.
        """
        n: cython.Py_ssize_t = self._n
        if is_flat:
            return self._range[ray] <= self._blind + _MAX_SLOPE
        first: cython.double = self._finite(ray)
        last: cython.double = first
        count: cython.Py_ssize_t = 0
        i: cython.Py_ssize_t = ray
        while count < _EDGE_RAYS:
            i = (i + direction + n) % n
            after = self._finite(i)
            if not fabs(after - last) < 2.0 * _MAX_SLOPE:
                break
            last = after
            count += 1
        approach: cython.double = last - first
        if count < 3 or approach < _MIN_APPROACH:
            return False
        return first - min(approach / count, _MAX_SLOPE) <= self._blind + _RANGE_NOISE

    @cython.cfunc
    def _finite(self, ray: cython.Py_ssize_t) -> cython.double:
        return self._range[ray] if isfinite(self._range[ray]) else 1e9

    @cython.cfunc
    def _vanish(
        self,
        moved_x: cython.double,
        moved_y: cython.double,
        c: cython.double,
        s: cython.double,
        ahead: cython.double,
        left: cython.double,
        step: cython.double,
        is_entered: cython.bint,
    ) -> cython.int:
        """Add the near returns of the scan before that may have crossed the rim as candidates.

        A return is a candidate if no return lies near its place any more, or if an obstacle enters
        its sector. Also updates `_emerged` and `_vanished`, in m of obstacle beside the rim.
        """
        stride: cython.Py_ssize_t = 1 + self._points // _MAX_POINTS
        limit: cython.double = step + _SHAPE_CHANGE
        is_gone: cython.bint
        start: cython.Py_ssize_t = 0  # search from the last match: neighbours lie side by side
        count: cython.Py_ssize_t = (self._points + stride - 1) // stride
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        ray: cython.Py_ssize_t
        for i in range(self._old_points):
            x_here, y_here = self._old_x[i] - moved_x, self._old_y[i] - moved_y
            x, y = c * x_here + s * y_here, c * y_here - s * x_here
            if not hypot(x - ahead, y - left) < self._blind + step:
                continue
            is_gone = True
            for j in range(count):
                k = start + j
                if k >= count:
                    k -= count
                x_here = self._x[k * stride] - x
                y_here = self._y[k * stride] - y
                if (
                    fabs(x_here) <= limit
                    and fabs(y_here) <= limit
                    and hypot(x_here, y_here) <= limit
                ):
                    is_gone, start = False, k
                    break
            bearing = atan2(y - left, x - ahead)
            ray = _nearest(self._rising, self._n, bearing)
            if isinf(self._range[ray]):
                width = hypot(x - ahead, y - left) * _TURN / self._n
                self._emerged -= width
                self._vanished += width
            if is_gone or (is_entered and self._inside[ray]):
                k = self._candidates
                self._hidden_at[k], self._age[k] = bearing, 0.0 if is_gone else _DOUBTFUL
                self._near[k], self._is_face[k] = self._blind - step, not is_gone
                self._candidates += 1
        return 0

    @cython.cfunc
    def _place(self, turned: cython.double, step: cython.double) -> cython.int:
        """Give each candidate that is still hidden its ray, by rules 3 to 5.

        Sets age, distance and kind of the obstacle of each ray; an age of inf: no obstacle.
        """
        n: cython.Py_ssize_t = self._n
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        ray: cython.Py_ssize_t
        reach: cython.double = step / (_MIN_HIDDEN_RANGE * self._blind)
        shift: cython.double = min(reach, 0.25 * _PI)
        is_here: cython.bint = (
            hypot(self._entered_x, self._entered_y) < _FORGET_DISTANCE * self._blind
        )
        self._find_reappeared(turned, step)
        self._emerged = max(self._emerged, 0.0)
        has_emerged: cython.bint = self._emerged >= min(_MIN_EMERGED, 0.5 * self._vanished)
        for k in range(self._candidates):
            self._is_hidden[k] = is_here and self._age[k] < _NARROW_MEMORY
            if has_emerged and k < self._hidden and self._found:
                i = _nearest(self._angle, self._found, self._hidden_at[k])
                off = _apart(self._angle[i], self._hidden_at[k])
                if off <= shift:
                    self._is_hidden[k] = False
                elif off <= reach:
                    self._age[k] = max(self._age[k], _DOUBTFUL)
        self._found = 0
        for i in range(n):
            self._exact[i] = self._bearing[i]
            self._age_of[i] = self._nearest_of[i] = INFINITY
            self._face_of[i] = True
            if self._is_empty[i]:
                self._angle[self._found], self._ray[self._found] = self._rising[i], i
                self._found += 1
        for k in range(self._candidates):
            if not self._is_hidden[k]:
                continue
            i = _nearest(self._angle, self._found, self._hidden_at[k])
            off = _apart(self._angle[i], self._hidden_at[k])
            if off > shift:
                continue
            ray = self._ray[i]
            self._age_of[ray] = min(self._age_of[ray], self._age[k])
            self._nearest_of[ray] = min(self._nearest_of[ray], self._near[k])
            self._face_of[ray] = self._face_of[ray] and self._is_face[k] != 0.0
            if off <= _PI / n:  # a slow turn would be lost in whole rays
                self._exact[ray] = self._hidden_at[k]
        return 0

    @cython.cfunc
    def _find_reappeared(self, turned: cython.double, step: cython.double) -> cython.int:
        """Find the returns near the rim whose rays were empty in the scan before.

        Sets `_angle` to their angles, `_found` to their number, and adds to `_emerged`.
        """
        n: cython.Py_ssize_t = self._n
        count: cython.Py_ssize_t = self._were_empty
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        is_turned: cython.bint = False
        self._found = 0
        if not count:
            return 0
        for i in range(n):
            if -INFINITY < self._range[i] <= self._blind + step:
                if not is_turned:
                    self._turn_empty(turned)
                    is_turned = True
                k = _nearest(self._turned, count, self._bearing[i])
                if _apart(self._turned[k], self._bearing[i]) <= _PI / n:
                    self._angle[self._found] = self._rising[i]
                    self._found += 1
                    self._emerged += self._range[i] * _TURN / n
        return 0

    @cython.cfunc
    def _turn_empty(self, turned: cython.double) -> cython.int:
        """Set `_turned` to the rising angles of the rays that were empty, in the present frame."""
        count: cython.Py_ssize_t = self._were_empty
        first: cython.Py_ssize_t = 0
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        for i in range(1, count):  # they rise but for one place
            if _mod(self._empty_bearing[i] - turned) < _mod(self._empty_bearing[i - 1] - turned):
                first = i
        for i in range(count):
            k = first + i
            angle = _mod(self._empty_bearing[k - count if k >= count else k] - turned)
            k = i
            while k > 0 and self._turned[k - 1] > angle:  # by rounding
                self._turned[k] = self._turned[k - 1]
                k -= 1
            self._turned[k] = angle
        return 0

    @cython.cfunc
    def _fill(self, seconds: cython.double) -> cython.int:
        """Extend each hidden obstacle over its empty sector, and let doubtful ones grow older.

        Four kinds of sectors, in order: obstacles cross the rim at both ends; a hidden obstacle in
        a sector that is not too wide; no crossing; else the rays stay as they are.
        """
        n: cython.Py_ssize_t = self._n
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        first: cython.Py_ssize_t
        end: cython.Py_ssize_t
        for k in range(self._sectors):
            first, end = self._first[k], self._first[k] + self._width[k]
            youngest = nearest = INFINITY
            for i in range(first, end):
                youngest = min(youngest, self._age_of[_wrapped(i, n)])
                nearest = min(nearest, self._nearest_of[_wrapped(i, n)])
            width = self._width[k] * 2.0 * _PI / n
            if self._crossings[k] == 2 and width < _MAX_FACE:
                for i in range(first, end):
                    self._age_of[_wrapped(i, n)] = min(self._age_of[_wrapped(i, n)], _DOUBTFUL)
                    if self._face_of[_wrapped(i, n)]:
                        self._nearest_of[_wrapped(i, n)] = self._corner[k]
            elif youngest < INFINITY and width <= _MAX_SECTOR:
                if width >= self._narrow:
                    youngest = 0.0
                elif self._crossings[k]:
                    youngest = min(youngest, _DOUBTFUL)
                else:
                    youngest += seconds
                for i in range(first, end):
                    self._age_of[_wrapped(i, n)], self._nearest_of[_wrapped(i, n)] = (
                        youngest,
                        nearest,
                    )
            elif not self._crossings[k]:
                for i in range(first, end):
                    if 0.0 < self._age_of[_wrapped(i, n)] < INFINITY:
                        self._age_of[_wrapped(i, n)] += seconds
        return 0
