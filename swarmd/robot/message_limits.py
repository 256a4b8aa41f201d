"""How many messages a pattern may send, and how many repeated events a robot reports. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING

from swarmd.core.codec import encode_value
from swarmd.core.errors import CodecError
from swarmd.core.token_bucket import TokenBucket
from swarmd.core.values import Value

if TYPE_CHECKING:
    from swarmd.robot.state import Lifecycle

CHANNEL_RATE, CHANNEL_BURST = 20.0, 5.0
"""Messages per second on one channel, and at once."""
ROBOT_RATE, ROBOT_BURST = 100.0, 25.0
"""Messages per second of one robot: five channels at their full rate."""
BYTE_RATE, BYTE_BURST = 32_000.0, 16_000.0
"""Encoded bytes per second of one robot: 31 messages of the largest size, or 320 bytes each at
ROBOT_RATE. The shipped patterns say less than 1 kB/s."""
EVENT_BURST = 3
"""Events of one kind that pass at once."""
EVENT_PERIOD = 60.0
"""Seconds after which one more passes."""


class Outbox:
    """Passes the messages of a pattern on declared channels within the limits of each channel and
    of the robot; `dropped` counts the others."""

    def __init__(self) -> None:
        self._channels: dict[str, TokenBucket] = {}
        self._messages = TokenBucket(ROBOT_RATE, ROBOT_BURST)
        self._bytes = TokenBucket(BYTE_RATE, BYTE_BURST)
        self.dropped = 0

    def take(
        self, messages: Mapping[str, Value], channels: frozenset[str], now: float
    ) -> dict[str, Value]:
        """The messages that may be sent at `now` (s), by channel."""
        passed = {}
        for channel, value in messages.items():
            if channel in channels and self._spend(channel, value, now):
                passed[channel] = value
            else:
                self.dropped += 1
        return passed

    def _spend(self, channel: str, value: Value, now: float) -> bool:
        bucket = self._channels.setdefault(channel, TokenBucket(CHANNEL_RATE, CHANNEL_BURST))
        if not (bucket.take(1.0, now) and self._messages.holds(1.0, now)):
            return False
        try:
            size = len(encode_value(value))
        except CodecError:
            size = 0  # the shell cannot send it either, and counts it
        return self._bytes.take(size, now) and self._messages.take(1.0, now)


class EventLimit:
    """Hands events to the robot's log; of those beyond the limit of their kind, their number.

    So `describe` keeps room for other events.
    """

    def __init__(self, lifecycle: Lifecycle) -> None:
        self._lifecycle = lifecycle
        self._budgets: dict[str, TokenBucket] = {}
        self._left_out: Counter[str] = Counter()

    def log(self, kind: str, text: str, now: float) -> None:
        """Log an event, or count it."""
        if self._passes(kind, now):
            self._lifecycle.log(text, now)
        else:
            self._left_out[kind] += 1

    def advance(self, now: float) -> None:
        """Log how many events were left out, of each kind of which one more passes."""
        for kind, count in list(self._left_out.items()):
            if self._passes(kind, now):
                del self._left_out[kind]
                self._lifecycle.log(f"{kind}: {count} more events", now)

    def _passes(self, kind: str, now: float) -> bool:
        budget = self._budgets.get(kind)
        if budget is None:
            budget = self._budgets[kind] = TokenBucket(1.0 / EVENT_PERIOD, EVENT_BURST)
        return budget.take(1.0, now)
