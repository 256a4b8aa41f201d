"""When a robot sends its beacon and its latches to all. Pure.

1. Without changes a beacon follows after BEACON_PERIOD, while the robot claims its id after
   CLAIM_PERIOD, and while a latch is new after FAST_BEACON_PERIOD.
2. A new latch is shown at once, any other change FAST_BEACON_PERIOD after the last beacon.
3. A new latch itself is sent at LATCH_REPEATS, unless REDUNDANCY others have sent the same ones.
"""

from __future__ import annotations

import math

from swarmd.network.members.claim import CLAIM_PERIOD
from swarmd.network.stops.stop_relay import REDUNDANCY

BEACON_PERIOD = 1.0  # s
# While a latch is new, and at least between beacons of changes.
FAST_BEACON_PERIOD = 0.1
NEW_LATCH_TIME = 1.0
LATCH_REPEATS = (0.0, 0.1, 0.3)  # s after a latch is new: so often the latch itself is sent to all


class BeaconTimes:
    """The times of the next beacon and of the next copies of the latches."""

    def __init__(self, now: float) -> None:
        self._beacons = 0  # sent to all
        self._beacon_at = now
        self._last_beacon = -math.inf
        self._shown: tuple[object, ...] = ()
        self._digest = b""
        self._digest_since = -math.inf
        self._latches_due: list[float] = []
        self._latch_copies = 0  # how often others have sent the same latches to all

    def send_now(self, now: float) -> None:
        """Let the next beacon be due now."""
        self._beacon_at = now

    def on_latches(self, digest: bytes) -> None:
        """Another robot has sent its latches to all."""
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

    def number_due(self, shown: tuple[object, ...], now: float, *, is_claiming: bool) -> int:
        """The number of the beacon that is due now, from 1; 0 if none is due.

        `shown`: what the beacon shows.
        """
        if shown != self._shown:
            self._shown = shown
            self._beacon_at = min(self._beacon_at, self._last_beacon + FAST_BEACON_PERIOD)
        if now < self._beacon_at:
            return 0
        is_new = now - self._digest_since < NEW_LATCH_TIME
        period = FAST_BEACON_PERIOD if is_new else BEACON_PERIOD
        if is_claiming:
            period = CLAIM_PERIOD
        self._last_beacon, self._beacon_at = now, now + period
        self._beacons += 1
        return self._beacons

    def wake_at(self) -> float:
        """When a beacon or the latches are due next."""
        return min(self._beacon_at, *self._latches_due[:1], math.inf)
