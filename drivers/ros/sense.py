"""What has come on one topic: how often, when, with which stamps, and what could not be read."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

RECENT = 64
FAULT_LASTS = 2.0


@dataclass(slots=True, eq=False)
class Sense:
    """One topic and its record. `topic` is its full name, `option` what names it in the options.

    Times are those of arrival, in s on the loop's clock; stamps are the sender's.
    """

    name: str
    option: str
    topic: str
    kind: type
    is_needed: bool = False
    count: int = 0
    times: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    stamps: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    text: str = ""
    fault: str = ""
    fault_at: float = -math.inf
    faults: int = 0

    def hear(self, now: float, stamp: float, text: str = "") -> None:
        """A message has come; `text` says briefly what is in it."""
        self.count += 1
        self.times.append(now)
        self.stamps.append(stamp)
        self.text = text

    def complain(self, now: float, fault: str) -> None:
        """Something has come that could not be taken."""
        self.fault, self.fault_at = fault, now
        self.faults += 1

    def heard_at(self) -> float:
        """When the last message came."""
        return self.times[-1] if self.times else -math.inf

    def complaint(self, now: float) -> str:
        """What is wrong with what came lately; empty if nothing is."""
        return self.fault if now - self.fault_at < FAULT_LASTS else ""

    def rate(self) -> float:
        """Messages a second over the last few; 0 before the second one."""
        if len(self.times) < 2:
            return 0.0
        return (len(self.times) - 1) / max(self.times[-1] - self.times[0], 1e-6)

    def advances(self) -> bool:
        """Whether the stamps have gone on; true while there are too few to tell."""
        return len(self.stamps) < 3 or self.stamps[-1] > self.stamps[0]

    def passed(self) -> tuple[float, float]:
        """Seconds by the stamps and by this machine's clock, from the first to the last kept."""
        if not self.times:
            return 0.0, 0.0
        return self.stamps[-1] - self.stamps[0], self.times[-1] - self.times[0]
