"""Mode `barrier` in C: what barrier.py computes with numpy, number by number, for one robot.

barrier.py, constraints.py, projection.py, stopping.py and dead_reckoning.py say why; this file has
the same operations in the same order. A NaN counts as numpy counts it, as the greatest and as the
smallest number, so that a constraint that is not known forbids motion.
"""

import cython

if not cython.compiled:
    raise ImportError("swarmd.protection.barrier_kernel is not compiled")

import math
from array import array

from cython.cimports.libc.math import atan2, copysign, cos, fabs, hypot, remainder, sin, sqrt

from swarmd.core.clock import TICK
from swarmd.core.values import MAX_SPEED, MAX_STEP
from swarmd.protection.barrier import AGE_TOLERANCE
from swarmd.protection.compiled_barrier import LIMITS, PASSES, REPEATS, STOPS
from swarmd.protection.constraints import (
    AT_AXLE,
    CREEP_GAIN,
    CREEP_SPEED,
    ENVELOPE_DIRECTIONS,
    MAX_REPORTED,
    MIN_BRAKING,
    SIDE_ANGLE,
    SLOW_REQUEST,
)
from swarmd.protection.dead_reckoning import REACTION_TIME
from swarmd.protection.projection import BINDING_TOLERANCE, TOLERANCE
from swarmd.protection.stopping import FAULT_SPEED, NEGLIGIBLE_SPEED, ROUNDING, SPEED_SHARES
from swarmd.sensing.odometry_history import HISTORY, MAX_EXTRAPOLATION

_tick = cython.declare(cython.double, TICK)
_creep = cython.declare(cython.double, CREEP_SPEED)
_creep_gain = cython.declare(cython.double, CREEP_GAIN)
_slow = cython.declare(cython.double, SLOW_REQUEST)
_min_braking = cython.declare(cython.double, MIN_BRAKING)
_side_cos = cython.declare(cython.double)
_side_sin = cython.declare(cython.double)
_side_cos, _side_sin = cos(SIDE_ANGLE), sin(SIDE_ANGLE)
_max_extrapolation = cython.declare(cython.double, MAX_EXTRAPOLATION)
_max_step = cython.declare(cython.double, MAX_STEP)
_max_speed = cython.declare(cython.double, MAX_SPEED)
_reaction = cython.declare(cython.double, REACTION_TIME)
_fault = cython.declare(cython.double, FAULT_SPEED)
_negligible = cython.declare(cython.double, NEGLIGIBLE_SPEED)
_tolerance = cython.declare(cython.double, TOLERANCE)
_binding = cython.declare(cython.double, BINDING_TOLERANCE)
_history = cython.declare(cython.Py_ssize_t, HISTORY)
_reported = cython.declare(cython.Py_ssize_t, MAX_REPORTED)
_at_axle = cython.declare(cython.double, AT_AXLE)
_inf = cython.declare(cython.double, float("inf"))
_pi = cython.declare(cython.double, math.pi)
_age_tolerance = cython.declare(cython.double, AGE_TOLERANCE)
_slack = cython.declare(cython.double, 1e-6)  # far beyond BINDING_TOLERANCE
_rounding = cython.declare(cython.double, ROUNDING)
_passes = cython.declare(cython.int, PASSES)
_limits = cython.declare(cython.int, LIMITS)
_repeats = cython.declare(cython.int, REPEATS)
_stops = cython.declare(cython.int, STOPS)


def _doubles(count):
    """A buffer of `count` doubles, all 0."""
    return array("d", bytes(8 * count))


def _indices(count):
    """A buffer of `count` indices, all 0."""
    return array("q", bytes(8 * count))


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _maximum(a: cython.double, b: cython.double) -> cython.double:
    """The greater; NaN if one is."""
    return a if a > b or a != a else b


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _sign(a: cython.double) -> cython.double:
    return 1.0 if a > 0.0 else (-1.0 if a < 0.0 else 0.0)


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _same(a: cython.double, b: cython.double) -> cython.bint:
    """True if they are equal, or both NaN."""
    return a == b or (a != a and b != b)


@cython.cfunc
@cython.exceptval(check=False)
def _mean(
    now: cython.double, wanted: cython.double, rate: cython.double, seconds: cython.double
) -> cython.double:
    """The mean speed over `seconds` on a ramp of `rate` from `now` to `wanted`."""
    change: cython.double = wanted - now
    ramp: cython.double = fabs(change) / rate
    if ramp >= seconds:
        return now + copysign(0.5 * rate * seconds, change)
    return now + change * (1.0 - 0.5 * ramp / seconds)


