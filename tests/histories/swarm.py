"""The real `Robot`, `PeerProtocol` and `RequestServer` of several daemons in virtual time.

There are no sockets.

`VirtualDaemon` is wired as `daemon/daemon.py` and `daemon/network.py`
are: the order of calls, the files of latches and goals, the claim of the id and the latches of the
peers before requests are served. The driver, the pattern host and the links of operators are
reduced to what they deliver, and when. Datagrams are not packed: their codec has tests of its own.

An event is due at its time; a daemon ticks when its robot or peer is due, and at least each
`LONGEST_TICK`. A run of the same events with the same seed is the same run: a read of a clock of
this machine is an error.
"""

from __future__ import annotations

import heapq
import itertools
import math
import random
import shutil
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol
from unittest.mock import Mock

import numpy as np
import zenoh
from msgspec.structs import replace as struct_replace

from swarmd.core.errors import CodecError, CoreFault
from swarmd.core.events import (
    TICK_INPUT,
    DriverInput,
    DuplicateInput,
    GoalInput,
    HostInput,
    Input,
    LatchesInput,
    LeaseInput,
    LeaveInput,
    MessageInput,
    NoteInput,
    OdometryInput,
    PoseInput,
    RequestInput,
    ScanInput,
)
from swarmd.core.goal import GoalRecord
from swarmd.core.host_messages import (
    HostCommand,
    HostEvent,
    KillHost,
    Load,
    Loaded,
    LoadRefused,
    ParamsSet,
    SetParams,
    StartTrial,
    Step,
    Stepped,
    TrialDone,
)
from swarmd.core.incident import Incident
from swarmd.core.keys import MESSAGE, build
from swarmd.core.messages import Code, PeerView, Reply
from swarmd.core.record import RecordKind
from swarmd.core.refusal import Refusal
from swarmd.core.values import (
    ZERO,
    Array,
    Odometry,
    Outputs,
    Platform,
    Pose,
    Scan,
    SharedPose,
    Twist,
)
from swarmd.core.verbs import (
    ForgetRequest,
    KeptIncident,
    MarkRequest,
    PushRequest,
    RecordRequest,
    ReloadRequest,
    Request,
    RosterRequest,
)
from swarmd.daemon.audit import Audit
from swarmd.daemon.goal_service import STORE_TIME
from swarmd.daemon.key_permits import KeyPermits
from swarmd.daemon.recording.incident_file import IncidentHead
from swarmd.daemon.recording.ring import Ring
from swarmd.daemon.requests import RequestServer
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.carriers.programs import MAX_TAKEN, Programs
from swarmd.link.datagram import Ack, Address, Datagram, RunLease, Stop
from swarmd.link.keys.key_permit import PresentRun
from swarmd.link.keys.roster import KeyPermit, Role
from swarmd.link.members.admission import Admission
from swarmd.link.peer import PeerActions, PeerProtocol, PeerSettings, Summary
from swarmd.link.signature import Author
from swarmd.link.spread.goal_sync import FoundGoal
from swarmd.link.stops.stop_freshness import REPLAYED
from swarmd.robot.actions import Actions
from swarmd.robot.latches import LatchRecord
from swarmd.robot.protection.fence.fence_settings import FenceSettings
from swarmd.robot.robot import Robot
from swarmd.robot.setup import EarlierLives, RobotSetup
from swarmd.robot.steering.steering import Steering
from swarmd.settings.robot_settings import RobotSettings
from swarmd.settings.settings import load_platform
from tests.histories.black_box import BlackBox, Death, new_ring_folder
from tests.support.fake_services import fake_services
from tests.support.no_real_clock import no_real_clock

LEASE, SETTLE = 3.0, 1.0  # of profile field
DELAY = 0.005  # s
MOST_DELAY = 1.2  # of a datagram, as a share of the delay
JOIN_TICK, TICK, LONGEST_TICK = 0.05, 0.05, 0.4  # s
LOAD_TIME, TRIAL_TIME, DISK_TIME = 0.05, 0.3, 0.02  # s
SCAN_PERIOD = 0.5
POSE_PERIOD = 0.2
COMMAND_TIME = 0.5  # s after which a base without commands stands
FENCE = FenceSettings(frame="lab", polygon=[(-1e3, -1e3), (1e3, -1e3), (0.0, 1e3)])
RAM_SPEED, RAM_DISTANCE, RAM_PERIOD, RAM_AGAIN = 1.0, 1.2, 0.1, 6.0  # m/s, m, s and s
BATCH, PAUSE, MAX_WAITING = 64, 0.005, 2700  # as in `link/carriers/udp.py`
PATTERNS = frozenset({"drive", "circle"})  # what each robot has; others are pushed
SPEEDS = {"drive": 0.1, "circle": 0.05}
CHILD = "-child"
"""The end of the name of a forked program, which is on the computer of its parent."""
ROSTER = ("r1", "r2", "r3", "r4", "r5", "r6", "r7")
NO_DATA = np.full(8, np.inf)


