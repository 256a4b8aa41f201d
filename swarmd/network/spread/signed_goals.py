"""The goals of a look that count: in a secured swarm those that their issuers signed. Pure.

A robot tells its goals in its status. A stolen robot may tell false goals, which an
operator must not show as those of the swarm, and never sign anew.
"""

from __future__ import annotations

from functools import cache

import msgspec
from msgspec.structs import replace

from swarmd.core.goal import Goal, GoalStatus, KnownGoal
from swarmd.network.operator.members_view import MembersView
from swarmd.network.spread.goal_sync import is_signed_goal
from swarmd.security.identity import Identity


def signed_goals(view: MembersView, identity: Identity | None) -> MembersView:
    """The look without goals that do not count; each signature takes some 4 ms."""
    if identity is None:
        return view
    key_of = identity.roster.operators.get

    @cache
    def counts(content: bytes) -> bool:
        return is_signed_goal(msgspec.msgpack.decode(content, type=Goal), key_of)

    def goal(one: Goal | None) -> Goal | None:
        return one if one is not None and counts(msgspec.msgpack.encode(one)) else None

    def known(one: KnownGoal | None) -> KnownGoal | None:
        return one if one is not None and goal(one.goal) is not None else None

    def checked(goals: GoalStatus) -> GoalStatus:
        held, own, before = known(goals.held), known(goals.own), goal(goals.before)
        return replace(goals, held=held, own=own, before=before)

    members = {
        name: one
        if one.status is None or one.status.goal is None
        else replace(one, status=replace(one.status, goal=checked(one.status.goal)))
        for name, one in view.members.items()
    }
    return replace(view, members=members)
