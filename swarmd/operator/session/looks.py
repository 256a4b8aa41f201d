"""Looks at a swarm: one look, and a look each second.

- `MemberSearch` runs a look: it sends solicits, dials robots, and asks for their statuses.
- `SwarmWatch` looks for members each second, and takes the statuses that robots publish.
"""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from swarmd.core import codec
from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder, encode, version_of
from swarmd.core.errors import SwarmError
from swarmd.core.keys import ANY, CONTROL
from swarmd.core.messages import (
    STATUS_SILENCE,
    PeerView,
    Status,
    StatusHeader,
)
from swarmd.core.verbs import MembersQuery
from swarmd.operator.session.carriers import OperatorDatagrams, OperatorSessions
from swarmd.operator.session.clocks import SOLICIT_PACE, Arrivals, LoopWatch, RepeatTimer
from swarmd.operator.session.discovery import Discovery
from swarmd.operator.session.members_view import Contact, Dials, MembersView

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator


POLL_PACE = ((0.2, 0.015), (float("inf"), 0.1))  # steps of a RepeatTimer
# s after which a look that needs no status asks for statuses: most such looks are over before.
STATUS_DELAY = 0.1
MAX_EXCUSED = 512  # robots in a query for members that need not answer again
STATUS_TIMEOUT = 10.0  # s of a query for members or a status
TURN_PERIOD = 0.004  # s of a turn of a look at least
OVER_PERIOD = 0.02  # s between two checks whether the look is over, which take long

_header = Decoder(StatusHeader, any_version=True)


class MemberSearch:
    """Looks for members by the datagrams and sessions of an operator."""

    def __init__(
        self,
        datagrams: OperatorDatagrams,
        sessions: OperatorSessions,
        arrivals: Arrivals,
        loops: LoopWatch,
    ) -> None:
        self._datagrams = datagrams
        self._sessions = sessions
        self._arrivals = arrivals
        self._loops = loops

    def look(
        self,
        discovery: Discovery,
        timeout: float | None,
        cap: float,
        *,
        needs_status: bool,
        dials: Dials,
    ) -> MembersView:
        """Query all members (a look) until the look is complete; returns the members.

        `discovery`: a new look, into which threads of the carrier and of Zenoh put the answers.
        `discovery.is_complete` decides when the look is complete. An incomplete look ends after
        `timeout` s. With `timeout` None an incomplete look ends once a longer wait is of no use
        (`discovery.is_over`), and after `cap` s at the latest. `needs_status` False: statuses are
        asked for only after STATUS_DELAY. `dials` NONE: no robot is dialled and no status
        is asked, so `needs_status` must be False.
        """
        now = discovery.started
        solicit_timer = RepeatTimer(now, SOLICIT_PACE)
        status_timer = RepeatTimer(now, POLL_PACE)
        over_timer = RepeatTimer(now, ((float("inf"), OVER_PERIOD),))  # for `discovery.is_over`
        deadline = None if timeout is None else now + timeout
        ask_status_at = now if needs_status else now + STATUS_DELAY
        is_mute = dials is Dials.NONE
        pause = 0.0
        self._loops.begin(now)
        while True:
            with self._arrivals.lock:
                now = boottime()
                count = self._arrivals.count
                is_complete = discovery.is_complete(now)
                is_any_heard = bool(discovery.heard)
                if deadline is not None:
                    ends_incomplete = now >= deadline
                elif now - discovery.started >= cap:
                    ends_incomplete = True
                else:
                    ends_incomplete = over_timer.is_due(now) and discovery.is_over(now)
            self._loops.turn(now, pause)
            if is_complete and dials is Dials.ALL:
                # The caller sends requests next, and needs links to all robots. Robots that wait to
                # be dialled together are dialled before the return; this may sleep.
                now = self._dial_last_robots(discovery, now)
            if is_complete or ends_incomplete:
                with self._arrivals.lock:
                    return discovery.result(now)
            if solicit_timer.is_due(now):
                self._datagrams.solicit(discovery, now)
            if is_any_heard and dials is Dials.ALL:
                self._sessions.prepare()  # while the other robots answer
            dial_due_in = math.inf if is_mute else self._sessions.dial(discovery, now)
            if now >= ask_status_at and status_timer.is_due(now) and not is_mute:
                self._ask_members(discovery)
            to_end_check = OVER_PERIOD if deadline is None else deadline - now
            timers_due_in = solicit_timer.pause(now)
            if not is_mute:
                timers_due_in = min(timers_due_in, status_timer.pause(now))
            pause = min(timers_due_in, to_end_check, dial_due_in)
            self._arrivals.wait(count, pause)
            # What arrives together is looked at together: a turn walks over all robots.
            time.sleep(max(0.0, now + TURN_PERIOD - boottime()))

    def _dial_last_robots(self, discovery: Discovery, now: float) -> float:
        """Dial the robots that still wait to be dialled together; returns the time afterwards."""
        wait = self._sessions.dial(discovery, now)
        while wait < math.inf:
            time.sleep(wait)
            now = boottime()
            wait = self._sessions.dial(discovery, now)
        return now

    def _ask_members(self, discovery: Discovery) -> None:
        """Query `members` of all linked robots by Zenoh; the replies go to `discovery`.

        Each robot replies with a `PeerView`: its own status, and the members that it knows. The
        query names the robots that have answered, and these robots do not reply again. The view of
        a robot of another version is not read. Such a robot gets a second query, for its status, of
        which only the header is read.
        """
        if not self._sessions.is_open:
            return
        # The module loads Zenoh, which a look without an open session does without.
        from swarmd.link.carriers.session import MAX_WIRE

        with self._arrivals.lock:
            answered = sorted(discovery.answered)
        decode = Decoder(PeerView, MAX_WIRE)

        # `OperatorSessions.get` calls both functions on Zenoh's threads, with the lock held, and
        # drops a reply for which a function raises CodecError.
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


