"""`swarmctl run`: start a pattern on robots."""

from __future__ import annotations

import click

from swarmd.cli.arguments import Duration, Targets, read_assignments, takes_targets
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.report import report_outcome
from swarmd.cli.send import send_to
from swarmd.core.keys import is_id
from swarmd.core.messages import RunRequest


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
    outcome = send_to(
        options,
        RunRequest,
        targets,
        pattern=pattern,
        params=values,
        seconds=duration,
        until=until,
    )
    report_outcome(options, "run", outcome)
