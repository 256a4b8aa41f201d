"""How every request ends: a line for each robot, one for all of them, and an exit code."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, NoReturn

import click

from swarmd.cli.output import NOTHING, print_json, print_table, warn
from swarmd.network.outcome import USAGE, Outcome

if TYPE_CHECKING:
    from swarmd.cli.options import CommonOptions

# How pattern hosts begin to refuse an unknown pattern or parameter, or a value out of range.
_MISTAKE = re.compile(r"(no pattern|no parameter|parameters?) ")


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
    fault = usage_fault(outcome)
    if fault:
        raise click.UsageError(fault)
    click.get_current_context().exit(outcome.exit_code)


def usage_fault(outcome: Outcome) -> str:
    """What the operator got wrong, if that is why all robots refused; else empty.

    Only the robots know which patterns they have and what those can be told; all the same a word
    that none of them understands is the operator's to correct, as is any other usage.
    """
    texts = {reply.text for reply in outcome.replies.values()}
    is_refused = outcome.targeted and len(outcome.refused) == outcome.targeted
    if is_refused and len(texts) == 1 and _MISTAKE.match(text := texts.pop()):
        return text
    return ""


def plain(outcome: Outcome) -> dict[str, Any]:
    """The outcome as JSON holds it."""
    return {
        "targeted": outcome.targeted,
        "applied": list(outcome.applied),
        "refused": list(outcome.refused),
        "failed": list(outcome.failed),
        "missing": list(outcome.missing),
        "line": outcome.line,
        "exit_code": USAGE if usage_fault(outcome) else outcome.exit_code,
        "seconds": round(outcome.seconds, 4),
        "replies": {
            name: {"code": reply.code.value, "text": reply.text}
            for name, reply in outcome.replies.items()
        },
        "warnings": list(outcome.warnings),
    }
