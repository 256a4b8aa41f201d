"""The agents of an environment: robots of a scenario that request the actions of a learner.

When the daemon of a robot ends and starts again, the robot becomes a new agent, such as `tb3-01#2`,
since the robot's memory is empty and in PettingZoo a terminated agent does not return. A life is
the time of a robot as one agent.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.values import Array, Inputs, Twist
from swarmd.kit.behavior import Context
from swarmd.kit.observation import PolicySpec
from swarmd.kit.policy_pattern import ActionPattern, PolicyParams
from swarmd.sim.scenarios.scenario import Scenario, ScheduledEvent

PATTERN = "agent"
"""The pattern that robots of learners run, in place of that of the scenario."""


@dataclass(slots=True)
class Seat:
    """The exchange between an environment and the pattern of one robot."""

    action: Array
    """(actions,) that the pattern requests until the environment sets a new action."""
    pattern: ActionPattern | None = None
    inputs: Inputs | None = None
    """The newest inputs of the pattern; None before its first step."""

    def leave(self) -> None:
        """Forget the robot's pattern and inputs, and set the action to zero."""
        self.action = np.zeros_like(self.action)
        self.pattern = None
        self.inputs = None


def agent_class(spec: PolicySpec, seats: dict[str, Seat]) -> type[ActionPattern]:
    """The pattern whose requests are the actions in `seats`, by robot."""

    class Agent(ActionPattern):
        """Requests the action of its seat."""

        def __init__(self, params: PolicyParams, context: Context) -> None:
            super().__init__(params, context, spec)
            self._seat = seats[context.robot]
            self._seat.pattern = self

        def drive(self, inputs: Inputs) -> Twist:
            """The twist of the seat's action."""
            self._seat.inputs = inputs
            return self.requested(self._seat.action)

    return Agent


def learners_of(scenario: Scenario, group: str | None) -> tuple[str, ...]:
    """The robots that learn: those of a group, or all; ConfigError for an unknown group."""
    if group is None:
        return tuple(scenario.robots)
    if group not in scenario.groups:
        raise ConfigError(f"agents: {unknown('group', group, scenario.groups)}")
    return tuple(sorted(scenario.groups[group]))


def with_agents(scenario: Scenario, learners: Collection[str]) -> Scenario:
    """The scenario in which learners run PATTERN whenever the scenario starts a pattern on them.

    Parameters and end conditions of the replaced patterns do not apply to learners. ConfigError for
    a learner that never runs a pattern.
    """
    events = tuple(part for event in scenario.events for part in _split(event, learners))
    running = {robot for event in events if event.action == "run" for robot in event.robots}
    for robot in sorted(set(learners) - running):
        raise ConfigError(f"scenario {scenario.name}: {robot} runs no pattern; give it one")
    return replace(scenario, events=events)


def lives_of(scenario: Scenario, learners: Iterable[str]) -> list[str]:
    """All agents in the order of robots and lives: `a`, `a#2`, `b`, ..."""
    counts = {robot: int(robot not in scenario.absent) for robot in learners}
    is_there = {robot: bool(count) for robot, count in counts.items()}
    for event in scenario.events:
        for robot in counts.keys() & set(event.robots):
            if event.action == "join" and not is_there[robot]:
                counts[robot] += 1
            if event.action in ("join", "leave", "kill", "remove"):
                is_there[robot] = event.action == "join"
    return [name_of(robot, life) for robot, n in counts.items() for life in range(1, n + 1)]


def name_of(robot: str, life: int) -> str:
    """The agent of a robot's life, from 1 on."""
    return robot if life == 1 else f"{robot}#{life}"


def _split(event: ScheduledEvent, learners: Collection[str]) -> Iterable[ScheduledEvent]:
    """The event for robots that do not learn, then a run of PATTERN for learners.

    Learners get no event `param`: the actions take the place of parameters.
    """
    mine = tuple(robot for robot in event.robots if robot in learners)
    if event.action not in ("run", "param") or not mine:
        yield event
        return
    others = tuple(robot for robot in event.robots if robot not in learners)
    if others:
        yield replace(event, robots=others)
    if event.action == "run":
        yield replace(event, robots=mine, pattern=PATTERN, parameters={}, until=())
