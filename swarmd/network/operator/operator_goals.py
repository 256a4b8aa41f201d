"""The goals of a look that count, and the goal that an operator sets next."""

from __future__ import annotations

import os
from functools import cache
from typing import TYPE_CHECKING, Any

import msgspec
from msgspec.structs import replace

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.goal import MAX_UNSIGNED, Goal, GoalStatus, KnownGoal, encode_goal, signed_part
from swarmd.network.spread.goal_sync import is_signed_goal
from swarmd.security.content_signature import Purpose, sign

if TYPE_CHECKING:
    from swarmd.network.operator.members_view import MembersView
    from swarmd.network.operator.operator import Operator
    from swarmd.security.identity import Identity

MAX_GENERATION = 2**32 - 1
_MAX_ISSUER = 63


def next_goal(operator: Operator, view: MembersView, **fields: Any) -> Goal:
    """A goal with these `fields` that is greater than all in `view`.

    ConfigError if it is too long, or if keys are in force and it cannot be signed.
    """
    goal = Goal(
        generation=next_generation(operator, view),
        issuer=operator.name[:_MAX_ISSUER],
        id=os.urandom(6).hex(),
        **fields,
    )
    return resigned(operator, goal)


def next_generation(operator: Operator, view: MembersView) -> int:
    """One above all goals in `view`. ConfigError after the last one.

    In a secured swarm generations above MAX_UNSIGNED count only in goals that are signed: a robot
    that was taken over may show any.
    """
    greatest = view.goal_generation
    if operator.identity is not None and greatest > MAX_UNSIGNED:
        statuses = [one.status for one in signed_goals(view, operator.identity).members.values()]
        goals = [one.goal.held for one in statuses if one is not None and one.goal is not None]
        signed = (held.goal.generation for held in goals if held is not None)
        greatest = max(MAX_UNSIGNED, *signed)
    if greatest >= MAX_GENERATION:
        raise ConfigError(
            f"a robot shows a goal of the last generation, {MAX_GENERATION}; no goal can follow"
            " it: revoke the operator who set it, or, without keys, remove `goal` from the state"
            " folders of the robots and restart them"
        )
    return greatest + 1


def resigned(operator: Operator, goal: Goal, **changes: Any) -> Goal:
    """The goal with changes, signed anew where keys are in force. ConfigError as `next_goal`.

    It keeps its id: to `undo` it is one goal.
    """
    goal = replace(goal, **changes)
    goal = goal if operator.identity is None else sign_goal(goal, operator.identity)
    try:
        encode_goal(goal)
    except CodecError as error:
        raise ConfigError(str(error)) from error
    return goal


def sign_goal(goal: Goal, identity: Identity) -> Goal:
    """The goal with the signature of an operator."""
    from swarmd.security.private_keys import load_private_key

    key = load_private_key(identity.key)
    return replace(goal, signature=sign(key, Purpose.GOAL, signed_part(goal)))


def signed_goals(view: MembersView, identity: Identity | None) -> MembersView:
    """The look without goals that do not count: in a secured swarm those without a signature.

    A robot tells its goals in its status. A stolen robot may tell false goals, which an operator
    must not show as those of the swarm, and never sign anew. Each signature takes some 4 ms. Pure.
    """
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
