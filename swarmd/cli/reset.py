"""`swarmctl reset`: clear the emergency stops that were seen, and faults; moves nothing."""

from __future__ import annotations

import sys
from collections.abc import Iterable

import click

from swarmd.cli.arguments import read_targets, target_options
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import warn
from swarmd.cli.report import report_outcome
from swarmd.cli.send import expected_of, known_members, send
from swarmd.core.messages import Latch, Member, ResetRequest


@click.command()
@target_options
@click.option("--reason", default="", help="Why it is safe again; shown by `describe`.")
@click.option("-y", "--yes", is_flag=True, help="Do not ask back.")
@common_options
def reset(
    options: CommonOptions,
    names: tuple[str, ...],
    is_all: bool,
    exclude: tuple[str, ...],
    reason: str,
    yes: bool,
) -> None:
    """Clear emergency stops and faults of TARGETS, which become idle; moves nothing.

    Only the emergency stops that are there now are cleared: one that comes meanwhile stays.
    """
    targets = read_targets("reset", names, is_all, exclude, needed=True)
    with options.operator() as operator:
        view = known_members(operator)
        expected = expected_of(view, targets)
        latches = held_by(view.members[name] for name in expected.asked)
        for latch_id, latch in latches.items():
            text = f" ({latch.reason})" if latch.reason else ""
            warn(f"clears {latch_id}, by {latch.issuer}, for {latch.scope}{text}")
        if not yes and sys.stdin.isatty() and not _confirmed(expected.asked):
            raise click.ClickException("nothing was sent")
        outcome = send(
            operator,
            view,
            ResetRequest,
            expected,
            options.timeout,
            ids=tuple(sorted(latches)),
            reason=reason,
        )
    report_outcome(options, "reset", outcome)


def held_by(members: Iterable[Member]) -> dict[str, Latch]:
    """The emergency stops of these robots, by id."""
    statuses = [member.status for member in members if member.status is not None]
    return {latch_id: latch for status in statuses for latch_id, latch in status.latches.items()}


def _confirmed(names: tuple[str, ...]) -> bool:
    return click.confirm(f"Reset {', '.join(names)}?", err=True)
