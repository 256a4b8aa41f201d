"""The datagram protocol of one robot. Pure: datagrams and times in, `PeerActions` out.

`PeerProtocol` combines the claim of the robot id, the membership, the spread of latches (held
emergency stops) and goals, the relay of stops, and the loss count of pattern messages. The daemon
sends the datagrams in `PeerActions.sends`, and carries out the other fields of `PeerActions`.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

from msgspec.structs import replace

from swarmd.core.clock import ClockSample
from swarmd.core.goal import Goal, HeldGoal, encode_goal
from swarmd.core.kin_message import KinMessage
from swarmd.core.messages import Body, Latch, PeerFault, Presence, State
from swarmd.core.record import RecordKind
from swarmd.core.values import PeerPlace, SharedPose
from swarmd.link.datagram import (
    PRESENCES,
    STATES,
    Ack,
    Address,
    Beacon,
    BodyReport,
    ClockQuery,
    ClockReply,
    Datagram,
    Drive,
    Flag,
    GoalReport,
    KinReport,
    Latches,
    MemberList,
    Message,
    Place,
    RunLease,
    Solicit,
    StatusPart,
    Stop,
    Swarm,
    in_parts,
    status_parts,
)
from swarmd.link.keys.roster import Role
from swarmd.link.members.admission import Admission
from swarmd.link.members.answer_budget import AnswerBudget
from swarmd.link.members.beacon_times import BEACON_PERIOD, BeaconTimes
from swarmd.link.members.claim import CLAIM_PERIOD, Claim
from swarmd.link.members.hearing import Hearing, Report
from swarmd.link.members.lease_freshness import lease_age
from swarmd.link.members.link_quality import LinkQualities
from swarmd.link.members.membership import MAX_MEMBERS, Membership
from swarmd.link.members.message_windows import MessageWindows
from swarmd.link.members.peer_clocks import PeerClocks
from swarmd.link.members.peer_places import PeerPlaces
from swarmd.link.signature import Author, Flaw
from swarmd.link.spread.goal_sync import FoundGoal, GoalSync
from swarmd.link.spread.latch_sync import LatchSync, digest_of, latch_parts
from swarmd.link.stops.stop_relay import StopRelay

LIST_PERIOD = 10.0  # s between two requests for a member list, each to a random member
SYNC_TIMEOUT = 1.0  # s for which a robot that joins waits for the latches of its peers
MEMBERS_PERIOD = 0.25  # s between two searches for silent members
# s from the last new peer until a robot joins a run: within a beacon period all peers show their
# goals, and a goal without a pattern (a stop) may be among them.
JOIN_SETTLE = 1.5 * BEACON_PERIOD
# While many robots start together, the beacons of all claims per second, and the least of each.
CLAIMS_PER_SECOND = 400.0
CLAIM_BEACONS = 4
STARTING_TOGETHER = 8  # others; from this number on a robot that owns its id asks for no beacons
MAX_DUPLICATES = 64  # other instances with this robot's id

CheckGoal = Callable[[Goal, float], bool | None]


class StopVerdict(NamedTuple):
    """What a robot does with a stop that its permit bounds.

    `relayed`: the stop as this robot carries it out and relays it, with the robots that it may
    reach; None: no robot. `refusal`: why this robot refuses the stop; empty if it does not.
    """

    relayed: Stop | None
    refusal: str = ""


JudgeStop = Callable[[Stop, Author | None], StopVerdict]
MakeStatus = Callable[[], bytes]


@dataclass(frozen=True, slots=True)
class Summary:
    """The robot's state for its beacon, and the stops that the robot no longer relays."""

    state: State
    revision: int
    latches: Mapping[str, Latch]
    goal: HeldGoal | None = None
    pulled: Mapping[RecordKind, bytes] = field(default_factory=dict)
    """The digests of the records that robots pull over Zenoh."""
    wished: float = -math.inf
    """s at which the present run was requested: earlier stops of this robot are not relayed"""
    reset_at: float = -math.inf
    """s of the last reset: earlier stops of all robots are not relayed"""
    cleared: Collection[str] = ()
    """The ids of emergency stops that were reset, and are not relayed."""

    @property
    def digests(self) -> tuple[bytes, ...]:
        """The digests by kind, in the order of `RecordKind`; empty for a kind without a record."""
        goal = b"" if self.goal is None else self.goal.digest
        by_kind = {RecordKind.LATCH: digest_of(self.latches), RecordKind.GOAL: goal, **self.pulled}
        return tuple(by_kind.get(kind, b"") for kind in RecordKind)