_OF_SERVICES = ForgetRequest | RecordRequest | MarkRequest | RosterRequest | PushRequest
"""The requests that the robot itself does not answer."""


class Disturbance(Protocol):
    """Decides on each datagram, request and reply by itself."""

    def arrivals(self, sender: str, receiver: str, what: object) -> tuple[float, ...]:
        """The s after its time at which it arrives: none if it is lost, two with a copy.

        `what`: a datagram, or what is called at the end of a link.
        """


class Judge(Protocol):
    """Looks at each step of a history."""

    def on_event(self, daemon: VirtualDaemon) -> None:
        """The robot of a daemon has carried out an event."""

    def on_reply(self, daemon: VirtualDaemon, request: Request, reply: Reply) -> None:
        """A robot answers a request or a stop."""

    def on_send(self, daemon: VirtualDaemon, body: Datagram) -> None:
        """A robot sends a datagram."""

    def on_twist(self, daemon: VirtualDaemon) -> None:
        """A robot sends its base a command that is not zero."""

    def on_base(self, daemon: VirtualDaemon) -> None:
        """The base of a robot is lost, or is back."""

    def forget_stops(self, robot: str) -> None:
        """A robot has ended before what it obeyed was on its disk; it has acked none of that."""

    def on_program(self, daemon: VirtualDaemon, sender: str) -> None:
        """A robot takes a message of a Zenoh program."""

    def on_found(self, daemon: VirtualDaemon, found: FoundGoal, source: str) -> None:
        """A robot is about to be handed the goal of a peer."""

    def motion_of(self, daemon: VirtualDaemon) -> object:
        """What moves a robot, before its black box works."""

    def check_motion(self, daemon: VirtualDaemon, before: object) -> None:
        """The black box of a robot has worked."""

    def on_incident(
        self, daemon: VirtualDaemon, incident: Incident, at: float, source: str
    ) -> None:
        """A robot begins to keep an incident, which was at `at` s."""

    def on_file(self, daemon: VirtualDaemon) -> None:
        """A robot has written the file of an incident."""

    def on_displaced(
        self,
        daemon: VirtualDaemon,
        before: Sequence[KeptIncident],
        gone: Mapping[str, KeptIncident],
        new: IncidentHead,
    ) -> None:
        """Of the files `before` those in `gone` give way to the file of another incident."""

    def on_death(self, daemon: VirtualDaemon, death: Death | None) -> None:
        """A daemon has ended; `death`: if it was killed."""


