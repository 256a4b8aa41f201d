"""Carries out the events of a scenario in lockstep."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Protocol

from swarmd.core.errors import SwarmError
from swarmd.core.messages import (
    Code,
    EstopRequest,
    ParamRequest,
    Request,
    ResetRequest,
    RunRequest,
    StopRequest,
)
from swarmd.sim.lockstep.shell import RobotShell
from swarmd.sim.scenarios.scenario import ScheduledEvent
from swarmd.sim.world.world import World

OPERATOR = "scenario"
_ROUNDING = 1e-9


class Swarm(Protocol):
    """The swarm that events act on. `shells`: by row, None without a daemon."""

    world: World
    shells: list[RobotShell | None]

    def start(self, row: int) -> None:
        """Start a daemon on robot `row`."""

    def end(self, row: int, *, in_order: bool) -> None:
        """End the daemon of robot `row`, in order or by a kill."""


class Timeline:
    """Events in order of time, carried out when due."""

    def __init__(self, events: Sequence[ScheduledEvent], swarm: Swarm) -> None:
        self._events = events
        self._swarm = swarm
        self._rows = {robot: row for row, robot in enumerate(swarm.world.ids)}
        self._next = 0

    def apply(self, now: float) -> None:
        """Carry out the events due by `now` s. Raises SwarmError if a robot refuses one."""
        while self._next < len(self._events) and self._events[self._next].at <= now + _ROUNDING:
            event = self._events[self._next]
            self._next += 1
            self._carry_out(event, now)

    def _carry_out(self, event: ScheduledEvent, now: float) -> None:
        swarm = self._swarm
        if event.action == "place":
            assert event.pose is not None
            swarm.world.place(event.box, event.pose)
        elif event.action == "remove" and event.box:
            swarm.world.remove(event.box)
        elif event.action == "remove":
            for row in self._rows_of(event):
                if swarm.shells[row] is not None:
                    swarm.end(row, in_order=False)
                swarm.world.take_out(row)
        elif event.action == "join":
            for row in self._rows_of(event):
                if swarm.shells[row] is None:
                    swarm.start(row)
        elif event.action in ("leave", "kill"):
            for row in self._rows_of(event):
                if swarm.shells[row] is not None:
                    swarm.end(row, in_order=event.action == "leave")
        else:
            self._request_all(event, now)

    def _rows_of(self, event: ScheduledEvent) -> list[int]:
        return [self._rows[robot] for robot in event.robots]

    def _request_all(self, event: ScheduledEvent, now: float) -> None:
        """Send the event's request to each of its robots with a daemon."""
        for row in self._rows_of(event):
            shell = self._swarm.shells[row]
            if shell is None:
                continue
            reply = shell.request(self._request(event, shell, now), now)
            if reply is None or reply.code is not Code.APPLIED:
                answer = "gave no answer" if reply is None else reply.text
                what = f"{event.action} {event.pattern}".rstrip()
                raise SwarmError(f"at {event.at:g} s {what}: {shell.robot.id}: {answer}")

    def _is_for_all(self, event: ScheduledEvent) -> bool:
        chosen = frozenset(event.robots)
        return all(one is None or one.robot.id in chosen for one in self._swarm.shells)

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
            scope: Literal["swarm", "robots"] = "swarm" if self._is_for_all(event) else "robots"
            return EstopRequest(**common, scope=scope)
        return StopRequest(**common)
