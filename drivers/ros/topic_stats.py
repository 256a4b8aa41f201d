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
"""Stamps that go back twice within this time in s are a sign of two publishers."""

_STANDSTILL_WINDOW = 3.0  # s before the last message in which repeated stamps are searched
_STANDSTILL_MESSAGES = 3  # messages in a row with one stamp that count as a standstill
_STAMP_WINDOW = 8  # messages over which stamps must advance; some sensors repeat a stamp once


@dataclass(slots=True, eq=False)
class TopicStats:
    """One subscribed topic, and statistics of its messages."""

    name: str
    option: str  # the driver option that names the topic
    topic: str  # the full name
    message_type: type
    is_needed: bool = False  # the base counts as lost without this topic
    count: int = 0  # messages that could be read
    times: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW))
    """Arrivals in s on the loop's clock; cleared with `stamps` when a stamp goes back."""
    stamps: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW))
    """Stamps in s on the sender's clock."""
    setbacks: deque[float] = field(default_factory=lambda: deque(maxlen=2))
    """The last two times in s at which a stamp went back, such as when a robot restarts."""
    summary: str = ""  # the content of the last message
    fault: str = ""  # the first of the present series of messages that could not be used
    fault_at: float = -math.inf  # s of the last such message
    faults: int = 0  # messages that could not be used
    stale_after: float = math.inf  # s, the least of all entries of the topic
    has_only_entries: bool = False
    """Only entries of `ENTRY_KINDS` read the topic; `stale_after` is theirs."""
    doubt: str = ""  # the first contradiction in the present series of readable messages
    further: list[str] = field(default_factory=list)
    """Options of further entries that share the topic."""

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

    def record_fault(self, now: float, fault: str) -> None:
        """Count a message that could not be used; the first fault of a series is kept."""
        self.fault = self.recent_fault(now) or fault
        self.fault_at = now
        self.faults += 1

    def last_arrival(self) -> float:
        """When the last message arrived; minus infinity before the first."""
        return self.times[-1] if self.times else -math.inf

    def recent_fault(self, now: float) -> str:
        """The fault within the last FAULT_TIMEOUT; empty without a fault."""
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
        """True for entries whose last message counts until the next message."""
        return self.has_only_entries and self.stale_after == math.inf

    @property
    def is_scan(self) -> bool:
        """True for a lidar, or a sensor of the range ring."""
        return self.option in ("scan", "ranges")

    def stamps_advance(self) -> bool:
        """False if the last few stamps are equal; True below three messages."""
        count = min(len(self.stamps), _STAMP_WINDOW)
        return count < 3 or self.stamps[-1] > self.stamps[-count]

    def standstill(self) -> float:
        """The longest time in s for which the stamp stood still while messages came.

        A stamp stands still if _STANDSTILL_MESSAGES messages in a row have the same stamp. The
        result is 0 if no stamp stands still, and also if all recent messages have the same stamp,
        which `stamps_advance` detects.
        """
        recent = [pair for pair in self.pairs if self.times[-1] - pair[0] < _STANDSTILL_WINDOW]
        # Runs of messages with one stamp, as (arrival, stamp). A run ends when the next begins.
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
