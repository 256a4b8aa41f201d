"""Peers on a network in virtual time, with delay, loss and cuts; no sockets, no clock."""

from __future__ import annotations

import heapq
import itertools
import math
import random
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Literal

from msgspec.structs import replace

from swarmd.core.clock import ClockSample
from swarmd.core.goal import Goal
from swarmd.core.messages import Code, Latch, PeerFault, State
from swarmd.core.values import PeerPlace
from swarmd.link.datagram import (
    Ack,
    Address,
    Datagram,
    Drive,
    KinReport,
    Solicit,
    Stop,
    pack,
    tag_of,
    unpack,
)
from swarmd.link.members.admission import Admission
from swarmd.link.peer import (
    CheckGoal,
    HeardLease,
    JudgeStop,
    MakeStatus,
    PeerActions,
    PeerProtocol,
    PeerSettings,
    StopVerdict,
    Summary,
)
from swarmd.link.signature import PREVIOUS_TIME, Author, Flaw, Previous, Trust
from swarmd.robot.goals import Found, Goals
from tests.link.keyring import Keyring
from tests.support.no_real_clock import no_real_clock

TAG = tag_of("field", "lab")
OPERATOR: Address = ("10.0.0.250", 5000)
TICK = 0.05


@dataclass(eq=False)
class Robot:
    """A robot reduced to what its peer shows and does."""

    peer: PeerProtocol
    address: Address
    state: State = State.IDLE
    revision: int = 0
    latches: dict[str, Latch] = field(default_factory=dict)
    stops: list[str] = field(default_factory=list)
    messages: list[bytes] = field(default_factory=list)
    changes: list[str] = field(default_factory=list)
    clocks: list[ClockSample] = field(default_factory=list)
    places: list[PeerPlace] = field(default_factory=list)
    kin: list[KinReport] = field(default_factory=list)
    leases: list[HeardLease] = field(default_factory=list)
    drives: list[Drive] = field(default_factory=list)
    peer_faults: list[PeerFault] = field(default_factory=list)
    goals: Goals = field(default_factory=lambda: Goals("robot", (), None, 0.0))
    wished: float = -math.inf
    reset_at: float = -math.inf
    cleared: tuple[str, ...] = ()
    joinable: list[Goal] = field(default_factory=list)
    is_recording: bool = False
    is_up: bool = True
    invalid_goals: int = 0
    trust: Trust | None = None
    flaws: Counter[str] = field(default_factory=Counter)
    replayed: list[str] = field(default_factory=list)
    denied: list[str] = field(default_factory=list)
    duplicates: list[str] = field(default_factory=list)

    @property
    def summary(self) -> Summary:
        return Summary(
            self.state,
            self.revision,
            self.latches,
            self.goals.held,
            wished=self.wished,
            reset_at=self.reset_at,
            cleared=self.cleared,
        )

    def find(self, goal: Goal, age: float | None, now: float) -> None:
        """Adopt a goal if it is greater."""
        if self.goals.judge(goal) in (Found.OWN, Found.OTHER):
            self.goals.adopt(goal, age, now, may_join=False)
        elif self.goals.is_held(goal):
            self.goals.learn_age(age, now)


