"""Rolling scans of rotating sensors: each ray is measured at its own time, while bodies move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarmd.core.values import Array, Platform
from swarmd.sim.world.geometry import Indices
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


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSegment:
    """The rays of a rolling scan in progress that were measured since the segment before."""

    row: int
    ranges: Array
    """(rays,) in m, exact, of all rays of the sensor; valid until the next `advance`."""
    rays: Indices
    """(k,) the numbers of the measured rays, in the order of the sweep."""
    bearings: Array
    """(k,) rad."""
    ages: Array
    """(k,) s against the newest of these rays."""
    oldest: int
    """The step at which the first of these rays was measured."""


class RollingScans:
    """The scans in progress of the sensors of one platform, measured sector by sector.

    All rays of a sector are measured at one step, and have one age. A ray is measured at most half
    a sector's duration before or after its true time.
    """

    def __init__(self, lidar: Lidar, platform: Platform, n: int, dt: float, sectors: int) -> None:
        """Divide the sensor's sweep into sectors of whole steps; no scan is in progress.

        `n`: robots of the world. `dt`: s of a step. `platform.scan.sweep` must be given. `sectors`:
        the least number of sectors of a sweep, if the sweep has as many steps.
        """
        spec, sweep = platform.scan, platform.scan.sweep
        assert sweep is not None
        # 1. The step of a scan at which each ray is measured, in the order of the sweep.
        order, times = sweep_order(spec.bearings, sweep)
        duration = min(sweep.duration, 1.0 / spec.rate)
        self._steps = max(int(duration / dt + _ROUNDING), 1)  # whole steps of a sweep
        sector_steps = max(self._steps // sectors, 1)
        # A sector of rays is measured each `sector_steps`: the time of a ray is rounded to these.
        steps = (times / (sector_steps * dt) + 0.5).astype(np.intp) * sector_steps
        steps = np.minimum(steps, self._steps)
        # 2. The number of rays measured by each step since the begin of a scan.
        ends = np.searchsorted(steps, np.arange(self._steps + 1), side="right")
        # 3. (rays,) the age in s of each ray at the end of a scan.
        self._ages = np.empty(len(order))
        self._ages[order] = (self._steps - steps) * dt
        self._ages.flags.writeable = False
        self._n = n
        # By the last step of each segment but the last: its rays, their bearings and ages, and the
        # step of its first ray. The last segment comes with the whole scan.
        self._segments: dict[int, tuple[Indices, Array, Array, int]] = {}
        self.segments: list[MeasuredSegment] = []  # of the last `advance`
        measured = 0
        for number in range(1, spec.segments):
            step = number * self._steps // spec.segments
            rays, first = order[measured : ends[step]], measured
            measured = int(ends[step])
            if len(rays):
                own = steps[first:measured]
                bearings, ages = spec.bearings[rays], (own[-1] - own) * dt
                bearings.flags.writeable = ages.flags.writeable = False
                self._segments[step] = rays, bearings, ages, int(own[0])
        # 4. Two rows for each robot, used in turn: a scan begins at the step at which the previous
        # scan ends, and both write in that step. At first each robot is as if its last scan had
        # ended at step 0.
        self._ranges = np.full((2 * n, len(order)), np.inf)
        self._last_row, self._last_begun = list(range(n)), [-self._steps] * n
        self._waiting: set[int] = set()
        self._sweeps = lidar.sweeps(ends, self._ranges)

    def begin(self, robot: int) -> None:
        """Begin a scan of a robot at the next `advance`, or after its scan in progress."""
        self._waiting.add(robot)

    def advance(self, poses: Array, step: int, *, ends_only: bool = False) -> list[CompleteScan]:
        """Measure the rays of `step`; returns the scans that this step completes.

        Consecutive calls have consecutive steps. `poses` (k, 3) of robots, then of boxes.
        `ends_only`: measure no rays of other scans; a second call for this step measures those.
        """
        if self._waiting:
            self._start(step)
        completed = [
            CompleteScan(robot, self._ranges[row], self._ages, step - self._steps)
            for robot, row in self._sweeps.advance(poses, step, ends_only)
        ]
        if self._segments:
            self.segments = [
                MeasuredSegment(
                    robot, self._ranges[self._last_row[robot]], rays, bearings, ages, begun + oldest
                )
                for robot, begun in enumerate(self._last_begun)
                if step - begun in self._segments and not ends_only
                for rays, bearings, ages, oldest in (self._segments[step - begun],)
            ]
        return completed

    def _start(self, step: int) -> None:
        ready = sorted(r for r in self._waiting if self._last_begun[r] + self._steps <= step)
        self._waiting.difference_update(ready)
        for robot in ready:
            row = (self._last_row[robot] + self._n) % len(self._ranges)
            self._last_begun[robot], self._last_row[robot] = step, row
            self._sweeps.begin(robot, step, row)
