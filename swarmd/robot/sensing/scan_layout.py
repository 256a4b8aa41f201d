"""The layout of a scan: its bearings and what derives from them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import PI, TURN, wrap
from swarmd.core.buffers import checked, flags, indices, scratch, view_of
from swarmd.core.cython_shadow import INFINITY, NAN, isfinite, isnan, rint, tan
from swarmd.core.ray_order import sort_rays

if TYPE_CHECKING:
    from swarmd.core.values import Array, Scan
if cython.compiled:
    from cython.cimports.libc.string import memcmp

_MAX_LAYOUTS = cython.declare(cython.int, 2)  # of a robot: of its lidar and of its ring
_MAX_STEPS = cython.declare(cython.double, 3.5)  # between rays of one object


@cython.final
@cython.auto_pickle(False)
@cython.cclass
class ScanLayout:
    """The bearings of a scan and what derives from them; buffers for the features of a scan.

    De-skew gives each scan of a moving robot other bearings. So a layout is set again for each
    scan, and its buffers stay.
    """

    n: cython.Py_ssize_t
    capacity: cython.Py_ssize_t  # of the buffers
    given: cython.double[::1]  # bearings
    angles: Array  # the array of `wrapped`
    wrapped: cython.double[::1]  # bearings within [-pi, pi)
    # The arrays of the last scan of these bearings, if nothing can change them. It is not the scan
    # itself, which keeps the layouts alive.
    given_ranges: Array | None
    given_bearings: Array | None
    known: cython.const_double[::1]  # ranges of that scan
    # By rising bearing, see `set_grazing`.
    is_ordered: cython.bint
    order: cython.longlong[::1]
    rising: cython.double[::1]
    steps: cython.double[::1]  # to the next ray
    spacing: cython.double  # the median step
    grazing: cython.double
    slopes: cython.double[::1]
    is_apart: cython.uchar[::1]
    # Of `count` equal sectors.
    count: cython.Py_ssize_t
    sector: cython.longlong[::1]  # of each ray
    lowest: cython.double[::1]  # range in each sector
    nearest_ray: cython.Py_ssize_t[::1]
    points: Array  # (count, 2) closest points: range and bearing
    point: cython.double[:, ::1]  # the view of `points`
    # Of the objects in a scan.
    work: cython.double[::1]  # ranges by rising bearing
    is_last: cython.uchar[::1]  # rays at whose end an object ends

    def __init__(self, n: cython.Py_ssize_t) -> None:
        """For up to n bearings."""
        self.capacity = n
        self.angles = np.empty(n)
        self.given = scratch(n)
        self.steps = scratch(n)
        self.wrapped = view_of(self.angles)
        self.work = scratch(n)
        self.rising = scratch(n)
        self.slopes = scratch(n)
        self.order = indices(n)
        self.sector = indices(n)
        self.is_apart = flags(n)
        self.is_last = flags(n)

    @cython.cfunc
    def is_of(self, bearings: cython.const_double[::1]) -> cython.bint:
        """True if these are its bearings."""
        n: cython.Py_ssize_t = self.n
        if len(bearings) != n:
            return False
        if cython.compiled:
            return memcmp(cython.address(bearings[0]), cython.address(self.given[0]), 8 * n) == 0
        return list(bearings) == self.given[:n]

    @cython.ccall
    def set_bearings(self, bearings: cython.const_double[::1]) -> cython.int:
        """Take other bearings; IndexError if they are more than the layout has room for."""
        i: cython.Py_ssize_t
        n: cython.Py_ssize_t = len(bearings)
        given = checked(self.given, n)
        wrapped = checked(self.wrapped, n)
        self.n = n
        for i in range(n):
            angle = bearings[i]
            if not isfinite(angle):
                raise ValueError(f"bearing {i} of a scan is {angle}; expected a finite angle")
            given[i] = angle
            wrapped[i] = wrap(angle)
        self.is_ordered = False
        self.grazing = NAN
        self.count = -1

    @cython.cfunc
    @cython.boundscheck(False)
    def set_grazing(self, grazing: cython.double) -> None:
        """Set the order of the rays by rising bearing, and `slopes` and `is_apart` of each ray.

        `slopes`: how much the range changes to the next ray on a surface at `grazing` rad to the
        ray, as a share of the range. `is_apart`: the next ray is too far away to be of the same
        object; up to two rays may be unknown within an object.
        """
        if not self.is_ordered:
            self.set_order()
        if grazing == self.grazing:
            return
        i: cython.Py_ssize_t
        slope = tan(grazing)
        max_step = min(_MAX_STEPS * self.spacing, 0.5 * PI)
        for i in range(self.n):
            self.slopes[i] = self.steps[i] / slope if slope else INFINITY
            self.is_apart[i] = self.steps[i] >= max_step
        self.grazing = grazing

    @cython.cfunc
    @cython.boundscheck(False)
    def set_order(self) -> None:
        """Set the order of the rays by rising bearing, their `steps` and the `spacing` in rad.

        A step is the angle to the next ray in this order, and `spacing` the median step.
        """
        count: cython.Py_ssize_t = self.n
        i: cython.Py_ssize_t
        sort_rays(self.wrapped, count, self.rising, self.order)
        for i in range(count - 1):
            self.steps[i] = self.rising[i + 1] - self.rising[i]
        self.steps[count - 1] = self.rising[0] - self.rising[count - 1] + TURN
        for i in range(count):
            self.slopes[i] = self.steps[i]  # a copy, since `_smallest` reorders
        self.spacing = _smallest(self.slopes, count, count // 2)
        self.is_ordered = True

    @cython.cfunc
    def set_sectors(self, count: cython.Py_ssize_t) -> None:
        """Set the sector of each ray."""
        if count == self.count:
            return
        if self.points is None or len(self.points) != count:
            self.points = np.empty((count, 2))
            self.point = view_of(self.points)
            self.lowest = scratch(count)
            self.nearest_ray = np.empty(count, np.intp).data
        share = count / TURN
        i: cython.Py_ssize_t
        sector: cython.longlong
        for i in range(self.n):
            # Below `count` on either side, so that no slow modulo is needed.
            sector = cython.cast(cython.longlong, rint(self.wrapped[i] * share))
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
        middle = values[k]
        i = low
        j = high
        while i <= j:
            while values[i] < middle:
                i += 1
            while middle < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i = i + 1
                j = j - 1
        if j < k:
            low = i
        if k < i:
            high = j
    return values[k]


@cython.final
@cython.auto_pickle(False)
@cython.cclass
class ScanLayouts:
    """The layouts of the latest bearings of one robot, since most sensors keep theirs.

    Who hands scans to a pattern owns it (`PatternExecutor`), and lends it to each scan by `serve`.
    A scan that comes from elsewhere has one of its own. No feature depends on what is kept here, of
    which a test asks in any order.
    """

    _kept: list[ScanLayout]  # the newest first

    def __init__(self) -> None:
        self._kept = []

    def serve(self, scan: Scan | None) -> None:
        """Let the features of a scan use what was derived from the scans before it."""
        if scan is not None:
            scan.__dict__["layouts"] = self

    @cython.cfunc
    def of(self, scan: Scan) -> ScanLayout | None:
        """The layout of the known rays of a scan, with their ranges; None without any."""
        layout: ScanLayout
        given_ranges = scan.ranges
        given_bearings = scan.bearings
        for layout in self._kept:
            if layout.given_ranges is given_ranges and layout.given_bearings is given_bearings:
                return layout
        ranges = np.ascontiguousarray(given_ranges, np.float64)
        bearings = np.ascontiguousarray(given_bearings, np.float64)
        if ranges.shape != bearings.shape or ranges.ndim != 1:
            raise ValueError(
                f"ranges {ranges.shape} and bearings {bearings.shape} of a scan; expected both (n,)"
            )
        known: cython.const_double[::1] = view_of(ranges)
        i: cython.Py_ssize_t
        for i in range(len(known)):
            if isnan(known[i]):
                is_known = ~np.isnan(ranges)
                known = view_of(ranges[is_known])
                bearings = bearings[is_known]
                break
        if not len(known):
            return None
        view: cython.const_double[::1] = view_of(bearings)
        for layout in self._kept:
            if layout.is_of(view):
                break
        else:
            layout = self._new_layout(view)
        is_fixed = not (given_ranges.flags.writeable or given_bearings.flags.writeable)
        layout.given_ranges = given_ranges if is_fixed else None
        layout.given_bearings = given_bearings if is_fixed else None
        layout.known = known
        return layout

    @cython.cfunc
    def _new_layout(self, view: cython.const_double[::1]) -> ScanLayout:
        """The layout of other bearings, in place of the oldest one."""
        kept = self._kept
        layout: ScanLayout = kept.pop() if len(kept) == _MAX_LAYOUTS else ScanLayout(len(view))
        if layout.capacity < len(view):
            layout = ScanLayout(len(view))
        layout.set_bearings(view)
        kept.insert(0, layout)
        return layout


@cython.cfunc
def layout_of(scan: Scan) -> ScanLayout | None:
    """The layout of the known rays of a scan, with their ranges; None without any."""
    lent = scan.__dict__
    layouts: ScanLayouts | None = lent.get("layouts")
    if layouts is None:
        layouts = ScanLayouts()
        lent["layouts"] = layouts
    return layouts.of(scan)
