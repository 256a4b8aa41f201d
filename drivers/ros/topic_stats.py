"""Statistics of one topic: arrival times, stamps, rate, and messages that could not be read."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from itertools import groupby
from operator import itemgetter

WINDOW = 64
"""Messages of which arrival times and stamps are kept."""
FAULT_TIMEOUT = 2.0
"""Seconds after which a fault no longer counts as recent."""
SETBACK_WINDOW = 10.0
"""Seconds within which stamps that go back twice count as those of two publishers."""

_STANDSTILL_WINDOW = 3.0  # s before the last message of which standing stamps count
_STANDSTILL_MESSAGES = 3  # with one stamp, at least
_STAMP_WINDOW = 8  # messages over which stamps must advance; some sensors publish one stamp twice


@dataclass(slots=True, eq=False)
class TopicStats:
    """One subscribed topic and what arrived on it.

    `topic` is the full name and `option` the driver option that names it. `times` are arrivals in
    s on the loop's clock and `stamps` those of the sender. Both begin again when stamps go back, as
    they do when a robot restarts; `setbacks` holds the last two times of that. `goes_stale`: the
    topic has entries of `ENTRY_KINDS` alone. `stale_after` s is the least of all its entries.
    `doubt`: what the last messages say against themselves although they can be read; of a series
    the first. `further`: the entries of these options that share the topic.
    """

    name: str
    option: str
    topic: str
    message_type: type
    is_needed: bool = False
    count: int = 0
    times: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW))
    stamps: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW))
    setbacks: deque[float] = field(default_factory=lambda: deque(maxlen=2))
    summary: str = ""
    fault: str = ""
    fault_at: float = -math.inf
    faults: int = 0
    stale_after: float = math.inf
    goes_stale: bool = False
    doubt: str = ""
    further: list[str] = field(default_factory=list)

    def record(self, now: float, stamp: float, summary: str = "") -> None:
        """Count a message that could be read; `summary` describes its content briefly."""
        self.count += 1
        if self.stamps and stamp < self.stamps[-1]:
            self.setbacks.append(now)
            self.times.clear()
            self.stamps.clear()
        self.times.append(now)
        self.stamps.append(stamp)
        self.summary = summary

    def record_doubt(self, doubt: str) -> None:
        """Keep what the present message says against itself; empty ends the series."""
        self.doubt = doubt and (self.doubt or doubt)

    def record_fault(self, now: float, fault: str) -> None:
        """Count a message that could not be used; of a series the first fault is kept."""
        self.fault = self.recent_fault(now) or fault
        self.fault_at = now
        self.faults += 1

    def last_arrival(self) -> float:
        """When the last message arrived; minus infinity before the first."""
        return self.times[-1] if self.times else -math.inf

    def recent_fault(self, now: float) -> str:
        """The fault of the last FAULT_TIMEOUT; empty without one."""
        return self.fault if now - self.fault_at < FAULT_TIMEOUT else ""

    def rate(self) -> float:
        """Messages a second over the window; 0 before the second message."""
        if len(self.times) < 2:
            return 0.0
        return (len(self.times) - 1) / max(self.times[-1] - self.times[0], 1e-6)

    @property
    def pairs(self) -> list[tuple[float, float]]:
        """Arrivals with their stamps."""
        return list(zip(self.times, self.stamps, strict=True))

    @property
    def is_never_stale(self) -> bool:
        """True for entries whose last message counts until the next one."""
        return self.goes_stale and self.stale_after == math.inf

    @property
    def is_scan(self) -> bool:
        """True for the range sensor, or a part of it."""
        return self.option in ("scan", "ranges")

    def stamps_advance(self) -> bool:
        """False if the last few stamps are all the same; true below three messages."""
        count = min(len(self.stamps), _STAMP_WINDOW)
        return count < 3 or self.stamps[-1] > self.stamps[-count]

    def standstill(self) -> float:
        """The longest time in s without a new stamp while messages came; 0 if all have one."""
        recent = [pair for pair in self.pairs if self.times[-1] - pair[0] < _STANDSTILL_WINDOW]
        runs = [list(run) for _, run in groupby(recent, key=itemgetter(1))]
        ends = [*(run[0][0] for run in runs[1:]), self.last_arrival()]
        spans = [
            end - run[0][0]
            for run, end in zip(runs, ends, strict=False)
            if len(run) >= _STANDSTILL_MESSAGES
        ]
        return max(spans, default=0.0) if len(runs) > 1 else 0.0

    def stamps_go_back(self) -> bool:
        """True if the stamps went back twice within SETBACK_WINDOW: a sign of two publishers."""
        return len(self.setbacks) == 2 and self.last_arrival() - self.setbacks[0] < SETBACK_WINDOW

    def elapsed(self) -> tuple[float, float]:
        """Seconds over the window by the stamps and by this machine's clock."""
        if not self.times:
            return 0.0, 0.0
        return self.stamps[-1] - self.stamps[0], self.times[-1] - self.times[0]
