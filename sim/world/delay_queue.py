"""A queue that holds items back until a time."""

from __future__ import annotations

import heapq
from typing import Generic, TypeVar

Item = TypeVar("Item")


class DelayQueue(Generic[Item]):
    """Items with a release time; items of one time and rank keep their order."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, float, int, Item]] = []
        self._count = 0

    def put(self, at: float, item: Item, rank: float = 0.0) -> None:
        """Hold the item until `at` s; of one time, items of lower rank are released first."""
        heapq.heappush(self._heap, (at, rank, self._count, item))
        self._count += 1

    def due(self, now: float) -> list[Item]:
        """Remove and return the items released by `now` s, in order."""
        items = []
        # Times are sums of steps: a rounding error must not delay an item by a step.
        while self._heap and self._heap[0][0] <= now + 1e-9:
            items.append(heapq.heappop(self._heap)[3])
        return items
