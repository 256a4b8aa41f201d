"""Sends non-zero commands only after a sign of life of the hub. Pure.

The hub is the Zenoh router or bridge of the robot. A command that is sent to a frozen hub waits in
the buffers of TCP. Neither end can withdraw the command, and Zenoh drops no message by age. The hub
passes the command on when it continues: the base would move late. So each sign of life (a message,
or the answer to a query) permits one non-zero command within FRESH_TIME. Without a fresh sign of
life the command is held, and the hub is queried.
"""

from __future__ import annotations

import math

from swarmd.core.values import ZERO, Twist

FRESH_TIME = 0.01
"""Seconds after a sign of life within which a command may be sent without a question.

A command that answers a scan leaves 1 to 5 ms after it. A longer time makes it more likely that the
hub froze in between.
"""

MAX_SILENCE = 0.2
"""Seconds without an answer after which each command is sent as zero.

So a command that a freezing hub has received, but not passed on, is followed by zero.
"""

MAX_HELD_TIME = 0.1
"""Seconds for which a command waits for a sign of life; a daemon commands every 0.05 s."""

_ASK_PERIOD = 1.0  # s between two questions to a silent hub


class CommandCredit:
    """Holds back non-zero commands until the hub has shown a sign of life. Times are arguments, s.

    A sign of life is any message of the hub, or the answer to a query. Zero is never held back.
    """

    def __init__(self) -> None:
        """No sign of life yet."""
        self._heard_at = -math.inf
        self._asked_at = -math.inf
        self._asked_first_at = -math.inf
        self._is_spent = True
        self._held: tuple[Twist, float] | None = None

    def hear(self, now: float) -> None:
        """Note a sign of life of the hub, which permits one command."""
        self._heard_at = now
        self._asked_at = -math.inf
        self._is_spent = False

    def offer(self, twist: Twist, now: float) -> Twist | None:
        """The command to send now in place of `twist`; None if no command may be sent.

        1. Zero is sent.
        2. Another command is sent if a fresh sign of life is left; the command uses the sign up.
        3. Otherwise `twist` is held. If a query has had no answer for MAX_SILENCE, zero is sent,
           else nothing.

        In each case an earlier held command is dropped.
        """
        self._held = None
        if twist.is_zero or self._spend(now):
            return twist
        self._held = twist, now
        is_silent = self._asked_at > -math.inf and now - self._asked_first_at > MAX_SILENCE
        return ZERO if is_silent else None

    def release(self, now: float) -> Twist | None:
        """The held command if it may be sent now, else None; drops a command that is too old."""
        if self._held is None or not self._spend(now):
            return None
        (twist, offered_at) = self._held
        self._held = None
        return twist if now - offered_at <= MAX_HELD_TIME else None

    def asks(self, now: float) -> bool:
        """True if the hub is to be asked now; the question then counts as sent."""
        is_due = self._held is not None and now - self._asked_at >= _ASK_PERIOD
        if is_due:
            if self._asked_at == -math.inf:
                self._asked_first_at = now
            self._asked_at = now
        return is_due

    def _spend(self, now: float) -> bool:
        """True if a fresh sign of life is left, which is then used up."""
        is_allowed = not self._is_spent and now - self._heard_at <= FRESH_TIME
        self._is_spent |= is_allowed
        return is_allowed
