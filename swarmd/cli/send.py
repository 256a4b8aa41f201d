"""Requests to robots: the swarm as seen, the robots that must answer, the outcome reported.

The outcome is a line for each robot, a count, and the exit code.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import click

from swarmd.cli.arguments import Failure, Targets
from swarmd.cli.output import NOTHING, print_json, print_table, warn
from swarmd.core.errors import unknown
from swarmd.core.messages import Refusal
from swarmd.network.outcome import (
    NO_TARGET,
    UNREACHABLE,
    USAGE,
    Expected,
    Outcome,
    expected_to_run,
)

if TYPE_CHECKING:
    from swarmd.cli.options import CommonOptions
    from swarmd.core.messages import AnyRequest
    from swarmd.network.discovery import MembersView
    from swarmd.network.operator import Operator

REQUEST_TIMEOUT = 5.0  # s
STOP_TIMEOUT = 3.0  # s
# Where the operator finds what all robots refused as a mistake.
_HELP = {
    Refusal.UNKNOWN_PATTERN: "swarmctl patterns",
    Refusal.INVALID_PARAMETER: "swarmctl patterns show NAME",
    Refusal.INVALID_CONDITION: "swarmctl run --help",
}


def known_members(operator: Operator, timeout: float | None = None) -> MembersView:
    """The swarm, once all have answered or after `timeout` s; None: 1 s.

    Failure, naming the swarms that were found, if no daemon was reached.
    """
    view = operator.members() if timeout is None else operator.members(timeout=timeout)
    if view.members:
        return view
    settings = operator.settings
    text = f"no daemon of swarm {settings.swarm!r} can be reached"
    others = [name for name in operator.swarms() if name != settings.swarm]
    if others:
        text = f"{text}; there are the swarms: {', '.join(others)} (see --swarm)"
        raise Failure(text, UNREACHABLE)
    where = "on this machine" if settings.profile == "dev" else f"by {settings.interface}"
    text = f"{text}, nor any other swarm {where}; start swarmd, or see --profile"
    raise Failure(text, UNREACHABLE)


def expected_of(view: MembersView, targets: Targets) -> Expected:
    """The robots that must answer a request to `targets`; Failure if there are none."""
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
) -> NoReturn:
    """Send a request to the targets and report; `--timeout` overrides `timeout` s."""
    with options.operator() as operator:
        view = known_members(operator)
        expected = expected_of(view, targets)
        outcome = send(operator, view, kind, expected, options.timeout or timeout, **fields)
    report(options, outcome)


def send_stop(
    options: CommonOptions, verb: Literal["stop", "estop"], targets: Targets, reason: str = ""
) -> NoReturn:
    """Stop the targets at once and report; a full name that no robot has does not answer.

    Failure if no daemon was reached or no robot is targeted.
    """
    select = None if targets.is_whole_swarm else targets.matching
    with options.operator() as operator:
        timeout = options.timeout or STOP_TIMEOUT
        outcome = operator.halt(verb, select=select, reason=reason, timeout=timeout)
        names = set(targets.full_names)
        if not outcome.targeted or not names <= {*outcome.replies, *outcome.missing}:
            view = known_members(operator)
            if not outcome.targeted:
                targets.select(view.members.keys() | view.roster)
                raise _no_target()
            lost = sorted(names - view.members.keys())
            warnings = (unknown("robot", name, view.members) for name in lost)
            outcome = replace(
                outcome,
                missing=tuple(sorted({*outcome.missing, *lost})),
                warnings=(*outcome.warnings, *warnings),
            )
    report(options, outcome)


def report(options: CommonOptions, outcome: Outcome) -> NoReturn:
    """Print the outcome of a request and end with its exit code."""
    for line in outcome.warnings:
        warn(f"warning: {line}")
    for name in outcome.duplicates:
        warn(f"warning: {name} answered twice: two daemons have this id; stop one of them")
    if options.is_json:
        print_json("Outcome", _as_json(outcome))
        warn(outcome.line)
    else:
        rows = [
            (name, reply.code.value, reply.text or NOTHING)
            for name, reply in outcome.replies.items()
        ]
        rows += [(name, "no answer", NOTHING) for name in outcome.missing]
        if rows:
            print_table(("NAME", "ANSWER", "TEXT"), sorted(rows))
        click.echo(outcome.line)
    if outcome.mistake:
        refusal = next(iter(outcome.replies.values())).refusal
        name = click.get_current_context().params.get("pattern", "NAME")
        see = f" (see {_HELP[refusal]})".replace("NAME", name) if refusal in _HELP else ""
        raise Failure(f"{outcome.mistake}{see}", USAGE)
    click.get_current_context().exit(outcome.exit_code)


def _no_target(*reasons: str) -> Failure:
    text = "; ".join(reasons) or "the targets have left, or are excluded"
    return Failure(f"no robot is targeted: {text}", NO_TARGET)


def _as_json(outcome: Outcome) -> dict[str, Any]:
    return {
        "verb": click.get_current_context().command_path.partition(" ")[2],
        "targeted": outcome.targeted,
        "applied": list(outcome.applied),
        "refused": list(outcome.refused),
        "failed": list(outcome.failed),
        "missing": list(outcome.missing),
        "line": outcome.line,
        "exit_code": outcome.exit_code,
        "seconds": round(outcome.seconds, 4),
        "replies": {
            name: {"code": reply.code, "refusal": reply.refusal, "text": reply.text}
            for name, reply in outcome.replies.items()
        },
        "warnings": list(outcome.warnings),
    }
