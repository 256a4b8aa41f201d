"""Recovery: steers a blocked robot around an obstacle, before protection judges the command.

Recovery replaces the requested command. The protection mode judges the replacement like any
request, so recovery cannot weaken protection. Without recovery, two robots that meet head on would
block each other for good.

- In the open: recovery looks for a free corridor of the robot's width near the robot's heading, and
  prefers the right side (after the vector field histogram, Borenstein and Koren 1991).
- In a door or a narrow corridor: recovery keeps the robot on the middle line (pure pursuit, Coulter
  1992), and requests little more speed than protection allows. For a faster request, protection
  would choose a command with a turn, since beside a wall a robot that turns away may move faster.
- Where two robots meet and neither can pass: each backs off for a random time that grows (random
  backoff, Metcalfe and Boggs 1976).
- A robot that can neither turn nor go on takes the fastest twist that protection allows.

A robot in contact creeps by envelope.py (`Creeping`).

A kernel (see `core/kernels.py`), since each decision passes it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import PI, TURN, wrap
from swarmd.core.buffers import view
from swarmd.core.cython_shadow import (
    INFINITY,
    Table,
    atan2,
    copysign,
    cos,
    fabs,
    hypot,
    remainder,
    sin,
)
from swarmd.core.values import ZERO, Array, Limits, Twist
from swarmd.robot.protection.decision import Clearance, DecisionContext
from swarmd.robot.steering.avoidance import PASSAGE_WIDTHS
from swarmd.robot.steering.tracks import speed_of
from swarmd.robot.steering.velocity_obstacles import passage_between

if TYPE_CHECKING:
    from swarmd.core.values import Pose

# A robot with less than this share of the requested speed is blocked.
_BLOCKED_SHARE = 0.5
# s of blocked motion before recovery begins
_MOVE_BLOCKED_TIME = 0.1
# s of blocked turning before the robot backs off instead
_TURN_BLOCKED_TIME = 1.0
# Share of the limits: a slower requested command never counts as blocked.
_MIN_SPEED_SHARE = 0.1
# Share of this least linear speed: a slower robot hardly moves.
_HARDLY_MOVES = 0.25
# s for which the robot follows a free corridor
_FOLLOW_TIME = 1.5
# 1/s: rad/s for each rad that the heading is off the corridor
_FOLLOW_GAIN = 2.0
_BACK_OFF_TIME = 0.8  # s, the shortest back-off
# s, in addition to the back-off, after which recovery ends
_MAX_RECOVERY_TIME = 8.0
# s for which the robot keeps the chosen side
_SIDE_HOLD_TIME = 10.0
_SIDE_FLIP_PROBABILITY = 0.05  # of the left side, so that two robots do not mirror each other
_HEADING_TOLERANCE = math.radians(15.0)
# rad by which a corridor on the other side must be nearer
_OTHER_SIDE_COST = math.radians(40.0)
_YIELD_TIME = 12.0  # s, the longest back-off
# s within which the next block belongs to the same meeting
_ROUND_TIME = 15.0
# Of the requested speed: with less the robot looks for a narrow passage.
_LIMITED_SHARE = 0.9
_PURSUIT_LENGTH = 0.2  # m ahead on the middle line
# 1/s, rad/s
_PASSAGE_GAIN = 3.0
_PASSAGE_TURN_RATE = 0.8
# m ahead of the axle: walls there are the sides of a passage
_SIDES_FROM = -0.15
_SIDES_TO = 0.35
# In a passage the request is at most this multiple of the allowed speed, plus this share of the
# linear limit.
_SPEED_UP = 1.3
_SPEED_STEP = 0.1
# s without motion in a passage after which the robot counts as blocked
_STOPPED_TIME = 1.0
# A robot that moves less than these m and turns less than these rad in these s counts as blocked.
_STALL_DISTANCE = 0.04
_STALL_TURN = 1.0
_STALL_TIME = 5.0
# s, the longest back-off that protection slows to less than half, as in contact
_CREEP_TIME = 4.0
# m from where a robot was set down, and s of requests, within which it leaves the place: see
# `_observe`. Of 31 cells beside walls, in corners and in corridors that came less than 0.1 m in
# 40 s, 30 then come 0.1 m (docs/evidence/beside.md). Robots that meet have driven farther.
_LEAVING_DISTANCE = 0.15
_LEAVING_TIME = 120.0
# s, the longest back-off of a robot that leaves: 12 cm
_LEAVING_BACK_TIME = 8.0
# s for which a robot counts as one that creeps after its last command at a creep
_CREPT_TIME = 10.0
# s, the longest time between two decisions
_DECISION_PERIOD = 0.1
# s for which a robot that leaves straight keeps to ahead or back, unless it is blocked
_WAY_HOLD_TIME = 20.0
# m/s: a straight escape at least as fast is taken before one with a turn
_STRAIGHT_ESCAPE = 0.0075
# m/s of the axle or of a flank: a robot no faster creeps (protection: 1.5 cm/s at each corner).
_CREEPING = 0.016
# m/s of the axle or of a flank, in the direction of the request: a robot that creeps gains ground.
_GAINS_GROUND = 0.003
# s for which a robot that gains ground at a creep keeps its direction at most: half a turn of a
# TurtleBot 4 takes 40 s.
_KEEPS_DIRECTION = 60.0
# m beside the body, of a corridor along which a robot leaves
_BESIDE_BODY = 0.02
_ESCAPE_TURNS = (0.0, 1.0, -1.0)  # rad/s
# s of blocked motion before recovery begins, if moving objects are near
_CROWD_PATIENCE = 2.0

_BEARINGS = np.radians(np.arange(-180.0, 180.0, 10.0)).tolist()  # rad, of corridors


Points = Callable[[], Array]
Allows = Callable[[Twist], Twist]


class Others(Struct, frozen=True, gc=False):
    """What avoidance and right of way know about other moving objects."""

    wanted: Twist | None = None  # the request before avoidance; None: there was no avoidance
    are_near: bool = False  # moving objects are near
    are_avoided: bool = False  # the request leads past a moving object
    is_settled: bool = False  # the request gives way at an opening or passes it: recovery ends


NO_OTHERS = Others()


@cython.cclass
class Recovery:
    """Replaces the requested command of a blocked robot. Times are in s and come with each call.

    States:
        follow: inactive, the requested command passes.
        pass: the robot keeps to the middle of a narrow passage.
        back: the robot backs off.
        turn: the robot turns towards a free corridor.
        go: the robot drives along the corridor.

    Attributes:
        lookahead: the length in m from the axle up to which a corridor is checked.
        is_active: True while recovery replaces the requested command.
        has_taken_over: True while the command does not depend on the requested one.
    """

    lookahead: float
    is_active: bool
    has_taken_over: bool
    _half_width: float  # m, of a corridor
    _width: float  # m, of the robot
    _flank: float  # m from the axle, of the place whose speed in a turn counts
    _linear_limit: float  # m/s
    _angular_limit: float  # rad/s
    _turn_rate: float  # rad/s
    _turn_weight: float  # m2/s2 for each rad2/s2
    _rng: Random
    _side: float  # 1 left or -1 right
    _side_until: float
    _bearing: float  # rad, of the corridor
    _planned_at_yaw: float  # rad
    _speed: float  # m/s, the fastest that was requested during a recovery
    _is_backing: bool
    _set_down_at: Pose | None  # of odometry, where the robot was set down; None: not known yet
    _is_set_down: bool  # the robot has not left this place
    _leaving_time: float  # s of requests since the robot was set down
    _decided_at: float  # s, of the last decision
    _crept_at: float  # s, of the last safe command at a creep; -inf without one
    _leaves: bool  # the robot was set down here, and protection lets it creep
    _is_way_back: bool  # the robot has crept back, not ahead
    _way_until: float  # s, until which it keeps to this way; -inf: it may choose
    _gained_at: float  # s, when the robot last gained ground at a creep
    _escape: Twist | None  # the twist of state back; None without one
    _back_off_count: int
    _back_time: float
    _last_block_at: float  # s; -inf without one
    _request: Twist  # the last replacement
    _last_motion: tuple[Any, Pose] | None  # its time and pose; None without one
    _began_at: float
    _blocked_since: float  # inf: not blocked
    _state: str
    _state_since: float

    def __init__(self, clearance: Clearance, limits: Limits, seed: str) -> None:
        """`clearance` is the room that a corridor needs for nearly full speed under protection.

        `seed` seeds the random choices.
        """
        self.lookahead = clearance.ahead + _FOLLOW_TIME * limits.linear
        self._half_width = clearance.beside
        self._width = 2.0 * clearance.body
        self._flank = clearance.body if clearance.body > 0.0 else clearance.beside
        self._linear_limit = limits.linear
        self._angular_limit = limits.angular
        self._turn_rate = min(limits.angular, 1.5)
        self._turn_weight = math.pow(limits.linear / limits.angular, 2.0)
        self._rng = Random(seed)
        self._side = -1.0
        self._side_until = -INFINITY
        self._back_time = _BACK_OFF_TIME
        self._last_block_at = -INFINITY
        self.set_down()
        self.reset()

    def set_down(self) -> None:
        """The robot does not run: a person may have set it down where it is.

        A hold that lasts ends the run. A shorter one, such as of a late scan, is no such time:
        robots that meet would leave anew with each of them.
        """
        self._set_down_at = None
        self._is_set_down = True
        self._leaving_time = 0.0
        self._decided_at = INFINITY
        self._crept_at = -INFINITY
        self._leaves = False
        self._way_until = -INFINITY
        self._gained_at = -INFINITY

    def reset(self) -> None:
        """Become inactive: the requested command passes."""
        self._request = ZERO
        self._last_motion = None
        self._began_at = -INFINITY
        self._enter("follow", -INFINITY)

    def replacement(
        self,
        requested: Twist,
        safe: Twist,
        context: DecisionContext,
        points: Points,
        others: Others = NO_OTHERS,
        safe_for: Allows | None = None,
    ) -> Twist:
        """The command that replaces `requested`; `requested` itself while the robot is not blocked.

        A robot is blocked if protection has allowed clearly less than the last request for some
        time.

        Args:
            requested: the command of the pattern or of avoidance.
            safe: the last safe command.
            context: the time and the odometry.
            points: gives the returns of the scan, (k, 2) in m in the base frame.
            others: what avoidance and right of way know about other moving objects.
            safe_for: gives the safe command for any requested command; None: no escape is
                tried.
        """
        # The request before avoidance: avoidance may slow a request so much that it seems idle.
        pattern_request = requested if others.wanted is None else others.wanted
        linear = pattern_request.linear
        lateral = pattern_request.lateral
        now = context.now

        self._observe(pattern_request, safe, context)

        # 1. Ends a recovery that is not needed any more (right of way decides, too: `is_settled`),
        # or takes too long.
        has_taken_over = self.has_taken_over
        if (
            others.is_settled
            or not (self._is_fast(linear, lateral) or self._is_turning(pattern_request.angular))
            or (has_taken_over and self._is_over(now))
        ):
            self.reset()
            return requested

        # 2. Before a recovery. A robot that is neither blocked nor stalled keeps its request, which
        # is led along the middle line in a passage. A blocked robot begins a recovery.
        # `patience`: s of blocked motion before a recovery begins.
        patience = _CROWD_PATIENCE if others.are_near else _MOVE_BLOCKED_TIME
        is_blocked = self._is_blocked(safe, now, patience)
        if not has_taken_over:
            if not is_blocked and not self._is_stalled(context, points):
                if others.are_avoided:
                    self._leave_passage()
                    self._request = requested
                else:
                    self._request = self._through_passage(requested, safe, points)
                return self._request
            self._set_back_time(now, points())
            self._start(pattern_request, context, points())
            is_blocked = False  # the request was blocked, not yet the command of the recovery

        # 3. Continues the recovery.
        self._speed = max(self._speed, speed_of(linear, lateral))
        self._request = self._recover(safe, context, points, is_blocked, safe_for)
        return self._request

    def _observe(self, requested: Twist, safe: Twist, context: DecisionContext) -> None:
        """Update `_leaves`, and what a robot that leaves keeps to.

        A robot that was set down in a corner, or across a corridor, creeps out of it, and needs
        tens of s in one direction. Two robots that meet creep, too, and must give way. They have
        driven there: so a robot leaves only until it is _LEAVING_DISTANCE from where it was set
        down, and for _LEAVING_TIME at most.
        """
        if not self._is_set_down:
            return
        now = context.now
        if not requested.is_zero:
            self._leaving_time += max(min(now - self._decided_at, _DECISION_PERIOD), 0.0)
        self._decided_at = now
        if not self._is_near_start(context) or self._leaving_time >= _LEAVING_TIME:
            self._is_set_down = False
            self._leaves = False
            self._way_until = -INFINITY
            return
        is_creep = self._is_creep(safe)
        if is_creep and not safe.is_zero:
            self._crept_at = now
        self._leaves = now - self._crept_at <= _CREPT_TIME
        if not self._leaves:
            return
        if self._gains_ground(safe):
            self._gained_at = now
        if self.has_taken_over and is_creep and fabs(safe.linear) >= _STRAIGHT_ESCAPE:
            self._is_way_back = safe.linear < 0.0
            self._way_until = now + _WAY_HOLD_TIME

    def _is_near_start(self, context: DecisionContext) -> bool:
        """True if odometry says that the robot is still where it was set down; sets this place."""
        if context.odometry is None:
            return False
        pose = context.odometry.pose
        if self._set_down_at is None:
            self._set_down_at = pose
        start = self._set_down_at
        return hypot(pose.x - start.x, pose.y - start.y) < _LEAVING_DISTANCE

    def _is_over(self, now: float) -> bool:
        """True if a recovery takes too long.

        A robot that leaves and gains ground keeps its direction: the request, or a back-off before
        the next recovery, would take the ground back.
        """
        if now - self._began_at <= _MAX_RECOVERY_TIME + self._back_time:
            return False
        if not self._leaves:
            return True
        is_gaining = now - self._gained_at <= _TURN_BLOCKED_TIME
        return not (is_gaining and now - self._state_since <= _KEEPS_DIRECTION)

    def _start(self, requested: Twist, context: DecisionContext, points: Array) -> None:
        """Begin a recovery: back off if a motion was blocked; choose a corridor if a turn was.

        A robot that leaves backs off in any case: straight on no corner swings towards a wall.
        """
        self._began_at = context.now
        self._speed = 0.5 * self._linear_limit
        self._last_motion = None
        if self._leaves or self._is_fast(requested.linear, requested.lateral):
            self._back_off(points, context.now)
        else:
            self._plan(0.0, context, points)

    def _is_blocked(self, safe: Twist, now: float, patience: float) -> bool:
        """Update `_blocked_since`; True once the robot has been blocked for some time.

        A robot is blocked while the safe command is far below the last request. The time is
        _TURN_BLOCKED_TIME for a request that only turns. For any other request the time is
        `patience` s before a recovery, _MOVE_BLOCKED_TIME during a recovery, and in a passage the
        longer of `patience` and _STOPPED_TIME. A robot that is in a passage or creeps counts as
        blocked only while it hardly moves.
        """
        linear = self._request.linear
        angular = self._request.angular
        lateral = self._request.lateral
        is_passing = self._state == "pass"
        is_moving = self._is_fast(linear, lateral)
        share = 1.0  # of the request that protection allows
        if is_passing or self._creeps(safe):
            least = _HARDLY_MOVES * (_MIN_SPEED_SHARE * self._linear_limit)
            if self._leaves and not is_passing:
                least = min(least, _GAINS_GROUND)
            share = 1.0 if fabs(safe.linear) >= least else 0.0
        elif self._gains_ground(safe):
            share = 1.0
        elif is_moving or self._is_turning(angular):
            share = self._product(safe.linear, safe.angular, safe.lateral, linear, angular, lateral)
            share /= self._product(linear, angular, lateral, linear, angular, lateral)
        if share >= _BLOCKED_SHARE:
            self._blocked_since = INFINITY
            return False
        if self._blocked_since == INFINITY:
            self._blocked_since = now
        if is_passing:
            patience = max(_STOPPED_TIME, patience)
        elif not is_moving or (self._leaves and self._state != "follow"):
            patience = _TURN_BLOCKED_TIME
        elif self._state != "follow":
            patience = _MOVE_BLOCKED_TIME
        return now - self._blocked_since >= patience

    def _creeps(self, safe: Twist) -> bool:
        """True if protection lets a robot that backs off only creep, as in contact."""
        if self._state != "back":
            return False
        asked = self._request.linear
        allowed = safe.linear
        if asked <= 0.0:
            allowed = -allowed
        return 0.0 < allowed < _BLOCKED_SHARE * fabs(asked)

    def _gains_ground(self, safe: Twist) -> bool:
        """True if protection lets a robot that leaves creep in the direction of its request."""
        if not self._leaves or self._state not in ("turn", "go"):
            return False
        if not self._is_creep(safe):
            return False
        gained = self._flank * safe.angular * self._request.angular
        speed = fabs(self._request.angular)
        if self._request.linear != 0.0:
            gained = safe.linear * self._request.linear
            speed = fabs(self._request.linear)
        return gained >= _GAINS_GROUND * speed

    def _is_creep(self, safe: Twist) -> bool:
        """True if neither the axle nor a flank is faster than a robot that creeps."""
        return (
            hypot(safe.linear, safe.lateral) <= _CREEPING
            and fabs(self._flank * safe.angular) <= _CREEPING
        )

    def _is_stalled(self, context: DecisionContext, points: Points) -> bool:
        """Update `_last_motion`; True: no progress near obstacles, although the robot may move.

        By odometry the robot has stayed near one place and heading for more than `_STALL_TIME` s:
        it rocks to and fro, or avoidance reduces its request to nearly zero. False without a return
        near the robot, and without odometry.
        """
        if context.odometry is None:
            return False
        now = context.now
        pose = context.odometry.pose
        if self._last_motion is not None:
            since, start = self._last_motion
            distance = hypot(pose.x - start.x, pose.y - start.y)
            turn = fabs(pose.yaw - start.yaw)
            has_stayed = distance <= _STALL_DISTANCE and turn <= _STALL_TURN
            if has_stayed and now - since <= _STALL_TIME:
                return False
            if has_stayed and len(points()):
                return True
        self._last_motion = now, pose
        return False

    def _product(
        self,
        linear: float,
        angular: float,
        lateral: float,
        other_linear: float,
        other_angular: float,
        other_lateral: float,
    ) -> float:
        """The inner product of two twists in m2/s2.

        A turn at its limit weighs as much as motion at its limit. So a robot that may make the turn
        of its request does not count as blocked, even if it may hardly move.
        """
        return (
            linear * other_linear
            + lateral * other_lateral
            + self._turn_weight * angular * other_angular
        )

    def _set_back_time(self, now: float, points: Array) -> None:
        """Set `_back_time` of a robot that has just been blocked, and `_back_off_count`.

        If two robots meet between walls, each block of the meeting makes the back-off longer. In
        the open, or at the first block of a meeting, the back-off is short, since the robots can
        drive around each other.
        """
        is_new = now - self._last_block_at > _ROUND_TIME
        self._last_block_at = now
        if is_new or not self._is_enclosed(points):
            self._back_off_count = 0
            self._back_time = _BACK_OFF_TIME
            return

        # A random time whose bound doubles with each block.
        self._back_off_count += 1
        longest = _BACK_OFF_TIME * 2.0 ** min(self._back_off_count, 4)
        self._back_time = self._rng.uniform(0.5, 1.0) * min(longest, _YIELD_TIME)

    def _is_enclosed(self, points: Array) -> bool:
        """True between walls: no corridor ahead is free up to the lookahead."""
        places: Table = view(points)
        ahead = [bearing for bearing in _BEARINGS if fabs(bearing) <= 0.5 * PI]
        return all(
            [
                self._free_length(places, bearing, self._half_width) < self.lookahead
                for bearing in ahead
            ]
        )

    def _through_passage(self, requested: Twist, safe: Twist, points: Points) -> Twist:
        """The command that keeps to the middle of a narrow passage; else `requested`.

        `requested` passes if the robot is not in a narrow passage, or protection does not limit it.
        """
        linear = requested.linear
        allowed = safe.linear
        is_limited = self._state == "pass"
        if not is_limited and linear > 0.0 and linear >= _MIN_SPEED_SHARE * self._linear_limit:
            is_limited = (
                self._is_fast(self._request.linear, self._request.lateral)
                and allowed / linear < _LIMITED_SHARE
            )
        if linear <= 0.0 or requested.lateral != 0.0 or not is_limited:
            self._leave_passage()
            return requested
        target = self.middle(points())
        if target is None:
            self._leave_passage()
            return requested
        if self._state == "follow":
            self._enter("pass", self._state_since)
        linear = min(linear, _SPEED_UP * max(allowed, 0.0) + _SPEED_STEP * self._linear_limit)
        return Twist(linear, _turn_to(target))

    def _recover(
        self,
        safe: Twist,
        context: DecisionContext,
        points: Points,
        is_blocked: bool,
        safe_for: Allows | None,
    ) -> Twist:
        """The command of a recovery; changes the state first if necessary.

        Args:
            safe: the last safe command.
            context: the time and the odometry.
            points: gives the returns of the scan.
            is_blocked: protection blocks the command of the recovery, too.
            safe_for: gives the safe command for any requested command; None: no escape is
                tried.
        """
        # 1. Changes the state. A blocked turn leads to a back-off or an escape; the end of a
        # back-off, or a blocked drive, to a new corridor.
        now = context.now
        # At a creep, as in contact, the robot needs longer to get clear.
        back_time = self._back_time
        if self._creeps(safe):
            is_leaving = self._leaves and self._is_creep(safe)
            back_time = _LEAVING_BACK_TIME if is_leaving else _CREEP_TIME
        if self._state != "turn" and is_blocked:
            self._way_until = -INFINITY
        if self._state == "turn" and is_blocked:
            self._back_off(points(), now)
            self._escape = None if safe_for is None else self._fastest_escape(safe_for)
        elif self._state == "back" and (is_blocked or now - self._state_since >= back_time):
            self._plan(0.0, context, points())
        elif self._state == "go" and is_blocked:
            self._plan(self._bearing - self._turned_since_plan(context), context, points())

        # 2. The command of the state.
        if self._state == "back":
            return self._backing()
        yaw_error = remainder(self._bearing - self._turned_since_plan(context), TURN)
        if self._state == "turn":
            if fabs(yaw_error) > _HEADING_TOLERANCE:
                return Twist(0.0, copysign(self._turn_rate, yaw_error))
            self._enter("go", now)
        if now - self._state_since >= _FOLLOW_TIME and not self._gains_ground(safe):
            self.reset()  # this command is the last one of the recovery
        turn = max(min(_FOLLOW_GAIN * yaw_error, self._turn_rate), -self._turn_rate)
        return Twist(self._speed, turn)

    def _backing(self) -> Twist:
        """The command of state back; a long back-off is faster."""
        speed = 0.5 * self._speed
        if self._escape is not None:
            return self._escape
        if not self._is_backing:
            return Twist(speed)
        return Twist(-speed if self._back_time <= _BACK_OFF_TIME else -2.0 * speed)

    def _is_fast(self, linear: float, lateral: float) -> bool:
        """True if a twist with these speeds translates faster than the least speed."""
        return hypot(linear, lateral) >= _MIN_SPEED_SHARE * self._linear_limit

    def _is_turning(self, angular: float) -> bool:
        """True if a twist with this speed turns faster than the least speed."""
        return fabs(angular) >= _MIN_SPEED_SHARE * self._angular_limit

    def _leave_passage(self) -> None:
        if self._state == "pass":
            self._enter("follow", self._state_since)

    def middle(self, points: Array) -> Array | None:
        """(2,) a place in m ahead on the middle line of a narrow passage; None without a passage.

        `points` (k, 2) are returns in m in the base frame. The sides of the passage are the two
        returns, one to the left and one to the right, that are nearest to each other.
        """
        widest = 2.0 * PASSAGE_WIDTHS * self._half_width
        width, i, k = passage_between(points, _SIDES_FROM, _SIDES_TO, widest)
        if not self._width < width < widest:
            return None
        left = points[i]
        right = points[k]
        across = left - right
        direction = np.array((across[1], -across[0])) / width  # through the passage
        middle = 0.5 * (left + right)
        target: Array = middle - direction * (middle @ direction - _PURSUIT_LENGTH)
        return target if target[0] > 0.0 else None

    def _back_off(self, points: Array, now: float) -> None:
        """Move forward or backward, to the side with more room."""
        places: Table = view(points)
        half_width = self._half_width
        if self._leaves:
            half_width = self._body_half_width()
        ahead = self._free_length(places, 0.0, half_width)
        self._is_backing = self._free_length(places, PI, half_width) > ahead
        if now < self._way_until:
            self._is_backing = self._is_way_back
        self._escape = None
        self._enter("back", now)

    def _fastest_escape(self, safe_for: Allows) -> Twist | None:
        """The fastest of six twists that protection allows; None if protection allows none.

        A robot that leaves takes the first straight one that is no slower than _STRAIGHT_ESCAPE.
        """
        speed = 0.5 * self._speed
        fastest = 0.0
        escape = None
        for sign in (-1.0, 1.0) if self._is_backing else (1.0, -1.0):
            for turn in _ESCAPE_TURNS:
                twist = Twist(sign * speed, turn)
                allowed = sign * safe_for(twist).linear
                if self._leaves and turn == 0.0 and allowed >= _STRAIGHT_ESCAPE:
                    return twist
                if allowed > fastest + 0.01 * speed:
                    fastest = allowed
                    escape = twist
        return escape

    def _plan(self, heading: float, context: DecisionContext, points: Array) -> None:
        """Choose a free corridor near `heading` (bearing in rad), and enter the state turn.

        A corridor costs its angle from the heading. A corridor on the side that was not chosen
        costs more, as does a corridor that is not free up to `lookahead`.

        A robot that leaves chooses among corridors of its body's width if no wider one is free. In
        a corner and in a narrow corridor each wider one ends at a wall beside it, and the longest
        leads across, to the next wall.
        """
        now = context.now
        if now >= self._side_until:
            self._side = 1.0 if self._rng.random() < _SIDE_FLIP_PROBABILITY else -1.0
        self._side_until = now + _SIDE_HOLD_TIME
        places: Table = view(points)
        self._choose(places, heading, self._half_width)
        if self._leaves:
            free = self._free_length(places, self._bearing, self._half_width)
            if free < self.lookahead:
                self._choose(places, heading, self._body_half_width())
        self._planned_at_yaw = 0.0 if context.odometry is None else context.odometry.pose.yaw
        self._enter("turn", now)

    def _body_half_width(self) -> float:
        """m, half of the width of a corridor along which a robot leaves."""
        return 0.5 * self._width + _BESIDE_BODY

    def _choose(self, places: Table, heading: float, half_width: float) -> None:
        """Set `_bearing` to that of the corridor that costs least; see `_plan`."""
        least_cost = INFINITY
        for bearing in _BEARINGS:
            angle_off = wrap(bearing - heading)
            cost = fabs(angle_off)
            if angle_off * self._side < -1e-9:
                cost += _OTHER_SIDE_COST
            # 20 rad for each m that is not free: 0.2 m outweigh any angle.
            free = self._free_length(places, bearing, half_width)
            cost += 20.0 * max(self.lookahead - free, 0.0)
            if cost < least_cost:
                least_cost = cost
                self._bearing = bearing

    def _free_length(self, places: Table, bearing: float, half_width: float) -> float:
        """m of free corridor from the axle along a bearing, up to `lookahead`."""
        c = cos(bearing)
        s = sin(bearing)
        free = self.lookahead
        for i in range(len(places)):
            ahead = c * places[i, 0] + s * places[i, 1]
            aside = c * places[i, 1] - s * places[i, 0]
            if 0.0 < ahead < free and fabs(aside) < half_width:
                free = ahead
        return free

    def _turned_since_plan(self, context: DecisionContext) -> float:
        """The turn in rad since the corridor was chosen."""
        if context.odometry is None:
            return copysign(self._turn_rate * (context.now - self._state_since), self._bearing)
        return context.odometry.pose.yaw - self._planned_at_yaw

    def _enter(self, state: str, now: float) -> None:
        self._state = state
        self._state_since = now
        self.is_active = state != "follow"
        self.has_taken_over = self.is_active and state != "pass"
        self._blocked_since = INFINITY


def _turn_to(target: Array) -> float:
    """The turn in rad/s towards a place (2,) on the middle line of a passage."""
    turn = _PASSAGE_GAIN * atan2(target[1], target[0])
    return max(min(turn, _PASSAGE_TURN_RATE), -_PASSAGE_TURN_RATE)
