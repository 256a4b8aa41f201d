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
  backoff, Metcalfe and Boggs 1976). A robot that has come forward since it was last blocked waits.
- A robot that can neither turn nor go on takes the fastest twist that protection allows.

A robot in contact creeps by envelope.py (`Creeping`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random
from typing import TypeAlias

import numpy as np
from msgspec import Struct

from swarmd.core.values import ZERO, Array, Limits, Pose, Twist
from swarmd.protection.decision import Clearance, DecisionContext

_BLOCKED_SHARE = 0.5  # a robot with less than this share of the requested speed is blocked
_MOVE_BLOCKED_TIME = 0.1  # s of blocked motion before recovery begins
_TURN_BLOCKED_TIME = 1.0  # s of blocked turning before the robot backs off instead
_MIN_SPEED_SHARE = 0.1  # of the limits: a slower requested command never counts as blocked
_HARDLY_MOVES = 0.25  # share of this least linear speed: a slower robot hardly moves
_FOLLOW_TIME = 1.5  # s for which the robot follows a free corridor
_FOLLOW_GAIN = 2.0  # 1/s: rad/s for each rad that the heading is off the corridor
_BACK_OFF_TIME = 0.8  # s, the shortest back-off
_MAX_RECOVERY_TIME = 8.0  # s, in addition to the back-off, after which recovery ends
_SIDE_HOLD_TIME = 10.0  # s for which the robot keeps the chosen side
_SIDE_FLIP_PROBABILITY = 0.05  # of the left side, so that two robots do not mirror each other
_HEADING_TOLERANCE = math.radians(15.0)
_OTHER_SIDE_COST = math.radians(40.0)  # by which a corridor on the other side must be nearer
_YIELD_TIME = 12.0  # s, the longest back-off
_ROUND_TIME = 15.0  # s within which the next block belongs to the same meeting
_MIN_GAIN = 0.05  # m of progress since the last block after which a robot waits
_WAIT_TIMES = (1.0, 3.0)  # s for which it waits
_LIMITED_SHARE = 0.9  # of the requested speed: with less the robot looks for a narrow passage
_PASSAGE_WIDTHS = 1.4  # times the width of a corridor: a passage up to this width is narrow
_PURSUIT_LENGTH = 0.2  # m ahead on the middle line
_PASSAGE_GAIN, _PASSAGE_TURN_RATE = 3.0, 0.8  # 1/s, rad/s
_PASSAGE_REACH = (-0.15, 0.35)  # m ahead of the axle: walls there are the sides of a passage
# In a passage the request is at most this multiple of the allowed speed, plus this share of the
# linear limit.
_SPEED_UP, _SPEED_STEP = 1.3, 0.1
_STOPPED_TIME = 1.0  # s without motion in a passage after which the robot counts as blocked
# A robot that moves less than these m and turns less than these rad in these s counts as blocked.
_STALL_TIME = 5.0
_STALL_DISTANCE, _STALL_TURN = 0.04, 1.0
_CREEP_TIME = 4.0  # s, the longest back-off at a creep
_ESCAPE_TURNS = (0.0, 1.0, -1.0)  # rad/s
_CROWD_PATIENCE = 2.0  # s of blocked motion before recovery begins, if moving objects are near
_AXIS_BEARINGS = np.array((0.0, np.pi))
_BEARINGS = np.radians(np.arange(-180.0, 180.0, 10.0))


Points: TypeAlias = Callable[[], Array]
Allows: TypeAlias = Callable[[Twist], Twist]


class Others(Struct, frozen=True, gc=False):
    """What avoidance and right of way know about other moving objects."""

    wanted: Twist | None = None  # the request before avoidance; None: there was no avoidance
    are_near: bool = False  # moving objects are near
    are_avoided: bool = False  # the request leads past a moving object
    is_settled: bool = False  # the request gives way at an opening or passes it: recovery ends
    patience: float = 0.0  # s of blocked motion before recovery begins, at least


NO_OTHERS = Others()


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

    def __init__(self, clearance: Clearance, limits: Limits, seed: str) -> None:
        """`clearance` is the room that a corridor needs for nearly full speed under protection.

        `seed` seeds the random choices.
        """
        self.lookahead = clearance.ahead + _FOLLOW_TIME * limits.linear
        self._half_width = clearance.beside
        self._width = 2.0 * clearance.body
        self._limits = limits
        self._least_linear = _MIN_SPEED_SHARE * limits.linear
        self._least_angular = _MIN_SPEED_SHARE * limits.angular
        self._turn_rate = min(limits.angular, 1.5)
        self._turn_weight = (limits.linear / limits.angular) ** 2  # m2/s2 for each rad2/s2
        self._rng = Random(seed)
        self._side, self._side_until = -1.0, -math.inf
        self._bearing = self._planned_at_yaw = self._speed = 0.0
        self._is_backing = False
        self._escape: Twist | None = None
        self._back_off_count, self._back_time = 0, _BACK_OFF_TIME
        self._patience = _MOVE_BLOCKED_TIME
        self._last_block: tuple[float, Pose] | None = None
        self.reset()

    def reset(self) -> None:
        """Become inactive: the requested command passes."""
        self._request = ZERO
        self._last_motion: tuple[float, Pose] | None = None
        self._began_at = -math.inf
        self._blocked_since: float | None = None
        self._enter("follow", -math.inf)

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
        now, pattern_request = context.now, others.wanted or requested

        # 1. Ends a recovery that is not needed any more (right of way decides, too: `is_settled`),
        # or takes too long.
        has_taken_over, duration = self.has_taken_over, now - self._began_at
        if (
            others.is_settled
            or not (self._is_moving(pattern_request) or self._is_turning(pattern_request))
            or (has_taken_over and duration > _MAX_RECOVERY_TIME + self._back_time)
        ):
            self.reset()
            return requested

        # 2. Before a recovery. A robot that is neither blocked nor stalled keeps its request, which
        # is led along the middle line in a passage. A blocked robot waits, or begins a recovery.
        # `patience`: s of blocked motion before a recovery begins.
        patience = _CROWD_PATIENCE if others.are_near else self._patience
        is_blocked = self._is_blocked(safe, now, max(patience, others.patience))
        if not has_taken_over:
            if not is_blocked and not self._is_stalled(context, points):
                if others.are_avoided:
                    self._leave_passage()
                    self._request = requested
                else:
                    self._request = self._through_passage(requested, safe, points)
                return self._request
            if self._should_wait(context, points()):  # sets a longer `_patience` for the next block
                return self._request
            self._start(pattern_request, context, points())
            is_blocked = False  # the request was blocked, not yet the command of the recovery

        # 3. Continues the recovery.
        self._speed = max(self._speed, math.hypot(pattern_request.linear, pattern_request.lateral))
        self._request = self._recover(safe, context, points, is_blocked, safe_for)
        return self._request

    def _start(self, requested: Twist, context: DecisionContext, points: Array) -> None:
        """Begin a recovery: back off if a motion was blocked; choose a corridor if a turn was."""
        self._began_at, self._speed = context.now, 0.5 * self._limits.linear
        self._last_motion = None
        if self._is_moving(requested):
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
        request = self._request
        is_moving = self._is_moving(request)
        share = 1.0  # of the request that protection allows
        if self._state == "pass" or self._creeps(safe):
            share = 1.0 if abs(safe.linear) >= _HARDLY_MOVES * self._least_linear else 0.0
        elif is_moving or self._is_turning(request):
            share = self._product(safe, request) / self._product(request, request)
        if share >= _BLOCKED_SHARE:
            self._blocked_since = None
            return False
        if self._blocked_since is None:
            self._blocked_since = now
        if self._state == "pass":
            return now - self._blocked_since >= max(_STOPPED_TIME, patience)
        patience_in_state = patience if self._state == "follow" else _MOVE_BLOCKED_TIME
        return now - self._blocked_since >= (patience_in_state if is_moving else _TURN_BLOCKED_TIME)

    def _creeps(self, safe: Twist) -> bool:
        """True if protection lets a robot that backs off only creep, as in contact."""
        if self._state != "back":
            return False
        asked = self._request.linear
        allowed = safe.linear if asked > 0.0 else -safe.linear
        return 0.0 < allowed < _BLOCKED_SHARE * abs(asked)

    def _is_stalled(self, context: DecisionContext, points: Points) -> bool:
        """Update `_last_motion`; True: no progress near obstacles, although the robot may move.

        By odometry the robot has stayed near one place and heading for more than `_STALL_TIME` s:
        it rocks to and fro, or avoidance reduces its request to nearly zero. False without a return
        near the robot, and without odometry.
        """
        if context.odometry is None:
            return False
        now, pose = context.now, context.odometry.pose
        if self._last_motion is not None:
            since, start = self._last_motion
            distance = math.hypot(pose.x - start.x, pose.y - start.y)
            has_stayed = distance <= _STALL_DISTANCE and abs(pose.yaw - start.yaw) <= _STALL_TURN
            if has_stayed and now - since <= _STALL_TIME:
                return False
            if has_stayed and len(points()):
                return True
        self._last_motion = now, pose
        return False

    def _product(self, a: Twist, b: Twist) -> float:
        """The inner product of two twists in m2/s2.

        A turn at its limit weighs as much as motion at its limit. So a robot that may make the turn
        of its request does not count as blocked, even if it may hardly move.
        """
        weight = self._turn_weight
        return a.linear * b.linear + a.lateral * b.lateral + weight * a.angular * b.angular

    def _should_wait(self, context: DecisionContext, points: Array) -> bool:
        """Choose how a robot that has just been blocked gives way; True: it waits.

        If two robots meet between walls, a robot that has come forward since its last block waits
        once. Otherwise the robot backs off, each time for longer: sets `_back_time`,
        `_back_off_count` and `_patience`. In the open, or at the first block of a meeting, the
        back-off is short, since the robots can drive around each other.
        """
        # 1. Is the robot between walls: no corridor ahead is free up to the lookahead?
        now, pose = context.now, None if context.odometry is None else context.odometry.pose
        is_ahead = np.abs(_BEARINGS) <= 0.5 * np.pi
        is_enclosed = self._free_lengths(points, _BEARINGS[is_ahead]).max() < self.lookahead
        last_block, self._last_block = self._last_block, None if pose is None else (now, pose)
        has_waited = self._patience != _MOVE_BLOCKED_TIME  # since the last block: set in step 2
        self._patience = _MOVE_BLOCKED_TIME
        if (
            not is_enclosed
            or last_block is None
            or pose is None
            or now - last_block[0] > _ROUND_TIME
        ):
            self._back_off_count, self._back_time = 0, _BACK_OFF_TIME
            return False

        # 2. A further block of the same meeting: waits once after progress.
        dx, dy = pose.x - last_block[1].x, pose.y - last_block[1].y
        progress_m = math.cos(pose.yaw) * dx + math.sin(pose.yaw) * dy
        if progress_m > _MIN_GAIN and not has_waited:
            self._patience = self._rng.uniform(*_WAIT_TIMES)
            return True

        # 3. Else backs off for a random time whose bound doubles with each block.
        self._back_off_count += 1
        longest = min(_BACK_OFF_TIME * 2.0**self._back_off_count, _YIELD_TIME)
        self._back_time = self._rng.uniform(0.5, 1.0) * longest
        return False

    def _through_passage(self, requested: Twist, safe: Twist, points: Points) -> Twist:
        """The command that keeps to the middle of a narrow passage; else `requested`.

        `requested` passes if the robot is not in a narrow passage, or protection does not limit it.
        """
        share = safe.linear / requested.linear if requested.linear >= self._least_linear else 1.0
        is_limited = self._state == "pass" or (
            self._is_moving(self._request) and share < _LIMITED_SHARE
        )
        if requested.linear <= 0.0 or requested.lateral != 0.0 or not is_limited:
            self._leave_passage()
            return requested
        target = self.middle(points())
        if target is None:
            self._leave_passage()
            return requested
        if self._state == "follow":
            self._enter("pass", self._state_since)
        speed_bound = _SPEED_UP * max(safe.linear, 0.0) + _SPEED_STEP * self._limits.linear
        turn = _PASSAGE_GAIN * math.atan2(target[1], target[0])
        turn = max(min(turn, _PASSAGE_TURN_RATE), -_PASSAGE_TURN_RATE)
        return Twist(min(requested.linear, speed_bound), turn)

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
        back_time = _CREEP_TIME if self._creeps(safe) else self._back_time
        if self._state == "turn" and is_blocked:
            self._back_off(points(), now)
            self._escape = None if safe_for is None else self._fastest_escape(safe_for)
        elif self._state == "back" and (is_blocked or now - self._state_since >= back_time):
            self._plan(0.0, context, points())
        elif self._state == "go" and is_blocked:
            self._plan(self._bearing - self._turned_since_plan(context), context, points())

        # 2. The command of the state.
        if self._state == "back":
            return self._backing(points)
        yaw_error = math.remainder(self._bearing - self._turned_since_plan(context), 2.0 * math.pi)
        if self._state == "turn":
            if abs(yaw_error) > _HEADING_TOLERANCE:
                return Twist(angular=math.copysign(self._turn_rate, yaw_error))
            self._enter("go", now)
        if now - self._state_since >= _FOLLOW_TIME:
            self.reset()  # this command is the last one of the recovery
        turn = max(min(_FOLLOW_GAIN * yaw_error, self._turn_rate), -self._turn_rate)
        return Twist(self._speed, turn)

    def _backing(self, points: Points) -> Twist:
        """The command of state back; a long back-off follows the middle line of a passage."""
        speed = 0.5 * self._speed
        if self._escape is not None:
            return self._escape
        if not self._is_backing:
            return Twist(speed)
        if self._back_time <= _BACK_OFF_TIME:
            return Twist(-speed)
        target = self.middle(-points())  # seen from the rear
        turn = 0.0 if target is None else _PASSAGE_GAIN * math.atan2(target[1], target[0])
        return Twist(-2.0 * speed, max(min(turn, _PASSAGE_TURN_RATE), -_PASSAGE_TURN_RATE))

    def _is_moving(self, twist: Twist) -> bool:
        """True if the twist translates faster than the least speed."""
        if twist.lateral == 0.0:
            return abs(twist.linear) >= self._least_linear
        return math.hypot(twist.linear, twist.lateral) >= self._least_linear

    def _is_turning(self, twist: Twist) -> bool:
        """True if the twist turns faster than the least speed."""
        return abs(twist.angular) >= self._least_angular

    def _leave_passage(self) -> None:
        if self._state == "pass":
            self._enter("follow", self._state_since)

    def middle(self, points: Array) -> Array | None:
        """(2,) a place in m ahead on the middle line of a narrow passage; None without a passage.

        `points` (k, 2) are returns in m in the base frame. The sides of the passage are the two
        returns, one to the left and one to the right, that are nearest to each other.
        """
        rear_m, front_m = _PASSAGE_REACH
        widest = 2.0 * _PASSAGE_WIDTHS * self._half_width
        x, y = points[:, 0], points[:, 1]
        beside = points[(x > rear_m) & (x < front_m) & (np.abs(y) < widest)]
        left, right = beside[beside[:, 1] > 0.0], beside[beside[:, 1] <= 0.0]
        if not len(left) or not len(right):
            return None
        across = left[:, None] - right[None]
        widths = np.hypot(across[..., 0], across[..., 1])
        i, j = divmod(int(widths.argmin()), len(right))
        width = widths[i, j]
        if not self._width < width < widest:
            return None
        direction = np.array((across[i, j, 1], -across[i, j, 0])) / width  # through the passage
        middle = 0.5 * (left[i] + right[j])
        target: Array = middle - direction * (middle @ direction - _PURSUIT_LENGTH)
        return target if target[0] > 0.0 else None

    def _back_off(self, points: Array, now: float) -> None:
        """Move forward or backward, to the side with more room."""
        ahead, behind = self._free_lengths(points, _AXIS_BEARINGS)
        self._is_backing, self._escape = bool(behind > ahead), None
        self._enter("back", now)

    def _fastest_escape(self, safe_for: Allows) -> Twist | None:
        """The fastest of six twists that protection allows; None if protection allows none."""
        speed, fastest, escape = 0.5 * self._speed, 0.0, None
        for sign in (-1.0, 1.0) if self._is_backing else (1.0, -1.0):
            for turn in _ESCAPE_TURNS:
                twist = Twist(sign * speed, turn)
                allowed = sign * safe_for(twist).linear
                if allowed > fastest + 0.01 * speed:
                    fastest, escape = allowed, twist
        return escape

    def _plan(self, heading: float, context: DecisionContext, points: Array) -> None:
        """Choose a free corridor near `heading` (bearing in rad), and enter the state turn.

        A corridor costs its angle from the heading. A corridor on the side that was not chosen
        costs more, as does a corridor that is not free up to `lookahead`.
        """
        now = context.now
        if now >= self._side_until:
            self._side = 1.0 if self._rng.random() < _SIDE_FLIP_PROBABILITY else -1.0
        self._side_until = now + _SIDE_HOLD_TIME
        angles_off = np.remainder(_BEARINGS - heading + np.pi, 2.0 * np.pi) - np.pi
        is_other_side = angles_off * self._side < -1e-9
        costs = np.abs(angles_off) + _OTHER_SIDE_COST * is_other_side
        free = self._free_lengths(points, _BEARINGS)
        # 20 rad for each m that is not free: 0.2 m outweigh any angle.
        costs += 20.0 * np.maximum(self.lookahead - free, 0.0)
        best = int(costs.argmin())
        self._bearing = float(_BEARINGS[best])
        self._planned_at_yaw = 0.0 if context.odometry is None else context.odometry.pose.yaw
        self._enter("turn", now)

    def _free_lengths(self, points: Array, bearings: Array) -> Array:
        """(b,) m of free corridor from the axle along each bearing (b,)."""
        cos, sin = np.cos(bearings)[:, None], np.sin(bearings)[:, None]
        x, y = points[:, 0], points[:, 1]
        ahead, aside = cos * x + sin * y, cos * y - sin * x
        is_in = (ahead > 0.0) & (np.abs(aside) < self._half_width)
        free: Array = np.where(is_in, ahead, self.lookahead).min(axis=1, initial=self.lookahead)
        return free

    def _turned_since_plan(self, context: DecisionContext) -> float:
        """The turn in rad since the corridor was chosen."""
        if context.odometry is None:
            return math.copysign(self._turn_rate * (context.now - self._state_since), self._bearing)
        return context.odometry.pose.yaw - self._planned_at_yaw

    def _enter(self, state: str, now: float) -> None:
        self._state, self._state_since = state, now
        self.is_active = state != "follow"
        self.has_taken_over = state not in {"follow", "pass"}
        self._blocked_since = None
