"""`swarmctl run`: start a pattern on robots, which becomes their goal."""

from __future__ import annotations

from typing import Any

import click

from swarmd.cli import completion
from swarmd.cli.canary import CANARY_TIME, canaries_of, read_canary
from swarmd.cli.options import CommonOptions, Duration, common_options
from swarmd.cli.run_start import goal_targets, run_with_canary, start, start_at
from swarmd.cli.send import asking
from swarmd.cli.targets import Targets, takes_targets
from swarmd.core.keys import is_id
from swarmd.core.verbs import MAX_AHEAD
from swarmd.network.spread.operator_goals import next_goal
from swarmd.texts.assignments import read_assignments

_MIN_LEASE = 1.0


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
    _check(**fields, at=at, canary=canary, canary_time=canary_time)
    read_canary(canary)
    with asking(options, targets, needs_status=canary is not None) as asked:
        chosen = goal_targets(targets, asked.names)
        goal = next_goal(asked.operator, asked.view, targets=chosen, **fields)
        if canary is not None:
            first = canaries_of(canary, asked.names)
            run_with_canary(asked, goal, first, canary_time or CANARY_TIME)
        elif lease is not None:
            from swarmd.cli.run_lease import run_while_here

            run_while_here(asked, goal, lease)
        elif at is not None:
            start_at(asked, goal, at)
        else:
            asked.report(start(asked, goal))


def _check(
    *,
    conditions: tuple[str, ...],
    on_join: str,
    valid: float | None,
    lease: float | None,
    at: float | None,
    canary: str | None,
    canary_time: float | None,
    **_: Any,
) -> None:
    """UsageError for conditions and options that cannot be, before a robot is asked."""
    if conditions:
        from swarmd.kit.conditions import parse_conditions

        parse_conditions(conditions)
    if on_join == "run" and valid is None:
        raise click.UsageError(
            "--on-join run needs --valid: how long robots that join may start by themselves"
        )
    if valid is not None and on_join != "run":
        raise click.UsageError("--valid is how long robots that join run it: add --on-join run")
    if lease is not None and lease < _MIN_LEASE:
        raise click.UsageError(f"--lease: expected at least {_MIN_LEASE:.0f}s")
    if canary is None and canary_time is not None:
        raise click.UsageError("--canary-time: expected --canary, too")
    if sum(one is not None for one in (at, canary, lease)) > 1:
        raise click.UsageError("--at, --canary and --lease do not go together; take one of them")
