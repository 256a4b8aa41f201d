"""The state of a stop or estop on its way: which robots lack an ack, and when it is done. Pure."""

from __future__ import annotations

from collections.abc import Callable, Collection

import msgspec

from swarmd.core.codec import encode
from swarmd.core.messages import EstopRequest, StopRequest
from swarmd.network.discovery import Discovery
from swarmd.network.outcome import Acks, Outcome, expected_to_stop

Select = Callable[[Collection[str]], Collection[str]]
# After this many seconds the views that came count as the membership.
DISCOVERY_TIMEOUT = 1.0


class PendingStop:
    """One stop or estop that is repeated until every robot acked.

    `select` picks from the names known so far; None: all. A request to all has `targets` None,
    which needs no membership; a selection names its targets. Every repetition has the same id.
    """

    def __init__(
        self,
        request: StopRequest | EstopRequest,
        select: Select | None,
        discovery: Discovery,
        started: float,
    ) -> None:
        self.acks = Acks(request.id)
        self.is_for_all = select is None
        self._request = request
        self._select = select
        self._discovery = discovery
        self._started = started

    def payload(self) -> bytes:
        """The bytes to send now."""
        if self._select is None:
            return encode(self._request)
        targets = dict.fromkeys(sorted(self._selected()), None)
        return encode(msgspec.structs.replace(self._request, targets=targets))

    def pending(self) -> tuple[str, ...]:
        """The targeted robots without an ack: the request is sent to each once more."""
        return self._lacking(self._selected())

    def is_done(self, now: float) -> bool:
        """True once the membership is known and every robot that must ack has."""
        if not self._discovery.known:
            return False
        is_known = self._discovery.is_complete(now) or now - self._started >= DISCOVERY_TIMEOUT
        return is_known and not self._lacking(self._expected())

    def outcome(self, now: float) -> Outcome:
        """The outcome if it ended now."""
        expected = self._expected()
        return self.acks.outcome(
            expected, silent=self._lacking(expected), seconds=now - self._started
        )

    def _lacking(self, names: frozenset[str]) -> tuple[str, ...]:
        """Those without an ack; of an id that two daemons hold, both must ack."""
        return tuple(
            sorted(name for name in names if self.acks.lacks(name, self._discovery.holders(name)))
        )

    def _selected(self) -> frozenset[str]:
        known = self._discovery.known
        return known if self._select is None else frozenset(self._select(known))

    def _expected(self) -> frozenset[str]:
        view = self._discovery.result()
        return expected_to_stop(view.members, view.roster, self._selected())
