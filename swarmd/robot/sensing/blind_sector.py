"""Blind sectors: rays of a range sensor that show open space, or old ranges, in place of obstacles.

A covered or broken part of a sensor looks like open space. A sector of the sensor is blind if

- MISSED: its rays have missed static objects in many directions, without any return meanwhile.
  While the robot turns, different rays pass over the same object. If other rays return the object
  before and after, a ray without a return has missed it.
- LOST: its rays lose all returns from one scan to the next, and these returns were of a longer
  surface than any object that leaves between two scans.
- BLOCKED: its rays return nothing, and the base does not move into their direction although it is
  commanded to.
- FROZEN: its ranges stay equal while the robot moves, although static objects would have changed
  them, and although the ranges of other sectors change as those of static objects.

Why there are no false alarms: in an open field, at a door and at a surface that reflects no ray,
the other rays have no return either (MISSED), and the returns end one after the other (LOST). An
object that moves is not the same before and after (MISSED), and is shorter than 1 m (LOST,
FROZEN). The range of a wall beside the robot stays equal, as that of a static object does (FROZEN).

Three scans in a row with a return end a blind sector. A frozen sector needs other returns than the
frozen ones. A new run ends BLOCKED, since a base that is stuck in the open looks the same.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import TURN
from swarmd.core.buffers import checked, checked_indices, flags, indices, scratch, view_of
from swarmd.core.cython_shadow import (
    INFINITY,
    NAN,
    Doubles,
    Indices,
    fabs,
    floor,
    hypot,
    isnan,
    remainder,
    rint,
)
from swarmd.core.values import Array, Odometry, ScanSpec
from swarmd.robot.sensing.sector_history import (
    EQUAL,
    LEAST_SECTORS,
    SECTORS,
    frozen_sectors,
    lost_sectors,
)

if TYPE_CHECKING:
    from swarmd.core.values import Pose

# Sectors of 4 degrees, of the sensor and of the directions around it.
_SECTORS = SECTORS
_COMPARE_PERIOD = 0.95  # s between two looks, at least
# Directions, each a sector wide, in which a blind sector must have missed an object.
_MIN_MISSED = 8
_MAX_TIME = 15.0  # s after which a seen object is forgotten
# Share of the range by which the robot may move, since motion changes directions to objects.
_MAX_MOTION = 0.25
# An object is the same if its range changes by at most this share of the range plus so many m.
_SAME_SHARE = 0.25
_SAME_M = 0.1
# Looks (comparisons of a scan) in a row that see a static object, before and after a ray misses it.
_STREAK = 3
# Scans in a row with a return, after which a blind sector is trusted again.
_CLEARING_SCANS = 3

# Why a sector is blind.
_MISSED = 1
_LOST = 2
_BLOCKED = 3
_FROZEN = 4
_REASONS = {
    1: "have not returned anything for {since:.0f} s while others did",
    2: "have lost their returns at once",
    3: "return nothing, and the base does not move into their direction",
    4: "return equal ranges while the robot moves and others change",
}
_least_sectors = LEAST_SECTORS
# Share of range_max within which a surface certainly returns something again.
_SURE_SHARE = 0.8
_OTHERS_SPEED = 0.5  # m/s at which an edge of a surface may move
_LOOK_WAY = 0.3  # m between two looks for frozen sectors
_LOOK_TURN = 0.5  # rad, the same
_STEADY_TURN = 0.1  # rad in a scan: its rays fit one pose
_BLOCKED_WIDTH = 2  # sectors without a return on each side of the direction of the command
_SILENCE = 2.0  # s without a return in these sectors
_BLOCKED_REACH = SECTORS // 4  # sectors on each side that are blind then
# m beyond `range_min`: beside silent sectors, a surface so near goes on into the blind zone.
_BESIDE_NEAR = 0.05


@cython.cclass
class BlindSectors:
    """Finds the blind sectors of one sensor. Times in s, poses in the odometry frame.

    `text` names the blind sectors; empty without one. `kinds`: (90,) by sector, why it is blind; 0:
    it is not.
    """

    text: str
    kinds: NDArray[np.uint8]
    _is_used: bool
    _compared_at: float
    _compared_yaw: float
    _spec: ScanSpec
    _range_min: float
    _range_max: float
    _is_zero_near: bool
    _bearings_of_scan: Array | None
    _bearings: Doubles
    _sector: Indices  # of each ray
    _direction: Indices
    _is_return: Indices
    _kind: Indices  # of `kinds`
    _returned_array: Array  # the array of `_returned_at`
    _returned_at: Doubles  # by sector
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
    # By sector: whether it has rays; arrays of the mean ranges of its returns (NaN: none) in this
    # scan, in the scan before, and in the last look for frozen sectors; the frozen range.
    _has_rays: NDArray[np.bool_]
    _means: Array
    _mean: Doubles  # of `_means`
    _mean_before: cython.double[90]
    _look_means: Array
    _frozen: Array
    # The poses of the robot at the scan before and at the last look; None before the first.
    _scan_pose: Pose | None
    _look_pose: Pose | None
    _scan_at: float  # s, time of the scan before

    def __init__(self, spec: ScanSpec) -> None:
        self._spec = spec
        self._is_used = len(spec.bearings) >= _SECTORS
        self.text = ""
        self._compared_at = -INFINITY
        self._compared_yaw = NAN
        self._range_min = spec.range_min
        self._range_max = spec.range_max
        self._is_zero_near = spec.zero == "too_close"
        self.kinds = np.zeros(_SECTORS, np.uint8)
        self._kind = self.kinds.data
        self._means = np.full(_SECTORS, NAN)
        self._mean = self._means.data
        self._look_means = np.full(_SECTORS, NAN)
        self._frozen = np.full(_SECTORS, NAN)
        self._has_rays = np.zeros(_SECTORS, np.bool_)
        self._returned_array = np.full(_SECTORS, NAN)
        self._returned_at = self._returned_array.data
        for k in range(_SECTORS):
            self._seen_at[k] = -INFINITY
        self._bearings = scratch(0)
        self._sector = self._direction = indices(0)
        self._is_return = flags(0)

    def check_indices(self) -> None:
        """ValueError unless each ray is in one of the sectors, for a serialised robot."""
        for i in range(len(self._sector)):
            if not 0 <= self._sector[i] < _SECTORS:
                raise ValueError(f"ray {i} is in sector {self._sector[i]} of {_SECTORS}")

    def take(self, ranges: Array, bearings: Array, odometry: Odometry | None, now: float) -> Array:
        """The raw ranges (n,) of a scan, with NaN for rays of blind sectors without a return."""
        known = np.array(ranges, np.float64)
        self.mark(view_of(known), bearings, odometry, now)
        return known

    def mark(self, given: Doubles, bearings: Array, odometry: Odometry | None, now: float) -> None:
        """Set NaN for rays of blind sectors without a return."""
        if not self._is_used:
            return
        if bearings is not self._bearings_of_scan:
            self._set_bearings(bearings)
        self._find_returns(given)
        has_changed = self._count_returns(now)
        if odometry is not None:
            if self._scan_pose is None:
                self._keep_scan(odometry.pose, now)
                self._look_pose = odometry.pose
            if self._look_from(given, odometry.pose, now):
                has_changed = True
        if has_changed:
            self.text = blind_text(self.kinds, self._returned_array, now)
        if not self.text:
            return
        for i in range(len(given)):
            kind = self._kind[self._sector[i]]
            if kind and (kind == _FROZEN or not self._is_return[i]):
                given[i] = NAN

    def _keep_scan(self, pose: Pose, now: float) -> None:
        """Keep the scan for the next: pose, time, and means at which a return is certain."""
        for k in range(_SECTORS):
            is_sure = self._mean[k] <= _SURE_SHARE * self._range_max
            self._mean_before[k] = self._mean[k] if is_sure else NAN
        self._scan_pose = pose
        self._scan_at = now

    def _look_from(self, ranges: Doubles, pose: Pose, now: float) -> bool:
        """Look for blind sectors in a scan from a pose of the robot; true if one is new."""
        before = self._scan_pose or pose
        look = self._look_pose or pose
        yaw = pose.yaw
        turned = remainder(yaw - before.yaw, TURN)
        is_new = False
        # 1. Sectors that have lost their returns: mostly too few for a look.
        if not isnan(turned) and self._count_gone(turned) >= _least_sectors:
            motion = hypot(pose.x - before.x, pose.y - before.y)
            motion += _OTHERS_SPEED * (now - self._scan_at)
            shown = np.array([self._mean_before[k] for k in range(_SECTORS)])
            lost = lost_sectors(self._means, shown, turned, motion, self._range_min)
            is_new = self._mark(lost & self._has_rays, _LOST)
        self._keep_scan(pose, now)
        # 2. Sectors that have frozen since the last look.
        way = hypot(pose.x - look.x, pose.y - look.y)
        has_turned = fabs(remainder(yaw - look.yaw, TURN)) >= _LOOK_TURN
        if fabs(turned) <= _STEADY_TURN and (way >= _LOOK_WAY or has_turned):
            if way < self._range_max:
                frozen = frozen_sectors(self._means, self._look_means, pose, look)
                is_new = self._mark(frozen, _FROZEN) or is_new
            self._look_means[:] = self._means
            self._look_pose = pose
        # 3. Sectors that miss what others return. This counts `_hits` and `_sums` by direction.
        if self._is_due(yaw, now) and self._compare_scan(ranges, pose.x, pose.y, yaw, now):
            is_new = True
        return is_new

    def _count_gone(self, turned: float) -> int:
        """How many sectors return nothing, of those that `lost_sectors` may find.

        The scan before showed something in the direction of such a sector, and on both sides of it.
        While a robot turns among others, most sectors without a return are edges of a surface.
        `turned`: rad since the scan before.
        """
        count = 0
        shift = cython.cast(cython.Py_ssize_t, rint(turned / (TURN / _SECTORS)))
        for k in range(_SECTORS):
            if not isnan(self._mean[k]):
                continue
            place = k + shift + _SECTORS
            is_shown = not (
                isnan(self._mean_before[(place - 1) % _SECTORS])
                or isnan(self._mean_before[place % _SECTORS])
                or isnan(self._mean_before[(place + 1) % _SECTORS])
            )
            count += is_shown
        return count

    def _mark(self, is_blind: NDArray[np.bool_], kind: int) -> bool:
        """Mark sectors (90,) as blind, except those that are so already; true if any is new."""
        is_new = is_blind & (self.kinds == 0)
        self.kinds[is_new] = kind
        self._frozen[is_new] = self._means[is_new]
        return bool(is_new.any())

    def on_blocked(self, bearing: float, now: float) -> None:
        """Doubt the sectors without a return in a direction into which the base does not move.

        `bearing`: rad, of the command that the base does not follow. Nothing changes if a ray in
        this direction had a return in the last _SILENCE s, since a pusher may have come into the
        blind zone, or if a surface beside the silent sectors goes on into the blind zone, as that
        of a box that the robot pushes: protection sees it beside. Nor does anything change if
        hardly a ray of the sensor has a return: a base that is stuck in the open says nothing of
        its sensor. Else all sectors within a quarter of a turn that return nothing are blind.
        """
        if np.isnan(self._means).sum() > SECTORS - LEAST_SECTORS:
            return
        beside = np.arange(-_BLOCKED_REACH, _BLOCKED_REACH + 1)
        sectors = (_sector_of(bearing) + beside) % SECTORS
        around = self._means[sectors]
        right, left = (one[~np.isnan(one)] for one in np.split(around, [_BLOCKED_REACH]))
        nearest_beside = min((*np.flip(right)[:1], *left[:1]), default=INFINITY)
        if nearest_beside <= self._range_min + _BESIDE_NEAR:
            return
        is_silent = self._returned_array <= now - _SILENCE
        is_empty = (np.isnan(self._means) & self._has_rays & is_silent)[sectors]
        doubted = np.zeros(SECTORS, np.bool_)
        doubted[sectors] = is_empty & is_empty[np.abs(beside) <= _BLOCKED_WIDTH].all()
        if self._mark(doubted, _BLOCKED):
            self.text = blind_text(self.kinds, self._returned_array, now)

    def on_new_run(self, now: float) -> None:
        """End what `on_blocked` doubts: whoever starts a run has freed the base."""
        self.kinds[self.kinds == _BLOCKED] = 0
        self.text = blind_text(self.kinds, self._returned_array, now)

    def restore(self, kinds: NDArray[np.uint8], now: float) -> None:
        """Take over earlier `kinds`, and forget the scan before and the last look."""
        self.kinds[:] = kinds
        self._look_means[:] = NAN
        self._scan_pose = None
        self.text = blind_text(self.kinds, self._returned_array, now)

    def forget_motion(self) -> None:
        """Forget what is compared by the motion of the robot, as when odometry was reset.

        Two scans have no common frame then. Sectors that are blind stay so: they were found by
        earlier motion.
        """
        self._look_means[:] = NAN
        self._scan_pose = None
        self._look_pose = None
        self._compared_yaw = NAN
        for k in range(_SECTORS):
            self._seen_at[k] = -INFINITY
            self._range[k] = 0.0
            self._streak[k] = 0
        for k in range(_SECTORS * _SECTORS):
            self._pending[k] = False
            self._missed[k] = False

    def _set_bearings(self, bearings: Array) -> None:
        """Set the sector of each ray, and which sectors have rays that are not masked."""
        n = len(bearings)
        self._bearings_of_scan = bearings
        self._bearings = view_of(bearings)
        self._sector = indices(n)
        self._direction = indices(n)
        self._is_return = flags(n)
        for i in range(n):
            self._sector[i] = _sector_of(self._bearings[i])
        free = np.asarray(self._sector)[~self._spec.masked(bearings)]
        self._has_rays[:] = np.bincount(free, minlength=_SECTORS) > 0

    def _find_returns(self, ranges: Doubles) -> None:
        """Set which rays are returns; by sector of the sensor, `_hits` and `_mean` of the returns.

        A return that is too close to measure counts as one at `range_min`.
        """
        count = len(ranges)
        given = checked(ranges, count)
        sector = checked_indices(self._sector, count)
        for k in range(_SECTORS):
            self._hits[k] = 0
            self._sums[k] = 0.0
        for i in range(count):
            distance = given[i]
            is_return = (0.0 < distance <= self._range_max) or distance == -INFINITY
            is_return = is_return or (self._is_zero_near and distance == 0.0)
            self._is_return[i] = is_return
            if is_return:
                k = sector[i]
                self._hits[k] += 1
                self._sums[k] += max(distance, self._range_min)
        for k in range(_SECTORS):
            self._mean[k] = self._sums[k] / self._hits[k] if self._hits[k] else NAN

    def _count_returns(self, now: float) -> bool:
        """Count scans in a row with a return in each sector; true if a sector is blind no more.

        The ranges in which a sector is frozen are no returns.
        """
        has_cleared = False
        for k in range(_SECTORS):
            has_return = self._hits[k] > 0
            if self._kind[k] == _FROZEN and fabs(self._mean[k] - self._frozen[k]) <= EQUAL:
                has_return = False
            self._return_streak[k] = self._return_streak[k] + 1 if has_return else 0
            if has_return or isnan(self._returned_at[k]):
                self._returned_at[k] = now
            if self._kind[k] and self._return_streak[k] >= _CLEARING_SCANS:
                self._kind[k] = 0
                has_cleared = True
        return has_cleared

    def _is_due(self, yaw: float, now: float) -> bool:
        """Begin a comparison if the robot has turned by a sector since the last; True if begun."""
        turned = fabs(remainder(yaw - self._compared_yaw, TURN))
        if now - self._compared_at < _COMPARE_PERIOD or turned < TURN / _SECTORS:
            return False
        self._compared_at = now
        self._compared_yaw = yaw
        return True

    def _compare_scan(self, ranges: Doubles, x: float, y: float, yaw: float, now: float) -> bool:
        """Compare what each sector of the sensor returns with what other sectors returned there.

        True if a further sector is blind now. `x`, `y`, `yaw` are the pose of the robot.
        """
        doubts = 0  # 0: no sector waits, and none has missed an object, as mostly
        for d in range(_SECTORS * _SECTORS):
            doubts |= self._pending[d] | self._missed[d]
        self._sum_by_direction(ranges, yaw)
        for d in range(_SECTORS):
            self._is_known[d] = now - self._seen_at[d] <= _MAX_TIME and (
                hypot(x - self._x[d], y - self._y[d]) <= _MAX_MOTION * self._range[d]
            )
            self._compare_direction(d, x, y, now, doubts)
        self._await_confirmation()
        return self._judge_sectors() if doubts else False

    def _sum_by_direction(self, ranges: Doubles, yaw: float) -> None:
        """Set rays, hits and the sum of ranges in each direction of the odometry frame."""
        for d in range(_SECTORS):
            self._rays[d] = 0
            self._hits[d] = 0
            self._sums[d] = 0.0
        for i in range(len(ranges)):
            d = self._direction[i] = _sector_of(self._bearings[i] + yaw)
            self._rays[d] += 1
            if self._is_return[i]:
                self._hits[d] += 1
                self._sums[d] += max(ranges[i], self._range_min)

    def _compare_direction(self, d: int, x: float, y: float, now: float, doubts: int) -> None:
        """Compare the returns in the direction `d` (an index) with the object last seen there.

        An object is seen if all rays in the direction have a return. An object is static once
        _STREAK comparisons in a row have seen it. Then the object is known (`_is_known`) for
        _MAX_TIME, as long as the robot stays near. A sector of the sensor that misses a known
        object waits (`_pending`) until the object proves to be static again. Then the miss counts
        against the sector (`_missed`).

        `x`, `y`: m, the place of the robot. `now`: s. `doubts`: 0 if no sector waits or has missed.
        """

        # 1. Is an object seen in the direction, and is it the object that was seen last?
        distance = self._sums[d] / max(self._hits[d], 1)
        is_seen = 0 < self._rays[d] == self._hits[d]  # has rays, and all return
        is_same = is_seen and (
            fabs(distance - self._range[d]) <= _SAME_M + _SAME_SHARE * self._range[d]
        )
        is_new = is_seen and not is_same
        # The number of comparisons in a row that saw this object.
        if is_same:
            self._streak[d] += 1
        else:
            self._streak[d] = 1 if is_new else 0
        has_streak = self._streak[d] >= _STREAK

        # 2. The wait of sectors ends: with a miss if the known object has proved to be static
        # again, without a miss if the object is a new object, or is no longer known.
        is_static = self._is_known[d] != 0 and has_streak
        is_decided = is_static or is_new or not self._is_known[d]
        for k in range(_SECTORS if doubts else 0):
            if self._return_streak[k]:  # a sector that has returns now is not blind
                self._pending[_SECTORS * d + k] = False
                self._missed[_SECTORS * k + d] = False
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
            self._x[d] = x
            self._y[d] = y

    def _await_confirmation(self) -> None:
        """Mark sectors that miss a known object: this counts once the object is seen again."""
        for i in range(len(self._sector)):
            d = self._direction[i]
            k = self._sector[i]
            if self._is_known[d] and not self._hits[d] and not self._return_streak[k]:
                self._pending[_SECTORS * d + k] = True

    def _judge_sectors(self) -> bool:
        """Sectors that have missed things in many directions are blind; true if one is new."""
        is_new = False
        for k in range(_SECTORS):
            count = 0
            for d in range(_SECTORS):
                count += self._missed[_SECTORS * k + d]
            if count >= _MIN_MISSED and not self._kind[k]:
                self._kind[k] = _MISSED
                is_new = True
        return is_new


def _sector_of(angle: float) -> int:
    """The sector of an angle, from 0 to 89."""
    sector = cython.cast(cython.longlong, floor(angle * (1.0 / (TURN / _SECTORS)) + 1e-6))
    sector %= _SECTORS
    return sector + _SECTORS if sector < 0 else sector


def blind_text(kinds: NDArray[np.uint8], returned_at: Array, now: float) -> str:
    """The blind sectors in degrees, and why each is blind; both arrays (90,) by sector."""
    parts = []
    for kind, reason in _REASONS.items():
        is_blind = kinds == kind
        if is_blind.any():
            since = now - float(returned_at[is_blind].max())
            parts.append(f"rays {_degrees(is_blind)} deg {reason.format(since=since)}")
    if not parts:
        return ""
    return f"{'; '.join(parts)}: they count as unknown; clean or uncover the sensor"


def _degrees(is_blind: NDArray[np.bool_]) -> str:
    """The runs of blind sectors, such as `24..28, 336..16`."""
    start = int(is_blind.argmin())  # not blind, so that no blind run wraps around
    blind = np.roll(is_blind, -start)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], blind, [False])).astype(np.int8)))
    width = 360 // SECTORS
    names = [
        f"{(first + start) * width % 360}..{(end + start) * width % 360}"
        for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    ]
    return ", ".join(names)
