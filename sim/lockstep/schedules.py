"""When periodic things are due in lockstep, each robot in a phase of its own."""

from __future__ import annotations

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.world.geometry import Indices

_ROUNDING = 1e-9
_NOBODY: Indices = np.empty(0, dtype=np.intp)


class Schedules:
    """Periodic jobs of n robots: no two lidars or daemons of a swarm are in step."""

    def __init__(self, rates: Array, begins: Array | None = None) -> None:
        """`rates` (n,) in Hz. `begins` (n,): when each begins, in s; None: all at once.

        Two rhythms that begin together meet again: a robot ticks when its lidar sweeps, as often as
        it can, and is taken into the processor's caches once for both.
        """
        self._period = 1.0 / np.asarray(rates, dtype=np.float64)
        starts = np.zeros(len(self._period)) if begins is None else begins
        self._phase = np.mod(starts, self._period)
        self._ticks = np.zeros(len(self._period))
        self._next = self._phase.copy()
        self._soonest = float(self._next.min(initial=np.inf))

    def due(self, now: float) -> Indices:
        """The rows due by `now` s, in order; ask at every step, for each is named once a period."""
        if self._soonest > now + _ROUNDING:
            return _NOBODY
        rows = (self._next <= now + _ROUNDING).nonzero()[0]
        self._ticks[rows] += 1.0
        self._next[rows] = self._phase[rows] + self._ticks[rows] * self._period[rows]
        self._soonest = float(self._next.min())
        return rows


class Alarms:
    """One alarm a robot, on the grid of a world's steps."""

    def __init__(self, n: int, dt: float) -> None:
        self._dt = dt
        self._step = 0
        self._alarms = [-1] * n
        self._rows: dict[int, list[int]] = {}

    def set(self, row: int, at: float | None) -> None:
        """Wake `row` in the first step from `at` s on, not before the next; None: not at all."""
        if at is None:
            self._alarms[row] = -1
            return
        step = max(int(-((_ROUNDING - at) // self._dt)), self._step + 1)
        if self._alarms[row] != step:
            self._alarms[row] = step
            self._rows.setdefault(step, []).append(row)

    def due(self, step: int) -> list[int]:
        """The rows to wake in this step, in order; to be asked for every step."""
        self._step = step
        rows = [row for row in self._rows.pop(step, ()) if self._alarms[row] == step]
        for row in rows:
            self._alarms[row] = -1
        return sorted(rows)
