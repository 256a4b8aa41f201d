"""The daemon's timer: ticks against absolute deadlines, and one wake-up in between.

There are 20 ticks a second, and 10 while the timer rests.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable

from swarmd.core.clock import STALL_TIMEOUT, TICK

MAX_LATENESS_SAMPLES = 400
RESTING_PERIODS = 2
"""Periods of 50 ms between two ticks while the timer rests."""
_SLACK = 0.2 * TICK
"""s by which ticks are later while scans bring them forward: no tick comes just before a scan."""


class TickTimer:
    """Calls `tick` every 50 ms (every 100 ms at rest), and at the wake-up that `wake_in` sets.

    `periods`: the count of 50 ms periods up to the last tick; a wake-up adds none.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, tick: Callable[[], None]) -> None:
        self._loop = loop
        self._tick = tick
        self._next = loop.time() + TICK
        self._step = 1  # periods until the next tick
        self._is_resting = False
        self._slack = 0.0
        self._early_at = -math.inf  # s; the last tick that came with a scan
        self._handle = loop.call_at(self._next, self._on_time)
        self._wake_at: float | None = None
        self._wake: asyncio.TimerHandle | None = None
        self._lateness: deque[float] = deque(maxlen=MAX_LATENESS_SAMPLES)
        self.stalls = 0
        self.periods = 0

    @property
    def p99(self) -> float:
        """The 99th percentile of the lateness of the last ticks, in s."""
        ranked = sorted(self._lateness)
        return ranked[int(0.99 * (len(ranked) - 1))] if ranked else 0.0

    @property
    def left(self) -> float:
        """Seconds until the next tick."""
        return max(self._next - self._loop.time(), 0.0)

    def rest(self, is_resting: bool) -> None:
        """True: tick every RESTING_PERIODS after the next tick. False: every 50 ms from now on."""
        self._is_resting = is_resting
        at = self._loop.time() + TICK
        if not is_resting and self._step > 1 and at < self._next:
            self._handle.cancel()
            self._next = at
            self._step = 1
            self._handle = self._loop.call_at(at, self._on_time)

    def tick_early(self) -> None:
        """At rest: tick now in place of the next tick, with a scan that has woken the loop.

        A tick that is due within 50 ms comes with this scan. So does a tick that is due later, if
        the scan before came without a tick: from then on, each scan brings a tick with it. One
        wake-up of the processor is saved for each scan.
        """
        if not self._is_resting or self._step == 1:
            return
        now = self._loop.time()
        left = max(self._next - now, 0.0)
        is_out_of_phase = now - self._early_at > RESTING_PERIODS * TICK + _SLACK
        if left < TICK or is_out_of_phase:
            self._handle.cancel()
            self._next -= left
            self._slack = _SLACK
            self._early_at = now
            self._handle = self._loop.call_at(self._next, self._on_time)

    def wake_in(self, seconds: float | None) -> None:
        """Set the wake-up in place of the wake-up before; None: no wake-up between ticks."""
        if self._wake is not None:
            self._wake.cancel()
            self._wake = None
        self._wake_at = None if seconds is None else self._loop.time() + seconds
        self._arm()

    def stop(self) -> None:
        """Cancel all further ticks."""
        self._handle.cancel()
        self.wake_in(None)

    def _on_time(self) -> None:
        now = self._loop.time()
        late = max(now - self._next, 0.0)
        self._lateness.append(late)
        if late > STALL_TIMEOUT:
            self.stalls += 1
        self.periods += self._step
        self._step = RESTING_PERIODS if self._is_resting else 1
        self._next += self._step * TICK + (self._slack if self._step > 1 else 0.0)
        if self._next <= now:  # more than a period late: do not catch up
            self._next = now + self._step * TICK
        self._handle = self._loop.call_at(self._next, self._on_time)
        self._arm()
        self._tick()

    def _arm(self) -> None:
        """Set the loop's timer for the wake-up if it comes before the next tick."""
        at = self._wake_at
        if at is not None and at < self._next:
            self._wake_at = None
            self._wake = self._loop.call_at(at, self._tick)
