"""What is under way: held back until its time has come."""

from __future__ import annotations

import heapq
from typing import Generic, TypeVar

Item = TypeVar("Item")


class DelayQueue(Generic[Item]):
    """Items that wait for their time; those of one time come in the order they were put in."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Item]] = []
        self._count = 0

    def put(self, at: float, item: Item) -> None:
        """Hold the item back until `at` s."""
        heapq.heappush(self._heap, (at, self._count, item))
        self._count += 1

    def due(self, now: float) -> list[Item]:
        """Take out all whose time has come by `now` s, in order."""
        items = []
        # Times are sums of steps: what is due now must not wait a step for a rounding error.
        while self._heap and self._heap[0][0] <= now + 1e-9:
            items.append(heapq.heappop(self._heap)[2])
        return items
