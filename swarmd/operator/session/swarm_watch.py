"""Watches a swarm: looks for members each second, and takes the statuses that robots publish."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable

from swarmd.core.codec import Decoder
from swarmd.core.errors import SwarmError
from swarmd.core.messages import STATUS_SILENCE, Status
from swarmd.operator.session.members_view import Contact, MembersView
from swarmd.operator.session.operator import Operator

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
