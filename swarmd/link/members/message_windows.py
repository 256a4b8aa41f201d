"""Which messages of patterns are new, which are duplicates, and how many are lost. Pure.

Other modules drop repeated datagrams of other kinds: `carriers/udp.py` a copy by a second way,
`membership.py` a delayed beacon, `beacon_freshness.py` a replayed beacon, `stops/stop_freshness.py`
a replayed stop.
"""

from __future__ import annotations

from dataclasses import dataclass

from swarmd.link.datagram import Message

WINDOW = 64  # the last messages of a sender, for each of which the robot knows whether it came
MAX_SENDERS = 1024


@dataclass(slots=True)
class _Window:
    """The last WINDOW messages of a sender: the highest sequence, and a bit for each message."""

    instance: bytes
    highest: int
    seen: int = 1  # bit k is set if the message `highest - k` has come

    def take(self, sequence: int) -> tuple[bool, int]:
        """Take the sequence number of a message.

        Returns whether the message is new, and the change of the number of lost messages. A message
        that comes after a later message was counted as lost before, so that the change is -1.
        """
        ahead = sequence - self.highest
        if ahead >= WINDOW:  # the window holds no message before: at most WINDOW count as lost
            self.seen = 1
            self.highest = sequence
            return True, WINDOW
        if ahead > 0:
            self.seen = ((self.seen << ahead) | 1) & ((1 << WINDOW) - 1)
            self.highest = sequence
            return True, ahead - 1
        behind = -ahead  # at most 0 ahead: an earlier message, or the highest again
        if behind >= WINDOW or self.seen & 1 << behind:
            return False, 0
        self.seen |= 1 << behind
        return True, -1


class MessageWindows:
    """The last messages of each sender."""

    def __init__(self) -> None:
        self._windows: dict[str, _Window] = {}

    def take(self, message: Message) -> tuple[bool, int]:
        """Whether a message is new, and the change of the number of lost messages."""
        window = self._windows.get(message.robot)
        if window is not None and window.instance == message.instance:
            return window.take(message.sequence)
        self._windows.pop(message.robot, None)
        while len(self._windows) >= MAX_SENDERS:
            del self._windows[next(iter(self._windows))]
        self._windows[message.robot] = _Window(message.instance, message.sequence)
        return True, 0
