"""The goals of a look that count, and the goal that an operator sets next."""

from __future__ import annotations

import os
from functools import cache
from typing import TYPE_CHECKING, Any

import msgspec
from msgspec.structs import replace

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.goal import MAX_UNSIGNED, Goal, KnownGoal, encode_goal, signed_part
from swarmd.link.keys.content_signature import Purpose, sign
from swarmd.link.spread.goal_sync import is_signed_goal

if TYPE_CHECKING:
    from swarmd.link.keys.identity import Identity
    from swarmd.operator.session.members_view import MembersView, SeenMember
    from swarmd.operator.session.operator import Operator

MAX_GENERATION = 2**32 - 1
_MAX_ISSUER = 63


def next_goal(operator: Operator, view: MembersView, **fields: Any) -> Goal:
    """A goal with these `fields`, of a greater generation than all goals in `view`.

    Raises ConfigError if the goal is too long, or cannot be signed in a secured swarm.
    """
    goal = Goal(
        generation=next_generation(operator, view),
        issuer=operator.name[:_MAX_ISSUER],
        id=os.urandom(6).hex(),
        **fields,
    )
    return signed_again(operator, goal)


def next_generation(operator: Operator, view: MembersView) -> int:
    """The generation for a new goal: the greatest generation of the goals in `view`, plus 1.

    In a secured swarm a generation above MAX_UNSIGNED counts only if its goal is signed: a robot
    that was taken over may show any generation. A generation up to MAX_UNSIGNED always counts: up
    to there, robots also hold unsigned goals that only stop robots (`GoalCheck`). Raises
    ConfigError beyond MAX_GENERATION.
    """
    greatest = view.goal_generation
    if operator.identity is not None and greatest > MAX_UNSIGNED:
        members = signed_goals(view, operator.identity).members.values()
        statuses = [member.status for member in members if member.status is not None]
        goals = [status.goal.held for status in statuses if status.goal is not None]
        signed = (held.goal.generation for held in goals if held is not None)
        greatest = max((MAX_UNSIGNED, *signed))  # a tuple: there may be no signed goal
    if greatest >= MAX_GENERATION:
        raise ConfigError(
            f"a robot shows a goal of the last generation, {MAX_GENERATION}; no goal can follow"
            " it: revoke the operator who set it, or, without keys, remove `goal` from the state"
            " folders of the robots and restart them"
        )
    return greatest + 1


def signed_again(operator: Operator, goal: Goal, **changes: Any) -> Goal:
    """The goal with changes, signed again in a secured swarm. Raises ConfigError as `next_goal`.

    The goal keeps its id, so that `undo` takes both versions as one goal.
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
    from swarmd.link.keys.private_keys import load_private_key

    key = load_private_key(identity.key)
    return replace(goal, signature=sign(key, Purpose.GOAL, signed_part(goal)))


def signed_goals(view: MembersView, identity: Identity | None) -> MembersView:
    """`view` with None for each reported goal whose issuer's signature is false or missing.

    A robot reports its goals in its status: the goal that it holds, its own goal, and the goal
    before. A stolen robot may report false goals. An operator must not show such goals as goals of
    the swarm, and must never sign them. `identity` None: the swarm has no keys, and `view` is
    returned unchanged. Verifying a signature takes some 4 ms, so that each goal is verified once.
    """
    if identity is None:
        return view
    public_key_of = identity.roster.operators.get

    @cache
    def is_signed(encoded: bytes) -> bool:
        return is_signed_goal(msgspec.msgpack.decode(encoded, type=Goal), public_key_of)

    def signed_or_none(goal: Goal | None) -> Goal | None:
        return goal if goal is not None and is_signed(msgspec.msgpack.encode(goal)) else None

    def known_or_none(known: KnownGoal | None) -> KnownGoal | None:
        return known if known is not None and signed_or_none(known.goal) is not None else None

    def with_signed_goals(member: SeenMember) -> SeenMember:
        if member.status is None or member.status.goal is None:
            return member
        reported = member.status.goal
        signed = replace(
            reported,
            held=known_or_none(reported.held),
            own=known_or_none(reported.own),
            before=signed_or_none(reported.before),
        )
        return replace(member, status=replace(member.status, goal=signed))

    members = {name: with_signed_goals(member) for name, member in view.members.items()}
    return replace(view, members=members)
