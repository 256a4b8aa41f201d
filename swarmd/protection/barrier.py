"""Mode `barrier`: the command nearest to the requested one from which the robot can still stop.

The speed at which the outline closes on a near return is linear in the twist. It must not exceed a
cap from which the robot can still stop before the two touch, while the obstacle approaches at its
assumed speed. The command is the one within these half-planes that is nearest to the requested one,
reduced if the outline would not stay clear while the robot brakes. The zero command always
satisfies the constraints, moving away is free except for a creep speed in contact, and far from
obstacles a requested command passes bit by bit.

Sources: control barrier functions as command filters (Ames, Xu, Grizzle and Tabuada, IEEE TAC
2017); for swarms Wang, Ames and Egerstedt, IEEE T-RO 2017; "passive safety", no own fault at
contact: Mitsch, Ghorbal, Vogelbacher and Platzer, IJRR 2017. Unlike theirs, all inputs come from
the robot's own lidar and odometry. docs/safety.md states what holds and under which assumptions.

Cython compiles this file, and CPython runs it where it is not compiled (core/kernels.py). A NaN
counts as the greatest and as the smallest number, so that a constraint that is not known forbids
motion. A row is a constraint a x + b y <= cap on the two speeds, each over its limit.
"""

from __future__ import annotations

import math
from array import array
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from swarmd.core.clock import TICK
from swarmd.core.errors import ConfigError
from swarmd.core.kernels import load_kernel
from swarmd.core.messages import LimitingObstacle, NarrowestPassage
from swarmd.core.values import (
    MAX_SPEED,
    MAX_STEP,
    ZERO,
    Array,
    Limits,
    Platform,
    Pose,
    Scan,
    TouchZone,
    Twist,
)
from swarmd.protection.binding_range import REACTION_TIME, BindingRange
from swarmd.protection.decision import DecisionContext, ModeDecision
from swarmd.protection.footprint import Footprint, ScanGeometry
from swarmd.protection.recovery import Clearance
from swarmd.protection.settings import BarrierSettings
from swarmd.sensing.rays import unit_vectors
from swarmd.sensing.scan_pipeline import HISTORY, MAX_EXTRAPOLATION

if TYPE_CHECKING:  # Cython reads this import, CPython the other one
    import cython
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import atan2, copysign, cos, fabs, hypot, remainder, sin, sqrt
else:
    from swarmd.core.cython_shadow import atan2, copysign, cos, fabs, hypot, remainder, sin, sqrt

CREEP_SPEED = cython.declare(cython.double, 0.015)
"""m/s: the fastest corner in contact, where part of the obstacle may be unseen.

Also that of a robot that creeps towards an obstacle which stops any faster robot.
"""
SLOW_REQUEST = cython.declare(cython.double, 3.0 * CREEP_SPEED)
"""m/s: a robot that is asked for more does not creep towards an obstacle."""
CREEP_GAIN = cython.declare(cython.double, 1e-6)
"""By which creeping must be nearer to the requested command, in speeds over their limits."""
MIN_BRAKING = cython.declare(cython.double, 0.02)
"""m/s2, for constraints that hardly any motion closes."""
SIDE_ANGLE = math.radians(60.0)
"""rad between a return and its two side constraints."""
SIDE_RESERVE = 0.3
"""Share of `others_speed` by which a corner passes an obstacle more slowly, if none is given.

With 0.25 an attacker met a Waffle Pi at 2.6 cm/s at a corner that slid past it, with 0.29 at 1.1.
"""
NEGLIGIBLE_SPEED = cython.declare(cython.double, 0.015)
"""m/s: closing at a speed up to this is no approach."""
FAULT_SPEED = cython.declare(cython.double, 0.02)
"""m/s: a contact at a closing speed up to this is not a fault of the robot."""
TOLERANCE = cython.declare(cython.double, 1e-12)
"""By how much rounding may violate a constraint."""
BINDING_TOLERANCE = cython.declare(cython.double, 1e-9)
"""How near a constraint that counts as tight is to the point."""
MAX_REPORTED = cython.declare(cython.Py_ssize_t, 4)
"""Constraints that a decision reports."""

_AGE_TOLERANCE = cython.declare(cython.double, 1e-6)  # s, for the rounding of ages
# m: rounding decides the direction of a nearer place
_AT_AXLE = cython.declare(cython.double, 1e-9)
# m, of the way of an outline: prunes nothing that binds
_ROUNDING = cython.declare(cython.double, 1e-9)
_SLACK = cython.declare(cython.double, 1e-6)  # far beyond BINDING_TOLERANCE
_SAME_FACE = 1e-9  # m by which corners of one face may differ
_TOUCH_STEP = math.radians(15.0)  # directions between two of these are at most 1 % faster
_PASSAGE_SLACK = 0.03  # m per side by which a passage must be wider: noise, a turning lidar
_CORRIDOR_SPEED = 0.08  # m/s: what counts as passing a corridor
_PLACES_BESIDE = 33  # along each wall of a corridor, odd: one lies beside a lidar in the middle
_STEPS = cython.declare(cython.Py_ssize_t, 4)  # poses of a simulated stop
_CHUNK = cython.declare(cython.Py_ssize_t, 64)  # points of a chunk

_tick = cython.declare(cython.double, TICK)
_side_cos = cython.declare(cython.double, math.cos(SIDE_ANGLE))
_side_sin = cython.declare(cython.double, math.sin(SIDE_ANGLE))
_max_extrapolation = cython.declare(cython.double, MAX_EXTRAPOLATION)
_max_step = cython.declare(cython.double, MAX_STEP)
_max_speed = cython.declare(cython.double, MAX_SPEED)
_reaction = cython.declare(cython.double, REACTION_TIME)
_history = cython.declare(cython.Py_ssize_t, HISTORY)
_inf = cython.declare(cython.double, math.inf)
_nan = cython.declare(cython.double, math.nan)
_pi = cython.declare(cython.double, math.pi)


def _view(values: Array):
    """`values` (n,) or (n, m) as the kernel reads them: in CPython as numbers of Python."""
    table = np.ascontiguousarray(values, np.float64)
    if not cython.compiled:
        return memoryview(table) if table.ndim > 1 else table.tolist()
    return table


def _doubles(count):
    """A buffer of `count` doubles, all 0."""
    return array("d", bytes(8 * count)) if cython.compiled else [0.0] * count


def _indices(count):
    """A buffer of `count` indices, all 0."""
    return array("q", bytes(8 * count)) if cython.compiled else [0] * count


def _envelope_directions() -> Array:
    angles = 2.0 * np.pi * np.arange(48) / 48
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    directions /= np.abs(directions).max(axis=1)[:, None]
    return directions


def _speed_shares() -> Array:
    grid = (1.0, 0.75, 0.5, 0.25, 0.0)
    shares = [(a, b) for a in grid for b in grid if (a, b) != (1.0, 1.0)]
    shares.sort(key=lambda share: (1.0 - share[0]) ** 2 + (1.0 - share[1]) ** 2)
    return np.array(shares)


_ENVELOPE_DIRECTIONS = _view(_envelope_directions())
"""(48, 2) directions of the envelope, on the box of the limits, whose corners are among them."""
_SPEED_SHARES = _view(_speed_shares())
"""Shares of the two speeds, those nearest to the whole first; the last is zero."""
_NO_ROWS = _view(np.empty((0, 4)))
_NO_AGES = _view(np.empty(0))
_decided = cython.declare(object, ModeDecision)  # a name of C is looked up once


@cython.cfunc
@cython.inline
def _first(values: cython.double[::1], count: cython.Py_ssize_t) -> cython.p_double:
    """The values, of which a loop reads the first `count`: checked here, and not at each."""
    if len(values) < count:
        raise IndexError(f"{len(values)} values; expected {count}")
    if not cython.compiled:
        return values
    return cython.address(values[0])


@cython.cfunc
@cython.inline
def _first_index(values: cython.longlong[::1], count: cython.Py_ssize_t) -> cython.p_longlong:
    """As `_first`, for indices."""
    if len(values) < count:
        raise IndexError(f"{len(values)} indices; expected {count}")
    if not cython.compiled:
        return values
    return cython.address(values[0])


@cython.cfunc
def _take(
    values: cython.double[::1],
    indices: cython.longlong[::1],
    count: cython.Py_ssize_t,
    into: cython.double[::1],
    begin: cython.Py_ssize_t,
):
    """Put the values at the first `count` indices into a buffer, from its index `begin` on."""
    i: cython.Py_ssize_t
    order: cython.p_longlong = _first_index(indices, count)
    given: cython.p_double = _first(values, count)
    to: cython.p_double = _first(into, begin + count)
    for i in range(count):
        to[begin + i] = given[order[i]]


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _maximum(a: cython.double, b: cython.double) -> cython.double:
    """The greater; NaN if one is."""
    return a if (a > b) | (a != a) else b


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


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _cap(
    room: cython.double,
    braking: cython.double,
    unseen: cython.double,
    others: cython.double,
    is_passive: cython.bint,
) -> cython.double:
    """The cap in m/s on the closing speed, for an obstacle that approaches at `others` m/s.

    From the cap the robot can still stop before the two use up `room` m, the gap less what
    stays free. `braking` m/s2 is the rate at which the closing speed can fall, `unseen` s the
    time since the obstacle was seen. Solves
    s tick + s^2 / 2b + V (unseen + tick + s / b) = room. After the dynamic window with moving
    obstacles and "passive safety" (Mitsch, Ghorbal, Vogelbacher and Platzer, IJRR 2017).
    """
    if not is_passive:
        return _reciprocal_cap(room, braking, unseen)
    left: cython.double = room - others * (unseen + _tick)
    first: cython.double = braking * _tick + others
    root: cython.double = sqrt(first * first + 2.0 * braking * _maximum(left, 0.0))
    return _maximum(root - first, 0.0)


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _reciprocal_cap(
    room: cython.double, braking: cython.double, unseen: cython.double
) -> cython.double:
    """The cap in m/s towards robots with the same rule: each may use half of the room.

    As `_cap`, with others at rest and a reaction of two ticks plus the time unseen. After
    barrier certificates that share the distance (Wang, Ames and Egerstedt, IEEE T-RO 2017).
    """
    half: cython.double = 0.5 * _maximum(room, 0.0)
    first: cython.double = braking * (2.0 * _tick + unseen)
    return _maximum(sqrt(first * first + 2.0 * braking * half) - first, 0.0)


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _braking(
    linear: cython.double, lever: cython.double, slowing: cython.double, turning: cython.double
) -> cython.double:
    """m/s2: the rate at which the closing speed of a constraint can fall.

    `slowing` m/s2 and `turning` rad/s2 are the rates at which the two speeds can fall.
    """
    braking: cython.double = fabs(linear) * slowing
    braking += fabs(lever) * turning
    return _maximum(braking, MIN_BRAKING)


