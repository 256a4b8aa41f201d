"""The layout of a scan: its bearings and what derives from them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import PI, TURN, wrap
from swarmd.core.buffers import checked, flags, indices, scratch, view_of
from swarmd.core.cython_shadow import (
    INFINITY,
    NAN,
    Doubles,
    Indices,
    Table,
    isfinite,
    isnan,
    rint,
    tan,
)
from swarmd.core.ray_order import sort_rays

if TYPE_CHECKING:
    from swarmd.core.values import Array, Scan
if cython.compiled:
    from cython.cimports.libc.string import memcmp

_MAX_LAYOUTS = 2  # of a robot: of its lidar and of its ring
_MAX_STEPS = 3.5  # between rays of one object


@cython.cclass
class ScanLayout:
    """The bearings of a scan and what derives from them; buffers for the features of a scan.

    De-skew gives each scan of a moving robot other bearings. So a layout is set again for each
    scan, and its buffers stay.
    """

    n: int
    capacity: int  # of the buffers
    given: Doubles  # bearings
    angles: Array  # the array of `wrapped`
    wrapped: Doubles  # bearings within [-pi, pi)
    # The arrays of the last scan of these bearings, if nothing can change them. It is not the scan
    # itself, which keeps the layouts alive.
    given_ranges: Array | None
    given_bearings: Array | None
    known: Doubles  # ranges of that scan
    # By rising bearing, see `set_grazing`.
    is_ordered: bool
    order: Indices
    rising: Doubles
    steps: Doubles  # to the next ray
    spacing: float  # the median step
    grazing: float
    slopes: Doubles
    is_apart: Indices
    # Of `count` equal sectors.
    count: int
    sector: Indices  # of each ray
    lowest: Doubles  # range in each sector
    nearest_ray: Indices
    points: Array  # (count, 2) closest points: range and bearing
    point: Table  # the view of `points`
    # Of the objects in a scan.
    work: Doubles  # ranges by rising bearing
    is_last: Indices  # rays at whose end an object ends

    def __init__(self, n: int) -> None:
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

    def is_of(self, bearings: Doubles) -> bool:
        """True if these are its bearings."""
        n = self.n
        if len(bearings) != n:
            return False
        if cython.compiled:
            return memcmp(cython.address(bearings[0]), cython.address(self.given[0]), 8 * n) == 0
        return list(bearings) == self.given[:n]

    def set_bearings(self, bearings: Doubles) -> None:
        """Take other bearings; IndexError if they are more than the layout has room for."""
        n = len(bearings)
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

    def set_grazing(self, grazing: float) -> None:
        """Set the order of the rays by rising bearing, and `slopes` and `is_apart` of each ray.

        `slopes`: how much the range changes to the next ray on a surface at `grazing` rad to the
        ray, as a share of the range. `is_apart`: the next ray is too far away to be of the same
        object; up to two rays may be unknown within an object.
        """
        if not self.is_ordered:
            self.set_order()
        if grazing == self.grazing:
            return
        slope = tan(grazing)
        max_step = min(_MAX_STEPS * self.spacing, 0.5 * PI)
        for i in range(self.n):
            self.slopes[i] = self.steps[i] / slope if slope else INFINITY
            self.is_apart[i] = self.steps[i] >= max_step
        self.grazing = grazing

    def set_order(self) -> None:
        """Set the order of the rays by rising bearing, their `steps` and the `spacing` in rad.

        A step is the angle to the next ray in this order, and `spacing` the median step.
        """
        count = self.n
        sort_rays(self.wrapped, count, self.rising, self.order)
        for i in range(count - 1):
            self.steps[i] = self.rising[i + 1] - self.rising[i]
        self.steps[count - 1] = self.rising[0] - self.rising[count - 1] + TURN
        for i in range(count):
            self.slopes[i] = self.steps[i]  # a copy, since `_smallest` reorders
        self.spacing = _smallest(self.slopes, count, count // 2)
        self.is_ordered = True

    def set_sectors(self, count: int) -> None:
        """Set the sector of each ray."""
        if count == self.count:
            return
        if self.points is None or len(self.points) != count:
            self.points = np.empty((count, 2))
            self.point = view_of(self.points)
            self.lowest = scratch(count)
            self.nearest_ray = np.empty(count, np.intp).data
        share = count / TURN
        for i in range(self.n):
            # Below `count` on either side, so that no slow modulo is needed.
            sector = cython.cast(cython.longlong, rint(self.wrapped[i] * share))
            self.sector[i] = sector + count if sector < 0 else sector
        self.count = count


def _smallest(values: Doubles, n: int, k: int) -> float:
    """The element of rank k of the first n, which get another order (Hoare's algorithm FIND)."""
    low = 0
    high = n - 1
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
        known: Doubles = view_of(ranges)
        for i in range(len(known)):
            if isnan(known[i]):
                is_known = ~np.isnan(ranges)
                known = view_of(ranges[is_known])
                bearings = bearings[is_known]
                break
        if not len(known):
            return None
        view: Doubles = view_of(bearings)
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

    def _new_layout(self, view: Doubles) -> ScanLayout:
        """The layout of other bearings, in place of the oldest one."""
        kept = self._kept
        layout: ScanLayout = kept.pop() if len(kept) == _MAX_LAYOUTS else ScanLayout(len(view))
        if layout.capacity < len(view):
            layout = ScanLayout(len(view))
        layout.set_bearings(view)
        kept.insert(0, layout)
        return layout


def layout_of(scan: Scan) -> ScanLayout | None:
    """The layout of the known rays of a scan, with their ranges; None without any."""
    lent = scan.__dict__
    kept = lent.get("layouts")
    if not isinstance(kept, ScanLayouts):  # none, or of the other form of this module
        kept = ScanLayouts()
        lent["layouts"] = kept
    layouts: ScanLayouts = kept
    return layouts.of(scan)
