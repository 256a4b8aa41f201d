"""What one robot says and hears by datagrams. Pure: datagrams and times in, `Effects` out.

`Peer` joins the claim of the id, the membership, the spread of latches, the relay of stops and the
loss of pattern messages. The daemon sends what `Effects` holds and carries out the rest.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass, field

from swarmd.core.arrival_delay import ArrivalDelay
from swarmd.core.clock import ClockSample
from swarmd.core.messages import Body, Latch, State
from swarmd.core.token_bucket import TokenBucket
from swarmd.core.values import PeerPlace, SharedPose
from swarmd.network.claim import CLAIM_PERIOD, Claim
from swarmd.network.datagram import (
    STATES,
    Ack,
    Address,
    Beacon,
    BodyReport,
    ClockQuery,
    ClockReply,
    Datagram,
    Flag,
    Latches,
    MemberList,
    Message,
    Place,
    Solicit,
    Stop,
    Swarm,
    in_parts,
)
from swarmd.network.latch_sync import LatchSync, digest_of, latch_parts
from swarmd.network.membership import Membership
from swarmd.network.stop_relay import REDUNDANCY, StopRelay

BEACON_PERIOD = 1.0  # s
# While a latch is new, and at least between beacons of changes.
FAST_BEACON_PERIOD = 0.1
NEW_LATCH_TIME = 1.0
LATCH_REPEATS = (0.0, 0.1, 0.3)  # s after a latch is new: so often the latch itself is sent to all
# s between two questions for the clocks of peers; FIRST at the beginning, then twice as long.
CLOCK_PERIOD, FIRST_CLOCK_PERIOD = 10.0, 1.0
LIST_PERIOD = 10.0  # between questions for words, each to another member
# Datagrams a second that answer solicits, of all and of one host, and that answer a claimer.
ANSWER_RATE, ANSWER_RATE_OF_HOST = 100.0, 30.0
CLAIM_ANSWER_RATE = 40.0
MAX_HOSTS = 128
SYNC_TIMEOUT = 1.0  # a robot that joins waits so long for the latches of the others
MEMBERS_PERIOD = 0.25  # between looks for members that are silent
MESSAGE_WINDOW = 64
PLACE_PERIOD = 0.1  # s between datagrams of the own place, at least
FASTEST_DATAGRAM = 0.02  # s that the fastest takes at most: no clock shows it
_JITTER = 0.01  # s by which a tick may be early
_MAX_SENDERS = 1024


@dataclass(frozen=True, slots=True)
class Summary:
    """What a robot's beacon shows of it."""

    state: State
    revision: int
    latches: Mapping[str, Latch]


@dataclass(slots=True)
class Effects:
    """What follows from a datagram or from time.

    `sends`: datagrams, each to an address or (None) to all. `stops`: to be carried out, with their
    sources; the ack goes to the source if `wants_ack`. `latches`: of peers. `changed`: robots whose
    presence changed. `messages`: of patterns. `indirect_addresses`: of robots that others hear.
    `places`: of peers in a shared frame. `clocks`: times that peers answered. `duplicate`: another
    instance that has begun to own the id. `lost`: messages that are missing, or less than 0 for
    those that came late.
    """

    sends: list[tuple[Datagram, Address | None]] = field(default_factory=list)
    stops: list[tuple[Stop, Address]] = field(default_factory=list)
    latches: dict[str, Latch] = field(default_factory=dict)
    changed: list[str] = field(default_factory=list)
    messages: list[Message] = field(default_factory=list)
    places: list[PeerPlace] = field(default_factory=list)
    clocks: list[ClockSample] = field(default_factory=list)
    indirect_addresses: list[Address] = field(default_factory=list)
    duplicate: str = ""
    lost: int = 0


