"""How every request ends: a line for each robot, one for all of them, and an exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn

import click

from swarmd.cli.output import NOTHING, print_json, print_table, warn
from swarmd.network.outcome import Outcome

if TYPE_CHECKING:
    from swarmd.cli.options import CommonOptions


def report_outcome(options: CommonOptions, verb: str, outcome: Outcome) -> NoReturn:
    """Print the outcome of a request and end with its exit code."""
    for line in outcome.warnings:
        warn(f"warning: {line}")
    for name in outcome.duplicates:
        warn(f"warning: {name} answered twice: two daemons hold this id; stop one of them")
    if options.is_json:
        print_json("Outcome", {"verb": verb, **plain(outcome)})
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
        raise click.UsageError(outcome.mistake)
    click.get_current_context().exit(outcome.exit_code)


def plain(outcome: Outcome) -> dict[str, Any]:
    """The outcome as JSON holds it."""
    return {
        "targeted": outcome.targeted,
        "applied": list(outcome.applied),
        "refused": list(outcome.refused),
        "failed": list(outcome.failed),
        "missing": list(outcome.missing),
        "line": outcome.line,
        "exit_code": outcome.exit_code,
        "seconds": round(outcome.seconds, 4),
        "replies": {
            name: {
                "code": reply.code.value,
                "refusal": None if reply.refusal is None else reply.refusal.value,
                "text": reply.text,
            }
            for name, reply in outcome.replies.items()
        },
        "warnings": list(outcome.warnings),
    }
