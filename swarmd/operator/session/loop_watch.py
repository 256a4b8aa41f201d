"""Detects that a process stood still: SIGSTOP, Ctrl-Z, a closed lid, a suspended computer.

A program that commands robots looks again and again while it works: it waits for answers, for a
canary, or for the next call. If it did not look for more than MAX_GAP beyond its wait, it stood
still, and its user may have given a later order elsewhere. Then it starts no motion.

Time for which a thread of the process waited for a processor is no gap: on a loaded computer a
program is slow without standing still, also where the waiting thread holds what the loop needs. The
kernel counts this time, and does not count it for a stopped process. A robot bounds the age of each
start in any case (`verbs.MAX_AGE`).
"""

from __future__ import annotations

import contextlib
import math
import os
from collections import deque
from collections.abc import Callable, Mapping

MAX_GAP = 1.0
"""Seconds without a look, beyond the wait and the time without a processor."""
READ_PERIOD = 0.5  # s after which the waits are read again; 20 threads take some 0.5 ms
MAX_LOOPS = 64  # loops that are remembered
START_TIME = 3.0
"""Seconds between an order and the first look that count as work: the start of a program."""


def processor_waits() -> dict[str, float]:
    """Seconds for which each thread has waited for a processor so far; empty if not known."""
    waits = {}
    with contextlib.suppress(OSError):
        for thread in os.listdir("/proc/self/task"):
            path = f"/proc/self/task/{thread}/schedstat"
            with contextlib.suppress(OSError, ValueError, IndexError), open(path, "rb", 0) as file:
                waits[thread] = 1e-9 * int(file.read().split()[1])
    return waits


class LoopWatch:
    """Watches the loops of one thread; times in s on one clock.

    Call `begin` before a loop, and `turn` in each turn of it.
    """

    def __init__(self, waited: Callable[[], Mapping[str, float]] = processor_waits) -> None:
        """`waited`: s for which each thread has waited for a processor so far."""
        self._processor_waits = waited
        self._waited: Mapping[str, float] = {}
        self._read_at = -math.inf
        self._loops = deque[tuple[float, float]](maxlen=MAX_LOOPS)  # begin and last turn of each
        self._stops = deque[tuple[float, float]](maxlen=MAX_LOOPS)  # end of a standstill, and s

    def begin(self, now: float) -> None:
        """A loop begins."""
        self._read(now)
        self._loops.append((now, now))

    def turn(self, now: float, pause: float = 0.0) -> float:
        """Note a turn of the loop; returns the s for which the process stood still before it, or 0.

        `pause`: s for which the loop wanted to wait at most since its last turn.
        """
        begun, last = self._loops[-1]
        gap = now - last - pause
        if gap > MAX_GAP or now - self._read_at > READ_PERIOD:
            gap -= self._read(now)
        if gap <= MAX_GAP:
            self._loops[-1] = begun, now
            return 0.0
        self._stops.append((now, gap))
        self._loops.append((now, now))
        return gap

    def _read(self, now: float) -> float:
        """The longest wait of a thread in s since the last call."""
        before = self._waited
        self._waited = self._processor_waits()
        self._read_at = now
        return max(
            (wait - before.get(thread, 0.0) for thread, wait in self._waited.items()), default=0.0
        )

    def stood(self, since: float) -> float:
        """The longest standstill in s that ended after `since`; 0 without one."""
        return max((gap for end, gap in self._stops if end > since), default=0.0)

    def worked(self, since: float) -> float:
        """Seconds since `since` that loops took, and those before the first loop (START_TIME)."""
        loops = [(max(begun, since), last) for begun, last in self._loops if last >= since]
        start = min(loops[0][0] - since, START_TIME) if loops else 0.0
        return start + sum(last - begun for begun, last in loops)
