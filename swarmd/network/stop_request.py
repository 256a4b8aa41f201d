"""Whom a stop must still reach, and when everyone has acked: pure."""

from __future__ import annotations

from collections.abc import Callable, Collection

import msgspec

from swarmd.core.codec import encode
from swarmd.core.messages import EstopRequest, StopRequest
from swarmd.network.discovery import Gathering
from swarmd.network.outcome import Acks, Outcome, expected_to_stop

Select = Callable[[Collection[str]], Collection[str]]
# After this many seconds the answers that came are taken for the membership.
GATHER = 1.0


class Halting:
    """One `stop` or `estop` on its way. `select` picks of the names known so far; None: all.

    Everyone is told with `targets` None, which needs no knowledge of who is there; a selection
    names its targets. The request's id is the same in every repetition.
    """

    def __init__(
        self,
        request: StopRequest | EstopRequest,
        select: Select | None,
        gathering: Gathering,
        started: float,
    ) -> None:
        self.acks = Acks(request.id)
        self._request = request
        self._select = select
        self._gathering = gathering
        self._started = started

    @property
    def is_for_all(self) -> bool:
        """True if every robot is meant."""
        return self._select is None

    def payload(self) -> bytes:
        """The request as it is to be sent now."""
        if self._select is None:
            return encode(self._request)
        targets = dict.fromkeys(sorted(self._selected()), None)
        return encode(msgspec.structs.replace(self._request, targets=targets))

    def pending(self) -> tuple[str, ...]:
        """Robots that are meant and have not acked: each is to be sent it once more."""
        return self._lacking(self._selected())

    def is_done(self, now: float) -> bool:
        """True once the membership is known and everyone that must ack has."""
        if not self._gathering.known:
            return False
        is_known = self._gathering.is_complete(now) or now - self._started >= GATHER
        return is_known and not self._lacking(self._expected(now))

    def outcome(self, now: float) -> Outcome:
        """How it stands."""
        expected = self._expected(now)
        return self.acks.outcome(
            expected, silent=self._lacking(expected), seconds=now - self._started
        )

    def _lacking(self, names: frozenset[str]) -> tuple[str, ...]:
        """Of an id that two daemons hold, both must ack."""
        return tuple(
            sorted(name for name in names if self.acks.lacks(name, self._gathering.holders(name)))
        )

    def _selected(self) -> frozenset[str]:
        known = self._gathering.known
        return known if self._select is None else frozenset(self._select(known))

    def _expected(self, now: float) -> frozenset[str]:
        view = self._gathering.result(now)
        return expected_to_stop(view.members, view.roster, self._selected())
