"""What robots are to do beside what they do, and the reason of each difference. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from msgspec.structs import asdict

from swarmd.core.goal import Goal, GoalState, KnownGoal
from swarmd.core.messages import Presence, State, Status
from swarmd.core.record import LABEL
from swarmd.network.operator.members_view import Contact, MembersView, SeenMember
from swarmd.texts.values import NOTHING, number
from swarmd.texts.why import absence


@dataclass(frozen=True, slots=True)
class Difference:
    """A robot's goal beside what it does.

    `goal`: the greatest goal known that is for this robot; None without a goal. `actual`: its
    state and pattern. `reason`: why it does not do what the goal wants, empty if it does. `note`:
    what else is to be known of a robot that is as desired.
    """

    robot: str
    goal: Goal | None
    actual: str
    reason: str = ""
    note: str = ""

    @property
    def is_as_desired(self) -> bool:
        """True if the robot does what its goal wants, or has no goal."""
        return not self.reason

    @property
    def desired(self) -> str:
        """What the goal wants of it: a pattern, `stand`, or nothing."""
        return NOTHING if self.goal is None else self.goal.pattern or "stand"


def differences(view: MembersView, names: Iterable[str]) -> list[Difference]:
    """The line of each robot in `names`."""
    known = goals_of(view)
    undone = {one.goal.undoes for one in known.values()}
    wanted = {digest: one for digest, one in known.items() if one.goal.id not in undone}
    return [_difference(name, view.members.get(name), wanted, undone) for name in names]


def goals_of(view: MembersView) -> dict[str, KnownGoal]:
    """All goals that robots know, by digest, the greatest last."""
    found: dict[str, KnownGoal] = {}
    for member in view.members.values():
        goals = None if member.status is None else member.status.goal
        for one in () if goals is None else (goals.own, goals.held):
            if one is not None:
                found[one.digest] = _with_age(found.get(one.digest), one)
    return dict(sorted(found.items(), key=lambda item: (item[1].goal.order, item[0])))


def present_goals(view: MembersView) -> tuple[Goal | None, Goal | None]:
    """The greatest goal that a robot holds, and the goal that it replaced."""
    goals = [one.status.goal for one in view.members.values() if one.status is not None]
    held = [one for one in goals if one is not None and one.held is not None]
    if not held:
        return None, None
    latest = max(held, key=lambda one: (one.held.goal.order, one.held.digest) if one.held else ())
    assert latest.held is not None
    same = [one for one in held if one.held is not None and one.held.digest == latest.held.digest]
    before = [one.before for one in same if one.before is not None]
    return latest.held.goal, max(before, key=lambda one: one.order, default=None)


def content_of(goal: Goal) -> dict[str, Any]:
    """The fields of a goal that another one takes over."""
    own = ("generation", "issuer", "id", "undoes", "signature")
    return {name: value for name, value in asdict(goal).items() if name not in own}


def set_apart(view: MembersView, present: Goal, before: Goal) -> tuple[list[str], list[str]]:
    """The expected robots that an earlier goal is for, and those that only the present one runs on.

    By name alone where labels are not known.
    """
    labels = {
        name: one.status.labels for name, one in view.members.items() if one.status is not None
    }
    names = sorted(view.expected)
    first = [name for name in names if before.is_for(name, labels.get(name, ()))]
    if present.pattern is None:
        return first, []
    rest = [name for name in names if present.is_for(name, labels.get(name, ()))]
    return first, [name for name in rest if name not in first]


def goal_for(robot: str, labels: Iterable[str], known: Iterable[KnownGoal]) -> KnownGoal | None:
    """The last of `known` that targets a robot with these labels."""
    found = [one for one in known if one.goal.is_for(robot, tuple(labels))]
    return found[-1] if found else None


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
        f"label {one.removeprefix(LABEL)}" if one.startswith(LABEL) else one for one in goal.targets
    )
    return ", ".join(words) or "all robots"


def _difference(
    name: str, member: SeenMember | None, known: dict[str, KnownGoal], undone: set[str | None]
) -> Difference:
    status = None if member is None else member.status
    if member is None or status is None or member.contact is not Contact.ANSWERED:
        # Labels are not known: the goal of a robot that is gone may be one by name alone.
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
    """Why a robot does not do what the goal wants; empty if it does."""
    goals, goal = status.goal, wanted.goal
    if status.state is State.ESTOPPED:
        issuers = ", ".join(sorted({one.issuer for one in status.latches.values()}))
        return f"estopped by {issuers or 'an operator'}"
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


def _with_age(one: KnownGoal | None, other: KnownGoal) -> KnownGoal:
    """The one with the greater age: what robots hand on lacks the time on the way."""
    if one is None or one.age is None:
        return other
    return one if other.age is None or one.age >= other.age else other
