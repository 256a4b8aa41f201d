"""What has come on one topic: how often, when, with which stamps, and what could not be read."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

RECENT = 64
FAULT_LASTS = 2.0
SETBACKS_WITHIN = 10.0

_LATE = 8  # messages over which the stamps must go on; some sensors say a thing twice


@dataclass(slots=True, eq=False)
class Sense:
    """One topic and its record. `topic` is its full name, `option` what names it in the options.

    Times are those of arrival, in s on the loop's clock; stamps are the sender's. Both begin anew
    when stamps go back, as they do when a robot is restarted: `setbacks` has the last two times.
    """

    name: str
    option: str
    topic: str
    kind: type
    is_needed: bool = False
    count: int = 0
    times: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    stamps: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    setbacks: deque[float] = field(default_factory=lambda: deque(maxlen=2))
    text: str = ""
    fault: str = ""
    fault_at: float = -math.inf
    faults: int = 0

    def hear(self, now: float, stamp: float, text: str = "") -> None:
        """A message has come; `text` says briefly what is in it."""
        self.count += 1
        if self.stamps and stamp < self.stamps[-1]:
            self.setbacks.append(now)
            self.times.clear()
            self.stamps.clear()
        self.times.append(now)
        self.stamps.append(stamp)
        self.text = text

    def complain(self, now: float, fault: str) -> None:
        """Something has come that could not be taken; the first of a row says why."""
        self.fault = self.complaint(now) or fault
        self.fault_at = now
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
        """Whether the stamps have gone on of late; true while there are too few to tell."""
        count = min(len(self.stamps), _LATE)
        return count < 3 or self.stamps[-1] > self.stamps[-count]

    def goes_back(self) -> bool:
        """Whether the stamps have gone back again and again of late, as of two senders."""
        return len(self.setbacks) == 2 and self.heard_at() - self.setbacks[0] < SETBACKS_WITHIN

    def passed(self) -> tuple[float, float]:
        """Seconds by the stamps and by this machine's clock, from the first to the last kept."""
        if not self.times:
            return 0.0, 0.0
        return self.stamps[-1] - self.stamps[0], self.times[-1] - self.times[0]
