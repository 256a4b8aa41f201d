"""Sends a stop or estop of an operator, and repeats it until each robot has acked."""

from __future__ import annotations

from collections.abc import Callable

from swarmd.core.clock import boottime
from swarmd.link.datagram import Ack, Address, Stop
from swarmd.operator.session.arrivals import Arrivals
from swarmd.operator.session.discovery import Discovery
from swarmd.operator.session.operator_datagrams import OperatorDatagrams
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.repeat_timer import SOLICIT_PACE, RepeatTimer
from swarmd.operator.session.roster_follower import RosterFollower
from swarmd.operator.session.stop_request import STOP_WAIT, PendingStop

STOP_PACE = ((1.0, 0.1), (float("inf"), 0.25))  # steps of a RepeatTimer
PROGRESS_PERIOD = 3.0  # s between two reports of robots without an ack
END_PERIOD = 0.05  # s between two tests of the end


class _Progress:
    """Reports to the user which robots have not stopped, whenever these change."""

    def __init__(self, now: float) -> None:
        self._timer = RepeatTimer(now + 1.0, ((float("inf"), PROGRESS_PERIOD),))
        # By `_rest_time` each base rests, or its robot has reported that the base has not stopped.
        self._rest_time = now + STOP_WAIT
        self._unstopped: tuple[str, ...] = ()
        self._is_any_moving = False
        self._reported: tuple[str, ...] | None = None

    def take(self, pending: PendingStop, now: float) -> None:
        """Note the robots that have not stopped; with the lock held.

        Before `_rest_time` these are only the robots without an ack, since a base needs time to
        stop. From `_rest_time` on, robots whose last ack says "moving" are added.
        """
        lacking = pending.lacking(now)  # robots without an ack, and robots that still move
        self._unstopped = lacking if now >= self._rest_time else pending.silent(now)
        self._is_any_moving = bool(lacking)

    def report(self, on_progress: Callable[[tuple[str, ...]], None], now: float) -> None:
        """Call `on_progress` if the noted robots are new, at most once per PROGRESS_PERIOD."""
        # The user takes an empty list as the end of the stop: not while a base still moves.
        is_premature = not self._unstopped and self._is_any_moving
        is_new = self._unstopped != self._reported
        if is_new and not is_premature and self._timer.is_due(now):
            self._reported = self._unstopped
            on_progress(self._unstopped)


class StopSender:
    """Sends one stop at a time. `rosters` may take a newer roster meanwhile."""

    def __init__(
        self, datagrams: OperatorDatagrams, rosters: RosterFollower, arrivals: Arrivals
    ) -> None:
        self._datagrams = datagrams
        self._rosters = rosters
        self._arrivals = arrivals
        self._pending: PendingStop | None = None

    def on_ack(self, ack: Ack, now: float) -> bool:
        """Take an ack, with the lock held; False if it is not of the stop under way."""
        return self._pending is not None and self._pending.on_ack(ack, now)

    def send(
        self,
        pending: PendingStop,
        discovery: Discovery,
        until: float | None,
        *,
        until_all: bool,
        on_progress: Callable[[tuple[str, ...]], None],
        is_ended: Callable[[], bool],
    ) -> Outcome:
        """Send a stop, and repeat it until all targets have acked and rest; returns the outcome.

        `pending`: the stop, with its targets and the acks that other threads put there.
        `discovery`: the robots that are found meanwhile. Sending ends earlier

        - once `is_ended` returns True,
        - at the time `until` in s,
        - if `until` is None and `until_all` is False: once a longer wait is of no use
          (`PendingStop.is_over`),
        - on a KeyboardInterrupt, which is raised again only if `until_all` is False.

        `on_progress` is called only if `until_all` is True: it gets the robots that have not
        stopped, whenever these robots change.
        """
        with self._arrivals.lock:
            self._pending = pending
        now = boottime()
        solicit_timer = RepeatTimer(now, SOLICIT_PACE)
        stop_timer = RepeatTimer(now, STOP_PACE)
        progress = _Progress(now)
        known_targets: frozenset[str] = frozenset()
        try:
            while True:
                with self._arrivals.lock:
                    now = boottime()
                    count = self._arrivals.count
                    is_over = _is_over(pending, now, until, until_all=until_all)
                    if is_over or is_ended() or pending.is_done(now):
                        break
                    if until_all:
                        progress.take(pending, now)
                    targets = pending.selected()
                    new_targets = targets - known_targets
                    known_targets = targets
                    # A repeat goes to all targets (None); between two repeats, to new targets only.
                    is_repeat_due = stop_timer.is_due(now)
                    stops: tuple[tuple[Stop, tuple[Address, ...]], ...] = ()
                    if is_repeat_due or new_targets:
                        names = None if is_repeat_due else new_targets
                        stops = tuple(pending.datagrams(now, names))
                for stop_part, addresses in stops:
                    self._datagrams.send(stop_part, addresses, is_to_all=is_repeat_due)
                self._rosters.begin()  # if a robot shows a newer roster, a thread takes this roster
                if solicit_timer.is_due(now):
                    self._datagrams.solicit(discovery, now)
                if until_all:
                    progress.report(on_progress, now)
                pause = min(solicit_timer.pause(now), stop_timer.pause(now))
                to_end_check = END_PERIOD if until is None else until - now
                self._arrivals.wait(count, min(pause, to_end_check))
        except KeyboardInterrupt:
            if not until_all:
                raise  # `_pending` stays until the next stop: the caller ends and reads no acks
        with self._arrivals.lock:
            self._pending = None
            return pending.outcome(boottime())


def _is_over(pending: PendingStop, now: float, until: float | None, *, until_all: bool) -> bool:
    """True at the time `until`; without this time, once a longer wait is of no use."""
    if until is not None:
        return now >= until
    return not until_all and pending.is_over(now)
