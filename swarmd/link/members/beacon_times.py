"""When a robot sends its beacon and its latches to all. Pure.

1. The usual period of beacons is BEACON_PERIOD. It is FAST_BEACON_PERIOD while a latch is new, and
   that of the claim while the robot claims its id.
2. A new latch makes a beacon due at once. Any other change makes a beacon due FAST_BEACON_PERIOD
   after the last beacon.
3. The latches themselves are sent at LATCH_REPEATS after a new latch, unless REDUNDANCY other
   robots have sent the same latches.
"""

from __future__ import annotations

import math

from swarmd.link.stops.stop_relay import REDUNDANCY

BEACON_PERIOD = 1.0  # s
FAST_BEACON_PERIOD = 0.1  # s; also the least time between two beacons of changes
NEW_LATCH_TIME = 1.0  # s for which a latch is new
LATCH_REPEATS = (0.0, 0.1, 0.3)  # s after a new latch, at which the latches are sent to all


class BeaconTimes:
    """The times of the next beacon and of the next copies of the latches."""

    def __init__(self, now: float) -> None:
        self._beacons = 0  # the count of beacons sent to all
        self._beacon_at = now
        self._last_beacon = -math.inf
        self._content: tuple[object, ...] = ()
        self._digest = b""
        self._digest_since = -math.inf
        self._latches_due: list[float] = []
        self._latch_copies = 0  # how often other robots have sent the same latches to all

    def send_now(self, now: float) -> None:
        """Let the next beacon be due now."""
        self._beacon_at = now

    def on_latches(self, digest: bytes) -> None:
        """Count the latches of another robot, sent to all, if they equal the own latches."""
        self._latch_copies += digest == self._digest

    def note_latches(self, digest: bytes, now: float) -> None:
        """Take the digest of the own latches; empty without a latch."""
        if digest != self._digest:
            self._digest = digest
            self._latch_copies = 0
            self._latches_due = [now + delay for delay in LATCH_REPEATS] if digest else []
            self._digest_since = now if digest else -math.inf
            self._beacon_at = now

    def latches_are_due(self, now: float) -> bool:
        """True if the latches are to be sent now; False until the next of LATCH_REPEATS."""
        if not self._latches_due or now < self._latches_due[0]:
            return False
        self._latches_due.pop(0)
        return self._latch_copies < REDUNDANCY

    def number_due(
        self, content: tuple[object, ...], now: float, *, claim_period: float | None
    ) -> int:
        """The number of the beacon that is due now, from 1; 0 if no beacon is due.

        `content`: the values in the beacon. A change of these makes the beacon due earlier.
        `claim_period`: s until the next beacon of a robot that claims its id; None: it owns its id.
        """
        if content != self._content:
            self._content = content
            self._beacon_at = min(self._beacon_at, self._last_beacon + FAST_BEACON_PERIOD)
        if now < self._beacon_at:
            return 0
        is_new = now - self._digest_since < NEW_LATCH_TIME
        period = FAST_BEACON_PERIOD if is_new else BEACON_PERIOD
        if claim_period is not None:
            period = claim_period
        self._last_beacon = now
        self._beacon_at = now + period
        self._beacons += 1
        return self._beacons

    def wake_at(self) -> float:
        """When a beacon or the latches are due next."""
        return min(self._beacon_at, *self._latches_due[:1], math.inf)
