"""The newest sample of each topic, handed from Zenoh's threads to the loop."""

from __future__ import annotations

import asyncio
import threading
from collections import Counter
from collections.abc import Callable

from swarmd.core.threads import hand_over


class LatestSamples:
    """Calls `take(name, payload)` on the loop with the newest sample of each name.

    A waiting sample is dropped when a newer sample of the same name arrives: after a stall of the
    loop a queue of outdated samples would delay the newest. For each dropped sample `dropped(what)`
    is called on the loop, with `<name>:overtaken`, or with the `what` that `drop` gets.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        take: Callable[[str, bytes], None],
        dropped: Callable[[str], None] = lambda what: None,
    ) -> None:
        self._loop = loop
        self._take = take
        self._dropped = dropped
        self._lock = threading.Lock()
        self._waiting: dict[str, bytes] = {}
        self._dropped_counts: Counter[str] = Counter()
        self._is_closed = False

    def close(self) -> None:
        """Deliver nothing from now on, not even samples on their way."""
        self._is_closed = True

    def put(self, name: str, payload: bytes) -> None:
        """Take in a sample, on any thread."""
        with self._lock:
            is_first = name not in self._waiting
            self._waiting[name] = payload
        if is_first:
            hand_over(self._loop, self._deliver, name)
        else:
            self.drop(f"{name}:overtaken")

    def _deliver(self, name: str) -> None:
        with self._lock:
            payload = self._waiting.pop(name)
        if not self._is_closed:
            self._take(name, payload)

    def drop(self, what: str) -> None:
        """Count a sample that is not taken in, on any thread."""
        with self._lock:
            is_first = not self._dropped_counts
            self._dropped_counts[what] += 1
        if is_first:
            hand_over(self._loop, self._report)

    def _report(self) -> None:
        with self._lock:
            counts = self._dropped_counts
            self._dropped_counts = Counter()
        for what in counts.elements():
            self._dropped(what)
