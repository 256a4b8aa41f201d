"""Limits of the messages that a pattern sends, and of repeated events in a robot's log. Pure."""

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
"""Seconds after which one more event of a kind passes."""


class Outbox:
    """Passes messages of the own pattern, within the limits of each channel and of the robot.

    `dropped`: the count of messages beyond these limits, or on a channel that is not declared.
    """

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
            size = 0  # the shell cannot encode the value either, and counts the message as dropped
        return self._limits.passes(channel, size, now)


class EventLimit:
    """Writes events to the robot's log, and only counts those beyond the limit of each kind.

    The log of `swarmctl describe` is short: a repeated event must not displace all other events.
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
        """For each kind of which one more event may pass, log the count of events left out."""
        for kind, count in list(self._left_out.items()):
            if self._passes(kind, now):
                del self._left_out[kind]
                self._lifecycle.log(f"{kind}: {count} more events", now)

    def _passes(self, kind: str, now: float) -> bool:
        budget = self._budgets.get(kind)
        if budget is None:
            budget = self._budgets[kind] = TokenBucket(1.0 / EVENT_PERIOD, EVENT_BURST)
        return budget.take(1.0, now)
