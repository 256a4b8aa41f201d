"""Compares the goals of robots with their states, and gives the reason of each difference. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from msgspec.structs import asdict

from swarmd.core.goal import Goal, GoalState, KnownGoal
from swarmd.core.messages import Presence, State, Status
from swarmd.core.record import LABEL
from swarmd.operator.session.members_view import Contact, MembersView, SeenMember
from swarmd.operator.texts.values import NOTHING, number
from swarmd.operator.texts.why import absence, stops_text


@dataclass(frozen=True, slots=True)
class Difference:
    """The goal of a robot, and its actual state."""

    robot: str
    goal: Goal | None  # the greatest known goal that is for this robot
    actual: str  # the robot's state and pattern
    reason: str = ""  # why the robot does not do what the goal wants; empty if it does
    note: str = ""  # a remark on a robot that is as desired

    @property
    def is_as_desired(self) -> bool:
        """True if the robot does what its goal wants, or has no goal."""
        return not self.reason

    @property
    def desired(self) -> str:
        """What the goal wants of the robot: a pattern, `stand`, or nothing."""
        return NOTHING if self.goal is None else self.goal.pattern or "stand"


def differences(view: MembersView, names: Iterable[str]) -> list[Difference]:
    """The `Difference` of each robot in `names`."""
    known = goals_of(view)
    undone = {known_goal.goal.undoes for known_goal in known.values()}
    wanted = {
        digest: known_goal
        for digest, known_goal in known.items()
        if known_goal.goal.id not in undone
    }
    return [_difference(name, view.members.get(name), wanted, undone) for name in names]


def goals_of(view: MembersView) -> dict[str, KnownGoal]:
    """All goals that robots know, by digest; the greatest comes last."""
    by_digest: dict[str, KnownGoal] = {}
    for member in view.members.values():
        goals = None if member.status is None else member.status.goal
        for known in () if goals is None else (goals.own, goals.held):
            if known is not None:
                by_digest[known.digest] = _with_age(by_digest.get(known.digest), known)
    return dict(sorted(by_digest.items(), key=lambda item: (item[1].goal.order, item[0])))


def present_goals(view: MembersView) -> tuple[Goal | None, Goal | None]:
    """The greatest goal that a robot holds, and the goal that it replaced."""
    statuses = [member.status for member in view.members.values() if member.status is not None]
    held = [  # each with the goal that it replaced on that robot
        (status.goal.held, status.goal.before)
        for status in statuses
        if status.goal is not None and status.goal.held is not None
    ]
    if not held:
        return None, None
    latest, _ = max(held, key=lambda pair: (pair[0].goal.order, pair[0].digest))
    replaced = [before for known, before in held if known.digest == latest.digest and before]
    return latest.goal, max(replaced, key=lambda goal: goal.order, default=None)


def content_of(goal: Goal) -> dict[str, Any]:
    """The fields of a goal that a new goal takes over."""
    own = ("generation", "issuer", "id", "undoes", "signature")
    return {name: value for name, value in asdict(goal).items() if name not in own}


def set_apart(view: MembersView, present: Goal, before: Goal) -> tuple[list[str], list[str]]:
    """The robots that run, and the robots that stop, if goal `before` replaces goal `present`.

    The targets of `before` run. The robots that only `present` targets stop; none if `present` has
    no pattern, since its robots then stand already. Both lists have only the robots that must
    answer (`MembersView.expected`). A robot whose labels are not known is matched by its name
    alone.
    """
    labels = {
        name: member.status.labels
        for name, member in view.members.items()
        if member.status is not None
    }
    names = sorted(view.expected)
    of_before = [name for name in names if before.is_for(name, labels.get(name, ()))]
    if present.pattern is None:
        return of_before, []
    of_present = [name for name in names if present.is_for(name, labels.get(name, ()))]
    return of_before, [name for name in of_present if name not in of_before]


def goal_for(robot: str, labels: Iterable[str], known: Iterable[KnownGoal]) -> KnownGoal | None:
    """The last of `known` that targets a robot with these labels."""
    targeting = [known_goal for known_goal in known if known_goal.goal.is_for(robot, tuple(labels))]
    return targeting[-1] if targeting else None


def describe_goal(goal: Goal) -> str:
    """Such as `goal 7 of bob: flocking speed=0.1 on all robots for 60 s, on join: offer`."""
    words = [goal.text]
    words += [f"{key}={number(value)}" for key, value in goal.params.items()]
    words.append(f"on {targets_text(goal)}")
    if goal.seconds is not None:
        words.append(f"for {number(goal.seconds)} s")
    if goal.conditions:
        words.append(f"until {' or '.join(goal.conditions)}")
    if goal.lease is not None:
        words.append(f"with a run lease of {number(goal.lease)} s")
    if goal.on_join == "run" and goal.valid is not None:
        words.append(f"(robots that join within {number(goal.valid)} s run it)")
    return " ".join(words)


def targets_text(goal: Goal) -> str:
    """Such as `tb3-*, label red`."""
    words = (
        f"label {target.removeprefix(LABEL)}" if target.startswith(LABEL) else target
        for target in goal.targets
    )
    return ", ".join(words) or "all robots"


def _difference(
    name: str, member: SeenMember | None, known: dict[str, KnownGoal], undone: set[str | None]
) -> Difference:
    status = None if member is None else member.status
    if member is None or status is None or member.contact is not Contact.ANSWERED:
        # The labels of a robot that is gone are not known: only goals that name the robot count.
        wanted = goal_for(name, (), known.values())
        there = "absent" if member is None else _place(member)
        return Difference(name, None if wanted is None else wanted.goal, there, absence(member))
    wanted = goal_for(name, status.labels, known.values())
    actual = status.state.value if status.pattern is None else f"{status.state} {status.pattern}"
    own = None if status.goal is None or status.goal.own is None else status.goal.own.goal
    if own is not None and own.id in undone and (wanted is None or wanted.goal.order < own.order):
        runs = f"runs {status.pattern}: " if status.state is State.RUNNING else ""
        text = f"{runs}{own.text} was undone"
        return Difference(name, None, actual, text if runs else "", text)
    if wanted is None:
        latest = next(reversed(known.values()), None)
        note = f"no target of {latest.goal.text}" if latest else ""
        return Difference(name, None, actual, note=note)
    reason = _reason(status, wanted)
    if reason and status.goal is not None and status.goal.superseded:
        reason = f"{reason}; its run was superseded by {status.goal.superseded}"
    return Difference(name, wanted.goal, actual, reason)


def _reason(status: Status, wanted: KnownGoal) -> str:
    """Why a robot does not do what its goal wants; empty if it does."""
    goals = status.goal
    goal = wanted.goal
    if status.state is State.ESTOPPED:
        return f"estopped{stops_text(status.latches.values())}"
    if status.state is State.FAULTED:
        return f"faulted: {status.reason} {status.detail}".rstrip()
    if goals is None or goals.own is None or goals.own.digest != wanted.digest:
        if goal.pattern is None and status.state is not State.RUNNING:
            return ""
        return f"{goal.text} has not reached it yet"
    if goal.pattern is None:
        return f"runs {status.pattern}" if status.state is State.RUNNING else ""
    if goals.state is GoalState.RUNNING and status.state is State.RUNNING:
        return goals.reason
    reason = goals.reason or (goals.state.value if goals.state else f"{status.state}")
    if goals.state is GoalState.ENDED and not reason.startswith(status.state.value):
        return f"its run ended: {reason}; resume runs the goal again"
    return reason


def _place(member: SeenMember) -> str:
    if member.presence is not Presence.ALIVE:
        return member.presence.value
    return member.state or member.contact.value


def _with_age(first: KnownGoal | None, second: KnownGoal) -> KnownGoal:
    """The copy of a goal with the greater age: a relayed copy lacks time on the network."""
    if first is None or first.age is None:
        return second
    return first if second.age is None or first.age >= second.age else second