class VirtualNetwork:
    """Robots `r1` to `r<count>`; `reaches(sender, receiver)` cuts, `loss` and `delay` disturb.

    With a `keyring` the swarm is secured, and its operator is `anna`. `tapped` has all datagrams
    that were sent, as one hears them who has no keys; `inject` sends such.
    """

    def __init__(
        self,
        count: int,
        *,
        seed: int = 1,
        lease: float = 3.0,
        settle: float = 1.0,
        joined: bool = True,
        keyring: Keyring | None = None,
    ):
        self.keyring = keyring
        self.tapped: list[tuple[str, Datagram, bytes, Address]] = []
        self.is_tapped = False
        self.unicast: Counter[Address] = Counter()
        self.ages: dict[str, list[int]] = {}
        self.now = 100.0
        self.random = random.Random(seed)
        self.loss = 0.0
        self.delay = 0.005
        self.reaches: Callable[[str, str], bool] = lambda sender, receiver: True
        self.heard: list[tuple[float, Datagram]] = []
        self.sent: dict[str, int] = {}
        self.sent_kinds: Counter[type] = Counter()
        self._queue: list[tuple[float, int, str, bytes, Address]] = []
        self._order = itertools.count()
        self._lease, self._settle = lease, settle
        self._lives = 0
        self.robots: dict[str, Robot] = {}
        for number in range(1, count + 1):
            self.add(f"r{number}")
        if joined:
            self.run(3.0)

    def add(
        self,
        name: str,
        key: str = "",
        *,
        check_goal: CheckGoal = lambda goal, now: True,
        judge_stop: JudgeStop = lambda stop, author: StopVerdict(stop),
        make_status: MakeStatus = bytes,
    ) -> Robot:
        """A robot that starts; `key`: its name in this network, if an id is used twice."""
        self._lives += 1
        peer = PeerProtocol(
            PeerSettings(
                robot=name,
                instance=self._lives.to_bytes(6, "big"),
                swarm="lab",
                profile="field",
                lease=self._lease,
                settle=self._settle,
                wire=1,
                version="1.0",
                clock=self._lives.to_bytes(6, "big").hex(),
            ),
            roster=(),
            now=self.now,
            admission=None if self.keyring is None else self._admission(name),
            check_goal=check_goal,
            judge_stop=judge_stop,
            make_status=make_status,
        )
        key = key or name
        number = self._lives
        trust = None if self.keyring is None else self.keyring.trust(name)
        self.robots[key] = Robot(peer, (f"10.0.0.{number}", 7440), trust=trust)
        return self.robots[key]

    def _admission(self, name: str) -> Admission:
        assert self.keyring is not None
        numbers = random.Random(f"{name} {self._lives}")
        return Admission(
            name, self.keyring.roster.robots, self._lease, lambda: numbers.getrandbits(53)
        )

    def change_roster(self, remove: Collection[str], *, but: Collection[str] = ()) -> None:
        """The robots take the next generation of the roster, `but` these do not hear of it."""
        assert self.keyring is not None
        until = self.now + PREVIOUS_TIME
        before = self.keyring.roster
        keys = {name: self.keyring.keys(name) for name in self.robots}
        self.keyring.renew(remove=remove)
        for name, robot in self.robots.items():
            if name in but:
                continue
            previous = Previous(keys[name], before, until)
            robot.trust = Trust.of(self.keyring.identity(name), previous)

    def inject(self, payload: bytes, source: Address, to: str | None = None) -> None:
        """A stranger sends these bytes from this address, to one robot or all."""
        for name in list(self.robots) if to is None else [to]:
            self._queue_up(name, payload, source)

    def send(self, body: Datagram, to: str | None = None) -> None:
        """What the operator sends, to one robot or all."""
        address = None if to is None else self.robots[to].address
        self._send("operator", OPERATOR, body, address)

    def acks(self) -> Mapping[str, Ack]:
        """The last ack of each robot that the operator heard."""
        return {body.robot: body for _, body in self.heard if isinstance(body, Ack)}

    def stop(
        self, verb: Literal["stop", "estop"], seconds: float, targets: tuple[str, ...] | None = None
    ) -> None:
        """The operator repeats a stop at 10 Hz for a while."""
        began = self.now
        while self.now - began < seconds:
            age = round((self.now - began) * 1000)
            stop = Stop(
                id=f"{verb}-id",
                verb=verb,
                operator="anna",
                targets=targets,
                scope="swarm" if targets is None else "robots",
                age=age,
                repeated=age,
            )
            self.send(stop)
            self.run(0.1)

    def run(self, seconds: float) -> None:
        """Let virtual time pass; a read of a clock of this machine is an error."""
        with no_real_clock():
            self._run(seconds)

    def _run(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.now += TICK
            while self._queue and self._queue[0][0] <= self.now:
                _, _, receiver, payload, source = heapq.heappop(self._queue)
                self._deliver(receiver, payload, source)
            for name, robot in list(self.robots.items()):
                if robot.is_up:
                    self._carry_out(name, robot.peer.advance(self.now, robot.summary))
                if robot.is_up and robot.is_recording:
                    asked = robot.peer.clock_queries(self.now)
                    self._carry_out(name, PeerActions(sends=asked))

    def until(self, holds: Callable[[], bool], cap: float = 60.0) -> float:
        """Let time pass until it holds; the seconds it took."""
        began = self.now
        while not holds():
            assert self.now - began < cap, "never came true"
            self.run(TICK)
        return self.now - began

    def solicit(self) -> None:
        """The operator asks all for beacons and words."""
        self.send(Solicit(echo=7, wants_members=True))

    def _deliver(self, receiver: str, payload: bytes, source: Address) -> None:
        body = unpack(TAG, payload)
        assert body is not None
        if receiver == "operator":
            self.heard.append((self.now, body))
            return
        robot = self.robots.get(receiver)
        if robot is None or not robot.is_up:
            return
        author = None
        if robot.trust is not None:
            found = robot.trust.verifier.verify(payload, self.now)
            if isinstance(found, Flaw):
                robot.flaws[found] += 1
                return
            author = found
        effects = robot.peer.on_datagram(body, source, self.now, robot.summary, author=author)
        if effects.flaw is not None:
            robot.flaws[effects.flaw] += 1
        robot.replayed.extend(stop.id for stop, _ in effects.replayed)
        robot.denied.extend(text for _, _, text in effects.refused)
        for stop, sender in effects.stops:
            self._on_stop(receiver, robot, stop, sender)
        self._carry_out(receiver, effects, (source, author))

    def _on_stop(self, name: str, robot: Robot, stop: Stop, sender: Address) -> None:
        if stop.targets is not None and robot.peer.robot not in stop.targets:
            return
        robot.stops.append(stop.id)
        self.ages.setdefault(stop.id, []).append(stop.age)
        if stop.verb == "estop":
            robot.state = State.ESTOPPED
            robot.latches[stop.id] = Latch(issuer=stop.operator, scope=stop.scope)
        if robot.peer.wants_ack(stop, sender, self.now):
            ack = Ack(
                id=stop.id,
                robot=robot.peer.robot,
                instance=b"123456",
                revision=1,
                code=Code.APPLIED,
            )
            if robot.trust is not None:
                ack = replace(ack, proof=robot.trust.signer.proof(ack, stop.operator))
            self._send(name, robot.address, ack, sender)

    def _carry_out(
        self,
        name: str,
        effects: PeerActions,
        asker: tuple[Address, Author | None] | None = None,
    ) -> None:
        robot = self.robots[name]
        for body, address in effects.sends:
            author = asker[1] if asker is not None and asker[0] == address else None
            self._send(name, robot.address, body, address, author)
        if effects.duplicate:
            robot.duplicates.append(effects.duplicate)
        robot.latches.update(effects.latches)
        if robot.latches:
            robot.state = State.ESTOPPED
        robot.messages.extend(message.payload for message in effects.messages)
        robot.changes.extend(effects.changed)
        robot.clocks.extend(effects.clocks)
        robot.places.extend(effects.places)
        robot.kin.extend(effects.kin)
        robot.leases.extend(effects.leases)
        robot.drives.extend(effects.drives)
        robot.peer_faults.extend(effects.peer_faults or ())
        robot.invalid_goals += effects.invalid_goals
        for found in effects.goals:
            robot.find(found.goal, found.age, self.now)
            if found.may_join:
                robot.joinable.append(found.goal)

    def _send(
        self,
        name: str,
        source: Address,
        body: Datagram,
        to: Address | None,
        asker: Author | None = None,
    ) -> None:
        payload = pack(TAG, body)
        trust = self.robots[name].trust if name in self.robots else self._trust_of_operator()
        if trust is not None:
            payload = trust.signer.sign(payload, asker)
        if self.is_tapped:
            self.tapped.append((name, body, payload, source))
        self.sent[name] = self.sent.get(name, 0) + 1
        self.sent_kinds[type(body)] += 1
        addresses = {robot.address: key for key, robot in self.robots.items()}
        addresses[OPERATOR] = "operator"
        if to is not None:
            self.unicast[to] += 1
        receivers = list(addresses.values()) if to is None else [addresses.get(to, "")]
        for receiver in receivers:
            is_own = receiver == name and to is None
            if is_own or not self.reaches(name, receiver) or self.random.random() < self.loss:
                continue
            self._queue_up(receiver, payload, source)

    def _queue_up(self, receiver: str, payload: bytes, source: Address) -> None:
        at = self.now + self.delay * (1.0 + 0.2 * self.random.random())
        heapq.heappush(self._queue, (at, next(self._order), receiver, payload, source))

    def _trust_of_operator(self) -> Trust | None:
        return None if self.keyring is None else self.keyring.trust("anna")
