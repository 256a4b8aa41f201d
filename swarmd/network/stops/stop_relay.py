"""Stops and emergency stops that a robot passes on to others. Pure: datagrams and times in.

A stop that reaches one robot reaches all that this robot hears: it repeats the stop as the Trickle
algorithm does (RFC 6206): at intervals that double, at a random moment of each,
and not if REDUNDANCY others have sent it in that interval. So a hundred robots that all heard the
operator send little, and a robot that only one of them reaches gets it. It goes on until LIFETIME
after the operator sent its last copy, or until all named targets have acked and rest. Each copy has
the age at which the operator sent it, so that no copy that travels in a circle prolongs that. A
robot hands on no stop that it would refuse itself.

Acks travel back the same way: a robot hands those that it gets to the sender of the stop, with its
own name as `via`.
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
LAST_INTERVAL = 6.4
LIFETIME = 60.0
REDUNDANCY = 2
MAX_STOPS = 64
MAX_SOURCES = 4
MAX_ACKS = 256
MAX_HANDED_ON = 8 * MAX_ACKS * MAX_SOURCES
ACKS_AT_ONCE = 16  # acks of others that one repeat of a stop returns
MAX_AGE_SHIFT = 2.0  # s
# So long a stop is handed on whatever acks say, in s: one of them may be forged. So long it is also
# handed on at FIRST_INTERVAL while a base moves: of bases that rest after 1 s, 270 of 300 said so
# within 3 s at 30 % loss, at intervals that double 184.
TRUSTLESS_TIME = 3.0
DIRECT_TIMEOUT = 2.0  # the operator is heard directly if it was within this time, in s
ACK_PERIOD = 0.08  # between acks to one source, in s: an operator repeats at 10 Hz


@dataclass(slots=True)
class _Relayed:
    """A stop under way.

    `issued`: on the own clock. `repeated`: the greatest age at which the operator sent a copy, in
    s. `heard`: when the first copy came. `sources`: the senders, and when the last ack went to
    each.
    """

    stop: Stop
    issued: float
    first_issued: float
    repeated: float
    heard: float
    interval: float
    interval_ends: float
    due: float
    copies: int = 0
    sources: dict[Address, float] = field(default_factory=dict)
    heard_directly: float = -1e9
    acks: dict[str, Ack] = field(default_factory=dict)
    acks_sent: float = -1e9
    handed_on: set[tuple[str, Address, bytes | None, str, bool]] = field(default_factory=set)


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
        """A stop arrived; the acks of others that its sender is to have.

        `wants_ack` then shows whether the robot's own ack goes to this sender. Copies of senders
        that are no member (not `is_member`) do not keep this robot from handing it on.
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
            relayed.due = now + self._random.uniform(0.1, 1.0) * FIRST_INTERVAL
            self._stops[key] = relayed
        # Ages grow along different ways; a forged one must not make the stop look older than a run.
        relayed.issued = max(min(relayed.issued, issued), relayed.first_issued - MAX_AGE_SHIFT)
        repeated = min(stop.repeated / 1000.0, now - relayed.issued)  # it may be forged
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
                relayed.sources[source] = -1e9
        if stop.hops == 0 and source in relayed.sources:  # it repeats: it may lack some
            return self._acks_again(relayed, source, now)
        return []

    def _acks_again(self, relayed: _Relayed, source: Address, now: float) -> list[Send]:
        """Some acks of others for a sender that repeats the stop, in turn."""
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
        """Another robot acked a stop that this one handed on; whom to hand the ack to."""
        parts = [part for key, part in self._stops.items() if key[0] == ack.id]
        sends: list[Send] = []
        for relayed in parts:
            if ack.robot == self._own or len(relayed.acks) >= MAX_ACKS:
                continue
            handed = replace(ack, via=self._own)
            others = [address for address in relayed.sources if address != source]
            origin: bytes | None = None
            if ack.refusal == REPLAYED:  # the operator repeats the stop for this robot
                # Each refusal may have a new origin. A refusal that robots hand on again and again
                # travels in circles.
                origin = relayed.stop.origin
                if not ack.via:
                    sends += [(handed, address) for address in others]
                    continue
            elif not ack.is_moving or ack.robot not in relayed.acks:
                relayed.acks[ack.robot] = ack
            for address in others:
                key = ack.robot, address, origin, ack.code, ack.is_moving
                if key not in relayed.handed_on and len(relayed.handed_on) < MAX_HANDED_ON:
                    relayed.handed_on.add(key)
                    sends.append((handed, address))
        return sends

    def advance(
        self, now: float, is_over: Callable[[Stop, float], bool] = lambda stop, issued: False
    ) -> list[Stop]:
        """The stops to send to all now; none that `is_over`, which takes the time of its issue."""
        due: list[Stop] = []
        for key, relayed in list(self._stops.items()):
            if now - relayed.issued - relayed.repeated > LIFETIME:
                del self._stops[key]
                continue
            if now >= relayed.due and relayed.due >= 0.0:
                relayed.due = -1.0
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
                relayed.due = now + self._random.uniform(0.1, 1.0) * relayed.interval
                relayed.interval_ends = now + relayed.interval
                relayed.copies = 0
        return due

    def wake_at(self) -> float | None:
        """When `advance` has something to do; None without a stop under way."""
        times = [
            relayed.due if relayed.due >= 0.0 else relayed.interval_ends
            for relayed in self._stops.values()
        ]
        return min(times, default=None)

    def _is_needed(self, relayed: _Relayed, now: float) -> bool:
        stop = relayed.stop
        if stop.hops >= MAX_HOPS:
            return False
        if stop.targets is None:
            return True
        others = {*stop.targets} - {self._own}
        is_new = now - relayed.heard < TRUSTLESS_TIME and bool(others)
        rest = {name for name, ack in relayed.acks.items() if not ack.is_moving}
        return is_new or not others <= rest
