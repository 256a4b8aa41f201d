"""Whom a request is for, and what happens if nobody is there."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import click

from swarmd.cli.arguments import NoTarget, Targets
from swarmd.core.errors import unknown
from swarmd.network.outcome import UNREACHABLE, Expected, Outcome, expected_to_run

if TYPE_CHECKING:
    from swarmd.core.messages import AnyRequest
    from swarmd.network.discovery import MembersView
    from swarmd.network.operator import Operator

PATIENCE = 5.0
HALTING = 3.0
NOBODY = "those that are meant have left, or are excluded"


class Unreachable(click.ClickException):
    """No daemon of the swarm can be reached; exit code 6."""

    exit_code = UNREACHABLE


def known_members(operator: Operator) -> MembersView:
    """Who is there; Unreachable, naming the swarms that can be seen, if nobody is."""
    view = operator.members()
    if not view.members:
        raise nobody(operator)
    return view


def nobody(operator: Operator) -> Unreachable:
    """The error for a swarm of which no daemon can be reached."""
    settings = operator.settings
    others = [name for name in operator.swarms() if name != settings.swarm]
    text = f"no daemon of swarm {settings.swarm!r} can be reached"
    if others:
        return Unreachable(f"{text}; there are the swarms: {', '.join(others)} (see --swarm)")
    where = "on this machine" if settings.profile == "dev" else f"by {settings.interface}"
    return Unreachable(f"{text}, nor any other swarm {where}; start swarmd, or see --profile")


def expected_of(view: MembersView, targets: Targets) -> Expected:
    """Whom a request to `targets` is for; NoTarget if that is nobody."""
    selected = targets.select(view.members.keys() | view.roster)
    expected = expected_to_run(view.members, view.roster, selected)
    if not expected.asked and not expected.absent:
        reasons = "; ".join(expected.warnings) or NOBODY
        raise NoTarget(f"no robot is there to be asked: {reasons}")
    return expected


def send(
    operator: Operator,
    view: MembersView,
    kind: type[AnyRequest],
    expected: Expected,
    timeout: float | None,
    **fields: Any,
) -> Outcome:
    """Send a request to the expected robots with the epochs of `view`."""
    return operator.request(
        kind,
        view.epochs(expected.asked),
        **fields,
        timeout=timeout or PATIENCE,
        absent=expected.absent,
        warnings=expected.warnings,
    )


def send_stop(
    operator: Operator,
    verb: Literal["stop", "estop"],
    targets: Targets,
    timeout: float | None,
    reason: str = "",
) -> Outcome:
    """Stop whom the targets name, at once; names that nobody knows of count as not answering.

    Unreachable if nobody was met, NoTarget if nobody was meant.
    """
    select = None if targets.is_everyone else targets.matching
    outcome = operator.halt(verb, select=select, reason=reason, timeout=timeout or HALTING)
    if outcome.targeted and set(targets.unseen) <= {*outcome.replies, *outcome.missing}:
        return outcome
    view = known_members(operator)
    if not outcome.targeted:
        targets.select(view.members.keys() | view.roster)
        raise NoTarget(f"no robot is there to be stopped: {NOBODY}")
    unseen = set(targets.unseen) - view.members.keys()
    warnings = (f"{unknown('robot', name, view.members)}" for name in sorted(unseen))
    return replace(
        outcome,
        missing=tuple(sorted({*outcome.missing, *unseen})),
        warnings=(*outcome.warnings, *warnings),
    )
