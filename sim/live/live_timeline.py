"""Carries out the events of a scenario on a running fleet, as an operator would."""

from __future__ import annotations

from collections.abc import Sequence

from swarmd.core.errors import SwarmError
from swarmd.core.verbs import ParamRequest, ResetRequest, RunRequest
from swarmd.network.operator import Operator, StopVerb
from swarmd.network.outcome import Outcome
from swarmd.sim.live.fleet import Fleet
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.starting import await_robots, run_fields, why_not
from swarmd.sim.live.summary import DoneEvent
from swarmd.sim.scenarios.scenario import ScheduledEvent


class LiveTimeline:
    """Events in order of time, carried out when due or as soon as the earlier ones are done."""

    def __init__(
        self,
        events: Sequence[ScheduledEvent],
        fleet: Fleet,
        operator: Operator,
        world: WorldView,
    ) -> None:
        self._events = list(events)
        self._fleet, self._operator, self._world = fleet, operator, world
        self.done: list[DoneEvent] = []

    def apply(self, now: float) -> None:
        """Carry out the events that are due at `now` s of the recording."""
        while self._events and self._events[0].at <= now:
            event = self._events.pop(0)
            try:
                self._carry_out(event)
                problem = ""
            except SwarmError as error:
                problem = str(error)
            what = f"{event.action} {event.pattern or event.box}".rstrip()
            self.done.append(DoneEvent(event.at, now, what, event.robots, problem))

    def send_stop(self, verb: StopVerb, robots: Sequence[str]) -> Outcome:
        """Stop or estop robots; an estop of all is swarm-wide unless a daemon has been ended."""
        if set(robots) == set(self._fleet.spec.robots):
            return self._operator.send_stop(verb)
        return self._operator.send_stop(verb, select=lambda known: robots, names=robots)

    def _carry_out(self, event: ScheduledEvent) -> None:
        """SwarmError if a robot refuses it or does not answer."""
        present = set(self._fleet.robots)
        robots = tuple(robot for robot in event.robots if robot in present)
        match event.action:
            case "place" if event.pose is not None:
                self._world.place(event.box, event.pose)
            case "remove" if event.box:
                self._world.remove(event.box)
            case "join":
                for robot in event.robots:
                    if robot not in present:
                        self._fleet.start_daemon(robot)
                await_robots(self._operator, self._fleet)
            case "leave" | "kill" | "remove":
                for robot in robots:
                    self._fleet.end_daemon(robot, in_order=event.action == "leave")
                if event.action == "remove":
                    for robot in event.robots:
                        self._world.take_out(robot)
            case "stop" | "estop":
                _check(event.action, self.send_stop(event.action, robots))
            case _:
                self._request(event, robots)

    def _request(self, event: ScheduledEvent, robots: tuple[str, ...]) -> None:
        operator = self._operator
        view = operator.members()
        epochs = view.epochs(robots)
        if event.action == "run":
            outcome = operator.request(RunRequest, epochs, **run_fields(event))
        elif event.action == "param":
            outcome = operator.request(ParamRequest, epochs, params=dict(event.parameters))
        else:
            ids = tuple(sorted(view.latches(robots)))
            outcome = operator.request(ResetRequest, epochs, ids=ids)
        _check(event.action, outcome)


def _check(verb: str, outcome: Outcome) -> None:
    if outcome.exit_code:
        raise SwarmError(why_not(verb, outcome))
