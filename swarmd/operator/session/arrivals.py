"""The lock of what an operator receives on other threads, and the wait for more of it."""

from __future__ import annotations

import threading


class Arrivals:
    """A lock over tables that other threads fill, and a count of what has arrived.

    Zenoh's threads and the carrier's thread hold `lock` while they put what they receive into
    tables, then call `notify`. The caller's thread waits.
    """

    def __init__(self) -> None:
        self.lock = threading.Condition()
        self.count = 0

    def notify(self) -> None:
        """Wake the thread that waits; the lock is held."""
        self.count += 1
        self.lock.notify_all()

    def wait(self, count: int, timeout: float) -> None:
        """Wait until something arrives after `count` was read, at most `timeout` s."""
        with self.lock:
            self.lock.wait_for(lambda: self.count != count, max(0.001, timeout))
