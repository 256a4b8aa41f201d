"""Periodic jobs, alarms, and the events of a scenario, in lockstep."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import compress
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core import verbs
from swarmd.core.errors import SwarmError
from swarmd.core.messages import Code
from swarmd.core.values import Array
from swarmd.sim.lockstep.shell import RobotShell
from swarmd.sim.scenarios.scenario import ScheduledEvent

if TYPE_CHECKING:
    from swarmd.sim.lockstep.lockstep import Lockstep

_ROUNDING = 1e-9
_AHEAD = 1.0  # s; the times of this span are listed at once
_UNSURE = 1e-3  # s at the end of a list, whose times may be missing by rounding
OPERATOR = "scenario"


class Schedules:
    """A periodic job for each of n robots, with a rate and a phase of its own."""

    def __init__(self, rates: Array, begins: Array | None = None) -> None:
        """`rates` (n,) in Hz. `begins` (n,) in s: a time at which each job is due; None: 0.

        Two schedules with equal begins have common times. So a tick and a scan of a robot fall on
        one step where the rates allow this, and the robot's data are still in the processor's
        caches.
        """
        self._period = 1.0 / np.asarray(rates, dtype=np.float64)
        starts = np.zeros(len(self._period)) if begins is None else begins
        self._phase = np.mod(starts, self._period)
        # The due times before `_end` in order, with their rows.
        self._times: list[float] = []
        self._rows: list[int] = []
        # `_next`: the index of the next due time
        self._next = 0
        self._end = -math.inf
        self._soonest = -math.inf  # before this time `due` has nothing to do
        self._listed = np.zeros(len(self._period), dtype=np.intp)  # number of times listed, by row

    def due(self, now: float) -> list[int]:
        """The rows due by `now` s, in order; call it at every step."""
        until = now + _ROUNDING
        if until < self._soonest:
            return []
        if until >= self._end:
            self._list(now + _AHEAD)
        times = self._times
        first = self._next
        self._next = last = bisect_right(times, until, first)
        self._soonest = min(times[last], self._end) if last < len(times) else self._end
        return sorted(self._rows[first:last])

    def _list(self, end: float) -> None:
        """List the due times before `end` s, many at once, since each call of numpy takes long."""
        # Row r is due at the ticks `_listed[r]` to `upto[r]` - 1, counted from its phase.
        upto = np.ceil((end - self._phase) / self._period).astype(np.intp)
        counts = np.maximum(upto - self._listed, 0)
        rows = np.repeat(np.arange(len(counts)), counts)
        before = np.cumsum(counts) - counts
        ticks = np.arange(len(rows)) + np.repeat(self._listed - before, counts)
        times = self._phase[rows] + ticks * self._period[rows]
        times = np.concatenate((self._times[self._next :], times))
        rows = np.concatenate((np.array(self._rows[self._next :], dtype=np.intp), rows))
        order = np.argsort(times, kind="stable")
        self._times = times[order].tolist()
        self._rows = rows[order].tolist()
        # Rounding may leave out a time at the very end. `_end` is earlier, so that the next list
        # adds this time before it is due.
        self._next = 0
        self._end = end - _UNSURE
        self._listed += counts


class Alarms:
    """At most one alarm for each robot, rounded up to the steps of a world."""

    def __init__(self, n: int, dt: float) -> None:
        self._dt = dt
        self._step = 0
        self._due = [-1] * n  # the step of each alarm; a past step is no alarm
        # The rows by step; an alarm that was moved is left in the set of its former step.
        self._rows: dict[int, set[int]] = {}

    def set(self, row: int, at: float | None) -> None:
        """Set the alarm of `row` to the first step at or after `at` s; None: no alarm.

        The alarm is at the next step at the earliest.
        """
        if at is None:
            self._due[row] = -1
            return
        step = int(-((_ROUNDING - at) // self._dt))  # ceil((at - _ROUNDING) / dt)
        step = max(step, self._step + 1)
        if step != self._due[row]:
            self._due[row] = step
            self._rows.setdefault(step, set()).add(row)

    def due(self, step: int) -> list[int]:
        """The rows whose alarm is this step, in order; call it for every step."""
        self._step = step
        return sorted(row for row in self._rows.pop(step, ()) if self._due[row] == step)


class EventTimeline:
    """Events in order of time, carried out when due."""

    def __init__(self, events: Sequence[ScheduledEvent], swarm: Lockstep) -> None:
        self._events = events
        self._swarm = swarm
        self._rows = {robot: row for row, robot in enumerate(swarm.world.ids)}
        self._next = 0

    def apply(self, now: float) -> None:
        """Carry out the events due by `now` s. Raises SwarmError if a robot refuses one."""
        first = self._next
        while self._next < len(self._events) and self._events[self._next].at <= now + _ROUNDING:
            self._next += 1
            self._carry_out(self._events[self._next - 1], now)
        if self._next > first:
            self._swarm.exchange()

    def _carry_out(self, event: ScheduledEvent, now: float) -> None:
        swarm = self._swarm
        if event.pose is not None:
            swarm.world.place(event.box, event.pose)
        elif event.box:
            swarm.world.remove(event.box)
        if event.fields:
            swarm.world.change_fields(event.fields)
        rows = [self._rows[robot] for robot in event.robots]
        if event.fault is not None and event.action in ("fault", "mend"):
            swarm.change_fault(event.fault, rows, is_on=event.action == "fault")
            return
        if event.action == "join":
            swarm.start([row for row in rows if not swarm.has_daemon[row]])
            return
        for row in rows:
            shell = swarm.shells[row]
            if event.action in ("leave", "kill", "remove"):
                # A halted daemon that is ended does not continue with the end of its fault.
                swarm.resume(row)
                if swarm.has_daemon[row]:
                    swarm.end(row, in_order=event.action == "leave")
            elif shell is not None:
                self._send_request(event, shell, now)
            if event.action == "remove":
                swarm.world.take_out(row)

    def _send_request(self, event: ScheduledEvent, shell: RobotShell, now: float) -> None:
        reply = shell.request(self._request(event, shell, now), now)
        if reply is None or reply.code is not Code.APPLIED:
            answer = "gave no answer" if reply is None else reply.text
            what = f"{event.action} {event.pattern}".rstrip()
            raise SwarmError(f"at {event.at:g} s {what}: {shell.robot.id}: {answer}")

    def _request(self, event: ScheduledEvent, shell: RobotShell, now: float) -> verbs.Request:
        robot = shell.robot
        common: dict[str, Any] = {
            "id": f"event-{self._next}",
            "operator": OPERATOR,
            "targets": {robot.id: robot.epoch},
        }
        if event.action == "run":
            return verbs.RunRequest(
                **common,
                pattern=event.pattern,
                params=dict(event.parameters),
                seconds=event.seconds,
                until=tuple(event.until),
            )
        if event.action == "param":
            return verbs.ParamRequest(**common, params=dict(event.parameters))
        if event.action == "reset":
            return verbs.ResetRequest(**common, ids=tuple(robot.status(now).latches))
        if event.action == "estop":
            # Of the whole swarm, if no other robot has a daemon.
            swarm = self._swarm
            others = {*compress(swarm.world.ids, swarm.has_daemon)} - {*event.robots}
            return verbs.EstopRequest(**common, scope="robots" if others else "swarm")
        return verbs.StopRequest(**common)
