"""Sends a goal to robots: with its run, or alone; and what a key may not send."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from swarmd.core.errors import ConfigError
from swarmd.core.verbs import GoalRequest, RunRequest
from swarmd.link.keys.roster import Role

if TYPE_CHECKING:
    from swarmd.core.goal import Goal
    from swarmd.core.messages import Epoch
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.outcome import Outcome
    from swarmd.operator.session.session import Session


def send_goal(
    session: Session, epochs: Mapping[str, Epoch | None], goal: Goal, **fields: Any
) -> Outcome:
    """Send a goal to robots: as a run request, or as a goal request if it has no pattern.

    The request counts as issued when the verb of `session` began. A key with a permit sends the run
    without the goal: such a run is of the asked robots alone, and nothing spreads.
    """
    request = session.operator.request
    began = session.began
    if goal.pattern is None:
        return request(GoalRequest, epochs, issued=began, goal=goal, **fields)
    return request(
        RunRequest,
        epochs,
        issued=began,
        pattern=goal.pattern,
        params=goal.params,
        seconds=goal.seconds,
        until=goal.conditions,
        goal=None if has_permit(session.operator) else goal,
        **fields,
    )


def has_permit(operator: Operator) -> bool:
    """True if the key of this operator has a permit, which lets it set no goal."""
    return operator.identity is not None and operator.identity.role is Role.PERMIT


def check_sets_goals(operator: Operator, verb: str) -> None:
    """Raise ConfigError for a key that may set no goal. `verb`: what the user asked for."""
    if has_permit(operator):
        raise ConfigError(
            f"{verb} sets a goal, and a key with a permit ({operator.name}) sets none"
        )
