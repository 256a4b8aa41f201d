"""Compares a swarm file with the present state of robots, and makes a plan of changes. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from swarmd.core.goal import Goal, GoalState, GoalStatus
from swarmd.core.messages import State, Status
from swarmd.network.operator.members_view import Contact, MembersView
from swarmd.settings.swarmfile import SwarmFile
from swarmd.texts.goal import content_of, present_goals
from swarmd.texts.values import NOTHING, number
from swarmd.texts.why import absence

Params = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Plan:
    """The changes that bring robots to the content of a swarm file."""

    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # new labels, by robot
    goal: Mapping[str, Any] | None = None  # the content of a new goal
    targets: tuple[str, ...] = ()  # robots of the new goal
    resume: tuple[str, ...] = ()  # robots that are to run the goal that they were offered
    params: Mapping[str, Params] = field(default_factory=dict)  # new parameters, by running robot
    lines: tuple[tuple[str, str, str], ...] = ()  # each change in words, with its robots
    unknown: Mapping[str, str] = field(default_factory=dict)  # why a robot was not compared
    left: Mapping[str, str] = field(default_factory=dict)  # differences that the plan does not end

    @property
    def is_empty(self) -> bool:
        """True if nothing is to be changed."""
        return not (self.labels or self.goal or self.resume or self.params)

    @property
    def moves(self) -> bool:
        """True if the plan starts motion, or changes the motion of running robots."""
        starts = self.goal is not None and self.goal["pattern"] is not None
        return starts or bool(self.resume or self.params)


def plan_of(file: SwarmFile, view: MembersView) -> Plan:
    """The changes that bring the robots in `view` to the content of a file.

    A robot without a status is `unknown`. A file without labels leaves all labels as they are. The
    same holds for the goal and for parameters.
    """
    there = {
        name: member.status
        for name, member in view.members.items()
        if member.status is not None and member.contact is Contact.ANSWERED
    }
    expected = sorted(view.expected - there.keys())
    unknown = {name: absence(view.members.get(name)) for name in expected}
    for label, robots in file.members.items():
        for name in set(robots) - view.members.keys() - unknown.keys():
            unknown[name] = f"labels.{label} names it, and no such robot is known"
    labels = {name: labels_in(file, name) for name in there} if file.labels else {}
    changed = {
        name: wanted for name, wanted in labels.items() if set(wanted) != {*there[name].labels}
    }
    lines = [
        ("labels", name, f"{_words(there[name].labels)} -> {_words(wanted)}")
        for name, wanted in changed.items()
    ]
    present, _ = present_goals(view)
    goal: Mapping[str, Any] | None = None
    targets: tuple[str, ...] = ()
    resume: tuple[str, ...] = ()
    left: dict[str, str] = {}
    if file.goal is not None:
        after = {name: labels.get(name, status.labels) for name, status in there.items()}
        wanted_goal = Goal(generation=1, issuer="file", id="file", **file.goal.content)
        targets = tuple(n for n in sorted(after) if wanted_goal.is_for(n, after[n]))
        if is_like(present, file.goal.content):
            resume = tuple(name for name in targets if _is_offered(there[name]))
            left = {
                name: status.goal.reason
                for name, status in there.items()
                if name in targets and status.goal and _is_left(status.goal)
            }
            lines += [("resume", name, file.goal.pattern or "stand") for name in resume]
        else:
            goal = file.goal.content
            before = "no goal" if present is None else present.text
            lines.append(("goal", _words(targets), f"{before} -> {_goal_text(file.goal.content)}"))
    params = {
        name: changes
        for name, status in there.items()
        if (changes := _param_changes(file, name, status, labels, goal))
    }
    lines += [
        ("param", name, f"{key} {_value(there[name], key)} -> {number(value)}")
        for name, changes in params.items()
        for key, value in changes.items()
    ]
    return Plan(changed, goal, targets, resume, params, tuple(lines), unknown, left)


def labels_in(file: SwarmFile, robot: str) -> tuple[str, ...]:
    """The labels of a robot in a file, in its order."""
    return tuple(label for label, robots in file.members.items() if robot in robots)


def is_like(goal: Goal | None, content: Mapping[str, Any]) -> bool:
    """True if a goal has this content, and no run lease."""
    if goal is None or goal.lease is not None:
        return False
    known = content_of(goal)
    return all(known[key] == value for key, value in content.items())


def params_in(file: SwarmFile, robot: str, labels: tuple[str, ...], pattern: str) -> Params:
    """The parameters of a robot's pattern in a file.

    A robot's own parameters replace those of its labels.
    """
    params: dict[str, Any] = {}
    for label in labels:
        params |= file.parameters.labels.get(label, {}).get(pattern, {})
    return params | file.parameters.robots.get(robot, {}).get(pattern, {})


def _param_changes(
    file: SwarmFile,
    robot: str,
    status: Status,
    labels: Mapping[str, tuple[str, ...]],
    goal: Mapping[str, Any] | None,
) -> Params:
    """The parameters of a running pattern that differ from the file.

    Parameters of a goal take precedence over the file. None where a new goal lets the robot run
    another pattern: its parameters are compared after that.
    """
    pattern = status.pattern
    if status.state is not State.RUNNING or pattern is None or goal is not None:
        return {}
    wanted = dict(params_in(file, robot, labels.get(robot, status.labels), pattern))
    if file.goal is not None and file.goal.pattern == pattern:
        wanted |= file.goal.params
    known = {key: param.value for key, param in status.params.items()}
    return {key: value for key, value in wanted.items() if key in known and known[key] != value}


def _is_left(goal: GoalStatus) -> bool:
    """True if the run has ended. Of a run that goes on, parameters are compared separately."""
    return bool(goal.reason) and goal.state not in (GoalState.OFFERED, GoalState.RUNNING)


def _is_offered(status: Status) -> bool:
    return status.goal is not None and status.goal.state is GoalState.OFFERED


def _value(status: Status, key: str) -> str:
    return number(status.params[key].value)


def _words(names: tuple[str, ...]) -> str:
    return ", ".join(names) or NOTHING


def _goal_text(content: Mapping[str, Any]) -> str:
    params = (f"{key}={number(value)}" for key, value in content["params"].items())
    return " ".join((content["pattern"] or "stand", *params))
