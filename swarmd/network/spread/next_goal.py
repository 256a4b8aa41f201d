"""The goal that an operator sets next: greater than every goal seen, and signed in its name."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.goal import MAX_UNSIGNED, Goal, encode_goal, signed_part
from swarmd.network.spread.signed_goals import signed_goals
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
