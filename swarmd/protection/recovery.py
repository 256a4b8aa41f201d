"""Leads a robot around what blocks its way: acts on the wish, before protection judges it.

So it cannot weaken protection: whatever it asks for passes the same arbiter. A filter that only
says no leaves robots standing face to face; this looks for a way near the one that is wished, as a
person would who steps aside to the right. The free ways are the corridors of the robot's width in
which the lidar sees nothing near (after the vector field histogram, Borenstein and Koren 1991).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random
from typing import NamedTuple, TypeAlias

import numpy as np

from swarmd.core.values import ZERO, Array, Limits, Twist
from swarmd.protection.decision import DecisionContext

_BLOCKED = 0.5  # who gets less than this share of the speed he asks for is blocked
_PATIENCE = 0.1  # s for which it is so before something is done
_LEAST = 0.1  # of the limits: slower wishes are not going anywhere
_STANDS = 1.0  # s after which turning that does not turn gives way to moving along the axis
_FOLLOWS = 1.5  # s for which a free way is followed
_BACKS = 0.8  # s
_ENDS = 8.0  # s after which it lets go, whatever has come of it
_KEEPS_SIDE = 10.0  # s for which it goes on to the side that it has once chosen
_FLIP = 0.05  # chance to take the other side, so that two do not dance for ever
_ALIGNED = math.radians(15.0)
_OTHER_SIDE = math.radians(40.0)  # what a way on the other side must be nearer, to be taken
_AXIS = np.array((0.0, np.pi))
_WAYS = np.radians(np.arange(-180.0, 180.0, 10.0))


Points: TypeAlias = Callable[[], Array]


class Clearance(NamedTuple):
    """The room that a way needs in m from the axle: straight `ahead`, and to each side."""

    ahead: float
    beside: float


class Recovery:
    """States: follow the wish, turn to a free way, go along it, back off. Times in s, handed in.

    `sight` is how far it has to see, in m from the axle.
    """

    def __init__(self, clearance: Clearance, limits: Limits, seed: str) -> None:
        """`berth` is that of a speed at ease; `seed` decides random choices."""
        self.sight = clearance.ahead + _FOLLOWS * limits.linear
        self._half = clearance.beside
        self._limits = limits
        self._turn = min(limits.angular, 1.5)
        self._rng = Random(seed)
        self._side, self._side_until = -1.0, -math.inf
        self._way = self._yaw = self._pace = 0.0
        self._backwards = False
        self.reset()

    def reset(self) -> None:
        """Follow the wish again."""
        self._state, self._asked = "follow", ZERO
        self._since = self._began = -math.inf
        self._blocked_since: float | None = None

    @property
    def is_leading(self) -> bool:
        """True while something else than the wish is asked for."""
        return self._state != "follow"

    def instead(
        self, requested: Twist, given: Twist, moment: DecisionContext, points: Points
    ) -> Twist:
        """What to ask for instead of the wish; the wish itself while nothing blocks it.

        `given` is what protection last made of what was asked for, `points` gives (k, 2) what the
        lidar saw, in the base frame in m.
        """
        now = moment.now
        is_idle = not (self._goes(requested) or self._turns(requested))
        if is_idle or (self.is_leading and now - self._began > _ENDS):
            self.reset()
            return requested
        is_blocked = self._is_blocked(given, now)
        if not self.is_leading:
            if not is_blocked:
                self._asked = requested
                return requested
            self._begin(requested, moment, points())
            is_blocked = False
        self._pace = max(self._pace, math.hypot(requested.linear, requested.lateral))
        self._asked = self._lead(moment, points, is_blocked)
        return self._asked

    def _begin(self, requested: Twist, moment: DecisionContext, points: Array) -> None:
        """Make room first, or where it is turning that is blocked, go to where there is some."""
        self._began, self._pace = moment.now, 0.5 * self._limits.linear
        if self._goes(requested):
            self._back_off(points, moment.now)
        else:
            self._plan(0.0, moment, points)

    def _is_blocked(self, given: Twist, now: float) -> bool:
        """True once it has for a while got next to nothing of what it asked for."""
        asked = self._asked
        goes = self._goes(asked)
        got = 1.0
        if goes:
            got = given.linear * asked.linear + given.lateral * asked.lateral
            got /= asked.linear**2 + asked.lateral**2
        elif self._turns(asked):
            got = given.angular / asked.angular
        if got >= _BLOCKED:
            self._blocked_since = None
            return False
        if self._blocked_since is None:
            self._blocked_since = now
        return now - self._blocked_since >= (_PATIENCE if goes else _STANDS)

    def _lead(self, moment: DecisionContext, points: Points, is_blocked: bool) -> Twist:
        now = moment.now
        if self._state == "turn" and is_blocked:
            self._back_off(points(), now)
        elif self._state == "back" and (is_blocked or now - self._since >= _BACKS):
            self._plan(0.0, moment, points())
        elif self._state == "go" and is_blocked:
            self._plan(self._way - self._turned(moment), moment, points())
        if self._state == "back":
            return Twist(-0.5 * self._pace if self._backwards else 0.5 * self._pace)
        left = math.remainder(self._way - self._turned(moment), 2.0 * math.pi)
        if self._state == "turn":
            if abs(left) > _ALIGNED:
                return Twist(angular=math.copysign(self._turn, left))
            self._enter("go", now)
        if now - self._since >= _FOLLOWS:
            self.reset()
        return Twist(self._pace, max(min(2.0 * left, self._turn), -self._turn))

    def _goes(self, twist: Twist) -> bool:
        """True if it is to get somewhere."""
        return math.hypot(twist.linear, twist.lateral) >= _LEAST * self._limits.linear

    def _turns(self, twist: Twist) -> bool:
        """True if it is to turn."""
        return abs(twist.angular) >= _LEAST * self._limits.angular

    def _back_off(self, points: Array, now: float) -> None:
        """Move along the axis, to where there is more room."""
        ahead, behind = self._free(points, _AXIS)
        self._backwards = bool(behind > ahead)
        self._enter("back", now)

    def _plan(self, wished: float, moment: DecisionContext, points: Array) -> None:
        """Choose a free way near the one wished, both as bearings in rad from here."""
        now = moment.now
        if now >= self._side_until:
            self._side = 1.0 if self._rng.random() < _FLIP else -1.0
        self._side_until = now + _KEEPS_SIDE
        off = np.remainder(_WAYS - wished + np.pi, 2.0 * np.pi) - np.pi
        is_other = off * self._side < -1e-9
        costs = np.abs(off) + _OTHER_SIDE * is_other
        free = self._free(points, _WAYS)
        costs += 20.0 * np.maximum(self.sight - free, 0.0)
        best = int(costs.argmin())
        self._way = float(_WAYS[best])
        self._yaw = 0.0 if moment.odometry is None else moment.odometry.pose.yaw
        self._enter("turn", now)

    def _free(self, points: Array, ways: Array) -> Array:
        """(w,) m of corridor that is free from the axle along each bearing (w,)."""
        cos, sin = np.cos(ways)[:, None], np.sin(ways)[:, None]
        x, y = points[:, 0], points[:, 1]
        ahead, aside = cos * x + sin * y, cos * y - sin * x
        is_in = (ahead > 0.0) & (np.abs(aside) < self._half)
        free: Array = np.where(is_in, ahead, self.sight).min(axis=1, initial=self.sight)
        return free

    def _turned(self, moment: DecisionContext) -> float:
        """How far it has turned since the way was chosen, in rad."""
        if moment.odometry is None:
            return math.copysign(self._turn * (moment.now - self._since), self._way)
        return moment.odometry.pose.yaw - self._yaw

    def _enter(self, state: str, now: float) -> None:
        self._state, self._since = state, now
        self._blocked_since = None
