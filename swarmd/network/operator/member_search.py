"""Runs a look of an operator: sends solicits, dials robots, and asks for their statuses."""

from __future__ import annotations

import math
import time

from swarmd.core import codec
from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder, encode, version_of
from swarmd.core.keys import ANY, CONTROL
from swarmd.core.messages import PeerView, StatusHeader
from swarmd.core.verbs import MembersQuery
from swarmd.network.operator.arrivals import Arrivals
from swarmd.network.operator.discovery import Discovery
from swarmd.network.operator.members_view import MembersView
from swarmd.network.operator.operator_datagrams import OperatorDatagrams
from swarmd.network.operator.operator_sessions import OperatorSessions
from swarmd.network.operator.repeat_timer import SOLICIT_PACE, RepeatTimer

POLL_PACE = ((0.2, 0.015), (float("inf"), 0.1))  # steps of a RepeatTimer
# s after which a look that needs no status asks for statuses: most such looks are over before.
STATUS_DELAY = 0.1
MAX_EXCUSED = 512  # robots in a query for members that need not answer again
STATUS_TIMEOUT = 10.0  # s of a query for members or a status
OVER_PERIOD = 0.02  # s between two checks whether the look is over, which take long

_header = Decoder(StatusHeader, any_version=True)


class MemberSearch:
    """Looks for members by the datagrams and sessions of an operator."""

    def __init__(
        self, datagrams: OperatorDatagrams, sessions: OperatorSessions, arrivals: Arrivals
    ) -> None:
        self._datagrams = datagrams
        self._sessions = sessions
        self._arrivals = arrivals

    def look(
        self, discovery: Discovery, timeout: float | None, cap: float, *, needs_status: bool
    ) -> MembersView:
        """Query all members (a look) until `discovery`, just begun, is complete; returns them.

        Threads of the carrier and of Zenoh put the answers into `discovery`, which decides when the
        look is complete (`is_complete`). An incomplete look ends after `timeout` s. With `timeout`
        None an incomplete look ends once a longer wait is of no use (`is_over`), and after `cap` s
        at the latest. `needs_status` False: statuses are asked for only after STATUS_DELAY.
        """
        now = discovery.started
        solicit_timer, status_timer = RepeatTimer(now, SOLICIT_PACE), RepeatTimer(now, POLL_PACE)
        over_timer = RepeatTimer(now, ((float("inf"), OVER_PERIOD),))  # for `discovery.is_over`
        deadline = None if timeout is None else now + timeout
        ask_status_at = now if needs_status else now + STATUS_DELAY
        while True:
            with self._arrivals.lock:
                now, count = boottime(), self._arrivals.count
                is_complete = discovery.is_complete(now)
                if deadline is not None:
                    is_over = now >= deadline
                else:
                    is_capped = now - discovery.started >= cap
                    is_over = is_capped or (over_timer.is_due(now) and discovery.is_over(now))
            if is_complete:
                now = self._dial_last_robots(discovery, now)
            if is_complete or is_over:
                with self._arrivals.lock:
                    return discovery.result(now)
            if solicit_timer.is_due(now):
                self._datagrams.solicit(discovery, now)
            dial_due_in = self._sessions.dial(discovery, now)
            if now >= ask_status_at and status_timer.is_due(now):
                self._ask_members(discovery)
            to_end_check = OVER_PERIOD if deadline is None else deadline - now
            timers_due_in = min(solicit_timer.pause(now), status_timer.pause(now))
            self._arrivals.wait(count, min(timers_due_in, to_end_check, dial_due_in))

    def _dial_last_robots(self, discovery: Discovery, now: float) -> float:
        """Dial the robots that still wait to be dialled together; returns the time afterwards.

        The caller of a complete look needs links to all robots for its requests.
        """
        wait = self._sessions.dial(discovery, now)
        while wait < math.inf:
            time.sleep(wait)
            now = boottime()
            wait = self._sessions.dial(discovery, now)
        return now

    def _ask_members(self, discovery: Discovery) -> None:
        """Ask all linked robots for status and members, by Zenoh; the replies go to `discovery`.

        The query names the robots that have answered, which stay silent. The status of a robot of
        another version is asked for on its own, and only the head of such a status is read.
        """
        if not self._sessions.is_open:
            return
        from swarmd.network.carriers.session import MAX_WIRE

        with self._arrivals.lock:
            answered = sorted(discovery.answered)
        decode = Decoder(PeerView, MAX_WIRE)

        def on_view(robot: str, payload: bytes) -> None:
            if version_of(payload) != codec.VERSION:
                return
            view = decode(payload)
            if view.robot == robot:
                discovery.on_view(view, boottime())

        def on_status(robot: str, payload: bytes) -> None:
            header = _header(payload)
            if header.robot == robot and version_of(payload) != codec.VERSION:
                discovery.on_header(header, boottime())

        query = encode(MembersQuery(answered=tuple(answered[:MAX_EXCUSED])))
        self._sessions.get(ANY, CONTROL, "members", query, STATUS_TIMEOUT, on_view)
        with self._arrivals.lock:
            of_other_version = discovery.of_other_version - set(answered)
        for robot in sorted(of_other_version):
            self._sessions.get(robot, "state", "status", b"", STATUS_TIMEOUT, on_status)
