"""What a pattern may say: its declared channels, and not too often."""

from __future__ import annotations

from collections.abc import Mapping

from swarmd.values import Value

MESSAGES_PER_SECOND = 20.0


class Outbox:
    """Lets at most 20 messages a second pass on each declared channel; counts the rest."""

    def __init__(self) -> None:
        self._tokens: dict[str, float] = {}
        self._at: dict[str, float] = {}
        self.dropped = 0

    def take(
        self, messages: Mapping[str, Value], channels: frozenset[str], now: float
    ) -> dict[str, Value]:
        """Those that may be sent at `now`, by channel."""
        passed = {}
        for channel, value in messages.items():
            if channel in channels and self._spend(channel, now):
                passed[channel] = value
            else:
                self.dropped += 1
        return passed

    def _spend(self, channel: str, now: float) -> bool:
        elapsed = now - self._at.get(channel, -1e9)
        filled = self._tokens.get(channel, 0.0) + elapsed * MESSAGES_PER_SECOND
        tokens = min(filled, MESSAGES_PER_SECOND / 4.0)
        self._at[channel] = now
        is_allowed = tokens >= 1.0
        self._tokens[channel] = tokens - 1.0 if is_allowed else tokens
        return is_allowed
