"""Rolling scans of rotating sensors: each ray is measured at its own time, while bodies move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarmd.core.values import Array, Platform
from swarmd.sim.world.lidar import Lidar, sweep_order

_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class CompleteScan:
    """A complete rolling scan of robot `row`."""

    row: int
    ranges: Array
    """(rays,) in m, exact; valid until the next `advance`."""
    ages: Array
    """(rays,) in s at the end of the scan."""
    begun: int
    """The step at which the scan began."""


class RollingScans:
    """The scans in progress of the sensors of one platform, measured sector by sector.

    All rays of a sector are measured at one step, and have one age. A ray is measured at most half
    a sector's duration before or after its true time.
    """

    def __init__(self, lidar: Lidar, platform: Platform, n: int, dt: float, sectors: int) -> None:
        """Divide the sensor's sweep into sectors of whole steps; no scan is in progress.

        `platform`: of the sensor, with a `scan.sweep`. `n`: robots of the world. `dt`: s of a step.
        `sectors`: the least number of sectors of a sweep; a sweep with fewer steps has one sector
        for each step.
        """
        spec = platform.scan
        sweep = platform.scan.sweep
        assert sweep is not None
        order, times = sweep_order(spec.bearings, sweep)  # rays in the order of the sweep
        duration = min(sweep.duration, 1.0 / spec.rate)  # ends before the next scan begins
        self._sweep_steps = max(int(duration / dt + _ROUNDING), 1)  # whole steps of a sweep
        # A sector is measured each `sector_steps`, and the time of a ray is rounded to these steps.
        sector_steps = max(self._sweep_steps // sectors, 1)
        ray_steps = (times / (sector_steps * dt) + 0.5).astype(np.intp) * sector_steps
        # (rays,) the step of each ray since the begin of a scan, in the order of the sweep.
        ray_steps = np.minimum(ray_steps, self._sweep_steps)
        # (sweep steps + 1,) the number of rays measured up to each step since the begin of a scan.
        ray_counts = np.searchsorted(ray_steps, np.arange(self._sweep_steps + 1), side="right")
        # (rays,) the age in s of each ray at the end of a scan.
        self._ages = np.empty(len(order))
        self._ages[order] = (self._sweep_steps - ray_steps) * dt
        self._ages.flags.writeable = False
        self._begin_rows(n, len(order))
        self._sweeps = lidar.sweeps(ray_counts, self._ranges)

    def _begin_rows(self, n: int, rays: int) -> None:
        """Make two rows of ranges for each of `n` robots, which its scans use in turn.

        A scan begins at the step at which the previous scan ends, and both write in that step.
        """
        self._n = n
        self._ranges = np.full((2 * n, rays), np.inf)
        self._last_row = list(range(n))
        # A first scan may begin at step 0, as if another scan ended there.
        self._last_begun = [-self._sweep_steps] * n
        self._waiting: set[int] = set()

    def begin(self, robot: int) -> None:
        """Begin a scan of a robot at the next `advance`, or after its scan in progress."""
        self._waiting.add(robot)

    def advance(self, poses: Array, step: int, *, ends_only: bool = False) -> list[CompleteScan]:
        """Measure the rays of `step`; returns the scans that this step completes.

        Consecutive calls have consecutive steps. `poses` (k, 3) of robots, then of boxes.
        `ends_only`: this call measures only the rays of scans that end; a second call for
        this step measures the rest.
        """
        if self._waiting:
            self._start(step)
        return [
            CompleteScan(robot, self._ranges[row], self._ages, step - self._sweep_steps)
            for robot, row in self._sweeps.advance(poses, step, ends_only)
        ]

    def _start(self, step: int) -> None:
        ready = sorted(r for r in self._waiting if self._last_begun[r] + self._sweep_steps <= step)
        self._waiting.difference_update(ready)
        for robot in ready:
            row = (self._last_row[robot] + self._n) % len(self._ranges)
            self._last_begun[robot] = step
            self._last_row[robot] = row
            self._sweeps.begin(robot, step, row)
