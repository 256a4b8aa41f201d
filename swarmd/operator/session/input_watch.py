"""Bounds how long a command waited for a program that was busy or frozen.

A program that does not run, as after SIGSTOP or while its computer sleeps, reads its input late and
cannot see when the input was written. So a reader notes each moment at which no input waited.
"""

from __future__ import annotations

import math

MAX_GAP = 1.0
"""Seconds without a look after which waiting input has an unknown age."""
MAX_LATENESS = 3.0
"""Seconds from the arrival of a command that starts or changes motion to its carrying out."""
TOO_LATE = "it came too late; look at the robots and send it again"


class InputWatch:
    """The looks of a reader at its input. Times are in s on the clock since boot."""

    def __init__(self, now: float) -> None:
        self._looked_at = now
        self._unbroken_since = now
        """The first of the looks that follow each other within MAX_GAP."""

    def look(self, now: float) -> None:
        """Note that no input waited at `now`; the reader looks several times in MAX_GAP."""
        if now - self._looked_at > MAX_GAP:
            self._unbroken_since = now
        self._looked_at = now

    def arrival(self, now: float) -> float:
        """When input that is read at `now` arrived: `now`, or -inf if its age is unknown."""
        return now if now - self._looked_at <= MAX_GAP else -math.inf

    def is_unbroken(self, since: float, now: float) -> bool:
        """True if the reader looked within each MAX_GAP from `since` to `now`."""
        return since >= self._unbroken_since and now - self._looked_at <= MAX_GAP

    def is_fresh(self, at: float, now: float) -> bool:
        """True if a command that arrived `at` may start motion at `now`.

        False after MAX_LATENESS, and if the reader did not look for MAX_GAP since `at`.
        """
        return self.is_unbroken(at, now) and now - at < MAX_LATENESS
