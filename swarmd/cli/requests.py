"""The verbs that start and stop robots: `swarmctl run`, `stop`, `estop` and `reset`."""

from __future__ import annotations

import sys

import click

from swarmd.cli.arguments import Duration, Targets, read_assignments, takes_targets
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import warn
from swarmd.cli.send import (
    REQUEST_TIMEOUT,
    expected_of,
    known_members,
    report,
    send,
    send_stop,
    send_to,
)
from swarmd.core.keys import is_id
from swarmd.core.messages import ResetRequest, RunRequest


@click.command()
@click.argument("pattern")
@takes_targets(is_required=True)
@click.option(
    "-p", "params", multiple=True, metavar="KEY=VALUE", help="A parameter; may be repeated."
)
@click.option("--for", "duration", type=Duration(), help="End after this time, such as 60s.")
@click.option(
    "--until",
    multiple=True,
    metavar="CONDITION",
    help="End when it is met: done, nearer:METRES, settled:REPORT:SECONDS, report:KEY=VALUE or"
    " timeout:SECONDS; repeated, the first that is met.",
)
@common_options
def run(
    options: CommonOptions,
    pattern: str,
    targets: Targets,
    params: tuple[str, ...],
    duration: float | None,
    until: tuple[str, ...],
) -> None:
    """Start PATTERN on TARGETS: names, globs such as 'tb3-*', or --all.

    A robot answers `applied` when the pattern is loaded and will be stepped. A robot that changed
    since swarmctl looked at it refuses: check `swarmctl members` and repeat the request.
    """
    if not is_id(pattern):
        raise click.UsageError(f"{pattern!r} is no pattern name; see `swarmctl patterns`")
    values = read_assignments(params)
    if until:
        from swarmd.kit.conditions import parse_conditions

        parse_conditions(until)
    send_to(
        options, RunRequest, targets, pattern=pattern, params=values, seconds=duration, until=until
    )


@click.command()
@takes_targets(is_required=False)
@common_options
def stop(options: CommonOptions, targets: Targets) -> None:
    """Stop TARGETS, or all robots; they need a `run` to move again."""
    send_stop(options, "stop", targets)


@click.command()
@takes_targets(is_required=False)
@click.option("--reason", default="", help="Kept with the latch, and shown by `describe`.")
@common_options
def estop(options: CommonOptions, targets: Targets, reason: str) -> None:
    """Emergency-stop TARGETS, or all robots, without confirmation.

    The stop is latched: it survives restarts, and robots that join adopt a stop of the whole
    swarm, until `swarmctl reset`.
    """
    send_stop(options, "estop", targets, reason)


@click.command()
@takes_targets(is_required=True)
@click.option("--reason", default="", help="Why it is safe again; shown by `describe`.")
@click.option(
    "-y",
    "--yes",
    is_flag=True,
    help="Do not ask for confirmation, which happens only on a terminal.",
)
@common_options
def reset(options: CommonOptions, targets: Targets, reason: str, yes: bool) -> None:
    """Clear emergency stops and faults of TARGETS, which become idle; moves nothing.

    Clears only the emergency stops that swarmctl sees now. A later one stays.
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
    report(options, outcome)
