"""Runs under a lease: they end when robots no longer hear the operator that renews the lease."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

from swarmd.core.clock import boottime
from swarmd.core.goal import GoalState
from swarmd.core.messages import Reason
from swarmd.operator.session.exit_codes import FAILED, PARTIAL, TIMEOUT
from swarmd.operator.session.session import next_status, statuses_of
from swarmd.operator.verbs.run import words

if TYPE_CHECKING:
    from swarmd.core.goal import Goal
    from swarmd.core.messages import Epoch, Status
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.session import Session

PARTS = 4
"""How often the lease is renewed while it lasts: three copies may get lost."""


class Lapse(NamedTuple):
    """A time in which a command has renewed nothing for longer than the lease."""

    begun: float  # s: the last renewal before it
    seconds: float  # so far


class LeasedRuns:
    """The runs of `goal` on robots until they end, and what is told of them. Pure.

    `running`: the robots, each with its epoch at the start of the run: the instance of its daemon
    and the count of the changes of its state. A status of this instance with a lower count is
    ignored. A robot that sends no status for `patience` s is no longer awaited. Times in s.

    A robot whose lease ended has stopped since it did not hear this command. If the command renewed
    nothing for the time of the lease, since it was stopped (SIGSTOP) or its computer slept, then
    this is the cause, and no robot counts as silent for the time in which nobody listened.
    """

    def __init__(
        self, goal: Goal, patience: float, running: Mapping[str, Epoch | None], now: float
    ) -> None:
        self.running = dict(running)
        self.ended: dict[str, Status | None] = {}  # the status that ended each run; None: not heard
        self._goal = goal
        self._patience = patience
        self._heard = dict.fromkeys(running, now)
        self._lapse: Lapse | None = None  # the last one that was told

    def on_status(self, status: Status, now: float) -> Iterator[str]:
        """Take a status; yields a line for the user if the run of the robot has ended."""
        robot = status.robot
        if robot not in self.running:
            return
        self._heard[robot] = now
        if not _is_on(status, self._goal) and not _is_older(status, self.running[robot]):
            del self.running[robot]
            self.ended[robot] = status
            yield words.ended(status)

    def advance(self, now: float, lapse: Lapse | None) -> Iterator[str]:
        """Let time pass; yields lines for the user. `lapse`: the last one of this command."""
        if lapse is not None and (self._lapse is None or lapse.begun > self._lapse.begun):
            self._lapse = lapse
            self._heard = dict.fromkeys(self._heard, now)
            yield words.renewed_nothing(lapse.seconds, self._goal.lease or 0.0)
        for name in [name for name in self.running if now - self._heard[name] > self._patience]:
            del self.running[name]
            self.ended[name] = None
            is_after_lapse = self._lapse is not None
            yield words.not_heard(name, self._patience, is_after_lapse=is_after_lapse)

    def exit_code(self, started: int) -> int:
        """The exit code of the command; `started`: that of the start of the runs.

        A run whose lease has ended, and one whose end is not known, did not end as it was wanted.
        """
        lapsed = [one for one in self.ended.values() if one is not None and _has_lapsed(one)]
        silent = [name for name, one in self.ended.items() if one is None]
        if not lapsed and not silent:
            return started
        if len(lapsed) + len(silent) < len(self.ended):
            return PARTIAL
        return FAILED if lapsed else TIMEOUT


def follow_runs(
    session: Session,
    goal: Goal,
    patience: float,
    running: Mapping[str, Epoch | None],
    lapse: Callable[[float], Lapse | None],
) -> LeasedRuns:
    """Wait until no robot in `running` runs the goal any more; tell the user each end.

    `patience`, `running`: as of `LeasedRuns`. `lapse`: that of the `LeaseKeeper`.
    """
    runs = LeasedRuns(goal, patience, running, boottime())
    with statuses_of(session.operator) as status_queue:
        while runs.running:
            status = next_status(status_queue, 0.5)
            now = boottime()
            for line in runs.advance(now, lapse(now)):
                session.tell(line)
            if status is not None:
                for line in runs.on_status(status, now):
                    session.tell(line)
    return runs


def _has_lapsed(status: Status) -> bool:
    return status.reason is Reason.LEASE_ENDED


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

    Nothing is renewed once `is_owned` is False: a program that has failed may wait for other
    threads for ever, and its user waits for it no longer (`Session.is_owned`).
    """

    def __init__(
        self,
        operator: Operator,
        goal_id: str,
        lease: float,
        names: Collection[str],
        *,
        is_owned: Callable[[], bool],
    ) -> None:
        super().__init__(name="swarmd-lease", daemon=True)
        self._is_owned = is_owned
        self._operator = operator
        self._goal_id = goal_id
        self._names = names
        self._period = lease / PARTS
        self._ending = threading.Event()
        self._lease = lease
        self._renewed_at: float | None = None
        self._lapse: Lapse | None = None

    def lapse(self, now: float) -> Lapse | None:
        """The last time in which nothing was renewed for longer than the lease, until `now`."""
        renewed_at = self._renewed_at
        if renewed_at is not None and now - renewed_at > self._lease:
            return Lapse(renewed_at, now - renewed_at)
        return self._lapse

    def run(self) -> None:
        """Renew until `close`, or until nothing owns the lease."""
        operator = self._operator
        count = 0
        while self._is_owned() and not self._ending.is_set():
            count += 1
            operator.send_lease(self._goal_id, count, self._names)
            now = boottime()
            self._lapse = self.lapse(now)
            self._renewed_at = now
            self._ending.wait(self._period)

    def close(self) -> None:
        """Renew no longer."""
        self._ending.set()
        self.join(1.0)