@dataclass(slots=True)
class _Window:
    """The messages of one sender: the highest sequence, and a bit for each of those before it."""

    instance: bytes
    highest: int
    seen: int = 1

    def take(self, sequence: int) -> tuple[bool, int]:
        """Whether a message is new, and the change of the number of lost ones."""
        ahead = sequence - self.highest
        if ahead >= MESSAGE_WINDOW:  # more are missing than can be told from another beginning
            self.seen, self.highest = 1, sequence
            return True, MESSAGE_WINDOW
        if ahead > 0:
            self.seen = ((self.seen << ahead) | 1) & ((1 << MESSAGE_WINDOW) - 1)
            self.highest = sequence
            return True, ahead - 1
        bit = 1 << -ahead
        if -ahead >= MESSAGE_WINDOW or self.seen & bit:
            return False, 0
        self.seen |= bit
        return True, -1


class Peer:
    """One robot among the others; `instance` has 6 bytes, `clock` is that of `clock_id`."""

    def __init__(
        self,
        *,
        robot: str,
        instance: bytes,
        swarm: str,
        profile: str,
        lease: float,
        settle: float,
        wire: int,
        version: str,
        roster: tuple[str, ...],
        now: float,
        body: Body | None = None,
        clock: str = "000000000000",
    ) -> None:
        self.robot = robot
        self.membership = Membership(robot, lease)
        self._instance = instance
        self._lease = lease
        self._swarm = Swarm(swarm=swarm, profile=profile, robot=robot)
        self._wire = wire
        self._version = version
        self._roster = roster
        self._body = None if body is None else BodyReport.of(body)
        self._random = random.Random(instance)
        self._claim: Claim | None = Claim(robot, instance, settle, now)
        self._settle = settle
        self._sync = LatchSync()
        self._relay = StopRelay(robot, self._random.getrandbits(32))
        self._sequence = 0
        self._message_sequence = 0
        self._beacon_at = now
        self._last_beacon = -math.inf
        self._shown: tuple[object, ...] = ()
        self._digest = b""
        self._digest_since = -math.inf
        self._latches_due: list[float] = []
        self._latch_copies = 0  # how often others have sent the same latches to all
        self._lists_at = now + self._random.uniform(0.0, 1.0)
        self._began = now
        self._windows: dict[str, _Window] = {}
        self._place_at = -math.inf
        self._place_delays: dict[str, tuple[bytes, ArrivalDelay]] = {}
        self._clock = clock
        self._clocks_at, self._clocks_pause = -math.inf, FIRST_CLOCK_PERIOD
        self._clocks_asked: dict[str, int] = {}
        self._duplicates: dict[bytes, float] = {}
        self._answers = TokenBucket(ANSWER_RATE, ANSWER_RATE)
        self._members_at = now
        self._answers_by_host: dict[str, TokenBucket] = {}
        self._claim_answers = TokenBucket(CLAIM_ANSWER_RATE, CLAIM_ANSWER_RATE)
        self._solicits_at = [now, now + 0.3]

    # State

    @property
    def owns_id(self) -> bool:
        """True once the claim of the id is won."""
        return self._claim is None

    @property
    def holder(self) -> str | None:
        """The instance that owns the id, if the claim is lost."""
        if self._claim is None or self._claim.holder is None:
            return None
        return self._claim.holder.hex()

    @property
    def duplicates(self) -> tuple[str, ...]:
        """Other instances that own this id now."""
        return tuple(name.hex() for name in self._duplicates)

    def is_in_sync(self, now: float) -> bool:
        """True once the latches of all peers that were heard are here, or SYNC_TIMEOUT is over."""
        return now - self._began >= self._settle + SYNC_TIMEOUT or not self._sync.is_open

    # Inputs

    def on_datagram(
        self, body: Datagram, source: Address, now: float, summary: Summary, *, is_any: bool = False
    ) -> Effects:
        """A datagram arrived; `is_any`: it is for any swarm."""
        effects = Effects()
        match body:
            case Beacon():
                self._on_beacon(body, source, now, summary, effects)
            case Solicit():
                self._on_solicit(body, source, now, summary, effects, is_any=is_any)
            case MemberList():
                self.membership.on_member_list(body, now)
                effects.indirect_addresses = [
                    (heard.host, heard.port)
                    for heard in body.members
                    if heard.hops == 0 and heard.presence == 0 and heard.port
                    and self.membership.indirect_address(heard.robot) == (heard.host, heard.port)
                ]  # fmt: skip
            case Stop():
                is_member = self.membership.is_address(source)
                sends = self._relay.on_stop(body, source, now, is_member=is_member)
                effects.sends.extend(sends)
                effects.stops.append((body, source))
            case Ack() if self.membership.knows(body.robot):
                effects.sends.extend(self._relay.on_ack(body, source, now))
            case Latches() if body.instance != self._instance:
                self._latch_copies += body.digest == self._digest
                self._sync.on_latches(body)
                effects.latches = dict(body.held)
            case Message() if body.robot != self.robot:
                self._on_message(body, effects)
            case ClockQuery() if self._claim is None and self._may_answer(source, 1, now):
                effects.sends.append((self._clock_reply(body, now), source))
            case ClockReply():
                self._on_clock(body, now, effects)
            case Place() if body.robot != self.robot and self.membership.knows(body.robot):
                self._on_place(body, now, effects)
        return effects

    def wants_ack(self, stop: Stop, source: Address, now: float) -> bool:
        """True if the sender of this stop is to have this robot's ack now."""
        return self._relay.wants_ack(stop, source, now)

    def message(self, channel: str, payload: bytes) -> Message:
        """The datagram of a pattern's message."""
        self._message_sequence += 1
        return Message(
            robot=self.robot,
            instance=self._instance,
            sequence=self._message_sequence,
            channel=channel,
            payload=payload,
        )

    def place(self, pose: SharedPose, age: float, now: float) -> Place | None:
        """The datagram of the own pose, measured `age` s ago; None if it is not due yet."""
        if self._claim is not None or now < self._place_at:
            return None
        self._place_at = now + PLACE_PERIOD - _JITTER
        return Place(
            robot=self.robot,
            instance=self._instance,
            sent=max(round(1000.0 * now), 0),
            age=math.ceil(1000.0 * max(age, 0.0)),
            frame=pose.frame,
            x=round(1000.0 * pose.pose.x),
            y=round(1000.0 * pose.pose.y),
            error=math.ceil(1000.0 * pose.error) + 1,  # that of rounding
        )

    def clock_queries(self, now: float) -> list[tuple[Datagram, Address | None]]:
        """Questions for the clocks of peers, if they are due: call it while a recording is made.

        Of all robots in the order of their names, in a ring, each asks those 1, 2, 4, ... places
        further: few questions, and a short path between any two.
        """
        if self._claim is not None or now < self._clocks_at:
            return []
        is_first = now > self._clocks_at + FIRST_CLOCK_PERIOD  # nothing was recorded until now
        self._clocks_pause = (
            FIRST_CLOCK_PERIOD if is_first else min(2 * self._clocks_pause, CLOCK_PERIOD)
        )
        self._clocks_at = now + self._clocks_pause
        alive = dict(self.membership.alive_addresses())
        ring = sorted([*alive, self.robot])
        place = ring.index(self.robot)
        asked = [ring[(place + 2**k) % len(ring)] for k in range((len(ring) - 1).bit_length())]
        query = ClockQuery(sent=max(round(1e9 * now), 0))
        self._clocks_asked = dict.fromkeys(asked, query.sent)
        return [(query, alive[robot]) for robot in dict.fromkeys(asked)]

    def leave_beacon(self, summary: Summary) -> Beacon:
        """The last beacon of a robot that leaves in order."""
        return self._beacon(summary, Flag.LEFT)

    def advance(self, now: float, summary: Summary) -> Effects:
        """Time passes; call it at `wake_at` and at least ten times a second."""
        effects = Effects()
        if self._claim is not None and self._claim.is_won(now):
            self._claim = None
            self._beacon_at = now
            effects.sends.append((Solicit(echo=0), None))
        while self._claim is not None and self._solicits_at and now >= self._solicits_at[0]:
            # The answers show the latches of the others before the claim is won.
            self._solicits_at.pop(0)
            effects.sends.append((Solicit(echo=0), None))
        if now >= self._members_at:
            self._members_at = now + MEMBERS_PERIOD
            self._advance_members(now, effects)
        self._send_latches_if_due(now, summary, effects)
        self._send_beacon_if_due(now, summary, effects)
        effects.sends.extend((stop, None) for stop in self._relay.advance(now))
        if now >= self._lists_at:
            self._lists_at = now + self._random.uniform(0.5, 1.5) * LIST_PERIOD
            alive = sorted(self.membership.alive_addresses())
            if alive:
                ask = Solicit(echo=0, wants_members=True)
                effects.sends.append((ask, self._random.choice(alive)[1]))
        return effects

    def _advance_members(self, now: float, effects: Effects) -> None:
        """End leases and solicit silent members, which takes a microsecond a member."""
        effects.changed = self.membership.advance(now)
        probe = Solicit(echo=0)
        effects.sends.extend((probe, address) for address in self.membership.to_probe(now))
        for instance, heard in list(self._duplicates.items()):
            if now - heard > self._lease:
                del self._duplicates[instance]

    def wake_at(self) -> float:
        """When `advance` is due next."""
        relay = self._relay.wake_at()
        return min(self._beacon_at, *self._latches_due[:1], math.inf if relay is None else relay)

    # Parts

    def _on_beacon(
        self, beacon: Beacon, source: Address, now: float, summary: Summary, effects: Effects
    ) -> None:
        if beacon.instance == self._instance:
            return
        if beacon.robot == self.robot:
            self._on_own_id(beacon, source, now, summary, effects)
            return
        if self.membership.on_beacon(beacon, source, now):
            effects.changed.append(beacon.robot)
        own = digest_of(summary.latches)
        is_owner = not beacon.flags & (Flag.JOINING | Flag.LEFT)
        is_stranger = not self.membership.is_established(beacon.robot)
        if is_owner and self._sync.wants(
            beacon.instance, beacon.latches, own, now, is_stranger=is_stranger
        ):
            effects.sends.append((Solicit(echo=0, wants_latches=True), source))

    def _on_own_id(
        self, beacon: Beacon, source: Address, now: float, summary: Summary, effects: Effects
    ) -> None:
        if self._claim is not None:
            self._claim.on_beacon(beacon, now)
        elif beacon.flags & Flag.JOINING:
            if self._claim_answers.take(1.0, now):
                effects.sends.append((self._beacon(summary), source))
        elif beacon.flags & Flag.LEFT:
            self._duplicates.pop(beacon.instance, None)
        elif len(self._duplicates) < MESSAGE_WINDOW:
            if beacon.instance not in self._duplicates:
                effects.duplicate = beacon.instance.hex()
            self._duplicates[beacon.instance] = now

    def _on_solicit(
        self,
        solicit: Solicit,
        source: Address,
        now: float,
        summary: Summary,
        effects: Effects,
        *,
        is_any: bool,
    ) -> None:
        if not self._may_answer(source, 1, now):
            return
        if is_any:
            effects.sends.append((self._swarm, source))
            return
        if self._claim is not None:
            return
        beacon = self._beacon(summary, echo=solicit.echo, version=self._version)
        effects.sends.append((beacon, source))
        if solicit.wants_members:
            parts = in_parts(self.membership.reports(now), roster=self._roster)
            if not self._may_answer(source, len(parts), now):
                return
            for number, (members, roster) in enumerate(parts):
                word = MemberList(
                    robot=self.robot,
                    instance=self._instance,
                    members=members,
                    part=number,
                    parts=len(parts),
                    echo=solicit.echo,
                    roster=roster,
                )
                effects.sends.append((word, source))
        if solicit.wants_latches:
            parts_ = latch_parts(self.robot, self._instance, summary.latches)
            effects.sends.extend((latches, source) for latches in parts_)

    def _clock_reply(self, query: ClockQuery, now: float) -> ClockReply:
        return ClockReply(
            robot=self.robot,
            clock=bytes.fromhex(self._clock),
            sent=query.sent,
            answered=max(round(1e9 * now), 0),
        )

    def _on_clock(self, reply: ClockReply, now: float, effects: Effects) -> None:
        if self._clocks_asked.get(reply.robot) != reply.sent:
            return  # late, or not asked for
        del self._clocks_asked[reply.robot]
        sent, answered = 1e-9 * reply.sent, 1e-9 * reply.answered
        sample = ClockSample(reply.robot, reply.clock.hex(), sent, answered, now)
        effects.clocks.append(sample)

    def _on_message(self, message: Message, effects: Effects) -> None:
        window = self._windows.get(message.robot)
        if window is None or window.instance != message.instance:
            self._windows.pop(message.robot, None)
            while len(self._windows) >= 1024:
                del self._windows[next(iter(self._windows))]
            self._windows[message.robot] = _Window(message.instance, message.sequence)
            effects.messages.append(message)
            return
        is_new, effects.lost = window.take(message.sequence)
        if is_new:
            effects.messages.append(message)

    def _on_place(self, place: Place, now: float, effects: Effects) -> None:
        instance, delay = self._place_delays.get(place.robot, (b"", ArrivalDelay()))
        if instance != place.instance:
            delay = ArrivalDelay()
            self._place_delays.pop(place.robot, None)
            while len(self._place_delays) >= _MAX_SENDERS:
                del self._place_delays[next(iter(self._place_delays))]
            self._place_delays[place.robot] = place.instance, delay
        late = delay.take(place.sent / 1000.0, now)
        if late is not None:
            x, y, error = place.x / 1000.0, place.y / 1000.0, place.error / 1000.0
            age = place.age / 1000.0 + late + FASTEST_DATAGRAM
            effects.places.append(PeerPlace(place.robot, place.frame, x, y, error, age))

    def _send_latches_if_due(self, now: float, summary: Summary, effects: Effects) -> None:
        digest = digest_of(summary.latches)
        if digest != self._digest:
            self._digest = digest
            self._latch_copies = 0
            self._latches_due = [now + delay for delay in LATCH_REPEATS] if digest else []
            self._digest_since = now if digest else -math.inf
            self._beacon_at = now
        if self._latches_due and now >= self._latches_due[0] and self._claim is None:
            self._latches_due.pop(0)
            if self._latch_copies < REDUNDANCY:
                parts = latch_parts(self.robot, self._instance, summary.latches)
                effects.sends.extend((latches, None) for latches in parts)

    def _send_beacon_if_due(self, now: float, summary: Summary, effects: Effects) -> None:
        shown = (summary.state, summary.revision, self._claim is None)
        if shown != self._shown:
            self._shown = shown
            self._beacon_at = min(self._beacon_at, self._last_beacon + FAST_BEACON_PERIOD)
        if now < self._beacon_at:
            return
        is_new = now - self._digest_since < NEW_LATCH_TIME
        if self._claim is not None:
            period = CLAIM_PERIOD
        else:
            period = FAST_BEACON_PERIOD if is_new else BEACON_PERIOD
        self._last_beacon, self._beacon_at = now, now + period
        flags = 0 if self._claim is None else Flag.JOINING
        effects.sends.append((self._beacon(summary, flags), None))

    def _beacon(
        self, summary: Summary, flags: int = 0, *, echo: int = 0, version: str = ""
    ) -> Beacon:
        self._sequence += 1
        return Beacon(
            robot=self.robot,
            instance=self._instance,
            sequence=self._sequence,
            wire=self._wire,
            state=STATES.index(summary.state),
            revision=summary.revision,
            flags=flags,
            latches=digest_of(summary.latches),
            echo=echo,
            version=version,
            body=self._body,
        )

    def _may_answer(self, source: Address, count: int, now: float) -> bool:
        """True if a host may have so many datagrams now, which are then taken from its budget."""
        # All robots of one machine have one host, and a robot behind routers has no port.
        host = f"{source[0]}:{source[1]}" if source[0].startswith("127.") else source[0]
        budget = self._answers_by_host.pop(host, None)
        if budget is None:
            budget = TokenBucket(ANSWER_RATE_OF_HOST, ANSWER_RATE_OF_HOST)
        self._answers_by_host[host] = budget
        while len(self._answers_by_host) > MAX_HOSTS:
            del self._answers_by_host[next(iter(self._answers_by_host))]
        return budget.take(count, now) and self._answers.take(count, now)