@dataclass(frozen=True, slots=True)
class Disk:
    """The state folder of a robot."""

    latches: LatchRecord = field(default_factory=LatchRecord)
    goals: GoalRecord = field(default_factory=GoalRecord)
    patterns: frozenset[str] = frozenset()
    counters: Mapping[bytes, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Cause:
    """Why a pattern is loaded: the request that asked for it, else a goal that was found."""

    at: float
    request: Request | None = None
    goal_id: str = ""


class StrictDrops(DropCounter):
    """Hides no error of a handler: a broken rule, or a fault of the daemon."""

    @contextmanager
    def refusing(
        self, kind: str, refuse: Callable[[Code, str], object] | None = None
    ) -> Iterator[None]:
        """As that of a daemon, but for errors, which pass as CoreFault."""
        with super().refusing(kind, refuse):
            try:
                yield
            except CodecError:
                raise
            except Exception as error:
                raise CoreFault from error


class VirtualQuery:
    """A request of an operator as a daemon's bus hands it over."""

    def __init__(
        self, payload: bytes, asker: str, source: str, answer: Callable[[bytes], None]
    ) -> None:
        self.payload, self.asker, self.source = payload, asker, source
        self.reply = answer

    def drop(self) -> None:
        """No answer."""


class VirtualSession:
    """What `Programs` needs of a Zenoh session; `messages` are the puts that wait for a tick."""

    def __init__(self) -> None:
        self.messages: deque[Any] = deque(maxlen=MAX_TAKEN)

    def liveliness(self) -> Any:
        """Tokens are not played."""
        return Mock()

    def declare_publisher(self, key: str, **_: object) -> Any:
        """No program subscribes."""
        return Mock(matching_status=Mock(matching=False))

    def declare_subscriber(self, key: str, handler: object, **_: object) -> Any:
        """The messages of programs."""
        return Mock(try_recv=lambda: self.messages.popleft() if self.messages else None)


class VirtualSwarm:
    """Robots and operators on one network, which `cuts`, `loss` and `delay` disturb.

    `cuts`: pairs of names, (sender, receiver), that nothing passes. In a swarm that `is_secured`
    robots know the authors of datagrams, as if these were signed, and admit what counts. In one
    that `is_fenced` a tracker tells robots their poses while they run. `permits`: of the roster of
    a secured swarm.
    """

    def __init__(
        self,
        seed: int,
        *,
        is_secured: bool = False,
        is_fenced: bool = False,
        permits: Mapping[str, KeyPermit] | None = None,
    ) -> None:
        self.now = 1000.0
        self.most_delay = MOST_DELAY
        self.is_secured, self.is_fenced = is_secured, is_fenced
        roster = SimpleNamespace(permits=dict(permits or {}), operators={}, robots=ROSTER)
        self.identity: Any = SimpleNamespace(roster=roster) if is_secured else None
        self.random = random.Random(seed)
        self.cuts: set[tuple[str, str]] = set()
        self.loss, self.delay = 0.0, DELAY
        # By sender, the s by which its datagrams, and its requests by links, arrive later.
        self.slow: dict[str, float] = {}
        self.slow_links: dict[str, float] = {}
        self.copies: tuple[float, ...] = ()  # s after which each datagram arrives once more
        self.disturbance: Disturbance | None = None
        self.slowest = DELAY  # of all delays so far
        self.wall = 1.8e9  # s; the wall clocks differ by robot and may jump
        self.judge: Judge | None = None
        self.issued: dict[str, float] = {}  # when stops, goals and requests were made, by id
        self.worked: dict[str, float] = {}  # s of an operator's work, and until a start, by id
        self.renewed: dict[str, float] = {}  # when an operator last renewed a lease, by goal
        # What an attacker has recorded: the leases that operators sent, with their senders.
        self.recorded: list[tuple[RunLease, Node]] = []
        self.robots: dict[str, VirtualDaemon] = {}
        self.nodes: dict[str, Node] = {}
        self._by_address: dict[Address, Node] = {}
        self._events: list[tuple[float, int, Callable[[], object]]] = []
        self._order = itertools.count()
        self.chance_of_ids = random.Random(f"incidents {seed}")
        self.folder, self.rings = new_ring_folder(), set[Ring]()
        self.close = weakref.finalize(self, _remove, self.folder, self.rings)

    def add(self, node: Node) -> None:
        """A robot or an operator comes; its address is that of its name for good."""
        self.nodes[node.name] = node
        self._by_address[node.address] = node
        if isinstance(node, VirtualDaemon):
            self.robots[node.name] = node

    def boot(self, name: str, join_tick: float = JOIN_TICK) -> VirtualDaemon:
        """A robot that starts for the first time."""
        daemon = VirtualDaemon(self, name)
        daemon.join_tick = join_tick
        self.add(daemon)
        with no_real_clock():
            daemon.start()
        return daemon

    def at(self, when: float, call: Callable[[], object]) -> None:
        """Call this at a time."""
        heapq.heappush(self._events, (when, next(self._order), call))

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        end = self.now + seconds
        events = self._events
        with no_real_clock():
            while events and events[0][0] <= end:
                when, _, call = heapq.heappop(events)
                self.now = max(when, self.now)
                call()
        self.now = end

    def until(self, holds: Callable[[], bool], cap: float = 30.0) -> None:
        """Let time pass until it holds, or for `cap` s."""
        end = self.now + cap
        while not holds() and self.now < end:
            self.advance(0.1)

    def reaches(self, sender: str, receiver: str) -> bool:
        """True if nothing is cut between them, in this direction."""
        one, other = sender.removesuffix(CHILD), receiver.removesuffix(CHILD)
        return (one, other) not in self.cuts

    def cut(self, senders: Iterable[str], receivers: Iterable[str], *, both: bool = True) -> None:
        """Nothing passes between them any more; `both`: in both directions."""
        others = tuple(receivers)
        for one in senders:
            for other in others:
                self.cuts.add((one, other))
                if both:
                    self.cuts.add((other, one))

    def send(self, sender: Node, body: Datagram, to: Address | None) -> None:
        """A datagram goes to all, or to one address."""
        if to is None:
            receivers = [one for one in self.nodes.values() if one is not sender]
        else:
            receivers = [self._by_address[to]] if to in self._by_address else []
        if isinstance(body, RunLease):
            self.recorded.append((body, sender))
        delay = self.delay + self.slow.get(sender.name, 0.0)
        self.slowest = max(self.slowest, delay + max(self.copies, default=0.0))
        for one in receivers:
            if not one.is_listening or not self.reaches(sender.name, one.name):
                continue
            if self.loss and self.random.random() < self.loss:
                continue
            when = self.now + delay * (1.0 + (MOST_DELAY - 1.0) * self.random.random())
            for later in self._arrivals(sender.name, one.name, body, self.copies):
                self.at(when + later, partial(one.receive, body, sender))

    def play_back(self, robot: str, period: float, newest: int) -> None:
        """An attacker sends a robot the `newest` leases that were recorded, one each `period` s.

        In the order in which they were sent. The signatures hold, and the source is forged.
        """
        for number, (lease, sender) in enumerate(self.recorded[-newest:]):
            when = self.now + period * number
            self.at(when, partial(self.nodes[robot].receive, lease, sender))

    def name_of(self, address: Address) -> str:
        """The robot or operator at an address."""
        return self._by_address[address].name

    def ask(self, asker: str, robot: str, call: Callable[[VirtualDaemon], object]) -> None:
        """What an operator asks a robot by a link: both directions must pass."""
        daemon = self.robots[robot]
        if daemon.is_up and self.reaches(asker, robot) and self.reaches(robot, asker):
            when = self.now + 2.0 * self.delay + self.slow_links.get(asker, 0.0)
            for later in self._arrivals(asker, robot, call):
                query = partial(daemon.take_query, call, when + later)
                self.at(when + later, partial(daemon.take, query))

    def answer(self, robot: str, asker: str, call: Callable[[], object]) -> None:
        """The answer of a robot comes back by a link."""
        if self.reaches(asker, robot) and self.reaches(robot, asker):
            for later in self._arrivals(robot, asker, call):
                self.at(self.now + 2.0 * self.delay + later, call)

    def _arrivals(
        self, sender: str, receiver: str, what: object, copies: tuple[float, ...] = ()
    ) -> tuple[float, ...]:
        if self.disturbance is not None:
            return self.disturbance.arrivals(sender, receiver, what)
        return (0.0, *copies)


def _remove(folder: Path, rings: set[Ring]) -> None:
    """Close the open rings of a swarm, and remove its folder."""
    for ring in rings:
        ring.close()
    shutil.rmtree(folder, ignore_errors=True)


class Node:
    """What has a name and an address in the network."""

    name: str
    address: Address
    is_listening = True

    @property
    def author(self) -> Author:
        """What its signature proves."""
        raise NotImplementedError

    def receive(self, body: Datagram, sender: Node) -> None:
        """A datagram arrives."""
        raise NotImplementedError


class VirtualDaemon(Node):
    """One robot with its state folder, through all lives of its daemon."""

    def __init__(self, swarm: VirtualSwarm, name: str) -> None:
        self.name = name
        self.address = (f"10.0.0.{1 + len(swarm.robots)}", 7440)
        self.swarm = swarm
        self.disk = Disk()
        self.older: list[tuple[float, Disk]] = [(swarm.now, self.disk)]
        self.is_up = self.is_frozen = self.is_settled = False
        self.lives = 0
        self.wall = swarm.random.choice((0.0, -1.7e9, 3600.0))  # s beside the true time
        self.join_tick = JOIN_TICK  # s; a busy computer has a longer one
        self.disk_time = DISK_TIME  # s that a write takes
        self.twist = ZERO
        self.x = 0.0  # m, the true place; robots drive along x
        self.told_x: float | None = None  # where the tracker tells the robot to stand, in error
        self.told_way = (
            0.0  # m driven since then, in this life, and since an operator wanted the run
        )
        self.cause: Cause | None = None  # of the pattern that runs
        self.event: object = None  # the request or the goal that is handed to the robot now
        self.hops: dict[str, int] = {}  # of the stops that were carried out, the greatest
        self.waits: dict[str, float] = {}  # s for which a query waited while the daemon stalled
        self._waited = 0.0
        self._waiting: list[Callable[[], object]] = []
        self._due = math.inf
        self._unwritten: GoalRecord | None = None  # what the write under way is to leave

    # Life

    @property
    def is_listening(self) -> bool:  # type: ignore[override]
        """True while its sockets are open."""
        return self.is_up

    @property
    def is_active(self) -> bool:
        """True while a pattern runs or is being loaded."""
        return self.is_up and self.robot.running_generation is not None

    def start(self, disk: Disk | None = None) -> None:
        """The daemon starts; `disk`: another state folder than that of its last life."""
        assert not self.is_up
        swarm, now = self.swarm, self.swarm.now
        if disk is not None:
            self._store(disk)
        self.lives += 1
        instance = swarm.random.getrandbits(48).to_bytes(6, "big")
        self.instance = instance
        self.is_up, self.is_frozen, self.is_settled = True, False, False
        self.is_base_up = True
        self.twist, self.cause, self._causes = ZERO, None, dict[int, Cause]()
        self.hops, self.waits = {}, {}
        self._scan_seq, self._scan_at, self._waiting = 0, -math.inf, []
        self._moved_at = self._posed_at = -math.inf
        self.told_way = 0.0  # a new life has no earlier pose to compare with
        self._loads = itertools.count()
        self._load = 0  # the load under way, which a kill of the host ends
        self._pattern = ""
        self.robot = Robot(
            self.name,
            platform(),
            RobotSetup(
                driver="virtual",
                profile="field",
                settings=RobotSettings(fence=FENCE if swarm.is_fenced else None),
            ),
            make_steering=Steering,
            seed=1,
            instance=instance.hex(),
            now=now,
            earlier=EarlierLives(self.disk.latches, self.disk.goals),
        )
        self.admission = self._admission()
        self.permits = KeyPermits(
            self.name,
            lambda: swarm.identity,
            self._present_run,
            wall=lambda: swarm.wall + self.wall,
            clock=lambda: swarm.now,
        )
        self.peer = PeerProtocol(
            PeerSettings(
                robot=self.name,
                instance=instance,
                swarm="lab",
                profile="field",
                lease=LEASE,
                settle=SETTLE,
                wire=1,
                version="1.0",
            ),
            roster=ROSTER if swarm.is_secured else (),
            now=now,
            admission=self.admission,
            judge_stop=self.permits.judge_stop,
        )
        self._session = VirtualSession()
        self._programs = Programs(
            self._session,  # type: ignore[arg-type]  # has what `Programs` calls
            "lab",
            self.name,
            self.knows,
            StrictDrops(),
            takes_messages=True,
        )
        self.black_box = BlackBox(self, keeps_files=disk is None)
        audit = Audit(
            self.note,
            wall=lambda: self.swarm.wall + self.wall,
        )
        self.server = RequestServer(
            self.name,
            self._on_request,
            audit,
            replace(fake_services(), incidents=self.black_box.service),
            drops=StrictDrops(),
            is_secured=swarm.is_secured,
            judge=self.permits.judge,
            clock=lambda: swarm.now,
        )
        self.black_box.open()
        self._observe()
        self._tick_at(now)

    def _present_run(self) -> PresentRun | None:
        pattern = self.robot.running_pattern
        return None if pattern is None else PresentRun(pattern, self.robot.running_speed)

    def _admission(self) -> Admission | None:
        if not self.swarm.is_secured:
            return None
        echoes = partial(self.swarm.random.getrandbits, 53)
        return Admission(self.name, ROSTER, LEASE, echoes, self.disk.counters)

    def kill(self) -> None:
        """The daemon ends at once: what is not on the disk is lost."""
        if self.swarm.judge is not None:
            if self._unwritten is not None:
                self.swarm.judge.forget_stops(self.name)
            self.swarm.judge.on_death(self, self.black_box.die())
        self._unwritten = None
        self.is_up = self.is_frozen = False
        self.twist = ZERO

    def leave(self) -> None:
        """The daemon ends in order."""
        self._step(LeaveInput())
        if self.peer.owns_id:
            self._send(self.peer.leave_beacon(self._summary()), None)
        if self._unwritten is not None:
            self._store(replace(self.disk, goals=self._unwritten))
            self._unwritten = None
        self.black_box.close()
        self.kill()

    def freeze(self, seconds: float = math.inf) -> None:
        """The daemon stalls; what is sent to it waits in its sockets, and its base stands."""
        self.is_frozen = True
        self.black_box.frozen_at = self.swarm.now
        self.twist = ZERO
        if seconds < math.inf:
            life = self.lives
            self.swarm.at(
                self.swarm.now + seconds,
                lambda: self.thaw() if self.is_frozen and life == self.lives else None,
            )

    def ram(self) -> None:
        """Something comes twice, faster than the platform declares; scans come more often then."""
        for begin in (0.0, RAM_AGAIN):
            for number in range(round(RAM_DISTANCE / RAM_SPEED / RAM_PERIOD)):
                after = RAM_PERIOD * number
                see = partial(self._see, RAM_DISTANCE - RAM_SPEED * after, self.lives)
                self.swarm.at(self.swarm.now + begin + after, partial(self.take, see))

    def lose_base(self, seconds: float) -> None:
        """The link of the base is lost, and comes back after `seconds`."""
        self._on_base(self.lives, is_up=False)
        back = partial(self._on_base, self.lives, is_up=True)
        self.swarm.at(self.swarm.now + seconds, partial(self.take, back))

    def _on_base(self, life: int, *, is_up: bool) -> None:
        if life != self.lives or self.is_base_up == is_up:
            return
        self.is_base_up = is_up
        if self.swarm.judge is not None:
            self.swarm.judge.on_base(self)
        self._step(DriverInput(is_up, "connected" if is_up else "lost"))

    def thaw(self) -> None:
        """The daemon continues: what waited comes at once, a batch in each turn of its loop."""
        self.is_frozen = False
        self._take_waiting()

    def _take_waiting(self) -> None:
        batch, self._waiting = self._waiting[:BATCH], self._waiting[BATCH:]
        for call in batch:
            self.take(call)
        if self.is_up and not self.is_frozen:
            self._tick()
        if self._waiting:
            self.swarm.at(self.swarm.now + PAUSE, self._take_waiting)

    def older_disk(self, age: float) -> Disk:
        """The state folder as it was `age` s ago."""
        wanted = self.swarm.now - age
        return next((disk for at, disk in reversed(self.older) if at <= wanted), self.older[0][1])

    def _store(self, disk: Disk) -> None:
        self.disk = disk
        self.older.append((self.swarm.now, disk))

    # What comes

    def take(self, call: Callable[[], object]) -> None:
        """Something arrives for the daemon's loop, which may be stalled."""
        if not self.is_up:
            return
        if self.is_frozen:
            if len(self._waiting) < MAX_WAITING:
                self._waiting.append(call)
            return
        call()

    @property
    def author(self) -> Author:
        return Author(Role.ROBOT)

    def receive(self, body: Datagram, sender: Node) -> None:
        """A datagram arrives at its socket."""
        self.take(partial(self._on_datagram, body, sender, self.swarm.now, self.lives))

    def take_query(self, call: Callable[[VirtualDaemon], object], arrived: float) -> None:
        """What came by a link is handled; unlike a datagram it has no stamp of its arrival."""
        self._waited = self.swarm.now - arrived
        call(self)
        self._waited = 0.0

    def on_request(
        self, verb: str, payload: bytes, asker: str, answer: Callable[[bytes], None]
    ) -> None:
        """A request comes by a link."""
        if not self.is_settled:
            return

        def reply(content: bytes) -> None:
            self.swarm.answer(self.name, asker, partial(answer, content))

        source = str(self.swarm.nodes[asker].address)
        query: Any = VirtualQuery(payload, asker, source, reply)
        self.server.handle(verb, query)

    def put(self, sender: str, payload: bytes) -> None:
        """A message of a program comes by a link."""
        key = build("lab", sender, MESSAGE, "drive", "vote")
        kind, content = zenoh.SampleKind.PUT, zenoh.ZBytes(payload)
        self._session.messages.append(Mock(key_expr=key, kind=kind, payload=content))

    def knows(self, name: str) -> bool:
        """As `Network._is_robot`."""
        is_listed = self.swarm.is_secured and name in ROSTER
        if is_listed or name == self.name:
            return True
        return self.peer.membership.member(name, self.swarm.now) is not None

    def view(self) -> PeerView | None:
        """The answer to a question of an operator for the members."""
        if not self.is_settled:
            return None
        now = self.swarm.now
        members = tuple(self.peer.membership.members(now).values())
        return PeerView(robot=self.name, status=self.robot.status(now), members=members)

    def _on_datagram(self, body: Datagram, node: Node, arrived: float, life: int) -> None:
        if life != self.lives:
            return
        now, source = self.swarm.now, node.address
        author = node.author if self.swarm.is_secured else None
        waited = now - arrived
        effects = self.peer.on_datagram(
            body, source, now, self._summary(), author=author, waited=waited
        )
        for stop, sender in effects.stops:
            self.hops[stop.id] = max(stop.hops, self.hops.get(stop.id, 0))
            shown = struct_replace(stop, hops=max(stop.hops, 1)) if effects.is_repeated else stop
            self.server.stop(shown, str(sender), partial(self._ack, stop, sender))
        for stop, sender in effects.replayed:
            self._send(self._refused_ack(stop.id, REPLAYED), sender)
        for stop, sender, text in effects.refused:
            self.server.deny_stop(stop, str(sender), text, partial(self._deny, sender))
        self._apply(effects, source)
        if effects.beacon is not None:
            self.black_box.on_beacon(effects.beacon, source)
        self._tick_soon()

    def _deny(self, source: Address, reply: Reply) -> None:
        self._send(self._refused_ack(reply.id, Refusal.NOT_PERMITTED), source)

    def _refused_ack(self, id: str, refusal: str) -> Ack:
        return Ack(
            id=id,
            robot=self.name,
            instance=self.instance,
            revision=0,
            code=Code.REFUSED,
            refusal=refusal,
        )

    def _on_request(self, request: Request) -> None:
        self.waits[request.id] = max(self._waited, self.waits.get(request.id, 0.0))
        self.event = request
        self._step(RequestInput(request))
        self.event = None

    def _ack(self, stop: Stop, source: Address, reply: Reply) -> None:
        if not self.peer.owns_id or not self.peer.wants_ack(stop, source, self.swarm.now):
            return
        ack = Ack(
            id=reply.id,
            robot=self.name,
            instance=self.instance,
            revision=0 if reply.epoch is None else reply.epoch.revision,
            code=reply.code,
            refusal=reply.refusal,
            text=reply.text[:300],
            is_moving=reply.is_moving,
        )
        self._send(ack, source)

    def _apply(self, effects: PeerActions, source: Address | None = None) -> None:
        """As `Network._carry_out`."""
        for body, address in effects.sends:
            self._send(body, address)
        if effects.latches:
            self._step(LatchesInput(effects.latches))
        for found in effects.goals:
            if self.swarm.judge is not None and source is not None:  # else it is held already
                self.swarm.judge.on_found(self, found, self.swarm.name_of(source))
            self.event = found
            self._step(GoalInput(found.goal, found.age, may_join=found.may_join))
            self.event = None
        for robot in effects.changed:
            if (lost := self.peer.membership.lost_beacon(robot)) is not None:
                self.black_box.on_lost(lost)
        for heard in effects.leases:
            self._step(LeaseInput(heard.lease.id, heard.lease.count, heard.age))
        if effects.duplicate:
            self._step(DuplicateInput(effects.duplicate))

    def _send(self, body: Datagram, to: Address | None) -> None:
        if self.swarm.judge is not None:
            self.swarm.judge.on_send(self, body)
        self.swarm.send(self, body, to)

    def _summary(self) -> Summary:
        robot = self.robot
        return Summary(
            robot.state,
            robot.epoch.revision,
            robot.latches,
            robot.goal,
            pulled={RecordKind.INCIDENT: self.black_box.digest},
            wished=robot.wished,
            reset_at=robot.reset_at,
            cleared=robot.cleared,
        )

    # Ticks and actions

    def _tick_at(self, when: float) -> None:
        self._due = when
        self.swarm.at(when, partial(self._on_tick, when, self.lives))

    def _tick_soon(self) -> None:
        """Tick sooner than planned if the robot or the peer is due sooner."""
        due = self._next_tick()
        if due < self._due - 1e-6:
            self._tick_at(due)

    def _next_tick(self) -> float:
        now = self.swarm.now
        if not self.is_settled:
            return now + self.join_tick
        wanted = min(max(self.peer.wake_at(), now + TICK), now + LONGEST_TICK)
        if self.swarm.is_fenced and self.is_active:
            wanted = min(wanted, now + POSE_PERIOD)
        wake_at = self.robot.wake_at(now)
        return wanted if wake_at is None else min(wanted, max(wake_at, now + 1e-3))

    def _on_tick(self, planned: float, life: int) -> None:
        if planned == self._due and life == self.lives and self.is_up and not self.is_frozen:
            self._tick()

    def _tick(self) -> None:
        now = self.swarm.now
        # Odometry goes on after a stop, so that the robot knows that its base rests.
        is_read = self.is_active or self._scan_at < self._moved_at + SCAN_PERIOD
        if is_read and self.is_base_up and now - self._scan_at >= SCAN_PERIOD:
            self._measure()
        if self.swarm.is_fenced and is_read and now - self._posed_at >= POSE_PERIOD:
            self._posed_at = now
            self._step(OdometryInput(Odometry(now, Pose(self.x), self.twist)))
            told = Pose(self.x if self.told_x is None else self.told_x)
            self._step(PoseInput(SharedPose(now, told, 0.05, 0.05, FENCE.frame)))
        self._step(TICK_INPUT)
        self._apply(self.peer.advance(now, self._summary()))
        for message in self._programs.take(now):
            if self.swarm.judge is not None:
                self.swarm.judge.on_program(self, message.sender)
            self._step(MessageInput(*message, is_program=True))
        if self.admission is not None and self.admission.stops.counters != self.disk.counters:
            self._store(replace(self.disk, counters=dict(self.admission.stops.counters)))
        if not self.is_settled and self.peer.owns_id and self.peer.is_in_sync(now):
            self.is_settled = True
            self._step(DriverInput(True, "connected"))
        self._tick_at(self._next_tick())

    def _see(self, distance: float, life: int) -> None:
        if life == self.lives and self.is_base_up:
            self._measure(np.where(np.arange(len(NO_DATA)) == len(NO_DATA) // 2, distance, np.inf))

    def _measure(self, ranges: Array = NO_DATA) -> None:
        now, spec = self.swarm.now, platform().scan
        self._scan_at, self._scan_seq = now, self._scan_seq + 1
        self._step(OdometryInput(Odometry(now, Pose(self.x), ZERO)))
        scan = Scan(self._scan_seq, now, ranges, spec.bearings, spec.range_min, spec.range_max)
        self._step(ScanInput(scan))

    def _step(self, input: Input) -> None:
        """As `Daemon.step`."""
        now = self.swarm.now
        actions = self.black_box.recorder.step(self.robot, input, now)
        if actions is not None:
            self._carry_out(actions)
        self.black_box.step(input, now)

    def note(self, line: str) -> None:
        """A line for the log of the robot."""
        self._step(NoteInput(line))

    def _carry_out(self, actions: Actions) -> None:
        """As `Daemon._carry_out`."""
        self._move()
        self.twist = actions.twist
        if not self.twist.is_zero:
            self._moved_at = self.swarm.now
            if self.swarm.judge is not None:
                self.swarm.judge.on_twist(self)
        if actions.is_quiet:
            return
        if actions.goals is not None:
            self._write_soon(actions.goals)
        if actions.latches is not None:
            self._store(replace(self.disk, latches=actions.latches))
            if self.disk_time > DISK_TIME:  # latches are written on the loop
                self.freeze(self.disk_time)
        for command in (actions.trial, actions.host):
            if command is not None:
                self._command(command)
        for reply in actions.replies:
            if self.swarm.judge is not None:
                pending = self.server._pending.get(reply.id)
                if pending is not None and not isinstance(pending.request, _OF_SERVICES):
                    self.swarm.judge.on_reply(self, pending.request, reply)
            robot = self.robot
            if self._unwritten is None or robot.is_running or robot.latches:
                self.server.reply(reply)
            else:
                self._reply_once_stored(reply, self.swarm.now + STORE_TIME, self.lives)
        self._observe()

    def _write_soon(self, goals: GoalRecord) -> None:
        """As `RecordWriter`: one write at a time, then the newest record."""
        is_writing, self._unwritten = self._unwritten is not None, goals
        if not is_writing:
            self._write_goals(goals)

    def _write_goals(self, goals: GoalRecord) -> None:
        life = self.lives

        def end() -> None:
            newest = self._unwritten
            if not self.is_up or life != self.lives or newest is None:
                return
            self._store(replace(self.disk, goals=goals))
            self._unwritten = None if newest is goals else newest
            if newest is not goals:
                self._write_goals(newest)

        self.swarm.at(self.swarm.now + self.disk_time, end)

    def _reply_once_stored(self, reply: Reply, until: float, life: int) -> None:
        """As `Daemon._answer`."""
        if not self.is_up or life != self.lives:
            return
        is_stored = self._unwritten is None
        if is_stored or self.swarm.now >= until:
            self.take(lambda: self.server.reply(reply, is_stored=is_stored))
            return
        again = partial(self._reply_once_stored, reply, until, life)
        self.swarm.at(self.swarm.now + DISK_TIME, again)

    def _move(self) -> None:
        """Move as the last command says, which counts for COMMAND_TIME at most."""
        seconds, self._moved_to = self.swarm.now - self._moved_to, self.swarm.now
        way = self.twist.linear * min(seconds, COMMAND_TIME)
        if self.swarm.is_fenced:
            self.x += way
            self.told_way += abs(way)

    _moved_to = 0.0

    def _observe(self) -> None:
        """Find the cause of the pattern that runs, and let the judge look."""
        generation = self.robot.running_generation
        if self.robot.is_running and generation in self._causes:
            is_new = self.cause is not self._causes[generation]
            self.cause = self._causes[generation]
            if is_new and self.cause.request is not None:
                self.told_way = 0.0
        if self.swarm.judge is not None:
            self.swarm.judge.on_event(self)

    # The pattern host

    def _command(self, command: HostCommand) -> None:
        if isinstance(command, Step):
            speed = SPEEDS.get(self._pattern, 0.1)
            stepped = Stepped(command.generation, Outputs(twist=Twist(speed)), self._scan_seq)
            self._step(HostInput(stepped))
        elif isinstance(command, KillHost):
            self._load = next(self._loads)
        elif isinstance(command, SetParams):
            done = ParamsSet(command.generation, command.request, "", {"a": (1.0, "b")})
            self._host_says(done, 0.0)
        elif isinstance(command, Load):
            self._load = next(self._loads)
            self._causes[command.generation] = self._cause_of(command)
            self._pattern = command.pattern
            self._host_says(self._loaded(command), LOAD_TIME, self._load)
        elif isinstance(command, StartTrial):
            self._host_says(TrialDone(command.load.generation, ""), TRIAL_TIME)

    def _cause_of(self, load: Load) -> Cause:
        request = self.event
        goal = self.robot.goals.own
        if request is None and self.robot.is_running and self.cause is not None:
            return self.cause  # a pattern that failed is restarted
        if isinstance(request, FoundGoal) or request is None:
            return Cause(self.swarm.now, None, "" if goal is None else goal.id)
        found = getattr(request, "goal", None)
        if isinstance(request, ReloadRequest) and request.keeps_running:
            return Cause(self.swarm.now, None, "" if goal is None else goal.id)
        assert not isinstance(request, TrialDone)
        return Cause(self.swarm.now, request, "" if found is None else found.id)  # type: ignore[arg-type]

    def _loaded(self, load: Load) -> HostEvent:
        if load.pattern not in PATTERNS | self.disk.patterns:
            return LoadRefused(load.generation, "no such pattern", Refusal.UNKNOWN_PATTERN)
        params = dict(load.layers).get("request", {})
        if "wrong" in params:
            return LoadRefused(load.generation, "wrong", Refusal.INVALID_PARAMETER, "wrong")
        return Loaded(load.generation, 1.0, frozenset(), {})

    def _host_says(self, event: HostEvent, delay: float, load: int | None = None) -> None:
        life = self.lives

        def say() -> None:
            if life == self.lives and load in (None, self._load):
                self._step(HostInput(event))

        self.swarm.at(self.swarm.now + delay, lambda: self.take(say))

    def push(self, pattern: str, request_id: str, operator: str) -> None:
        """Code of a pattern is stored; the robot tries it, as `PatternControl` asks."""
        if not self.is_settled:
            return
        self._store(replace(self.disk, patterns=self.disk.patterns | {pattern}))
        request = ReloadRequest(
            id=request_id,
            operator=operator,
            targets={self.name: self.robot.epoch},
            pattern=pattern,
            keeps_running=True,
        )
        self._on_request(request)


@cache
def platform() -> Platform:
    """A platform whose scans cost little: eight rays, twice a second."""
    base = load_platform("waffle_pi")
    bearings = np.linspace(-math.pi, math.pi, 8, endpoint=False)
    scan = replace(
        base.scan,
        bearings=bearings,
        rate=1.0 / SCAN_PERIOD,
        is_noisy=False,
        sweep=None,
        zero="no_return",
        near="reported",
        max_gap=math.pi,
    )
    return replace(base, scan=scan, protection={**base.protection, "mode": "barrier"})
