"""The way of a simulated scan from its last ray to the robot."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter

from swarmd.core.values import Platform, Scan
from swarmd.sim.world.delay_queue import DelayQueue
from swarmd.sim.world.realism import LidarNoise
from swarmd.sim.world.seeding import generator


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
