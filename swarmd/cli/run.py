"""`swarmctl run`: start a pattern on robots, on those that are as the operator saw them."""

from __future__ import annotations

import click

from swarmd.cli.arguments import Duration, read_assignments, read_targets, target_options
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.report import report_outcome
from swarmd.cli.send import expected_of, known_members, send
from swarmd.core.keys import is_id
from swarmd.core.messages import RunRequest


@click.command()
@click.argument("pattern")
@target_options
@click.option(
    "-p", "params", multiple=True, metavar="KEY=VALUE", help="A parameter; may be repeated."
)
@click.option("--for", "duration", type=Duration(), help="Finish after this long, such as 60s.")
@click.option(
    "--until",
    multiple=True,
    metavar="CONDITION",
    help="Finish when it holds: done, nearer:METRES, settled:REPORT:SECONDS, report:KEY=VALUE or"
    " timeout:SECONDS; given more than once, any of them.",
)
@common_options
def run(
    options: CommonOptions,
    pattern: str,
    names: tuple[str, ...],
    is_all: bool,
    exclude: tuple[str, ...],
    params: tuple[str, ...],
    duration: float | None,
    until: tuple[str, ...],
) -> None:
    """Start PATTERN on TARGETS: names, globs such as 'tb3-*', or --all.

    An answer `applied` means that the pattern is loaded and will be stepped. Robots that changed
    since they were looked at refuse: look at `swarmctl members` and ask again.
    """
    targets = read_targets("run", names, is_all, exclude, needed=True)
    if not is_id(pattern):
        raise click.UsageError(f"{pattern!r} is no pattern's name; see `swarmctl patterns`")
    values = read_assignments(params)
    if until:
        from swarmd.kit.conditions import parse_conditions

        parse_conditions(until)
    with options.operator() as operator:
        view = known_members(operator)
        outcome = send(
            operator,
            view,
            RunRequest,
            expected_of(view, targets),
            options.timeout,
            pattern=pattern,
            params=values,
            seconds=duration,
            until=until,
        )
    report_outcome(options, "run", outcome)
