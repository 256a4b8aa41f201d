"""`swarmctl run`: start a pattern on robots, which becomes their goal."""

from __future__ import annotations

from typing import Any

import click

from swarmd.cli import completion
from swarmd.cli.canary import canaries_of, read_canary
from swarmd.cli.options import CommonOptions, Duration, common_options
from swarmd.cli.send import asking
from swarmd.cli.targets import takes_targets
from swarmd.client.canary import CANARY_TIME
from swarmd.client.runs import (
    check_run,
    goal_targets,
    make_goal,
    run_with_canary,
    start,
    start_at,
)
from swarmd.client.targets import Targets
from swarmd.core.errors import ConfigError
from swarmd.core.keys import is_id
from swarmd.core.verbs import MAX_AHEAD
from swarmd.texts.assignments import read_assignments
from swarmd.texts.values import seconds


class _Ahead(Duration):
    """A time from now on, as `+3s`."""

    name = "ahead"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The duration in s, at most MAX_AHEAD."""
        text = str(value).strip()
        if not text.startswith("+"):
            self.fail(f"{text!r}: expected a time from now on, such as +3s", param, ctx)
        found = super().convert(text[1:], param, ctx)
        if found > MAX_AHEAD:
            self.fail(f"{text!r}: robots wait for at most {MAX_AHEAD:.0f} s", param, ctx)
        return found


@click.command()
@click.argument("pattern", shell_complete=completion.patterns)
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
@click.option("--at", type=_Ahead(), help="Start all robots at one moment, such as +3s.")
@click.option(
    "--canary",
    metavar="ROBOT",
    help="First only this robot, or so many robots; the others if it runs well.",
    shell_complete=completion.robots,
)
@click.option(
    "--canary-time", type=Duration(), help=f"How long it must run well [{CANARY_TIME:.0f}s]."
)
@click.option(
    "--lease",
    type=Duration(),
    help="Stay here; the robots stop when swarmctl is gone for this time, such as 5s.",
)
@click.option(
    "--on-join",
    type=click.Choice(["offer", "run"]),
    help="What robots do that join later: wait for `resume`, or run it [offer].",
)
@click.option("--valid", type=Duration(), help="How long robots that join run it, such as 5m.")
@common_options
def run(
    options: CommonOptions,
    pattern: str,
    targets: Targets,
    params: tuple[str, ...],
    duration: float | None,
    until: tuple[str, ...],
    at: float | None,
    canary: str | None,
    canary_time: float | None,
    lease: float | None,
    on_join: str | None,
    valid: float | None,
) -> None:
    """Start PATTERN on TARGETS: names, globs such as 'tb3-*', -l LABEL, or --all.

    It becomes the goal of these robots; robots that join later are offered it. A robot answers
    `applied` when the pattern is loaded and will be stepped. A robot that changed since swarmctl
    looked at it refuses: check `swarmctl members` and repeat the request.
    """
    if not is_id(pattern):
        raise click.UsageError(f"{pattern!r} is no pattern name; see `swarmctl patterns`")
    fields: dict[str, Any] = {
        "pattern": pattern,
        "params": read_assignments(params),
        "seconds": duration,
        "conditions": until,
        "on_join": on_join or "offer",
        "valid": valid,
        "lease": lease,
    }
    _check(
        until,
        on_join=on_join or "offer",
        valid=valid,
        lease=lease,
        at=at,
        canary=canary,
        canary_time=canary_time,
    )
    read_canary(canary)
    with asking(options, targets, needs_status=canary is not None) as asked:
        targeted = asked.targeted
        goal = make_goal(targeted, goal_targets(targets, asked.names), **fields)
        if canary is not None:
            first = canaries_of(canary, asked.names)
            asked.report(*run_with_canary(targeted, goal, first, canary_time or CANARY_TIME))
        elif lease is not None:
            from swarmd.cli.run_lease import run_while_here

            run_while_here(asked, goal, lease)
        elif at is not None:
            if (wait := targeted.time_left) is not None and wait <= at:
                raise click.UsageError(f"--timeout is too short for a start in {seconds(at)}")
            asked.report(*start_at(targeted, goal, at))
        else:
            asked.report(start(targeted, goal))


def _check(conditions: tuple[str, ...], **values: Any) -> None:
    """Errors of conditions and options that cannot be, before a robot is asked."""
    if conditions:
        from swarmd.kit.conditions import parse_conditions

        parse_conditions(conditions)
    try:
        check_run(**values, option=lambda name: f"--{name.replace('_', '-')}")
    except ConfigError as error:
        raise click.UsageError(str(error)) from error
