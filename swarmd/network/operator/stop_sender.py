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
        """Send until the stop is done or over, as `Operator.send_stop` describes.

        `until`: s at which the wait ends; None: by `pending.is_over`, or, with `until_all`, never.
        Each turn: 1. test the ends, 2. send the stop to all if a repeat is due, else only to robots
        that were just found, 3. solicit, 4. report progress, 5. wait for arrivals.
        """
        with self._arrivals.lock:
            self._pending = pending
        now = boottime()
        names_moving_at = now + STOP_WAIT
        solicit, repeat = RepeatTimer(now, SOLICIT_PACE), RepeatTimer(now, STOP_PACE)
        progress = RepeatTimer(now + 1.0, ((float("inf"), PROGRESS_PERIOD),))
        selected: frozenset[str] = frozenset()
        reported: tuple[str, ...] | None = None
        try:
            while True:
                with self._arrivals.lock:
                    now, count = boottime(), self._arrivals.count
                    is_over = until is not None and now >= until
                    if until is None and not until_all:
                        is_over = pending.is_over(now)
                    if is_over or is_ended() or pending.is_done(now):
                        break
                    before, selected = selected, pending.selected()
                    lacking = pending.lacking(now)
                    # By `names_moving_at` each base rests, or its robot has reported that it has
                    # not stopped: a robot whose last ack says "moving" counts as lost from then on.
                    silent = lacking if now >= names_moving_at else pending.silent(now)
                    is_due, new = repeat.is_due(now), selected - before
                    # Robots that were just found get a copy of their own before the next repeat.
                    stops = tuple(pending.datagrams(now, None if is_due else new))
                for stop_part, addresses in stops if is_due or new else ():
                    self._datagrams.send(stop_part, addresses, is_to_all=is_due)
                self._rosters.begin()
                if solicit.is_due(now):
                    self._datagrams.solicit(discovery, now)
                is_new = silent != reported and bool(silent or not lacking)
                if until_all and is_new and progress.is_due(now):
                    reported = silent
                    on_progress(silent)
                pause = min(solicit.pause(now), repeat.pause(now))
                longest = END_PERIOD if until is None else until - now
                self._arrivals.wait(count, min(pause, longest))
        except KeyboardInterrupt:
            if not until_all:
                raise
        with self._arrivals.lock:
            self._pending = None
            return pending.outcome(boottime())