LOOK_PERIOD = 1.0  # s between the begins of two looks
LOOK_TIME = 1.0  # s of a look, at most
LOOKING = "swarmd-looking"
"""The name of the daemon threads that look for members."""
_HEARD = (Contact.ANSWERED, Contact.NO_ANSWER)

_status = Decoder(Status)


class SwarmWatch:
    """Looks from `start` to `close`; the caller closes the operator.

    `on_status` and `on_view` are called on other threads, with each status and each look.
    """

    def __init__(
        self,
        operator: Operator,
        *,
        on_status: Callable[[Status], None] = lambda status: None,
        on_view: Callable[[MembersView], None] = lambda view: None,
    ) -> None:
        self._operator = operator
        self._tell_status = on_status
        self._tell_view = on_view
        self._lock = threading.Lock()
        self._statuses: dict[str, tuple[Status, float]] = {}
        self._view = MembersView({})
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._look, name=LOOKING, daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._operator.watch("status", self._on_status)
        self._thread.start()

    def close(self) -> None:
        """End the watch and its subscriptions."""
        self._ending.set()
        if not sys.is_finalizing():  # no thread goes on then
            self._thread.join(2.0 * LOOK_TIME)
        self._operator.unwatch("status")  # a look that dials subscribes to what is watched

    @property
    def view(self) -> MembersView:
        """The members as last seen."""
        return self._view

    def statuses(self) -> dict[str, tuple[Status, float]]:
        """The last status of each robot that sent one, and its age in s."""
        now = time.monotonic()
        with self._lock:
            known = dict(self._statuses)
        return {name: (status, max(now - at, 0.0)) for name, (status, at) in known.items()}

    def _look(self) -> None:
        while not self._ending.is_set():
            began = time.monotonic()
            with contextlib.suppress(SwarmError):
                view = self._operator.members(timeout=LOOK_TIME, needs_status=self._lacks_status())
                for member in view.members.values():
                    if member.contact is Contact.ANSWERED and member.status is not None:
                        self._take(member.status)
                self._view = view
                self._tell_view(view)
            self._ending.wait(max(LOOK_PERIOD - (time.monotonic() - began), 0.05))

    def _lacks_status(self) -> bool:
        """True if a robot whose beacons are heard does not publish its status each second.

        If True, the next query of all members must ask for statuses. With 50 robots a query with
        statuses takes three times the CPU time of a query without statuses.
        """
        recent = {name for name, (_, age) in self.statuses().items() if age <= STATUS_SILENCE}
        heard = [m.robot for m in self._view.members.values() if m.contact in _HEARD]
        return not heard or not recent.issuperset(heard)

    def _on_status(self, robot: str, payload: bytes) -> None:
        status = _status(payload)
        if status.robot == robot:
            self._take(status)

    def _take(self, status: Status) -> None:
        with self._lock:
            self._statuses[status.robot] = status, time.monotonic()
        self._tell_status(status)
