"""Blind sectors: rays without returns in directions in which other rays have returns.

A covered or broken part of a range sensor looks like open space. While the robot turns, different
rays pass over the same static object. If other rays return the object before and after, a ray
without a return has missed it. A sector of the sensor is blind once its rays have missed objects in
many directions, without any return meanwhile.

Why there are no false alarms: in an open field, at a door and at a surface that reflects no ray,
the other rays have no return either. An object that moves is not the same before and after. A
return in a sector of the sensor clears the misses of the sector.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array, Odometry, ScanSpec
from swarmd.sensing.angles import TURN
from swarmd.sensing.buffers import new_flags, new_indices, view_of

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import INFINITY, NAN, fabs, floor, hypot, isnan, remainder
else:
    from swarmd.core.cython_shadow import INFINITY, NAN, fabs, floor, hypot, isnan, remainder

SECTORS = 90
"""Sectors of 4 degrees, of the sensor and of the directions around it."""

_SECTORS = cython.declare(cython.Py_ssize_t, SECTORS)
_COMPARE_PERIOD = cython.declare(cython.double, 0.95)  # s between two looks, at least
# Directions, each a sector wide, in which a blind sector must have missed an object.
_MIN_MISSED = cython.declare(cython.Py_ssize_t, 8)
_MAX_TIME = cython.declare(cython.double, 15.0)  # s after which a seen object is forgotten
# Share of the range by which the robot may move, since motion changes directions to objects.
_MAX_MOTION = cython.declare(cython.double, 0.25)
# An object is the same if its range changes by at most this share of the range plus so many m.
_SAME_SHARE = cython.declare(cython.double, 0.25)
_SAME_M = cython.declare(cython.double, 0.1)
# Looks (comparisons of a scan) in a row that see a static object, before and after a ray misses it.
_STREAK = cython.declare(cython.int, 3)
# Scans in a row with a return, after which a blind sector is trusted again.
_CLEARING_SCANS = cython.declare(cython.int, 3)


@cython.cclass
class BlindSectors:
    """Finds the blind sectors of one sensor. Times in s, poses in the odometry frame.

    `text` names the blind sectors; empty without one.
    """

    text = cython.declare(object, visibility="readonly")
    _is_used: cython.bint
    _compared_at: cython.double
    _compared_yaw: cython.double
    _is_blind: object
    _range_min: cython.double
    _range_max: cython.double
    _is_zero_near: cython.bint
    _bearings_of_scan: object
    _bearings: cython.const[cython.double][::1]
    _sector: cython.longlong[::1]  # of each ray
    _direction: cython.longlong[::1]
    _is_return: cython.uchar[::1]
    _blind_flags: cython.uchar[::1]
    _returned_array: object  # the array of `_returned_at`
    _returned_at: cython.double[::1]  # by sector
    _return_streak: cython.longlong[90]  # scans in a row with a return
    # By direction: range of the object last seen there, from where (x, y), in how many comparisons
    # in a row, and when.
    _range: cython.double[90]
    _x: cython.double[90]
    _y: cython.double[90]
    _streak: cython.int[90]
    _seen_at: cython.double[90]
    # short: Cython takes an array of uchar for a text that ends at 0, as a memory is read.
    _pending: cython.short[8100]  # [direction, sector]: missed the object since
    _missed: cython.short[8100]  # [sector, direction]: missed a static object
    # Of one comparison, by direction: rays, returns, sum of ranges, whether an object is known.
    _rays: cython.int[90]
    _hits: cython.int[90]
    _sums: cython.double[90]
    _is_known: cython.short[90]

    def __init__(self, spec: ScanSpec) -> None:
        k: cython.Py_ssize_t
        self._is_used, self.text = len(spec.bearings) >= _SECTORS, ""
        self._compared_at, self._compared_yaw = -INFINITY, NAN
        self._range_min, self._range_max = spec.range_min, spec.range_max
        self._is_zero_near = spec.zero == "too_close"
        self._is_blind = np.zeros(_SECTORS, np.bool_)
        self._blind_flags = memoryview(self._is_blind.view(np.uint8))
        self._returned_array = np.full(_SECTORS, NAN)
        self._returned_at = memoryview(self._returned_array)
        for k in range(_SECTORS):
            self._seen_at[k] = -INFINITY
        self._bearings = self._sector = self._direction = self._is_return = None

    def check_indices(self) -> None:
        """ValueError unless each ray is in one of the sectors, for a serialised robot."""
        i: cython.Py_ssize_t
        for i in range(0 if self._sector is None else len(self._sector)):
            if not 0 <= self._sector[i] < _SECTORS:
                raise ValueError(f"ray {i} is in sector {self._sector[i]} of {_SECTORS}")

    def take(
        self, ranges: Array, bearings: Array, odometry: Odometry | None, now: cython.double
    ) -> Array:
        """The raw ranges (n,) of a scan, with NaN for rays of blind sectors without a return."""
        known = np.array(ranges, np.float64)
        self.mark(view_of(known), bearings, odometry, now)
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
        if bearings is not self._bearings_of_scan:
            self._set_bearings(bearings)
        self._find_returns(given)
        has_changed: cython.bint = self._count_returns(now)
        if is_due and self._compare_scan(given, pose.x, pose.y, pose.yaw, now):
            has_changed = True
        i: cython.Py_ssize_t
        for i in range(given.shape[0]):
            if self._blind_flags[self._sector[i]] and not self._is_return[i]:
                given[i] = NAN
        if has_changed:
            self.text = blind_text(self._is_blind, self._returned_array, now)

    @cython.cfunc
    def _set_bearings(self, bearings):
        """Set the sector of each ray."""
        i: cython.Py_ssize_t
        n: cython.Py_ssize_t = len(bearings)
        self._bearings_of_scan, self._bearings = bearings, view_of(bearings)
        self._sector, self._direction = new_indices(n), new_indices(n)
        self._is_return = new_flags(n)
        for i in range(n):
            self._sector[i] = _sector_of(self._bearings[i])

    @cython.cfunc
    def _find_returns(self, ranges: cython.double[::1]) -> cython.int:
        """Set which rays are returns, and `_hits`: the returns in each sector of the sensor."""
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        for k in range(_SECTORS):
            self._hits[k] = 0
        for i in range(ranges.shape[0]):
            self._is_return[i] = (0.0 < ranges[i] <= self._range_max) or ranges[i] == -INFINITY
            if self._is_zero_near and ranges[i] == 0.0:
                self._is_return[i] = True
            self._hits[self._sector[i]] += self._is_return[i]
        return 0

    @cython.cfunc
    def _count_returns(self, now: cython.double) -> cython.bint:
        """Count scans in a row with a return in each sector; true if a sector is blind no more."""
        k: cython.Py_ssize_t
        has_cleared: cython.bint = False
        for k in range(_SECTORS):
            self._return_streak[k] = self._return_streak[k] + 1 if self._hits[k] else 0
            if self._hits[k] or isnan(self._returned_at[k]):
                self._returned_at[k] = now
            if self._blind_flags[k] and self._return_streak[k] >= _CLEARING_SCANS:
                self._blind_flags[k], has_cleared = False, True
        return has_cleared

    @cython.cfunc
    def _is_due(self, yaw: cython.double, now: cython.double) -> cython.bint:
        """Begin a comparison if the robot has turned by a sector since the last; True if begun."""
        turned: cython.double = fabs(remainder(yaw - self._compared_yaw, TURN))
        if now - self._compared_at < _COMPARE_PERIOD or turned < TURN / _SECTORS:
            return False
        self._compared_at, self._compared_yaw = now, yaw
        return True

    @cython.cfunc
    def _compare_scan(
        self,
        ranges: cython.double[::1],
        x: cython.double,
        y: cython.double,
        yaw: cython.double,
        now: cython.double,
    ) -> cython.bint:
        """Compare what each sector of the sensor returns with what other sectors returned there.

        True if a further sector is blind now. `x`, `y`, `yaw` are the pose of the robot.
        """
        d: cython.Py_ssize_t
        self._sum_by_direction(ranges, yaw)
        for d in range(_SECTORS):
            self._is_known[d] = now - self._seen_at[d] <= _MAX_TIME and (
                hypot(x - self._x[d], y - self._y[d]) <= _MAX_MOTION * self._range[d]
            )
            self._compare_direction(d, x, y, now)
        self._await_confirmation()
        return self._judge_sectors()

    @cython.cfunc
    def _sum_by_direction(self, ranges: cython.double[::1], yaw: cython.double) -> cython.int:
        """Set rays, hits and the sum of ranges in each direction of the odometry frame."""
        i: cython.Py_ssize_t
        d: cython.Py_ssize_t
        for d in range(_SECTORS):
            self._rays[d] = self._hits[d] = 0
            self._sums[d] = 0.0
        for i in range(ranges.shape[0]):
            d = self._direction[i] = _sector_of(self._bearings[i] + yaw)
            self._rays[d] += 1
            if self._is_return[i]:
                self._hits[d] += 1
                self._sums[d] += max(ranges[i], self._range_min)
        return 0

    @cython.cfunc
    def _compare_direction(
        self, d: cython.Py_ssize_t, x: cython.double, y: cython.double, now: cython.double
    ) -> cython.int:
        """Compare the returns in the direction `d` (an index) with the object last seen there.

        An object is seen if all rays in the direction have a return. An object is static once
        _STREAK comparisons in a row have seen it. Then the object is known (`_is_known`) for
        _MAX_TIME, as long as the robot stays near. A sector of the sensor that misses a known
        object waits (`_pending`) until the object proves to be static again. Then the miss counts
        against the sector (`_missed`).

        `x`, `y`: m, the place of the robot. `now`: s.
        """
        k: cython.Py_ssize_t

        # 1. Is an object seen in the direction, and is it the object that was seen last?
        distance: cython.double = self._sums[d] / max(self._hits[d], 1)
        is_seen: cython.bint = 0 < self._rays[d] == self._hits[d]  # has rays, and all return
        is_same: cython.bint = is_seen and (
            fabs(distance - self._range[d]) <= _SAME_M + _SAME_SHARE * self._range[d]
        )
        is_new: cython.bint = is_seen and not is_same
        # The number of comparisons in a row that saw this object.
        if is_same:
            self._streak[d] += 1
        else:
            self._streak[d] = 1 if is_new else 0
        has_streak: cython.bint = self._streak[d] >= _STREAK

        # 2. The wait of sectors ends: with a miss if the known object has proved to be static
        # again, without a miss if the object is a new object, or is no longer known.
        is_static: cython.bint = self._is_known[d] and has_streak
        is_decided: cython.bint = is_static or is_new or not self._is_known[d]
        for k in range(_SECTORS):
            if self._return_streak[k]:  # a sector that has returns now is not blind
                self._pending[_SECTORS * d + k] = self._missed[_SECTORS * k + d] = False
            elif is_decided and self._pending[_SECTORS * d + k]:
                self._pending[_SECTORS * d + k] = False
                self._missed[_SECTORS * k + d] |= is_static

        # 3. Stores an object that is new or static.
        if is_new:
            self._seen_at[d] = -INFINITY  # not known until the object proves to be static
        elif has_streak:
            self._seen_at[d] = now
        if is_new or has_streak:
            self._range[d] = distance
            self._x[d], self._y[d] = x, y
        return 0

    @cython.cfunc
    def _await_confirmation(self) -> cython.int:
        """Mark sectors that miss a known object: this counts once the object is seen again."""
        i: cython.Py_ssize_t
        d: cython.Py_ssize_t
        k: cython.Py_ssize_t
        for i in range(self._sector.shape[0]):
            d, k = self._direction[i], self._sector[i]
            if self._is_known[d] and not self._hits[d] and not self._return_streak[k]:
                self._pending[_SECTORS * d + k] = True
        return 0

    @cython.cfunc
    def _judge_sectors(self) -> cython.bint:
        """Sectors that have missed things in many directions are blind; true if one is new."""
        d: cython.Py_ssize_t
        k: cython.Py_ssize_t
        count: cython.Py_ssize_t
        is_new: cython.bint = False
        for k in range(_SECTORS):
            count = 0
            for d in range(_SECTORS):
                count += self._missed[_SECTORS * k + d]
            if count >= _MIN_MISSED and not self._blind_flags[k]:
                self._blind_flags[k] = is_new = True
        return is_new


@cython.cfunc
@cython.inline
def _sector_of(angle: cython.double) -> cython.longlong:
    """The sector of an angle, from 0 to 89."""
    sector: cython.longlong = cython.cast(
        cython.longlong, floor(angle * (1.0 / (TURN / _SECTORS)) + 1e-6)
    )
    sector %= _SECTORS
    return sector + _SECTORS if sector < 0 else sector


def blind_text(is_blind: NDArray[np.bool_], returned_at: Array, now: float) -> str:
    """The blind sectors in degrees, and since when; both arrays (90,) by sector."""
    if not is_blind.any():
        return ""
    start = int(is_blind.argmin())  # not blind, so that no blind run wraps around
    blind = np.roll(is_blind, -start)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], blind, [False])).astype(np.int8)))
    width = 360 // SECTORS
    names = [
        f"{(first + start) * width % 360}..{(end + start) * width % 360}"
        for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    ]
    since = now - float(returned_at[is_blind].max())
    return (
        f"rays {', '.join(names)} deg have not returned anything for {since:.0f} s while others"
        " did: they count as unknown; clean or uncover the sensor"
    )
