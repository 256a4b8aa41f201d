"""`swarmctl run --lease`: runs that end when this process does."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import NoReturn

import click

from swarmd.operator.cli.output import signals_end, warn
from swarmd.operator.cli.send import Asked, report
from swarmd.operator.client.run_lease import follow_runs
from swarmd.operator.client.runs import Run, carry_out
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.texts.values import seconds
from swarmd.operator.verbs.stop.ask import stop_names

SILENCE = 5.0  # s beyond the lease for which a robot that is not heard is waited for


def run_while_here(
    asked: Asked, run: Run, targets: tuple[str, ...], option: Callable[[str], str] = str
) -> NoReturn:
    """Run a pattern with a lease until all robots have ended the run, or until a signal stops them.

    A lease ends the run of a robot that does not hear this program. `targets`: those of the run's
    goal. `option` returns the name of an option as the user writes it.
    """
    lease = run.lease or 0.0
    ended = None
    with signals_end(), ExitStack() as opened:
        try:
            started = carry_out(run, asked.targeted, targets, opened, option)
            outcome = asked.show(started.outcome)
            if not outcome.applied:
                report_again(outcome)
            warn(
                f"the robots run while this command runs, and {seconds(lease)} longer;"
                " Ctrl-C stops them"
            )
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


def report_again(outcome: Outcome) -> NoReturn:
    """End with the exit code of an outcome that was printed."""
    click.get_current_context().exit(outcome.exit_code)
