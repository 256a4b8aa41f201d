"""Which commands a driver publishes while its base is lost, back, or left for good. Pure.

A driver whose base others may command hands `is_stopped` to `filter`; any other leaves it out.
Limits are applied earlier, in `protection/arbiter.py`.
"""

from __future__ import annotations

import math

from swarmd.core.values import ZERO, Twist

ZERO_REPEAT_TIME = 2.0
"""Seconds for which a lost base is sent zero again: the first zero may not have arrived."""


class CommandGate:
    """Drops commands while the base is lost; the first command after each (re)connect is zero.

    A driver that has published no command publishes no zero either: a `--check` must not interrupt
    the daemon that drives the base. Times are in s on one monotonic clock, handed in.
    """

    def __init__(self) -> None:
        self._is_open = self._has_sent = self._is_stopped = False
        self._needs_zero = True
        self._repeat_until = -math.inf

    @property
    def is_open(self) -> bool:
        """True while the base is connected."""
        return self._is_open

    @property
    def has_sent(self) -> bool:
        """True once a command was published; until `end`."""
        return self._has_sent

    @property
    def is_stopped(self) -> bool:
        """True while the robot must stand: a command of another node is answered with zero."""
        return self._is_stopped

    def open(self) -> None:
        """The base is connected: the next command is zero."""
        self._is_open = self._needs_zero = True

    def require_zero(self) -> None:
        """The next command is zero: another node may take the commands from now on."""
        self._needs_zero = True

    def filter(self, twist: Twist, *, is_stopped: bool = False) -> Twist | None:
        """The command to publish for a safe command; None if it is to be dropped.

        `is_stopped`: of a robot that must stand; it is zero and published although the base is
        lost, since another node may command the base.
        """
        self._is_stopped = is_stopped
        if not (self._is_open or is_stopped):
            return None
        twist = ZERO if self._needs_zero or is_stopped else twist
        self._needs_zero, self._has_sent = not self._is_open, True
        return twist

    def close(self, now: float) -> bool:
        """The base is lost. True if the driver has to publish zero now.

        `repeats_zero` is then true for ZERO_REPEAT_TIME.
        """
        is_wanted = self._is_open and self._has_sent
        self._is_open = False
        if is_wanted:
            self.repeat_zero(now)
        return is_wanted

    def repeat_zero(self, now: float) -> None:
        """Begin ZERO_REPEAT_TIME again: a link that was cut is back, so zeros arrive again."""
        self._repeat_until = now + ZERO_REPEAT_TIME

    def repeats_zero(self, now: float) -> bool:
        """True while zero is to be published although the base is lost."""
        return not self._is_open and self._has_sent and now < self._repeat_until

    def cut(self) -> None:
        """The connection itself has ended: no zero can be published, nor is repeated."""
        self._is_open, self._repeat_until = False, -math.inf

    def end(self) -> bool:
        """The driver ends. True if it has to publish zero now; a later `run` begins again."""
        has_sent = self._has_sent
        self.cut()
        self._has_sent = self._is_stopped = False
        return has_sent
