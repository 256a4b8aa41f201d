"""The way of a scan and of odometry through the sensors, and the features of a scan.

A kernel (see `core/kernels.py`). `conditioning.py`, `scan_delay.py` and `deskew.py` say what its
classes do, and `rays.py` what its functions find.
"""

from __future__ import annotations

import math
from array import array
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from swarmd.core.messages import DelayFigure, Reason, ScanDelaySummary
from swarmd.core.values import (
    MAX_COORDINATE,
    MAX_SPEED,
    MAX_STEP,
    ZERO,
    Array,
    Odometry,
    Scan,
    ScanSpec,
)
from swarmd.sensing.blind_sector import SECTORS, blind_text
from swarmd.sensing.conditioning import (
    COMPARED_SCANS,
    MAX_REPEATS,
    MIN_DISTINCT_RETURNS,
    widest_between_rays,
)
from swarmd.sensing.deskew import Rays
from swarmd.sensing.measured_sweep import Headings, MeasuredSweep
from swarmd.sensing.odometry_history import HISTORY, MAX_EXTRAPOLATION
from swarmd.sensing.scan_delay import (
    LONGEST_SHARED,
    MAX_LEAD,
    TOLERANCE,
    figure_of,
    lead,
    wrong_stamps,
)

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import (
        INFINITY,
        NAN,
        asin,
        atan2,
        ceil,
        cos,
        fabs,
        floor,
        fmod,
        hypot,
        isfinite,
        isnan,
        remainder,
        rint,
        sin,
        sqrt,
        tan,
    )
    from cython.cimports.libc.string import memcmp
else:
    from swarmd.core.cython_shadow import (
        INFINITY,
        NAN,
        asin,
        atan2,
        ceil,
        cos,
        fabs,
        floor,
        fmod,
        hypot,
        isfinite,
        isnan,
        remainder,
        rint,
        sin,
        sqrt,
        tan,
    )

PACKET_RAYS = 6  # rays that an LDS loses together

_PI = cython.declare(cython.double, math.pi)
_TURN = cython.declare(cython.double, 2.0 * math.pi)
# m: the range given to rays without a return, so that they form runs.
_UNSEEN = cython.declare(cython.double, 1e9)
_MAX_LAYOUTS = cython.declare(cython.int, 8)
# Far returns that do not vanish from one scan to the next: so many, and this share of the rays.
# Fewer may vanish: those of a ring of few sensors.
_BLIND_RETURNS = cython.declare(cython.double, 8.0)
_BLIND_SHARE = cython.declare(cython.double, 0.1)
# m above range_min: an LDS ray this near may turn into a zero.
_NEAR_MARGIN = cython.declare(cython.double, 0.10)
# s for which a near ray explains zeros.
_NEAR_MEMORY = cython.declare(cython.double, 1.0)
# rad beside a near ray in which zeros may mean near.
_NEAR_SECTOR = cython.declare(cython.double, math.radians(3.0) + 1e-9)
_PACKET_RAYS = cython.declare(cython.Py_ssize_t, PACKET_RAYS)
# Scans in order after which a lower sequence or stamp counts as a restart.
_RESTART_SCANS = cython.declare(cython.int, 3)
_MAX_RAY_AGE = cython.declare(cython.double, 10.0)  # s: more is garbage
_MOVES_LINEAR = cython.declare(cython.double, 0.02)  # m/s above which the robot counts as moving
_MOVES_ANGULAR = cython.declare(cython.double, 0.05)  # rad/s

# De-skew.
_READINGS = cython.declare(cython.Py_ssize_t, HISTORY)
_MAX_EXTRAPOLATION = cython.declare(cython.double, MAX_EXTRAPOLATION)
_MAX_STEP = cython.declare(cython.double, MAX_STEP)
_MAX_SPEED = cython.declare(cython.double, MAX_SPEED)
_MAX_COORDINATE = cython.declare(cython.double, MAX_COORDINATE)
_MIN_STEP = cython.declare(cython.double, 1e-9)  # s between two poses of a path
# m and rad during one scan: a robot that moves less is at rest, and its scan is not changed.
_AT_REST = cython.declare(cython.double, 5e-4)

# Blind sectors.
_SECTORS = cython.declare(cython.Py_ssize_t, SECTORS)
_LOOK_PERIOD = cython.declare(cython.double, 0.95)  # s between two looks, at least
# directions, each a sector wide, in which a blind sector has missed something
_MISSED = cython.declare(cython.Py_ssize_t, 8)
_MAX_TIME = cython.declare(cython.double, 15.0)  # s for which what is seen counts as static
# of the range by which the robot may move: things change their direction
_MAX_MOTION = cython.declare(cython.double, 0.25)
_LIKE = cython.declare(cython.double, 0.25)  # of the range by which a thing may seem to move, and
_LIKE_M = cython.declare(cython.double, 0.1)  # m
# looks in a row in which a static thing is seen, before and after it is missed
_STREAK = cython.declare(cython.int, 3)
# scans in a row with a return, after which a blind sector is trusted again
_CLEARING = cython.declare(cython.int, 3)

# Delay by turns.
_CANDIDATES = cython.declare(cython.Py_ssize_t, 49)
_LONGEST = cython.declare(cython.double, 1.2)  # s, of the last candidate
_STEP = cython.declare(cython.double, 1.2 / 48)
_HISTORY = cython.declare(cython.Py_ssize_t, 96)  # headings
_SPACING = cython.declare(cython.double, 0.02)  # s between two of them, at least
_MIN_RATE_CHANGE = cython.declare(cython.double, 0.15)  # rad/s
# rad by which candidates must differ for a pair of scans to tell anything
_MIN_TURN_SPREAD = cython.declare(cython.double, 0.06)
# rad by which the search for the turn goes beyond the turns of all candidates
_SEARCHED = cython.declare(cython.double, 0.25)
# rad; beyond it a square room looks like itself
_MAX_SEARCHED = cython.declare(cython.double, 1.2)
# m between two scans: a shift of near things looks like a turn
_MAX_SHIFT = cython.declare(cython.double, 0.03)
_MIN_RAYS = cython.declare(cython.Py_ssize_t, 90)
# m; farther returns count as if they were there
_MAX_RANGE = cython.declare(cython.double, 6.0)
# m, standard deviation of ranges below which a scene has no features
_MIN_RELIEF = cython.declare(cython.double, 0.1)
# correlation of two scans at the turn found
_MIN_LIKENESS = cython.declare(cython.double, 0.6)
# of earlier pairs, for each new one: some 50 count
_FORGETTING = cython.declare(cython.double, 0.98)
_MIN_PAIRS = cython.declare(cython.double, 8.0)
# rad of one measured turn: things that move by themselves turn a scene by that, for seconds
_MIN_SPREAD = cython.declare(cython.double, 0.025)
# factor on the spread, as errors of pairs are not independent: 1.7 in simulation
_ALIKE = cython.declare(cython.double, 2.0)
# s of candidates within three deviations: a wider one is no figure
_MAX_INTERVAL = cython.declare(cython.double, 0.2)
_LOWEST_SCALE = cython.declare(cython.double, 0.85)  # of odometry
_HIGHEST_SCALE = cython.declare(cython.double, 1.15)
# after which only each fourth scan is compared with the one before it
_ENOUGH_PAIRS = cython.declare(cython.Py_ssize_t, 20)

# Delay by stamps.
_CLEARS = cython.declare(
    cython.double, 0.8
)  # share of the bound below which a late scan is in time
_STAMPS = cython.declare(cython.Py_ssize_t, 20)  # scans of which the third-latest is the delay
_MIN_STAMPS = cython.declare(cython.Py_ssize_t, 5)  # scans before stamps give a figure
_PERIOD = cython.declare(cython.double, 0.5)  # s of odometry whose lowest lag is kept
# s after which stamps tell again whether scan and odometry share a clock
_RESTART_TIME = cython.declare(cython.double, 2.5)
# s between periods: beyond it, three times one way, the clock is no real time
_MAX_DRIFT = cython.declare(cython.double, 0.005)
# s by which odometry gets later at once, or earlier: its clock was set then
_SHIFT = cython.declare(cython.double, 0.1)
_MAX_AGE = cython.declare(cython.double, LONGEST_SHARED)
# s: what a clock that was set shows at most, so that a status can tell it
_LONGEST_AGE = cython.declare(cython.double, 1000.0)
_MAX_LEAD = cython.declare(cython.double, MAX_LEAD)
# Spreads by which turns must exceed declaration and stamps.
_CERTAIN = cython.declare(cython.double, 2.5)
_EXPIRES = cython.declare(
    cython.double, 60.0
)  # s after which turns no longer say that scans are late
_TOLERANCE = cython.declare(cython.double, TOLERANCE)


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
def _wrapped(i: cython.Py_ssize_t, n: cython.Py_ssize_t) -> cython.Py_ssize_t:
    """i modulo n, for i below 2 n: to divide is slow."""
    return i - n if i >= n else i


@cython.cfunc
def _view(values):
    """What a view of an array is made of; CPython indexes memory faster than arrays."""
    return values if cython.compiled else memoryview(values)


@cython.cfunc
def _doubles(n: cython.Py_ssize_t) -> cython.double[::1]:
    """A buffer. Views that are made in one place spare the compiler a fifth of its work."""
    return memoryview(np.empty(n))


@cython.cfunc
def _places(n: cython.Py_ssize_t) -> cython.longlong[::1]:
    return memoryview(np.empty(n, np.int64))


@cython.cfunc
def _marks(n: cython.Py_ssize_t) -> cython.uchar[::1]:
    return memoryview(np.empty(n, np.uint8))


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _apart(one: cython.double, other: cython.double) -> cython.double:
    """The angle between two directions."""
    return fabs(_mod(one - other + _PI) - _PI)


@cython.cfunc
def _nearest(
    rising: cython.double[::1], n: cython.Py_ssize_t, wanted: cython.double, hint: cython.Py_ssize_t
) -> cython.Py_ssize_t:
    """The place of the nearest of n rising angles; that of the last call is a good `hint`."""
    angle: cython.double = _mod(wanted)
    low: cython.Py_ssize_t = 0
    high: cython.Py_ssize_t = n
    middle: cython.Py_ssize_t
    for middle in range(hint, min(hint + 3, n)):
        if rising[middle] >= angle and (middle == 0 or rising[middle - 1] < angle):
            low = high = middle
            break
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


