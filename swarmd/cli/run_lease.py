"""`swarmctl run --lease`: runs that end when this process does."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

import click

from swarmd.cli.output import signals_end, warn
from swarmd.cli.send import Asked, report
from swarmd.client.run_lease import LeaseKeeper, follow_runs
from swarmd.client.runs import start
from swarmd.client.stops import stop_names
from swarmd.texts.values import seconds

if TYPE_CHECKING:
    from swarmd.core.goal import Goal
    from swarmd.network.operator.outcome import Outcome

SILENCE = 5.0  # s beyond the lease for which a robot that is not heard is waited for


def run_while_here(asked: Asked, goal: Goal, lease: float) -> NoReturn:
    """Run a goal on all targets until all runs have ended, or a signal; then stop them.

    The goal's `lease`, in s, is renewed until then.
    """
    options, operator = asked.options, asked.operator
    keeper = LeaseKeeper(operator, goal.id, lease, asked.names)
    ended: Outcome | None = None
    with signals_end():
        try:
            keeper.start()
            outcome = asked.show(start(asked.targeted, goal))
            if not outcome.applied:
                report_again(outcome)
            warn(
                f"the robots run while this command runs, and {seconds(lease)} longer;"
                " Ctrl-C stops them"
            )
            running = {name: outcome.replies[name].epoch for name in outcome.applied}
            follow_runs(asked.targeted.session, goal, lease + SILENCE, running)
        except (KeyboardInterrupt, SystemExit):
            ended = stop_names(operator, asked.names)
        finally:
            keeper.close()
    if ended is not None:
        report(options, ended)
    report_again(outcome)


def report_again(outcome: Outcome) -> NoReturn:
    """End with the exit code of an outcome that was printed."""
    click.get_current_context().exit(outcome.exit_code)
