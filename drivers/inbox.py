"""The newest sample of each sense, handed from Zenoh's threads to the loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

import zenoh

from swarmd.handover import hand_over


class Inbox:
    """Calls `take(name, payload)` on the loop with the newest sample of each name.

    Only the newest: after a stall of the loop the older ones would be history, and a queue of
    them would delay what is true now.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, take: Callable[[str, bytes], None]) -> None:
        self._loop, self._take = loop, take
        self._lock = threading.Lock()
        self._waiting: dict[str, bytes] = {}
        self._is_closed = False

    def close(self) -> None:
        """Deliver nothing from now on, not even what is on its way."""
        self._is_closed = True

    def receiver(self, name: str, key: str) -> Callable[[zenoh.Sample], None]:
        """A Zenoh callback for one name; samples on other keys than `key` are left out."""

        def on_sample(sample: zenoh.Sample) -> None:
            if str(sample.key_expr) == key:
                self.put(name, sample.payload.to_bytes())

        return on_sample

    def put(self, name: str, payload: bytes) -> None:
        """Take in a sample, on any thread."""
        with self._lock:
            is_first = name not in self._waiting
            self._waiting[name] = payload
        if is_first:
            hand_over(self._loop, self._deliver, name)

    def _deliver(self, name: str) -> None:
        with self._lock:
            payload = self._waiting.pop(name)
        if not self._is_closed:
            self._take(name, payload)
