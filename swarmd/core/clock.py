"""The clock of this machine: monotonic, and counting while the machine is suspended."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

Clock = Callable[[], float]

TICK = 0.05
"""Seconds between two decisions of a robot, at most."""
STALL_TIMEOUT = 1.0
"""A robot whose loop is later than this, in s, has stalled: its run ends (`loop_stalled`)."""
_START_TIME = 19  # the place of `starttime` after the name of the program, see proc_pid_stat(5)
FIRST_WALL = 1.7e9
"""A wall clock of before November 2023, in s since 1970, has not been set."""


def boottime() -> float:
    """Seconds since boot (CLOCK_BOOTTIME), with time in suspend; never set back."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def process_start() -> float:
    """When this process began, on the clock of `boottime`, to 10 ms; now if the system is silent.

    A command counts from then: its user typed it before its modules were imported.
    """
    with suppress(OSError, ValueError, IndexError):
        fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
        return int(fields[_START_TIME]) / os.sysconf("SC_CLK_TCK")
    return boottime()


class ClockSample(NamedTuple):
    """A request and answer between this robot and `peer`, by which their clocks are compared.

    `sent`: s on this robot's clock, when the request went out; `returned`: when the answer came.
    `answered`: s on the peer's clock, when the peer made the answer. `clock`: the `clock_id` of the
    peer's clock.
    """

    peer: str
    clock: str
    sent: float
    answered: float
    returned: float


@lru_cache(maxsize=1)
def clock_id() -> str:
    """12 hex digits that name the clock of `boottime`.

    Processes with equal ids read the same clock. A reboot or a time namespace gives another id.
    """
    import hashlib  # `swarmctl --help` reads no clock

    boot = ""
    namespace = ""
    with suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    with suppress(OSError):
        namespace = os.readlink("/proc/self/ns/time")
    unknown = "" if boot else os.urandom(16).hex()
    return hashlib.blake2b(f"{boot}/{namespace}{unknown}".encode(), digest_size=6).hexdigest()
