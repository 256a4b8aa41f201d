"""Which commands a driver publishes while its base is lost, back, or left for good. Pure."""

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
        self._is_open = self._has_sent = False
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

    def open(self) -> None:
        """The base is connected: the next command is zero."""
        self._is_open = self._needs_zero = True

    def require_zero(self) -> None:
        """The next command is zero: another node may take the commands from now on."""
        self._needs_zero = True

    def filter(self, twist: Twist) -> Twist | None:
        """The command to publish for a safe command; None if it is to be dropped."""
        if not self._is_open:
            return None
        twist = ZERO if self._needs_zero else twist
        self._needs_zero, self._has_sent = False, True
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
        self._has_sent = False
        return has_sent
