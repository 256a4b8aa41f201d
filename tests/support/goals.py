"""Goals, and members that hold them."""

from __future__ import annotations

from typing import Any

from swarmd.core.goal import Goal, GoalState, GoalStatus, KnownGoal, digest_of
from swarmd.operator.session.members_view import MembersView, SeenMember
from tests.support.statuses import make_member


def make_goal(generation: int = 1, pattern: str | None = "drive", **fields: Any) -> Goal:
    """A goal of anna."""
    fields = {"issuer": "anna", "id": f"g{generation}", **fields}
    return Goal(generation=generation, pattern=pattern, **fields)


def known(goal: Goal, age: float | None = 1.0) -> KnownGoal:
    """A goal as a robot knows it."""
    return KnownGoal(goal=goal, digest=digest_of(goal).hex(), age=age)


def goal_status(
    held: Goal,
    own: Goal | None = None,
    state: GoalState | None = GoalState.RUNNING,
    before: Goal | None = None,
    **changes: Any,
) -> GoalStatus:
    """A robot that holds a goal, which by default is its own one."""
    own = held if own is None else own
    return GoalStatus(held=known(held), own=known(own), state=state, before=before, **changes)


def member_with(robot: str, goal: GoalStatus | None, **changes: Any) -> SeenMember:
    """A running robot with goals."""
    return make_member(robot, goal=goal, **changes)


def view_of(*members: SeenMember, roster: tuple[str, ...] = ()) -> MembersView:
    """A look at these robots; those with a status have answered."""
    answered = frozenset(one.robot for one in members if one.status is not None)
    by_name = {one.robot: one for one in members}
    return MembersView(by_name, answered=answered, roster=frozenset(roster))
