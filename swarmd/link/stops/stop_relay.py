"""Relay of stops and emergency stops to other robots. Pure: datagrams and times in.

Each robot that hears a stop repeats it by the Trickle algorithm (RFC 6206):

1. Intervals double, from FIRST_INTERVAL to LAST_INTERVAL. The stop is sent at a random moment of
   each interval, unless REDUNDANCY other robots have sent the stop in that interval. So a hundred
   robots that all hear each other send little. A robot that hears a single robot still gets the
   stop.
2. The relay ends LIFETIME after the operator sent its last copy, or once all named targets have
   acked and rest. Each copy carries the age at which the operator sent it (`repeated`), so that a
   copy that travels in a circle does not prolong the relay.
3. A robot does not relay a stop that the robot itself would refuse.

Acks travel back by the same robots: a robot hands each ack to the senders of the stop, with its own
name as `via`.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field

from msgspec.structs import replace

from swarmd.link.datagram import MAX_HOPS, MAX_MS, Ack, Address, Stop
from swarmd.link.stops.stop_freshness import REPLAYED

_Key = tuple[str, str, tuple[str, ...] | None]
Send = tuple[Stop | Ack, Address | None]  # datagram, receiver (None: all robots)

FIRST_INTERVAL = 0.2  # s
LAST_INTERVAL = 6.4  # s
LIFETIME = 60.0  # s
REDUNDANCY = 2  # copies of other robots in an interval after which this robot does not send
MAX_STOPS = 64
MAX_SOURCES = 4
MAX_ACKS = 256  # robots whose acks of a stop are kept
MAX_HANDED_ON = 8 * MAX_ACKS * MAX_SOURCES
ACKS_AT_ONCE = 16  # acks of other robots that one repeat of a stop returns
MAX_AGE_SHIFT = 2.0  # s by which later copies may make the stop older than its first copy says
# s for which a stop is relayed whatever acks say: an ack may be forged. While a base moves, the
# stop is also relayed at FIRST_INTERVAL for this time. Measured at 30 % loss, bases at rest after
# 1 s: within 3 s 270 of 300 had reported that they rest; with intervals that double, 184.
TRUSTLESS_TIME = 3.0
DIRECT_TIMEOUT = 2.0  # s since a copy of the operator itself, for which it counts as heard directly
ACK_PERIOD = 0.08  # s between acks to one source: an operator repeats at 10 Hz
_NEVER = -1e9  # s
_SENT = -1.0  # value of `_Relayed.due` once the stop was sent in the present interval
# The stop is sent at a random moment between these shares of an interval.
_FIRST_SHARE = 0.1
_LAST_SHARE = 1.0


@dataclass(slots=True)
class _Relayed:
    """A stop under way. Times are in s on the own clock."""

    stop: Stop
    issued: float  # when the operator issued the stop, by the ages of all copies
    first_issued: float  # when the operator issued the stop, by the age of the first copy
    repeated: float  # the greatest age at which the operator itself sent a copy
    heard: float  # when the first copy came
    interval: float  # the length of the present interval
    interval_ends: float
    due: float  # when to send in the present interval, or _SENT
    copies: int = 0  # copies of other members in the present interval
    # By sender of the stop, when the last ack was sent to this sender.
    sources: dict[Address, float] = field(default_factory=dict)
    heard_directly: float = _NEVER  # when the last copy came from the operator itself
    acks: dict[str, Ack] = field(default_factory=dict)  # by name of another robot, its last ack
    acks_sent: float = _NEVER  # when acks of other robots were last returned
    handed_on: set[tuple[str, Address, bytes | None, str, bool]] = field(default_factory=set)
    """Acks that were handed on: robot, receiver, origin of a refusal, code, is_moving."""

    def take_ages(self, copy: Stop, now: float) -> None:
        """Update the times of the stop (`issued`, `repeated`) by a copy that came at `now`.

        Copies that came by several ways have different ages. The greatest age counts, since the age
        of a copy does not include the time on the network. Copies after the first move `issued`
        back by at most MAX_AGE_SHIFT: a stop with a forged great age would look older than the
        present run, and would not end this run.
        """
        issued = now - copy.age / 1000.0
        self.issued = max(min(self.issued, issued), self.first_issued - MAX_AGE_SHIFT)
        # The operator has sent no copy after now: `repeated` is at most the present age.
        repeated = min(copy.repeated / 1000.0, now - self.issued)
        self.repeated = max(self.repeated, repeated)

    def add_sender(self, source: Address, *, is_operator: bool) -> None:
        """Note a sender of the stop, which gets acks.

        Only MAX_SOURCES senders are noted. Beyond that the operator takes the place of the sender
        that came first, and any other sender is left out.
        """
        if source in self.sources:
            return
        if is_operator and len(self.sources) >= MAX_SOURCES:
            del self.sources[next(iter(self.sources))]
        if len(self.sources) < MAX_SOURCES:
            self.sources[source] = _NEVER  # no ack has gone to this sender

    def copy_to_send(self, now: float) -> Stop:
        """The copy that this robot sends to all now."""
        return replace(
            self.stop,
            hops=min(self.stop.hops + 1, MAX_HOPS),
            age=min(round((now - self.issued) * 1000), MAX_MS),
            repeated=round(self.repeated * 1000),
        )

    def keep_ack(self, ack: Ack) -> bool:
        """Keep the last ack of each robot, to send it again; False if there is no room.

        There is room for the acks of MAX_ACKS robots. "Moving" does not replace a kept "at rest".
        """
        is_first = ack.robot not in self.acks
        if is_first and len(self.acks) >= MAX_ACKS:
            return False
        if is_first or not ack.is_moving:
            self.acks[ack.robot] = ack
        return True

    def receivers_of(self, ack: Ack, source: Address) -> list[Address]:
        """The senders of the stop that now get a copy of another robot's ack.

        `source`, the sender of this ack, is never among them.
        """
        receivers = [address for address in self.sources if address != source]
        is_refused_as_replayed = ack.refusal == REPLAYED
        if not is_refused_as_replayed:
            return self.take_receivers(ack, None, receivers) if self.keep_ack(ack) else []
        if not ack.via:  # the refusing robot itself has sent the ack
            return receivers
        # A refusal that a third robot has handed on could travel in circles: each receiver gets one
        # copy for each origin. After a refusal the operator repeats the stop with a new origin.
        return self.take_receivers(ack, self.stop.origin, receivers)

    def take_receivers(
        self, ack: Ack, origin: bytes | None, receivers: list[Address]
    ) -> list[Address]:
        """The receivers without a copy of such an ack; from now on they count as having a copy.

        A receiver gets one copy for each code of the ack, for each of the two states of the base
        (moving and at rest), and for each origin. `origin`: the origin of the stop if the ack
        refuses the stop as replayed, else None.
        """
        taken: list[Address] = []
        for address in receivers:
            key = ack.robot, address, origin, ack.code, ack.is_moving
            if key not in self.handed_on and len(self.handed_on) < MAX_HANDED_ON:
                self.handed_on.add(key)
                taken.append(address)
        return taken


class StopRelay:
    """The stops that the robot `own` has heard lately."""

    def __init__(self, own: str, seed: int) -> None:
        self._own = own
        self._random = random.Random(seed)
        # The parts of a stop with many targets are handed on one by one.
        self._stops: dict[_Key, _Relayed] = {}

    def on_stop(
        self, stop: Stop, source: Address, now: float, *, is_member: bool = True
    ) -> list[Send]:
        """Take a copy of a stop, and relay the stop from now on if it is new.

        `source`: the sender of this copy, the operator or another robot. `is_member` False: the
        sender is no member of the swarm, so its copy does not count for REDUNDANCY. If the operator
        itself sent this copy, returns acks of other robots, which the operator may lack.
        `wants_ack` decides on this robot's own ack.
        """
        key = stop.id, stop.verb, stop.targets
        relayed = self._stops.get(key) or self._begin(stop, now)
        is_from_operator = stop.hops == 0
        relayed.take_ages(stop, now)
        # Relay the copy with the fewest hops, and the last of several such copies. If a robot
        # refuses the stop as replayed, the operator repeats the stop with a new origin and counter:
        # only the last copy has them.
        if stop.hops <= relayed.stop.hops:
            relayed.stop = replace(
                relayed.stop, hops=stop.hops, origin=stop.origin, counter=stop.counter
            )
        relayed.add_sender(source, is_operator=is_from_operator)
        if is_from_operator:
            relayed.heard_directly = now
            return self._acks_again(relayed, source, now)
        if is_member:
            relayed.copies += 1
        return []

    def _begin(self, stop: Stop, now: float) -> _Relayed:
        """Begin the first interval of a new stop; ends the relay of the oldest stop for room."""
        issued = now - stop.age / 1000.0
        while len(self._stops) >= MAX_STOPS:
            del self._stops[next(iter(self._stops))]
        relayed = self._stops[stop.id, stop.verb, stop.targets] = _Relayed(
            stop=stop,
            issued=issued,
            first_issued=issued,
            repeated=0.0,
            heard=now,
            interval=FIRST_INTERVAL,
            interval_ends=now + FIRST_INTERVAL,
            due=self._moment(now, FIRST_INTERVAL),
        )
        return relayed

    def _acks_again(self, relayed: _Relayed, source: Address, now: float) -> list[Send]:
        """The next ACKS_AT_ONCE acks of other robots for a sender that repeats the stop."""
        if now - relayed.acks_sent < ACK_PERIOD:
            return []
        relayed.acks_sent = now
        names = list(relayed.acks)[:ACKS_AT_ONCE]
        for name in names:
            relayed.acks[name] = relayed.acks.pop(name)
        return [(replace(relayed.acks[name], via=self._own), source) for name in names]

    def wants_ack(self, stop: Stop, source: Address, now: float) -> bool:
        """True if this robot should ack the stop to `source` now, at most once per ACK_PERIOD.

        A copy from another robot is not acked while the operator is heard directly.
        """
        relayed = self._stops.get((stop.id, stop.verb, stop.targets))
        if relayed is None or source not in relayed.sources:
            return False
        if stop.hops > 0 and now - relayed.heard_directly < DIRECT_TIMEOUT:
            return False
        if now - relayed.sources[source] < ACK_PERIOD:
            return False
        relayed.sources[source] = now
        return True

    def on_ack(self, ack: Ack, source: Address) -> list[Send]:
        """Take another robot's ack of a relayed stop; returns copies of the ack to hand on.

        The copies go to senders of the stop, but not to `source`, the sender of this ack. A copy
        names this robot as `via`.
        """
        if ack.robot == self._own:
            return []
        copy = replace(ack, via=self._own)
        # A stop with many targets is relayed in parts with one id. Each part has its own senders.
        parts = [relayed for (id, _, _), relayed in self._stops.items() if id == ack.id]
        return [(copy, address) for part in parts for address in part.receivers_of(ack, source)]

    def advance(
        self, now: float, is_over: Callable[[Stop, float], bool] = lambda stop, issued: False
    ) -> list[Stop]:
        """Returns the stops to send to all now, and begins intervals that are due (Trickle).

        A stop is sent at a random moment of its interval, unless REDUNDANCY other robots have sent
        it in that interval. `is_over(stop, issued)`: True for a stop, issued at `issued` s, that
        this robot would refuse; such a stop is not sent.
        """
        due: list[Stop] = []
        for key, relayed in list(self._stops.items()):
            age = now - relayed.issued
            if age - relayed.repeated > LIFETIME:  # s since the operator's own last copy
                del self._stops[key]
                continue
            if now >= relayed.due and relayed.due != _SENT:
                relayed.due = _SENT
                is_needed = relayed.copies < REDUNDANCY and self._is_needed(relayed, now)
                if is_needed and not is_over(relayed.stop, relayed.issued):
                    due.append(relayed.copy_to_send(now))
            if now >= relayed.interval_ends:
                self._begin_next_interval(relayed, now)
        return due

    def _begin_next_interval(self, relayed: _Relayed, now: float) -> None:
        """Begin an interval of twice the length, or a short interval while a base still moves."""
        # After TRUSTLESS_TIME an ack "moving" does not count: a forged ack would keep the intervals
        # short.
        is_new = now - relayed.heard < TRUSTLESS_TIME
        is_moving = is_new and any(ack.is_moving for ack in relayed.acks.values())
        doubled = min(2.0 * relayed.interval, LAST_INTERVAL)
        relayed.interval = FIRST_INTERVAL if is_moving else doubled
        relayed.due = self._moment(now, relayed.interval)
        relayed.interval_ends = now + relayed.interval
        relayed.copies = 0

    def wake_at(self) -> float | None:
        """When `advance` has something to do; None without a stop under way."""
        times = [
            relayed.due if relayed.due != _SENT else relayed.interval_ends
            for relayed in self._stops.values()
        ]
        return min(times, default=None)

    def _moment(self, now: float, interval: float) -> float:
        """A random moment of the interval that begins now."""
        return now + self._random.uniform(_FIRST_SHARE, _LAST_SHARE) * interval

    def _is_needed(self, relayed: _Relayed, now: float) -> bool:
        """False at MAX_HOPS, and once all targets other than this robot have acked and rest.

        Within TRUSTLESS_TIME after the first copy acks do not count.
        """
        stop = relayed.stop
        if stop.hops >= MAX_HOPS:
            return False
        if stop.targets is None:
            return True
        other_targets = {*stop.targets} - {self._own}
        is_new = now - relayed.heard < TRUSTLESS_TIME and bool(other_targets)
        resting = {name for name, ack in relayed.acks.items() if not ack.is_moving}
        return is_new or not other_targets <= resting
