"""Bounds the time for which a request of ROS waited at the hub and on the link. Pure.

A request carries no age. The hub (bridge or router) and TCP keep a request while the hub or this
process is frozen, or while the link is cut. So this process probes the hub all the time, and takes
an upper bound of the age from the answers:

1. The link keeps the order of what the hub sends. So a request that arrives after the answer to a
   probe left the hub after this answer, and thus after the probe was sent. The request has waited
   on the link for at most the time since the probe was sent.
2. A hub that was frozen answers the probes first, and then passes on the requests that wait in its
   input. Such a request has waited in the hub for at most as long as the slowest answer took. So
   this time, the longest of the last SETTLE_TIME, is added to the age. After a gap of MAX_AGE
   between two answers, the age is unknown for SETTLE_TIME.
3. After a loss of the link no probe counts as answered.

A hub that answers all the time may still hold requests back for longer. Such a wait is not
detected, except by the stamp of the middleware (`by_stamp`).
"""

from __future__ import annotations

import math
from collections import deque

PROBE_PERIOD = 0.1
"""Seconds between two probes; a probe is answered within 0.4 ms on loopback. With a longer period
a run is refused for longer after a stop, since it may have been issued before the stop."""
MAX_AGE = 1.0
"""Seconds since the last answered probe was sent, beyond which the age of a request is unknown."""
SETTLE_TIME = 2.0
"""Seconds after a gap in which requests that waited may still arrive."""
MAX_STAMP_AGE = 2.0
"""Seconds between the stamp of a request and this computer's clock, in either direction."""


class RequestAge:
    """The greatest possible age of a request that arrives now; times in s of one clock."""

    def __init__(self) -> None:
        """No probe was answered yet."""
        self._probed_at = -math.inf
        self._answered = -math.inf
        self._steady_since = math.inf
        self._trips = deque[tuple[float, float]](maxlen=64)  # the time of an answer, and its s

    def probes(self, now: float) -> bool:
        """True if a probe is due; the probe then counts as sent at `now`."""
        is_due = now - self._probed_at >= PROBE_PERIOD
        if is_due:
            self._probed_at = now
        return is_due

    def answered(self, sent_at: float, now: float) -> None:
        """Take the answer to the probe that was sent at `sent_at`."""
        if now - self._answered > MAX_AGE:
            self._steady_since = now
        self._answered = max(self._answered, sent_at)
        self._trips.append((now, now - sent_at))

    def bound(self, now: float) -> float | None:
        """The greatest age in s; None if unknown."""
        age = now - self._answered
        if age > MAX_AGE or now - self._steady_since < SETTLE_TIME:
            return None
        return age + max(trip for at, trip in self._trips if now - at < SETTLE_TIME)


def by_stamp(stamp: float, wall: float) -> float | None:
    """The age by the caller's stamp; None if stamp and this computer's clock are too far apart.

    `stamp`, `wall`: s since 1970. A stamp that lies ahead counts as age 0.
    """
    age = wall - stamp
    return max(age, 0.0) if abs(age) <= MAX_STAMP_AGE else None
