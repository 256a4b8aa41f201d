"""The end of every request: a line for each robot, a count, and an exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn

import click

from swarmd.cli.output import NOTHING, print_json, print_table, warn
from swarmd.core.messages import Refusal
from swarmd.network.outcome import USAGE, Outcome

if TYPE_CHECKING:
    from swarmd.cli.options import CommonOptions

# Where the operator finds what all robots refused as a mistake.
_HELP = {
    Refusal.UNKNOWN_PATTERN: "swarmctl patterns",
    Refusal.INVALID_PARAMETER: "swarmctl patterns show NAME",
    Refusal.INVALID_CONDITION: "swarmctl run --help",
}


class Mistake(click.ClickException):
    """All robots refused the request as a mistake in it; exit code 2."""

    exit_code = USAGE


def report_outcome(options: CommonOptions, verb: str, outcome: Outcome) -> NoReturn:
    """Print the outcome of a request and end with its exit code."""
    for line in outcome.warnings:
        warn(f"warning: {line}")
    for name in outcome.duplicates:
        warn(f"warning: {name} answered twice: two daemons have this id; stop one of them")
    if options.is_json:
        print_json("Outcome", _as_json(verb, outcome))
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
        see = f" (see {_HELP[refusal]})" if refusal in _HELP else ""
        raise Mistake(f"{outcome.mistake}{see}")
    click.get_current_context().exit(outcome.exit_code)


def _as_json(verb: str, outcome: Outcome) -> dict[str, Any]:
    return {
        "verb": verb,
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