@cython.auto_pickle(False)
@cython.cclass
class _Layout:
    """The bearings of a scan and what derives from them; buffers for the features of a scan.

    A robot that moves has other bearings in each scan, so the buffers are used again.
    """

    n: cython.Py_ssize_t
    capacity: cython.Py_ssize_t
    given: cython.double[::1]
    angles: object
    wrapped: cython.double[::1]
    order: cython.longlong[::1]
    is_ordered: cython.bint
    rising: cython.double[::1]
    steps: cython.double[::1]
    spacing: cython.double
    grazing: cython.double
    slopes: cython.double[::1]
    is_apart: cython.uchar[::1]
    count: cython.Py_ssize_t
    sector: cython.longlong[::1]
    lowest: cython.double[::1]
    nearest_ray: cython.Py_ssize_t[::1]
    work: cython.double[::1]
    is_last: cython.uchar[::1]
    points: object
    found: object
    found_counts: object
    found_free: object
    point: cython.double[:, ::1]
    ranges: cython.double[::1]
    bearings: cython.double[::1]
    widths: cython.double[::1]
    counts: cython.longlong[::1]
    is_free: cython.uchar[::1]
    scan: object  # the last one of these bearings, if nothing can change it, and its known ranges
    known: cython.const[cython.double][::1]

    def __init__(self, n):
        """For up to n bearings."""
        self.capacity = n
        self.angles, self.steps, self.given = np.empty(n), _doubles(n), _doubles(n)
        self.wrapped, self.work = memoryview(self.angles), _doubles(n)
        self.rising, self.slopes = _doubles(n), _doubles(n)
        self.order, self.sector = _places(n), _places(n)
        self.is_apart, self.is_last = _marks(n), _marks(n)
        self.found, self.found_counts = np.empty((3, n)), np.empty(n, np.int64)
        self.found_free = np.empty(n, np.bool_)
        self.ranges, self.bearings, self.widths = map(memoryview, self.found)
        self.counts = memoryview(self.found_counts)
        self.is_free = memoryview(self.found_free.view(np.uint8))

    @cython.cfunc
    def is_of(self, bearings: cython.const[cython.double][::1]) -> cython.bint:
        n: cython.Py_ssize_t = self.n
        if bearings.shape[0] != n:
            return False
        if cython.compiled:
            return memcmp(cython.address(bearings[0]), cython.address(self.given[0]), 8 * n) == 0
        return bearings == self.given[:n]

    @cython.cfunc
    def set_bearings(self, bearings: cython.const[cython.double][::1]) -> cython.int:
        i: cython.Py_ssize_t
        self.n = bearings.shape[0]
        for i in range(self.n):
            if not isfinite(bearings[i]):
                raise ValueError(f"bearing {i} of a scan is {bearings[i]}; expected a finite angle")
            self.given[i] = bearings[i]
            self.wrapped[i] = _mod(bearings[i] + _PI) - _PI
        self.is_ordered, self.grazing, self.count = False, NAN, -1
        return 0

    @cython.cfunc
    @cython.boundscheck(False)
    def set_grazing(self, grazing: cython.double):
        """Set the order of rising bearings, the steps to the next, and what a surface makes.

        `slopes`: of a surface at `grazing` rad to the next ray. `is_apart`: rays that are too far
        apart; up to two rays may be unknown in the middle of an object.
        """
        n: cython.Py_ssize_t = self.n
        i: cython.Py_ssize_t
        if not self.is_ordered:
            if not self.has_sorted():
                order: cython.longlong[::1] = np.argsort(self.angles[:n], kind="stable")
                self.order[:n] = order
            for i in range(n):
                self.rising[i] = self.wrapped[self.order[i]]
            for i in range(n - 1):
                self.steps[i] = self.rising[i + 1] - self.rising[i]
            self.steps[n - 1] = self.rising[0] - self.rising[n - 1] + _TURN
            self.slopes[:n] = self.steps[:n]
            self.spacing = _smallest(self.slopes, n, n // 2)
            self.is_ordered = True
        if grazing != self.grazing:
            slope: cython.double = tan(grazing)
            least: cython.double = min(3.5 * self.spacing, 0.5 * _PI)
            for i in range(n):
                self.slopes[i] = self.steps[i] / slope if slope else INFINITY
                self.is_apart[i] = self.steps[i] >= least
            self.grazing = grazing

    @cython.cfunc
    @cython.boundscheck(False)
    def has_sorted(self) -> cython.bint:
        """False if bearings neither rise nor fall almost everywhere, and `order` is not set.

        Insertion from the smallest one on: a sensor measures its rays one after the other.
        """
        n: cython.Py_ssize_t = self.n
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        ray: cython.Py_ssize_t = 0
        for i in range(n):
            if self.wrapped[i] < self.wrapped[ray]:
                ray = i
        step: cython.Py_ssize_t = 1
        if self.wrapped[(ray + n - 1) % n] < self.wrapped[(ray + 1) % n]:
            step = n - 1  # they fall
        moves: cython.Py_ssize_t = 16 * n
        for i in range(n):
            angle, k = self.wrapped[ray], i
            while k > 0 and (
                self.rising[k - 1] > angle
                or (self.rising[k - 1] == angle and self.order[k - 1] > ray)
            ):
                self.rising[k], self.order[k] = self.rising[k - 1], self.order[k - 1]
                k, moves = k - 1, moves - 1
            self.rising[k], self.order[k] = angle, ray
            if moves < 0 or not isfinite(angle):
                return False
            ray = _wrapped(ray + step, n)
        return True

    @cython.cfunc
    def set_sectors(self, count: cython.Py_ssize_t):
        """Set the sector of each ray."""
        if count == self.count:
            return
        if self.points is None or len(self.points) != count:
            self.points = np.empty((count, 2))
            self.point = memoryview(self.points)
            self.lowest = _doubles(count)
            self.nearest_ray = memoryview(np.empty(count, np.intp))
        share: cython.double = count / _TURN
        i: cython.Py_ssize_t
        sector: cython.longlong
        for i in range(self.n):
            sector = cython.cast(cython.longlong, rint(self.wrapped[i] * share)) % count
            self.sector[i] = sector + count if sector < 0 else sector
        self.count = count


@cython.cfunc
@cython.boundscheck(False)
def _smallest(
    values: cython.double[::1], n: cython.Py_ssize_t, k: cython.Py_ssize_t
) -> cython.double:
    """The element of rank k of the first n, which get another order (Hoare's algorithm FIND)."""
    low: cython.Py_ssize_t = 0
    high: cython.Py_ssize_t = n - 1
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    while low < high:
        middle, i, j = values[k], low, high
        while i <= j:
            while values[i] < middle:
                i += 1
            while middle < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if j < k:
            low = i
        if k < i:
            high = j
    return values[k]


_layouts: list = []  # a cache of the latest ones: most sensors keep their bearings


@cython.cfunc
def _layout_of(scan) -> _Layout:
    """The layout of the known rays of a scan, with their ranges; None without any."""
    layout: _Layout
    for layout in _layouts:
        if layout.scan is scan:
            return layout
    ranges, bearings = _known(scan)
    if not len(bearings):
        return None
    view: cython.const[cython.double][::1] = bearings
    for layout in _layouts:
        if layout.is_of(view):
            break
    else:
        layout = _new_layout(view)
    is_fixed = not (scan.ranges.flags.writeable or scan.bearings.flags.writeable)
    layout.scan, layout.known = scan if is_fixed else None, ranges
    return layout


@cython.cfunc
def _new_layout(view: cython.const[cython.double][::1]) -> _Layout:
    """The layout of other bearings, in place of the oldest one."""
    layout: _Layout = _layouts.pop() if len(_layouts) == _MAX_LAYOUTS else _Layout(view.shape[0])
    if layout.capacity < view.shape[0]:
        layout = _Layout(view.shape[0])
    layout.set_bearings(view)
    _layouts.insert(0, layout)
    return layout


@cython.cfunc
def _known(scan):
    """The known ranges and their bearings."""
    ranges = np.ascontiguousarray(scan.ranges, np.float64)
    bearings = np.ascontiguousarray(scan.bearings, np.float64)
    if ranges.shape != bearings.shape or ranges.ndim != 1:
        raise ValueError(
            f"ranges {ranges.shape} and bearings {bearings.shape} of a scan; expected both (n,)"
        )
    if not cython.compiled:
        ranges, bearings = memoryview(ranges), memoryview(bearings)
    view: cython.const[cython.double][::1] = ranges
    i: cython.Py_ssize_t
    for i in range(view.shape[0]):
        if isnan(view[i]):
            is_known = ~np.isnan(ranges)
            ranges, bearings = np.array(ranges)[is_known], np.array(bearings)[is_known]
            return (ranges, bearings) if cython.compiled else map(memoryview, (ranges, bearings))
    return ranges, bearings


def nearest(scan, bearing: cython.double, half_width: cython.double):
    """Range and bearing of the ray that `rays.nearest` finds; None without one."""
    layout: _Layout = _layout_of(scan)
    if layout is None:
        return None
    ranges: cython.const[cython.double][::1] = layout.known
    n: cython.Py_ssize_t = layout.n
    least: cython.double = scan.range_min
    lowest: cython.double = INFINITY
    index: cython.Py_ssize_t = -1
    is_sector: cython.bint = half_width < _PI
    i: cython.Py_ssize_t
    for i in range(n):
        distance = ranges[i]
        if distance < least:
            distance = least
        if distance < lowest:
            if is_sector and fabs(_mod(layout.wrapped[i] - bearing + _PI) - _PI) > half_width:
                continue
            lowest, index = distance, i
    return None if index < 0 else (lowest, layout.wrapped[index])


def unit_vectors(bearings):
    """See `rays.unit_vectors`."""
    given: cython.const[cython.double][::1] = np.ascontiguousarray(bearings, np.float64)
    vectors = np.empty((given.shape[0], 2))
    out: cython.double[:, ::1] = vectors
    if not cython.compiled:
        given, out = memoryview(given), memoryview(vectors)
    i: cython.Py_ssize_t
    for i in range(given.shape[0]):
        angle = given[i]
        out[i, 0], out[i, 1] = cos(angle), sin(angle)
    return vectors


def closest_points(scan, within: cython.double, count: cython.Py_ssize_t):
    """See `rays.closest_points`."""
    if count < 1:  # C ends the process where it divides by zero
        raise ValueError(f"count is {count}; expected at least 1 sector")
    layout: _Layout = _layout_of(scan)
    if layout is None:
        return np.empty((0, 2))
    ranges: cython.const[cython.double][::1] = layout.known
    n: cython.Py_ssize_t = layout.n
    layout.set_sectors(count)
    least: cython.double = scan.range_min
    i: cython.Py_ssize_t
    k: cython.Py_ssize_t
    lowest: cython.double[::1] = layout.lowest
    is_seen: cython.bint = False
    for k in range(count):
        lowest[k], layout.nearest_ray[k] = INFINITY, 0
    for i in range(n):
        distance = ranges[i]
        if distance < least:
            distance = least
        if distance <= within:
            is_seen = True
            k = layout.sector[i]
            if distance <= lowest[k]:
                lowest[k], layout.nearest_ray[k] = distance, i
    if not is_seen:
        return np.empty((0, 2))
    found: cython.Py_ssize_t = 0
    before: cython.double = lowest[count - 1]
    if count >= 3:
        for k in range(count):
            after = lowest[k + 1] if k + 1 < count else lowest[0]
            if lowest[k] < before and lowest[k] <= after:
                layout.point[found, 0] = lowest[k]
                layout.point[found, 1] = layout.wrapped[layout.nearest_ray[k]]
                found += 1
            before = lowest[k]
    if found == 0:
        distance = INFINITY
        for k in range(count):
            distance = min(distance, lowest[k])
        for k in range(count):
            if lowest[k] == distance and distance < INFINITY:
                layout.point[found, 0] = distance
                layout.point[found, 1] = layout.wrapped[layout.nearest_ray[k]]
                found += 1
    return layout.points[:found].copy()


@cython.boundscheck(False)
def clusters(scan, within: cython.double, jump: cython.double, grazing: cython.double):
    """The arrays of `rays.RayClusters`; None without a return."""
    layout: _Layout = _layout_of(scan)
    if layout is None:
        return None
    given: cython.const[cython.double][::1] = layout.known
    n: cython.Py_ssize_t = layout.n
    layout.set_grazing(grazing)
    ranges: cython.double[::1] = layout.work
    least: cython.double = scan.range_min
    is_seen: cython.bint = False
    i: cython.Py_ssize_t
    k: cython.Py_ssize_t
    order: cython.longlong[::1] = layout.order
    slopes: cython.double[::1] = layout.slopes
    is_apart: cython.uchar[::1] = layout.is_apart
    is_last: cython.uchar[::1] = layout.is_last
    for i in range(n):
        distance = given[order[i]]
        if distance < least:
            distance = least
        if distance > within:
            distance = _UNSEEN
        else:
            is_seen = True
        ranges[i] = distance
    if not is_seen:
        return None
    shift: cython.Py_ssize_t = 0
    for i in range(n):
        distance, after = ranges[i], ranges[i + 1] if i + 1 < n else ranges[0]
        is_last[i] = is_apart[i] or (
            fabs(distance - after) > jump + (after if after < distance else distance) * slopes[i]
        )
        if shift == 0 and is_last[i]:
            shift = i + 1
    # Start behind a break, so that no object spans the end of the arrays.
    is_whole: cython.bint = shift == 0
    if is_whole:
        shift = 1
    found: cython.Py_ssize_t = 0
    first: cython.Py_ssize_t = shift
    lowest: cython.double = INFINITY
    for i in range(shift, shift + n):
        k = i - n if i >= n else i
        if ranges[k] < lowest:
            lowest = ranges[k]
        if is_last[k] or (is_whole and i == shift + n - 1):
            if lowest < _UNSEEN:
                _measure(layout, found, first, i, lowest)
                found += 1
            first, lowest = i + 1, INFINITY
    distances, middles, widths = layout.found[:, :found].copy()
    counts, is_free = layout.found_counts[:found].copy(), layout.found_free[:found].copy()
    return distances, middles, widths, counts, is_free


@cython.cfunc
def _measure(
    layout: _Layout,
    found: cython.Py_ssize_t,
    first: cython.Py_ssize_t,
    last: cython.Py_ssize_t,
    lowest: cython.double,
) -> cython.int:
    """Keep the object of the rays `first` to `last`, which count on beyond n."""
    n: cython.Py_ssize_t = layout.n
    one: cython.Py_ssize_t = first % n
    end: cython.Py_ssize_t = last % n
    start: cython.double = layout.rising[one] + (_TURN if first >= n else 0.0)
    stop: cython.double = layout.rising[end] + (_TURN if last >= n else 0.0)
    near: cython.double = layout.work[one]
    far: cython.double = layout.work[end]
    spread: cython.double = stop - start
    chord: cython.double = hypot(near - far, 2.0 * sqrt(near * far) * sin(0.5 * spread))
    layout.ranges[found] = lowest
    layout.bearings[found] = _mod(start + 0.5 * spread + _PI) - _PI
    layout.widths[found] = max(chord, spread * lowest) + lowest * min(layout.spacing, _PI)
    layout.counts[found] = last - first + 1
    layout.is_free[found] = (
        layout.work[(one + n - 1) % n] > near and layout.work[(end + 1) % n] > far
    )
    return 0


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _moved_range(
    along: cython.double, across: cython.double, least: cython.double, most: cython.double
) -> cython.double:
    """The distance of a return that lies so far along its ray and across it."""
    distance: cython.double = min(sqrt(along * along + across * across), most)
    return -INFINITY if distance < least else distance


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _moved_bearing(
    bearing: cython.double, turn: cython.double, along: cython.double, across: cython.double
) -> cython.double:
    """The bearing of that return from a sensor that was turned."""
    if fabs(across) < 0.03 * along:  # the series to 3e-15, faster than atan2
        tangent = across / along
        square = tangent * tangent
        turn += tangent * (1.0 - square * (1.0 / 3.0 - square * (0.2 - square / 7.0)))
    else:
        turn += atan2(across, along)
    return _mod(bearing + turn + _PI) - _PI


@cython.ccall
def move_rays(
    ranges: cython.const[cython.double][::1],
    bearings: cython.const[cython.double][::1],
    cosines: cython.const[cython.double][::1],
    sines: cython.const[cython.double][::1],
    ages: cython.const[cython.double][::1],
    path: cython.double[:, ::1],
    rows: cython.Py_ssize_t,
    limits: cython.double[::1],
    distances: cython.double[::1],
    angles: cython.double[::1],
) -> cython.int:
    """Set ranges and bearings (n,) at the end of a path, of rays measured `ages` s before it.

    `cosines` and `sines` (n,) of the bearings. `path`: 2 or more `rows` of s before its end, x and
    y in m and yaw in rad relative to it; between two the pose changes linearly. `limits`: the
    sensor's x and y in the base frame, range_min and range_max in m. A ray without a distance turns
    and keeps its class. A return that is nearer than range_min at the end of the path is -inf, too
    close to measure. The new bearings are within [-pi, pi).
    """
    n: cython.Py_ssize_t = ranges.shape[0]
    last: cython.Py_ssize_t = rows - 1
    k: cython.Py_ssize_t = 1  # the row at the end of the ray's stretch of the path
    i: cython.Py_ssize_t
    # The stretch: its begin and how long it is, in time, x, y and turn.
    begin: cython.double = INFINITY
    end: cython.double = -INFINITY
    x_begin: cython.double = 0.0
    y_begin: cython.double = 0.0
    turn_begin: cython.double = 0.0
    x_way: cython.double = 0.0
    y_way: cython.double = 0.0
    turn_way: cython.double = 0.0
    # Where rays of one age were measured: many sensors tell the ages of whole sectors.
    age: cython.double = NAN
    has_place: cython.bint = False
    share: cython.double = 0.0
    turn: cython.double = 0.0
    x: cython.double = 0.0
    y: cython.double = 0.0
    c: cython.double = 1.0
    s: cython.double = 0.0
    for i in range(n):
        distance = ranges[i]
        if age != ages[i]:
            age, has_place = ages[i], False
            if not begin <= age <= end:
                while k < last and age > path[k, 0]:
                    k += 1
                while k > 1 and age < path[k - 1, 0]:
                    k -= 1
                begin, end = path[k - 1, 0], path[k, 0]
                x_begin, y_begin, turn_begin = path[k - 1, 1], path[k - 1, 2], path[k - 1, 3]
                x_way, y_way = path[k, 1] - x_begin, path[k, 2] - y_begin
                turn_way = path[k, 3] - turn_begin
            share = min(max((age - begin) / (end - begin), 0.0), 1.0)
            turn = turn_begin + share * turn_way
        if not isfinite(distance):
            distances[i], angles[i] = distance, _mod(bearings[i] + turn + _PI) - _PI
            continue
        if not has_place:
            has_place, c, s = True, cos(turn), sin(turn)
            x, y = x_begin + share * x_way, y_begin + share * y_way
            x += (c - 1.0) * limits[0] - s * limits[1]
            y += s * limits[0] + (c - 1.0) * limits[1]
        ahead = c * cosines[i] - s * sines[i]
        left = s * cosines[i] + c * sines[i]
        along, across = distance + (ahead * x + left * y), ahead * y - left * x
        distances[i] = _moved_range(along, across, limits[2], limits[3])
        angles[i] = _moved_bearing(bearings[i], turn, along, across)
    return 0


@cython.ccall
def rays_in_sector(
    ranges: cython.const[cython.double][::1],
    bearings: cython.const[cython.double][::1],
    ages: cython.const[cython.double][::1],
    first: cython.Py_ssize_t,
    way: cython.double[::1],
    sector: cython.double[::1],
    limits: cython.double[::1],
    distances: cython.double[::1],
    angles: cython.double[::1],
    kept_ages: cython.double[::1],
) -> cython.Py_ssize_t:
    """Set ranges, bearings and ages of the rays in a sector, from ray `first` on; their number.

    `way`: x and y in m and yaw in rad of the place where all were measured, relative to the one for
    which ranges and bearings are set; a ray counts if it lies in the sector as seen from one of the
    two. `sector`: the bearing of its start, 1.0 if it lies counter-clockwise of that or else -1.0,
    and its width in rad. `limits` as of `move_rays`.
    """
    x: cython.double = way[0]
    y: cython.double = way[1]
    turn: cython.double = way[2]
    start: cython.double = sector[0]
    direction: cython.double = sector[1]
    width: cython.double = sector[2]
    c: cython.double = cos(turn)
    s: cython.double = sin(turn)
    x += (c - 1.0) * limits[0] - s * limits[1]
    y += s * limits[0] + (c - 1.0) * limits[1]
    # Nothing changes its direction by more than this; farther rays need no look.
    most: cython.double = _PI
    away: cython.double = sqrt(x * x + y * y)
    if away < 0.9 * limits[2]:
        most = asin(away / limits[2]) + 1e-9
    n: cython.Py_ssize_t = ranges.shape[0]
    count: cython.Py_ssize_t = 0
    i: cython.Py_ssize_t
    for i in range(first, n):
        before = direction * (bearings[i] + turn - start)
        if _mod(before + most) > width + 2.0 * most:
            continue
        if isfinite(ranges[i]):
            ahead, left = cos(bearings[i] + turn), sin(bearings[i] + turn)
            along, across = ranges[i] + (ahead * x + left * y), ahead * y - left * x
            distances[count] = _moved_range(along, across, limits[2], limits[3])
            angles[count] = _moved_bearing(bearings[i], turn, along, across)
        else:
            distances[count], angles[count] = ranges[i], _mod(bearings[i] + turn + _PI) - _PI
        if _mod(before) < width or _mod(direction * (angles[count] - start)) < width:
            kept_ages[count] = ages[i]
            count += 1
    return count


_ZEROS = {"no_return": INFINITY, "too_close": -INFINITY, "unknown": NAN, "lds": NAN}


@cython.cclass
class RayMemory:
    """The memory of each ray, and what it makes of a scan's ranges.

    `known_at`: see `ScanConditioner`.
    """

    known_at = cython.declare(cython.double, visibility="readonly")
    _range_min: cython.double
    _range_max: cython.double
    _max_gap: cython.double
    _stale_after: cython.double
    _zero: cython.double
    _is_lds: cython.bint
    _guesses_near: cython.bint
    _near_below: cython.double
    _step: cython.double
    _yaw: cython.double
    _far_returns: cython.Py_ssize_t
    _given: object
    _n: cython.Py_ssize_t
    _bearings: cython.double[::1]
    _direction: cython.double
    _is_even: cython.bint  # rays cover a full turn, one each `_step`
    _order: cython.longlong[::1]  # the rays by rising bearing, and the place of each ray in it
    _rising: cython.double[::1]
    _place: cython.longlong[::1]
    # By the places of rays, which begin at `_turned`: a robot that turns moves no memory.
    _ranges: cython.double[::1]
    _seen_at: cython.double[::1]
    _near_at: cython.double[::1]
    _turned: cython.Py_ssize_t
    _is_zero: cython.uchar[::1]
    _is_lost: cython.uchar[::1]

    def __init__(self, spec, *, guesses_near):
        self.known_at = -INFINITY
        self._range_min, self._range_max = spec.range_min, spec.range_max
        self._max_gap, self._stale_after = spec.max_gap + 1e-9, spec.stale_after
        self._zero, self._is_lds = _ZEROS[spec.zero], spec.zero == "lds"
        self._guesses_near = guesses_near
        self._near_below = spec.range_min + _NEAR_MARGIN
        self._step = _TURN / max(len(spec.bearings), 1)
        self._yaw, self._far_returns = NAN, 0
        self._given, self._n = None, 0
        self._bearings = self._rising = self._ranges = self._seen_at = self._near_at = None
        self._order = self._place = self._is_zero = self._is_lost = None

    def condition(self, raw, bearings, yaw: cython.double, now: cython.double):
        """The conditioned ranges (n,) of a scan; None if it is invalid.

        Bearings (n,) that are the same object as before are not looked at again. `yaw` of the
        robot in rad, NaN if unknown; `now` in s.
        """
        ranges = np.array(raw, dtype=np.float64, order="C")
        return ranges if self.interpret(_view(ranges), bearings, yaw, now) else None

    @cython.cfunc
    def interpret(
        self, out: cython.double[::1], bearings, yaw: cython.double, now: cython.double
    ) -> cython.bint:
        """Replace raw ranges by conditioned ones; false if the scan is invalid."""
        n: cython.Py_ssize_t = out.shape[0]
        if self._goes_blind(out):
            return False
        turned: cython.double = self._turn_of(yaw)
        if bearings is not self._given and self._n and np.array_equal(bearings, self._bearings):
            self._given = bearings
        if bearings is not self._given:
            self._set_bearings(bearings, turned)
        elif turned != 0.0 and self._is_even:
            self._turned += cython.cast(cython.Py_ssize_t, rint(turned / self._step))
            self._turned += n if self._turned < 0 else -n if self._turned >= n else 0
        elif turned != 0.0:
            self._recall(self._rising, turned)
        if self._interpret(out):
            self._interpret_zeros(out, now)
        unknown: cython.Py_ssize_t = self._remember(out, now)
        if 2 * unknown > n:
            return False
        self.known_at = now
        if unknown:
            self.known_at = self._lost_since(now)
            unknown = 0
            i: cython.Py_ssize_t
            k: cython.Py_ssize_t
            for i in range(n):
                if isnan(out[i]):
                    k = self._at(i)
                    if self._seen_at[k] >= now - self._stale_after:
                        out[i] = self._ranges[k]
                    if isnan(out[i]):
                        unknown += 1
            if unknown and not self._bridge(out):
                return False
        return True

    @cython.cfunc
    def _remember(self, ranges: cython.double[::1], now: cython.double) -> cython.Py_ssize_t:
        """Store the known rays; the number of unknown rays, which keep their memory."""
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        unknown: cython.Py_ssize_t = 0
        near_below: cython.double = self._near_below
        known: cython.double[::1] = self._ranges
        seen_at: cython.double[::1] = self._seen_at
        is_zero: cython.uchar[::1] = self._is_zero
        is_lost: cython.uchar[::1] = self._is_lost
        for i in range(ranges.shape[0]):
            distance = ranges[i]
            if isnan(distance):
                unknown += 1
                is_lost[i] = not (self._is_lds and is_zero[i])
                continue
            is_lost[i], k = False, self._at(i)
            known[k], seen_at[k] = distance, now
            # A zero is no near ray: one passing obstacle would make an open field near for good.
            if distance < near_below and not is_zero[i]:
                self._near_at[k] = now
        return unknown

    @cython.cfunc
    @cython.inline
    def _at(self, ray: cython.Py_ssize_t) -> cython.Py_ssize_t:
        """Where the memory of a ray is."""
        return _wrapped(self._place[ray] + self._turned, self._n)

    @cython.cfunc
    def _goes_blind(self, raw: cython.double[::1]) -> cython.bint:
        """True if the scan has no return although the last one with returns had many far ones.

        Then the sensor is blind; the robot has not reached an open field. An obstacle in the blind
        zone may hide everything else, but then its returns were near before.
        """
        i: cython.Py_ssize_t
        far: cython.Py_ssize_t = 0
        has_return: cython.bint = False
        near_below: cython.double = self._near_below
        range_max: cython.double = self._range_max
        far_below: cython.double = 0.8 * self._range_max
        for i in range(raw.shape[0]):
            distance = raw[i]
            if (0.0 < distance <= range_max) or distance == -INFINITY:
                has_return = True
                if near_below < distance < far_below:
                    far += 1
        if has_return:
            self._far_returns = far
            return False
        least: cython.double = max(_BLIND_SHARE * raw.shape[0], _BLIND_RETURNS)
        return self._far_returns >= least

    @cython.cfunc
    def _turn_of(self, yaw: cython.double) -> cython.double:
        """The turn of the sensor since the last call, in whole rays; the remainder is kept."""
        turned: cython.double = _mod(yaw - self._yaw + _PI) - _PI
        if not isfinite(turned):
            self._yaw = yaw
            return 0.0
        turned = self._step * rint(turned / self._step)
        self._yaw += turned
        return turned

    @cython.cfunc
    def _set_bearings(self, bearings, turned: cython.double):
        """Take over the memory of other bearings."""
        i: cython.Py_ssize_t
        n: cython.Py_ssize_t = len(bearings)
        had: cython.Py_ssize_t = self._n
        step: cython.double = self._step
        rising: cython.double[::1] = self._rising
        values = np.array(bearings, dtype=np.float64, order="C")
        order = np.argsort(values % _TURN, kind="stable")
        self._given, self._n, self._direction = bearings, n, 1.0
        self._bearings, self._order = memoryview(values), memoryview(order)
        self._rising = memoryview(values[order] % _TURN)
        self._place = memoryview(np.argsort(order))
        if n > 1:
            last = math.remainder(values[n - 1] - values[n - 2], _TURN)
            self._direction = math.copysign(1.0, last)
        self._is_even = fabs(n * step - _TURN) < 0.5 * step
        for i in range(n):
            if fabs(self._rising[i] - self._rising[0] - i * step) > 0.2 * step:
                self._is_even = False
        self._is_zero, self._is_lost = _marks(n), _marks(n)
        if had:
            self._recall(rising, turned)
            return
        self._ranges, self._seen_at, self._near_at = _doubles(n), _doubles(n), _doubles(n)
        for i in range(n):
            self._ranges[i], self._seen_at[i], self._near_at[i] = NAN, -INFINITY, -INFINITY

    @cython.cfunc
    def _recall(self, rising: cython.double[::1], turned: cython.double) -> cython.int:
        """Give each ray the old memory of the ray that was nearest to it before the turn."""
        n: cython.Py_ssize_t = self._n
        had: cython.Py_ssize_t = rising.shape[0]
        ranges: cython.double[::1] = self._ranges
        seen_at: cython.double[::1] = self._seen_at
        near_at: cython.double[::1] = self._near_at
        too_far: cython.double = 2.0 * _TURN / had
        place: cython.Py_ssize_t = 0
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        at: cython.Py_ssize_t
        self._ranges, self._seen_at, self._near_at = _doubles(n), _doubles(n), _doubles(n)
        for i in range(n):
            wanted = _mod(self._bearings[i] + turned)
            place = _nearest(rising, had, wanted, place)
            is_far = _apart(rising[place], wanted) > too_far
            k, at = _wrapped(place + self._turned, had), self._place[i]
            self._ranges[at] = ranges[k]
            self._seen_at[at] = -INFINITY if is_far else seen_at[k]
            self._near_at[at] = -INFINITY if is_far else near_at[k]
        self._turned = 0
        return 0

    @cython.cfunc
    def _interpret(self, out: cython.double[::1]) -> cython.bint:
        """Each ray as +inf, -inf, NaN or a distance; true if zeros of an LDS are left."""
        i: cython.Py_ssize_t
        range_min: cython.double = self._range_min
        range_max: cython.double = self._range_max
        is_zero: cython.uchar[::1] = self._is_zero
        has_zeros: cython.bint = False
        for i in range(out.shape[0]):
            value = out[i]
            is_zero[i] = value == 0.0
            if range_min <= value <= range_max:
                continue
            if value == 0.0:
                if self._is_lds:
                    has_zeros = True
                else:
                    out[i] = self._zero
            elif (0.0 < value < range_min) or value == -INFINITY:
                out[i] = -INFINITY
            else:
                out[i] = INFINITY if value > range_max else NAN
        return has_zeros

    @cython.cfunc
    def _interpret_zeros(self, out: cython.double[::1], now: cython.double) -> cython.int:
        """The meaning of the zeros of an LDS that are left in `out`."""
        n: cython.Py_ssize_t = out.shape[0]
        first: cython.Py_ssize_t = 0
        while first < n and out[first] == 0.0:
            first += 1
        begin: cython.Py_ssize_t = first
        end: cython.Py_ssize_t = first + n
        k: cython.Py_ssize_t
        i: cython.Py_ssize_t
        run: cython.Py_ssize_t
        while begin < end:  # runs of zeros, the one around the end of the array last
            if first < n and out[_wrapped(begin, n)] != 0.0:
                begin += 1
                continue
            run = 0
            while run < n and begin + run < end and out[_wrapped(begin + run, n)] == 0.0:
                run += 1
            for k in range(begin, begin + run):
                i = _wrapped(k, n)
                out[i] = self._meaning(i, run, now)
            begin += run
        return 0

    @cython.cfunc
    def _meaning(
        self, ray: cython.Py_ssize_t, run: cython.Py_ssize_t, now: cython.double
    ) -> cython.double:
        """The meaning of a zero in a run of so many; NaN: a drop-out."""
        at: cython.Py_ssize_t = self._at(ray)
        had_return: cython.bint = self._seen_at[at] >= now - self._stale_after and isfinite(
            self._ranges[at]
        )
        # A short run over recent returns is a lost packet; a near obstacle hides more rays.
        if not (had_return and run <= _PACKET_RAYS) and self._was_near(ray, now):
            return -INFINITY
        return NAN if had_return else INFINITY

    @cython.cfunc
    def _was_near(self, ray: cython.Py_ssize_t, now: cython.double) -> cython.bint:
        """True beside a ray that was near lately."""
        if not self._guesses_near:
            return False
        since: cython.double = now - _NEAR_MEMORY
        direction: cython.Py_ssize_t
        step: cython.Py_ssize_t
        beside: cython.Py_ssize_t
        n: cython.Py_ssize_t = self._n
        for direction in range(-1, 2, 2):
            for step in range(n):
                beside = self._order[(self._place[ray] + direction * step + n) % n]
                if _apart(self._bearings[ray], self._bearings[beside]) > _NEAR_SECTOR:
                    break
                if self._near_at[self._at(beside)] >= since:
                    return True
        return False

    @cython.cfunc
    def _lost_since(self, now: cython.double) -> cython.double:
        """The latest time from which on no sector wider than `max_gap` is lost."""
        if self._widest(INFINITY) <= self._max_gap:
            return now
        before: cython.double = INFINITY
        i: cython.Py_ssize_t
        while True:
            latest = -INFINITY
            for i in range(self._n):
                if self._is_lost[i] and latest < self._seen_at[self._at(i)] < before:
                    latest = self._seen_at[self._at(i)]
            if latest == -INFINITY or self._widest(latest) <= self._max_gap:
                return latest
            before = latest

    @cython.cfunc
    def _widest(self, before: cython.double) -> cython.double:
        """The widest sector of lost rays that were last known before a time, between others."""
        n: cython.Py_ssize_t = self._n
        first: cython.Py_ssize_t = 0
        while first < n and self._is_lost[first] and self._seen_at[self._at(first)] < before:
            first += 1
        if first == n:
            return INFINITY
        widest: cython.double = 0.0
        last: cython.Py_ssize_t = first
        k: cython.Py_ssize_t
        i: cython.Py_ssize_t
        for k in range(first + 1, first + n + 1):
            i = _wrapped(k, n)
            if self._is_lost[i] and self._seen_at[self._at(i)] < before:
                continue
            if k - last > 1:
                step = self._bearings[_wrapped(last, n)] - self._bearings[i]
                widest = max(widest, _TURN - _mod(self._direction * step))
            last = k
        return widest

    @cython.cfunc
    def _bridge(self, out: cython.double[::1]) -> cython.bint:
        """Fill unknown sectors up to `max_gap` with the nearer edge; false if one is left."""
        n: cython.Py_ssize_t = out.shape[0]
        first: cython.Py_ssize_t = 0
        while first < n and isnan(out[first]):
            first += 1
        if first == n:
            return False
        # The angle unwraps as in numpy.unwrap, from a known ray on.
        start: cython.double = self._bearings[first]
        angle: cython.double = start
        before: cython.double = start  # the angle of the last known ray
        edge: cython.double = out[first]
        last: cython.Py_ssize_t = first
        shift: cython.double = 0.0
        k: cython.Py_ssize_t
        i: cython.Py_ssize_t
        is_filled: cython.bint = True
        for k in range(first + 1, first + n):
            i = _wrapped(k, n)
            step = self._bearings[i] - self._bearings[_wrapped(k - 1, n)]
            if fabs(step) >= _PI:
                wrapped_step = _mod(step + _PI) - _PI
                if wrapped_step == -_PI and step > 0.0:
                    wrapped_step = _PI
                shift += wrapped_step - step
            angle = self._bearings[i] + shift
            if isnan(out[i]):
                continue
            if k - last > 1 and not self._fill(out, last, k, before, angle, edge, out[i]):
                is_filled = False
            last, before, edge = k, angle, out[i]
        if last < first + n - 1:
            after = start + math.copysign(_TURN, angle - start)
            if not self._fill(out, last, first + n, before, after, edge, out[first]):
                is_filled = False
        return is_filled

    @cython.cfunc
    def _fill(
        self,
        out: cython.double[::1],
        last: cython.Py_ssize_t,
        end: cython.Py_ssize_t,
        before: cython.double,
        after: cython.double,
        edge: cython.double,
        other: cython.double,
    ) -> cython.bint:
        """Fill the rays between the known rays `last` and `end` with the smaller of their ranges.

        `edge`, `other`: these ranges in m. `before`, `after`: the angles of the two rays in rad.
        False, and nothing is filled, if the angles differ by more than `max_gap`.
        """
        if not fabs(after - before) <= self._max_gap:
            return False
        k: cython.Py_ssize_t
        for k in range(last + 1, end):
            out[_wrapped(k, out.shape[0])] = min(edge, other)
        return True


@cython.cclass
class BlindSectors:
    """Finds the blind sectors of one sensor, see `blind_sector.py`. Times in s.

    Poses are in the odometry frame. `text` names the blind sectors; empty without one.
    """

    text = cython.declare(object, visibility="readonly")
    _is_used: cython.bint
    _looked_at: cython.double
    _looked_yaw: cython.double
    _is_blind: object
    _range_min: cython.double
    _range_max: cython.double
    _is_zero_near: cython.bint
    _given: object
    _bearings: cython.const[cython.double][::1]
    _sector: cython.longlong[::1]  # of each ray
    _direction: cython.longlong[::1]
    _is_return: cython.uchar[::1]
    _blind: cython.uchar[::1]
    _returned: object  # when
    _returned_at: cython.double[::1]
    _returns: cython.longlong[90]  # scans in a row with a return
    # By direction: the thing last seen there, for how many looks in a row, and the sectors that
    # have missed it since. By sector: the directions in which it has missed something.
    _range: cython.double[90]
    _x: cython.double[90]
    _y: cython.double[90]
    _streak: cython.int[90]
    _seen_at: cython.double[90]
    # short: Cython takes an array of uchar for a text that ends at 0, as a memory is read.
    _pending: cython.short[8100]
    _missed: cython.short[8100]
    # Of one look, by direction.
    _rays: cython.int[90]
    _hits: cython.int[90]
    _sums: cython.double[90]
    _is_known: cython.short[90]

    def __init__(self, spec: ScanSpec) -> None:
        k: cython.Py_ssize_t
        self._is_used, self.text = len(spec.bearings) >= _SECTORS, ""
        self._looked_at, self._looked_yaw = -INFINITY, NAN
        self._range_min, self._range_max = spec.range_min, spec.range_max
        self._is_zero_near = spec.zero == "too_close"
        self._is_blind = np.zeros(_SECTORS, np.bool_)
        self._blind = memoryview(self._is_blind.view(np.uint8))
        self._returned = np.full(_SECTORS, NAN)
        self._returned_at = memoryview(self._returned)
        for k in range(_SECTORS):
            self._seen_at[k] = -INFINITY
        self._bearings = self._sector = self._direction = self._is_return = None

    def check_indices(self) -> None:
        """ValueError unless each ray is in one of the sectors; see `recall`."""
        i: cython.Py_ssize_t
        for i in range(0 if self._sector is None else len(self._sector)):
            if not 0 <= self._sector[i] < _SECTORS:
                raise ValueError(f"ray {i} is in sector {self._sector[i]} of {_SECTORS}")

    def take(
        self, ranges: Array, bearings: Array, odometry: Odometry | None, now: cython.double
    ) -> Array:
        """The raw ranges (n,) of a scan, with NaN for rays of blind sectors without a return."""
        known = np.array(ranges, np.float64)
        self.mark(_view(known), bearings, odometry, now)
        return known

    @cython.cfunc
    def mark(self, given: cython.double[::1], bearings, odometry, now: cython.double):
        """Set NaN for rays of blind sectors without a return."""
        is_due: cython.bint = self._is_used and odometry is not None
        if is_due:
            pose = odometry.pose
            is_due = self._is_due(pose.yaw, now)
        if not (is_due or self.text):
            return
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        n: cython.Py_ssize_t = given.shape[0]
        if bearings is not self._given:
            self._given, self._bearings = bearings, _view(bearings)
            self._sector, self._direction, self._is_return = _places(n), _places(n), _marks(n)
            for i in range(n):
                self._sector[i] = _sector_of(self._bearings[i])
        is_return: cython.uchar[::1] = self._is_return
        for k in range(_SECTORS):
            self._hits[k] = 0
        for i in range(n):
            is_return[i] = (0.0 < given[i] <= self._range_max) or given[i] == -INFINITY
            if self._is_zero_near and given[i] == 0.0:
                is_return[i] = True
            self._hits[self._sector[i]] += is_return[i]
        has_changed: cython.bint = False
        for k in range(_SECTORS):
            self._returns[k] = self._returns[k] + 1 if self._hits[k] else 0
            if self._hits[k] or isnan(self._returned_at[k]):
                self._returned_at[k] = now
            if self._blind[k] and self._returns[k] >= _CLEARING:
                self._blind[k], has_changed = False, True
        if is_due and self._look(given, pose.x, pose.y, pose.yaw, now):
            has_changed = True
        for i in range(n):
            if self._blind[self._sector[i]] and not is_return[i]:
                given[i] = NAN
        if has_changed:
            self.text = blind_text(self._is_blind, self._returned, now)

    @cython.cfunc
    def _is_due(self, yaw: cython.double, now: cython.double) -> cython.bint:
        """True once the robot has turned by a sector since the last look."""
        turned: cython.double = fabs(remainder(yaw - self._looked_yaw, _TURN))
        if now - self._looked_at < _LOOK_PERIOD or turned < _TURN / _SECTORS:
            return False
        self._looked_at, self._looked_yaw = now, yaw
        return True

    @cython.cfunc
    def _look(
        self,
        ranges: cython.double[::1],
        x: cython.double,
        y: cython.double,
        yaw: cython.double,
        now: cython.double,
    ) -> cython.bint:
        """Compare what each ray returns with what others returned in its direction.

        True if another sector is blind now.
        """
        has_changed: cython.bint = False
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        d: cython.Py_ssize_t
        count: cython.Py_ssize_t
        is_seen: cython.bint
        is_like: cython.bint
        is_static: cython.bint
        is_over: cython.bint
        n: cython.Py_ssize_t = ranges.shape[0]
        for d in range(_SECTORS):
            self._rays[d] = self._hits[d] = 0
            self._sums[d] = 0.0
        for i in range(n):
            d = self._direction[i] = _sector_of(self._bearings[i] + yaw)
            self._rays[d] += 1
            if self._is_return[i]:
                self._hits[d] += 1
                self._sums[d] += max(ranges[i], self._range_min)
        for d in range(_SECTORS):
            self._is_known[d] = now - self._seen_at[d] <= _MAX_TIME and (
                hypot(x - self._x[d], y - self._y[d]) <= _MAX_MOTION * self._range[d]
            )
            is_seen = 0 < self._rays[d] == self._hits[d]
            distance = self._sums[d] / max(self._hits[d], 1)
            is_like = is_seen and (
                fabs(distance - self._range[d]) <= _LIKE_M + _LIKE * self._range[d]
            )
            self._streak[d] = self._streak[d] + 1 if is_like else is_seen
            is_static = self._is_known[d] and self._streak[d] >= _STREAK
            is_over = is_static or not self._is_known[d] or (is_seen and not is_like)
            for k in range(_SECTORS):
                if self._returns[k]:
                    self._pending[_SECTORS * d + k] = self._missed[_SECTORS * k + d] = False
                elif is_over and self._pending[_SECTORS * d + k]:
                    self._pending[_SECTORS * d + k] = False
                    self._missed[_SECTORS * k + d] |= is_static
            if self._streak[d] >= _STREAK:
                self._seen_at[d] = now
            if is_seen and not is_like:
                self._seen_at[d] = -INFINITY
            if is_seen and (not is_like or self._streak[d] >= _STREAK):
                self._range[d], self._x[d], self._y[d] = distance, x, y
        for i in range(n):
            d, k = self._direction[i], self._sector[i]
            if self._is_known[d] and not self._hits[d] and not self._returns[k]:
                self._pending[_SECTORS * d + k] = True
        for k in range(_SECTORS):
            count = 0
            for d in range(_SECTORS):
                count += self._missed[_SECTORS * k + d]
            if count >= _MISSED and not self._blind[k]:
                self._blind[k] = has_changed = True
        return has_changed


@cython.cfunc
@cython.inline
def _sector_of(angle: cython.double) -> cython.longlong:
    sector: cython.longlong = cython.cast(
        cython.longlong, floor(angle * (1.0 / (_TURN / _SECTORS)) + 1e-6)
    )
    sector %= _SECTORS
    return sector + _SECTORS if sector < 0 else sector


@cython.cclass
class ScanConditioner:
    """Conditions the scans of one sensor; fills unknown rays from a short memory of each ray.

    The memory turns against the sensor, as far as odometry is available.

    `take` returns the conditioned scan or the reason to reject it. INVALID_SCAN: lengths differ, no
    rays, a stamp that is not finite, an impossible age of a ray, fewer than half of the rays known,
    an unknown sector wider than `max_gap`, such a sector without rays (unless the sensor never has
    rays there), or no return at all after a scan with many far returns. FROZEN_SCAN: stamp or
    sequence does not rise, or a noisy sensor sends bit-identical scans. FROZEN_STAMP: the stamp is
    that of the scan before, whose ranges differ. CLOCK_SET: the stamp is below an earlier one.

    `known_at` is the time in s to which the last returned scan is valid: its arrival, unless a
    sector wider than `max_gap` comes from the memory, or the scan repeats an earlier one.
    """

    _max_sector: cython.double
    _range_min: object
    _range_max: object
    _latency: object
    _is_noisy: cython.bint
    _bearings: object  # the last valid ones
    _ages: object
    _blind: BlindSectors
    _rays: RayMemory
    _last_given: object
    _last_seq: object
    _last_stamp: cython.double
    _newest_seq: object
    _newest_stamp: cython.double
    _in_order: cython.int
    _recent: object
    _identical: cython.int

    def __init__(self, spec: ScanSpec, *, guesses_near: bool = True) -> None:
        """`guesses_near`: a zero of an LDS beside a near ray counts as too close."""
        self._max_sector = max(spec.max_gap, widest_between_rays(spec.bearings)) + 1e-9
        self._range_min, self._range_max = spec.range_min, spec.range_max
        self._latency, self._is_noisy = spec.latency, spec.is_noisy
        self._bearings, self._recent = np.empty(0), []
        self._blind, self._rays = BlindSectors(spec), RayMemory(spec, guesses_near=guesses_near)
        self._last_seq = self._newest_seq = self._last_stamp = self._newest_stamp = -INFINITY

    @property
    def known_at(self) -> float:
        """The time in s to which the last returned scan is valid."""
        return self._rays.known_at

    @property
    def blind_text(self) -> str:
        """The blind sectors of the sensor, whose rays count as unknown; empty without one."""
        return self._blind.text

    def take(self, scan: Scan, odometry: Odometry | None, now: cython.double) -> Scan | Reason:
        """Condition one scan that arrived at `now` (s on this machine's clock)."""
        given, bearings = scan.ranges, scan.bearings
        stamp: cython.double = scan.stamp
        if given.ndim != 1 or not isfinite(stamp):
            return Reason.INVALID_SCAN
        n: cython.Py_ssize_t = len(given)
        if n == 0 or (bearings is not self._bearings and given.shape != bearings.shape):
            return Reason.INVALID_SCAN
        if bearings is not self._bearings and not self._has_no_gap(bearings):
            return Reason.INVALID_SCAN
        if n != len(self._bearings) or not self._has_ages(scan.ages, n):
            return Reason.INVALID_SCAN
        reason = self._not_newer(scan.seq, stamp, given)
        if reason is not None:
            return reason
        ranges = np.array(given, np.float64)
        out: cython.double[::1] = _view(ranges)
        if self._is_noisy and self._repeats(ranges, out, odometry):
            now = self._rays.known_at  # a repeat holds nothing new
            if self._identical >= MAX_REPEATS:
                return Reason.FROZEN_SCAN
        yaw: cython.double = NAN
        if odometry is not None:
            yaw = odometry.pose.yaw
        self._blind.mark(out, self._bearings, odometry, now)
        if not self._rays.interpret(out, self._bearings, yaw, now):
            return Reason.INVALID_SCAN
        ranges.setflags(write=False)  # the memory and an inline pattern share it
        limits = self._range_min, self._range_max
        return Scan(scan.seq, stamp, ranges, self._bearings, *limits, self._ages, self._latency)

    @cython.cfunc
    def _has_no_gap(self, bearings) -> cython.bint:
        """True if no sector lacks rays; keeps the bearings.

        A copy, if a driver may write others to the same array: all that follows takes the same
        object for the same bearings.
        """
        if not np.array_equal(bearings, self._bearings):
            if not np.isfinite(bearings).all() or widest_between_rays(bearings) > self._max_sector:
                return False
            if bearings.flags.writeable or not bearings.flags.owndata:
                bearings = np.array(bearings, np.float64)
                bearings.setflags(write=False)
            self._bearings = bearings
        return True

    @cython.cfunc
    def _has_ages(self, ages, n: cython.Py_ssize_t) -> cython.bint:
        """True if each ray has a possible age, or none has one; keeps a copy of the ages."""
        if ages is not None and ages is not self._ages:
            if ages.shape != (n,) or not ((ages >= 0.0) & (ages <= _MAX_RAY_AGE)).all():
                return False
            if self._ages is not None and np.array_equal(ages, self._ages):
                return True
            if ages.flags.writeable or not ages.flags.owndata:
                ages = np.array(ages, np.float64)
                ages.setflags(write=False)
        self._ages = ages
        return ages is None or len(ages) == n

    @cython.cfunc
    def _not_newer(self, seq, stamp: cython.double, given):
        """Why the scan is not newer than each before; None if it is, or the sensor has restarted.

        A restart shows in consecutive scans whose numbers and stamps rise again.
        """
        is_next: cython.bint = stamp > self._last_stamp and seq > self._last_seq
        stands: cython.bint = stamp == self._last_stamp
        is_other: cython.bint = seq > self._newest_seq  # else no new message
        before, self._last_given = self._last_given, given
        self._last_seq, self._last_stamp = seq, stamp
        if not (stamp > self._newest_stamp and seq > self._newest_seq):
            self._in_order = self._in_order + 1 if is_next else 0
            if self._in_order < _RESTART_SCANS:
                if is_other and stands and given.tobytes() != before.tobytes():
                    return Reason.FROZEN_STAMP
                if is_other and not stands and stamp < self._newest_stamp:
                    return Reason.CLOCK_SET
                return Reason.FROZEN_SCAN
        self._in_order, self._newest_seq, self._newest_stamp = 0, seq, stamp
        return None

    @cython.cfunc
    def _repeats(self, ranges, values: cython.double[::1], odometry) -> cython.bint:
        """True if a noisy sensor sends the same ranges again.

        With hardly any return a repeat is possible, unless the robot moves.
        """
        raw = ranges.tobytes()
        if raw not in self._recent:
            self._recent.append(raw)
            if len(self._recent) > COMPARED_SCANS:
                self._recent.pop(0)
            self._identical = 0
            return False
        i: cython.Py_ssize_t
        returns: cython.int = 0
        for i in range(values.shape[0]):
            returns += isfinite(values[i]) and values[i] != 0.0
        twist = ZERO if odometry is None else odometry.twist
        is_moving: cython.bint = (
            max(abs(twist.linear), abs(twist.lateral)) > _MOVES_LINEAR
            or abs(twist.angular) > _MOVES_ANGULAR
        )
        if returns < (1 if is_moving else MIN_DISTINCT_RETURNS):
            return False
        self._identical += 1
        return True


@cython.cclass
class _Turns:
    """Delay by turns, see `scan_delay.py`: `delay` and `spread` in s, from `pairs` of scans.

    `at`: the time of the last one. `delay`: NaN while it is not known, and `why` it is not.
    `pose`: the last one by odometry.
    """

    delay: cython.double
    spread: cython.double
    at: cython.double
    pairs: cython.Py_ssize_t
    why: object
    pose: object
    _headings: object
    _times: cython.double[::1]
    _yaws: cython.double[::1]
    _first: cython.Py_ssize_t  # of the headings kept
    _end: cython.Py_ssize_t
    _stamp: cython.double
    _yaw: cython.double
    _slow_rate: cython.double
    _changed_at: cython.double
    _total: cython.double  # turned so far
    _bearings: object
    _n: cython.Py_ssize_t
    _ray: cython.double  # the angle from one to the next; 0: they do not cover a full turn evenly
    # The last scan: when it arrived on the clock of odometry, where, and its ranges about their
    # mean, twice in a row, with their norm. Then the same of the one before.
    _scans: cython.Py_ssize_t
    _has_last: cython.bint
    _scan_at: cython.double
    _x: cython.double
    _y: cython.double
    _relief: cython.double[::1]
    _norm: cython.double
    _old_relief: cython.double[::1]
    _old_norm: cython.double
    # Turns by candidate delay, and sums over pairs: of measured turns m, and of those p.
    _turn_of: cython.double[49]
    _error_of: cython.double[49]
    _mm: cython.double
    _mp: cython.double[49]
    _pp: cython.double[49]
    _weight: cython.double

    def __init__(self):
        self.delay, self.why = NAN, "it has not turned at a changing rate yet"
        self._headings = np.empty((2, 4 * _HISTORY))
        self._times, self._yaws = map(memoryview, self._headings)
        self._stamp = self._changed_at = -INFINITY
        self._relief = self._old_relief = _doubles(0)

    def check_indices(self) -> None:
        """ValueError unless its ranges are those of its rays, as `_likeness` reads them."""
        ray: cython.double = fabs(self._ray)
        lengths = len(self._relief), len(self._old_relief), 2 * self._n
        is_even: cython.bint = ray == 0.0 or fabs(ray * self._n - _TURN) < 1.5 * ray
        if self._n < 0 or min(lengths) != max(lengths) or not is_even:
            raise ValueError(f"{self._n} rays at steps of {ray} rad, {lengths} ranges")

    @cython.cfunc
    def figure(self, now: cython.double):
        """The delay, or why it is not known."""
        if isnan(self.delay):
            return DelayFigure(method="turns", text=self.why)
        return DelayFigure(
            method="turns",
            delay=self.delay,
            spread=self.spread,
            samples=self.pairs,
            age=max(now - self.at, 0.0),
        )

    @cython.cfunc
    def forget(self):
        """Measure anew."""
        k: cython.Py_ssize_t
        self.delay, self.pairs, self._mm, self._weight = NAN, 0, 0.0, 0.0
        for k in range(_CANDIDATES):
            self._mp[k] = self._pp[k] = 0.0
        self.why = "its last figure was older than a minute"

    @cython.cfunc
    def forget_headings(self):
        """The clock of odometry was set."""
        self._first = self._end = 0
        self._stamp, self._has_last = -INFINITY, False

    @cython.cfunc
    def headings(self):
        """A copy of the headings kept."""
        return Headings(*self._headings[:, self._first : self._end].copy())

    @cython.cfunc
    def read(self, stamp: cython.double, yaw: cython.double, rate: cython.double, pose):
        """Keep a heading."""
        self._slow_rate += 0.1 * (rate - self._slow_rate)
        if fabs(rate - self._slow_rate) > _MIN_RATE_CHANGE:
            self._changed_at = stamp
        self.pose = pose
        if stamp - self._stamp < _SPACING:
            return
        if self._end == 4 * _HISTORY:
            self._times[:_HISTORY] = self._times[3 * _HISTORY :]
            self._yaws[:_HISTORY] = self._yaws[3 * _HISTORY :]
            self._first, self._end = 0, _HISTORY
        if self._end > self._first:
            self._total += remainder(yaw - self._yaw, _TURN)
        self._times[self._end], self._yaws[self._end] = stamp, self._total
        self._yaw, self._stamp, self._end = yaw, stamp, self._end + 1
        self._first = max(self._first, self._end - _HISTORY)

    @cython.cfunc
    def compare(self, scan, at: cython.double, now: cython.double):
        """Compare a scan with the last one; `at` is its arrival on the clock of odometry."""
        had_last: cython.bint = self._has_last
        self._has_last = False
        if at - self._changed_at > _LONGEST + 0.5:
            return
        if scan.bearings is not self._bearings:
            self._set_bearings(scan.bearings)
            had_last = False
        if self._ray == 0.0:
            return
        self._scans += 1
        if self.pairs >= _ENOUGH_PAIRS and self._scans % 4 > 1:
            return
        before: cython.double = self._scan_at
        x: cython.double = self._x
        y: cython.double = self._y
        self._keep(scan)
        self._scan_at, self._has_last = at, True
        self._x, self._y = self.pose.x, self.pose.y
        if not had_last or (self.pairs >= _ENOUGH_PAIRS and self._scans % 4 == 0):
            return
        if at - before > 0.5 or self._end == self._first:
            return
        if before - _LONGEST < self._times[self._first]:
            return
        if hypot(self._x - x, self._y - y) > _MAX_SHIFT:
            return
        k: cython.Py_ssize_t
        low: cython.double = INFINITY
        high: cython.double = -INFINITY
        end: cython.Py_ssize_t = self._end - 1
        begin: cython.Py_ssize_t = end
        for k in range(_CANDIDATES):
            while end > self._first and self._times[end] > at - _STEP * k:
                end -= 1
            while begin > self._first and self._times[begin] > before - _STEP * k:
                begin -= 1
            self._turn_of[k] = self._heading(end, at - _STEP * k) - self._heading(
                begin, before - _STEP * k
            )
            low, high = min(low, self._turn_of[k]), max(high, self._turn_of[k])
        if high - low < _MIN_TURN_SPREAD or max(-low, high) + _SEARCHED > _MAX_SEARCHED:
            return
        turn: cython.double = self._measured(low - _SEARCHED, high + _SEARCHED)
        if not isnan(turn):
            self._add(turn)
            self.at = now

    @cython.cfunc
    def _set_bearings(self, bearings):
        self._bearings, self._ray, self._n = bearings, 0.0, len(bearings)
        steps = np.diff(np.unwrap(bearings))
        if self._n >= _MIN_RAYS:
            step: cython.double = steps.mean()
            is_even: cython.bint = np.abs(steps - step).max() < 0.1 * fabs(step)
            if is_even and fabs(fabs(step) * self._n - _TURN) < 1.5 * fabs(step):
                self._ray = step
        if self._ray == 0.0:
            self.why = "its rays do not cover a full turn evenly"
        self._relief, self._old_relief = _doubles(2 * self._n), _doubles(2 * self._n)

    @cython.cfunc
    def _keep(self, scan):
        """Keep the ranges of a scan about their mean; a ray without a return tells nothing.

        As far away, it would be a feature: lost rays and a blind sector do not turn with the room.
        """
        ranges: cython.const[cython.double][::1] = _view(
            np.ascontiguousarray(scan.ranges, np.float64)
        )
        least: cython.double = scan.range_min
        most: cython.double = scan.range_max
        n: cython.Py_ssize_t = self._n
        i: cython.Py_ssize_t
        returns: cython.Py_ssize_t = 0
        mean: cython.double = 0.0
        square: cython.double = 0.0
        self._relief, self._old_relief = self._old_relief, self._relief
        self._old_norm = self._norm
        relief: cython.double[::1] = self._relief
        for i in range(n):
            if least <= ranges[i] <= most:
                mean += min(ranges[i], _MAX_RANGE)
                returns += 1
        mean /= max(returns, 1)
        for i in range(n):
            is_return: cython.bint = least <= ranges[i] <= most
            relief[i] = min(ranges[i], _MAX_RANGE) - mean if is_return else 0.0
            relief[n + i] = relief[i]
            square += relief[i] * relief[i]
        self._norm = sqrt(square)

    @cython.cfunc
    def _heading(self, k: cython.Py_ssize_t, at: cython.double) -> cython.double:
        """The heading at a time, which is not before that of heading k and before the next one."""
        before: cython.double = self._times[k]
        if at <= before or k == self._end - 1:
            return self._yaws[k]
        slope: cython.double = (self._yaws[k + 1] - self._yaws[k]) / (self._times[k + 1] - before)
        return slope * (at - before) + self._yaws[k]

    @cython.cfunc
    def _measured(self, low: cython.double, high: cython.double) -> cython.double:
        """The turn in rad from one scan to the next, between `low` and `high`; NaN: unclear.

        A turn by k rays to the left moves all that is seen k rays to the right.
        """
        least: cython.double = _MIN_RELIEF * sqrt(self._n)
        if min(self._norm, self._old_norm) < least:
            self.why = "it sees no features to tell a turn by"
            return NAN
        ray: cython.double = fabs(self._ray)
        first: cython.Py_ssize_t = cython.cast(cython.Py_ssize_t, floor(low / ray))
        last: cython.Py_ssize_t = cython.cast(cython.Py_ssize_t, ceil(high / ray))
        shift: cython.Py_ssize_t
        best: cython.Py_ssize_t = first
        most: cython.double = -INFINITY
        for shift in range(first, last + 1):
            likeness = self._likeness(shift)
            if likeness > most:
                most, best = likeness, shift
        if not first < best < last or most < _MIN_LIKENESS * self._old_norm * self._norm:
            return NAN
        a: cython.double = self._likeness(best - 1)
        c: cython.double = self._likeness(best + 1)
        return (best + 0.5 * (a - c) / (a - 2.0 * most + c)) * ray

    @cython.cfunc
    @cython.boundscheck(False)
    def _likeness(self, shift: cython.Py_ssize_t) -> cython.double:
        """The correlation of the last two scans at a turn by so many rays, at most n."""
        n: cython.Py_ssize_t = self._n
        first: cython.Py_ssize_t = shift if self._ray > 0.0 else -shift
        if first < 0:
            first += n
        one: cython.double[::1] = self._old_relief
        other: cython.double[::1] = self._relief
        i: cython.Py_ssize_t
        a: cython.double = 0.0
        b: cython.double = 0.0
        c: cython.double = 0.0
        d: cython.double = 0.0
        for i in range(0, n - 3, 4):  # four sums: a processor adds to them at the same time
            a += one[first + i] * other[i]
            b += one[first + i + 1] * other[i + 1]
            c += one[first + i + 2] * other[i + 2]
            d += one[first + i + 3] * other[i + 3]
        for i in range(n - n % 4, n):
            a += one[first + i] * other[i]
        return (a + b) + (c + d)

    @cython.cfunc
    def _add(self, turn: cython.double):
        """Add a measured turn, and what odometry says of it for each candidate."""
        k: cython.Py_ssize_t
        best: cython.Py_ssize_t = 0
        self._mm = _FORGETTING * self._mm + turn * turn
        self._weight = _FORGETTING * self._weight + 1.0
        for k in range(_CANDIDATES):
            self._mp[k] = _FORGETTING * self._mp[k] + turn * self._turn_of[k]
            self._pp[k] = _FORGETTING * self._pp[k] + self._turn_of[k] * self._turn_of[k]
            scale = self._mp[k] / max(self._pp[k], 1e-12)
            scale = min(max(scale, _LOWEST_SCALE), _HIGHEST_SCALE)
            self._error_of[k] = self._mm - 2.0 * scale * self._mp[k] + scale * scale * self._pp[k]
            if self._error_of[k] < self._error_of[best]:
                best = k
        self.pairs += 1
        self.delay = NAN
        if self._weight < _MIN_PAIRS:
            self.why = "too few turns yet"
            return
        self.why = "its turns do not tell one delay from another"
        variance: cython.double = self._error_of[best] / (self._weight - 2.0)
        variance = max(variance, _MIN_SPREAD * _MIN_SPREAD)
        limit: cython.double = self._error_of[best] + 9.0 * variance
        low: cython.Py_ssize_t = 0
        high: cython.Py_ssize_t = _CANDIDATES - 1
        while self._error_of[low] > limit:
            low += 1
        while self._error_of[high] > limit:
            high -= 1
        if high == _CANDIDATES - 1 or (high - low) * _STEP > _MAX_INTERVAL:
            return
        best = max(best, 1)
        a: cython.double = self._error_of[best - 1]
        c: cython.double = self._error_of[best + 1]
        bend: cython.double = a - 2.0 * self._error_of[best] + c
        if bend > 0.0:
            self.delay = max(_STEP * best + 0.5 * _STEP * (a - c) / bend, 0.0)
            self.spread = max(_ALIKE * _STEP * sqrt(2.0 * variance / bend), 0.005)


@cython.cclass
class _Stamps:
    """Delays by stamps. `offset`: the least arrival minus stamp of recent odometry; inf: none.

    `is_restarting`: stamps jumped a moment ago, and whether scan and odometry share a clock is to
    be found out. Until then a scan that seems late counts as late.
    """

    offset: cython.double
    is_restarting: cython.bint
    _spec: object
    _restart_ends: cython.double
    _scans: cython.Py_ssize_t  # that came since the restart
    _stamp: cython.double
    _scan_stamp: cython.double
    _lowest: cython.double  # lag of this period, and of the two before it
    _before: cython.double
    _until: cython.double
    _drifts: cython.bint
    _minima: cython.double[4]  # of the last periods
    _periods: cython.Py_ssize_t
    _ages: cython.double[20]  # of the last scans, the oldest at `_oldest`
    _count: cython.Py_ssize_t
    _oldest: cython.Py_ssize_t
    _at: cython.double
    _is_shared: cython.bint
    _why: object
    _ages_of_rays: object
    _lead: cython.double

    def __init__(self, spec) -> None:
        self._spec, self._why = spec, "no odometry yet"
        self.offset = self._lowest = self._before = INFINITY
        self._restart_ends = self._stamp = self._scan_stamp = self._until = -INFINITY
        self._lead = 0.0 if spec.sweep is None else 0.5 * spec.sweep.duration

    def check_indices(self) -> None:
        """ValueError unless its counts are of its arrays; see `recall`."""
        is_of_ages: cython.bint = 0 <= self._count <= _STAMPS and 0 <= self._oldest < _STAMPS
        if not (is_of_ages and 0 <= self._periods <= 4):
            raise ValueError(f"{self._count} ages from {self._oldest}, {self._periods} periods")

    @cython.cfunc
    def read(self, stamp: cython.double, now: cython.double) -> cython.bint:
        """Take in the stamp of a reading; true if its clock was set."""
        if stamp == self._stamp:
            return False
        lag: cython.double = now - stamp
        is_set: cython.bint = stamp < self._stamp or lag < self.offset - _SHIFT < INFINITY
        self._stamp = stamp
        if is_set:
            self._periods = 0
            self._lowest = self._before = INFINITY
            self._until = now + _PERIOD
            self._drifts = False
            self._restart(now)
        elif now >= self._until:
            self._end_period(now)
        self._lowest = min(lag, self._lowest)
        self.offset = min(self._lowest, self._before)
        return is_set

    @cython.cfunc
    def forget_scans(self) -> cython.int:
        """Tell the delay by the scans that come."""
        self._count = 0
        return 0

    @cython.cfunc
    def goes_back(self, stamp: cython.double, now: cython.double) -> cython.bint:
        """Take in the stamp of a scan; true if its clock was set back."""
        is_back: cython.bint = stamp < self._scan_stamp
        self._scan_stamp = stamp
        if is_back:
            self._restart(now)
        return is_back

    @cython.cfunc
    def _restart(self, now: cython.double) -> cython.int:
        self._count = self._scans = 0
        self.is_restarting, self._restart_ends = True, now + _RESTART_TIME
        return 0

    @cython.cfunc
    def _end_period(self, now: cython.double) -> cython.int:
        k: cython.Py_ssize_t
        change: cython.double
        if self._lowest < INFINITY:
            if self._periods == 4:
                self._periods = 3
                for k in range(3):
                    self._minima[k] = self._minima[k + 1]
            self._minima[self._periods] = self._lowest
            self._periods += 1
        self._lowest, self._until = INFINITY, now + _PERIOD
        before: cython.double = self._before
        self._before = INFINITY
        for k in range(max(self._periods - 2, 0), self._periods):
            self._before = min(self._before, self._minima[k])
        if before + _SHIFT < self._before < INFINITY:
            self._count = 0  # scan and odometry were late together, or their clock was set back
        # A clock that is not real time, as that of a slow simulator.
        rises: cython.int = 0
        falls: cython.int = 0
        for k in range(1, self._periods):
            change = self._minima[k] - self._minima[k - 1]
            rises += change > _MAX_DRIFT
            falls += change < -_MAX_DRIFT
        self._drifts = rises == 3 or falls == 3
        return 0

    @cython.cfunc
    def take(self, scan, now: cython.double) -> cython.double:
        """Take in a scan; the delay that counts, or 0 if stamps do not tell it."""
        if self.offset == INFINITY:
            return 0.0
        ages = scan.ages
        if ages is not self._ages_of_rays:  # mostly they are those of the last scan
            self._ages_of_rays, self._lead = ages, lead(scan, self._spec)
        stamp: cython.double = scan.stamp
        age: cython.double = now - self.offset - stamp - self._lead
        self._scans += 1
        if self.is_restarting and now > self._restart_ends and self._scans > _MIN_STAMPS:
            self.is_restarting = self._is_shared = False
        if self._drifts:
            self._forget("the stamps of odometry do not run at real time")
        elif age < _MAX_LEAD or (age > _MAX_AGE and not self._is_shared):
            self._forget(wrong_stamps(age, self._lead))
        else:
            age = min(max(age, 0.0), _LONGEST_AGE)
            if self._count < _STAMPS:
                self._ages[(self._oldest + self._count) % _STAMPS] = age
                self._count += 1
            else:
                self._ages[self._oldest] = age
                self._oldest = (self._oldest + 1) % _STAMPS
            self._at = now
        if not self._is_shared and (self._count < _MIN_STAMPS or self._periods < 4):
            return 0.0
        self._is_shared = self._count > 0
        return self._delay()

    @cython.cfunc
    def _delay(self) -> cython.double:
        """The third-latest of the last scans, and at least that of the last one."""
        first: cython.double = -INFINITY
        second: cython.double = -INFINITY
        third: cython.double = -INFINITY
        age: cython.double = 0.0
        k: cython.Py_ssize_t
        for k in range(self._count):
            age = self._ages[(self._oldest + k) % _STAMPS]
            if age > first:
                third, second, first = second, first, age
            elif age > second:
                third, second = second, age
            elif age > third:
                third = age
        if self._count < 3:
            third = second if self._count == 2 else first
        return max(third, age)

    @cython.cfunc
    def figure(self, now: cython.double):
        """The mean delay of the last scans, with its deviation."""
        if not self._is_shared or not self._count:
            why = "too few scans yet" if self._count else self._why
            return DelayFigure(method="stamps", text=why)
        ages = [self._ages[(self._oldest + k) % _STAMPS] for k in range(self._count)]
        return figure_of(ages, max(now - self._at, 0.0))

    @cython.cfunc
    def _forget(self, why):
        self._count, self._is_shared, self._why = 0, False, why


@cython.cclass
class ScanDelay:
    """Measures the delay of one sensor's scans, see `scan_delay.py`. Times in s of the robot.

    `added` is what protection counts beyond the declared latency: an upper estimate, at least the
    age of the last scan by its stamp; 0 within TOLERANCE of the declared one. `is_late`: it exceeds
    the platform's `max_scan_delay`, until it falls below 0.8 of that. `restarts` counts how often
    stamps jumped, so that the clock of odometry or scan was set: stamps then count anew, and what
    was added before is not taken back until they tell the delay again. `is_clock_set`: scans that
    are late now were in time when stamps jumped last. `sweep`: None if the platform tells how the
    sensor measures its rays.
    """

    added = cython.declare(cython.double, visibility="readonly")
    is_late = cython.declare(cython.bint, visibility="readonly")
    restarts = cython.declare(cython.Py_ssize_t, visibility="readonly")
    is_clock_set = cython.declare(cython.bint, visibility="readonly")
    sweep = cython.declare(object, visibility="readonly")
    _latency: cython.double
    _bound: cython.double
    _added_before: cython.double
    _stamps: _Stamps
    _turns: _Turns

    def __init__(self, spec: ScanSpec) -> None:
        self._latency, self._bound = spec.latency, spec.max_scan_delay
        self._stamps, self._turns = _Stamps(spec), _Turns()
        self.sweep = MeasuredSweep(spec) if spec.measures_sweep else None

    @cython.cfunc
    def read(
        self,
        stamp: cython.double,
        yaw: cython.double,
        rate: cython.double,
        pose,
        now: cython.double,
    ):
        """Take in what a reading says."""
        if self._stamps.read(stamp, now):
            self._restart()
        self._turns.read(stamp, yaw, rate, pose)

    def on_scan(self, scan: Scan, now: cython.double) -> None:
        """Take in a raw scan that arrived at `now` and is valid."""
        offset: cython.double = self._stamps.offset
        if self._stamps.goes_back(scan.stamp, now):
            self._restart()
        if self.sweep is not None:
            scan = self._swept(scan, now, offset)
        stamps: cython.double = self._stamps.take(scan, now)
        turns: _Turns = self._turns
        if offset < INFINITY:
            turns.compare(scan, now - offset, now)
        added: cython.double = stamps - self._latency
        if self._stamps.is_restarting:
            added = max(added, self._added_before)
        known: cython.double = max(self._latency, stamps) + _TOLERANCE
        if turns.delay - _CERTAIN * turns.spread > known:  # false of NaN: there is no figure
            upper: cython.double = turns.delay + turns.spread - self._latency
            if upper > self._bound and now - turns.at > _EXPIRES:
                turns.forget()  # a robot that is held cannot turn to measure anew
            else:
                added = max(added, upper)
        self.added = added if added > _TOLERANCE else 0.0
        self.is_late = self.added > (_CLEARS * self._bound if self.is_late else self._bound)
        self.is_clock_set = self.is_clock_set and (self.is_late or self._stamps.is_restarting)

    @cython.cfunc
    def _swept(self, scan, now: cython.double, offset: cython.double):
        """The scan with the ages that turns tell, if they do."""
        sweep = self.sweep
        headings = self._turns.headings()
        if offset < INFINITY and len(headings.times):
            has_turns = not isnan(self._turns.delay)
            measured = self._turns.delay if has_turns else self._stamps.figure(now).delay
            delay = self._latency if measured is None else measured
            before = sweep.order
            sweep.on_scan(scan, now - offset, delay, headings, self._turns.pose)
            if sweep.order != before:
                self._stamps.forget_scans()  # the time from a stamp to the mean ray is another one
        return scan if sweep.order is None else replace(scan, ages=sweep.ages(scan))

    @cython.cfunc
    def _restart(self):
        self.restarts += 1
        self._added_before = self.added
        self.is_clock_set = self.is_clock_set or not self.is_late
        self._turns.forget_headings()
        if self.sweep is not None:
            self.sweep.forget_scans()

    def summary(self, now: cython.double) -> ScanDelaySummary:
        """The figures of both methods, for the status."""
        return ScanDelaySummary(
            declared=self._latency,
            added=self.added,
            bound=self._bound,
            figures=(self._stamps.figure(now), self._turns.figure(now)),
            sweep=None if self.sweep is None else self.sweep.figure(),
        )


@cython.cclass
class OdometryHistory:
    """The last readings of odometry, for all that needs the motion of the sensor.

    `latest`: the stamp in s of the last reading; NaN without one.
    """

    latest = cython.declare(cython.double, visibility="readonly")
    _delay: ScanDelay
    # The last readings: stamp, x, y, yaw, linear, angular, lateral.
    _readings: cython.double[::1]
    _last: cython.Py_ssize_t
    _known: cython.Py_ssize_t
    _x: cython.double  # the pose that `_find` found
    _y: cython.double
    _yaw: cython.double
    path: cython.double[:, ::1]
    way: cython.double[::1]

    def __init__(self, delay: ScanDelay | None = None) -> None:
        """`delay` gets each reading whose stamp is new."""
        self._delay = delay
        self.latest, self._readings = NAN, array("d", (7 * _READINGS) * [0.0])
        self.path, self.way = memoryview(np.empty((_READINGS + 2, 4))), array("d", 3 * [0.0])

    def take(self, odometry: Odometry, now: cython.double) -> bool | None:
        """Take in a reading at `now`; true if its stamp is new, None if it is not valid.

        A new reading whose stamp does not rise, or whose pose jumps, ends the history before it.
        """
        pose, twist = odometry.pose, odometry.twist
        stamp: cython.double = odometry.stamp
        x: cython.double = pose.x
        y: cython.double = pose.y
        yaw: cython.double = pose.yaw
        linear: cython.double = twist.linear
        angular: cython.double = twist.angular
        lateral: cython.double = twist.lateral
        if not (  # see Odometry.is_valid, which takes longer
            isfinite(stamp)
            and fabs(x) <= _MAX_COORDINATE
            and fabs(y) <= _MAX_COORDINATE
            and fabs(yaw) <= _MAX_COORDINATE
            and fabs(linear) <= _MAX_COORDINATE
            and fabs(angular) <= _MAX_COORDINATE
            and fabs(lateral) <= _MAX_COORDINATE
        ):
            return None
        is_new: cython.bint = stamp != self.latest
        if is_new and self._delay is not None:
            self._delay.read(stamp, yaw, angular, pose, now)
        r: cython.double[::1] = self._readings
        at: cython.Py_ssize_t = 7 * self._last
        if self._known:
            if (
                not is_new
                and (x == r[at + 1] and y == r[at + 2] and yaw == r[at + 3])
                and (linear == r[at + 4] and angular == r[at + 5] and lateral == r[at + 6])
            ):
                return False
            apart: cython.double = hypot(x - r[at + 1], y - r[at + 2])
            apart = max(apart, fabs(remainder(yaw - r[at + 3], _TURN)))
            if stamp <= r[at] or apart > _MAX_STEP + _MAX_SPEED * (stamp - r[at]):
                self._known = 0
        self._last = (self._last + 1) % _READINGS
        self._known = min(self._known + 1, _READINGS)
        at = 7 * self._last
        r[at], r[at + 1], r[at + 2], r[at + 3] = stamp, x, y, yaw
        r[at + 4], r[at + 5], r[at + 6] = linear, angular, lateral
        self.latest = stamp
        return is_new

    @cython.cfunc
    def covers(self, at: cython.double) -> cython.bint:
        """True if the readings reach back to a time."""
        first: cython.Py_ssize_t = (self._last + 1 - self._known + _READINGS) % _READINGS
        return self._known > 0 and at >= self._readings[7 * first] - _MAX_EXTRAPOLATION

    @cython.cfunc
    def _find(self, at: cython.double) -> cython.int:
        """Find the pose at a time, of one reading at least: between two, or extrapolated."""
        r: cython.double[::1] = self._readings
        k: cython.Py_ssize_t
        early: cython.Py_ssize_t
        late: cython.Py_ssize_t = 7 * self._last
        for k in range(self._known):
            early = 7 * ((self._last - k + _READINGS) % _READINGS)
            if r[early] <= at:
                if k == 0:
                    break
                share = (at - r[early]) / (r[late] - r[early])
                self._x = r[early + 1] + share * (r[late + 1] - r[early + 1])
                self._y = r[early + 2] + share * (r[late + 2] - r[early + 2])
                self._yaw = r[early + 3] + share * remainder(r[late + 3] - r[early + 3], _TURN)
                return 0
            late = early
        # At a constant twist, along the chord of its arc.
        share = min(at - r[late], _MAX_EXTRAPOLATION)
        turn: cython.double = r[late + 5] * share
        c: cython.double = cos(r[late + 3] + 0.5 * turn)
        s: cython.double = sin(r[late + 3] + 0.5 * turn)
        ahead: cython.double = r[late + 4] * share
        left: cython.double = r[late + 6] * share
        self._x = r[late + 1] + c * ahead - s * left
        self._y = r[late + 2] + s * ahead + c * left
        self._yaw = r[late + 3] + turn
        return 0

    @cython.cfunc
    def set_path(self, at: cython.double, seconds: cython.double) -> cython.Py_ssize_t:
        """Set the path from the pose at a time back to that `seconds` earlier; its rows.

        0 at rest, without readings that reach back that far, and for no time.
        """
        if seconds == 0.0 or not self.covers(at - seconds):
            return 0
        r: cython.double[::1] = self._readings
        p: cython.double[:, ::1] = self.path
        rows: cython.Py_ssize_t = 1
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        self._find(at)
        p[0, 1], p[0, 2], p[0, 3] = self._x, self._y, self._yaw
        for i in range(self._known):
            k = 7 * ((self._last - i + _READINGS) % _READINGS)
            if at - r[k] >= seconds - _MIN_STEP:
                break
            if at - r[k] > _MIN_STEP:
                p[rows, 0], p[rows, 1], p[rows, 2], p[rows, 3] = (
                    at - r[k],
                    r[k + 1],
                    r[k + 2],
                    r[k + 3],
                )
                rows += 1
        self._find(at - seconds)
        p[rows, 0], p[rows, 1], p[rows, 2], p[rows, 3] = seconds, self._x, self._y, self._yaw
        rows += 1
        x: cython.double = p[0, 1]
        y: cython.double = p[0, 2]
        yaw: cython.double = p[0, 3]
        c: cython.double = cos(yaw)
        s: cython.double = sin(yaw)
        turned: cython.double = 0.0
        moves: cython.bint = False
        p[0, 0] = 0.0
        for i in range(rows):
            dx, dy = p[i, 1] - x, p[i, 2] - y
            turned += remainder(p[i, 3] - yaw - turned, _TURN)
            p[i, 1], p[i, 2], p[i, 3] = c * dx + s * dy, c * dy - s * dx, turned
            if max(fabs(p[i, 1]), fabs(p[i, 2]), fabs(turned)) > _AT_REST:
                moves = True
        return rows if moves else 0

    @cython.cfunc
    def set_way(self, at: cython.double, end: cython.double) -> cython.int:
        """Set the way to the pose at a time from that at its `end`."""
        self._find(end)
        x: cython.double = self._x
        y: cython.double = self._y
        yaw: cython.double = self._yaw
        self._find(at)
        dx: cython.double = self._x - x
        dy: cython.double = self._y - y
        c: cython.double = cos(yaw)
        s: cython.double = sin(yaw)
        self.way[0], self.way[1] = c * dx + s * dy, c * dy - s * dx
        self.way[2] = self._yaw - yaw
        return 0


@cython.cclass
class Deskewer:
    """De-skews the conditioned scans of one sensor, see `deskew.py`. Times in s.

    The returned scan has `ages` and `newest_age`. The ages are those of the driver, else those of
    the platform's `sweep`; without either the scan is returned as it is. With `measured` the ages
    are those of the measured sweep; while the sweep is not known, the rays stay where they were
    measured, the scan has the time of its mean ray, and each ray counts as old as the oldest one
    may be. Without odometry that reaches back over the whole scan the rays stay where they were
    measured, and the ages alone say how old each one is. At rest the scan keeps its bearings, the
    same object.
    """

    _sweep: object
    _latency: cython.double
    _stale_after: cython.double
    _measured: object
    _history: OdometryHistory
    _limits: cython.double[::1]
    _sector: cython.double[::1]
    # See Rays, for bearings and ages of a scan that are the same objects as before.
    _given: object
    _given_ages: object
    _ray_ages: object
    _bearings: cython.const[cython.double][::1]
    _cos: cython.const[cython.double][::1]
    _sin: cython.const[cython.double][::1]
    _ages: cython.const[cython.double][::1]
    _span: cython.double
    _newest_age: cython.double
    _direction: cython.double
    _oldest: cython.double
    _spacing: cython.double
    _last: object
    _last_at: cython.double  # the time of its newest ray
    _filled: cython.Py_ssize_t  # its first rays, which are those of the scan before it

    def __init__(
        self, spec: ScanSpec, history: OdometryHistory, measured: MeasuredSweep | None = None
    ) -> None:
        self._sweep, self._latency, self._stale_after = spec.sweep, spec.latency, spec.stale_after
        self._measured, self._history, self._last_at = measured, history, -INFINITY
        self._limits = array("d", (*spec.offset, spec.range_min, spec.range_max))
        self._sector = array("d", 3 * [0.0])
        self._bearings = self._cos = self._sin = self._ages = None

    def deskew(
        self, scan: Scan, now: cython.double, odometry_age, delay: cython.double = 0.0
    ) -> Scan:
        """The scan that arrived at `now`, as seen at the time of its newest ray.

        `odometry_age`: s since the last reading arrived; None without a fresh one. `delay`: s by
        which the scan is older than the platform's `latency` says.
        """
        ages = scan.ages
        if self._measured is not None:
            ages = self._measured.ages(scan)
            if self._measured.order is None:
                scan = _scan_with(scan, scan.ranges, scan.bearings, ages, self._latency)
                self._last, self._last_at = scan, now - self._latency - delay
                self._filled = 0
                return scan
        if ages is None and self._sweep is None:
            return scan
        ranges, bearings = scan.ranges, scan.bearings
        if bearings is not self._given or ages is not self._given_ages:
            self._set_rays(bearings, ages)
        ago: cython.double = self._newest_age + delay
        moved = None
        if odometry_age is not None:
            stamp: cython.double = odometry_age
            stamp = self._history.latest + stamp - ago
            moved = self._moved(ranges, stamp, now - ago - self._last_at)
        if moved is None:
            result = _scan_with(scan, ranges, bearings, self._ray_ages, self._newest_age)
            self._filled = 0
        else:
            result = _scan_with(scan, moved[0], moved[1], moved[2], self._newest_age)
            self._filled = len(result.ranges) - len(ranges)
        self._last, self._last_at = result, now - ago
        return result

    @cython.cfunc
    def _set_rays(self, bearings, ages):
        """Take other bearings and ages; None: by the platform's sweep."""
        rays = _rays_of(bearings, ages, self._sweep)
        self._given, self._given_ages, self._ray_ages = bearings, ages, rays.ages
        self._bearings, self._ages = _view(bearings), _view(rays.ages)
        self._cos, self._sin = _view(rays.cos), _view(rays.sin)
        self._span, self._newest_age = rays.span, max(self._latency - rays.mean_age, 0.0)
        self._direction, self._oldest, self._spacing = rays.direction, rays.oldest, rays.spacing

    @cython.cfunc
    def _moved(self, measured, stamp: cython.double, seconds: cython.double):
        """Ranges, bearings and ages (k,) of a scan, as seen at the `stamp` of its newest ray.

        None at rest, without odometry that reaches back over the scan, if all rays are of one
        instant, and if nothing fills a sector that was not measured. The newest ray of the last
        scan is `seconds` older.
        """
        history: OdometryHistory = self._history
        rows: cython.Py_ssize_t = history.set_path(stamp, self._span)
        if rows == 0:
            return None
        n: cython.Py_ssize_t = self._ages.shape[0]
        k: cython.Py_ssize_t = 0
        i: cython.Py_ssize_t
        unmeasured: cython.double = self._direction * history.path[rows - 1, 3]
        is_filled: cython.bint = unmeasured > 0.5 * self._spacing
        room: cython.Py_ssize_t = n
        before = self._last
        ages = self._ray_ages
        if is_filled:
            if before is None or before.ages is None or not 0.0 < seconds <= self._stale_after:
                return None
            if not history.covers(stamp - seconds):
                return None
            room += len(before.ranges)
        ranges, bearings = np.empty(room), np.empty(room)
        distances: cython.double[::1] = _view(ranges)
        angles: cython.double[::1] = _view(bearings)
        if is_filled:
            history.set_way(stamp - seconds, stamp)
            self._sector[0] = self._oldest - 0.5 * self._direction * self._spacing
            self._sector[1], self._sector[2] = self._direction, unmeasured
            ages = np.empty(room)
            kept: cython.double[::1] = _view(ages)
            k = rays_in_sector(
                _view(before.ranges),
                _view(before.bearings),
                _view(before.ages),
                self._filled,  # or a ray could be passed on for ever
                history.way,
                self._sector,
                self._limits,
                distances,
                angles,
                kept,
            )
            for i in range(k):
                kept[i] += seconds
            for i in range(n):
                kept[k + i] = self._ages[i]
            ranges, bearings, ages = ranges[: k + n], bearings[: k + n], ages[: k + n]
        move_rays(
            _view(measured),
            self._bearings,
            self._cos,
            self._sin,
            self._ages,
            history.path,
            rows,
            self._limits,
            distances[k:],
            angles[k:],
        )
        for values in (ranges, bearings, ages):
            values.setflags(write=False)
        return ranges, bearings, ages


_rays: list = []  # a cache of the latest ones: robots of one kind share them, and so their memory


@cython.cfunc
def _rays_of(bearings, ages, sweep):
    """The rays of these very bearings and ages."""
    for rays in _rays:
        if rays.bearings is bearings and rays.given is ages and rays.sweep == sweep:
            return rays
    if len(_rays) == _MAX_LAYOUTS:
        _rays.pop()
    _rays.insert(0, Rays(bearings, ages, sweep))
    return _rays[0]


@cython.cfunc
def _scan_with(scan, ranges, bearings, ages, newest_age: cython.double):
    """A scan of the same sequence, stamp and limits."""
    limits = scan.range_min, scan.range_max
    return Scan(scan.seq, scan.stamp, ranges, bearings, *limits, ages, newest_age)
