"""Decides which commands a driver publishes: none to a lost base, zero first and last. Pure.

Some bases take the commands of other nodes, too: only the driver of such a base passes `is_stopped`
to `filter`. `robot/protection/protection.py` applies the limits before this gate.
"""

from __future__ import annotations

import math

from swarmd.core.values import ZERO, Twist

ZERO_REPEAT_TIME = 2.0
"""Seconds for which a lost base is sent zero again: the first zero may not have arrived."""


class CommandGate:
    """Drops commands while the base is lost; the first command after each (re)connect is zero.

    A driver that has published no command publishes no final zero: a `--check` must not interrupt
    the daemon that drives the base. Times are in s on one monotonic clock and come with each call.
    """

    def __init__(self) -> None:
        self._is_open = False
        self._has_sent = False
        self._is_stopped = False
        self._needs_zero = True
        self._repeat_until = -math.inf

    @property
    def is_open(self) -> bool:
        """True while the base is connected."""
        return self._is_open

    @property
    def has_sent(self) -> bool:
        """True from the first published command until `end`."""
        return self._has_sent

    @property
    def is_stopped(self) -> bool:
        """True while the robot must stand: the driver answers a command of another node by zero."""
        return self._is_stopped

    def open(self) -> None:
        """Note that the base is connected: the next command is zero."""
        self._is_open = True
        self._needs_zero = True

    def require_zero(self) -> None:
        """Make the next command zero, since another node may take over the commands."""
        self._needs_zero = True

    def filter(self, twist: Twist, *, is_stopped: bool = False) -> Twist | None:
        """The command to publish for the safe command `twist`; None to publish nothing.

        `is_stopped`: the robot must stand. Then zero is published although the base is lost, since
        another node may command the base.
        """
        self._is_stopped = is_stopped
        if not (self._is_open or is_stopped):
            return None
        twist = ZERO if self._needs_zero or is_stopped else twist
        # A zero to a lost base may not arrive, so the first command after the reconnect is zero.
        self._needs_zero = not self._is_open
        self._has_sent = True
        return twist

    def close(self, now: float) -> bool:
        """Note that the base is lost; returns True if the driver must publish zero now.

        If True, the driver repeats the zero while `repeats_zero` is True, for ZERO_REPEAT_TIME.
        """
        is_wanted = self._is_open and self._has_sent
        self._is_open = False
        if is_wanted:
            self.repeat_zero(now)
        return is_wanted

    def repeat_zero(self, now: float) -> None:
        """Restart ZERO_REPEAT_TIME after a cut link is back, so that zeros arrive again."""
        self._repeat_until = now + ZERO_REPEAT_TIME

    def repeats_zero(self, now: float) -> bool:
        """True while zero must be published although the base is lost."""
        return not self._is_open and self._has_sent and now < self._repeat_until

    def cut(self) -> None:
        """Note that the connection itself has ended: zero can neither be published nor repeated."""
        self._is_open = False
        self._repeat_until = -math.inf

    def end(self) -> bool:
        """Note the driver's end; True if it must publish zero now. Resets for a later `run`."""
        has_sent = self._has_sent
        self.cut()
        self._has_sent = False
        self._is_stopped = False
        return has_sent
