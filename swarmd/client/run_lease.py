"""Runs under a lease: they end when robots no longer hear the operator that renews the lease."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING

from swarmd.client.ask_robots import next_status, statuses_of
from swarmd.core.clock import boottime
from swarmd.core.closing import is_program_ended
from swarmd.core.goal import GoalState
from swarmd.texts.values import seconds

if TYPE_CHECKING:
    from swarmd.client.session import Session
    from swarmd.core.goal import Goal
    from swarmd.core.messages import Epoch, Status
    from swarmd.network.operator.operator import Operator

PARTS = 4
"""How often the lease is renewed while it lasts: three copies may get lost."""


def follow_runs(
    session: Session, goal: Goal, patience: float, running: dict[str, Epoch | None]
) -> None:
    """Wait until no robot in `running` runs the goal any more; tell the user each end.

    `running`: the robots, each with its epoch at the start of the run: the instance of its daemon
    and the count of the changes of its state. A status of this instance with a lower count is
    ignored. A robot that sends no status for `patience` s is reported and no longer awaited.
    """
    heard = dict.fromkeys(running, boottime())
    with statuses_of(session.operator) as status_queue:
        while running:
            status, now = next_status(status_queue, 0.5), boottime()
            if status is not None and (robot := status.robot) in running:
                heard[robot] = now
                if not _is_on(status, goal) and not _is_older(status, running[robot]):
                    del running[robot]
                    detail = f" {status.detail}" if status.detail else ""
                    session.tell(f"{robot}: {status.state} ({status.reason}){detail}")
            for name in [name for name in running if now - heard[name] > patience]:
                del running[name]
                session.tell(f"{name} was not heard for {seconds(patience)}: it is not waited for")


def _is_on(status: Status, goal: Goal) -> bool:
    """True while a robot runs the goal, or loads the pattern of the goal."""
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


class LeaseKeeper(threading.Thread):
    """Renews the lease (`lease` s) of a goal on the robots `names`, from `start` to `close`.

    Nothing is renewed once `is_owned` is False: by default from the end of the main thread on,
    since a program that has failed may wait for other threads for ever.
    """

    def __init__(
        self,
        operator: Operator,
        goal_id: str,
        lease: float,
        names: Collection[str],
        *,
        is_owned: Callable[[], bool] | None = None,
    ) -> None:
        super().__init__(name="swarmd-lease", daemon=True)
        self._is_owned = is_owned or (lambda: not is_program_ended())
        self._operator, self._goal_id, self._names = operator, goal_id, names
        self._period = lease / PARTS
        self._ending = threading.Event()

    def run(self) -> None:
        """Renew until `close`, or until nothing owns the lease."""
        operator, count = self._operator, 0
        while self._is_owned() and not self._ending.is_set():
            count += 1
            operator.send_lease(self._goal_id, count, self._names)
            self._ending.wait(self._period)

    def close(self) -> None:
        """Renew no longer."""
        self._ending.set()
        self.join(1.0)
