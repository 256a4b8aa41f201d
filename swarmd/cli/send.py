"""Requests to robots: the swarm as seen, the robots that must answer, the outcome."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import click

from swarmd.cli.arguments import NoTarget, Targets
from swarmd.core.errors import unknown
from swarmd.network.outcome import UNREACHABLE, Expected, Outcome, expected_to_run

if TYPE_CHECKING:
    from swarmd.cli.options import CommonOptions
    from swarmd.core.messages import AnyRequest
    from swarmd.network.discovery import MembersView
    from swarmd.network.operator import Operator

REQUEST_TIMEOUT = 5.0  # s
STOP_TIMEOUT = 3.0  # s


class Unreachable(click.ClickException):
    """No daemon of the swarm was reached; exit code 6."""

    exit_code = UNREACHABLE


def known_members(operator: Operator, timeout: float | None = None) -> MembersView:
    """The swarm, once all have answered or after `timeout` s; None: 1 s.

    Unreachable, naming the swarms that were found, if no daemon was reached.
    """
    view = operator.members() if timeout is None else operator.members(timeout=timeout)
    if view.members:
        return view
    settings = operator.settings
    text = f"no daemon of swarm {settings.swarm!r} can be reached"
    others = [name for name in operator.swarms() if name != settings.swarm]
    if others:
        raise Unreachable(f"{text}; there are the swarms: {', '.join(others)} (see --swarm)")
    where = "on this machine" if settings.profile == "dev" else f"by {settings.interface}"
    raise Unreachable(f"{text}, nor any other swarm {where}; start swarmd, or see --profile")


def expected_of(view: MembersView, targets: Targets) -> Expected:
    """The robots that must answer a request to `targets`; NoTarget if there are none."""
    selected = targets.select(view.members.keys() | view.roster)
    expected = expected_to_run(view.members, view.roster, selected)
    if not expected.asked and not expected.absent:
        raise _no_target(*expected.warnings)
    return expected


def send(
    operator: Operator,
    view: MembersView,
    kind: type[AnyRequest],
    expected: Expected,
    timeout: float,
    **fields: Any,
) -> Outcome:
    """Send a request with its fields to the expected robots, with their epochs in `view`."""
    return operator.request(
        kind,
        view.epochs(expected.asked),
        **fields,
        timeout=timeout,
        absent=expected.absent,
        warnings=expected.warnings,
    )


def send_to(
    options: CommonOptions,
    kind: type[AnyRequest],
    targets: Targets,
    *,
    timeout: float = REQUEST_TIMEOUT,
    **fields: Any,
) -> Outcome:
    """Look at the swarm and send a request to the targets; `--timeout` overrides `timeout` s."""
    with options.operator() as operator:
        view = known_members(operator)
        expected = expected_of(view, targets)
        return send(operator, view, kind, expected, options.timeout or timeout, **fields)


def send_stop(
    options: CommonOptions, verb: Literal["stop", "estop"], targets: Targets, reason: str = ""
) -> Outcome:
    """Stop the targets at once; a full name that no robot has counts as not answering.

    Unreachable if no daemon was reached, NoTarget if none is targeted.
    """
    select = None if targets.is_whole_swarm else targets.matching
    with options.operator() as operator:
        timeout = options.timeout or STOP_TIMEOUT
        outcome = operator.halt(verb, select=select, reason=reason, timeout=timeout)
        if outcome.targeted and set(targets.full_names) <= {*outcome.replies, *outcome.missing}:
            return outcome
        view = known_members(operator)
    if not outcome.targeted:
        targets.select(view.members.keys() | view.roster)
        raise _no_target()
    lost = set(targets.full_names) - view.members.keys()
    warnings = (f"{unknown('robot', name, view.members)}" for name in sorted(lost))
    return replace(
        outcome,
        missing=tuple(sorted({*outcome.missing, *lost})),
        warnings=(*outcome.warnings, *warnings),
    )


def _no_target(*reasons: str) -> NoTarget:
    return NoTarget(
        f"no robot is targeted: {'; '.join(reasons) or 'the targets have left, or are excluded'}"
    )
