"""What a robot's pattern may say: a limit for each channel, and a budget for the robot. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from swarmd.core.codec import encode_value
from swarmd.core.errors import CodecError
from swarmd.core.token_bucket import TokenBucket
from swarmd.core.values import Value

CHANNEL_RATE, CHANNEL_BURST = 20.0, 5.0
"""Messages per second on one channel, and at once."""
ROBOT_RATE, ROBOT_BURST = 100.0, 25.0
"""Messages per second of one robot: five channels at their full rate."""
BYTE_RATE, BYTE_BURST = 32_000.0, 16_000.0
"""Encoded bytes per second of one robot: 31 messages of the largest size, or 320 bytes each at
ROBOT_RATE. The shipped patterns say less than 1 kB/s."""


class Outbox:
    """Passes the messages on declared channels within the limits; `dropped` counts the others."""

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