class HeardLease(NamedTuple):
    """A lease of an operator.

    `age`: s since it was sent, at most; None: it may be a replayed one. 0 in a swarm without keys.
    """

    lease: RunLease
    age: float | None


@dataclass(slots=True)
class PeerActions:
    """What the daemon must do after a datagram, or after time has passed."""

    sends: list[tuple[Datagram, Address | None]] = field(default_factory=list)
    """Datagrams with their receiver; None: all."""
    stops: list[tuple[Stop, Address]] = field(default_factory=list)
    """Stops to carry out, with their senders, which get an ack if `PeerProtocol.wants_ack`."""
    latches: dict[str, Latch] = field(default_factory=dict)  # latches that peers have shown, by id
    changed: list[str] = field(default_factory=list)  # robots whose presence changed
    messages: list[Message] = field(default_factory=list)  # messages from patterns of peers
    places: list[PeerPlace] = field(default_factory=list)  # places of peers in a shared frame
    kin: list[KinReport] = field(default_factory=list)  # the motion of peers, and what they see
    clocks: list[ClockSample] = field(default_factory=list)  # answers of peers to clock queries
    indirect_addresses: list[Address] = field(default_factory=list)
    """The addresses of robots that other robots hear."""
    beacon: Beacon | None = None
    """The beacon of a robot that owns its id; the digests of pulled kinds may be new."""
    duplicate: str = ""
    """Another instance that has begun to own this robot's id."""
    lost: int = 0
    """The change of the number of lost messages; below 0 if a message came late."""
    flaw: Flaw | None = None
    """In a secured swarm: why the datagram is dropped."""
    replayed: list[tuple[Stop, Address]] = field(default_factory=list)
    """In a secured swarm: stops that are refused as replayed."""
    refused: list[tuple[Stop, Address, str]] = field(default_factory=list)
    """In a secured swarm: stops that no permit permits here, with their senders and the reason."""
    is_repeated: bool = False
    """In a secured swarm: an earlier copy of the stop was heard."""
    goals: list[FoundGoal] = field(default_factory=list)  # goals that peers have shown
    invalid_goals: int = 0  # goals that their issuer has not signed
    leases: list[HeardLease] = field(default_factory=list)  # leases of operators
    drives: list[Drive] = field(default_factory=list)  # commands of a hand on this robot
    peer_faults: tuple[PeerFault, ...] | None = None
    """The faults of robots that peers tell, once they have changed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerSettings:
    """The identity that a peer states in its datagrams, and the times of its swarm."""

    robot: str
    instance: bytes
    """6 bytes"""
    swarm: str
    profile: str
    lease: float
    """s after which a member that is silent has failed"""
    settle: float
    """s that the claim of the id takes"""
    wire: int
    version: str
    body: Body | None = None
    clock: str = "000000000000"
    """The id of the clock from which `now` is read"""


class PeerProtocol:
    """The protocol state of one robot.

    `roster`: the robots that the swarm expects. `admission`: the checks of a secured swarm; None:
    the swarm is not secured. `check_goal(goal, now)`: True if the goal of a peer is accepted, False
    if it is not signed, None if the check must wait (`GoalCheck`). `judge_stop(stop, author)`: what
    permits leave of a stop; it is called for each copy, before the robot relays it.
    `make_status()`: the robot's encoded status, for those that solicit it; empty: none is told.
    """

    def __init__(
        self,
        settings: PeerSettings,
        *,
        roster: tuple[str, ...],
        now: float,
        admission: Admission | None = None,
        check_goal: CheckGoal = lambda goal, now: True,
        judge_stop: JudgeStop = lambda stop, author: StopVerdict(stop),
        make_status: MakeStatus = bytes,
    ) -> None:
        self.robot = settings.robot
        self._instance = settings.instance
        self._settings = settings
        self._admission = admission
        self._roster = roster
        self._check_goal = check_goal
        self._judge_stop = judge_stop
        self._make_status = make_status
        self._random = random.Random(settings.instance)
        self._begin_membership(settings, now)
        self._begin_spread()
        self._begin_datagrams(settings, now)

    def _begin_membership(self, settings: PeerSettings, now: float) -> None:
        """Set up the claim of the id, and the state of members and links."""
        self.membership = Membership(settings.robot, settings.lease)
        self.links = LinkQualities(BEACON_PERIOD)
        self.hearing = Hearing(settings.robot)
        # None once this robot owns its id.
        self._claim: Claim | None = Claim(settings.robot, settings.instance, settings.settle, now)
        self._began = now
        self._members_at = now
        self._new_peer_at = now  # when a peer was heard for the first time, or returned
        self._starting: set[str] = set()  # robots that claim their ids while this robot does
        self._duplicates: dict[bytes, float] = {}
        self._windows = MessageWindows()
        self._places = PeerPlaces(settings.robot, settings.instance)
        self._clocks = PeerClocks(settings.robot, settings.clock)

    def _begin_spread(self) -> None:
        """Set up the spread of latches, goals and stops."""
        self._sync = LatchSync()
        self._goal_sync = GoalSync(self._random.getrandbits(32))
        self._is_join_due = False  # a goal was found, and those of other peers may be greater
        self._relay = StopRelay(self.robot, self._random.getrandbits(32))

    def _begin_datagrams(self, settings: PeerSettings, now: float) -> None:
        """Set up the robot's own datagrams, their times, and the budget of answers."""
        self._swarm = Swarm(swarm=settings.swarm, profile=settings.profile, robot=settings.robot)
        self._body = None if settings.body is None else BodyReport.of(settings.body)
        self._sequence = 0
        self._message_sequence = 0
        self._sent = 0  # messages, places and kin reports
        self._times = BeaconTimes(now)
        self._lists_at = now + self._random.uniform(0.0, 1.0)
        self._solicits_at = [now, now + 0.3]
        self._answers = AnswerBudget()

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
    def rivals(self) -> tuple[str, ...]:
        """The instances that were heard to own or claim the id, while the own claim is open."""
        return () if self._claim is None else tuple(rival.hex() for rival in self._claim.rivals)

    @property
    def duplicates(self) -> tuple[str, ...]:
        """Other instances that own this id now."""
        return tuple(name.hex() for name in self._duplicates)

    def is_in_sync(self, now: float) -> bool:
        """True once all peers heard have sent their latches, or SYNC_TIMEOUT is over."""
        admission = self._admission
        awaits_latches = self._sync.is_open
        awaits_latches |= admission is not None and admission.freshness.awaits_latches(now)
        is_over = now - self._began >= self._settings.settle + SYNC_TIMEOUT
        return is_over or not awaits_latches

    # Inputs

    def on_datagram(
        self,
        body: Datagram,
        source: Address,
        now: float,
        summary: Summary,
        *,
        is_any: bool = False,
        author: Author | None = None,
        waited: float = 0.0,
    ) -> PeerActions:
        """Take a datagram; returns the datagrams to send, and what the daemon must carry out.

        `source`: the address of the sender. `summary`: this robot's state, latches and goal.
        `is_any`: a `Solicit` or `Swarm` for any swarm, which is never signed. `author`: the signer
        in a secured swarm, None without a valid signature. `waited`: s from arrival until now, for
        example while the process was frozen. If the datagram is refused, `PeerActions.flaw` says
        why.
        """
        actions = PeerActions()
        if isinstance(body, Stop) and waited > 0.0:
            body = replace(body, age=body.age + round(1000.0 * waited))  # ms

        # In a secured swarm: check the role of the signer, and that the datagram is no replay. The
        # sender of a beacon that may be replayed is asked for a new beacon (`_question`).
        if self._admission is not None and not is_any:
            admitted = self._admit(body, author, now)
            if isinstance(admitted, Flaw):
                actions.flaw = admitted
                self._question(body, admitted, source, now, actions)
                return actions
            body = admitted
        match body:
            case Beacon():
                self._on_beacon(body, source, now, summary, actions)
            case Solicit() if is_any:
                self._on_scout(source, now, actions)
            case Solicit():
                is_robot = author is not None and author.role is Role.ROBOT
                self._on_solicit(body, source, now, summary, actions, is_robot=is_robot)
            case MemberList():
                self.membership.on_member_list(body, now)
                actions.indirect_addresses = self._indirect_addresses(body)
            case Stop():
                self._on_stop(body, source, now, actions, author)
            case Ack():
                self._on_ack(body, source, actions)
            case Latches():
                self._on_latches(body, actions)
            case GoalReport():
                self._on_goal(body, now, actions)
            case RunLease():
                self._on_lease(body, now, actions)
            case Drive():
                if body.robot == self.robot and self._claim is None:
                    actions.drives.append(body)
            case Message():
                self._on_message(body, now, actions)
            case ClockQuery():
                self._on_clock_query(body, source, now, actions)
            case ClockReply():
                self._on_clock(body, now, actions)
            case Place():
                self._on_place(body, now, actions)
            case KinReport():
                if body.robot != self.robot and self.membership.is_present(
                    body.robot, body.instance
                ):
                    actions.kin.append(body)
                    self.hearing.on_message(body.robot, body.instance, now)
        return actions

    def wants_ack(self, stop: Stop, source: Address, now: float) -> bool:
        """True if this robot must now send its ack of the stop to `source`."""
        return self._relay.wants_ack(stop, source, now)

    def take_roster(self, robots: tuple[str, ...]) -> None:
        """Expect these robots from now on, and forget all members that are not among them."""
        self._roster = robots
        self.membership.keep_only(robots)
        if self._admission is not None:
            self._admission.names = frozenset(robots)

    def message(self, channel: str, payload: bytes) -> Message:
        """The datagram of a pattern's message."""
        self._message_sequence += 1
        self._sent += 1
        return Message(
            robot=self.robot,
            instance=self._instance,
            sequence=self._message_sequence,
            channel=channel,
            payload=payload,
        )

    def place(self, pose: SharedPose, age: float, now: float) -> Place | None:
        """The datagram of the own pose, measured `age` s ago; None if it is not due yet."""
        if self._claim is not None:
            return None
        place = self._places.place(pose, age, now)
        self._sent += place is not None
        return place

    def kin_report(self, message: KinMessage) -> KinReport | None:
        """The datagram of the own motion; None while this robot claims its id."""
        if self._claim is not None:
            return None
        self._sent += 1
        return KinReport(robot=self.robot, instance=self._instance, message=message)

    def clock_queries(self, now: float) -> list[tuple[Datagram, Address | None]]:
        """Questions for the clocks of peers, if they are due: call it while a recording is made."""
        if self._claim is not None:
            return []
        return [*self._clocks.queries(self.membership.alive_addresses(), now)]

    def pings(self, robots: Iterable[str], now: float) -> list[tuple[Datagram, Address | None]]:
        """Questions to these robots whose answers give the round trips in `links`.

        Earlier round trips to them are dropped.
        """
        if self._claim is not None:
            return []
        asked = tuple(robots)
        self.links.drop_round_trips(asked)
        return [*self._clocks.pings(asked, self.membership.alive_addresses(), now)]

    def leave_beacon(self, summary: Summary) -> Beacon:
        """The last beacon (Flag.LEFT) of a robot whose daemon ends in order."""
        return self._beacon(summary, Flag.LEFT)

    def advance(self, now: float, summary: Summary) -> PeerActions:
        """Returns the datagrams that are due at `now`, and what the daemon must carry out.

        Call it at `wake_at`, and at least ten times a second. `summary`: this robot's state,
        latches and goal.
        """
        actions = PeerActions()

        self._advance_claim(now, actions)
        if now >= self._members_at:
            self._members_at = now + MEMBERS_PERIOD
            self._advance_members(now, actions)
        if self.hearing.advance(now):
            actions.peer_faults = self.hearing.faults
        self._times.note_latches(digest_of(summary.latches), now)
        # The beacon goes before the latches: peers compare its digest with that of their latches.
        self._send_beacon_if_due(now, summary, actions)
        self._send_latches_if_due(now, summary, actions)
        stops = self._relay.advance(now, partial(self._is_overtaken, summary))
        actions.sends.extend((stop, None) for stop in stops)
        self._join_if_settled(now, summary, actions)
        overdue = self._goal_sync.repeats(summary.goal, now)  # questions without an answer
        actions.sends.extend(
            (Solicit(echo=echo, wants_goal=True), address) for echo, address in overdue
        )
        if now >= self._lists_at:
            self._lists_at = now + self._random.uniform(0.5, 1.5) * LIST_PERIOD
            self._ask_for_member_list(now, actions)
        return actions

    def _advance_claim(self, now: float, actions: PeerActions) -> None:
        """Become the owner of the id once the claim is won; solicit at set times of the claim.

        The answers to these solicits show the latches of the peers before the claim is won.
        """
        if self._claim is not None and self._claim.is_won(now):
            self._claim = None
            self._times.send_now(now)  # the first beacon of the owner
            # Of many robots that start together each would answer each, though all show themselves
            # now. With keys the answers are needed: they show that their senders are alive.
            if len(self._starting) < STARTING_TOGETHER or self._admission is not None:
                actions.sends.append((self._solicit(now), None))
            self._starting.clear()
        while self._claim is not None and self._solicits_at and now >= self._solicits_at[0]:
            self._solicits_at.pop(0)
            actions.sends.append((self._solicit(now), None))

    def _ask_for_member_list(self, now: float, actions: PeerActions) -> None:
        """Ask a random member for its list, which shows robots that are not heard here."""
        alive = sorted(self.membership.alive_addresses())
        if alive:
            request = self._solicit(now, members=True)
            _, address = self._random.choice(alive)
            actions.sends.append((request, address))

    def _advance_members(self, now: float, actions: PeerActions) -> None:
        """End leases, solicit silent members, and forget silent duplicates: 1 us a member."""
        actions.changed = self.membership.advance(now)
        silent = self.membership.to_probe(now)
        if silent:
            probe = self._solicit(now)
            actions.sends.extend((probe, address) for address in silent)
        for instance, heard in list(self._duplicates.items()):
            if now - heard > self._settings.lease:
                del self._duplicates[instance]

    def wake_at(self) -> float:
        """When `advance` is due next."""
        relay = self._relay.wake_at()
        return min(self._times.wake_at(), math.inf if relay is None else relay)

    # Parts

    def _on_scout(self, source: Address, now: float, actions: PeerActions) -> None:
        """Answer a program that looks for swarms with the name of this swarm."""
        if self._answers.may_answer_scout(now):
            actions.sends.append((self._swarm, source))

    def _on_ack(self, ack: Ack, source: Address, actions: PeerActions) -> None:
        """Hand on the ack of a stop that this robot relays, if the acking robot is a member."""
        if self.membership.knows(ack.robot):
            actions.sends.extend(self._relay.on_ack(ack, source))

    def _on_latches(self, latches: Latches, actions: PeerActions) -> None:
        """Take the emergency stops that a peer holds; a copy of the own datagram is ignored."""
        if latches.instance != self._instance:
            self._times.on_latches(latches.digest)
            self._sync.on_latches(latches)
            actions.latches = dict(latches.held)

    def _on_lease(self, lease: RunLease, now: float, actions: PeerActions) -> None:
        """Take a lease of an operator; in a secured swarm with the time at which it was sent."""
        age = 0.0 if self._admission is None else lease_age(lease, self._instance, now)
        actions.leases.append(HeardLease(lease, age))

    def _on_message(self, message: Message, now: float, actions: PeerActions) -> None:
        """Take the message of a peer's pattern, unless its number shows that it is no new one."""
        if message.robot != self.robot:
            self.hearing.on_message(message.robot, message.instance, now)
            is_new, actions.lost = self._windows.take(message)
            if is_new:
                actions.messages.append(message)

    def _on_clock_query(
        self, query: ClockQuery, source: Address, now: float, actions: PeerActions
    ) -> None:
        if self._claim is None and self._answers.may_answer(source, 1, now):
            actions.sends.append((self._clocks.reply(query, now), source))

    def _on_place(self, place: Place, now: float, actions: PeerActions) -> None:
        """Take the place of a peer that is a member."""
        if place.robot != self.robot and self.membership.knows(place.robot):
            self.hearing.on_message(place.robot, place.instance, now)
            peer_place = self._places.take(place, now)
            if peer_place is not None:
                actions.places.append(peer_place)

    def _indirect_addresses(self, list_: MemberList) -> list[Address]:
        """The addresses of robots that the list's sender hears, and that this robot does not."""
        alive = PRESENCES.index(Presence.ALIVE)
        return [
            (report.host, report.port)
            for report in list_.members
            if report.hops == 0
            and report.presence == alive
            and report.port
            and self.membership.indirect_address(report.robot) == (report.host, report.port)
        ]

    def _on_beacon(
        self, beacon: Beacon, source: Address, now: float, summary: Summary, actions: PeerActions
    ) -> None:
        """Take a beacon: update membership and link, and ask for latches and goals that differ.

        A beacon shows digests (hashes) of its robot's latches and goal. If a digest differs from
        this robot's own, this robot solicits the content from `source`. Latches come first: goals
        are solicited only once this robot owns its id and has the latches of its peers.
        """
        if beacon.instance == self._instance:
            return
        if beacon.robot == self.robot:
            self._on_own_id(beacon, source, now, summary, actions)
            return
        self.links.on_beacon(beacon.robot, beacon.instance, beacon.number, now)
        if self.membership.on_beacon(beacon, source, now):
            actions.changed.append(beacon.robot)
            self._new_peer_at = now  # a run is joined only JOIN_SETTLE later

        # A robot owns its id after its claim and before its farewell.
        is_owner = not beacon.flags & (Flag.JOINING | Flag.LEFT)
        if is_owner and beacon.number:
            report = Report(frozenset(beacon.unheard), beacon.heard)
            self.hearing.on_beacon(
                beacon.robot, beacon.instance, beacon.number, beacon.sent, report, now
            )
        is_starting = self._claim is not None and bool(beacon.flags & Flag.JOINING)
        if is_starting and len(self._starting) < MAX_MEMBERS:
            self._starting.add(beacon.robot)
        if is_owner:
            actions.beacon = beacon
            self._ask_for_latches(beacon, source, now, summary, actions)
            self._ask_for_goal(beacon, source, now, summary, actions)

    def _ask_for_latches(
        self, beacon: Beacon, source: Address, now: float, summary: Summary, actions: PeerActions
    ) -> None:
        """Solicit the latches of a peer if their digest differs from the own digest."""
        # A robot that was heard only briefly may be invented: few such robots are asked at once.
        is_stranger = not self.membership.is_established(beacon.robot)
        digest = beacon.digest(RecordKind.LATCH)
        own_digest = digest_of(summary.latches)
        if self._sync.wants(beacon.instance, digest, own_digest, now, is_stranger=is_stranger):
            actions.sends.append((self._solicit(now, latches=True), source))

    def _ask_for_goal(
        self, beacon: Beacon, source: Address, now: float, summary: Summary, actions: PeerActions
    ) -> None:
        """Solicit the goal of a peer if it may be greater; not before the own id and latches."""
        if self._claim is not None or not self.is_in_sync(now):
            return
        digest = beacon.digest(RecordKind.GOAL)
        echo = self._goal_sync.wants(beacon.instance, digest, source, summary.goal, now)
        if echo is not None:
            actions.sends.append((Solicit(echo=echo, wants_goal=True), source))

    def _on_goal(self, report: GoalReport, now: float, actions: PeerActions) -> None:
        """Take the goal of a peer once its signature is valid; the own datagram is ignored."""
        if report.instance == self._instance:
            return
        reported = self._goal_sync.on_report(report, now)
        if reported is None:
            return
        is_valid = self._check_goal(reported.goal, now)
        if is_valid:
            actions.goals.append(reported)
            self._is_join_due = True
        elif is_valid is None:  # too many signatures at a time: ask again
            self._goal_sync.retry(report.instance)
        else:
            actions.invalid_goals += 1

    def _join_if_settled(self, now: float, summary: Summary, actions: PeerActions) -> None:
        """Let the robot join the run of its goal once all peers' goals and latches are known."""
        held = summary.goal
        if not self._is_join_due or held is None or self._claim is not None:
            return
        if now - self._new_peer_at < JOIN_SETTLE or not self.is_in_sync(now):
            return
        if any(
            self._goal_sync.lacks(instance, digest, held.digest)
            for instance, digest in self.membership.goals()
        ):
            return
        self._is_join_due = False
        actions.goals.append(FoundGoal(held.goal, held.age(now), may_join=True))

    def _is_overtaken(self, summary: Summary, stop: Stop, issued: float) -> bool:
        """True if the stop, issued at `issued` s, must no longer be relayed.

        An emergency stop is relayed until a reset has cleared it at this robot. Any other stop is
        relayed until an operator has requested one of these after the stop, since a late copy of
        the stop would undo the request:

        1. a goal for all robots that starts a pattern,
        2. for a stop of all robots: a run or a reset of this robot,
        3. for a stop that names this robot: a run of this robot.
        """
        if stop.verb == "estop":
            return stop.id in summary.cleared and stop.id not in summary.latches
        held = summary.goal
        if held is not None and held.issued is not None:
            is_run_of_all = bool(held.goal.pattern) and not held.goal.targets
            if is_run_of_all and issued < held.issued:
                return True
        if stop.targets is None:
            return issued < max(summary.wished, summary.reset_at)
        return self.robot in stop.targets and issued < summary.wished

    def _on_own_id(
        self, beacon: Beacon, source: Address, now: float, summary: Summary, actions: PeerActions
    ) -> None:
        """Take a beacon of another instance with this robot's id: a rival, or a duplicate."""
        if self._claim is not None:
            self._claim.on_beacon(beacon, now)
        elif beacon.flags & Flag.JOINING:
            if self._answers.may_answer_claimer(now):
                actions.sends.append((self._beacon(summary), source))
        elif beacon.flags & Flag.LEFT:
            self._duplicates.pop(beacon.instance, None)
        elif len(self._duplicates) < MAX_DUPLICATES:
            if beacon.instance not in self._duplicates:
                actions.duplicate = beacon.instance.hex()
            self._duplicates[beacon.instance] = now

    def _on_solicit(
        self,
        solicit: Solicit,
        source: Address,
        now: float,
        summary: Summary,
        actions: PeerActions,
        *,
        is_robot: bool,
    ) -> None:
        """Answer a solicit with this robot's beacon, and with the lists that the solicit asks for.

        `is_robot`: a robot has signed the solicit; False in a swarm without keys. `_answers` limits
        the rate of answers: beyond the limit no answer is sent.
        """
        is_for_this = solicit.robot in (None, self.robot)
        if not is_for_this or not self._answers.may_answer(source, 1, now):
            return

        # While this robot claims its id, it answers a single kind of solicit: in a secured swarm
        # another claimer of the id asks by name whether this instance is alive.
        if self._claim is not None:
            is_by_claimer = is_robot and solicit.robot == self.robot
            if is_by_claimer:
                beacon = self._beacon(summary, Flag.JOINING, echo=solicit.echo)
                actions.sends.append((beacon, source))
            return

        parts = self._status_parts(solicit, source, now)
        # In a secured swarm the asker refuses messages of this instance up to the number `said`,
        # and places from before `clock`: an attacker may have kept them for a replay.
        beacon = replace(
            self._beacon(summary, echo=solicit.echo, version=self._settings.version),
            said=self._message_sequence,
            clock=max(round(1000.0 * now), 0),
            status_parts=len(parts),
        )
        actions.sends.append((beacon, source))
        actions.sends.extend((part, source) for part in parts)

        self._send_lists(solicit, source, now, summary, actions)

    def _status_parts(self, solicit: Solicit, source: Address, now: float) -> list[StatusPart]:
        """The parts of the own status, if the solicit asks for it and the budgets permit it.

        Empty in a secured swarm: datagrams are signed, and not encrypted.
        """
        if not solicit.wants_status or self._admission is not None:
            return []
        if not self._answers.may_make_status(now):
            return []
        parts = status_parts(self.robot, self._instance, solicit.echo, self._make_status())
        return parts if self._answers.may_answer(source, len(parts), now) else []

    def _send_lists(
        self, solicit: Solicit, source: Address, now: float, summary: Summary, actions: PeerActions
    ) -> None:
        """Send the member list, the goal and the latches, as far as the solicit asks for them."""
        if solicit.wants_members:
            parts = self._member_lists(solicit.echo, now)
            if not self._answers.may_answer(source, len(parts), now):
                return
            actions.sends.extend((part, source) for part in parts)
        goal = summary.goal
        if solicit.wants_goal and goal is not None and self._answers.may_answer(source, 1, now):
            actions.sends.append((self._goal_report(goal, solicit.echo, now), source))
        if solicit.wants_latches:
            latch_lists = latch_parts(self.robot, self._instance, summary.latches)
            actions.sends.extend((latches, source) for latches in latch_lists)

    def _member_lists(self, echo: int, now: float) -> list[MemberList]:
        """The parts of this robot's member list, which answer the solicit with this echo."""
        parts = in_parts(self.membership.reports(now), roster=self._roster)
        return [
            MemberList(
                robot=self.robot,
                instance=self._instance,
                members=members,
                part=number,
                parts=len(parts),
                echo=echo,
                roster=roster,
            )
            for number, (members, roster) in enumerate(parts)
        ]

    def _admit(self, body: Datagram, author: Author | None, now: float) -> Datagram | Flaw:
        assert self._admission is not None
        if author is None:
            return Flaw.UNSIGNED
        is_claiming = self._claim is not None
        return self._admission.admit(body, author, now, self.membership, is_claiming=is_claiming)

    def _question(
        self, body: Datagram, flaw: Flaw, source: Address, now: float, actions: PeerActions
    ) -> None:
        """Ask the sender of an unproven beacon for an answer that shows that it is alive now."""
        if self._admission is not None and flaw is Flaw.UNPROVEN and isinstance(body, Beacon):
            question = self._admission.freshness.question(body, now)
            if question is not None:
                actions.sends.append((question, source))

    def _solicit(self, now: float, *, members: bool = False, latches: bool = False) -> Solicit:
        """A `Solicit`; in a secured swarm the answer proves that its sender is alive now."""
        echo = 0 if self._admission is None else self._admission.freshness.new_echo(now)
        return Solicit(echo=echo, wants_members=members, wants_latches=latches)

    def _on_stop(
        self, stop: Stop, source: Address, now: float, actions: PeerActions, author: Author | None
    ) -> None:
        """Take a copy of a stop; carry out and relay what its permit leaves of it."""
        if self._admission is not None:
            verdict = self._judge_stop(stop, author)
            if verdict.refusal:
                actions.refused.append((stop, source, verdict.refusal))
            if verdict.relayed is None:
                return
            stop = verdict.relayed
            taken = self._admission.stops.take(stop, now)
            if taken is None:
                actions.replayed.append((stop, source))
                return
            stop = taken.stop
            actions.is_repeated = taken.is_repeated
        is_member = self.membership.is_address(source)
        actions.sends.extend(self._relay.on_stop(stop, source, now, is_member=is_member))
        actions.stops.append((stop, source))

    def _goal_report(self, held: HeldGoal, echo: int, now: float) -> GoalReport:
        age = held.age(now)
        return GoalReport(
            robot=self.robot,
            instance=self._instance,
            echo=echo,
            goal=encode_goal(held.goal),
            age=None if age is None else math.ceil(1000.0 * age),
        )

    def _on_clock(self, reply: ClockReply, now: float, actions: PeerActions) -> None:
        sample = self._clocks.sample(reply, now)
        if sample is not None:
            self.links.on_round_trip(reply.robot, max(now - sample.sent, 0.0), now)
            actions.clocks.append(sample)

    def _send_latches_if_due(self, now: float, summary: Summary, actions: PeerActions) -> None:
        if self._claim is None and self._times.latches_are_due(now):
            parts = latch_parts(self.robot, self._instance, summary.latches)
            actions.sends.extend((latches, None) for latches in parts)

    def _claim_period(self) -> float:
        """s until the next beacon of the claim: longer while many robots start together.

        At least CLAIM_BEACONS go out while the claim is open. The times differ by instance.
        """
        shared = len(self._starting) / CLAIMS_PER_SECOND
        longest = self._settings.settle / CLAIM_BEACONS
        period = max(CLAIM_PERIOD, min(shared, longest))
        return period if period <= CLAIM_PERIOD else period * self._random.uniform(0.75, 1.0)

    def _send_beacon_if_due(self, now: float, summary: Summary, actions: PeerActions) -> None:
        content = (summary.state, summary.revision, summary.digests, self._claim is None)
        claim_period = None if self._claim is None else self._claim_period()
        number = self._times.number_due(content, now, claim_period=claim_period)
        if number:
            flags = 0 if self._claim is None else Flag.JOINING
            report = self.hearing.report
            beacon = replace(
                self._beacon(summary, flags, number=number),
                sent=self._sent,
                unheard=tuple(sorted(report.unheard)),
                heard=report.heard,
            )
            actions.sends.append((beacon, None))

    def _beacon(
        self, summary: Summary, flags: int = 0, *, echo: int = 0, version: str = "", number: int = 0
    ) -> Beacon:
        self._sequence += 1
        return Beacon(
            robot=self.robot,
            instance=self._instance,
            sequence=self._sequence,
            wire=self._settings.wire,
            state=STATES.index(summary.state),
            revision=summary.revision,
            flags=flags,
            digests=summary.digests,
            echo=echo,
            version=version,
            body=self._body,
            number=number,
        )
