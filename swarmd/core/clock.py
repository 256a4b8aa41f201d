"""The clock of this machine: monotonic, and counting while the machine is suspended."""

from __future__ import annotations

import time
from collections.abc import Callable

Clock = Callable[[], float]

TICK = 0.05
"""Seconds between two decisions of a robot, at most."""


def boottime() -> float:
    """Seconds since boot (CLOCK_BOOTTIME), with time in suspend; never set back."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)
