"""Recovery: steers a blocked robot around an obstacle, before protection judges the command.

Recovery replaces the requested command, and its own requests pass the same arbiter; so it cannot
weaken protection. Without it, two robots that meet head on would block each other for good.
Recovery looks for a free corridor of the robot's width near the robot's present heading and prefers
the right side (after the vector field histogram, Borenstein and Koren 1991).

In a door or a narrow corridor it keeps the robot on the middle line (pure pursuit, Coulter 1992)
and asks for little more speed than protection allows; otherwise protection would turn the robot
aside, because a turn can leave it more speed. Where two meet and neither can pass, each backs off
for a random time that grows (Metcalfe and Boggs 1976); a robot that has gained ground waits. A
robot that can neither turn nor go on moves along the way that protection allows most.

The creeping of a robot that touches something is in envelope.py (`Creeping`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random
from typing import NamedTuple, TypeAlias

import numpy as np

from swarmd.core.values import ZERO, Array, Limits, Pose, Twist
from swarmd.protection.decision import DecisionContext

_BLOCKED_SHARE = 0.5  # a robot with less than this share of the requested speed is blocked
_MOVE_BLOCKED_TIME = 0.1  # s of blocked motion before recovery begins
_TURN_BLOCKED_TIME = 1.0  # s of blocked turning before it backs off instead
_MIN_SPEED_SHARE = 0.1  # of the limits: a slower requested command never counts as blocked
_FOLLOW_TIME = 1.5  # s for which it follows a free corridor
_BACK_OFF_TIME = 0.8  # s
_MAX_RECOVERY_TIME = 8.0  # s after which it gives up
_SIDE_HOLD_TIME = 10.0  # s for which it keeps the chosen side
_SIDE_FLIP_PROBABILITY = 0.05  # of the left side, so that two robots do not mirror each other
_HEADING_TOLERANCE = math.radians(15.0)
_OTHER_SIDE_COST = math.radians(40.0)  # by which a corridor on the other side must be nearer
_YIELD_TIME = 12.0  # s, the longest back-off
_ROUND_TIME = 15.0  # s within which the next block belongs to the same meeting
_MIN_GAIN = 0.05  # m of progress since the last block with which a robot lets the other yield
_PATIENCE = (1.0, 3.0)  # s for which it then waits
_LIMITED_SHARE = 0.9  # of the requested speed: with less it looks for a narrow passage
_PASSAGE_WIDTHS = 1.4  # of a corridor: a passage up to this width is narrow
_PURSUIT_LENGTH = 0.2  # m ahead on the middle line
_PASSAGE_GAIN, _PASSAGE_TURN_RATE = 3.0, 0.8  # 1/s, rad/s
_PASSAGE_REACH = (-0.15, 0.35)  # m before the axle at which the sides of a passage count
_SPEED_UP, _SPEED_STEP = 1.3, 0.1  # of the allowed speed, and of the limit in addition
_STOPPED_TIME = 1.0  # s without motion in a passage after which it counts as blocked
_STALL_TIME = 5.0  # s within which a robot must move or turn by these, or it counts as blocked
_STALL_WAY, _STALL_TURN = 0.04, 1.0  # m, rad
_CREEP_TIME = 4.0  # s, the longest back-off at a creep
_ESCAPE_TURNS = (0.0, 1.0, -1.0)  # rad/s
_CROWD_PATIENCE = 2.0  # s of blocked motion before a robot beside others recovers
_AXIS_BEARINGS = np.array((0.0, np.pi))
_BEARINGS = np.radians(np.arange(-180.0, 180.0, 10.0))


Points: TypeAlias = Callable[[], Array]
Allows: TypeAlias = Callable[[Twist], Twist]


class Clearance(NamedTuple):
    """Free room in m from the axle that a corridor needs: `ahead`, and `beside` per side.

    `body` is the part of `beside` that the outline takes.
    """

    ahead: float
    beside: float
    body: float = 0.0


class Others(NamedTuple):
    """What avoidance knows: whether moving objects are near, and whether one is led past.

    `wanted` is the pattern's request if avoidance has replaced it. `is_settled`: the request gives
    way at an opening, or passes one, and recovery adds nothing.
    """

    wanted: Twist | None = None
    are_near: bool = False
    are_avoided: bool = False
    is_settled: bool = False


NO_OTHERS = Others()


class Recovery:
    """States: follow (inactive), pass (a narrow passage), back (off), turn and go (to a corridor).

    Times are in s and come with each call. `lookahead` is the length in m from the axle up to
    which a corridor is checked.
    """

    def __init__(self, clearance: Clearance, limits: Limits, seed: str) -> None:
        """`seed` seeds the random choices.

        `clearance` is the room, ahead and to each side, that a corridor needs so that protection
        allows nearly full speed.
        """
        self.lookahead = clearance.ahead + _FOLLOW_TIME * limits.linear
        self._half_width = clearance.beside
        self._width = 2.0 * clearance.body
        self._limits = limits
        self._least_linear = _MIN_SPEED_SHARE * limits.linear
        self._least_angular = _MIN_SPEED_SHARE * limits.angular
        self._turn_rate = min(limits.angular, 1.5)
        self._rng = Random(seed)
        self._side, self._side_until = -1.0, -math.inf
        self._bearing = self._yaw = self._speed = 0.0
        self._is_backing = False
        self._escape: Twist | None = None
        self._attempts, self._back_time = 0, _BACK_OFF_TIME
        self._patience = _MOVE_BLOCKED_TIME
        self._last_block: tuple[float, Pose] | None = None
        self.reset()

    def reset(self) -> None:
        """Become inactive: the requested command passes."""
        self._state, self._request = "follow", ZERO
        self._moved: tuple[float, Pose] | None = None
        self._since = self._began = -math.inf
        self._blocked_since: float | None = None

    @property
    def is_active(self) -> bool:
        """True while recovery replaces the requested command."""
        return self._state != "follow"

    @property
    def has_taken_over(self) -> bool:
        """True while the command does not depend on the requested one."""
        return self._state not in {"follow", "pass"}

    def replacement(
        self,
        requested: Twist,
        safe: Twist,
        context: DecisionContext,
        points: Points,
        others: Others = NO_OTHERS,
        allows: Allows | None = None,
    ) -> Twist:
        """The command to request instead; `requested` itself while nothing blocks it.

        `safe` is the last safe command, `points` returns the scan as points (k, 2) in the base
        frame in m, `allows` the safe command for a requested one.
        """
        now, wanted = context.now, others.wanted or requested
        is_idle = not (self._is_moving(wanted) or self._is_turning(wanted))
        since = now - self._began
        if (
            is_idle
            or others.is_settled
            or (self.has_taken_over and since > _MAX_RECOVERY_TIME + self._back_time)
        ):
            self.reset()
            return requested
        patience = _CROWD_PATIENCE if others.are_near else self._patience
        is_blocked = self._is_blocked(safe, now, patience)
        if not self.has_taken_over:
            if not is_blocked and not self._is_stalled(context, points):
                if others.are_avoided:
                    self._leave_passage()
                    self._request = requested
                else:
                    self._request = self._through_passage(requested, safe, points)
                return self._request
            if self._waits(context, points()):
                return self._request
            self._start(wanted, context, points())
            is_blocked = False
        self._speed = max(self._speed, math.hypot(wanted.linear, wanted.lateral))
        self._request = self._recover(safe, context, points, is_blocked, allows)
        return self._request

    def _start(self, requested: Twist, context: DecisionContext, points: Array) -> None:
        """Back off if moving was blocked; plan at once if turning was."""
        self._began, self._speed = context.now, 0.5 * self._limits.linear
        self._moved = None
        if self._is_moving(requested):
            self._back_off(points, context.now)
        else:
            self._plan(0.0, context, points)

    def _is_blocked(self, safe: Twist, now: float, patience: float) -> bool:
        """True once the safe command has been far below the last request for some time."""
        request = self._request
        is_moving = self._is_moving(request)
        share = 1.0
        if self._state == "pass" or self._creeps(safe):
            share = 1.0 if abs(safe.linear) >= 0.25 * self._least_linear else 0.0
        elif is_moving or self._is_turning(request):
            share = self._product(safe, request) / self._product(request, request)
        if share >= _BLOCKED_SHARE:
            self._blocked_since = None
            return False
        if self._blocked_since is None:
            self._blocked_since = now
        if self._state == "pass":
            return now - self._blocked_since >= max(_STOPPED_TIME, patience)
        least = patience if self._state == "follow" else _MOVE_BLOCKED_TIME
        return now - self._blocked_since >= (least if is_moving else _TURN_BLOCKED_TIME)

    def _creeps(self, safe: Twist) -> bool:
        """True if a robot that backs off may only creep, as it must until it is out of contact."""
        asked = self._request.linear
        allowed = safe.linear if asked > 0.0 else -safe.linear
        return self._state == "back" and 0.0 < allowed < _BLOCKED_SHARE * abs(asked)

    def _is_stalled(self, context: DecisionContext, points: Points) -> bool:
        """True if the robot has neither moved nor turned for some time, whatever was allowed.

        It may rock to and fro, or get a request near zero from avoidance. A base that does not move
        with nothing near is not blocked.
        """
        if context.odometry is None:
            return False
        now, pose = context.now, context.odometry.pose
        if self._moved is not None:
            since, place = self._moved
            way = math.hypot(pose.x - place.x, pose.y - place.y)
            is_there = way <= _STALL_WAY and abs(pose.yaw - place.yaw) <= _STALL_TURN
            if is_there and (now - since <= _STALL_TIME or len(points())):
                return now - since > _STALL_TIME
        self._moved = now, pose
        return False

    def _product(self, a: Twist, b: Twist) -> float:
        """The inner product of two twists in m2/s2, with turns scaled by the ratio of the limits.

        So a robot that may make the turn of its request is not blocked, however slowly it moves.
        """
        scale = (self._limits.linear / self._limits.angular) ** 2
        return a.linear * b.linear + a.lateral * b.lateral + scale * a.angular * b.angular

    def _waits(self, context: DecisionContext, points: Array) -> bool:
        """True if the robot should wait for the other one to yield; counts its own attempts.

        Of two that meet, the one that has come forward since it was blocked last waits; the other
        backs off for longer. In the open each drives around the other instead.
        """
        now, pose = context.now, None if context.odometry is None else context.odometry.pose
        is_beside = np.abs(_BEARINGS) <= 0.5 * np.pi
        is_enclosed = self._free_lengths(points, _BEARINGS[is_beside]).max() < self.lookahead
        before, self._last_block = self._last_block, None if pose is None else (now, pose)
        patience, self._patience = self._patience, _MOVE_BLOCKED_TIME
        if not is_enclosed or before is None or pose is None or now - before[0] > _ROUND_TIME:
            self._attempts, self._back_time = 0, _BACK_OFF_TIME
            return False
        dx, dy = pose.x - before[1].x, pose.y - before[1].y
        gain = math.cos(pose.yaw) * dx + math.sin(pose.yaw) * dy
        if gain > _MIN_GAIN and patience == _MOVE_BLOCKED_TIME:
            self._patience = self._rng.uniform(*_PATIENCE)
            return True
        self._attempts += 1
        longest = min(_BACK_OFF_TIME * 2.0**self._attempts, _YIELD_TIME)
        self._back_time = self._rng.uniform(0.5, 1.0) * longest
        return False

    def _through_passage(self, requested: Twist, safe: Twist, points: Points) -> Twist:
        """The command that keeps to the middle of a narrow passage; `requested` outside of one."""
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
            self._enter("pass", self._since)
        allowed = _SPEED_UP * max(safe.linear, 0.0) + _SPEED_STEP * self._limits.linear
        turn = _PASSAGE_GAIN * math.atan2(target[1], target[0])
        turn = max(min(turn, _PASSAGE_TURN_RATE), -_PASSAGE_TURN_RATE)
        return Twist(min(requested.linear, allowed), turn)

    def _recover(
        self,
        safe: Twist,
        context: DecisionContext,
        points: Points,
        is_blocked: bool,
        allows: Allows | None,
    ) -> Twist:
        """Change the state if necessary; the command of the present state."""
        now = context.now
        back_time = _CREEP_TIME if self._creeps(safe) else self._back_time
        if self._state == "turn" and is_blocked:
            self._back_off(points(), now)
            self._escape = None if allows is None else self._fastest_escape(allows)
        elif self._state == "back" and (is_blocked or now - self._since >= back_time):
            self._plan(0.0, context, points())
        elif self._state == "go" and is_blocked:
            self._plan(self._bearing - self._turned_since_plan(context), context, points())
        if self._state == "back":
            return self._backing(points)
        left = math.remainder(self._bearing - self._turned_since_plan(context), 2.0 * math.pi)
        if self._state == "turn":
            if abs(left) > _HEADING_TOLERANCE:
                return Twist(angular=math.copysign(self._turn_rate, left))
            self._enter("go", now)
        if now - self._since >= _FOLLOW_TIME:
            self.reset()
        return Twist(self._speed, max(min(2.0 * left, self._turn_rate), -self._turn_rate))

    def _backing(self, points: Points) -> Twist:
        """The command that backs off, along the middle line of a narrow passage."""
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
            self._enter("follow", self._since)

    def middle(self, points: Array) -> Array | None:
        """(2,) a place ahead on the middle line of a narrow passage; None where there is none.

        The passage is between the nearest pair of a return to the left and one to the right.
        """
        first, last = _PASSAGE_REACH
        widest = 2.0 * _PASSAGE_WIDTHS * self._half_width
        x, y = points[:, 0], points[:, 1]
        near = points[(x > first) & (x < last) & (np.abs(y) < widest)]
        left, right = near[near[:, 1] > 0.0], near[near[:, 1] <= 0.0]
        if not len(left) or not len(right):
            return None
        across = left[:, None] - right[None]
        widths = np.hypot(across[..., 0], across[..., 1])
        i, j = divmod(int(widths.argmin()), len(right))
        width = widths[i, j]
        if not self._width < width < widest:
            return None
        along = np.array((across[i, j, 1], -across[i, j, 0])) / width
        middle = 0.5 * (left[i] + right[j])
        target: Array = middle - along * (middle @ along - _PURSUIT_LENGTH)
        return target if target[0] > 0.0 else None

    def _back_off(self, points: Array, now: float) -> None:
        """Move forward or backward, to the side with more room."""
        ahead, behind = self._free_lengths(points, _AXIS_BEARINGS)
        self._is_backing, self._escape = bool(behind > ahead), None
        self._enter("back", now)

    def _fastest_escape(self, allows: Allows) -> Twist | None:
        """The fastest of six twists that protection allows; None if protection allows none."""
        speed, fastest, escape = 0.5 * self._speed, 0.0, None
        for sign in (-1.0, 1.0) if self._is_backing else (1.0, -1.0):
            for turn in _ESCAPE_TURNS:
                twist = Twist(sign * speed, turn)
                allowed = sign * allows(twist).linear
                if allowed > fastest + 0.01 * speed:
                    fastest, escape = allowed, twist
        return escape

    def _plan(self, heading: float, context: DecisionContext, points: Array) -> None:
        """Choose the free corridor nearest to `heading`, a bearing in rad in the base frame."""
        now = context.now
        if now >= self._side_until:
            self._side = 1.0 if self._rng.random() < _SIDE_FLIP_PROBABILITY else -1.0
        self._side_until = now + _SIDE_HOLD_TIME
        off = np.remainder(_BEARINGS - heading + np.pi, 2.0 * np.pi) - np.pi
        is_other = off * self._side < -1e-9
        costs = np.abs(off) + _OTHER_SIDE_COST * is_other
        free = self._free_lengths(points, _BEARINGS)
        costs += 20.0 * np.maximum(self.lookahead - free, 0.0)
        best = int(costs.argmin())
        self._bearing = float(_BEARINGS[best])
        self._yaw = 0.0 if context.odometry is None else context.odometry.pose.yaw
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
            return math.copysign(self._turn_rate * (context.now - self._since), self._bearing)
        return context.odometry.pose.yaw - self._yaw

    def _enter(self, state: str, now: float) -> None:
        self._state, self._since = state, now
        self._blocked_since = None
