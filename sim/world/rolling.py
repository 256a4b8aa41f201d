"""Scans of sensors that turn: each ray is measured at its own time, while bodies move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarmd.core.values import Array, Platform
from swarmd.sim.world.lidar import Lidar, sweep_order

_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class CompleteScan:
    """A scan of robot `row`: exact ranges (rays,) in m, ages (rays,) in s, and its first step.

    The ranges are valid until the next `advance`.
    """

    row: int
    ranges: Array
    ages: Array
    begun: int


class RollingScans:
    """The scans in progress of the sensors of one platform, measured sector by sector.

    A ray is measured within half a sector of its time. The ages of a scan are those of sectors.
    """

    def __init__(self, lidar: Lidar, platform: Platform, n: int, dt: float, sectors: int) -> None:
        """For `n` robots of a world with steps of `dt` s; `platform.scan.sweep` is given.

        A sweep has at least that many `sectors`, or one each step.
        """
        spec, sweep = platform.scan, platform.scan.sweep
        assert sweep is not None
        order, times = sweep_order(spec.bearings, sweep)
        duration = min(sweep.duration, 1.0 / spec.rate)
        self._steps = max(int(duration / dt + _ROUNDING), 1)
        width = max(self._steps // sectors, 1)
        steps = np.minimum((times / (width * dt) + 0.5).astype(np.intp) * width, self._steps)
        # By steps since the begin.
        ends = np.searchsorted(steps, np.arange(self._steps + 1), side="right")
        self._first, self._counts = lidar.sectors(ends)
        self._ages = np.empty(len(order))
        self._ages[order] = (self._steps - steps) * dt
        self._ages.flags.writeable = False
        self._lidar, self._n = lidar, n
        # Two rows for each robot, since a scan begins at the step at which the last one ends.
        self._ranges = np.full((2 * n, len(order)), np.inf)
        self._last_row, self._last_begun = list(range(n)), [-self._steps] * n
        self._waiting: set[int] = set()
        # (3, m) of the scans in progress: robots, first steps, and rows of `_ranges`.
        self._scans = np.empty((3, 0), dtype=np.intp)

    def begin(self, robot: int) -> None:
        """Begin a scan of a robot at the next `advance`, or after its last one."""
        self._waiting.add(robot)

    def advance(self, poses: Array, step: int) -> list[CompleteScan]:
        """Measure the rays of `step`, which is one after the last; returns the complete scans.

        `poses` (k, 3) of robots, then of boxes.
        """
        if self._waiting:
            self._start(step)
        robots, begun, rows = self._scans
        since = step - begun
        first, counts = self._first, self._counts
        self._lidar.cast_sectors(self._ranges, rows, poses, robots, since, first, counts)
        if not (len(since) and since[0] == self._steps):  # scans are in the order of their begin
            return []
        done = np.count_nonzero(since == self._steps)
        self._scans = self._scans[:, done:]
        return [
            CompleteScan(robot, self._ranges[row], self._ages, step - self._steps)
            for robot, row in zip(robots[:done].tolist(), rows[:done].tolist(), strict=True)
        ]

    def _start(self, step: int) -> None:
        ready = sorted(r for r in self._waiting if self._last_begun[r] + self._steps <= step)
        if not ready:
            return
        self._waiting.difference_update(ready)
        for robot in ready:
            self._last_begun[robot] = step
            self._last_row[robot] = (self._last_row[robot] + self._n) % len(self._ranges)
        new = ready, [step] * len(ready), [self._last_row[robot] for robot in ready]
        self._scans = np.concatenate((self._scans, np.array(new, dtype=np.intp)), axis=1)
