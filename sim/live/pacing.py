"""Real-time pacing: due steps and due periodic jobs; the present time is an argument."""

from __future__ import annotations

from collections import deque

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.world.geometry import Indices

MAX_CATCH_UP = 0.25
"""The longest delay in s that is caught up by more steps; a longer delay is skipped."""

_WINDOW = 1.0


class StepPacer:
    """Absolute deadlines of steps; late steps are caught up within `MAX_CATCH_UP`."""

    def __init__(self, dt: float, now: float) -> None:
        self._dt = dt
        self.deadline = now + dt
        self.overruns = 0
        self._progress: deque[tuple[float, int]] = deque([(now, 0)])
        self._steps = 0

    def steps(self, now: float) -> int:
        """The number of steps due now; late steps are counted in `overruns`."""
        if now < self.deadline:
            return 0
        late = now - self.deadline
        if late > MAX_CATCH_UP:
            due = 1
            self.deadline = now + self._dt
            self.overruns += int(late / self._dt)
        else:
            due = int(late / self._dt) + 1
            self.deadline += due * self._dt
            self.overruns += due - 1
        self._steps += due
        self._progress.append((now, self._steps))
        while len(self._progress) > 2 and self._progress[1][0] <= now - _WINDOW:
            self._progress.popleft()
        return due

    def real_time_factor(self) -> float:
        """Simulated over real time in about the last second; 0 before the first step."""
        (start, before) = self._progress[0]
        (end, after) = self._progress[-1]
        return (after - before) * self._dt / (end - start) if end > start else 0.0


class Staggered:
    """n periodic jobs, spread evenly over half of their period, which avoids bursts."""

    def __init__(self, rates: Array, now: float, order: Indices | None = None) -> None:
        """Plan the first time of each job, half a period to a period after `now` in s.

        `rates` (n,) of the jobs in Hz. `order` (n,): the indices of the jobs in the order of their
        first times; None: the order of `rates`.
        """
        self._period = 1.0 / np.asarray(rates, dtype=np.float64)
        n = len(self._period)
        places = np.arange(n) if order is None else np.argsort(order)
        self._next = now + self._period * (1.0 + places / max(n, 1)) / 2.0

    def due(self, now: float) -> Indices:
        """The indices of jobs due by `now`, each once; missed periods are skipped."""
        ready = np.nonzero(self._next <= now + 1e-9)[0]
        missed = np.floor((now + 1e-9 - self._next[ready]) / self._period[ready])
        self._next[ready] += (missed + 1.0) * self._period[ready]
        return ready
