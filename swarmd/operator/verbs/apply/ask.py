"""Compares a swarm file with the present state of robots, and makes a plan of changes. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from swarmd.core.goal import Goal, GoalState, GoalStatus
from swarmd.core.messages import State, Status
from swarmd.operator.session.members_view import Contact, MembersView
from swarmd.operator.texts.values import NOTHING, number
from swarmd.operator.texts.why import absence
from swarmd.operator.verbs.goal.words import content_of, present_goals
from swarmd.settings.swarmfile import SwarmFile

Params = Mapping[str, Any]
Line = tuple[str, str, str]
"""A change in words: the kind, the robots, and the old and new value."""


@dataclass(frozen=True, slots=True)
class Plan:
    """The changes that bring robots to the content of a swarm file."""

    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # new labels, by robot
    goal: Mapping[str, Any] | None = None  # the content of a new goal
    targets: tuple[str, ...] = ()  # robots of the new goal
    resume: tuple[str, ...] = ()  # robots that are to run the goal that they were offered
    params: Mapping[str, Params] = field(default_factory=dict)  # new parameters, by running robot
    lines: tuple[Line, ...] = ()
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
    """The changes that bring the robots in `view` to the content of a swarm file.

    A robot that did not answer gets no changes, and is in `Plan.unknown`. What the file does not
    have (labels, a goal, parameters) stays as it is.
    """
    statuses = {
        name: member.status
        for name, member in view.members.items()
        # A robot that does not answer now may still have the status of an earlier look.
        if member.status is not None and member.contact is Contact.ANSWERED
    }

    file_labels = {name: labels_in(file, name) for name in statuses} if file.labels else {}
    new_labels = {
        name: wanted
        for name, wanted in file_labels.items()
        if set(wanted) != {*statuses[name].labels}
    }
    goal_plan = _goal_plan(file, view, statuses, file_labels)
    new_params: dict[str, Params] = {}
    for name, status in statuses.items():
        changes = _param_changes(file, name, status, file_labels, goal_plan.goal)
        if changes:
            new_params[name] = changes
    return replace(
        goal_plan,
        labels=new_labels,
        params=new_params,
        lines=(
            *_label_lines(statuses, new_labels),
            *goal_plan.lines,
            *_param_lines(statuses, new_params),
        ),
        unknown=_unknown_robots(file, view, statuses),
    )


def _label_lines(
    statuses: Mapping[str, Status], new_labels: Mapping[str, tuple[str, ...]]
) -> Iterator[Line]:
    for name, wanted in new_labels.items():
        yield "labels", name, f"{_words(statuses[name].labels)} -> {_words(wanted)}"


def _param_lines(
    statuses: Mapping[str, Status], new_params: Mapping[str, Params]
) -> Iterator[Line]:
    for name, params in new_params.items():
        for key, value in params.items():
            yield "param", name, f"{key} {_value(statuses[name], key)} -> {number(value)}"


def _goal_plan(
    file: SwarmFile,
    view: MembersView,
    statuses: Mapping[str, Status],
    labels: Mapping[str, tuple[str, ...]],
) -> Plan:
    """A plan with only the change from the present goal of the swarm to the goal in the file.

    `labels`: the labels of the file by robot, empty if the file names none.

    1. If the present goal differs from the goal in the file, the goal in the file is a new goal.
    2. If both goals are equal, robots to which the goal is offered resume the goal. A robot that
       joined later is offered the goal, and waits for an operator's request to run the goal.
    3. A run of this goal that has ended is not started again. `Plan.left` has, by robot, the reason
       of the end.
    """
    if file.goal is None:
        return Plan()
    content = file.goal.content
    robot_labels = {name: labels.get(name, status.labels) for name, status in statuses.items()}
    targets = _targets_of(content, robot_labels)
    present, _replaced = present_goals(view)
    if not is_like(present, content):
        before = "no goal" if present is None else present.text
        line = ("goal", _words(targets), f"{before} -> {_goal_text(content)}")
        return Plan(goal=content, targets=targets, lines=(line,))
    resume = tuple(name for name in targets if _is_offered(statuses[name]))
    left = {
        name: status.goal.reason
        for name, status in statuses.items()
        if name in targets and status.goal and _has_ended(status.goal)
    }
    lines = tuple(("resume", name, file.goal.pattern or "stand") for name in resume)
    return Plan(targets=targets, resume=resume, left=left, lines=lines)


def _targets_of(
    content: Mapping[str, Any], robot_labels: Mapping[str, tuple[str, ...]]
) -> tuple[str, ...]:
    """The robots, of those in `robot_labels`, that a goal with this content is for."""
    # This goal serves only `is_for`, and is never sent.
    goal = Goal(generation=1, issuer="file", id="file", **content)
    return tuple(name for name in sorted(robot_labels) if goal.is_for(name, robot_labels[name]))


def _unknown_robots(
    file: SwarmFile, view: MembersView, statuses: Mapping[str, Status]
) -> dict[str, str]:
    """The reason for each robot that cannot be compared: expected or named, without a status."""
    expected = sorted(view.expected - statuses.keys())
    unknown = {name: absence(view.members.get(name)) for name in expected}
    for label, robots in file.members.items():
        for name in set(robots) - view.members.keys() - unknown.keys():
            unknown[name] = f"labels.{label} names it, and no such robot is known"
    return unknown


def labels_in(file: SwarmFile, robot: str) -> tuple[str, ...]:
    """The labels that a file gives a robot, in the order of the file."""
    return tuple(label for label, robots in file.members.items() if robot in robots)


def is_like(goal: Goal | None, content: Mapping[str, Any]) -> bool:
    """True if a goal has this content, and no run lease."""
    if goal is None or goal.lease is not None:
        return False
    known = content_of(goal)
    return all(known[key] == value for key, value in content.items())


def params_in(file: SwarmFile, robot: str, labels: tuple[str, ...], pattern: str) -> Params:
    """The parameters of a robot's pattern in a file.

    Parameters for the robot replace parameters for its labels.
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
    """The changes of parameters that bring a robot's running pattern to the values in the file.

    The file may give a parameter under its goal, a robot and a label; the value under the goal
    counts most. `labels`: the labels in the file by robot. `goal`: the new goal of the plan, if
    any. Empty with a new goal, since the new run begins with the parameters of that goal. Empty
    also if the robot does not run.
    """
    pattern = status.pattern
    if status.state is not State.RUNNING or pattern is None or goal is not None:
        return {}
    wanted = dict(params_in(file, robot, labels.get(robot, status.labels), pattern))
    if file.goal is not None and file.goal.pattern == pattern:
        wanted |= file.goal.params
    present = {key: param.value for key, param in status.params.items()}
    return {key: value for key, value in wanted.items() if key in present and present[key] != value}


def _has_ended(goal: GoalStatus) -> bool:
    """True if the robot's run of the goal has ended, and the robot may not resume it."""
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
