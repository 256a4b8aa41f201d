"""`swarmctl run`: start a pattern on robots, which becomes their goal."""

from __future__ import annotations

from contextlib import ExitStack
from typing import NoReturn

import click

from swarmd.core.verbs import MAX_AHEAD
from swarmd.operator.cli import completion
from swarmd.operator.cli.canary import read_canary
from swarmd.operator.cli.options import CommonOptions, Duration, common_options
from swarmd.operator.cli.output import signals_end, warn
from swarmd.operator.cli.send import Asked, asking, report
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.targets import Targets
from swarmd.operator.texts.assignments import read_assignments
from swarmd.operator.verbs.run import words
from swarmd.operator.verbs.run.ask import ON_JOIN, Run, carry_out, goal_targets
from swarmd.operator.verbs.run.canary import CANARY_TIME
from swarmd.operator.verbs.stop.ask import stop_names

SILENCE = 5.0  # s beyond the lease for which a robot that is not heard is waited for


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
@click.option(
    "--for", "--seconds", "duration", type=Duration(), help="End after this time, such as 60s."
)
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
    type=click.Choice(ON_JOIN),
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

    The run becomes the goal of these robots; robots that join later are offered the goal. A robot
    answers `applied` when the pattern is loaded and will be stepped. A robot that changed since
    swarmctl looked at it refuses: check `swarmctl members` and repeat the request.
    """
    new_run = Run(
        pattern=pattern,
        params=read_assignments(params),
        seconds=duration,
        conditions=until,
        on_join=on_join or "offer",
        valid=valid,
        lease=lease,
        at=at,
        canary=read_canary(canary),
        canary_time=canary_time,
    )
    new_run.check(_option)  # faults name a field as its option of the command line
    with asking(options, targets, needs_status=new_run.needs_status) as asked:
        # The goal keeps globs and labels, for robots that join later. `asked.targeted` has the
        # robots that must answer now.
        run_targets = goal_targets(targets, asked.names)
        if lease is not None:
            _run_while_here(asked, new_run, run_targets)
        else:
            nothing_opened = ExitStack()  # only a lease is kept open
            started = carry_out(new_run, asked.targeted, run_targets, nothing_opened, _option)
            asked.report(started.outcome, started.notes)


def _option(name: str) -> str:
    """The option that gives a field of `Run`."""
    return "--for" if name == "seconds" else f"--{name.replace('_', '-')}"


def _run_while_here(asked: Asked, new_run: Run, targets: tuple[str, ...]) -> NoReturn:
    """Run a pattern with a lease until all robots have ended the run, or until a signal stops them.

    A lease ends the run of a robot that does not hear this program. `targets`: those of the run's
    goal.
    """
    from swarmd.operator.verbs.run.lease import follow_runs  # most runs have no lease

    lease = new_run.lease or 0.0
    ended = None
    with signals_end(), ExitStack() as opened:
        try:
            started = carry_out(new_run, asked.targeted, targets, opened, _option)
            outcome = asked.show(started.outcome)
            if not outcome.applied:
                _end_with(outcome)
            warn(words.runs_while_here(lease))
            running = {name: outcome.replies[name].epoch for name in outcome.applied}
            assert started.keeper is not None  # the run has a lease
            runs = follow_runs(
                asked.targeted.session,
                started.goal,
                lease + SILENCE,
                running,
                started.keeper.lapse,
            )
        except (KeyboardInterrupt, SystemExit):
            ended = stop_names(asked.operator, asked.names)
    if ended is not None:
        report(asked.options, ended)
    click.get_current_context().exit(runs.exit_code(outcome.exit_code))


def _end_with(outcome: Outcome) -> NoReturn:
    """End with the exit code of an outcome that was printed."""
    click.get_current_context().exit(outcome.exit_code)
