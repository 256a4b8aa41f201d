"""Periodic jobs and alarms in lockstep."""

from __future__ import annotations

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.world.geometry import Indices

_ROUNDING = 1e-9
_NONE: Indices = np.empty(0, dtype=np.intp)


class Schedules:
    """A periodic job of each of n robots, at a phase of its own."""

    def __init__(self, rates: Array, begins: Array | None = None) -> None:
        """`rates` (n,) in Hz. `begins` (n,) in s: the first time of each; None: all at 0.

        Jobs with equal phases coincide: a robot ticks with its scan where the rates allow, and
        both find its data in the processor's caches.
        """
        self._period = 1.0 / np.asarray(rates, dtype=np.float64)
        starts = np.zeros(len(self._period)) if begins is None else begins
        self._phase = np.mod(starts, self._period)
        self._ticks = np.zeros(len(self._period))
        self._next = self._phase.copy()
        self._soonest = float(self._next.min(initial=np.inf))

    def due(self, now: float) -> Indices:
        """The rows due by `now` s, in order; call it at every step."""
        if self._soonest > now + _ROUNDING:
            return _NONE
        rows = (self._next <= now + _ROUNDING).nonzero()[0]
        self._ticks[rows] += 1.0
        self._next[rows] = self._phase[rows] + self._ticks[rows] * self._period[rows]
        self._soonest = float(self._next.min())
        return rows


class Alarms:
    """At most one alarm for each robot, rounded up to the steps of a world."""

    def __init__(self, n: int, dt: float) -> None:
        self._dt = dt
        self._step = 0
        self._alarms = [-1] * n
        self._rows: dict[int, list[int]] = {}

    def set(self, row: int, at: float | None) -> None:
        """Set the alarm of `row` to the first step from `at` s on, at least the next; None: off."""
        if at is None:
            self._alarms[row] = -1
            return
        step = max(int(-((_ROUNDING - at) // self._dt)), self._step + 1)
        if self._alarms[row] != step:
            self._alarms[row] = step
            self._rows.setdefault(step, []).append(row)

    def due(self, step: int) -> list[int]:
        """The rows whose alarm is this step, in order; call it for every step."""
        self._step = step
        rows = [row for row in self._rows.pop(step, ()) if self._alarms[row] == step]
        for row in rows:
            self._alarms[row] = -1
        return sorted(rows)
