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


@dataclass(frozen=True, slots=True, eq=False)
class _Segment:
    """The rays of one segment of a sweep; fields as of `MeasuredSegment`."""

    rays: Indices
    bearings: Array
    ages: Array
    first_step: int
    """The step at which the first of these rays is measured, since the begin of the scan."""


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
        spec, sweep = platform.scan, platform.scan.sweep
        assert sweep is not None
        order, times = sweep_order(spec.bearings, sweep)
        duration = min(sweep.duration, 1.0 / spec.rate)  # the next scan must not begin before
        self._steps = max(int(duration / dt + _ROUNDING), 1)  # whole steps of a sweep
        # A sector is measured each `sector_steps`, and the time of a ray is rounded to these steps.
        sector_steps = max(self._steps // sectors, 1)
        steps = (times / (sector_steps * dt) + 0.5).astype(np.intp) * sector_steps
        steps = np.minimum(steps, self._steps)  # of each ray, in the order of the sweep
        # (steps + 1,) the number of rays measured up to each step since the begin of a scan.
        ends = np.searchsorted(steps, np.arange(self._steps + 1), side="right")
        # (rays,) the age in s of each ray at the end of a scan.
        self._ages = np.empty(len(order))
        self._ages[order] = (self._steps - steps) * dt
        self._ages.flags.writeable = False
        # By its last step. The last segment of a sweep is left out: it comes with the whole scan.
        self._segments: dict[int, _Segment] = {}
        self.segments: list[MeasuredSegment] = []  # of the last `advance`
        first_ray = 0
        for number in range(1, spec.segments):
            last_step = number * self._steps // spec.segments
            end_ray = int(ends[last_step])
            if end_ray > first_ray:
                segment = _segment(
                    spec.bearings, order[first_ray:end_ray], steps[first_ray:end_ray], dt
                )
                self._segments[last_step] = segment
            first_ray = end_ray
        self._begin_rows(n, len(order))
        self._sweeps = lidar.sweeps(ends, self._ranges)

    def _begin_rows(self, n: int, rays: int) -> None:
        """Make two rows of ranges for each of `n` robots, which its scans use in turn.

        A scan begins at the step at which the previous scan ends, and both write in that step.
        """
        self._n = n
        self._ranges = np.full((2 * n, rays), np.inf)
        self._last_row = list(range(n))
        # A first scan may begin at step 0, as if another scan ended there.
        self._last_begun = [-self._steps] * n
        self._waiting: set[int] = set()

    def begin(self, robot: int) -> None:
        """Begin a scan of a robot at the next `advance`, or after its scan in progress."""
        self._waiting.add(robot)

    def advance(self, poses: Array, step: int, *, ends_only: bool = False) -> list[CompleteScan]:
        """Measure the rays of `step`; returns the scans that this step completes.

        Consecutive calls have consecutive steps. `poses` (k, 3) of robots, then of boxes.
        `ends_only`: the rays of scans that do not end, and segments, are left to a second call for
        this step.
        """
        if self._waiting:
            self._start(step)
        completed = [
            CompleteScan(robot, self._ranges[row], self._ages, step - self._steps)
            for robot, row in self._sweeps.advance(poses, step, ends_only)
        ]
        if self._segments:
            self.segments = [] if ends_only else self._ended_segments(step)
        return completed

    def _ended_segments(self, step: int) -> list[MeasuredSegment]:
        """The segments of the robots' last scans that end at `step`."""
        ended = []
        for robot, begun in enumerate(self._last_begun):
            segment = self._segments.get(step - begun)
            if segment is not None:
                ended.append(
                    MeasuredSegment(
                        robot,
                        self._ranges[self._last_row[robot]],
                        segment.rays,
                        segment.bearings,
                        segment.ages,
                        begun + segment.first_step,
                    )
                )
        return ended

    def _start(self, step: int) -> None:
        ready = sorted(r for r in self._waiting if self._last_begun[r] + self._steps <= step)
        self._waiting.difference_update(ready)
        for robot in ready:
            row = (self._last_row[robot] + self._n) % len(self._ranges)
            self._last_begun[robot], self._last_row[robot] = step, row
            self._sweeps.begin(robot, step, row)


def _segment(all_bearings: Array, rays: Indices, steps: Indices, dt: float) -> _Segment:
    """The segment of `rays` (k,), which are measured at `steps` (k,) of a scan; `dt` in s."""
    bearings, ages = all_bearings[rays], (steps[-1] - steps) * dt
    bearings.flags.writeable = ages.flags.writeable = False
    return _Segment(rays, bearings, ages, int(steps[0]))
