"""The network of one daemon: datagrams between robots, and a Zenoh session that operators dial.

`Network` connects three parts: `PeerProtocol`, the pure datagram protocol, which makes all
decisions; `NetworkConnection` with the sockets and the session; and the daemon. All calls are on
the loop. The daemon's tick calls `advance`.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from msgspec.structs import replace

from swarmd.core import codec
from swarmd.core.clock import ClockSample, boottime, clock_id
from swarmd.core.codec import decode_value, encode
from swarmd.core.errors import CodecError, IdHeldError, fail_stop
from swarmd.core.events import (
    DriveInput,
    DuplicateInput,
    GoalInput,
    Input,
    KinInput,
    LatchesInput,
    LeaseInput,
    MessageInput,
    PeerFaultsInput,
    PlaceInput,
)
from swarmd.core.goal import Goal
from swarmd.core.kin_message import KinMessage
from swarmd.core.messages import Body, Member, Presence, Reply, Status
from swarmd.core.values import SharedPose, Twist
from swarmd.daemon.connection import NetworkConnection
from swarmd.daemon.datagram_guard import DatagramGuard
from swarmd.link.carriers.bus import ZenohBus
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.carriers.interface_watch import InterfaceChange
from swarmd.link.carriers.routed import RoutedCarrier
from swarmd.link.carriers.udp import UdpCarrier
from swarmd.link.datagram import (
    ANY_SWARM,
    Ack,
    Address,
    Beacon,
    Datagram,
    Flag,
    Message,
    Stop,
    Swarm,
    is_for_any_swarm,
    is_of_swarm,
    pack,
    tag_of,
    unpack,
)
from swarmd.link.keys.identity import Identity, authority_of
from swarmd.link.keys.roster import Role
from swarmd.link.members.link_quality import LinkQuality
from swarmd.link.members.membership import MAX_MEMBERS
from swarmd.link.peer import PeerActions, PeerProtocol, PeerSettings, StopVerdict, Summary
from swarmd.link.settings import NetworkSettings
from swarmd.link.signature import Author

log = logging.getLogger(__name__)

MAX_ACK_TEXT = 300  # bytes of the text of an ack, at most
CLAIM_WARNING = 5.0  # s of a claim after which the rivals are logged
MAX_CLAIM_PAUSE = 0.05  # s between two steps of a claim, at most
SYNC_PERIOD = 0.02  # s between two checks whether the latches of the peers have come


class NetworkOwner(Protocol):
    """The callbacks of a network to its daemon, all called on the loop."""

    def summary(self) -> Summary:
        """The robot's part of a beacon."""

    def status(self) -> Status:
        """The robot's status, for those that ask for it by datagram."""

    def on_input(self, input: Input) -> None:
        """Hand the robot an input that came from another robot, or a lease of an operator."""

    def on_stop(self, stop: Stop, source: Address, answer: Callable[[Reply], None]) -> None:
        """Carry out a stop or estop of an operator or relay; the reply goes to `answer`."""

    def judge_stop(self, stop: Stop, author: Author | None) -> StopVerdict:
        """What permits leave of a stop. `author`: its verified signer."""

    def on_refused_stop(
        self, stop: Stop, source: Address, text: str, answer: Callable[[Reply], None]
    ) -> None:
        """Audit a stop that its permit does not permit here; the reply goes to `answer`."""

    def on_clock(self, sample: ClockSample) -> None:
        """Record a reading of the clock of a peer."""

    def on_lost(self, beacon: Beacon) -> None:
        """A robot whose last beacon this is has failed."""

    def on_members(self) -> None:
        """Act on a change of the members or of their data."""

    def on_interface(self, change: InterfaceChange) -> None:
        """Act on a change of the interface."""

    def on_event(self, text: str) -> None:
        """Log a warning, also among the robot's events."""

    def on_newer_roster(self, robot: str, address: Address, generation: int) -> None:
        """Act on an unverified beacon that shows a roster of a greater generation."""

    def on_beacon(self, beacon: Beacon, address: Address) -> None:
        """Compare the digests in a peer's beacon with the own records."""

    def check_goal(self, goal: Goal, now: float) -> bool | None:
        """Whether the signature of a peer's goal is valid; None if it cannot be verified now."""

    def serve(self, bus: ZenohBus) -> None:
        """Answer operators and peers on a newly opened bus."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkRobot:
    """The properties of the own robot that its datagrams show."""

    name: str
    instance: str
    """Of this life of the daemon, in hex"""
    roster: tuple[str, ...]
    """The robots that the swarm expects"""
    version: str
    body: Body | None = None


class Network:
    """The network of one daemon: sends and receives, and hands results to the daemon."""

    def __init__(
        self,
        settings: NetworkSettings,
        robot: NetworkRobot,
        *,
        drops: DropCounter,
        identity: Identity | None = None,
        stop_counters: Path | None,
        hears_programs: bool = True,
    ) -> None:
        """Prepare the network; nothing is opened until `join`.

        `robot`: the properties of this robot that its datagrams show. `drops` counts messages that
        could not be read, handled or sent. `identity`: the keys of this robot; None in a swarm
        without keys. `stop_counters`: the file by which replayed stops are refused
        (`DatagramGuard`), required with an `identity`. `hears_programs` False: messages of Zenoh
        programs (sessions that are no robots) are neither taken nor sent.
        """
        self._settings = settings
        self._robot = robot
        self._roster = robot.roster  # replaced by the roster of each new identity
        self._instance = bytes.fromhex(robot.instance)  # id of this daemon process, as sent
        self._hears_programs = hears_programs
        self._identity = identity
        self._stop_counters = stop_counters
        self._owner: NetworkOwner  # from `join` on
        self._loop = asyncio.get_running_loop()
        self._tag = tag_of(settings.profile, settings.swarm, authority_of(identity))
        self.drops = drops
        self._guard: DatagramGuard | None = None  # signs and checks, in a secured swarm
        self._lost = 0  # messages of patterns that did not arrive
        # The sockets and the session, which call the methods `on_...` of this object.
        self._connection = NetworkConnection(settings, robot.name, self._tag, identity, drops, self)
        self._is_settled = False  # True once the id is owned and the latches of peers are known
        self._is_duplicate = False  # another daemon holds this robot's id
        self._is_full = False  # there were more members than MAX_MEMBERS
        self._protocol: PeerProtocol | None = None  # the datagram protocol, from `join` on

    # State

    @property
    def owns_id(self) -> bool:
        """True once the claim of the id has succeeded."""
        return self._protocol is not None and self._protocol.owns_id

    @property
    def members(self) -> Mapping[str, Member]:
        """By id: the other robots that were heard since the start and not forgotten."""
        return {} if self._protocol is None else self._protocol.membership.members(boottime())

    @property
    def bodies(self) -> Mapping[str, Body | None]:
        """By id: the body that each member reports, None before the report."""
        return {} if self._protocol is None else self._protocol.membership.bodies()

    @property
    def alive(self) -> tuple[str, ...]:
        """The other robots that are alive."""
        if self._protocol is None:
            return ()
        return tuple(robot for robot, _ in self._protocol.membership.alive_addresses())

    @property
    def programs(self) -> tuple[str, ...]:
        """The Zenoh programs whose tokens this robot sees."""
        bus = self._connection.bus
        return () if bus is None or bus.programs is None else bus.programs.names

    def links(self) -> Iterator[tuple[str, LinkQuality, tuple[str, ...]]]:
        """For each robot heard so far: id, link quality, and the routes of its datagrams."""
        if self._protocol is None:
            return
        now = boottime()
        for robot in self._protocol.membership.members(now):
            quality = self._protocol.links.quality(robot, now)
            address = self._protocol.membership.address(robot)
            if quality is not None and address is not None:
                yield robot, quality, self._ways_of(address, now)

    def link(self, robot: str) -> LinkQuality | None:
        """How well a robot is heard; None for a robot that was never heard."""
        return None if self._protocol is None else self._protocol.links.quality(robot, boottime())

    def _ways_of(self, address: Address, now: float) -> tuple[str, ...]:
        carrier = self._carrier
        return carrier.ways.of(address, now) if isinstance(carrier, UdpCarrier) else ("routed",)

    def heard(self) -> Iterator[tuple[str, str, float]]:
        """For each robot that is alive: id, host, and the share of its beacons that arrive here."""
        if self._protocol is None:
            return
        now = boottime()
        for robot, address in self._protocol.membership.alive_addresses():
            quality = self._protocol.links.quality(robot, now)
            if quality is not None:
                yield robot, address[0], 1.0 - quality.loss

    @property
    def roster(self) -> tuple[str, ...]:
        """The robots that the swarm expects."""
        return self._roster

    @property
    def interface_text(self) -> str:
        """The state of the interface in a few words; empty if no interface is watched."""
        return self._connection.interface_text

    @property
    def dropped(self) -> dict[str, int]:
        """Counts of dropped or lost messages by kind, such as `control/run:key` or `msg:lost`."""
        counts = self.drops.counts()
        if self._carrier is not None:
            counts |= self._carrier.dropped
            if self._carrier.unsent:
                counts["datagram:unsent"] = self._carrier.unsent
        if self._lost > 0:
            counts["msg:lost"] = self._lost
        if self._protocol is not None and self._protocol.membership.ignored:
            counts["members:full"] = self._protocol.membership.ignored
        return counts

    # Life

    async def join(self, owner: NetworkOwner) -> None:
        """Open the network, claim the robot's id, get the latches of the peers, serve operators.

        A claim is won if no other daemon shows the same id for `settings.settle` s. Raises
        NetworkError if the network cannot be opened, IdHeldError if another daemon has the id.
        """
        self._owner = owner
        if self._identity is not None:
            self._guard = self._guard_of(self._identity, owner)
        await self._connection.open()
        self._protocol = self._made_protocol(owner)
        await self._claim(self._protocol)
        while not self._protocol.is_in_sync(boottime()):  # with the latches of the peers
            await asyncio.sleep(SYNC_PERIOD)
        self._is_settled = True
        self._serve()

    def _guard_of(self, identity: Identity, owner: NetworkOwner) -> DatagramGuard:
        assert self._stop_counters is not None
        return DatagramGuard(
            identity,
            self._tag,
            self._settings.lease_seconds,
            self._stop_counters,
            self.drops,
            on_event=owner.on_event,
            on_newer_roster=owner.on_newer_roster,
        )

    def _made_protocol(self, owner: NetworkOwner) -> PeerProtocol:
        """The datagram protocol, which begins to claim the id of this robot."""
        settings = self._settings
        return PeerProtocol(
            PeerSettings(
                robot=self._robot.name,
                instance=self._instance,
                swarm=settings.swarm,
                profile=settings.profile,
                lease=settings.lease_seconds,
                settle=settings.settle,
                wire=codec.VERSION,
                version=self._robot.version,
                body=self._robot.body,
                clock=clock_id(),
            ),
            roster=self._roster,
            now=boottime(),
            admission=None if self._guard is None else self._guard.admission,
            check_goal=owner.check_goal,
            judge_stop=owner.judge_stop,
            make_status=lambda: encode(owner.status()),
        )

    async def _claim(self, protocol: PeerProtocol) -> None:
        """Wait until the id is claimed; IdHeldError if a daemon owns the id already (the holder).

        The claim lasts longer while another daemon (a rival) claims the id, too.
        """
        warn_at = boottime() + CLAIM_WARNING
        while not protocol.owns_id:
            self.advance()
            if boottime() > warn_at:
                warn_at = float("inf")  # warn once
                _warn_of_claim(self._robot.name, protocol.rivals)
            if holder := protocol.holder:
                raise IdHeldError(
                    f"robot id {self._robot.name!r} is held by another daemon (instance {holder});"
                    " stop it, or give this one another id"
                )
            due_in = protocol.wake_at() - boottime()
            await asyncio.sleep(max(0.0, min(due_in, MAX_CLAIM_PAUSE)))

    def advance(self, *, may_wait: bool = False) -> None:
        """Take messages of programs, and send the datagrams that are due; each tick calls this.

        `may_wait`: no event in the last tick. Then nothing but the messages is looked at before
        `PeerProtocol.wake_at`, so that a tick in between takes 20 us instead of 140.
        """
        protocol = self._protocol
        if protocol is None or self._carrier is None:
            return
        now = boottime()
        bus = self._connection.bus
        if bus is not None and bus.programs is not None:
            for message in bus.programs.take(now):
                self._owner.on_input(MessageInput(*message, is_program=True))
        if may_wait and now < protocol.wake_at():
            return
        self._carry_out(protocol.advance(now, self._owner.summary()))
        self._connection.watch_for_flood(now)
        if self._guard is not None and self._guard.has_new_counters():
            self._loop.run_in_executor(None, self._guard.write_counters)
        if protocol.membership.ignored and not self._is_full:
            self._is_full = True
            self._owner.on_event(
                f"more than {MAX_MEMBERS} robots are alive: further ones are ignored"
            )
        if self._is_duplicate and not protocol.duplicates:
            self._is_duplicate = False
            self._owner.on_input(DuplicateInput(None))

    def publish_message(self, channel: str, payload: bytes) -> None:
        """Send a pattern's message to all robots, and to Zenoh programs that subscribe to it."""
        if self._protocol is not None and self._protocol.owns_id:
            self._send(self._protocol.message(channel, payload), None)
            bus = self._connection.bus
            if bus is not None and bus.programs is not None:
                bus.programs.publish(channel, payload)

    def publish_pose(self, pose: SharedPose, age: float) -> None:
        """Send the own pose, measured `age` s ago, to all robots; dropped if none is due yet."""
        place = None if self._protocol is None else self._protocol.place(pose, age, boottime())
        if place is not None:
            self._send(place, None)

    def publish_kin_message(self, message: KinMessage) -> None:
        """Tell all robots the own motion, and what this robot sees."""
        report = None if self._protocol is None else self._protocol.kin_report(message)
        if report is not None:
            self._send(report, None)

    def ask_clocks(self) -> None:
        """Ask peers for their clocks if a reading is due; the answers go to `on_clock`."""
        if self._protocol is not None:
            for body, address in self._protocol.clock_queries(boottime()):
                self._send(body, address)

    def ping(self, robots: Iterable[str]) -> None:
        """Ping the alive robots among `robots`; the answers give the round trips in `links`."""
        if self._protocol is not None:
            for body, address in self._protocol.pings(robots, boottime()):
                self._send(body, address)

    def publish(self, name: str, payload: Callable[[], bytes | None]) -> None:
        """Publish a name of the table `PUBLISHED`; `payload` is called if someone subscribes."""
        bus = self._connection.bus
        if bus is not None and self.owns_id:
            bus.publish(name, payload)

    def forget(self, robot: str) -> bool:
        """Remove a robot from the members; False if the robot is alive."""
        assert self._protocol is not None
        member = self._protocol.membership.member(robot, boottime())
        if member is not None and member.presence is Presence.ALIVE:
            return False
        self._protocol.membership.forget(robot)
        return True

    def close(self, *, is_leaving: bool) -> None:
        """Close at once; `is_leaving`: first announce to the peers that this robot leaves."""
        if is_leaving and self._protocol is not None and self._protocol.owns_id:
            for _ in range(2):
                self._send(self._protocol.leave_beacon(self._owner.summary()), None)
        self._connection.close()

    def take_identity(self, identity: Identity) -> None:
        """Use roster, keys and certificate of `identity` from now on.

        Carrier and session are reopened after a moment, in which pending answers are sent. They
        stay closed if the roster lacks the identity's name.
        """
        self._roster = identity.roster.robots
        if self._guard is not None:
            self._guard.take(identity)
        if self._protocol is not None:
            self._protocol.take_roster(self._roster)
        self._connection.take_identity(identity)

    # Datagrams

    @property
    def _carrier(self) -> UdpCarrier | RoutedCarrier | None:
        return self._connection.carrier

    # Of the connection

    def on_interface(self, change: InterfaceChange) -> None:
        """Hand a change of the interface to the daemon, before anything is reopened."""
        self._owner.on_interface(change)

    def on_reopened(self) -> None:
        """Serve on the reopened session."""
        self._serve()

    def on_event(self, text: str) -> None:
        """Hand a line for the events to the daemon."""
        self._owner.on_event(text)

    def on_datagram(self, payload: bytes, source: Address, waited: float) -> None:
        """Handle a datagram, which waited for `waited` s before it was read."""
        with self.drops.refusing("datagram"):
            self._take(payload, source, waited)

    def _take(self, payload: bytes, source: Address, waited: float) -> None:
        if self._protocol is None:
            return
        now = boottime()
        author = None
        if self._guard is not None and is_of_swarm(self._tag, payload):
            author = self._guard.author_of(payload, source, now)
            if author is None:
                return
            is_operator = author.role is Role.OPERATOR
            self._connection.admit_links_from(source, now, is_operator=is_operator)
        body = unpack(self._tag, payload)
        if body is None:
            return
        # An exception in the handling of a stop ends the daemon, which stops the robot.
        handle = fail_stop(self._handle) if isinstance(body, Stop) else self._handle
        handle(self._protocol, body, source, author, waited, is_any=is_for_any_swarm(payload))

    def _handle(
        self,
        protocol: PeerProtocol,
        body: Datagram,
        source: Address,
        author: Author | None,
        waited: float,
        *,
        is_any: bool,
    ) -> None:
        """Hand a datagram to the protocol, and carry out what follows from the datagram.

        `author`: the verified signer; None in a swarm without keys. `waited`: s from arrival until
        the datagram was read. `is_any`: the datagram addresses robots of all swarms, such as a
        query for the names of swarms.
        """
        actions = protocol.on_datagram(
            body,
            source,
            boottime(),
            self._owner.summary(),
            is_any=is_any,
            author=author,
            waited=waited,
        )
        for stop, sender in actions.stops:
            # In a secured swarm a repeated stop may be an attacker's replay.
            stop_to_obey = _as_relayed(stop) if actions.is_repeated else stop
            self._owner.on_stop(stop_to_obey, sender, partial(self._ack, stop, sender, author))
        if self._guard is not None:
            if actions.flaw is not None:  # the datagram was refused
                self._guard.count(actions.flaw, source, boottime())
            else:
                self._confirm_member(body, source)
            self._refuse_replays(self._guard, actions, author)
            for stop, sender, text in actions.refused:
                answer = partial(self._answer_refused, self._guard, stop, sender, author)
                self._owner.on_refused_stop(stop, sender, text, answer)
        self._carry_out(actions, source, author)

    def _confirm_member(self, body: Datagram, source: Address) -> None:
        """Tell the carrier that `source` is a member, if `body` is the beacon of a member."""
        is_of_member = isinstance(body, Beacon) and not body.flags & Flag.JOINING
        if is_of_member and self._carrier is not None:
            self._carrier.confirm(source)

    def _refuse_replays(
        self, guard: DatagramGuard, actions: PeerActions, author: Author | None
    ) -> None:
        """Answer replayed stops with a refusal, at a limited rate."""
        for stop, sender in actions.replayed:
            refusal = guard.refusal(stop, sender, self._refused_ack(stop.id), boottime())
            if refusal is not None:
                self._send(refusal, sender, author)

    def _answer_refused(
        self, guard: DatagramGuard, stop: Stop, sender: Address, author: Author | None, reply: Reply
    ) -> None:
        """Answer a stop that its permit does not permit here, at a limited rate."""
        ack = replace(self._refused_ack(stop.id), refusal=reply.refusal, text=_ack_text(reply.text))
        refusal = guard.denial(stop, ack, boottime())
        if refusal is not None:
            self._send(refusal, sender, author)

    def _refused_ack(self, id: str) -> Ack:
        """The ack of a stop that was refused before the robot saw it."""
        return Ack(
            id=id, robot=self._robot.name, instance=self._instance, revision=0, code="refused"
        )

    def _carry_out(
        self, actions: PeerActions, source: Address | None = None, author: Author | None = None
    ) -> None:
        """Send the datagrams of the protocol, and hand its results to the daemon.

        `source`, `author`: sender and signer of the datagram that led to `actions`; None if time
        has led to `actions`.
        """
        for body, address in actions.sends:
            is_answer = address == source
            self._send(body, address, author if is_answer else None)
        self._add_recipients(actions.indirect_addresses)
        self._lost += actions.lost
        self._hand_inputs(actions)
        for sample in actions.clocks:
            self._owner.on_clock(sample)
        if actions.beacon is not None and source is not None:
            self._owner.on_beacon(actions.beacon, self._connection.local(source))
        if actions.duplicate:
            self._is_duplicate = True
            self._owner.on_input(DuplicateInput(f"instance {actions.duplicate}"))
        if actions.changed:
            self._owner.on_members()
        for robot in actions.changed:
            lost = None if self._protocol is None else self._protocol.membership.lost_beacon(robot)
            if lost is not None:
                self._owner.on_lost(lost)

    def _add_recipients(self, addresses: Iterable[Address]) -> None:
        """Send datagrams also to robots that are known only from the member lists of peers."""
        if self._carrier is not None:
            for address in addresses:
                self._carrier.recipients.on_mentioned(self._connection.local(address), boottime())

    def _hand_inputs(self, actions: PeerActions) -> None:
        """Hand the robot what its peers and operators have sent, and count invalid goals."""
        if actions.latches:
            self._owner.on_input(LatchesInput(dict(actions.latches)))
        for received in actions.goals:
            self._owner.on_input(GoalInput(received.goal, received.age, received.may_join))
        for heard in actions.leases:
            if heard.age is None:
                self.drops.add("lease:unproven")
            self._owner.on_input(LeaseInput(heard.lease.id, heard.lease.count, heard.age))
        for drive in actions.drives:
            twist = Twist(drive.linear, drive.angular, drive.lateral)
            sent = drive.sent / 1000.0  # s; the datagram has ms
            self._owner.on_input(DriveInput(drive.hand, drive.operator, drive.order, sent, twist))
        for _ in range(actions.invalid_goals):
            self.drops.add("goal:invalid")
        for message in actions.messages:
            self._take_message(message)
        for place in actions.places:
            self._owner.on_input(PlaceInput(place))
        for report in actions.kin:
            self._owner.on_input(KinInput(report.robot, report.message))
        if actions.peer_faults is not None:
            self._owner.on_input(PeerFaultsInput(actions.peer_faults))

    def _take_message(self, message: Message) -> None:
        try:
            value = decode_value(message.payload)
        except CodecError:
            self.drops.add("msg:malformed")
        else:
            size = len(message.payload)
            self._owner.on_input(MessageInput(message.robot, message.channel, value, size=size))

    def _ack(self, stop: Stop, source: Address, author: Author | None, reply: Reply) -> None:
        """Send the robot's reply to the sender of the stop, if an ack is due now."""
        protocol = self._protocol
        if (
            protocol is None
            or not protocol.owns_id
            or not protocol.wants_ack(stop, source, boottime())
        ):
            return
        ack = Ack(
            id=reply.id,
            robot=self._robot.name,
            instance=self._instance,
            revision=0 if reply.epoch is None else reply.epoch.revision,
            code=reply.code,
            refusal=reply.refusal,
            text=_ack_text(reply.text),
            is_moving=reply.is_moving,
        )
        if self._guard is not None:
            ack = self._guard.proven(ack, stop)
        self._send(ack, source, author)

    def _send(self, body: Datagram, address: Address | None, asker: Author | None = None) -> None:
        """Send a datagram to `address`, None: to all. `asker`: the operator or viewer answered."""
        if self._carrier is None:
            return
        is_any = isinstance(body, Swarm)
        try:
            payload = pack(ANY_SWARM if is_any else self._tag, body)
            if self._guard is not None and not is_any:
                payload = self._guard.sign(payload, asker)
        except CodecError:
            self.drops.add("datagram:oversized")
            return
        if address is None:
            self._carrier.send(payload)
        else:
            self._carrier.send_to(payload, address)

    def _serve(self) -> None:
        """Answer operators, once the id is owned and the latches of the peers are known."""
        bus = self._connection.bus
        if bus is not None and self._is_settled:
            # Behind routers the bus would also deliver the messages of robots, a second time.
            takes_messages = self._hears_programs and self._settings.profile != "routed"
            bus.meet_programs(self.is_robot, takes_messages=takes_messages)
            self._owner.serve(bus)

    def is_robot(self, name: str) -> bool:
        """True for this robot, for robots of the roster, and for robots heard here or by others."""
        if name == self._robot.name or name in self._roster or self._protocol is None:
            return True
        membership = self._protocol.membership
        return name in membership.indirect or membership.member(name, boottime()) is not None


def _ack_text(text: str) -> str:
    """The text, cut to the bytes that an ack may have."""
    return text.encode()[:MAX_ACK_TEXT].decode(errors="ignore")


def _as_relayed(stop: Stop) -> Stop:
    """A copy of the stop that says that a robot relayed the stop (1 hop or more).

    In a secured swarm each further copy of a stop gets this mark, since an attacker may have
    recorded and replayed it. A relayed emergency stop does not renew a latch that was reset, and
    with the mark a replayed copy does not renew the latch either.
    """
    return replace(stop, hops=max(stop.hops, 1))


def _warn_of_claim(robot: str, rivals: Collection[str]) -> None:
    """Log the reason why the claim of an id takes long."""
    if rivals:
        log.warning(
            "the id %s is also claimed by the daemon %s; waiting for it", robot, ", ".join(rivals)
        )
    else:
        log.warning("the claim of the id %s takes long: this computer is busy", robot)
