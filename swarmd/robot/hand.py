"""A hand on a robot: an operator drives it, in place of its pattern. Pure.

1. A request (`DriveRequest`) begins a hand, and one ends it. Between them the driver tells the
   robot a command (`DriveInput`) ten times a second.
2. Only the driver of the present hand is heard. A command that is repeated, out of order or late is
   dropped. Late is one that took MAX_LATE longer than the fastest one; no common clock is needed.
3. The hand is lost LEASE after the last command arrived, and at its end. A lost hand is heard no
   more: it holds the run beneath it (`hand_lost`) until a resume, a new run or a new hand that is
   released. Without a run a lost hand ends.
4. Whatever stops the robot ends the hand (`Lifecycle`); the end of the run's own time does not.
5. Protection judges the command as that of a pattern. Steering does not change it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from swarmd.core.values import ZERO, Twist, slowed
from swarmd.robot.protection.decision import Permit

if TYPE_CHECKING:
    from swarmd.core.events import DriveInput
    from swarmd.core.verbs import DriveRequest
    from swarmd.robot.pattern_load import Wish

LEASE = 0.5
"""Seconds after the arrival of a command at which the hand is lost: four of ten may get lost."""
FIRST_LEASE = 3.0
"""Seconds from the request to the first command: its reply must have reached the driver."""
MAX_LATE = 0.3
"""Seconds that a command may take longer than the fastest one, which the way itself varies by."""
_DRIFT = 1e-3  # by which two clocks may drift apart: ten times what a bad crystal does


class Hand:
    """The hand of one driver, from its request to its end. Times are in s on the robot's clock.

    Attributes:
        id: that of the request.
        driver: the operator of the request.
        wish: when it was asked for; a later stop ends the hand.
        permit: what protection allows: no touch zone, and the bound of speed of the driver's key.
        twist: the last command in m/s and rad/s, within that bound.
        until: the hand is lost then.
        lost_at: when it was lost; inf while the driver is heard.
    """

    def __init__(self, request: DriveRequest, wish: Wish, now: float) -> None:
        self.id = request.id
        self.driver = request.operator
        self.wish = wish
        self.permit = Permit(avoids=False, speed=request.speed)
        self.twist: Twist = ZERO
        self.lost_at = math.inf
        self.lost_text = ""
        self._ends_at = math.inf if request.seconds is None else now + request.seconds
        self.until = min(now + FIRST_LEASE, self._ends_at)
        self._order = -1
        # The least time from the sender's clock to the arrival here. The request took no longer.
        self._way = now - request.issued if request.clock else math.inf
        self._way_at = now

    @property
    def is_driving(self) -> bool:
        """True until the hand is lost."""
        return self.lost_at == math.inf

    @property
    def due_at(self) -> float:
        """The next deadline; inf for a lost hand."""
        return self.until if self.is_driving else math.inf

    def hear(self, one: DriveInput, now: float) -> bool:
        """Take in a command; False if it is dropped."""
        if one.hand != self.id or one.driver != self.driver:
            return False
        if not self.is_driving or now >= self.until:
            return False
        way = now - one.sent
        self._way = min(self._way + _DRIFT * (now - self._way_at), way)
        self._way_at = now
        if one.order <= self._order or way - self._way > MAX_LATE:
            return False
        self._order = one.order
        self.until = min(now + LEASE, self._ends_at)
        speed = self.permit.speed
        self.twist = one.twist if speed is None else slowed(one.twist, speed)
        return True

    def lose(self, now: float) -> None:
        """The driver is heard no more."""
        is_over = now >= self._ends_at
        self.lost_text = "its time was over" if is_over else f"was not heard for {LEASE:g} s"
        self.twist = ZERO
        self.lost_at = now
