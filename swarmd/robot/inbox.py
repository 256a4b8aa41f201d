"""The messages that wait for the next step of the own pattern. Pure."""

from __future__ import annotations

from collections import deque

from msgspec import Struct

from swarmd.core.codec import encode_value
from swarmd.core.values import Message, Value

MESSAGE_OVERHEAD = 200  # bytes of sender, channel and age in a frame
MAX_INBOX_BYTES = 100_000  # of messages kept between two steps; the oldest are dropped first


class _ReceivedMessage(Struct, frozen=True, gc=False):
    """A message that waits for the next step of the pattern."""

    sender: str
    channel: str
    value: Value
    received_at: float  # s
    size: int  # bytes, with MESSAGE_OVERHEAD


class Inbox:
    """Keeps messages up to MAX_INBOX_BYTES. Times are in s on the robot's clock."""

    def __init__(self) -> None:
        self._messages: deque[_ReceivedMessage] = deque()
        self._bytes = 0
        self.overflowed = 0  # messages that were dropped, since the start of the daemon

    def add(self, sender: str, channel: str, value: Value, now: float, size: int = 0) -> None:
        """Keep a message; a full inbox drops its oldest ones.

        `size`: bytes of the encoded value. If it is 0 (unknown), the method encodes the value to
        measure the size, and raises CodecError for a value that is too large.
        """
        size = MESSAGE_OVERHEAD + (size or len(encode_value(value)))
        self._messages.append(_ReceivedMessage(sender, channel, value, now, size))
        self._bytes += size
        while self._bytes > MAX_INBOX_BYTES:
            self._bytes -= self._messages.popleft().size
            self.overflowed += 1

    def take(self, now: float) -> tuple[Message, ...]:
        """The messages since the last call, with their ages; empties the inbox."""
        if not self._messages:
            return ()
        messages = tuple(
            [Message(m.sender, m.channel, m.value, now - m.received_at) for m in self._messages]
        )
        self.clear()
        return messages

    def clear(self) -> None:
        """Drop all messages that were meant for an earlier pattern."""
        self._messages.clear()
        self._bytes = 0
