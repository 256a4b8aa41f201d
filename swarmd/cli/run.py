"""`swarmctl run`: start a pattern on robots, which becomes their goal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click
from msgspec.structs import replace

from swarmd.cli import completion
from swarmd.cli.arguments import Duration, Targets, takes_targets
from swarmd.cli.canary import CANARY_TIME, canaries_of, read_canary
from swarmd.cli.labels import unlabelled
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.run_start import RunPlan, goal_targets, run_with_canary, start
from swarmd.cli.send import known_members, report, targets_of
from swarmd.core.keys import is_id
from swarmd.core.verbs import MAX_AHEAD
from swarmd.network.spread.next_goal import next_goal
from swarmd.texts.assignments import read_assignments

if TYPE_CHECKING:
    pass

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
    plan = RunPlan(
        pattern, read_assignments(params), duration, until, on_join or "offer", valid, lease
    )
    _check(plan, at=at, canary=canary, canary_time=canary_time)
    read_canary(canary)
    with options.operator() as operator:
        needs_status = bool(targets.labels) or canary is not None
        view = known_members(options, operator, is_request_next=True, needs_status=needs_status)
        names, unclear = targets_of(view, targets), unlabelled(view, targets)
        goal = next_goal(operator, view, targets=goal_targets(targets, names), **plan.fields)
        if canary is not None:
            first = canaries_of(canary, names)
            seconds = CANARY_TIME if canary_time is None else canary_time
            run_with_canary(options, operator, view, goal, names, first, seconds, unclear)
        elif lease is not None:
            from swarmd.cli.run_lease import run_while_here

            run_while_here(options, operator, view, goal, names, unclear)
        else:
            outcome, notes = start(options, operator, view, goal, names, at=at)
            report(options, replace(outcome, unlabelled=unclear), notes)


def _check(plan: RunPlan, *, at: float | None, canary: str | None, canary_time: Any) -> None:
    """UsageError for conditions and options that cannot be, before a robot is asked."""
    if plan.until:
        from swarmd.kit.conditions import parse_conditions

        parse_conditions(plan.until)
    if plan.on_join == "run" and plan.valid is None:
        raise click.UsageError(
            "--on-join run needs --valid: how long robots that join may start by themselves"
        )
    if plan.valid is not None and plan.on_join != "run":
        raise click.UsageError("--valid is how long robots that join run it: add --on-join run")
    if plan.lease is not None and plan.lease < _MIN_LEASE:
        raise click.UsageError(f"--lease: expected at least {_MIN_LEASE:.0f}s")
    if canary is None and canary_time is not None:
        raise click.UsageError("--canary-time: expected --canary, too")
    if sum(one is not None for one in (at, canary, plan.lease)) > 1:
        raise click.UsageError("--at, --canary and --lease do not go together; take one of them")
