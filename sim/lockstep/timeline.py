"""Carries out the events of a scenario in lockstep."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress
from typing import TYPE_CHECKING, Any

from swarmd.core.errors import SwarmError
from swarmd.core.messages import Code
from swarmd.core.verbs import (
    EstopRequest,
    ParamRequest,
    Request,
    ResetRequest,
    RunRequest,
    StopRequest,
)
from swarmd.sim.lockstep.shell import RobotShell
from swarmd.sim.scenarios.scenario import ScheduledEvent

if TYPE_CHECKING:
    from swarmd.sim.lockstep.lockstep import Lockstep

OPERATOR = "scenario"
_ROUNDING = 1e-9


class Timeline:
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
        rows = [self._rows[robot] for robot in event.robots]
        if event.action == "join":
            swarm.start([row for row in rows if not swarm.has_daemon[row]])
            return
        for row in rows:
            shell = swarm.shells[row]
            if event.action in ("leave", "kill", "remove"):
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

    def _request(self, event: ScheduledEvent, shell: RobotShell, now: float) -> Request:
        robot = shell.robot
        common: dict[str, Any] = {
            "id": f"event-{self._next}",
            "operator": OPERATOR,
            "targets": {robot.id: robot.epoch},
        }
        if event.action == "run":
            return RunRequest(
                **common,
                pattern=event.pattern,
                params=dict(event.parameters),
                seconds=event.seconds,
                until=tuple(event.until),
            )
        if event.action == "param":
            return ParamRequest(**common, params=dict(event.parameters))
        if event.action == "reset":
            return ResetRequest(**common, ids=tuple(robot.status(now).latches))
        if event.action == "estop":
            swarm = self._swarm
            others = {*compress(swarm.world.ids, swarm.has_daemon)} - {*event.robots}
            return EstopRequest(**common, scope="robots" if others else "swarm")
        return StopRequest(**common)
