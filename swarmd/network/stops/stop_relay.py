"""Relay of stops and emergency stops to other robots. Pure: datagrams and times in.

Each robot that hears a stop repeats it by the Trickle algorithm (RFC 6206):

1. Intervals double, from FIRST_INTERVAL to LAST_INTERVAL. The stop is sent at a random moment of
   each interval, unless REDUNDANCY other robots have sent it in that interval. So a hundred robots
   that all heard the operator send little, and a robot that only one of them reaches gets the stop.
2. The relay ends LIFETIME after the operator sent its last copy, or once all named targets have
   acked and rest. Each copy carries the age at which the operator sent it (`repeated`), so that a
   copy that travels in a circle does not prolong the relay.
3. A robot relays no stop that it would refuse itself.

Acks travel back by the same robots: a robot hands the acks that it gets to the senders of the stop,
with its own name as `via`.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field

from msgspec.structs import replace

from swarmd.network.datagram import MAX_HOPS, MAX_MS, Ack, Address, Stop
from swarmd.network.stops.stop_freshness import REPLAYED

_Key = tuple[str, str, tuple[str, ...] | None]
Send = tuple[Stop | Ack, Address | None]  # None: to all

FIRST_INTERVAL = 0.2  # s
LAST_INTERVAL = 6.4  # s
LIFETIME = 60.0  # s
REDUNDANCY = 2  # copies of other robots in an interval after which this robot does not send
MAX_STOPS = 64
MAX_SOURCES = 4
MAX_ACKS = 256
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
_FIRST_SHARE, _LAST_SHARE = 0.1, 1.0


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
    sources: dict[Address, float] = field(default_factory=dict)  # senders; last ack to each
    heard_directly: float = _NEVER  # the last copy of the operator itself
    acks: dict[str, Ack] = field(default_factory=dict)  # the last ack of each other robot
    acks_sent: float = _NEVER  # when acks of other robots were last returned
    handed_on: set[tuple[str, Address, bytes | None, str, bool]] = field(default_factory=set)
    """Acks that were handed on: robot, receiver, origin of a refusal, code, is_moving."""


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
        """Take a stop; returns the acks of other robots that its sender is to have.

        Ask `wants_ack` next for the robot's own ack. `is_member` False: the sender is no member of
        the swarm, so that its copy does not count for REDUNDANCY.
        """
        key = stop.id, stop.verb, stop.targets
        relayed = self._stops.get(key)
        issued = now - stop.age / 1000.0
        if relayed is None:
            while len(self._stops) >= MAX_STOPS:
                del self._stops[next(iter(self._stops))]
            relayed = _Relayed(
                stop, issued, issued, 0.0, now, FIRST_INTERVAL, now + FIRST_INTERVAL, 0.0
            )
            relayed.due = self._moment(now, FIRST_INTERVAL)
            self._stops[key] = relayed
        # Copies by several ways have different ages. A forged age must not make the stop look older
        # than the present run, which would be exempt from it.
        relayed.issued = max(min(relayed.issued, issued), relayed.first_issued - MAX_AGE_SHIFT)
        repeated = min(stop.repeated / 1000.0, now - relayed.issued)  # it may be forged, too
        relayed.repeated = max(relayed.repeated, repeated)
        if stop.hops <= relayed.stop.hops:
            origin = {"origin": stop.origin, "counter": stop.counter}
            relayed.stop = replace(relayed.stop, hops=stop.hops, **origin)
        if stop.hops == 0:
            relayed.heard_directly = now
        elif is_member:
            relayed.copies += 1
        if source not in relayed.sources:
            if stop.hops == 0 and len(relayed.sources) >= MAX_SOURCES:
                del relayed.sources[next(iter(relayed.sources))]
            if len(relayed.sources) < MAX_SOURCES:
                relayed.sources[source] = _NEVER
        if stop.hops == 0 and source in relayed.sources:  # the operator repeats: it may lack acks
            return self._acks_again(relayed, source, now)
        return []

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

    def on_ack(self, ack: Ack, source: Address, now: float) -> list[Send]:
        """Take another robot's ack of a relayed stop; returns copies for the stop's senders."""
        parts = [part for key, part in self._stops.items() if key[0] == ack.id]
        sends: list[Send] = []
        for relayed in parts:
            if ack.robot == self._own or len(relayed.acks) >= MAX_ACKS:
                continue
            handed = replace(ack, via=self._own)
            receivers = [address for address in relayed.sources if address != source]
            origin: bytes | None = None
            if ack.refusal == REPLAYED:  # the operator repeats the stop for this robot
                # Each refusal may have a new origin. A refusal that robots hand on again and again
                # travels in circles.
                origin = relayed.stop.origin
                if not ack.via:
                    sends += [(handed, address) for address in receivers]
                    continue
            elif not ack.is_moving or ack.robot not in relayed.acks:
                relayed.acks[ack.robot] = ack
            for address in receivers:
                key = ack.robot, address, origin, ack.code, ack.is_moving
                if key not in relayed.handed_on and len(relayed.handed_on) < MAX_HANDED_ON:
                    relayed.handed_on.add(key)
                    sends.append((handed, address))
        return sends

    def advance(
        self, now: float, is_over: Callable[[Stop, float], bool] = lambda stop, issued: False
    ) -> list[Stop]:
        """The stops to send to all now, and the begin of new intervals.

        `is_over(stop, issued)`: True for a stop that this robot would refuse; it is not sent.
        """
        due: list[Stop] = []
        for key, relayed in list(self._stops.items()):
            if now - relayed.issued - relayed.repeated > LIFETIME:
                del self._stops[key]
                continue
            if now >= relayed.due and relayed.due != _SENT:
                relayed.due = _SENT
                is_needed = relayed.copies < REDUNDANCY and self._is_needed(relayed, now)
                if is_needed and not is_over(relayed.stop, relayed.issued):
                    age, repeated = now - relayed.issued, relayed.repeated
                    hops = min(relayed.stop.hops + 1, MAX_HOPS)
                    ages = {
                        "age": min(round(age * 1000), MAX_MS),
                        "repeated": round(repeated * 1000),
                    }
                    due.append(replace(relayed.stop, hops=hops, **ages))
            if now >= relayed.interval_ends:
                doubled = min(2.0 * relayed.interval, LAST_INTERVAL)
                is_new = now - relayed.heard < TRUSTLESS_TIME
                moves = is_new and any(ack.is_moving for ack in relayed.acks.values())
                relayed.interval = FIRST_INTERVAL if moves else doubled
                relayed.due = self._moment(now, relayed.interval)
                relayed.interval_ends = now + relayed.interval
                relayed.copies = 0
        return due

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
        """False at MAX_HOPS, and once all other named targets have acked and rest.

        Within TRUSTLESS_TIME acks do not count.
        """
        stop = relayed.stop
        if stop.hops >= MAX_HOPS:
            return False
        if stop.targets is None:
            return True
        others = {*stop.targets} - {self._own}
        is_new = now - relayed.heard < TRUSTLESS_TIME and bool(others)
        resting = {name for name, ack in relayed.acks.items() if not ack.is_moving}
        return is_new or not others <= resting
