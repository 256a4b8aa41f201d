"""A stop or emergency stop under way: the robots without an ack, and the end of sending. Pure.

A robot acks (acknowledges) a stop at once, and the ack shows whether the robot's base is known to
rest. The stop is repeated to the robot until the base rests, or until the robot reports that the
base has not stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator

from msgspec.structs import replace

from swarmd.link.datagram import Ack, Address, Stop
from swarmd.link.stops.stop_freshness import REPLAYED
from swarmd.operator.session.discovery import Discovery
from swarmd.operator.session.outcome import Acks, Outcome

Select = Callable[[Collection[str]], Collection[str]]
Renew = Callable[[], tuple[bytes, int]]
"""Returns an origin that was never used, and a counter (`stop_freshness.py`)."""
RENEW_PERIOD = 0.5  # s between two new origins: refusals of the origin before may still arrive
# Bytes for target names in one datagram, beside an operator's name and a reason of full length.
_MAX_TARGET_BYTES = 400
_NAME_OVERHEAD = 2  # bytes of MessagePack before a name
# By default a stop goes on for at least STOP_WAIT s and STOP_TRIPS round trips.
STOP_WAIT = 3.0
STOP_TRIPS = 8.0
# A stop ends at the latest after STOP_CAP s and STOP_TRIPS round trips. A round trip counts as at
# most MAX_STOP_TRIP s, so that no datagram can raise this bound.
STOP_CAP = 20.0
MAX_STOP_TRIP = 2.0


class PendingStop:
    """A stop or emergency stop that is repeated until every expected robot has acked.

    - `discovery`: the robots that are known so far.
    - `select` picks the targets from the names known so far. None: all robots are targets, and
      the stop needs no list of names.
    - `names`: targets from the start, whether or not they are known.
    - `renew` returns a new origin and counter: by these a robot of a secured swarm detects replayed
      stops. The stop is repeated with new numbers if a robot refuses it as replayed.

    Every repeat has the same id.
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
        """The stop datagrams to send now, each with the addresses of its targets that lack an ack.

        The caller sends each datagram by multicast, and by unicast to these addresses. A stop of
        all robots is one datagram. A stop of named targets is as many datagrams as the names need,
        and none while no target is known. `names`: only for these targets; None: all targets.
        """
        # `age`: s since the stop was issued. `repeated`: the age at which the operator itself sent
        # the copy. Both are equal here; a robot that relays the copy raises only `age`.
        age_ms = round((now - self._started) * 1000)
        stop = replace(self._stop, age=age_ms, repeated=age_ms)
        lacking = set(self.lacking(now))
        if names is not None:
            lacking &= set(names)
        if self._select is None:
            yield stop, self._addresses(lacking)
            return
        for targets in _in_datagrams(sorted(self.selected() if names is None else names)):
            addresses = self._addresses(lacking.intersection(targets))
            yield replace(stop, targets=targets), addresses

    def _addresses(self, names: Collection[str]) -> tuple[Address, ...]:
        addresses = {self._discovery.address(name) for name in names}
        return tuple(sorted(address for address in addresses if address is not None))

    def on_ack(self, ack: Ack, now: float) -> bool:
        """Take an ack; False if the ack is not kept.

        An ack of another request is not kept. An ack that refuses the stop as replayed is not kept
        either: the robot has heard a later stop of the same origin (random bytes that mark this
        operator's installation). The next repeat of the stop then gets an origin that was never
        used, which no robot refuses as replayed.
        """
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
        """The expected robots that have not acked, or whose ack says that the base still moves."""
        expected = sorted(self._expected(now))
        silent = set(self._silent_of(expected))
        for name in expected:
            if self.acks.is_moving(name):
                self.acks.forget_ended(name, self._discovery.holders(name))
        return tuple(name for name in expected if name in silent or self.acks.is_moving(name))

    def silent(self, now: float) -> tuple[str, ...]:
        """The expected robots without an ack; if two daemons hold an id, both must ack."""
        return self._silent_of(sorted(self._expected(now)))

    def _silent_of(self, expected: Iterable[str]) -> tuple[str, ...]:
        # The holders of an id take long to find, and matter only once the robot has acked.
        return tuple(
            name
            for name in expected
            if not self.acks.has_reply(name) or self.acks.lacks(name, self._discovery.holders(name))
        )

    def is_done(self, now: float) -> bool:
        """True once the membership is known and every expected robot has acked and rests."""
        if not self._expected(now) or self.lacking(now):
            return False
        return self._discovery.has_all_lists(now)  # takes the time of N**2 reports

    def is_over(self, now: float) -> bool:
        """True once the stop need not be repeated longer for robots that lack an ack."""
        trip = self._discovery.round_trip
        if now - self._started >= STOP_CAP + STOP_TRIPS * min(trip, MAX_STOP_TRIP):
            return True
        earliest_end = self._started + STOP_WAIT + STOP_TRIPS * trip
        if now < earliest_end:
            return False
        is_without_robots = not self._discovery.heard or not self._expected(now)
        return is_without_robots or now >= self._discovery.ends_at(now, self.lacking(now))

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
        """The robots that must ack: all selected robots except those that left.

        A robot has left if it sent a farewell (its last beacon). A robot of the roster must ack
        even then. A farewell may be forged: a robot that another robot lists as alive must ack,
        too. Failed robots must ack, since a robot that cannot be reached may move.
        """
        left = self._discovery.left(now)
        excused = left - self._discovery.roster - self._discovery.doubted if left else left
        return self.selected() - excused


def _in_datagrams(names: Iterable[str]) -> Iterator[tuple[str, ...]]:
    """The names in groups of at most _MAX_TARGET_BYTES, at least one name a group."""
    group: list[str] = []
    size = 0  # bytes of `group` in a datagram
    for name in names:
        name_size = len(name) + _NAME_OVERHEAD
        if group and size + name_size > _MAX_TARGET_BYTES:
            yield tuple(group)
            group = []
            size = 0
        group.append(name)
        size += name_size
    if group:
        yield tuple(group)
