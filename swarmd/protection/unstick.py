"""Leads a robot around what blocks its way: acts on the wish, before protection judges it.

So it cannot weaken protection: whatever it asks for passes the same arbiter. A filter that only
says no leaves robots standing face to face; this gives each a way of its own, as a person would
who steps aside to the right.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random

import numpy as np

from swarmd.values import Scan, Twist

BLOCKED = 0.3
"""Blocked is who gets less than this share of the speed that he wishes."""
FREE = 0.6
"""A way is free that allows this share of it."""

_PATIENCE = 0.3  # s for which it is blocked before it acts
_STRAIGHT = 1.0  # s for which it follows a way that it has found free
_STANDS = 2.0  # s after which turning that does not turn gives way to backing off
_BACKS = 1.0  # s
_ENDS = 8.0  # s after which it lets go, whatever has come of it
_KEEPS_SIDE = 10.0  # s for which it goes on to the side it has once chosen
_LEAST = 0.02  # m/s: slower wishes are not going anywhere
_FLIP = 0.15  # chance to take the other side, so that two do not dance for ever
_EVEN = 0.1  # m: what two sides must differ by to matter

Allowed = Callable[[Twist], Twist]


class Unstick:
    """States: follow the wish, turn to a free way, go along it, back off. Times in s, handed in."""

    def __init__(self, angular: float, seed: str) -> None:
        """The base's limit in rad/s; `seed` decides its random choices."""
        self._turn = min(angular, 1.5)
        self._rng = Random(seed)
        self._side = -1.0
        self._side_until = -math.inf
        self.reset()

    def reset(self) -> None:
        """Follow the wish again."""
        self._state = "follow"
        self._since = self._began = -math.inf
        self._blocked_since: float | None = None

    @property
    def is_leading(self) -> bool:
        """True while something else than the wish is asked for."""
        return self._state != "follow"

    def instead(
        self, wish: Twist, given: Twist, now: float, scan: Scan | None, allowed: Allowed
    ) -> Twist:
        """What to ask for instead of the wish; the wish itself while nothing blocks it.

        `given` is what protection makes of the wish now, and `allowed` what of any twist.
        """
        speed = math.hypot(wish.linear, wish.lateral)
        if speed < _LEAST:
            self.reset()
            return wish
        if self._state == "follow":
            if not self._is_blocked_for_long(wish, given, now):
                return wish
            self._choose_side(now, scan)
            self._began = now
            self._enter("turn", now)
        elif now - self._began > _ENDS:
            self.reset()
            return wish
        return self._lead(speed, now, allowed)

    def _is_blocked_for_long(self, wish: Twist, given: Twist, now: float) -> bool:
        if _share(given, wish) >= BLOCKED:
            self._blocked_since = None
            return False
        if self._blocked_since is None:
            self._blocked_since = now
        return now - self._blocked_since >= _PATIENCE

    def _lead(self, speed: float, now: float, allowed: Allowed) -> Twist:
        ahead = Twist(speed)
        if self._state == "back":
            if now - self._since < _BACKS:
                return Twist(-0.5 * speed)
            self._enter("turn", now)
        if self._state == "go":
            if now - self._since >= _STRAIGHT:
                self.reset()
                return ahead
            if _share(allowed(ahead), ahead) >= BLOCKED:
                return ahead
            self._enter("turn", now)
        if _share(allowed(ahead), ahead) >= FREE:
            self._enter("go", now)
            return ahead
        turning = Twist(angular=self._side * self._turn)
        if abs(allowed(turning).angular) > BLOCKED * self._turn:
            self._blocked_since = None
        elif self._blocked_since is None:
            self._blocked_since = now
        elif now - self._blocked_since >= _STANDS:
            self._blocked_since = None
            self._side = -self._side
            self._enter("back", now)
            return Twist(-0.5 * speed)
        return turning

    def _enter(self, state: str, now: float) -> None:
        self._state, self._since = state, now
        self._blocked_since = None

    def _choose_side(self, now: float, scan: Scan | None) -> None:
        """The side on which there is more room ahead; the right one if they are alike."""
        if now >= self._side_until and scan is not None:
            room = np.minimum(np.maximum(scan.ranges, scan.range_min), 2.0)
            ahead = np.cos(scan.bearings) > -0.5
            left = room[ahead & (np.sin(scan.bearings) > 0.0)].mean()
            right = room[ahead & (np.sin(scan.bearings) < 0.0)].mean()
            self._side = 1.0 if left > right + _EVEN else -1.0
            if self._rng.random() < _FLIP:
                self._side = -self._side
        self._side_until = now + _KEEPS_SIDE


def _share(given: Twist, wish: Twist) -> float:
    """How much of a wish's speed is given, in its own direction."""
    square = wish.linear**2 + wish.lateral**2
    return (given.linear * wish.linear + given.lateral * wish.lateral) / square