@cython.final
@cython.cclass
class BarrierKernel:
    """The near obstacles of the last scan, dead reckoning, and the decision on a command."""

    # The settings and what follows from them.
    _others: cython.double
    _unseen_extent: cython.double
    _margin: cython.double
    _braking_linear: cython.double
    _braking_angular: cython.double
    _surface_speed: cython.double
    _is_passive: cython.bint
    _keep_out: cython.double  # NaN: no circle
    _angular_limit: cython.double
    _offset_x: cython.double
    _offset_y: cython.double
    _radius: cython.double
    _inner: cython.double
    _outer: cython.double
    _blind: cython.double
    _fresh: cython.double
    _fastest: cython.double
    _within: cython.double
    _stale: cython.double
    _side_reserve: cython.double
    _may_creep: cython.bint
    # The outline: corners, and for each edge its direction, normal and their origins.
    _edges: cython.Py_ssize_t
    _corner_x: cython.double[::1]
    _corner_y: cython.double[::1]
    _axis_x: cython.double[::1]
    _axis_y: cython.double[::1]
    _origin: cython.double[::1]
    _length: cython.double[::1]
    # The separation found last.
    _gap_found: cython.double
    _nx: cython.double
    _ny: cython.double
    _lever: cython.double
    # Readings of odometry, seven numbers each, the last at `_last`.
    _readings: cython.double[::1]
    _last: cython.Py_ssize_t
    _known: cython.Py_ssize_t
    _version: cython.Py_ssize_t
    _resets: cython.Py_ssize_t
    # The pose found last, and that of the last scan; of the motion between two scans.
    _pose_x: cython.double
    _pose_y: cython.double
    _pose_yaw: cython.double
    _taken_x: cython.double
    _taken_y: cython.double
    _taken_yaw: cython.double
    _taken: cython.double
    _lag: cython.double
    _oldest: cython.double
    _late: cython.double
    _scan_resets: cython.Py_ssize_t
    moved_x = cython.declare(cython.double, visibility="readonly")
    moved_y = cython.declare(cython.double, visibility="readonly")
    moved_yaw = cython.declare(cython.double, visibility="readonly")
    seconds = cython.declare(cython.double, visibility="readonly")
    # The rays, and the near obstacles of the last scan: contacts first, then by rising gaps.
    _directions: cython.double[:, ::1]
    _points: cython.Py_ssize_t
    _contacts: cython.Py_ssize_t
    _is_near: cython.bint
    _x: cython.double[::1]
    _y: cython.double[::1]
    _gap: cython.double[::1]
    _age: cython.double[::1]
    _ray_x: cython.double[::1]
    _ray_y: cython.double[::1]
    _ray_age: cython.double[::1]
    _found_x: cython.double[::1]
    _found_y: cython.double[::1]
    _found_gap: cython.double[::1]
    _found_age: cython.double[::1]
    _order: cython.longlong[::1]
    _spare: cython.longlong[::1]
    # Obstacles that the robot is told of: rows of x, y, radius, age; the first `_discs` may bind.
    _told: cython.double[:, ::1]
    _discs: cython.Py_ssize_t
    _disc: cython.longlong[::1]
    # The touch zone: direction, cosine of its half width, speed, and rows of nx, ny, x, y.
    _has_touch: cython.bint
    _touch_bearing: cython.double
    _touch_half: cython.double
    _touch_speed: cython.double
    _touch_x: cython.double
    _touch_y: cython.double
    _touch_cos: cython.double
    _touch_table: cython.double[:, ::1]
    # The situation of the feasible set.
    _has_situation: cython.bint
    _now: cython.double
    _scan_age: cython.double
    _odometry_age: cython.double
    _at_version: cython.Py_ssize_t
    _along_x: cython.double
    _along_y: cython.double
    _limit: cython.double
    _at_touch: cython.bint
    _at_bearing: cython.double
    _at_half: cython.double
    _at_speed: cython.double
    # The feasible set: placed points, `_count` seen and then `_discs` told ones, and rows: of seen
    # points, then of told ones, and of the envelope.
    _free: cython.double
    _count: cython.Py_ssize_t
    _rows: cython.Py_ssize_t
    _all: cython.Py_ssize_t
    _placed_x: cython.double[::1]
    _placed_y: cython.double[::1]
    _placed_gap: cython.double[::1]
    _placed_free: cython.double[::1]
    _placed_age: cython.double[::1]
    _placed_contact: cython.double[::1]
    _radius_of: cython.double[::1]
    _first_row: cython.longlong[::1]
    _normal_x: cython.double[::1]
    _normal_y: cython.double[::1]
    _near: cython.longlong[::1]
    _inside: cython.longlong[::1]
    _row_x: cython.double[::1]
    _row_y: cython.double[::1]
    _row_cap: cython.double[::1]
    _row_gap: cython.double[::1]
    _kept_cap: cython.double[::1]
    # The cap of a robot that creeps in m/s; 0 where it must not.
    _creep_cap: cython.double
    _is_creeping: cython.bint
    _source: cython.longlong[::1]
    # Two envelopes: while creeping and else.
    _envelope_x: cython.double[:, ::1]
    _envelope_y: cython.double[:, ::1]
    _envelope_cap: cython.double[:, ::1]
    _envelope_along_x: cython.double[2]
    _envelope_along_y: cython.double[2]
    _way_x: cython.double[::1]
    _way_y: cython.double[::1]
    # The polygon of a projection, and the one clipped from it.
    _sides: cython.Py_ssize_t
    _poly_x: cython.double[::1]
    _poly_y: cython.double[::1]
    _clip_x: cython.double[::1]
    _clip_y: cython.double[::1]
    _point_x: cython.double
    _point_y: cython.double
    # The stop check: poses of a simulated stop, of which the first `_poses` count.
    _stop_x: cython.double[4]
    _stop_y: cython.double[4]
    _stop_cos: cython.double[4]
    _stop_sin: cython.double[4]
    _stop_way: cython.double[4]
    _stop_v: cython.double[4]
    _stop_w: cython.double[4]
    _poses: cython.Py_ssize_t
    _shares: cython.double[:, ::1]
    _forbidding: cython.Py_ssize_t
    _beside: cython.Py_ssize_t
    # The last request and its result.
    _is_decided: cython.bint
    _is_limited: cython.bint
    _asked_speed: cython.double
    _asked_angular: cython.double
    linear = cython.declare(cython.double, visibility="readonly")
    angular = cython.declare(cython.double, visibility="readonly")
    min_gap = cython.declare(object, visibility="readonly")

    def __init__(self, settings, outline, derived):
        self._others = settings.others_speed
        self._unseen_extent = settings.unseen_extent
        self._margin = settings.margin
        self._braking_linear = settings.braking_linear
        self._braking_angular = settings.braking_angular
        self._is_passive = settings.responsibility == "passive"
        self._keep_out = float("nan") if settings.keep_out is None else settings.keep_out
        self._surface_speed = derived.surface_speed
        self._angular_limit = derived.angular
        self._offset_x, self._offset_y = derived.offset
        self._radius, self._blind = derived.radius, derived.blind
        self._inner, self._outer = outline.circles(derived.offset)
        self._fresh, self._fastest = derived.fresh, derived.fastest
        self._within, self._stale = derived.within, derived.stale
        self._side_reserve, self._may_creep = derived.side_reserve, derived.may_creep
        self._edges = len(outline.corners)
        self._corner_x = array("d", outline.corners[:, 0].tolist())
        self._corner_y = array("d", outline.corners[:, 1].tolist())
        self._axis_x = array("d", outline.axes[:, 0].tolist())
        self._axis_y = array("d", outline.axes[:, 1].tolist())
        self._origin = array("d", outline.origins.tolist())
        self._length = array("d", outline.lengths.tolist())
        self._readings = _doubles(7 * HISTORY)
        self._taken = -_inf
        self._directions = ENVELOPE_DIRECTIONS[:0]
        self._reserve_points(64)
        self._reserve_placed(64)
        self._told, self._disc = ENVELOPE_DIRECTIONS[:0], _indices(8)
        self._ray_x, self._ray_y, self._ray_age = _doubles(16), _doubles(16), _doubles(16)
        self._reserve_rows(256)
        count: cython.Py_ssize_t = len(ENVELOPE_DIRECTIONS)
        self._way_x, self._way_y = _doubles(count), _doubles(count)
        self._envelope_x = ENVELOPE_DIRECTIONS.T[:2].copy()
        self._envelope_y = ENVELOPE_DIRECTIONS.T[:2].copy()
        self._envelope_cap = ENVELOPE_DIRECTIONS.T[:2].copy()
        self._poly_x, self._poly_y = _doubles(64), _doubles(64)
        self._clip_x, self._clip_y = _doubles(64), _doubles(64)
        self._shares = SPEED_SHARES

    # Dead reckoning.

    def reading(
        self,
        stamp: cython.double,
        x: cython.double,
        y: cython.double,
        yaw: cython.double,
        linear: cython.double,
        angular: cython.double,
        lateral: cython.double,
    ):
        """Record a reading of odometry if it is new."""
        r: cython.double[::1] = self._readings
        at: cython.Py_ssize_t = 7 * self._last
        if self._known:
            if (
                r[at] == stamp
                and r[at + 1] == x
                and r[at + 2] == y
                and r[at + 3] == yaw
                and r[at + 4] == linear
                and r[at + 5] == angular
                and r[at + 6] == lateral
            ):
                return
            apart: cython.double = _maximum(
                hypot(x - r[at + 1], y - r[at + 2]), fabs(remainder(yaw - r[at + 3], 2.0 * _pi))
            )
            if stamp <= r[at] or apart > _max_step + _max_speed * (stamp - r[at]):
                self._known = 0
                self._resets += 1
        self._last = (self._last + 1) % _history
        self._known = min(self._known + 1, _history)
        self._version += 1
        at = 7 * self._last
        r[at], r[at + 1], r[at + 2], r[at + 3] = stamp, x, y, yaw
        r[at + 4], r[at + 5], r[at + 6] = linear, angular, lateral

    @cython.cfunc
    @cython.exceptval(-1)
    def _pose(self, odometry_age: cython.double, ago: cython.double) -> cython.int:
        """The pose `ago` s before the decision."""
        r: cython.double[::1] = self._readings
        if self._known == 0:
            self._pose_x = self._pose_y = self._pose_yaw = 0.0
            return 0
        k: cython.Py_ssize_t
        early: cython.Py_ssize_t
        late: cython.Py_ssize_t = 7 * self._last
        at: cython.double = r[late] + odometry_age - ago
        for k in range(self._known):
            early = 7 * ((self._last - k + _history) % _history)
            if r[early] <= at:
                if k == 0:
                    seconds: cython.double = at - r[early]
                    if _max_extrapolation < seconds:
                        seconds = _max_extrapolation
                    return self._move(early, r[early + 4], r[early + 5], r[early + 6], seconds)
                share: cython.double = (at - r[early]) / (r[late] - r[early])
                turn: cython.double = remainder(r[late + 3] - r[early + 3], 2.0 * _pi)
                self._pose_x = r[early + 1] + share * (r[late + 1] - r[early + 1])
                self._pose_y = r[early + 2] + share * (r[late + 2] - r[early + 2])
                self._pose_yaw = r[early + 3] + share * turn
                return 0
            late = early
        return self._move(late, r[late + 4], r[late + 5], r[late + 6], at - r[late])

    @cython.cfunc
    @cython.exceptval(-1)
    def _predicted_pose(
        self,
        odometry_age: cython.double,
        linear: cython.double,
        angular: cython.double,
        lateral: cython.double,
    ) -> cython.int:
        """The pose at which the next command takes effect, after the present one."""
        r: cython.double[::1] = self._readings
        if self._known == 0:
            self._pose_x = self._pose_y = self._pose_yaw = 0.0
            return 0
        last: cython.Py_ssize_t = 7 * self._last
        seconds: cython.double = odometry_age
        if _max_extrapolation < seconds:
            seconds = _max_extrapolation
        seconds += _reaction
        return self._move(
            last,
            _mean(r[last + 4], linear, self._braking_linear, seconds),
            _mean(r[last + 5], angular, self._braking_angular, seconds),
            _mean(r[last + 6], lateral, self._braking_linear, seconds),
            seconds,
        )

    @cython.cfunc
    @cython.exceptval(-1)
    def _move(
        self,
        at: cython.Py_ssize_t,
        linear: cython.double,
        angular: cython.double,
        lateral: cython.double,
        seconds: cython.double,
    ) -> cython.int:
        """The pose of a reading after `seconds` at a constant twist, along the chord of its arc."""
        r: cython.double[::1] = self._readings
        turn: cython.double = angular * seconds
        yaw: cython.double = r[at + 3] + 0.5 * turn
        ahead: cython.double = linear * seconds
        left: cython.double = lateral * seconds
        c: cython.double = cos(yaw)
        s: cython.double = sin(yaw)
        self._pose_x = r[at + 1] + c * ahead - s * left
        self._pose_y = r[at + 2] + s * ahead + c * left
        self._pose_yaw = r[at + 3] + turn
        return 0

    # The scan.

    def begin_scan(
        self,
        now: cython.double,
        age: cython.double,
        newest_age: cython.double,
        delay: cython.double,
        odometry_age: cython.double,
        ages: cython.const[cython.double][:],
    ):
        """False if a scan is not newer than the last one; else the motion between the two.

        `newest_age`: how old its newest ray was on arrival by the platform's latency; `delay`: how
        much later than that it arrives. `ages` (n,) of its rays; empty: all are 0.
        """
        i: cython.Py_ssize_t
        oldest: cython.double = 0.0
        for i in range(ages.shape[0]):
            if ages[i] > oldest:
                oldest = ages[i]
        latency: cython.double = newest_age + delay
        taken: cython.double = now - latency - age
        if age > 0.0 and taken < self._taken + _age_tolerance:
            return False
        self._oldest, self._late = oldest, delay + oldest
        self.seconds = _maximum(taken - self._taken, 0.0)
        if self._scan_resets != self._resets:  # the motion since the last scan by the speed alone
            self._pose(odometry_age, latency + min(self.seconds, self._stale))
            self._taken_x, self._taken_y = self._pose_x, self._pose_y
            self._taken_yaw = self._pose_yaw
        self._pose(odometry_age, latency)
        dx: cython.double = self._pose_x - self._taken_x
        dy: cython.double = self._pose_y - self._taken_y
        c: cython.double = cos(self._taken_yaw)
        s: cython.double = sin(self._taken_yaw)
        self.moved_x, self.moved_y = c * dx + s * dy, c * dy - s * dx
        self.moved_yaw = self._pose_yaw - self._taken_yaw
        self._taken_x, self._taken_y, self._taken_yaw = self._pose_x, self._pose_y, self._pose_yaw
        self._taken, self._lag, self._scan_resets = taken, age, self._resets
        return True

    def set_rays(self, directions: cython.double[:, ::1]):
        """The unit vectors (n, 2) of the rays of the scans that follow."""
        self._directions = directions

    def find_min_gap(self, ranges: cython.const[cython.double][:], range_min: cython.double):
        """Set `min_gap`, the m to the nearest return; None without a return."""
        i: cython.Py_ssize_t
        nearest: cython.double = _inf
        for i in range(ranges.shape[0]):
            if ranges[i] < nearest:
                nearest = ranges[i]
        within: cython.double = self._ring(nearest, range_min)
        smallest: cython.double = _inf
        for i in range(ranges.shape[0]):
            if ranges[i] <= within:
                self._place(i, ranges[i], range_min, 0)
                if self._found_gap[0] < smallest:
                    smallest = self._found_gap[0]
        self._set_min_gap(nearest, smallest)

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def _ring(self, nearest: cython.double, range_min: cython.double) -> cython.double:
        """The range up to which a return may be the nearest to the outline.

        The outline lies between two circles around the lidar.
        """
        if nearest == _inf or nearest == -_inf:
            return -_inf
        nearest = nearest if nearest > range_min else range_min
        return _maximum(nearest - self._inner, 0.0) + self._outer

    @cython.cfunc
    @cython.exceptval(-1)
    def _set_min_gap(self, nearest: cython.double, smallest: cython.double) -> cython.int:
        if nearest == _inf:
            self.min_gap = None
        else:
            self.min_gap = 0.0 if nearest == -_inf else smallest
        return 0

    def take_scan(
        self,
        ranges: cython.const[cython.double][:],
        range_min: cython.double,
        ages: cython.const[cython.double][:],
        hidden: cython.double[:, ::1],
    ):
        """Find the near obstacles of a scan, and among `hidden` (m, 3): rays, and m from the lidar.

        `ages` (n,) of the rays; empty: all are 0.
        A hidden obstacle that may touch the robot counts as a return too close to measure. A scan
        that is refused leaves the obstacles of the last scan.
        """
        count: cython.Py_ssize_t = ranges.shape[0]
        unseen: cython.Py_ssize_t = hidden.shape[0]
        if count > self._directions.shape[0]:
            raise IndexError(f"{count} ranges, but {self._directions.shape[0]} rays")
        has_ages: cython.bint = ages.shape[0] > 0
        if has_ages and ages.shape[0] != count:
            raise IndexError(f"{count} ranges, but {ages.shape[0]} ages")
        self._reserve_points(count + unseen)
        if self._ray_x.shape[0] < count + unseen:
            self._ray_x, self._ray_y = _doubles(count + unseen), _doubles(count + unseen)
            self._ray_age = _doubles(count + unseen)
        self._has_situation = False
        self._points = self._contacts = 0
        i: cython.Py_ssize_t
        found: cython.Py_ssize_t = 0
        contacts: cython.Py_ssize_t = 0
        nearest: cython.double = _inf
        for i in range(count):
            if ranges[i] < nearest:
                nearest = ranges[i]
        within: cython.double = self._within + self._others * self._late
        furthest: cython.double = self._binding_range(self._stale + self._late)
        outermost: cython.double = (within if within > furthest else furthest) + self._outer
        # All returns among which the nearest to the outline is; see Footprint.nearest.
        ring: cython.double = self._ring(nearest, range_min)
        smallest: cython.double = _inf  # gap of all returns
        closest: cython.double = _inf  # gap of the near ones
        for i in range(count):
            away: cython.double = ranges[i]
            if away == -_inf:
                self._ray_x[contacts] = self._directions[i, 0]
                self._ray_y[contacts] = self._directions[i, 1]
                self._ray_age[contacts] = ages[i] if has_ages else 0.0
                contacts += 1
            elif away <= outermost or away <= ring:
                self._place(i, away, range_min, found)
                self._found_age[found] = ages[i] if has_ages else 0.0
                gap: cython.double = self._found_gap[found]
                if gap < smallest:
                    smallest = gap
                if away <= outermost:
                    if gap < closest:
                        closest = gap
                    if gap <= furthest:
                        found += 1
        self._set_min_gap(nearest, smallest)
        for i in range(unseen):
            if hidden[i, 2] > self._along_ray(hidden[i, 0], hidden[i, 1]):
                x: cython.double = self._offset_x + hidden[i, 2] * hidden[i, 0]
                y: cython.double = self._offset_y + hidden[i, 2] * hidden[i, 1]
                gap = self._gap_of(x, y)
                self._found_x[found], self._found_y[found], self._found_gap[found] = x, y, gap
                self._found_age[found] = self._oldest
                if gap < closest:
                    closest = gap
                if gap <= furthest:
                    found += 1
            else:
                self._ray_x[contacts], self._ray_y[contacts] = hidden[i, 0], hidden[i, 1]
                self._ray_age[contacts] = self._oldest
                contacts += 1
        self._is_near = contacts > 0 or closest <= within
        self._sort(found)
        for i in range(contacts):
            away = self._along_ray(self._ray_x[i], self._ray_y[i])
            self._x[i] = self._offset_x + away * self._ray_x[i]
            self._y[i] = self._offset_y + away * self._ray_y[i]
            self._gap[i], self._age[i] = 0.0, self._ray_age[i]
        at: cython.Py_ssize_t
        for i in range(found):
            at = self._order[i]
            self._x[contacts + i] = self._found_x[at]
            self._y[contacts + i] = self._found_y[at]
            self._gap[contacts + i] = self._found_gap[at]
            self._age[contacts + i] = self._found_age[at]
        self._points, self._contacts = contacts + found, contacts

    @cython.cfunc
    @cython.exceptval(-1)
    def _place(
        self,
        ray: cython.Py_ssize_t,
        away: cython.double,
        range_min: cython.double,
        at: cython.Py_ssize_t,
    ) -> cython.int:
        """The point and the gap of a return, at an index of those found."""
        if away < range_min:
            away = range_min
        self._found_x[at] = self._offset_x + away * self._directions[ray, 0]
        self._found_y[at] = self._offset_y + away * self._directions[ray, 1]
        self._found_gap[at] = self._gap_of(self._found_x[at], self._found_y[at])
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _sort(self, count: cython.Py_ssize_t) -> cython.int:
        """Merge sort: the order of rising gaps; equal gaps keep their order."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        first: cython.Py_ssize_t
        middle: cython.Py_ssize_t
        end: cython.Py_ssize_t
        for i in range(count):
            self._order[i] = i
        run: cython.Py_ssize_t = 1
        while run < count:
            first = 0
            while first < count:
                middle = min(first + run, count)
                end = min(first + 2 * run, count)
                i, j = first, middle
                for k in range(first, end):
                    if i < middle and (
                        j >= end
                        or self._found_gap[self._order[i]] <= self._found_gap[self._order[j]]
                    ):
                        self._spare[k] = self._order[i]
                        i += 1
                    else:
                        self._spare[k] = self._order[j]
                        j += 1
                first = end
            self._order, self._spare = self._spare, self._order
            run *= 2
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _reserve_points(self, count: cython.Py_ssize_t) -> cython.int:
        """Buffers for so many points of a scan."""
        if self._x is not None and self._x.shape[0] >= count:
            return 0
        self._x, self._y, self._gap = _doubles(count), _doubles(count), _doubles(count)
        self._found_x, self._found_y = _doubles(count), _doubles(count)
        self._age, self._found_gap, self._found_age = (
            _doubles(count),
            _doubles(count),
            _doubles(count),
        )
        self._order, self._spare = _indices(count), _indices(count)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _reserve_placed(self, count: cython.Py_ssize_t) -> cython.int:
        """Buffers for so many points of a decision."""
        if self._placed_x is not None and self._placed_x.shape[0] >= count:
            return 0
        self._placed_x, self._placed_y = _doubles(count), _doubles(count)
        self._placed_gap, self._placed_free = _doubles(count), _doubles(count)
        self._placed_age, self._radius_of = _doubles(count), _doubles(count)
        self._placed_contact = _doubles(count)
        self._normal_x, self._normal_y = _doubles(count), _doubles(count)
        self._near, self._inside = _indices(count), _indices(count)
        self._first_row = _indices(count)
        return 0

    # The outline.

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def _gap_of(self, x: cython.double, y: cython.double) -> cython.double:
        """The distance in m from the outline to a point; 0 for a point inside."""
        k: cython.Py_ssize_t
        edges: cython.Py_ssize_t = self._edges
        least: cython.double = _inf
        for k in range(edges):
            above: cython.double = (
                self._axis_x[edges + k] * x + self._axis_y[edges + k] * y - self._origin[edges + k]
            )
            if above <= 0.0:
                continue
            along: cython.double = self._axis_x[k] * x + self._axis_y[k] * y - self._origin[k]
            beyond: cython.double = 0.0
            if along < 0.0:
                beyond = along
            elif along > self._length[k]:
                beyond = along - self._length[k]
            square: cython.double = beyond * beyond + above * above
            if square < least or square != square:
                least = square
        return 0.0 if least == _inf else sqrt(least)

    @cython.cfunc
    @cython.exceptval(-1)
    def _separate(self, x: cython.double, y: cython.double) -> cython.int:
        """Gap, direction and lever of a point."""
        k: cython.Py_ssize_t
        edges: cython.Py_ssize_t = self._edges
        edge: cython.Py_ssize_t = 0
        least: cython.double = _inf
        highest: cython.double = -_inf
        far: cython.double = 0.0
        high: cython.double = 0.0
        share: cython.double = 0.0
        for k in range(edges):
            along: cython.double = self._axis_x[k] * x + self._axis_y[k] * y - self._origin[k]
            above: cython.double = (
                self._axis_x[edges + k] * x + self._axis_y[edges + k] * y - self._origin[edges + k]
            )
            on: cython.double = along if along > 0.0 else 0.0
            if on > self._length[k]:
                on = self._length[k]
            beyond: cython.double = along - on
            square: cython.double = beyond * beyond + above * above
            if square < least or square != square:
                least, edge, far, high, share = square, k, beyond, above, on
            if above > highest:
                highest = above
        gap: cython.double = 0.0 if highest <= 0.0 and least == least else sqrt(least)
        if gap < 1e-9:
            far, high = 0.0, 1.0
        else:
            inverse: cython.double = 1.0 / gap
            far *= inverse
            high *= inverse
        ax: cython.double = self._axis_x[edge]
        ay: cython.double = self._axis_y[edge]
        nx: cython.double = far * ax + high * ay
        ny: cython.double = far * ay - high * ax
        self._lever = (self._corner_x[edge] + share * ax) * ny - (
            self._corner_y[edge] + share * ay
        ) * nx
        self._gap_found, self._nx, self._ny = gap, nx, ny
        return 0

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def _along_ray(self, ray_x: cython.double, ray_y: cython.double) -> cython.double:
        """m from the lidar to the outline along a ray; 0 from outside."""
        k: cython.Py_ssize_t
        least: cython.double = _inf
        for k in range(self._edges, 2 * self._edges):
            approach: cython.double = ray_x * self._axis_x[k] + ray_y * self._axis_y[k]
            if approach > 1e-12:
                height: cython.double = self._origin[k] - (
                    self._axis_x[k] * self._offset_x + self._axis_y[k] * self._offset_y
                )
                if height / approach < least:
                    least = height / approach
        return _maximum(least, 0.0)

    # The touch zone.

    def set_touch(
        self,
        bearing: cython.double,
        half_width: cython.double,
        speed: cython.double,
        table: cython.double[:, ::1],
    ):
        """Grant a touch zone; `table` (n, 4) are its directions and their foremost corners."""
        self._has_touch = True
        self._touch_bearing, self._touch_half, self._touch_speed = bearing, half_width, speed
        self._touch_x, self._touch_y, self._touch_cos = cos(bearing), sin(bearing), cos(half_width)
        self._touch_table = table

    def end_touch(self):
        """Grant no touch zone."""
        self._has_touch = False

    # Told obstacles.

    def set_told(self, told: cython.double[:, ::1]):
        """The obstacles (n, 4) that the robot is told of: x, y, radius in m, age in s."""
        self._told, self._has_situation = told, False
        if self._disc.shape[0] < told.shape[0]:
            self._disc = _indices(told.shape[0])

    @cython.cfunc
    @cython.exceptval(-1)
    def _find_discs(self) -> cython.int:
        """Those of the told obstacles which can bind the robot."""
        i: cython.Py_ssize_t
        told: cython.double[:, ::1] = self._told
        self._discs = 0
        for i in range(told.shape[0]):
            gap: cython.double = hypot(told[i, 0], told[i, 1]) - told[i, 2] - self._radius
            age: cython.double = told[i, 3] + _reaction
            if not (gap > self._fresh + (self._others + self._fastest) * age):
                self._disc[self._discs] = i
                self._discs += 1
        return 0

    # The decision.

    def decide(
        self,
        now: cython.double,
        scan_age: cython.double,
        odometry_age: cython.double,
        has_odometry: cython.bint,
        along_x: cython.double,
        along_y: cython.double,
        limit: cython.double,
        speed: cython.double,
        angular: cython.double,
        command_linear: cython.double,
        command_angular: cython.double,
        command_lateral: cython.double,
    ) -> cython.int:
        """Judge a request: PASSES, LIMITS (to `linear` and `angular`), REPEATS or STOPS.

        `speed` along a direction with a limit; an age that is not known is NaN. REPEATS: the last
        limit applies again.
        """
        self._find_discs()
        is_free: cython.bint = not (self._has_touch or self._is_near or self._points or self._discs)
        if is_free or (speed == 0.0 and angular == 0.0):
            return _passes
        if self._scan_resets != self._resets:
            return _stops
        version: cython.Py_ssize_t = self._version if has_odometry else -1
        if not (
            self._has_situation
            and self._now == now
            and self._at_version == version
            and _same(self._scan_age, scan_age)
            and _same(self._odometry_age, odometry_age)
            and self._along_x == along_x
            and self._along_y == along_y
            and self._at_touch == self._has_touch
            and (
                not self._has_touch
                or (
                    self._at_bearing == self._touch_bearing
                    and self._at_half == self._touch_half
                    and self._at_speed == self._touch_speed
                )
            )
        ):
            self._has_situation = self._is_decided = False
            self._now, self._scan_age, self._odometry_age = now, scan_age, odometry_age
            self._at_version, self._at_touch = version, self._has_touch
            self._along_x, self._along_y, self._limit = along_x, along_y, limit
            self._at_bearing, self._at_half = self._touch_bearing, self._touch_half
            self._at_speed = self._touch_speed
            self._build(command_linear, command_angular, command_lateral)
            self._has_situation = True
        elif self._is_decided and self._asked_speed == speed and self._asked_angular == angular:
            return _repeats if self._is_limited else _passes
        self._is_decided = False
        self._asked_speed, self._asked_angular = speed, angular
        self._is_limited = self._judge(speed, angular)
        self._is_decided = True
        return _limits if self._is_limited else _passes

    @cython.cfunc
    @cython.exceptval(-1)
    def _judge(self, speed: cython.double, angular: cython.double) -> cython.int:
        """1 if a request must be limited, to `linear` and `angular`."""
        wanted_x: cython.double = speed / self._limit
        wanted_y: cython.double = angular / self._angular_limit
        if self._is_creeping:
            self._end_creeping()
        self._project(wanted_x, wanted_y)
        self.linear = self._point_x * self._limit
        self.angular = self._point_y * self._angular_limit
        is_reduced: cython.bint = self._limit_stop()
        if not is_reduced and self._point_x == wanted_x and self._point_y == wanted_y:
            return 0
        if self._creep_cap > 0.0 and 0.0 < fabs(speed) <= _slow:
            x: cython.double = self._point_x
            y: cython.double = self._point_y
            off: cython.double = hypot(
                self.linear / self._limit - wanted_x, self.angular / self._angular_limit - wanted_y
            )
            self._begin_creeping()
            self._project(wanted_x, wanted_y)
            if hypot(self._point_x - wanted_x, self._point_y - wanted_y) < off - _creep_gain:
                self.linear = self._point_x * self._limit
                self.angular = self._point_y * self._angular_limit
            else:
                self._end_creeping()
                self._point_x, self._point_y = x, y
        return 1

    @cython.cfunc
    @cython.exceptval(-1)
    def _begin_creeping(self) -> cython.int:
        """Use the caps and the envelope of a robot that creeps."""
        i: cython.Py_ssize_t
        for i in range(self._all):
            self._kept_cap[i] = self._row_cap[i]
        for i in range(self._rows):
            self._row_cap[i] = _maximum(self._row_cap[i], self._creep_cap)
        self._is_creeping = True
        return self._set_envelope(0)

    @cython.cfunc
    @cython.exceptval(-1)
    def _end_creeping(self) -> cython.int:
        """Use the caps and the envelope of a robot that does not creep."""
        i: cython.Py_ssize_t
        for i in range(self._rows):
            self._row_cap[i] = self._kept_cap[i]
        self._is_creeping = False
        return self._set_envelope(1)

    @cython.cfunc
    @cython.exceptval(-1)
    def _build(
        self, linear: cython.double, angular: cython.double, lateral: cython.double
    ) -> cython.int:
        """All constraints of the situation; the arguments are the present command."""
        odometry_age: cython.double = self._odometry_age
        if odometry_age != odometry_age:
            odometry_age = 0.0
        self._predicted_pose(odometry_age, linear, angular, lateral)
        dx: cython.double = self._taken_x - self._pose_x
        dy: cython.double = self._taken_y - self._pose_y
        c: cython.double = cos(self._pose_yaw)
        s: cython.double = sin(self._pose_yaw)
        frame_x: cython.double = c * dx + s * dy
        frame_y: cython.double = c * dy - s * dx
        frame_yaw: cython.double = self._taken_yaw - self._pose_yaw
        c, s = cos(frame_yaw), sin(frame_yaw)
        age: cython.double = self._now - self._taken + _reaction
        late: cython.double = _maximum(odometry_age - _max_extrapolation, 0.0)
        self._free = self._margin + self._unseen_extent + (late + self._lag) * self._surface_speed
        furthest: cython.double = self._binding_range(age + self._oldest)
        count: cython.Py_ssize_t = 0
        while count < self._points and not (self._gap[count] >= furthest):
            count += 1
        self._count = count
        contacts: cython.Py_ssize_t = min(self._contacts, count)
        touch_rows: cython.Py_ssize_t = self._touch_table.shape[0] if self._has_touch else 0
        self._reserve_placed(count + self._discs)
        self._reserve_rows(
            (count + self._discs) * (4 + self._edges) + contacts + touch_rows + self._way_x.shape[0]
        )
        self._rows = 0
        i: cython.Py_ssize_t
        for i in range(count):
            self._placed_free[i], self._placed_age[i] = self._free, age + self._age[i]
            self._add_point(
                i,
                frame_x + c * self._x[i] - s * self._y[i],
                frame_y + s * self._x[i] + c * self._y[i],
                0.0,
            )
            self._placed_contact[i] = self._free + self._hidden_gap(i)
        self._add_sides(0, count)
        if self._unseen_extent > 0.0:
            self._add_corners(contacts, count)
        for i in range(contacts):
            self._row_cap[i] = 0.0
            nx: cython.double = c * self._ray_x[i] - s * self._ray_y[i]
            ny: cython.double = s * self._ray_x[i] + c * self._ray_y[i]
            lever: cython.double = self._placed_x[i] * ny - self._placed_y[i] * nx
            self._add(nx * self._along_x + ny * self._along_y, lever, 0.0, 0.0, i)
        if self._keep_out == self._keep_out:
            self._add_keep_out(count)
        if self._has_touch:
            self._grant_touch(count)
        if self._discs:
            self._add_told(odometry_age, late)
        self._all = self._rows
        self._is_creeping = False
        if self._is_near or self._discs:
            self._set_envelope(0 if self._is_touching() else 1)
        self._creep_cap = 0.0
        if self._may_creep and self._is_near and not (self._has_touch or self._discs):
            self._creep_cap = _creep
            for i in range(count):
                rest: cython.double = 0.5 * (self._placed_gap[i] - self._placed_contact[i])
                rest /= self._placed_age[i] + _tick
                self._creep_cap = min(self._creep_cap, rest)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _add_point(
        self,
        i: cython.Py_ssize_t,
        x: cython.double,
        y: cython.double,
        radius: cython.double,
    ) -> cython.int:
        """A row for a placed point, the centre of a disc of that radius."""
        self._placed_x[i], self._placed_y[i], self._radius_of[i] = x, y, radius
        self._separate(x, y)
        self._normal_x[i], self._normal_y[i] = self._nx, self._ny
        self._placed_gap[i], self._first_row[i] = self._gap_found, self._rows
        linear: cython.double = self._nx * self._along_x + self._ny * self._along_y
        cap: cython.double = self._cap(
            self._gap_found - self._placed_free[i],
            self._braking(linear, self._lever),
            self._placed_age[i],
        )
        self._add(linear, self._lever, cap, self._gap_found - radius, i)
        return 0

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def _hidden_gap(self, i: cython.Py_ssize_t) -> cython.double:
        """m by which the blind zone reaches beyond the outline; see constraints.hidden_gaps."""
        nx: cython.double = self._normal_x[i]
        ny: cython.double = self._normal_y[i]
        dx: cython.double = self._placed_x[i] - self._offset_x
        dy: cython.double = self._placed_y[i] - self._offset_y
        across: cython.double = dx * ny - dy * nx
        half: cython.double = self._blind * self._blind - across * across
        if not half > 0.0:
            return 0.0
        return _maximum(sqrt(half) - (dx * nx + dy * ny - self._placed_gap[i]), 0.0)

    @cython.cfunc
    @cython.exceptval(-1)
    def _add_told(self, odometry_age: cython.double, late: cython.double) -> cython.int:
        """The rows of the discs that the robot is told of; see Barrier._with_told."""
        k: cython.Py_ssize_t
        told: cython.double[:, ::1] = self._told
        predicted_x: cython.double = self._pose_x
        predicted_y: cython.double = self._pose_y
        predicted_yaw: cython.double = self._pose_yaw
        c: cython.double = cos(predicted_yaw)
        s: cython.double = sin(predicted_yaw)
        for k in range(self._discs):
            i: cython.Py_ssize_t = self._count + k
            n: cython.Py_ssize_t = self._disc[k]
            self._pose(odometry_age, told[n, 3])
            dx: cython.double = self._pose_x - predicted_x
            dy: cython.double = self._pose_y - predicted_y
            turn: cython.double = self._pose_yaw - predicted_yaw
            radius: cython.double = told[n, 2]
            x: cython.double = cos(turn) * told[n, 0] - sin(turn) * told[n, 1]
            y: cython.double = sin(turn) * told[n, 0] + cos(turn) * told[n, 1]
            least: cython.double = self._margin + radius
            self._placed_free[i] = least + late * self._surface_speed
            self._placed_age[i] = told[n, 3] + _reaction
            self._add_point(i, c * dx + s * dy + x, c * dy - s * dx + y, radius)
            self._placed_contact[i] = self._placed_free[i]
            self._add_sides(i, i + 1)
            self._add_corners(i, i + 1)
        return 0

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def _binding_range(self, age: cython.double) -> cython.double:
        """The gap in m beyond which nothing binds; see BindingRange."""
        gap: cython.double = self._fresh + (self._others + self._fastest) * age
        if self._keep_out != self._keep_out:
            return gap
        speed: cython.double = self._fastest
        half: cython.double = speed * (2.0 * _tick + age + 0.5 * speed / self._braking_linear)
        other: cython.double = self._keep_out + 2.0 * half + speed * age
        return other if other > gap else gap

    @cython.cfunc
    @cython.inline
    @cython.exceptval(check=False)
    def _cap(
        self, room: cython.double, braking: cython.double, unseen: cython.double
    ) -> cython.double:
        """The cap in m/s for so much room in m, `unseen` s after an obstacle was seen."""
        if not self._is_passive:
            return self._reciprocal_cap(room, braking, unseen)
        left: cython.double = room - self._others * (unseen + _tick)
        first: cython.double = braking * _tick + self._others
        root: cython.double = sqrt(first * first + 2.0 * braking * _maximum(left, 0.0))
        return _maximum(root - first, 0.0)

    @cython.cfunc
    @cython.inline
    @cython.exceptval(check=False)
    def _reciprocal_cap(
        self, room: cython.double, braking: cython.double, unseen: cython.double
    ) -> cython.double:
        half: cython.double = 0.5 * _maximum(room, 0.0)
        first: cython.double = braking * (2.0 * _tick + unseen)
        return _maximum(sqrt(first * first + 2.0 * braking * half) - first, 0.0)

    @cython.cfunc
    @cython.inline
    @cython.exceptval(check=False)
    def _braking(self, linear: cython.double, lever: cython.double) -> cython.double:
        braking: cython.double = fabs(linear) * self._braking_linear
        braking += fabs(lever) * self._braking_angular
        return _maximum(braking, _min_braking)

    @cython.cfunc
    @cython.exceptval(-1)
    def _add(
        self,
        linear: cython.double,
        lever: cython.double,
        cap: cython.double,
        gap: cython.double,
        source: cython.Py_ssize_t,
    ) -> cython.int:
        """A row, in speeds over their limits; `source` is its point."""
        at: cython.Py_ssize_t = self._rows
        self._row_x[at], self._row_y[at] = linear * self._limit, lever * self._angular_limit
        self._row_cap[at], self._row_gap[at], self._source[at] = cap, gap, source
        self._rows = at + 1
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _add_sides(self, first: cython.Py_ssize_t, end: cython.Py_ssize_t) -> cython.int:
        """Two rows for each point whose cap is 0; see side_constraints."""
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        side: cython.Py_ssize_t
        for side in range(2):
            turn: cython.double = _side_sin if side == 0 else -_side_sin
            for i in range(first, end):
                if not (self._row_cap[self._first_row[i]] <= 0.0):
                    continue
                nx: cython.double = self._normal_x[i]
                ny: cython.double = self._normal_y[i]
                ax: cython.double = _side_cos * nx - turn * ny
                ay: cython.double = turn * nx + _side_cos * ny
                foremost: cython.Py_ssize_t = 0
                most: cython.double = self._corner_x[0] * ax + self._corner_y[0] * ay
                for k in range(1, self._edges):
                    ahead: cython.double = self._corner_x[k] * ax + self._corner_y[k] * ay
                    if ahead > most:
                        most, foremost = ahead, k
                lever: cython.double = self._corner_x[foremost] * ay - self._corner_y[foremost] * ax
                gap: cython.double = self._placed_gap[i]
                rest: cython.double = 0.5 * (gap - self._placed_contact[i])
                rest /= self._placed_age[i] + _tick
                rest -= self._side_reserve
                linear: cython.double = ax * self._along_x + ay * self._along_y
                self._add(linear, lever, _maximum(rest, _creep), gap - self._radius_of[i], i)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _add_corners(self, first: cython.Py_ssize_t, end: cython.Py_ssize_t) -> cython.int:
        """A row of each own corner for each near point; see Barrier._corner_constraints."""
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        at: cython.Py_ssize_t = self._rows
        x: cython.double[::1] = self._placed_x
        y: cython.double[::1] = self._placed_y
        gap: cython.double[::1] = self._placed_gap
        frees: cython.double[::1] = self._placed_free
        ages: cython.double[::1] = self._placed_age
        row_x: cython.double[::1] = self._row_x
        row_y: cython.double[::1] = self._row_y
        row_cap: cython.double[::1] = self._row_cap
        row_gap: cython.double[::1] = self._row_gap
        along_x: cython.double = self._along_x
        along_y: cython.double = self._along_y
        limit: cython.double = self._limit
        angular_limit: cython.double = self._angular_limit
        # A row that no twist within the limits violates is left out.
        for k in range(self._edges):
            own_x: cython.double = self._corner_x[k]
            own_y: cython.double = self._corner_y[k]
            for i in range(first, end):
                if not (gap[i] <= 2.0 * frees[i] + self._others * (ages[i] + _tick)):
                    continue
                dx: cython.double = x[i] - own_x
                dy: cython.double = y[i] - own_y
                away: cython.double = _maximum(hypot(dx, dy), 1e-9)
                dx /= away
                dy /= away
                linear: cython.double = dx * along_x + dy * along_y
                lever: cython.double = own_x * dy - own_y * dx
                cap: cython.double = self._cap(
                    away - frees[i], self._braking(linear, lever), ages[i]
                )
                linear *= limit
                lever *= angular_limit
                if cap > fabs(linear) + fabs(lever) + _slack:
                    continue
                row_x[at], row_y[at], row_cap[at] = linear, lever, cap
                row_gap[at], self._source[at] = away - self._radius_of[i], i
                at += 1
        self._rows = at
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _add_keep_out(self, count: cython.Py_ssize_t) -> cython.int:
        """A second row for each point: the circle around the sensor."""
        i: cython.Py_ssize_t
        for i in range(count):
            dx: cython.double = self._placed_x[i] - self._offset_x
            dy: cython.double = self._placed_y[i] - self._offset_y
            away: cython.double = _maximum(hypot(dx, dy), 1e-9)
            dx /= away
            dy /= away
            linear: cython.double = dx * self._along_x + dy * self._along_y
            lever: cython.double = self._offset_x * dy - self._offset_y * dx
            cap: cython.double = self._reciprocal_cap(
                away - self._keep_out, self._braking(linear, lever), self._placed_age[i]
            )
            self._add(linear, lever, cap, self._row_gap[i], i)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _grant_touch(self, count: cython.Py_ssize_t) -> cython.int:
        """Raise the caps in the touch zone, and limit any motion in its directions."""
        i: cython.Py_ssize_t
        for i in range(count):
            ahead: cython.double = self._normal_x[i] * self._touch_x
            self._inside[i] = ahead + self._normal_y[i] * self._touch_y >= self._touch_cos
        for i in range(self._rows):
            if self._inside[self._source[i]]:
                self._row_cap[i] = _maximum(self._row_cap[i], self._touch_speed)
        for i in range(self._touch_table.shape[0]):
            nx: cython.double = self._touch_table[i, 0]
            ny: cython.double = self._touch_table[i, 1]
            linear: cython.double = nx * self._along_x + ny * self._along_y
            lever: cython.double = self._touch_table[i, 2] * ny - self._touch_table[i, 3] * nx
            self._add(linear, lever, self._touch_speed, _inf, 0)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _is_touching(self) -> cython.int:
        """1 if an obstacle may touch the robot."""
        i: cython.Py_ssize_t
        for i in range(self._count):
            is_within: cython.bint = self._placed_gap[i] <= self._placed_contact[i]
            if is_within and self._row_cap[self._first_row[i]] <= 0.0:
                return 1
        for i in range(self._count, self._count + self._discs):  # see Barrier._may_touch
            left: cython.double = self._placed_gap[i] - (self._placed_free[i] - self._margin)
            if left <= self._others * (self._placed_age[i] + _tick):
                return 1
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _set_envelope(self, which: cython.Py_ssize_t) -> cython.int:
        """The rows of an envelope, while creeping (0) or else (1), which are not reported."""
        i: cython.Py_ssize_t
        if not (
            self._envelope_along_x[which] == self._along_x
            and self._envelope_along_y[which] == self._along_y
        ):
            self._find_envelope(which, _creep if which == 0 else self._surface_speed)
            self._envelope_along_x[which] = self._along_x
            self._envelope_along_y[which] = self._along_y
        self._all = self._rows
        for i in range(self._way_x.shape[0]):
            self._row_x[self._all] = self._envelope_x[which, i]
            self._row_y[self._all] = self._envelope_y[which, i]
            self._row_cap[self._all] = self._envelope_cap[which, i]
            self._all += 1
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _find_envelope(self, which: cython.Py_ssize_t, speed: cython.double) -> cython.int:
        """The half-planes of the envelope; see constraints.envelope and half_planes."""
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        after: cython.Py_ssize_t
        count: cython.Py_ssize_t = self._way_x.shape[0]
        table: cython.double[:, ::1] = ENVELOPE_DIRECTIONS
        for i in range(count):
            linear: cython.double = table[i, 0] * self._limit
            angular: cython.double = table[i, 1] * self._angular_limit
            fastest: cython.double = 0.0
            for k in range(self._edges):
                x: cython.double = linear * self._along_x - angular * self._corner_y[k]
                y: cython.double = linear * self._along_y + angular * self._corner_x[k]
                fastest = _maximum(fastest, hypot(x, y))
            share: cython.double = speed / _maximum(fastest, 1e-12)
            if share > 1.0:
                share = 1.0
            self._way_x[i], self._way_y[i] = table[i, 0] * share, table[i, 1] * share
        for i in range(count):
            after = i + 1 if i + 1 < count else 0
            x = self._way_x[after] - self._way_x[i]
            y = self._way_y[after] - self._way_y[i]
            length: cython.double = hypot(y, -x)
            y, x = y / length, -x / length
            self._envelope_x[which, i], self._envelope_y[which, i] = y, x
            self._envelope_cap[which, i] = y * self._way_x[i] + x * self._way_y[i]
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _reserve_rows(self, count: cython.Py_ssize_t) -> cython.int:
        if self._row_x is not None and self._row_x.shape[0] >= count:
            return 0
        self._row_x, self._row_y = _doubles(count), _doubles(count)
        self._row_cap, self._row_gap = _doubles(count), _doubles(count)
        self._kept_cap = _doubles(count)
        self._source = _indices(count)
        return 0

    # The projection.

    @cython.cfunc
    @cython.exceptval(-1)
    def _project(self, x: cython.double, y: cython.double) -> cython.int:
        """The feasible point nearest to a requested one; see projection.nearest_feasible."""
        i: cython.Py_ssize_t
        worst: cython.Py_ssize_t
        self._poly_x[0] = self._poly_x[1] = self._poly_y[1] = self._poly_y[2] = 1.0
        self._poly_x[2] = self._poly_x[3] = self._poly_y[0] = self._poly_y[3] = -1.0
        self._sides = 4
        row_x: cython.double[::1] = self._row_x
        row_y: cython.double[::1] = self._row_y
        row_cap: cython.double[::1] = self._row_cap
        self._nearest(x, y)
        for _ in range(self._all):
            worst = 0
            most: cython.double = -_inf
            px: cython.double = self._point_x
            py: cython.double = self._point_y
            for i in range(self._all):
                excess: cython.double = row_x[i] * px + row_y[i] * py - row_cap[i]
                if not (excess <= most):
                    most, worst = excess, i
                    if excess != excess:
                        break
            if most <= _tolerance:
                break
            self._clip(self._row_x[worst], self._row_y[worst], self._row_cap[worst])
            self._nearest(x, y)
        return 0

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    @cython.inline
    def _excess(self, row: cython.Py_ssize_t) -> cython.double:
        """By how much the point violates a row."""
        return (
            self._row_x[row] * self._point_x + self._row_y[row] * self._point_y - self._row_cap[row]
        )

    @cython.cfunc
    @cython.exceptval(-1)
    def _clip(self, a: cython.double, b: cython.double, cap: cython.double) -> cython.int:
        """Cut off the part of the polygon where a x + b y > cap."""
        if self._clip_x.shape[0] < 2 * self._sides:
            self._clip_x, self._clip_y = _doubles(4 * self._sides), _doubles(4 * self._sides)
        i: cython.Py_ssize_t
        kept: cython.Py_ssize_t = 0
        x0: cython.double = self._poly_x[self._sides - 1]
        y0: cython.double = self._poly_y[self._sides - 1]
        over0: cython.double = a * x0 + b * y0 - cap
        for i in range(self._sides):
            x1: cython.double = self._poly_x[i]
            y1: cython.double = self._poly_y[i]
            over1: cython.double = a * x1 + b * y1 - cap
            if (over0 > 0.0) != (over1 > 0.0):
                share: cython.double = over0 / (over0 - over1)
                self._clip_x[kept] = x0 + share * (x1 - x0)
                self._clip_y[kept] = y0 + share * (y1 - y0)
                kept += 1
            if over1 <= 0.0:
                self._clip_x[kept], self._clip_y[kept] = x1, y1
                kept += 1
            x0, y0, over0 = x1, y1, over1
        if kept == 0:
            self._clip_x[0] = self._clip_y[0] = 0.0
            kept = 1
        self._sides = kept
        self._poly_x, self._clip_x = self._clip_x, self._poly_x
        self._poly_y, self._clip_y = self._clip_y, self._poly_y
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _nearest(self, x: cython.double, y: cython.double) -> cython.int:
        """The point of the polygon nearest to a requested one."""
        i: cython.Py_ssize_t
        best_x: cython.double = 0.0
        best_y: cython.double = 0.0
        best: cython.double = _inf
        is_inside: cython.bint = True
        x0: cython.double = self._poly_x[self._sides - 1]
        y0: cython.double = self._poly_y[self._sides - 1]
        for i in range(self._sides):
            x1: cython.double = self._poly_x[i]
            y1: cython.double = self._poly_y[i]
            dx: cython.double = x1 - x0
            dy: cython.double = y1 - y0
            px: cython.double = x - x0
            py: cython.double = y - y0
            if dx * py - dy * px <= 0.0:
                is_inside = False
            square: cython.double = dx * dx + dy * dy
            share: cython.double = (px * dx + py * dy) / square if square > 0.0 else 0.0
            if share < 0.0:
                share = 0.0
            if share > 1.0:
                share = 1.0
            on_x: cython.double = x0 + share * dx
            on_y: cython.double = y0 + share * dy
            away: cython.double = (x - on_x) * (x - on_x) + (y - on_y) * (y - on_y)
            if away < best:
                best_x, best_y, best = on_x, on_y, away
            x0, y0 = x1, y1
        if is_inside or best <= _tolerance * _tolerance:
            self._point_x, self._point_y = x, y
        else:
            self._point_x, self._point_y = best_x, best_y
        return 0

    # The stop check.

    @cython.cfunc
    @cython.exceptval(-1)
    def _limit_stop(self) -> cython.int:
        """1 if the speeds are reduced so that every stop stays clear; see StopCheck."""
        i: cython.Py_ssize_t
        s: cython.double = self.linear
        w: cython.double = self.angular
        slow: cython.double = fabs(s) / self._braking_linear
        turning: cython.double = fabs(w) / self._braking_angular
        seconds: cython.double = _tick + (turning if turning > slow else slow)
        others: cython.double = self._others if self._is_passive else 0.0
        way: cython.double = (fabs(s) + fabs(w) * self._radius) * seconds
        self._beside = 0
        for i in range(self._contacts, self._count + self._discs):
            if self._has_touch and i < self._count and self._inside[i]:
                continue
            need: cython.double = self._placed_free[i] + others * self._placed_age[i]
            if self._placed_gap[i] <= need + others * seconds + way:
                self._near[self._beside] = i
                self._beside += 1
        if self._beside == 0:
            return 0
        self._forbidding = 0
        if self._is_clear(s, w, others):
            return 0
        self.linear = self.angular = 0.0
        for i in range(self._shares.shape[0]):
            some: cython.double = self._shares[i, 0] * s
            turn: cython.double = self._shares[i, 1] * w
            if not self._is_feasible(some / self._limit, turn / self._angular_limit):
                continue
            if self._is_clear(some, turn, others):
                self.linear, self.angular = some, turn
                break
        # The zero command is always clear; shares of a speed of 0 are 0.
        return not (self.linear == s and self.angular == w)

    @cython.cfunc
    @cython.exceptval(-1)
    def _is_feasible(self, x: cython.double, y: cython.double) -> cython.int:
        """1 if a point violates no row."""
        i: cython.Py_ssize_t
        for i in range(self._all):
            if not (self._row_x[i] * x + self._row_y[i] * y - self._row_cap[i] <= _tolerance):
                return 0
        return 1

    @cython.cfunc
    @cython.exceptval(-1)
    def _is_clear(self, s: cython.double, w: cython.double, others: cython.double) -> cython.int:
        """1 if every stop from two speeds stays clear.

        The gap that a point must keep grows at `others` m/s. The outline comes
        no nearer to a point than by its own way: points beyond need no distance. The point that
        forbade the last speeds is asked first.
        """
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        v: cython.double = fabs(s)
        turning: cython.double = fabs(w)
        for k in range(3):  # both brakes as assumed, then one of them ideal
            slow: cython.double = 0.0 if k == 1 else v / self._braking_linear
            until: cython.double = 0.0 if k == 2 else turning / self._braking_angular
            last: cython.double = _tick + (until if until > slow else slow)
            step: cython.double = last / 4
            way: cython.double = self._simulate(k, s, w, v, turning, step)
            if self._forbids(self._near[self._forbidding], way, step, others):
                return 0
            for i in range(self._beside):
                if self._forbids(self._near[i], way, step, others):
                    self._forbidding = i
                    return 0
        return 1

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def _simulate(
        self,
        brake: cython.Py_ssize_t,
        s: cython.double,
        w: cython.double,
        v: cython.double,
        turning: cython.double,
        step: cython.double,
    ) -> cython.double:
        """The four poses of a stop; at most so far in m does a place of the outline move."""
        j: cython.Py_ssize_t
        linear: cython.double = 1e9 if brake == 1 else self._braking_linear
        angular: cython.double = 1e9 if brake == 2 else self._braking_angular
        way: cython.double = 0.0
        x: cython.double = 0.0
        y: cython.double = 0.0
        yaw: cython.double = 0.0
        self._poses = 0
        for j in range(4):
            braked: cython.double = _maximum(step * (j + 0.5) - _tick, 0.0)
            shed: cython.double = linear * braked if braked > 0.0 else 0.0
            move: cython.double = _maximum(v - shed, 0.0) * step * _sign(s)
            shed = angular * braked if braked > 0.0 else 0.0
            turn: cython.double = _maximum(turning - shed, 0.0) * step * _sign(w)
            yaw += turn
            c: cython.double = cos(yaw - 0.5 * turn)
            d: cython.double = sin(yaw - 0.5 * turn)
            x += move * (c * self._along_x - d * self._along_y)
            y += move * (d * self._along_x + c * self._along_y)
            self._stop_x[j], self._stop_y[j] = x, y
            until: cython.double = _maximum(step * j - _tick, 0.0)
            shed = linear * until if until > 0.0 else 0.0
            self._stop_v[j] = _maximum(v - shed, 0.0) * _sign(s)
            shed = angular * until if until > 0.0 else 0.0
            self._stop_w[j] = _maximum(turning - shed, 0.0) * _sign(w)
            self._stop_cos[j], self._stop_sin[j] = cos(yaw), sin(yaw)
            fastest: cython.double = fabs(self._stop_v[j]) + fabs(self._stop_w[j]) * self._radius
            if not (fastest + 1e-12 <= _negligible):
                self._poses = j + 1  # those after it close on nothing
            way += fabs(move) + fabs(turn) * self._radius
            self._stop_way[j] = -way
        return way

    @cython.cfunc
    @cython.exceptval(-1)
    def _forbids(
        self,
        point: cython.Py_ssize_t,
        way: cython.double,
        step: cython.double,
        others: cython.double,
    ) -> cython.int:
        """1 if the outline closes on a point within its gap during the simulated stop."""
        j: cython.Py_ssize_t
        gap: cython.double = self._placed_gap[point]
        need: cython.double = self._placed_free[point] + others * self._placed_age[point]
        least: cython.double = need + others * (step * 4.0) + way + _rounding
        if gap >= least:
            return 0
        before: cython.double = gap
        for j in range(self._poses):
            dx: cython.double = self._placed_x[point] - self._stop_x[j]
            dy: cython.double = self._placed_y[point] - self._stop_y[j]
            c: cython.double = self._stop_cos[j]
            d: cython.double = self._stop_sin[j]
            x: cython.double = c * dx + d * dy
            y: cython.double = c * dy - d * dx
            left: cython.double = self._gap_of(x, y)
            is_free: cython.bint = left >= need + others * (step * (j + 1.0))
            if not is_free and not (before - left <= _negligible * step):
                return 1
            within: cython.double = need - self._margin + others * (step * (j + 0.5))
            if left < within and self._swings(x, y, within, self._stop_v[j], self._stop_w[j]):
                return 1
            if left - self._stop_way[j] >= least:
                return 0
            before = left
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _swings(
        self,
        x: cython.double,
        y: cython.double,
        within: cython.double,
        v: cython.double,
        w: cython.double,
    ) -> cython.int:
        """1 if a turn moves a place of the outline outwards within a distance of a point.

        See StopCheck._swings.
        """
        k: cython.Py_ssize_t
        edges: cython.Py_ssize_t = self._edges
        for k in range(edges):
            nx: cython.double = self._axis_x[edges + k]
            ny: cython.double = self._axis_y[edges + k]
            above: cython.double = nx * x + ny * y - self._origin[edges + k]
            if not above < within:
                continue
            length: cython.double = self._length[k]
            along: cython.double = self._axis_x[k] * x + self._axis_y[k] * y - self._origin[k]
            first: cython.double
            last: cython.double
            if above > 0.0:
                half: cython.double = sqrt(within * within - above * above)
                first, last = along - half, along + half
            else:  # from behind the edge's line the way leads around the nearer corner
                past: cython.double = -along if along < 0.0 else along - length
                if not past > 0.0:
                    continue
                left: cython.double = within - hypot(past, above)
                if not left > 0.0:
                    continue
                first = 0.0 if along < 0.0 else length - left
                last = left if along < 0.0 else length
            first = first if first > 0.0 else 0.0
            last = last if last < length else length
            if first > last:
                continue
            turned: cython.double = w * (
                self._corner_x[k] * ny - self._corner_y[k] * nx - (first if w > 0.0 else last)
            )
            moved: cython.double = v * (self._along_x * nx + self._along_y * ny)
            if turned > _fault and turned + moved > _fault:
                return 1
        return 0

    # The report.

    def report(self):
        """(bearing, gap, cap) of the rows that bind the last limited request, lowest caps first."""
        i: cython.Py_ssize_t
        tight: cython.Py_ssize_t = 0
        found: list = []
        for i in range(self._all):
            if self._excess(i) >= -_binding:
                tight += 1
                if i < self._rows:
                    self._rank(found, i)
        points: cython.Py_ssize_t = self._count + self._discs
        if tight == 0 and points:  # limited by the stop alone: the nearest obstacle
            nearest: cython.Py_ssize_t = self._first_row[0]
            for i in range(1, points):
                if self._row_gap[self._first_row[i]] < self._row_gap[nearest]:
                    nearest = self._first_row[i]
            self._rank(found, nearest)
        shown: list = []
        for i in found:
            point: cython.Py_ssize_t = self._source[i]
            radius: cython.double = self._radius_of[point]
            x: cython.double = self._placed_x[point] - radius * self._normal_x[point]
            y: cython.double = self._placed_y[point] - radius * self._normal_y[point]
            bearing: cython.double = 0.0 if hypot(x, y) < _at_axle else atan2(y, x)
            shown.append((bearing, self._gap_of(x, y), self._row_cap[i]))
        return shown

    @cython.cfunc
    @cython.exceptval(-1)
    def _rank(self, found: list, row: cython.Py_ssize_t) -> cython.int:
        """Insert a row among those with the lowest caps, and of these the smallest gaps."""
        cap: cython.double = self._row_cap[row]
        gap: cython.double = self._row_gap[row]
        if not gap < _inf:
            return 0
        at: cython.Py_ssize_t = len(found)
        other: cython.Py_ssize_t
        while at > 0:
            other = found[at - 1]
            if self._row_cap[other] < cap or (
                self._row_cap[other] == cap and self._row_gap[other] <= gap
            ):
                break
            at -= 1
        if at < _reported:
            found.insert(at, row)
            del found[_reported:]
        return 0
