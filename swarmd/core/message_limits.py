"""The limits of the messages of one sender: a robot's pattern, or a Zenoh program. Pure."""

from __future__ import annotations

from swarmd.core.token_bucket import TokenBucket

CHANNEL_RATE = 20.0
CHANNEL_BURST = 5.0
"""Messages per second on one channel, and at once."""
SENDER_RATE = 100.0
SENDER_BURST = 25.0
"""Messages per second of one sender: five channels at their full rate."""
BYTE_RATE = 32_000.0
BYTE_BURST = 16_000.0
"""Encoded bytes per second of one sender: 31 messages of the largest size, or 320 bytes each at
SENDER_RATE. The shipped patterns send less than 1 kB/s."""
MAX_CHANNELS = 64
"""Channels of one sender whose rates are kept; messages on further ones do not pass."""


class SenderLimits:
    """Passes the messages of one sender within the limits of each channel and of the sender."""

    def __init__(self) -> None:
        self._channels: dict[str, TokenBucket] = {}
        self._messages = TokenBucket(SENDER_RATE, SENDER_BURST)
        self._bytes = TokenBucket(BYTE_RATE, BYTE_BURST)

    def passes(self, channel: str, size: int, now: float) -> bool:
        """True if a message of `size` bytes may pass at `now` (s); if so, spends its budget."""
        bucket = self._channels.get(channel)
        if bucket is None:
            if len(self._channels) >= MAX_CHANNELS:
                return False
            bucket = self._channels[channel] = TokenBucket(CHANNEL_RATE, CHANNEL_BURST)
        if not (bucket.take(1.0, now) and self._messages.holds(1.0, now)):
            return False
        return self._bytes.take(size, now) and self._messages.take(1.0, now)