@cython.final
@cython.cclass
class Barrier:
    """The arbiter of mode `barrier`. Units: m, s, rad."""

    mode = "barrier"

    _settings: BarrierSettings
    _spec: object
    _limits: Limits
    _outline: Footprint
    _memory: object
    _given: object  # bearings of the rays
    _odometry: object
    _touch: object
    _told_ones: tuple
    _decision: object
    # The settings and what follows from them.
    _others: cython.double
    _unseen_extent: cython.double
    _margin: cython.double
    _braking_linear: cython.double
    _braking_angular: cython.double
    _surface_speed: cython.double
    _is_passive: cython.bint
    _keep_out: cython.double  # NaN: no circle
    _linear_limit: cython.double
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
    _is_box: cython.bint  # a rectangle along the axes, between these places
    _front: cython.double
    _rear: cython.double
    _left: cython.double
    _right: cython.double
    # A chunk of points, for loops that a compiler vectorises: places, what must stay free, age and
    # radius; what separates them from the outline; and a row of each.
    _at_x: cython.double[64]
    _at_y: cython.double[64]
    _at_free: cython.double[64]
    _at_age: cython.double[64]
    _at_radius: cython.double[64]
    _at_least: cython.double[64]
    _at_highest: cython.double[64]
    _at_far: cython.double[64]
    _at_high: cython.double[64]
    _edge_x: cython.double[64]
    _edge_y: cython.double[64]
    _foot_x: cython.double[64]
    _foot_y: cython.double[64]
    _at_gap: cython.double[64]
    _at_nx: cython.double[64]
    _at_ny: cython.double[64]
    _at_lever: cython.double[64]
    _at_hidden: cython.double[64]
    _at_cap: cython.double[64]
    _new_x: cython.double[64]
    _new_y: cython.double[64]
    _new_cap: cython.double[64]
    _new_gap: cython.double[64]
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
    _moved_x: cython.double
    _moved_y: cython.double
    _moved_yaw: cython.double
    _seconds: cython.double
    # The least and greatest commands, 0 included: ahead since the last scan and before it, to the
    # left since then and before. The base responds late, so both explain motion between two scans.
    _least_command: cython.double[4]
    _most_command: cython.double[4]
    # The rays, and the near obstacles of the last scan: contacts first, then by rising gaps.
    _bearings: cython.const[cython.double][::1]
    _directions: cython.double[::1]  # x and y of each ray; x is NaN where they are not known yet
    _points: cython.Py_ssize_t
    _contacts: cython.Py_ssize_t
    _is_near: cython.bint
    _has_contact: cython.bint  # a decision since the last scan found the robot in contact
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
    # The touch zone: speed, direction, cosine of its half width, and rows of nx, ny, x, y.
    _has_touch: cython.bint
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
    _scan_gap: cython.double[::1]  # of seen points, when they were measured
    _radius_of: cython.double[::1]
    _first_row: cython.longlong[::1]
    _normal_x: cython.double[::1]
    _normal_y: cython.double[::1]
    # Of points that the stop check regards: places, gaps, and what these must be now.
    _near_x: cython.double[::1]
    _near_y: cython.double[::1]
    _near_gap: cython.double[::1]
    _near_need: cython.double[::1]
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
    _ranked: cython.Py_ssize_t[4]  # rows to report
    # Two envelopes: while creeping and else.
    _envelope_x: cython.double[::1]
    _envelope_y: cython.double[::1]
    _envelope_cap: cython.double[::1]
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
    _linear: cython.double
    _angular: cython.double
    _min_gap: object

    def __init__(self, platform: Platform) -> None:
        given = platform.protection["barrier"]
        if given is None:
            raise ConfigError(
                f"platform {platform.name}: protection mode barrier has no settings; expected"
                " protection.barrier with others_speed and unseen_extent"
            )
        self._settings = settings = msgspec.convert(given, BarrierSettings)
        self._limits, self._spec = platform.limits, platform.scan
        self._outline = outline = Footprint(platform.footprint)
        is_passive = settings.responsibility == "passive"
        self._others = settings.others_speed
        self._unseen_extent = settings.unseen_extent
        self._margin = settings.margin
        self._braking_linear = settings.braking_linear
        self._braking_angular = settings.braking_angular
        self._is_passive = is_passive
        self._keep_out = math.nan if settings.keep_out is None else settings.keep_out
        self._linear_limit, self._angular_limit = platform.limits.linear, platform.limits.angular
        self._offset_x, self._offset_y = offset = platform.scan.offset
        self._radius = float(np.hypot(*platform.footprint.T).max())
        self._inner, self._outer = outline.circles(offset)
        binding = BindingRange(platform, settings, TICK)
        self._surface_speed, self._stale = binding.surface, binding.stale
        self._fresh, self._fastest = binding.fresh, binding.fastest
        within = settings.envelope_within
        self._within = binding.for_envelope() if within is None else within
        can_hide = platform.scan.near != "reported" and settings.keep_out is None
        self._blind = platform.scan.range_min if can_hide else 0.0
        reserve = settings.side_reserve
        reserve = SIDE_RESERVE * settings.others_speed if reserve is None else reserve
        self._side_reserve = reserve if is_passive else 0.0
        # Where a disc may touch the robot is not known well enough to creep past it.
        self._may_creep = platform.ranges is None and settings.keep_out is None and is_passive
        if platform.scan.near == "lost" and platform.scan.range_min > 0.0:
            speed = settings.others_speed + binding.own
            blind_zone = load_kernel("swarmd.protection.blind_zone")
            self._memory = blind_zone.BlindZoneMemory(
                platform.scan.range_min, speed, 1.0 / platform.scan.rate
            )
        self._edges = len(outline.corners)
        self._corner_x, self._corner_y = (_view(column) for column in outline.corners.T)
        self._axis_x, self._axis_y = (_view(column) for column in outline.axes.T)
        self._origin, self._length = _view(outline.origins), _view(outline.lengths)
        (self._rear, self._right), (self._front, self._left) = (
            outline.corners.min(axis=0),
            outline.corners.max(axis=0),
        )
        is_along = np.isin(outline.axes, (-1.0, 0.0, 1.0)).all()
        self._is_box = self._edges == 4 and bool(is_along)
        self._readings = _doubles(7 * HISTORY)
        self._taken = -_inf
        self._told = self._touch_table = _NO_ROWS
        self._bearings, self._directions = _NO_AGES, _doubles(2)
        self._told_ones, self._decision = (), ModeDecision(ZERO, is_active=False)
        self._reserve_points(64)
        self._reserve_placed(64)
        self._disc = _indices(8)
        self._ray_x, self._ray_y, self._ray_age = _doubles(16), _doubles(16), _doubles(16)
        self._reserve_rows(256)
        count: cython.Py_ssize_t = len(_ENVELOPE_DIRECTIONS)
        self._way_x, self._way_y = _doubles(count), _doubles(count)
        self._envelope_x, self._envelope_y = _doubles(2 * count), _doubles(2 * count)
        self._envelope_cap = _doubles(2 * count)
        self._poly_x, self._poly_y = _doubles(64), _doubles(64)
        self._clip_x, self._clip_y = _doubles(64), _doubles(64)
        self._shares = _SPEED_SHARES

    # The room that the robot needs.

    def clearance(self, speed: float) -> Clearance:
        """The clearance needed to drive at `speed`: ahead, and to each side."""
        i: cython.Py_ssize_t
        settings = self._settings
        corners = self._outline.corners
        age: cython.double = 0.5 / self._spec.rate + self._spec.latency + REACTION_TIME
        front: cython.double = float(corners[:, 0].max())
        ahead: cython.double = 5.0
        for i in range(100):
            if self._fastest_at(0.05 * i, front, age) >= speed:
                ahead = 0.05 * i
                break
        body = float(np.abs(corners[:, 1]).max())
        beside = body + settings.margin + settings.unseen_extent + 0.06
        return Clearance(ahead, max(beside, settings.keep_out or 0.0), body)

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def _fastest_at(
        self, distance: cython.double, front: cython.double, age: cython.double
    ) -> cython.double:
        """The speed ahead that an obstacle at a distance from the axle allows."""
        room: cython.double = distance - front - self._margin - self._unseen_extent
        braking: cython.double = self._braking_linear
        cap: cython.double = _cap(room, braking, age, self._others, self._is_passive)
        if self._keep_out == self._keep_out:
            room = distance - self._offset_x - self._keep_out
            cap = min(cap, _reciprocal_cap(room, braking, age))
        return cap

    def narrowest_passage(self) -> NarrowestPassage:
        """The narrowest door, corridor and meeting that protection lets this robot through.

        At a door, the corners pass posts that may approach while they are not seen, unless the
        robot may creep. Along the sides of a corridor the gap also leaves the side constraints
        `_CORRIDOR_SPEED`. Each gap is `_PASSAGE_SLACK` wider: the nearest of noisy returns is
        nearer than the surface. A robot that is seen whole creeps past it even in contact.
        """
        settings = self._settings
        width = 2.0 * float(np.abs(self._outline.corners[:, 1]).max())
        age = self._spec.latency + REACTION_TIME
        others = settings.others_speed if settings.responsibility == "passive" else 0.0
        post = settings.margin + settings.unseen_extent + others * (age + TICK) + _PASSAGE_SLACK
        mean_age = age + 0.5 / self._spec.rate
        contact = self._contact_gap_beside()
        rest = _CORRIDOR_SPEED * math.sin(SIDE_ANGLE) + self._side_reserve
        side = contact + 2.0 * (mean_age + TICK) * rest + _PASSAGE_SLACK
        creeping = post
        if self._may_creep:
            slack = _PASSAGE_SLACK if settings.unseen_extent > 0.0 else 0.0
            creeping = contact + 2.0 * (mean_age + TICK) * CREEP_SPEED + slack
        if settings.keep_out is not None:
            side = post = max(side, post, settings.keep_out + _PASSAGE_SLACK - 0.5 * width)
        door = width + 2.0 * min(creeping, post)
        corridor = max(door, width + 2.0 * side)
        return NarrowestPassage(door, corridor, corridor + width + post)

    def _contact_gap_beside(self) -> float:
        """m from the outline within which a wall along the way may touch the robot unseen."""
        corners = self._outline.corners[:, 0]
        hidden: cython.double = 0.0
        for x in np.linspace(corners.min(), corners.max(), _PLACES_BESIDE).tolist():
            for y in (-2.0 * self._outer, 2.0 * self._outer):
                self._at_x[0], self._at_y[0] = x, y
                self._separate(1, self._blind)
                hidden = _maximum(hidden, self._at_hidden[0])
        return self._margin + self._unseen_extent + hidden

    # What an arbiter is given, and its decisions.

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """Take in a new scan: find the returns that are near enough to constrain the robot.

        The time of a scan is that of its newest ray. A scan that lacks a sector has the age of what
        the conditioner remembers of that sector. A scan that is not newer than the last one by this
        age is ignored: the last one is dead-reckoned, the remembered sector is not.
        """
        if context.odometry is not None:
            self._record(context.odometry)
        if scan.bearings is not self._given:  # those of a robot that turns differ with each scan
            self._set_bearings(scan.bearings)
        ranges = _view(scan.ranges)
        ages = _NO_AGES if scan.ages is None else _view(scan.ages)
        age: cython.double = context.scan_age or 0.0
        odometry_age: cython.double = context.odometry_age or 0.0
        newest = self._newest_age(scan)
        if not self._begin_scan(context.now, age, newest, context.scan_delay, odometry_age, ages):
            self._find_min_gap(ranges, scan.range_min)
            return
        hidden = _NO_ROWS
        memory = self._memory
        if memory is not None:
            moved = Pose(self._moved_x, self._moved_y, self._moved_yaw)
            memory.update(scan, geometry, moved, self._driven(), self._seconds)
            if len(memory.bearings):
                hidden = _view(_rays_and_ranges(memory.bearings, memory.nearest))
        self._take_scan(ranges, scan.range_min, ages, hidden)

    @cython.cfunc
    def _set_bearings(self, bearings):
        """Take the rays of other bearings; their directions are found when they are needed."""
        i: cython.Py_ssize_t
        count: cython.Py_ssize_t = len(bearings)
        self._given, self._bearings = bearings, _view(bearings)
        if len(self._directions) < 2 * count:
            self._directions = _doubles(2 * count)
        directions: cython.p_double = _first(self._directions, 2 * count)
        for i in range(count):
            directions[2 * i] = _nan

    def _newest_age(self, scan):
        """How old the newest ray of a scan was on arrival in s, by the platform's latency.

        Rays of the scan before, which fill a sector that a turn left unmeasured, change the mean of
        the ages, but not this age; so conditioning tells it.
        """
        if scan.newest_age is not None:
            return scan.newest_age
        ages = scan.ages
        mean = float(ages.mean()) if ages is not None and len(ages) else 0.0
        return max(self._spec.latency - mean, 0.0)

    @property
    def min_gap(self) -> float | None:
        """The m from the outline to the nearest return of the last scan; None without a return."""
        return self._min_gap

    def check_indices(self) -> None:
        """ValueError unless each count is within its array; see `recall`."""
        points, rows = len(self._x), len(self._row_x)
        if not (0 <= self._contacts <= points and 0 <= self._points <= points):
            raise ValueError(f"{self._contacts} contacts of {self._points} points in {points}")
        if not (0 <= self._rows <= rows and 0 <= self._all <= rows):
            raise ValueError(f"{self._rows} rows of {self._all} in {rows}")
        if not (0 <= self._count <= len(self._placed_x) and 0 <= self._discs <= len(self._disc)):
            raise ValueError(f"{self._count} points and {self._discs} discs are placed")
        if not (0 <= self._beside <= len(self._near_x) and 0 <= self._edges < 1 << 16):
            raise ValueError(f"{self._beside} points beside {self._edges} edges")

    def decide(
        self, requested: Twist, context: DecisionContext, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The feasible command nearest to `requested`; `requested` itself if it is feasible."""
        odometry = context.odometry
        if odometry is not None and odometry is not self._odometry:
            self._record(odometry)
        if touch is not self._touch and touch != self._touch:
            self._grant(touch)
        told = context.told + context.near if context.near else context.told
        if told is not self._told_ones and told != self._told_ones:
            self._set_told(told)
        self._find_discs()
        self._note_command(0, command.linear)
        self._note_command(2, command.lateral)
        is_free: cython.bint = not (self._has_touch or self._is_near or self._points or self._discs)
        along_x: cython.double = 1.0
        along_y: cython.double = 0.0
        speed: cython.double = requested.linear
        angular: cython.double = requested.angular
        lateral: cython.double = requested.lateral
        if is_free or (speed == 0.0 and angular == 0.0 and lateral == 0.0):
            return _decided(requested, False)
        if self._scan_resets != self._resets:  # the last scan has no valid pose any more
            return _decided(ZERO, True)
        limit: cython.double = self._linear_limit
        if lateral != 0.0:
            speed = hypot(requested.linear, lateral)
            along_x, along_y = requested.linear / speed, lateral / speed
            limit = linear_limit(self._limits, along_x, along_y)
        is_same: cython.bint = self._keep_situation(
            context.now,
            _nan if context.scan_age is None else context.scan_age,
            _nan if context.odometry_age is None else context.odometry_age,
            -1 if odometry is None else self._version,
            along_x,
            along_y,
        )
        if not is_same:
            self._limit = limit
            self._build(command.linear, command.angular, command.lateral)
            self._has_situation = True
        elif self._is_decided and self._asked_speed == speed and self._asked_angular == angular:
            return self._decision if self._is_limited else _decided(requested, False)
        self._is_decided = False
        self._asked_speed, self._asked_angular = speed, angular
        self._is_limited = self._judge(speed, angular)
        self._is_decided = True
        if not self._is_limited:
            return _decided(requested, False)
        twist = Twist(self._linear * along_x, self._angular, self._linear * along_y)
        self._decision = _decided(twist, True, self._report())
        return self._decision

    @cython.cfunc
    @cython.exceptval(-1)
    def _keep_situation(
        self,
        now: cython.double,
        scan_age: cython.double,
        odometry_age: cython.double,
        version: cython.Py_ssize_t,
        along_x: cython.double,
        along_y: cython.double,
    ) -> cython.int:
        """1 if the constraints of the last decision hold again; else take the new situation."""
        if (
            self._has_situation
            and self._now == now
            and self._at_version == version
            and _same(self._scan_age, scan_age)
            and _same(self._odometry_age, odometry_age)
            and self._along_x == along_x
            and self._along_y == along_y
        ):
            return 1
        self._has_situation = self._is_decided = False
        self._now, self._scan_age, self._odometry_age = now, scan_age, odometry_age
        self._at_version = version
        self._along_x, self._along_y = along_x, along_y
        return 0

    # Dead reckoning.

    @cython.cfunc
    def _record(self, odometry):
        """Record a reading of odometry if it is new.

        A new reading whose stamp does not rise, or whose pose jumps, is a reset: poses before it
        are not valid any more.
        """
        self._odometry = odometry
        pose, twist = odometry.pose, odometry.twist
        stamp: cython.double = odometry.stamp
        x: cython.double = pose.x
        y: cython.double = pose.y
        yaw: cython.double = pose.yaw
        linear: cython.double = twist.linear
        angular: cython.double = twist.angular
        lateral: cython.double = twist.lateral
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
        """The pose at which the next command takes effect.

        From the last reading on the robot approaches the present command at its lowest rates.
        """
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

    @cython.cfunc
    def _begin_scan(
        self,
        now: cython.double,
        age: cython.double,
        newest_age: cython.double,
        delay: cython.double,
        odometry_age: cython.double,
        ages: cython.const[cython.double][::1],
    ):
        """False if a scan is not newer than the last one; else the motion between the two.

        `newest_age`: how old its newest ray was on arrival by the platform's latency; `delay`: how
        much later than that it arrives. `ages` (n,) of its rays; empty: all are 0.
        """
        i: cython.Py_ssize_t
        oldest: cython.double = 0.0
        for i in range(len(ages)):
            if ages[i] > oldest:
                oldest = ages[i]
        latency: cython.double = newest_age + delay
        taken: cython.double = now - latency - age
        if age > 0.0 and taken < self._taken + _AGE_TOLERANCE:
            return False
        self._oldest, self._late = oldest, delay + oldest
        self._seconds = _maximum(taken - self._taken, 0.0)
        if self._scan_resets != self._resets:  # the motion since the last scan by the speed alone
            self._pose(odometry_age, latency + min(self._seconds, self._stale))
            self._taken_x, self._taken_y = self._pose_x, self._pose_y
            self._taken_yaw = self._pose_yaw
        self._pose(odometry_age, latency)
        dx: cython.double = self._pose_x - self._taken_x
        dy: cython.double = self._pose_y - self._taken_y
        c: cython.double = cos(self._taken_yaw)
        s: cython.double = sin(self._taken_yaw)
        self._moved_x, self._moved_y = c * dx + s * dy, c * dy - s * dx
        self._moved_yaw = self._pose_yaw - self._taken_yaw
        self._taken_x, self._taken_y, self._taken_yaw = self._pose_x, self._pose_y, self._pose_yaw
        self._taken, self._lag, self._scan_resets = taken, age, self._resets
        return True

    @cython.cfunc
    @cython.exceptval(-1)
    def _note_command(self, along: cython.Py_ssize_t, speed: cython.double) -> cython.int:
        """Note the command in force since the last decision: ahead (0) or to the left (2)."""
        self._least_command[along] = min(self._least_command[along], speed)
        self._most_command[along] = _maximum(self._most_command[along], speed)
        return 0

    @cython.cfunc
    def _driven(self):
        """The part of the motion between the last two scans that the robot's commands explain."""
        half: cython.double = 0.5 * self._moved_yaw  # along the chord of its arc
        c: cython.double = cos(half)
        s: cython.double = sin(half)
        ahead: cython.double = self._explained(0, c * self._moved_x + s * self._moved_y)
        left: cython.double = self._explained(2, c * self._moved_y - s * self._moved_x)
        return Pose(c * ahead - s * left, s * ahead + c * left, self._moved_yaw)

    @cython.cfunc
    @cython.exceptval(check=False)
    def _explained(self, along: cython.Py_ssize_t, moved: cython.double) -> cython.double:
        """The m of a motion between two scans that commands explain, which then begin anew."""
        least: cython.double = min(self._least_command[along], self._least_command[along + 1])
        most: cython.double = _maximum(self._most_command[along], self._most_command[along + 1])
        self._least_command[along + 1], self._least_command[along] = self._least_command[along], 0.0
        self._most_command[along + 1], self._most_command[along] = self._most_command[along], 0.0
        seconds: cython.double = min(self._seconds, self._stale)  # then the robot is held
        least *= seconds
        most *= seconds
        if not moved >= least:  # NaN too
            return least
        return moved if moved <= most else most

    @cython.cfunc
    def _find_min_gap(self, ranges: cython.const[cython.double][::1], range_min: cython.double):
        """Set the m to the nearest return; None without a return."""
        i: cython.Py_ssize_t
        nearest: cython.double = _inf
        for i in range(len(ranges)):
            if ranges[i] < nearest:
                nearest = ranges[i]
        within: cython.double = self._ring(nearest, range_min)
        smallest: cython.double = _inf
        for i in range(len(ranges)):
            if ranges[i] <= within:
                away: cython.double = range_min if ranges[i] < range_min else ranges[i]
                self._find_direction(i)
                x: cython.double = self._offset_x + away * self._directions[2 * i]
                y: cython.double = self._offset_y + away * self._directions[2 * i + 1]
                gap: cython.double = self._gap_of(x, y)
                if gap < smallest:
                    smallest = gap
        self._set_min_gap(nearest, smallest)

    @cython.cfunc
    @cython.exceptval(-1)
    def _find_direction(self, ray: cython.Py_ssize_t) -> cython.int:
        """Put the direction of a ray into `_directions`."""
        bearing: cython.double = self._bearings[ray]
        self._directions[2 * ray], self._directions[2 * ray + 1] = cos(bearing), sin(bearing)
        return 0

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
            self._min_gap = None
        else:
            self._min_gap = 0.0 if nearest == -_inf else smallest
        return 0

    @cython.cfunc
    def _take_scan(
        self,
        ranges: cython.const[cython.double][::1],
        range_min: cython.double,
        ages: cython.const[cython.double][::1],
        hidden: cython.double[:, ::1],
    ):
        """Find the near obstacles of a scan, and among `hidden` (m, 3): rays, and m from the lidar.

        `ages` (n,) of the rays; empty: all are 0.
        A hidden obstacle that may touch the robot counts as a return too close to measure. A scan
        that is refused leaves the obstacles of the last scan.
        """
        count: cython.Py_ssize_t = len(ranges)
        unseen: cython.Py_ssize_t = len(hidden)
        if count > len(self._bearings):
            raise IndexError(f"{count} ranges, but {len(self._bearings)} rays")
        directions: cython.p_double = _first(self._directions, 2 * count)
        has_ages: cython.bint = len(ages) > 0
        if has_ages and len(ages) != count:
            raise IndexError(f"{count} ranges, but {len(ages)} ages")
        self._reserve_points(count + unseen)
        if len(self._ray_x) < count + unseen:
            self._ray_x, self._ray_y = _doubles(count + unseen), _doubles(count + unseen)
            self._ray_age = _doubles(count + unseen)
        self._has_situation = self._has_contact = False
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
        found_x: cython.p_double = _first(self._found_x, count + unseen)
        found_y: cython.p_double = _first(self._found_y, count + unseen)
        found_gap: cython.p_double = _first(self._found_gap, count + unseen)
        found_age: cython.p_double = _first(self._found_age, count + unseen)
        for i in range(count):
            away: cython.double = ranges[i]
            if not (away <= outermost or away <= ring):
                continue
            if directions[2 * i] != directions[2 * i]:
                self._find_direction(i)
            if away == -_inf:
                self._ray_x[contacts] = directions[2 * i]
                self._ray_y[contacts] = directions[2 * i + 1]
                self._ray_age[contacts] = ages[i] if has_ages else 0.0
                contacts += 1
            else:
                away = range_min if away < range_min else away
                found_x[found] = self._offset_x + away * directions[2 * i]
                found_y[found] = self._offset_y + away * directions[2 * i + 1]
                gap: cython.double = self._gap_of(found_x[found], found_y[found])
                found_gap[found] = gap
                found_age[found] = ages[i] if has_ages else 0.0
                if gap < smallest:
                    smallest = gap
                if ranges[i] <= outermost:
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
                found_x[found], found_y[found], found_gap[found] = x, y, gap
                found_age[found] = self._oldest
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
        _take(self._found_x, self._order, found, self._x, contacts)
        _take(self._found_y, self._order, found, self._y, contacts)
        _take(self._found_gap, self._order, found, self._gap, contacts)
        _take(self._found_age, self._order, found, self._age, contacts)
        self._points, self._contacts = contacts + found, contacts

    @cython.cfunc
    @cython.exceptval(-1)
    def _sort(self, count: cython.Py_ssize_t) -> cython.int:
        """Merge sort of runs that are sorted by insertion; equal gaps keep their order."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        first: cython.Py_ssize_t
        middle: cython.Py_ssize_t
        end: cython.Py_ssize_t
        run: cython.Py_ssize_t = 8
        gaps: cython.p_double = _first(self._found_gap, count)
        order: cython.p_longlong = _first_index(self._order, count)
        spare: cython.p_longlong = _first_index(self._spare, count)
        for i in range(count):
            gap: cython.double = gaps[i]
            first, j = i - i % run, i
            while j > first and gaps[order[j - 1]] > gap:
                order[j] = order[j - 1]
                j -= 1
            order[j] = i
        while run < count:
            first = 0
            while first < count:
                middle = min(first + run, count)
                end = min(first + 2 * run, count)
                i, j = first, middle
                for k in range(first, end):
                    if i < middle and (j >= end or gaps[order[i]] <= gaps[order[j]]):
                        spare[k] = order[i]
                        i += 1
                    else:
                        spare[k] = order[j]
                        j += 1
                first = end
            order, spare = spare, order
            self._order, self._spare = self._spare, self._order
            run *= 2
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _reserve_points(self, count: cython.Py_ssize_t) -> cython.int:
        """Buffers for so many points of a scan."""
        if self._x is not None and len(self._x) >= count:
            return 0
        count += count // 2
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
        if self._placed_x is not None and len(self._placed_x) >= count:
            return 0
        count += count // 2  # or they would be made anew with each point more
        self._placed_x, self._placed_y = _doubles(count), _doubles(count)
        self._placed_gap, self._placed_free = _doubles(count), _doubles(count)
        self._placed_age, self._radius_of = _doubles(count), _doubles(count)
        self._placed_contact, self._scan_gap = _doubles(count), _doubles(count)
        self._normal_x, self._normal_y = _doubles(count), _doubles(count)
        self._near_x, self._near_y = _doubles(count), _doubles(count)
        self._near_gap, self._near_need = _doubles(count), _doubles(count)
        self._inside = _indices(count)
        self._first_row = _indices(count)
        return 0

    # The outline.

    @cython.cfunc
    @cython.exceptval(-1.0, check=True)
    def _gap_of(self, x: cython.double, y: cython.double) -> cython.double:
        """The distance in m from the outline to a point; 0 for a point inside.

        A rectangle along the axes needs fewer operations; its result differs by 1e-16.
        """
        k: cython.Py_ssize_t
        edges: cython.Py_ssize_t = self._edges
        least: cython.double = _inf
        if self._is_box and x == x and y == y:
            ahead: cython.double = x - self._front if x > self._front else self._rear - x
            aside: cython.double = y - self._left if y > self._left else self._right - y
            ahead = ahead if ahead > 0.0 else 0.0
            aside = aside if aside > 0.0 else 0.0
            return sqrt(aside * aside + ahead * ahead)
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
    def _separate(self, count: cython.Py_ssize_t, blind: cython.double) -> cython.int:
        """Gap, direction, lever and hidden gap of the first `count` points of the chunk.

        The hidden gap is how far a blind zone of radius `blind` m reaches beyond the outline
        towards the point. An obstacle that is seen at the point continues unseen only within that
        circle around the lidar. It is left at this gap on the shortest line from the outline to
        the point.
        """
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        x: cython.p_double = self._at_x
        y: cython.p_double = self._at_y
        least: cython.p_double = self._at_least
        highest: cython.p_double = self._at_highest
        far: cython.p_double = self._at_far
        high: cython.p_double = self._at_high
        edge_x: cython.p_double = self._edge_x
        edge_y: cython.p_double = self._edge_y
        foot_x: cython.p_double = self._foot_x
        foot_y: cython.p_double = self._foot_y
        for j in range(count):
            least[j], highest[j], far[j], high[j] = _inf, -_inf, 0.0, 0.0
            edge_x[j] = edge_y[j] = foot_x[j] = foot_y[j] = 0.0
        for k in range(self._edges):
            ax: cython.double = self._axis_x[k]
            ay: cython.double = self._axis_y[k]
            bx: cython.double = self._axis_x[self._edges + k]
            by: cython.double = self._axis_y[self._edges + k]
            start: cython.double = self._origin[k]
            base: cython.double = self._origin[self._edges + k]
            length: cython.double = self._length[k]
            corner_x: cython.double = self._corner_x[k]
            corner_y: cython.double = self._corner_y[k]
            for j in range(count):
                along: cython.double = ax * x[j] + ay * y[j] - start
                above: cython.double = bx * x[j] + by * y[j] - base
                on: cython.double = along if along > 0.0 else 0.0
                on = length if on > length else on
                beyond: cython.double = along - on
                square: cython.double = beyond * beyond + above * above
                is_nearer: cython.bint = (square < least[j]) | (square != square)
                # A choice between values that are known before is one that a compiler vectorises.
                was_far: cython.double = far[j]
                was_high: cython.double = high[j]
                was_edge_x: cython.double = edge_x[j]
                was_edge_y: cython.double = edge_y[j]
                was_foot_x: cython.double = foot_x[j]
                was_foot_y: cython.double = foot_y[j]
                was_least: cython.double = least[j]
                was_highest: cython.double = highest[j]
                far[j] = beyond if is_nearer else was_far
                high[j] = above if is_nearer else was_high
                edge_x[j] = ax if is_nearer else was_edge_x
                edge_y[j] = ay if is_nearer else was_edge_y
                foot_x[j] = corner_x + on * ax if is_nearer else was_foot_x
                foot_y[j] = corner_y + on * ay if is_nearer else was_foot_y
                least[j] = square if is_nearer else was_least
                highest[j] = above if above > was_highest else was_highest
        offset_x: cython.double = self._offset_x
        offset_y: cython.double = self._offset_y
        for j in range(count):
            is_inside: cython.bint = (highest[j] <= 0.0) & (least[j] == least[j])
            gap: cython.double = sqrt(least[j])
            gap = 0.0 if is_inside else gap
            is_on: cython.bint = gap < 1e-9
            inverse: cython.double = 1.0 / (1.0 if is_on else gap)
            out: cython.double = far[j] * inverse
            up: cython.double = high[j] * inverse
            out = 0.0 if is_on else out
            up = 1.0 if is_on else up
            nx: cython.double = out * edge_x[j] + up * edge_y[j]
            ny: cython.double = out * edge_y[j] - up * edge_x[j]
            dx: cython.double = x[j] - offset_x
            dy: cython.double = y[j] - offset_y
            across: cython.double = dx * ny - dy * nx
            half: cython.double = blind * blind - across * across  # square of half of the chord
            hidden: cython.double = sqrt(half) - (dx * nx + dy * ny - gap)
            hidden = hidden if (half > 0.0) & (hidden > 0.0) else 0.0
            self._at_gap[j], self._at_nx[j], self._at_ny[j] = gap, nx, ny
            self._at_lever[j], self._at_hidden[j] = foot_x[j] * ny - foot_y[j] * nx, hidden
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

    @cython.cfunc
    def _grant(self, zone):
        """Grant a touch zone; None: no zone."""
        self._touch, self._has_touch, self._has_situation = zone, zone is not None, False
        if zone is not None:
            self._touch_speed, self._touch_cos = zone.speed, cos(zone.half_width)
            self._touch_x, self._touch_y = cos(zone.bearing), sin(zone.bearing)
            self._touch_table = _view(np.stack(touch_directions(self._outline.corners, zone), 1))

    # Told obstacles.

    @cython.cfunc
    def _set_told(self, told):
        """The obstacles that the robot is told of."""
        self._told_ones, self._has_situation = told, False
        table = [(one.x, one.y, one.radius, one.age) for one in told]
        self._told = _view(np.array(table, np.float64).reshape(-1, 4))
        if len(self._disc) < len(told):
            self._disc = _indices(len(told))

    @cython.cfunc
    @cython.exceptval(-1)
    def _find_discs(self) -> cython.int:
        """Those of the told obstacles which can bind the robot."""
        i: cython.Py_ssize_t
        told: cython.double[:, ::1] = self._told
        self._discs = 0
        for i in range(len(told)):
            gap: cython.double = hypot(told[i, 0], told[i, 1]) - told[i, 2] - self._radius
            age: cython.double = told[i, 3] + _reaction
            if not (gap > self._fresh + (self._others + self._fastest) * age):
                self._disc[self._discs] = i
                self._discs += 1
        return 0

    # The decision.

    @cython.cfunc
    @cython.exceptval(-1)
    def _judge(self, speed: cython.double, angular: cython.double) -> cython.int:
        """1 if a request must be limited, to `linear` and `angular`."""
        wanted_x: cython.double = speed / self._limit
        wanted_y: cython.double = angular / self._angular_limit
        if self._is_creeping:
            self._end_creeping()
        self._project(wanted_x, wanted_y)
        self._linear = self._point_x * self._limit
        self._angular = self._point_y * self._angular_limit
        is_reduced: cython.bint = self._limit_stop()
        if not is_reduced and self._point_x == wanted_x and self._point_y == wanted_y:
            return 0
        if self._creep_cap > 0.0 and 0.0 < fabs(speed) <= SLOW_REQUEST:
            x: cython.double = self._point_x
            y: cython.double = self._point_y
            off: cython.double = hypot(
                self._linear / self._limit - wanted_x,
                self._angular / self._angular_limit - wanted_y,
            )
            self._begin_creeping()
            self._project(wanted_x, wanted_y)
            if hypot(self._point_x - wanted_x, self._point_y - wanted_y) < off - CREEP_GAIN:
                self._linear = self._point_x * self._limit
                self._angular = self._point_y * self._angular_limit
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
        contacts: cython.Py_ssize_t = min(self._contacts, count)
        touch_rows: cython.Py_ssize_t = len(self._touch_table) if self._has_touch else 0
        self._reserve_placed(count + self._discs)
        self._reserve_rows(
            (count + self._discs) * (6 + self._edges) + contacts + touch_rows + len(self._way_x)
        )
        self._rows = 0
        i: cython.Py_ssize_t
        first: cython.Py_ssize_t = 0
        point: cython.Py_ssize_t = 0
        gaps: cython.p_double = _first(self._gap, count)
        ages: cython.p_double = _first(self._age, count)
        xs: cython.p_double = _first(self._x, count)
        ys: cython.p_double = _first(self._y, count)
        while point < count:
            i = 0
            while point < count and i < _CHUNK:
                # A later ray leaves an obstacle less time to come near: a tenth drops out.
                if not (gaps[point] >= self._binding_range(age + ages[point])):
                    x: cython.double = xs[point]
                    y: cython.double = ys[point]
                    self._at_x[i] = frame_x + c * x - s * y
                    self._at_y[i] = frame_y + s * x + c * y
                    self._at_free[i], self._at_age[i] = self._free, age + ages[point]
                    self._at_radius[i] = 0.0
                    self._scan_gap[first + i] = gaps[point]
                    i += 1
                point += 1
            n: cython.Py_ssize_t = i
            self._add_points(first, n, self._blind)
            if self._unseen_extent > 0.0:
                self._add_corners(first, max(contacts - first, 0), n)
            if self._keep_out == self._keep_out:
                self._add_keep_out(first, n)
            first += n
        self._count = count = first
        for i in range(contacts):
            self._row_cap[self._first_row[i]] = 0.0
            nx: cython.double = c * self._ray_x[i] - s * self._ray_y[i]
            ny: cython.double = s * self._ray_x[i] + c * self._ray_y[i]
            lever: cython.double = self._placed_x[i] * ny - self._placed_y[i] * nx
            self._add(nx * self._along_x + ny * self._along_y, lever, 0.0, 0.0, i)
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
            self._creep_cap = CREEP_SPEED
            for i in range(count):
                rest: cython.double = 0.5 * (self._placed_gap[i] - self._placed_contact[i])
                rest /= self._placed_age[i] + _tick
                self._creep_cap = min(self._creep_cap, rest)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _add_points(
        self, first: cython.Py_ssize_t, count: cython.Py_ssize_t, blind: cython.double
    ) -> cython.int:
        """Rows for the points of the chunk, which become those from `first` on."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        at: cython.Py_ssize_t = self._rows
        nx: cython.p_double = self._at_nx
        ny: cython.p_double = self._at_ny
        lever: cython.p_double = self._at_lever
        gap: cython.p_double = self._at_gap
        free: cython.p_double = self._at_free
        age: cython.p_double = self._at_age
        cap: cython.p_double = self._at_cap
        new_x: cython.p_double = self._new_x
        new_y: cython.p_double = self._new_y
        along_x: cython.double = self._along_x
        along_y: cython.double = self._along_y
        limit: cython.double = self._limit
        angular_limit: cython.double = self._angular_limit
        slowing: cython.double = self._braking_linear
        turning: cython.double = self._braking_angular
        others: cython.double = self._others
        is_passive: cython.bint = self._is_passive
        self._separate(count, blind)
        for j in range(count):
            linear: cython.double = nx[j] * along_x + ny[j] * along_y
            braking: cython.double = _braking(linear, lever[j], slowing, turning)
            cap[j] = _cap(gap[j] - free[j], braking, age[j], others, is_passive)
            new_x[j], new_y[j] = linear * limit, lever[j] * angular_limit
        end: cython.Py_ssize_t = first + count
        placed_x: cython.p_double = _first(self._placed_x, end)
        placed_y: cython.p_double = _first(self._placed_y, end)
        placed_free: cython.p_double = _first(self._placed_free, end)
        placed_age: cython.p_double = _first(self._placed_age, end)
        placed_contact: cython.p_double = _first(self._placed_contact, end)
        placed_gap: cython.p_double = _first(self._placed_gap, end)
        normal_x: cython.p_double = _first(self._normal_x, end)
        normal_y: cython.p_double = _first(self._normal_y, end)
        radius_of: cython.p_double = _first(self._radius_of, end)
        row_x: cython.p_double = _first(self._row_x, at + count)
        row_y: cython.p_double = _first(self._row_y, at + count)
        row_cap: cython.p_double = _first(self._row_cap, at + count)
        row_gap: cython.p_double = _first(self._row_gap, at + count)
        for j in range(count):
            i = first + j
            placed_x[i], placed_y[i] = self._at_x[j], self._at_y[j]
            placed_free[i], placed_age[i] = free[j], age[j]
            placed_contact[i] = free[j] + self._at_hidden[j]
            normal_x[i], normal_y[i], placed_gap[i] = nx[j], ny[j], gap[j]
            radius_of[i] = self._at_radius[j]
            row_x[at + j], row_y[at + j], row_cap[at + j] = new_x[j], new_y[j], cap[j]
            row_gap[at + j] = gap[j] - self._at_radius[j]
        first_row: cython.p_longlong = _first_index(self._first_row, end)
        source: cython.p_longlong = _first_index(self._source, at + count)
        for j in range(count):
            first_row[first + j], source[at + j] = at + j, first + j
        self._rows = at + count
        self._add_approaching(first, count)
        return self._add_sides(first, count)

    @cython.cfunc
    @cython.exceptval(-1)
    def _add_told(self, odometry_age: cython.double, late: cython.double) -> cython.int:
        """The rows of the discs that the robot is told of.

        The gap to a disc is that to its centre less its radius, along the same line. So its radius
        adds to what must stay free around the centre, as that of unseen parts does for returns.
        """
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
            self._at_x[0], self._at_y[0] = c * dx + s * dy + x, c * dy - s * dx + y
            self._at_free[0] = least + late * self._surface_speed
            self._at_age[0], self._at_radius[0] = told[n, 3] + _reaction, radius
            self._add_points(i, 1, 0.0)
            self._add_corners(i, 0, 1)
        return 0

    @cython.cfunc
    @cython.inline
    @cython.exceptval(check=False)
    def _binding_range(self, age: cython.double) -> cython.double:
        """The gap in m beyond which nothing binds; see BindingRange.for_scan_age."""
        gap: cython.double = self._fresh + (self._others + self._fastest) * age
        if self._keep_out != self._keep_out:
            return gap
        speed: cython.double = self._fastest
        half: cython.double = speed * (2.0 * _tick + age + 0.5 * speed / self._braking_linear)
        other: cython.double = self._keep_out + 2.0 * half + speed * age
        return other if other > gap else gap

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
    def _add_sides(self, first: cython.Py_ssize_t, count: cython.Py_ssize_t) -> cython.int:
        """Two rows for each point of the chunk whose cap is 0: obstacles that are passed sideways.

        A robot that slides along a face does not close on it, as long as the face stands still. Two
        robots that slide towards the same place each pass what they saw there last, until their
        corners meet: a moving obstacle may no longer be where it was seen. So the corners that are
        foremost 60 degrees to either side of the obstacle may approach only so fast that two such
        robots do not touch before both have a new scan. The creep speed is always allowed. Moving
        away stays free.
        """
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        side: cython.Py_ssize_t
        nx: cython.p_double = self._at_nx
        ny: cython.p_double = self._at_ny
        gap: cython.p_double = self._at_gap
        cap: cython.p_double = self._at_cap
        most: cython.p_double = self._at_least
        lever: cython.p_double = self._at_highest
        ax: cython.p_double = self._edge_x
        ay: cython.p_double = self._edge_y
        while count > 0 and not (cap[count - 1] <= 0.0):
            count -= 1
        for side in range(2):
            turn: cython.double = _side_sin if side == 0 else -_side_sin
            for j in range(count):
                ax[j] = _side_cos * nx[j] - turn * ny[j]
                ay[j] = turn * nx[j] + _side_cos * ny[j]
                most[j], lever[j] = -_inf, 0.0
            for k in range(self._edges):
                own_x: cython.double = self._corner_x[k]
                own_y: cython.double = self._corner_y[k]
                for j in range(count):
                    ahead: cython.double = own_x * ax[j] + own_y * ay[j]
                    swung: cython.double = own_x * ay[j] - own_y * ax[j]
                    was_most: cython.double = most[j]
                    was_lever: cython.double = lever[j]
                    lever[j] = swung if ahead > was_most else was_lever
                    most[j] = ahead if ahead > was_most else was_most
            at: cython.Py_ssize_t = self._rows
            row_x: cython.p_double = _first(self._row_x, at + count)
            row_y: cython.p_double = _first(self._row_y, at + count)
            row_cap: cython.p_double = _first(self._row_cap, at + count)
            row_gap: cython.p_double = _first(self._row_gap, at + count)
            for j in range(count):
                if cap[j] <= 0.0:
                    rest: cython.double = 0.5 * (gap[j] - (self._at_free[j] + self._at_hidden[j]))
                    rest /= self._at_age[j] + _tick
                    rest -= self._side_reserve
                    linear: cython.double = ax[j] * self._along_x + ay[j] * self._along_y
                    row_x[at], row_y[at] = linear * self._limit, lever[j] * self._angular_limit
                    row_cap[at] = _maximum(rest, CREEP_SPEED)
                    row_gap[at], self._source[at] = gap[j] - self._at_radius[j], first + j
                    at += 1
            self._rows = at
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _add_approaching(self, first: cython.Py_ssize_t, count: cython.Py_ssize_t) -> cython.int:
        """At most one row for each way along the motion: obstacles that come from the side.

        No motion closes on an obstacle beside the robot, until it slides to a corner. Its side
        rows begin when its cap is 0: too late to brake, a Waffle Pi was still at 0.09 m/s then. So
        the robot brakes before, to the speed that these rows then allow. The time until the cap is
        0 leaves a tick, for which the command stands. A turn is not braked for here: its brake
        takes nothing off a speed ahead, and the stop check regards what swings outwards.
        """
        j: cython.Py_ssize_t
        if self._side_reserve <= 0.0:
            return 0
        others: cython.double = self._others
        slowing: cython.double = self._braking_linear
        early: cython.double = others * self._limit / slowing  # m it moves while the robot brakes
        ahead: cython.double = self._limit
        back: cython.double = self._limit
        of_ahead: cython.Py_ssize_t = -1
        of_back: cython.Py_ssize_t = -1
        for j in range(count):
            nx: cython.double = self._at_nx[j]
            ny: cython.double = self._at_ny[j]
            age: cython.double = self._at_age[j] + _tick
            left: cython.double = self._at_gap[j] - self._at_free[j] - others * age
            if not 0.0 < left < early:
                continue
            if self._has_touch and nx * self._touch_x + ny * self._touch_y >= self._touch_cos:
                continue
            rest: cython.double = 0.5 * (others - self._at_hidden[j] / age)
            rest = _maximum(rest - self._side_reserve, CREEP_SPEED)
            shed: cython.double = slowing * left / others
            along: cython.double = _side_cos * (nx * self._along_x + ny * self._along_y)
            aside: cython.double = _side_sin * fabs(nx * self._along_y - ny * self._along_x)
            if aside + along > 0.0 and rest / (aside + along) + shed < ahead:
                ahead, of_ahead = rest / (aside + along) + shed, j
            if aside - along > 0.0 and rest / (aside - along) + shed < back:
                back, of_back = rest / (aside - along) + shed, j
        if of_ahead >= 0:
            gap: cython.double = self._at_gap[of_ahead] - self._at_radius[of_ahead]
            self._add(1.0, 0.0, ahead, gap, first + of_ahead)
        if of_back >= 0:
            gap = self._at_gap[of_back] - self._at_radius[of_back]
            self._add(-1.0, 0.0, back, gap, first + of_back)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _add_corners(
        self, first: cython.Py_ssize_t, begin: cython.Py_ssize_t, end: cython.Py_ssize_t
    ) -> cython.int:
        """A row of each own corner for each near point, which extends beyond its visible part.

        Then the nearest place of the outline is not the only one that can touch the obstacle: a
        corner that swings past it can, too. The points are those of the chunk from `begin` to
        `end`; its first one is point `first`.
        """
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        x: cython.p_double = self._at_x
        y: cython.p_double = self._at_y
        gap: cython.p_double = self._at_gap
        free: cython.p_double = self._at_free
        age: cython.p_double = self._at_age
        new_x: cython.p_double = self._new_x
        new_y: cython.p_double = self._new_y
        new_cap: cython.p_double = self._new_cap
        new_gap: cython.p_double = self._new_gap
        along_x: cython.double = self._along_x
        along_y: cython.double = self._along_y
        limit: cython.double = self._limit
        angular_limit: cython.double = self._angular_limit
        slowing: cython.double = self._braking_linear
        turning: cython.double = self._braking_angular
        others: cython.double = self._others
        is_passive: cython.bint = self._is_passive
        while end > begin and not (
            gap[end - 1] <= 2.0 * free[end - 1] + others * (age[end - 1] + _tick)
        ):
            end -= 1
        for k in range(self._edges):
            own_x: cython.double = self._corner_x[k]
            own_y: cython.double = self._corner_y[k]
            for j in range(begin, end):
                dx: cython.double = x[j] - own_x
                dy: cython.double = y[j] - own_y
                away: cython.double = _maximum(sqrt(dx * dx + dy * dy), 1e-9)
                dx /= away
                dy /= away
                linear: cython.double = dx * along_x + dy * along_y
                lever: cython.double = own_x * dy - own_y * dx
                braking: cython.double = _braking(linear, lever, slowing, turning)
                new_cap[j] = _cap(away - free[j], braking, age[j], others, is_passive)
                new_x[j], new_y[j], new_gap[j] = linear * limit, lever * angular_limit, away
            at: cython.Py_ssize_t = self._rows
            for j in range(begin, end):
                # A row that no twist within the limits violates is left out.
                if new_cap[j] > fabs(new_x[j]) + fabs(new_y[j]) + _SLACK:
                    continue
                if gap[j] <= 2.0 * free[j] + others * (age[j] + _tick):
                    self._row_x[at], self._row_y[at] = new_x[j], new_y[j]
                    self._row_cap[at], self._row_gap[at] = (
                        new_cap[j],
                        new_gap[j] - self._at_radius[j],
                    )
                    self._source[at] = first + j
                    at += 1
            self._rows = at
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _add_keep_out(self, first: cython.Py_ssize_t, count: cython.Py_ssize_t) -> cython.int:
        """A second row for each point of the chunk: the circle around a sensor with a blind zone.

        The circle stays free: each of two robots keeps out of it by half of the distance.
        """
        j: cython.Py_ssize_t
        for j in range(count):
            dx: cython.double = self._at_x[j] - self._offset_x
            dy: cython.double = self._at_y[j] - self._offset_y
            away: cython.double = _maximum(sqrt(dx * dx + dy * dy), 1e-9)
            dx /= away
            dy /= away
            linear: cython.double = dx * self._along_x + dy * self._along_y
            lever: cython.double = self._offset_x * dy - self._offset_y * dx
            braking: cython.double = _braking(
                linear, lever, self._braking_linear, self._braking_angular
            )
            cap: cython.double = _reciprocal_cap(away - self._keep_out, braking, self._at_age[j])
            self._add(linear, lever, cap, self._at_gap[j] - self._at_radius[j], first + j)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _grant_touch(self, count: cython.Py_ssize_t) -> cython.int:
        """Raise the caps in the touch zone, and limit any motion in its directions.

        The direction from the outline decides, not the bearing from the axle: seen from the axle a
        pushed box is wider than any sector. No corner may move faster in the zone's directions,
        since a pushed object is not always seen.
        """
        i: cython.Py_ssize_t
        for i in range(count):
            ahead: cython.double = self._normal_x[i] * self._touch_x
            self._inside[i] = ahead + self._normal_y[i] * self._touch_y >= self._touch_cos
        for i in range(self._rows):
            if self._inside[self._source[i]]:
                self._row_cap[i] = _maximum(self._row_cap[i], self._touch_speed)
        for i in range(len(self._touch_table)):
            nx: cython.double = self._touch_table[i, 0]
            ny: cython.double = self._touch_table[i, 1]
            linear: cython.double = nx * self._along_x + ny * self._along_y
            lever: cython.double = self._touch_table[i, 2] * ny - self._touch_table[i, 3] * nx
            self._add(linear, lever, self._touch_speed, _inf, 0)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _is_touching(self) -> cython.int:
        """1 if an obstacle may touch the robot; contact with a seen one lasts until the next scan.

        By odometry a robot that is pushed leaves the obstacle that follows it: at 0.3 m/s by 4.6 cm
        within 0.15 s.
        """
        i: cython.Py_ssize_t
        for i in range(0 if self._has_contact else self._count):
            gap: cython.double = min(self._placed_gap[i], self._scan_gap[i])
            if gap <= self._placed_contact[i] and self._row_cap[self._first_row[i]] <= 0.0:
                self._has_contact = True
                break
        if self._has_contact:
            return 1
        # A told obstacle is somewhere in its disc. Once the disc may have reached the outline, the
        # direction to its middle does not show on which side the obstacle is.
        for i in range(self._count, self._count + self._discs):
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
            self._find_envelope(which, CREEP_SPEED if which == 0 else self._surface_speed)
            self._envelope_along_x[which] = self._along_x
            self._envelope_along_y[which] = self._along_y
        at: cython.Py_ssize_t = self._rows
        self._all = at + len(self._way_x)
        row_x: cython.p_double = _first(self._row_x, self._all)
        row_y: cython.p_double = _first(self._row_y, self._all)
        row_cap: cython.p_double = _first(self._row_cap, self._all)
        count: cython.Py_ssize_t = len(self._way_x)
        begin: cython.Py_ssize_t = which * count
        x: cython.p_double = _first(self._envelope_x, begin + count)
        y: cython.p_double = _first(self._envelope_y, begin + count)
        cap: cython.p_double = _first(self._envelope_cap, begin + count)
        for i in range(count):
            row_x[at + i], row_y[at + i] = x[begin + i], y[begin + i]
            row_cap[at + i] = cap[begin + i]
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _find_envelope(self, which: cython.Py_ssize_t, speed: cython.double) -> cython.int:
        """The rows of the envelope, in which no corner exceeds `speed` m/s.

        Every robot assumes that no surface around it moves faster than `others_speed`; the envelope
        makes that true of this robot, corners in a turn included. The polygon is an inner
        approximation of a convex set; its vertices are exact.
        """
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        after: cython.Py_ssize_t
        count: cython.Py_ssize_t = len(self._way_x)
        table: cython.double[:, ::1] = _ENVELOPE_DIRECTIONS
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
            at: cython.Py_ssize_t = which * count + i
            self._envelope_x[at], self._envelope_y[at] = y, x
            self._envelope_cap[at] = y * self._way_x[i] + x * self._way_y[i]
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _reserve_rows(self, count: cython.Py_ssize_t) -> cython.int:
        if self._row_x is not None and len(self._row_x) >= count:
            return 0
        count += count // 2
        self._row_x, self._row_y = _doubles(count), _doubles(count)
        self._row_cap, self._row_gap = _doubles(count), _doubles(count)
        self._kept_cap = _doubles(count)
        self._source = _indices(count)
        return 0

    # The projection.

    @cython.cfunc
    @cython.exceptval(-1)
    def _project(self, x: cython.double, y: cython.double) -> cython.int:
        """The feasible point nearest to a requested one: exact, for two variables.

        The axes are the two speeds over their limits, so that "nearest" weighs them alike. The loop
        adds the most violated row each time: a point that is nearest within some of the rows and
        violates no other is nearest within all. Each polygon contains the origin.
        """
        i: cython.Py_ssize_t
        n: cython.Py_ssize_t = self._all
        first: cython.Py_ssize_t
        worst: cython.Py_ssize_t
        self._poly_x[0] = self._poly_x[1] = self._poly_y[1] = self._poly_y[2] = 1.0
        self._poly_x[2] = self._poly_x[3] = self._poly_y[0] = self._poly_y[3] = -1.0
        self._sides = 4
        row_x: cython.p_double = _first(self._row_x, n)
        row_y: cython.p_double = _first(self._row_y, n)
        row_cap: cython.p_double = _first(self._row_cap, n)
        over: cython.p_double = self._new_gap
        self._nearest(x, y)
        for _ in range(n):
            worst = 0
            most: cython.double = -_inf
            px: cython.double = self._point_x
            py: cython.double = self._point_y
            first = 0
            while first < n:
                count: cython.Py_ssize_t = min(_CHUNK, n - first)
                for i in range(count):
                    over[i] = row_x[first + i] * px + row_y[first + i] * py - row_cap[first + i]
                for i in range(count):
                    if not (over[i] <= most):
                        most, worst = over[i], first + i
                        if most != most:
                            break
                if most != most:
                    break
                first += count
            if most <= TOLERANCE:
                break
            self._clip(row_x[worst], row_y[worst], row_cap[worst])
            self._nearest(x, y)
        return 0

    @cython.cfunc
    @cython.exceptval(-1)
    def _clip(self, a: cython.double, b: cython.double, cap: cython.double) -> cython.int:
        """Cut off the part of the polygon where a x + b y > cap (Sutherland and Hodgman 1974)."""
        if len(self._clip_x) < 2 * self._sides:
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
        """The point of the polygon nearest to a requested one; a line or a point has no inside."""
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
        if is_inside or best <= TOLERANCE * TOLERANCE:
            self._point_x, self._point_y = x, y
        else:
            self._point_x, self._point_y = best_x, best_y
        return 0

    # The stop check.

    @cython.cfunc
    @cython.exceptval(-1)
    def _limit_stop(self) -> cython.int:
        """1 if the speeds are reduced so that the outline stays clear while the robot brakes.

        A row bounds how fast the nearest place of the outline closes on an obstacle now. But a
        corner swings outwards while a turn ends, and of two speeds, one of which opens what the
        other closes, one may reach zero first. So the stop is simulated, as in the dynamic window
        approach (Fox, Burgard and Thrun, IEEE RAM 1997): with both brakes as weak as assumed, and
        with either of them ideal. An obstacle may also move along the outline, to where a turn
        moves the outline outwards. So at each pose no place that an obstacle can have reached by
        then may move outwards by the turn.
        """
        i: cython.Py_ssize_t
        s: cython.double = self._linear
        w: cython.double = self._angular
        slow: cython.double = fabs(s) / self._braking_linear
        turning: cython.double = fabs(w) / self._braking_angular
        seconds: cython.double = _tick + (turning if turning > slow else slow)
        others: cython.double = self._others if self._is_passive else 0.0
        way: cython.double = (fabs(s) + fabs(w) * self._radius) * seconds
        points: cython.Py_ssize_t = self._count + self._discs
        free: cython.p_double = _first(self._placed_free, points)
        age: cython.p_double = _first(self._placed_age, points)
        gap: cython.p_double = _first(self._placed_gap, points)
        near_gap: cython.p_double = _first(self._near_gap, points)
        near_need: cython.p_double = _first(self._near_need, points)
        beside: cython.Py_ssize_t = 0
        for i in range(self._contacts, points):
            if self._has_touch and i < self._count and self._inside[i]:
                continue
            need: cython.double = free[i] + others * age[i]
            if gap[i] <= need + others * seconds + way:
                self._near_x[beside], self._near_y[beside] = self._placed_x[i], self._placed_y[i]
                near_gap[beside], near_need[beside] = gap[i], need
                beside += 1
        self._beside = beside
        if beside == 0:
            return 0
        self._forbidding = 0
        if self._is_clear(s, w, others):
            return 0
        self._linear = self._angular = 0.0
        # Of two speeds, one of which opens what the other closes, a share of one may close.
        for i in range(len(self._shares)):
            some: cython.double = self._shares[i, 0] * s
            turn: cython.double = self._shares[i, 1] * w
            if not self._is_feasible(some / self._limit, turn / self._angular_limit):
                continue
            if self._is_clear(some, turn, others):
                self._linear, self._angular = some, turn
                break
        # The zero command is always clear; shares of a speed of 0 are 0.
        return not (self._linear == s and self._angular == w)

    @cython.cfunc
    @cython.exceptval(-1)
    def _is_feasible(self, x: cython.double, y: cython.double) -> cython.int:
        """1 if a point violates no row."""
        i: cython.Py_ssize_t
        row_x: cython.p_double = _first(self._row_x, self._all)
        row_y: cython.p_double = _first(self._row_y, self._all)
        row_cap: cython.p_double = _first(self._row_cap, self._all)
        for i in range(self._all):
            if not (row_x[i] * x + row_y[i] * y - row_cap[i] <= TOLERANCE):
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
        gap: cython.p_double = _first(self._near_gap, self._beside)
        need: cython.p_double = _first(self._near_need, self._beside)
        for k in range(3):  # both brakes as assumed, then one of them ideal
            if (k == 1 and v == 0.0) or (k == 2 and turning == 0.0):
                continue  # the brake of a speed of 0 changes nothing
            slow: cython.double = 0.0 if k == 1 else v / self._braking_linear
            until: cython.double = 0.0 if k == 2 else turning / self._braking_angular
            last: cython.double = _tick + (until if until > slow else slow)
            step: cython.double = last / _STEPS
            way: cython.double = self._simulate(k, s, w, v, turning, step)
            if self._poses == 0:  # the outline closes on nothing
                continue
            if self._forbids(self._forbidding, way, step, others):
                return 0
            for i in range(self._beside):
                most: cython.double = need[i] + others * (step * _STEPS) + way + _ROUNDING
                if not (gap[i] >= most) and self._forbids(i, way, step, others):
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
        for j in range(_STEPS):
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
            if not (fastest + 1e-12 <= NEGLIGIBLE_SPEED):
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
        gap: cython.double = self._near_gap[point]
        need: cython.double = self._near_need[point]
        point_x: cython.double = self._near_x[point]
        point_y: cython.double = self._near_y[point]
        least: cython.double = need + others * (step * _STEPS) + way + _ROUNDING
        if gap >= least:
            return 0
        before: cython.double = gap
        for j in range(self._poses):
            dx: cython.double = point_x - self._stop_x[j]
            dy: cython.double = point_y - self._stop_y[j]
            c: cython.double = self._stop_cos[j]
            d: cython.double = self._stop_sin[j]
            x: cython.double = c * dx + d * dy
            y: cython.double = c * dy - d * dx
            left: cython.double = self._gap_of(x, y)
            is_free: cython.bint = left >= need + others * (step * (j + 1.0))
            if not is_free and not (before - left <= NEGLIGIBLE_SPEED * step):
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

        Along an edge the outward speed is linear, so it is greatest where the circle around the
        point, or the edge, begins or ends. A turn moves no place faster than the outermost one.
        """
        k: cython.Py_ssize_t
        edges: cython.Py_ssize_t = self._edges
        if fabs(w) * self._radius + _ROUNDING <= FAULT_SPEED:
            return 0
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
                left: cython.double = within - sqrt(past * past + above * above)
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
            if turned > FAULT_SPEED and turned + moved > FAULT_SPEED:
                return 1
        return 0

    # The report.

    @cython.cfunc
    def _report(self) -> tuple:
        """The rows that bind the last limited request, those with the lowest caps first.

        The gap of a row is measured from the outline, also where the row is that of one corner.
        Rows of the envelope and of a touch zone, which have no return, are not reported. The
        bearing of a place at the axle is 0.
        """
        i: cython.Py_ssize_t
        k: cython.Py_ssize_t
        tight: cython.Py_ssize_t = 0
        found: cython.Py_ssize_t = 0
        row_x: cython.p_double = _first(self._row_x, self._all)
        row_y: cython.p_double = _first(self._row_y, self._all)
        row_cap: cython.p_double = _first(self._row_cap, self._all)
        x: cython.double = self._point_x
        y: cython.double = self._point_y
        for i in range(self._all):
            if row_x[i] * x + row_y[i] * y - row_cap[i] >= -BINDING_TOLERANCE:
                tight += 1
                if i < self._rows and (
                    found < MAX_REPORTED
                    or not (row_cap[i] > row_cap[self._ranked[MAX_REPORTED - 1]])
                ):
                    found = self._rank(found, i)
        points: cython.Py_ssize_t = self._count + self._discs
        if tight == 0 and points:  # limited by the stop alone: the nearest obstacle
            nearest: cython.Py_ssize_t = self._first_row[0]
            for i in range(1, points):
                if self._row_gap[self._first_row[i]] < self._row_gap[nearest]:
                    nearest = self._first_row[i]
            found = self._rank(found, nearest)
        shown: list = []
        for k in range(found):
            i = self._ranked[k]
            point: cython.Py_ssize_t = self._source[i]
            radius: cython.double = self._radius_of[point]
            x = self._placed_x[point] - radius * self._normal_x[point]
            y = self._placed_y[point] - radius * self._normal_y[point]
            bearing: cython.double = 0.0 if hypot(x, y) < _AT_AXLE else atan2(y, x)
            shown.append(LimitingObstacle(bearing, self._gap_of(x, y), self._row_cap[i]))
        return tuple(shown)

    @cython.cfunc
    @cython.exceptval(-1)
    def _rank(self, count: cython.Py_ssize_t, row: cython.Py_ssize_t) -> cython.Py_ssize_t:
        """Insert a row into `count` ranked ones, by rising caps, then gaps; their new number."""
        cap: cython.double = self._row_cap[row]
        gap: cython.double = self._row_gap[row]
        if not gap < _inf:
            return count
        at: cython.Py_ssize_t = count
        other: cython.Py_ssize_t
        while at > 0:
            other = self._ranked[at - 1]
            if self._row_cap[other] < cap or (
                self._row_cap[other] == cap and self._row_gap[other] <= gap
            ):
                break
            at -= 1
        if at == MAX_REPORTED:
            return count
        count = min(count + 1, MAX_REPORTED)
        for other in range(count - 1, at, -1):
            self._ranked[other] = self._ranked[other - 1]
        self._ranked[at] = row
        return count


def linear_limit(limits: Limits, along_x: float, along_y: float) -> float:
    """The limit of the linear speed in m/s in the direction of a unit vector."""
    ahead, aside = abs(along_x), abs(along_y)
    return min(
        limits.linear / ahead if ahead else math.inf, limits.lateral / aside if aside else math.inf
    )


def touch_directions(corners: Array, zone: TouchZone) -> tuple[Array, Array, Array, Array]:
    """Directions nx, ny (n,) of the zone, and the corners x, y (n,) in m foremost in each.

    A lidar does not show what touches the robot, and a pushed object moves with it. So the speed
    of a touch zone limits any motion in its directions, not only motion towards a return.
    """
    count = math.ceil(2.0 * zone.half_width / _TOUCH_STEP)
    angles = np.linspace(zone.bearing - zone.half_width, zone.bearing + zone.half_width, count + 1)
    edges = np.roll(corners, -1, axis=0) - corners
    faces = np.arctan2(-edges[:, 0], edges[:, 1])  # outward normals of a counter-clockwise outline
    off = (faces - zone.bearing + np.pi) % (2.0 * np.pi) - np.pi
    angles = np.concatenate((angles, faces[np.abs(off) <= zone.half_width]))
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    heights = directions @ corners.T
    direction, corner = np.nonzero(heights >= heights.max(axis=1, keepdims=True) - _SAME_FACE)
    return (*directions[direction].T, *corners[corner].T)


def _rays_and_ranges(bearings: Array, nearest: Array) -> Array:
    """(n, 3) unit vectors to hidden obstacles, and the m that each may be from the lidar."""
    return np.column_stack((unit_vectors(bearings), nearest))
