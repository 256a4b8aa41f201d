"""The clock of this machine: monotonic, and running on while it is suspended."""

from __future__ import annotations

import time
from collections.abc import Callable

Clock = Callable[[], float]


def boottime() -> float:
    """Seconds since boot (CLOCK_BOOTTIME): never set back, and counts suspend."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)
