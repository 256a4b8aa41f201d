"""Sends a stop or estop of an operator, and repeats it until each robot has acked."""

from __future__ import annotations

from collections.abc import Callable

from swarmd.core.clock import boottime
from swarmd.network.datagram import Ack
from swarmd.network.operator.arrivals import Arrivals
from swarmd.network.operator.discovery import Discovery
from swarmd.network.operator.operator_datagrams import OperatorDatagrams
from swarmd.network.operator.outcome import Outcome
from swarmd.network.operator.repeat_timer import SOLICIT_PACE, RepeatTimer
from swarmd.network.operator.roster_follower import RosterFollower
from swarmd.network.operator.stop_request import STOP_WAIT, PendingStop

STOP_PACE = ((1.0, 0.1), (float("inf"), 0.25))  # steps of a RepeatTimer
PROGRESS_PERIOD = 3.0  # s between two reports of robots without an ack
END_PERIOD = 0.05  # s between two tests of the end


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
        `discovery`: the robots that are found meanwhile. `until`: s at which sending ends at the
        latest; None: by `pending.is_over`, or with `until_all` never. Sending also ends once
        `is_ended` returns True. With `until_all`, `on_progress` gets the robots without an ack when
        these change, and a KeyboardInterrupt ends sending like `is_ended`.
        """
        with self._arrivals.lock:
            self._pending = pending
        now = boottime()
        # By `rest_time` each base rests, or its robot has reported that the base has not stopped.
        # After it, a robot whose last ack says "moving" is shown like a robot without an ack.
        rest_time = now + STOP_WAIT
        solicit_timer, stop_timer = RepeatTimer(now, SOLICIT_PACE), RepeatTimer(now, STOP_PACE)
        progress_timer = RepeatTimer(now + 1.0, ((float("inf"), PROGRESS_PERIOD),))
        targets: frozenset[str] = frozenset()
        reported: tuple[str, ...] | None = None
        try:
            while True:
                with self._arrivals.lock:
                    # 1. Has sending ended?
                    now, count = boottime(), self._arrivals.count
                    is_over = until is not None and now >= until
                    if until is None and not until_all:
                        is_over = pending.is_over(now)
                    if is_over or is_ended() or pending.is_done(now):
                        break

                    # 2. The datagrams to send: to all if a repeat is due, else only to robots that
                    # were just found.
                    targets_before, targets = targets, pending.selected()
                    lacking = pending.lacking(now)  # without an ack, or the base still moves
                    # `unstopped` is shown to the user: before `rest_time` only the robots without
                    # an ack, since a base needs time to stop.
                    unstopped = lacking if now >= rest_time else pending.silent(now)
                    is_repeat_due, new_targets = stop_timer.is_due(now), targets - targets_before
                    stops = tuple(pending.datagrams(now, None if is_repeat_due else new_targets))
                if is_repeat_due or new_targets:
                    for stop_part, addresses in stops:
                        self._datagrams.send(stop_part, addresses, is_to_all=is_repeat_due)
                self._rosters.begin()  # takes a newer roster, if a robot shows one, on a thread

                # 3. Find more robots, and report progress.
                if solicit_timer.is_due(now):
                    self._datagrams.solicit(discovery, now)
                # The user takes an empty list as the end of the stop. So an empty list is not shown
                # while a base still moves.
                is_true = bool(unstopped) or not lacking
                is_new = unstopped != reported
                if until_all and is_new and is_true and progress_timer.is_due(now):
                    reported = unstopped
                    on_progress(unstopped)

                # 4. Wait for an ack, or until something is due.
                pause = min(solicit_timer.pause(now), stop_timer.pause(now))
                to_end_check = END_PERIOD if until is None else until - now
                self._arrivals.wait(count, min(pause, to_end_check))
        except KeyboardInterrupt:
            if not until_all:
                raise
        with self._arrivals.lock:
            self._pending = None
            return pending.outcome(boottime())
