"""`swarmctl reset`: clear the emergency stops that were seen, and faults."""

from __future__ import annotations

import sys

import click

from swarmd.cli.arguments import Targets, takes_targets
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import warn
from swarmd.cli.report import report_outcome
from swarmd.cli.send import REQUEST_TIMEOUT, expected_of, known_members, send
from swarmd.core.messages import ResetRequest


@click.command()
@takes_targets(is_required=True)
@click.option("--reason", default="", help="Why it is safe again; shown by `describe`.")
@click.option("-y", "--yes", is_flag=True, help="Do not ask for confirmation.")
@common_options
def reset(options: CommonOptions, targets: Targets, reason: str, yes: bool) -> None:
    """Clear emergency stops and faults of TARGETS, which become idle; moves nothing.

    Clears only the emergency stops that swarmctl sees now: one that arrives meanwhile stays.
    """
    with options.operator() as operator:
        view = known_members(operator)
        expected = expected_of(view, targets)
        statuses = [view.members[name].status for name in expected.asked]
        latches = {key: latch for one in statuses if one for key, latch in one.latches.items()}
        for latch_id, latch in latches.items():
            text = f" ({latch.reason})" if latch.reason else ""
            warn(f"clears {latch_id}, by {latch.issuer}, for {latch.scope}{text}")
        question = f"Reset {', '.join(expected.asked)}?"
        if not yes and sys.stdin.isatty() and not click.confirm(question, err=True):
            raise click.ClickException("nothing was sent")
        timeout = options.timeout or REQUEST_TIMEOUT
        fields = {"ids": tuple(sorted(latches)), "reason": reason}
        outcome = send(operator, view, ResetRequest, expected, timeout, **fields)
    report_outcome(options, "reset", outcome)
