"""A queue that holds items back until a time, and the transport of simulated scans with it."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from operator import itemgetter
from typing import Generic, TypeVar

from swarmd.core.values import Platform, Scan
from swarmd.sim.world.realism import LidarNoise
from swarmd.sim.world.seeding import generator

Item = TypeVar("Item")


class DelayQueue(Generic[Item]):
    """Items with a release time; items of one time and rank keep their order."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, float, int, Item]] = []
        self._count = 0

    def put(self, at: float, item: Item, rank: float = 0.0) -> None:
        """Hold the item until `at` s; among items of one time, lower ranks are released first."""
        heapq.heappush(self._heap, (at, rank, self._count, item))
        self._count += 1

    def due(self, now: float) -> list[Item]:
        """Remove and return the items released by `now` s, in order."""
        items = []
        # Times are sums of steps: a rounding error must not delay an item by a step.
        while self._heap and self._heap[0][0] <= now + 1e-9:
            items.append(heapq.heappop(self._heap)[3])
        return items


class ScanTransport:
    """Delays the scans of a swarm; those of one robot keep their order."""

    def __init__(
        self, noise: LidarNoise, platforms: Sequence[Platform], ids: Sequence[str], seed: int
    ) -> None:
        """`platforms` and `ids` (n,) in the order of rows."""
        self._delays = [
            max(noise.latency / platform.scan.rate - _mean_age(noise, platform), 0.0) + noise.delay
            for platform in platforms
        ]
        self._jitter = noise.jitter
        self._rngs = [generator(seed, "scan transport", robot) for robot in ids]
        self._last = [0.0] * len(ids)
        self._in_transit: DelayQueue[tuple[int, Scan]] = DelayQueue()

    def send(self, row: int, scan: Scan, now: float) -> None:
        """Take a scan of robot `row` whose last ray is measured at `now` s."""
        at = now + self._delays[row]
        if self._jitter > 0.0:
            at += self._jitter * float(self._rngs[row].random())
        self._last[row] = max(at, self._last[row])
        self._in_transit.put(self._last[row], (row, scan))

    def arrived(self, now: float) -> list[tuple[int, Scan]]:
        """The scans that have arrived by `now` s since the last call, in order of rows."""
        return sorted(self._in_transit.due(now), key=itemgetter(0))


def _mean_age(noise: LidarNoise, platform: Platform) -> float:
    """The mean age in s of the rays of a scan when its last ray is measured."""
    sweep = platform.scan.sweep
    if not noise.rolling or sweep is None:
        return 0.0
    return 0.5 * min(sweep.duration, 1.0 / platform.scan.rate)
