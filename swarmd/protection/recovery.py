"""Recovery: steers a blocked robot around an obstacle, before protection judges the command.

Recovery replaces the requested command, and its own requests pass the same arbiter; so it cannot
weaken protection. Without it, two robots that meet head on would block each other for good.
Recovery looks for a free corridor of the robot's width near the requested heading and prefers the
right side (after the vector field histogram, Borenstein and Koren 1991).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random
from typing import NamedTuple, TypeAlias

import numpy as np

from swarmd.core.values import ZERO, Array, Limits, Twist
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
_AXIS_BEARINGS = np.array((0.0, np.pi))
_BEARINGS = np.radians(np.arange(-180.0, 180.0, 10.0))


Points: TypeAlias = Callable[[], Array]


class Clearance(NamedTuple):
    """Free room in m from the axle that a corridor needs: `ahead`, and `beside` per side."""

    ahead: float
    beside: float


class Recovery:
    """States: follow (inactive), back (off), turn (to a free corridor), go (along it).

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
        self._limits = limits
        self._least_linear = _MIN_SPEED_SHARE * limits.linear
        self._least_angular = _MIN_SPEED_SHARE * limits.angular
        self._turn_rate = min(limits.angular, 1.5)
        self._rng = Random(seed)
        self._side, self._side_until = -1.0, -math.inf
        self._bearing = self._yaw = self._speed = 0.0
        self._is_backing = False
        self.reset()

    def reset(self) -> None:
        """Become inactive: the requested command passes."""
        self._state, self._request = "follow", ZERO
        self._since = self._began = -math.inf
        self._blocked_since: float | None = None

    @property
    def is_active(self) -> bool:
        """True while recovery replaces the requested command."""
        return self._state != "follow"

    def replacement(
        self, requested: Twist, safe: Twist, context: DecisionContext, points: Points
    ) -> Twist:
        """The command to request instead; `requested` itself while nothing blocks it.

        `safe` is the last safe command, `points` returns the scan as points (k, 2) in the base
        frame in m.
        """
        now = context.now
        is_idle = not (self._is_moving(requested) or self._is_turning(requested))
        if is_idle or (self.is_active and now - self._began > _MAX_RECOVERY_TIME):
            self.reset()
            return requested
        is_blocked = self._is_blocked(safe, now)
        if not self.is_active:
            if not is_blocked:
                self._request = requested
                return requested
            self._start(requested, context, points())
            is_blocked = False
        self._speed = max(self._speed, math.hypot(requested.linear, requested.lateral))
        self._request = self._recover(context, points, is_blocked)
        return self._request

    def _start(self, requested: Twist, context: DecisionContext, points: Array) -> None:
        """Back off if moving was blocked; plan at once if turning was."""
        self._began, self._speed = context.now, 0.5 * self._limits.linear
        if self._is_moving(requested):
            self._back_off(points, context.now)
        else:
            self._plan(0.0, context, points)

    def _is_blocked(self, safe: Twist, now: float) -> bool:
        """True once the safe command has been far below the last request for some time."""
        request = self._request
        is_moving = self._is_moving(request)
        share = 1.0
        if is_moving:
            share = safe.linear * request.linear + safe.lateral * request.lateral
            share /= request.linear**2 + request.lateral**2
        elif self._is_turning(request):
            share = safe.angular / request.angular
        if share >= _BLOCKED_SHARE:
            self._blocked_since = None
            return False
        if self._blocked_since is None:
            self._blocked_since = now
        return now - self._blocked_since >= (
            _MOVE_BLOCKED_TIME if is_moving else _TURN_BLOCKED_TIME
        )

    def _recover(self, context: DecisionContext, points: Points, is_blocked: bool) -> Twist:
        """Change the state if necessary; the command of the present state."""
        now = context.now
        if self._state == "turn" and is_blocked:
            self._back_off(points(), now)
        elif self._state == "back" and (is_blocked or now - self._since >= _BACK_OFF_TIME):
            self._plan(0.0, context, points())
        elif self._state == "go" and is_blocked:
            self._plan(self._bearing - self._turned_since_plan(context), context, points())
        if self._state == "back":
            return Twist(-0.5 * self._speed if self._is_backing else 0.5 * self._speed)
        left = math.remainder(self._bearing - self._turned_since_plan(context), 2.0 * math.pi)
        if self._state == "turn":
            if abs(left) > _HEADING_TOLERANCE:
                return Twist(angular=math.copysign(self._turn_rate, left))
            self._enter("go", now)
        if now - self._since >= _FOLLOW_TIME:
            self.reset()
        return Twist(self._speed, max(min(2.0 * left, self._turn_rate), -self._turn_rate))

    def _is_moving(self, twist: Twist) -> bool:
        """True if the twist translates faster than the least speed."""
        if twist.lateral == 0.0:
            return abs(twist.linear) >= self._least_linear
        return math.hypot(twist.linear, twist.lateral) >= self._least_linear

    def _is_turning(self, twist: Twist) -> bool:
        """True if the twist turns faster than the least speed."""
        return abs(twist.angular) >= self._least_angular

    def _back_off(self, points: Array, now: float) -> None:
        """Move forward or backward, to the side with more room."""
        ahead, behind = self._free_lengths(points, _AXIS_BEARINGS)
        self._is_backing = bool(behind > ahead)
        self._enter("back", now)

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
