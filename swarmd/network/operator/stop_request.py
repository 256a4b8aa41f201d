"""The state of a stop or estop on its way: which robots lack an ack, and when it is done. Pure.

A robot acks at once, and its ack shows whether its base is known to rest. The stop is repeated to
the robot until the base rests, or the robot reports that it has not stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator

from msgspec.structs import replace

from swarmd.core.messages import Presence
from swarmd.network.datagram import Ack, Address, Stop
from swarmd.network.operator.discovery import Discovery
from swarmd.network.operator.outcome import Acks, Outcome
from swarmd.network.stops.stop_freshness import REPLAYED

Select = Callable[[Collection[str]], Collection[str]]
Renew = Callable[[], tuple[bytes, int]]
"""Gives an origin that was never used, and a counter."""
RENEW_PERIOD = 0.5  # s between two new origins: answers to the one before are on their way
# Names in one datagram, in bytes: beside an operator's name and a reason of full length.
_ROOM = 400
# By default a stop goes on for this long, in s, and for so many round trips since the last news.
STOP_WAIT, STOP_TRIPS = 3.0, 8.0
# A bound that no datagram can raise, in s, beside so many round trips of at most this many s.
STOP_CAP, MAX_STOP_TRIP = 20.0, 2.0


class PendingStop:
    """One stop or estop that is repeated until every expected robot acked.

    - `select` picks from the names known so far; None: all.
    - `names` are targets from the start, known or not.
    - A stop of all has no targets, and needs no membership.
    - Every repeat has the same id.
    - `renew`: for robots that refuse the stop as replayed (`stop_freshness.py`).
    """

    def __init__(
        self,
        stop: Stop,
        discovery: Discovery,
        started: float,
        *,
        select: Select | None = None,
        names: Collection[str] = (),
        renew: Renew | None = None,
    ) -> None:
        self.acks = Acks(stop.id)
        self._stop = stop
        self._discovery = discovery
        self._started = started
        self._select = select
        self._names = frozenset(names)
        self._renew = renew
        self._renewed = started - RENEW_PERIOD

    def datagrams(
        self, now: float, names: Collection[str] | None = None
    ) -> Iterator[tuple[Stop, tuple[Address, ...]]]:
        """What to send now, each with the addresses of its targets without an ack.

        Nothing while no target is known. `names` None: for all targets, else for these alone.
        """
        age = round((now - self._started) * 1000)
        stop = replace(self._stop, age=age, repeated=age)
        lacking = set(self.lacking(now))
        if names is not None:
            lacking &= set(names)
        if self._select is None:
            yield stop, self._addresses(lacking)
            return
        part: list[str] = []
        for name in sorted(self.selected() if names is None else names):
            if part and sum(len(target) + 2 for target in (*part, name)) > _ROOM:
                yield (
                    replace(stop, targets=tuple(part)),
                    self._addresses(lacking.intersection(part)),
                )
                part = []
            part.append(name)
        if part:
            yield replace(stop, targets=tuple(part)), self._addresses(lacking.intersection(part))

    def _addresses(self, names: Collection[str]) -> tuple[Address, ...]:
        addresses = {self._discovery.address(name) for name in names}
        return tuple(sorted(address for address in addresses if address is not None))

    def on_ack(self, ack: Ack, now: float) -> bool:
        """Take an ack; False if it is of another request."""
        if ack.refusal != REPLAYED or self._renew is None:
            return self.acks.on_ack(ack)
        if ack.id == self._stop.id and now - self._renewed >= RENEW_PERIOD:
            self._renewed = now
            origin, counter = self._renew()
            self._stop = replace(self._stop, origin=origin, counter=counter)
        return False

    def selected(self) -> frozenset[str]:
        """The targets among the names known so far."""
        known = self._discovery.known
        return known if self._select is None else self._names | frozenset(self._select(known))

    def lacking(self, now: float) -> tuple[str, ...]:
        """The expected robots without an ack, and those that have acked and do not rest yet."""
        silent, expected = set(self.silent(now)), sorted(self._expected(now))
        for name in expected:
            self.acks.forget_ended(name, self._discovery.holders(name))
        return tuple(name for name in expected if name in silent or self.acks.is_moving(name))

    def silent(self, now: float) -> tuple[str, ...]:
        """The expected robots without an ack; of an id that two daemons hold, both must ack."""
        return tuple(
            name
            for name in sorted(self._expected(now))
            if self.acks.lacks(name, self._discovery.holders(name))
        )

    def is_done(self, now: float) -> bool:
        """True once the membership is known and every expected robot has acked and rests."""
        is_known = self._discovery.has_all_lists(now) and bool(self._expected(now))
        return is_known and not self.lacking(now)

    def is_over(self, now: float) -> bool:
        """True after a wait that is long enough, by the round trip, for robots without an ack."""
        trip = self._discovery.round_trip
        if now - self._started >= STOP_CAP + STOP_TRIPS * min(trip, MAX_STOP_TRIP):
            return True
        least = self._started + STOP_WAIT + STOP_TRIPS * trip
        if now < least:
            return False
        is_bare = not self._discovery.heard or not self._expected(now)
        return is_bare or now >= self._discovery.ends_at(now, self.lacking(now))

    def outcome(self, now: float) -> Outcome:
        """The outcome if the stop ended now."""
        is_open = self._select is None or not self.selected() <= self._names
        return self.acks.outcome(
            self._expected(now),
            silent=self.silent(now),
            seconds=now - self._started,
            reached=len(self._discovery.heard),
            unlisted=self._discovery.unlisted if is_open else (),
        )

    def _expected(self, now: float) -> frozenset[str]:
        """The robots that must ack: all selected robots but those that left.

        Failed robots count, and so does the whole roster: a robot that cannot be reached may move.
        A farewell may be false, and counts only while no other robot lists the robot as alive.
        """
        view = self._discovery.result(now)
        left = {name for name, member in view.members.items() if member.presence is Presence.LEFT}
        return self.selected() - (left - view.roster - self._discovery.doubted)
