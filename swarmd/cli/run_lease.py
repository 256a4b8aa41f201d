"""`swarmctl run --lease`: runs that end when this process does."""

from __future__ import annotations

import threading
from collections.abc import Collection
from functools import partial
from typing import TYPE_CHECKING, NoReturn

import click

from swarmd.cli.ask_robots import next_status, statuses_of
from swarmd.cli.output import signals_end, warn
from swarmd.cli.run_start import start
from swarmd.cli.send import Asked, report, stop_names
from swarmd.core.clock import boottime
from swarmd.core.goal import GoalState
from swarmd.network.datagram import RunLease
from swarmd.texts.values import seconds

if TYPE_CHECKING:
    from swarmd.core.goal import Goal
    from swarmd.core.messages import Epoch, Status
    from swarmd.network.operator.operator import Operator
    from swarmd.network.operator.outcome import Outcome

PARTS = 4
"""How often the lease is renewed while it lasts: three copies may get lost."""
SILENCE = 5.0  # s beyond the lease for which a robot that is not heard is waited for


def run_while_here(asked: Asked, goal: Goal, lease: float) -> NoReturn:
    """Run a goal on all targets until all runs have ended, or a signal; then stop them.

    The goal's `lease`, in s, is renewed until then.
    """
    options, operator = asked.options, asked.operator
    keeper = _Keeper(operator, goal.id, lease, asked.names)
    ended: Outcome | None = None
    with signals_end():
        try:
            keeper.start()
            outcome = asked.show(start(asked, goal))
            if not outcome.applied:
                report_again(outcome)
            warn(
                f"the robots run while this command runs, and {seconds(lease)} longer;"
                " Ctrl-C stops them"
            )
            running = {name: outcome.replies[name].epoch for name in outcome.applied}
            follow_runs(operator, goal, lease + SILENCE, running)
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


def follow_runs(
    operator: Operator, goal: Goal, patience: float, running: dict[str, Epoch | None]
) -> None:
    """Return once no robot of `running` runs the goal any more; warns of each end.

    With the epoch of each since the run: an earlier status of the same daemon counts for nothing.
    A robot that tells no status for `patience` s is not waited for.
    """
    heard = dict.fromkeys(running, boottime())
    with statuses_of(operator) as news:
        while running:
            status, now = next_status(news, 0.5), boottime()
            if status is not None and (robot := status.robot) in running:
                heard[robot] = now
                if not _is_on(status, goal) and not _is_older(status, running[robot]):
                    del running[robot]
                    detail = f" {status.detail}" if status.detail else ""
                    warn(f"{robot}: {status.state} ({status.reason}){detail}")
            for name in [one for one in running if now - heard[one] > patience]:
                del running[name]
                warn(f"{name} was not heard for {seconds(patience)}: it is not waited for")


def _is_on(status: Status, goal: Goal) -> bool:
    """True while a robot runs the goal, or loads its pattern."""
    goals = status.goal
    if goals is None or goals.own is None or goals.own.goal.id != goal.id:
        return False
    return goals.state in (GoalState.RUNNING, GoalState.LOADING)


def _is_older(status: Status, since: Epoch | None) -> bool:
    """True for a status of the same daemon from before its epoch `since`."""
    epoch = status.epoch
    return (
        since is not None and epoch.instance == since.instance and epoch.revision < since.revision
    )


class _Keeper(threading.Thread):
    """Renews the lease of a goal."""

    def __init__(
        self, operator: Operator, goal_id: str, lease: float, names: Collection[str]
    ) -> None:
        super().__init__(name="swarmd-lease", daemon=True)
        self._operator, self._goal_id, self._names = operator, goal_id, names
        self._period = lease / PARTS
        self._ending = threading.Event()

    def run(self) -> None:
        """Renew until `close`."""
        operator, count = self._operator, 0
        while not self._ending.is_set():
            count += 1
            operator.send_to_robots(partial(self._lease, count), self._names)
            self._ending.wait(self._period)

    def _lease(self, count: int) -> RunLease:
        return RunLease(id=self._goal_id, operator=self._operator.name[:128], count=count)

    def close(self) -> None:
        """Renew no longer."""
        self._ending.set()
        self.join(1.0)
