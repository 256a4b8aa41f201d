"""How many messages a pattern may send, and how many repeated events a robot reports. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING

from swarmd.core.codec import encode_value
from swarmd.core.errors import CodecError
from swarmd.core.message_limits import SenderLimits
from swarmd.core.token_bucket import TokenBucket
from swarmd.core.values import Value

if TYPE_CHECKING:
    from swarmd.robot.state import Lifecycle

EVENT_BURST = 3
"""Events of one kind that pass at once."""
EVENT_PERIOD = 60.0
"""Seconds after which one more passes."""


class Outbox:
    """Passes the messages of a pattern on declared channels within the limits of each channel and
    of the robot; `dropped` counts the others."""

    def __init__(self) -> None:
        self._limits = SenderLimits()
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
        try:
            size = len(encode_value(value))
        except CodecError:
            size = 0  # the shell cannot send it either, and counts it
        return self._limits.passes(channel, size, now)


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
