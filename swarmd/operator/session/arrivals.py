"""The wait of a call: for what an operator receives on other threads, and until a repeat is due."""

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


# Of solicits, as `steps` of a timer: often at first, then sparing the network.
SOLICIT_PACE = ((0.5, 0.1), (float("inf"), 0.5))


class RepeatTimer:
    """When to do something again; `steps`: (until, period) in s since the start."""

    def __init__(self, now: float, steps: tuple[tuple[float, float], ...]) -> None:
        self._started = now
        self._next = now
        self._steps = steps

    def age(self, now: float) -> float:
        """Seconds since the start."""
        return now - self._started

    def is_due(self, now: float) -> bool:
        """True once a period: the call then begins the next period."""
        if now < self._next:
            return False
        age = now - self._started
        self._next = now + next(period for until, period in self._steps if age < until)
        return True

    def pause(self, now: float) -> float:
        """Seconds until it is due."""
        return max(0.001, self._next - now)
