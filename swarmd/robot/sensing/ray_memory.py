"""The memory of each ray: interprets raw ranges, and fills unknown rays.

A zero of an LDS (the lidar of the TurtleBot3) means a near obstacle, no return or a lost packet.
The last returns of the ray and of its neighbours decide between these meanings.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import PI, TURN, angle_between, mod_turn, wrap
from swarmd.core.buffers import flags, indices, scratch, view_of, wrapped_index
from swarmd.core.cython_shadow import INFINITY, NAN, Doubles, Indices, fabs, isfinite, isnan, rint
from swarmd.core.ray_order import sort_rays

if TYPE_CHECKING:
    from swarmd.core.values import Array, ScanSpec

PACKET_RAYS = 6  # rays that an LDS loses together

_SMALL_ANGLE = 1e-9  # rad, of rounding
_MAX_UNEVENNESS = 0.2  # steps by which evenly spaced rays may be off
_MAX_TURN_ERROR = 0.5  # steps by which these may miss a full turn
_GUESSES = 3  # places from the hint on that are tried first
# The sensor is blind if so many far returns, and this share of the rays, all vanish from one scan
# to the next. Fewer may vanish, as those of a ring of few sensors.
_BLIND_RETURNS = 8.0
_BLIND_SHARE = 0.1
# Share of range_max up to which returns count as far returns; returns beyond it may vanish.
_FAR_SHARE = 0.8
# m above range_min: an LDS ray this near may turn into a zero.
_NEAR_MARGIN = 0.10
# s for which a near ray explains zeros.
_NEAR_MEMORY = 1.0
# rad beside a near ray in which zeros may mean near.
_NEAR_SECTOR = math.radians(3.0) + 1e-9
_PACKET_RAYS = PACKET_RAYS
# More zeros in a row may be an obstacle in the blind zone that hides far returns: a robot 7 cm wide
# hides 34 rays of a Burger, and three packets side by side are hardly ever lost at once.
_HIDING_RAYS = 2 * PACKET_RAYS
_HIDDEN_RANGE = 1.0  # m beyond which a return counts as far there


def _nearest_angle(rising: Doubles, n: int, wanted: float, hint: int) -> int:
    """The index of the angle nearest to `wanted` (rad), by binary search.

    `rising`: angles in [0, a full turn), of which the first `n` > 0 are in use and rise. `wanted`:
    rad, any angle. `hint`: an index at which the search begins, such as the last result.
    """
    angle = mod_turn(wanted)
    low = 0
    high = n

    # 1. Finds the first angle that is not below `wanted`: near the hint, else by halving.
    for middle in range(hint, min(hint + _GUESSES, n)):
        if rising[middle] >= angle and (middle == 0 or rising[middle - 1] < angle):
            low = middle
            high = middle
            break
    while low < high:
        middle = (low + high) // 2
        if rising[middle] < angle:
            low = middle + 1
        else:
            high = middle

    # 2. This angle or the angle before, whichever is nearer.
    after = low if low < n else 0
    before = after - 1 if after else n - 1
    if angle_between(rising[before], wanted) < angle_between(rising[after], wanted):
        return before
    return after


def _unwrapped(step: float) -> float:
    """A step between two angles in [-pi, pi], as numpy.unwrap: half a turn keeps its sign."""
    wrapped_step = wrap(step)
    return PI if wrapped_step == -PI and step > 0.0 else wrapped_step


_ZEROS = {"no_return": INFINITY, "too_close": -INFINITY, "unknown": NAN, "lds": NAN}


@cython.cclass
class RayMemory:
    """Interprets the ranges of a scan by the memory of each ray. Times in s, angles rad, ranges m.

    `known_at`: see `ScanConditioner`. `far_returns`: of the last scan with returns. `filled`: (n,)
    1 for each ray that the last scan did not measure, else 0; None without such a ray.
    """

    known_at: float
    far_returns: int
    filled: Array | None
    _range_min: float
    _range_max: float
    _max_gap: float
    _stale_after: float
    _zero: float  # the meaning of a range of 0
    _is_lds: bool
    _guesses_near: bool
    _near_below: float  # the range of a ray that may turn into a zero
    _step: float  # from one ray to the next
    _yaw: float  # of the robot, to which the memory is turned
    _given: Array | None  # the array of the bearings
    _ray_count: int
    _bearings: Doubles
    _direction: float  # 1.0 if bearings rise, -1.0 if they fall
    _is_even: bool  # rays cover a full turn, one each `_step`
    _order: Indices  # the rays by rising bearing, and the place of each ray in it
    _rising: Doubles
    _place: Indices
    # The memory by the place of a ray plus `_shift`: to turn the memory, only `_shift` changes.
    _ranges: Doubles  # the last known range; NaN before the first
    _seen_at: Doubles  # the time of this range; -inf before the first
    _near_at: Doubles  # the time of the last range below `_near_below`; -inf: none
    _shift: int
    _is_zero: Indices  # of the present scan: the raw range is 0
    _is_lost: Indices  # of the present scan: unknown, other than by a zero of an LDS

    def __init__(self, spec: ScanSpec, *, guesses_near: bool) -> None:
        self.known_at = -INFINITY
        self._range_min = spec.range_min
        self._range_max = spec.range_max
        self._max_gap = spec.max_gap + _SMALL_ANGLE
        self._stale_after = spec.stale_after
        self._zero = _ZEROS[spec.zero]
        self._is_lds = spec.zero == "lds"
        self._guesses_near = guesses_near
        self._near_below = spec.range_min + _NEAR_MARGIN
        self._step = TURN / max(len(spec.bearings), 1)
        self._yaw = NAN
        self._bearings = self._rising = self._ranges = self._seen_at = self._near_at = scratch(0)
        self._order = self._place = indices(0)
        self._is_zero = self._is_lost = flags(0)

    def condition(self, raw: Array, bearings: Array, yaw: float, now: float) -> Array | None:
        """The conditioned ranges (n,) of a scan; None if the scan is invalid.

        `raw`: (n,) m, the ranges of the driver. `bearings`: (n,) rad; the same object as before
        must have the same values. `yaw`: rad, of the robot; NaN: unknown. `now`: s.
        """
        ranges = np.array(raw, dtype=np.float64, order="C")
        return ranges if self.interpret(view_of(ranges), bearings, yaw, now) else None

    def interpret(self, ranges: Doubles, bearings: Array, yaw: float, now: float) -> bool:
        """Replace the raw `ranges` (n,) of a scan by conditioned ranges; False: invalid scan.

        A conditioned range is a distance, +inf (no return) or -inf (too close to measure).
        `bearings` (n,) and the robot's `yaw` in rad (NaN: unknown), `now` in s. Sets `known_at`.
        """
        if self._goes_blind(ranges):
            return False
        self._turn_memory(bearings, yaw)
        if self._interpret_ranges(ranges):
            self._interpret_zeros(ranges, now)
        unknown_count = self._remember(ranges, now)
        self.filled = np.isnan(np.asarray(ranges)).astype(np.float64) if unknown_count else None
        if 2 * unknown_count > len(ranges):  # fewer than half of the rays are known
            return False
        self.known_at = now
        if unknown_count == 0:
            return True
        self.known_at = self._lost_since(now)
        # Neighbours fill the rays that the memory leaves unknown. False: a sector is too wide.
        return self._fill_from_memory(ranges, now) == 0 or self._bridge_sectors(ranges)

    def _turn_memory(self, bearings: Array, yaw: float) -> None:
        """Turn the memory with the robot to `yaw` in rad, so that it stays with the surroundings.

        Takes over the `bearings` (n,) of the scan if they differ from those of the scan before.
        """
        turned = self._turn_of(yaw)
        is_same = bearings is self._given  # mostly the same object
        if not is_same and self._ray_count and np.array_equal(bearings, np.asarray(self._bearings)):
            self._given = bearings
            is_same = True
        if not is_same:
            self._set_bearings(bearings, turned)
        elif turned != 0.0 and self._is_even:
            # Even rays need only a shift of indices by whole steps, wrapped into [0, n).
            self._shift += cython.cast(cython.Py_ssize_t, rint(turned / self._step))
            if self._shift < 0:
                self._shift += self._ray_count
            elif self._shift >= self._ray_count:
                self._shift -= self._ray_count
        elif turned != 0.0:
            self._recall(self._rising, turned)

    def _fill_from_memory(self, ranges: Doubles, now: float) -> int:
        """Fill unknown rays with their last ranges, if not stale; the number still unknown."""
        unknown_count = 0
        for i in range(len(ranges)):
            if isnan(ranges[i]):
                index = self._index(i)
                if self._seen_at[index] >= now - self._stale_after:
                    ranges[i] = self._ranges[index]
                if isnan(ranges[i]):
                    unknown_count += 1
        return unknown_count

    def _remember(self, ranges: Doubles, now: float) -> int:
        """Store the known rays; the number of unknown rays, which keep their memory."""
        unknown_count = 0
        near_below = self._near_below
        known_ranges = self._ranges
        seen_at = self._seen_at
        is_zero = self._is_zero
        is_lost = self._is_lost
        for i in range(len(ranges)):
            distance = ranges[i]
            if isnan(distance):
                unknown_count += 1
                is_lost[i] = not (self._is_lds and is_zero[i])
                continue
            is_lost[i] = False
            index = self._index(i)
            known_ranges[index] = distance
            seen_at[index] = now
            # A zero does not count as near: else guesses would keep a ray near for ever.
            if distance < near_below and not is_zero[i]:
                self._near_at[index] = now
        return unknown_count

    def _index(self, ray: int) -> int:
        """The index of a ray in the memory."""
        return wrapped_index(self._place[ray] + self._shift, self._ray_count)

    def _goes_blind(self, raw: Doubles) -> bool:
        """Store the number of far returns; True: no return at all, after a scan with many of them.

        A scan without a return leaves the stored number. After many far returns the sensor is
        blind: a robot cannot reach an open field between two scans. An obstacle in the blind zone
        may hide all returns, but only after near returns.
        """
        far_count = 0
        has_return = False
        near_below = self._near_below
        range_max = self._range_max
        far_below = _FAR_SHARE * self._range_max
        for i in range(len(raw)):
            distance = raw[i]
            if (0.0 < distance <= range_max) or distance == -INFINITY:
                has_return = True
                if near_below < distance < far_below:
                    far_count += 1
        if has_return:
            self.far_returns = far_count
            return False
        min_far_count = max(_BLIND_SHARE * len(raw), _BLIND_RETURNS)
        return self.far_returns >= min_far_count

    def _turn_of(self, yaw: float) -> float:
        """The turn of the sensor in rad since the last call, rounded to whole rays.

        The remainder counts in the next call. 0 if a yaw is unknown.
        """
        turned = wrap(yaw - self._yaw)
        if not isfinite(turned):
            self._yaw = yaw
            return 0.0
        turned = self._step * rint(turned / self._step)
        self._yaw += turned
        return turned

    def _set_bearings(self, bearings: Array, turned: float) -> None:
        """Replace the bearings; each ray gets the memory of the nearest of the old rays.

        `turned` in rad: the turn of the sensor since the last scan. Sets the order of the rays,
        whether they are even (a ray at each `_step` of a full turn), and in which direction
        bearings change.
        """
        count = len(bearings)
        old_count = self._ray_count
        old_rising = self._rising
        values = np.array(bearings, dtype=np.float64, order="C")
        angles: Doubles = view_of(values % TURN)
        self._given = bearings
        self._ray_count = count
        self._direction = 1.0
        self._bearings = values.data
        self._rising = scratch(count)
        self._order = indices(count)
        self._place = indices(count)
        sort_rays(angles, count, self._rising, self._order)
        for i in range(count):
            self._place[self._order[i]] = i
        if count > 1:
            last_step = math.remainder(values[count - 1] - values[count - 2], TURN)
            self._direction = math.copysign(1.0, last_step)
        self._is_even = self._has_even_rays()
        self._is_zero = flags(count)
        self._is_lost = flags(count)
        if old_count:
            self._recall(old_rising, turned)
        else:
            self._set_empty_memory()

    def _has_even_rays(self) -> bool:
        """True if the rays cover a full turn, a ray at each `_step`."""
        count = self._ray_count
        step = self._step
        if not fabs(count * step - TURN) < _MAX_TURN_ERROR * step:
            return False
        for i in range(count):
            if fabs(self._rising[i] - self._rising[0] - i * step) > _MAX_UNEVENNESS * step:
                return False
        return True

    def _set_empty_memory(self) -> None:
        n = self._ray_count
        self._ranges = scratch(n)
        self._seen_at = scratch(n)
        self._near_at = scratch(n)
        for i in range(n):
            self._ranges[i] = NAN
            self._seen_at[i] = -INFINITY
            self._near_at[i] = -INFINITY

    def _recall(self, rising: Doubles, turned: float) -> None:
        """Give each ray the old memory of the ray that was nearest to it before the turn."""
        count = self._ray_count
        old_count = len(rising)
        ranges = self._ranges
        seen_at = self._seen_at
        near_at = self._near_at
        too_far = 2.0 * TURN / old_count
        place = 0
        self._set_empty_memory()
        for i in range(count):
            wanted = mod_turn(self._bearings[i] + turned)
            place = _nearest_angle(rising, old_count, wanted, place)
            is_far = angle_between(rising[place], wanted) > too_far
            source = wrapped_index(place + self._shift, old_count)
            target = self._place[i]
            self._ranges[target] = ranges[source]
            self._seen_at[target] = -INFINITY if is_far else seen_at[source]
            self._near_at[target] = -INFINITY if is_far else near_at[source]
        self._shift = 0

    def _interpret_ranges(self, out: Doubles) -> bool:
        """Each ray as +inf, -inf, NaN or a distance; true if zeros of an LDS are left."""
        range_min = self._range_min
        range_max = self._range_max
        is_zero = self._is_zero
        has_zeros = False
        for i in range(len(out)):
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

    def _interpret_zeros(self, out: Doubles, now: float) -> None:
        """The meaning of the zeros of an LDS that are left in `out`."""
        n = len(out)
        first = 0
        while first < n and out[first] == 0.0:
            first += 1
        begin = first
        end = first + n
        while begin < end:  # runs of zeros, the one around the end of the array last
            if first < n and out[wrapped_index(begin, n)] != 0.0:
                begin += 1
                continue
            run = 0
            while run < n and begin + run < end and out[wrapped_index(begin + run, n)] == 0.0:
                run += 1
            for k in range(begin, begin + run):
                i = wrapped_index(k, n)
                out[i] = self._meaning(i, run, now)
            begin += run

    def _meaning(self, ray: int, run: int, now: float) -> float:
        """The meaning of a zero in a run of `run` zeros: -inf near, +inf no return, NaN lost.

        The memory fills a lost ray. `ray`: the index of the ray. `now`: s.
        """
        at = self._index(ray)
        had_return = self._seen_at[at] >= now - self._stale_after and isfinite(self._ranges[at])
        # A short run over recent returns is a lost packet; a near obstacle hides more rays.
        is_packet = had_return and run <= _PACKET_RAYS
        if not is_packet and self._was_near(ray, now):
            return -INFINITY
        # A long run over far returns may be an obstacle in the blind zone. `HiddenObstacles`
        # (robot/protection/blind_zone.py) finds such an obstacle by rays without a return, and
        # would find none if the memory filled these rays.
        may_hide = run > _HIDING_RAYS and self._ranges[at] > _HIDDEN_RANGE
        if may_hide and not self._guesses_near:
            return INFINITY
        return NAN if had_return else INFINITY

    def _was_near(self, ray: int, now: float) -> bool:
        """True if a ray within _NEAR_SECTOR had a near return within the last _NEAR_MEMORY s."""
        if not self._guesses_near:
            return False
        since = now - _NEAR_MEMORY
        n = self._ray_count
        for direction in range(-1, 2, 2):
            for step in range(n):
                beside = self._order[(self._place[ray] + direction * step + n) % n]
                if angle_between(self._bearings[ray], self._bearings[beside]) > _NEAR_SECTOR:
                    break
                if self._near_at[self._index(beside)] >= since:
                    return True
        return False

    def _lost_since(self, now: float) -> float:
        """The latest time t such that the rays lost before t form no sector wider than `max_gap`.

        A ray is lost before t if it is unknown now and was last known before t.
        """
        if self._widest(INFINITY) <= self._max_gap:
            return now
        before = INFINITY
        while True:
            latest = -INFINITY
            for i in range(self._ray_count):
                if self._is_lost[i] and latest < self._seen_at[self._index(i)] < before:
                    latest = self._seen_at[self._index(i)]
            if latest == -INFINITY or self._widest(latest) <= self._max_gap:
                return latest
            before = latest

    def _widest(self, before: float) -> float:
        """The width in rad of the widest sector of rays that were lost before the time `before`.

        inf if all rays were lost before this time.
        """
        n = self._ray_count
        first = 0
        while first < n and self._is_lost[first] and self._seen_at[self._index(first)] < before:
            first += 1
        if first == n:
            return INFINITY
        widest = 0.0
        last = first
        for k in range(first + 1, first + n + 1):
            i = wrapped_index(k, n)
            if self._is_lost[i] and self._seen_at[self._index(i)] < before:
                continue
            if k - last > 1:
                step = self._bearings[wrapped_index(last, n)] - self._bearings[i]
                widest = max(widest, TURN - mod_turn(self._direction * step))
            last = k
        return widest

    def _bridge_sectors(self, ranges: Doubles) -> bool:
        """Fill each unknown sector up to `max_gap` wide with the smaller range at its two edges.

        `ranges` (n,) has NaN for unknown rays. False if a wider sector is left unknown.
        """
        count = len(ranges)
        first = 0
        while first < count and isnan(ranges[first]):
            first += 1
        if first == count:
            return False
        # The last known ray: its index, angle and range. Angles are unwrapped: they rise or fall
        # over the whole turn. The sum of a bearing and `unwrap_shift` is an unwrapped angle.
        last = first
        first_angle = self._bearings[first]
        last_angle = first_angle
        last_range = ranges[first]
        angle = first_angle
        unwrap_shift = 0.0
        is_filled = True

        # Each known ray ends the unknown rays behind the last known ray.
        for k in range(first + 1, first + count):
            i = wrapped_index(k, count)
            step = self._bearings[i] - self._bearings[wrapped_index(k - 1, count)]
            if fabs(step) >= PI:
                unwrap_shift += _unwrapped(step) - step
            angle = self._bearings[i] + unwrap_shift
            if isnan(ranges[i]):
                continue
            if k - last > 1 and not self._fill_between(
                ranges, last, k, last_angle, angle, last_range, ranges[i]
            ):
                is_filled = False
            last = k
            last_angle = angle
            last_range = ranges[i]

        # The sector between the last known ray and the first known ray, a turn later.
        if last < first + count - 1:
            end_angle = first_angle + math.copysign(TURN, angle - first_angle)
            if not self._fill_between(
                ranges, last, first + count, last_angle, end_angle, last_range, ranges[first]
            ):
                is_filled = False
        return is_filled

    def _fill_between(
        self,
        ranges: Doubles,
        last: int,
        next_known: int,
        last_angle: float,
        next_angle: float,
        last_range: float,
        next_range: float,
    ) -> bool:
        """Fill the rays between two known rays with the smaller of the two known ranges.

        False, and no ray is filled, if the angles of the known rays differ by more than `max_gap`.

        Args:
            ranges: (n,) m, the ranges of the scan; indices beyond n wrap around.
            last, next_known: the indices of the two known rays.
            last_angle, next_angle: rad, the angles of these rays.
            last_range, next_range: m, the ranges of these rays.
        """
        if not fabs(next_angle - last_angle) <= self._max_gap:  # true also for NaN
            return False
        for k in range(last + 1, next_known):
            ranges[wrapped_index(k, len(ranges))] = min(last_range, next_range)
        return True
