"""The carriers of an operator: its datagrams and its Zenoh sessions.

Datagrams are signed and sent by a carrier, and verified when they arrive. Zenoh sessions are links
to the robots that the operator found, for queries and subscriptions.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import socket
import sys
import threading
from collections.abc import Callable, Collection, Iterable
from typing import TYPE_CHECKING, Protocol

from swarmd.core.clock import boottime
from swarmd.core.closing import is_program_ended
from swarmd.core.errors import CodecError, ForkedError, NetworkError
from swarmd.core.keys import ANY, ANYONE, CONTROL, build, parse
from swarmd.link.carriers.forked import check_not_forked
from swarmd.link.carriers.query_links import QueryLinks
from swarmd.link.datagram import Address, Beacon, Datagram, OnDatagram, Solicit, Swarm, pack, unpack
from swarmd.link.keys.identity import Identity
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.clocks import Arrivals, RobotClocks
from swarmd.operator.session.discovery import Discovery
from swarmd.operator.session.roster import CLOSING

if TYPE_CHECKING:
    import zenoh

    from swarmd.operator.session.admission import OperatorAdmission


OnBody = Callable[[Datagram, Address, float], bool]
"""Takes a datagram, its source and the time, with the lock held; True to wake a waiting call."""


class Carrier(Protocol):
    """What carries datagrams; see `udp.UdpCarrier`."""

    def send(self, payload: bytes) -> None:
        """Send to all."""

    def send_to(self, payload: bytes, address: Address) -> None:
        """Send to one address."""

    def confirm(self, source: Address) -> None:
        """Send datagrams to this source: its last beacon is signed and fresh."""

    def start_thread(self, on_datagram: OnDatagram) -> None:
        """Call `on_datagram` for each datagram that arrives, on a thread."""

    def close(self) -> None:
        """End."""


def reachable(address: Address, interface: str) -> Address:
    """The address; a link-local address gets the scope of this machine's interface."""
    host, port = address
    if not host.lower().startswith("fe80:"):
        return address
    try:
        index = socket.if_nametoindex(interface)
    except OSError:
        return address
    return f"{host.partition('%')[0]}%{index}", port


class OperatorDatagrams:
    """Sends the operator's datagrams, and checks the datagrams that robots send.

    `answers`: the operator's keys and checks in a secured swarm; replace them under the lock of
    `arrivals`. From `start` on, `on_body` gets each accepted datagram, on the carrier's thread.
    """

    def __init__(
        self,
        carrier: Carrier,
        tag: bytes,
        interface: str,
        arrivals: Arrivals,
        on_body: OnBody,
        *,
        answers: OperatorAdmission | None = None,
    ) -> None:
        self.carrier = carrier
        self.answers = answers
        self._tag = tag
        self._interface = interface
        self._arrivals = arrivals
        self._on_body = on_body
        self._echo = int.from_bytes(os.urandom(6), "big")
        self.clocks = RobotClocks()  # use it under the lock of `arrivals`

    def start(self) -> None:
        """Begin to receive."""
        self.carrier.start_thread(self._on_datagram)

    def send(
        self, body: Datagram, addresses: Iterable[Address] = (), *, is_to_all: bool = True
    ) -> None:
        """Send a datagram to all, and to each of these addresses."""
        payload = pack(self._tag, body)
        if self.answers is not None:
            payload = self.answers.sign(payload)
        if is_to_all:
            self.carrier.send(payload)
        for address in addresses:
            self.carrier.send_to(payload, reachable(address, self._interface))

    def solicit(self, discovery: Discovery, now: float) -> None:
        """Ask robots for beacons, and for member lists and statuses if they are due.

        The first solicit of a look by datagrams asks all robots for their statuses. Later ones are
        for the robots whose status has not come.
        """
        with self._arrivals.lock:
            wants_status = discovery.begin_status_request()
            echo = self._new_echo(discovery, now, wants_status=wants_status)
            wants_members = discovery.begin_list_request(now)
            addresses = discovery.to_solicit()
            to_ask = discovery.to_ask(now) if discovery.asks_by_datagram else ()
            status_echo = 0
            if to_ask:
                status_echo = self._new_echo(discovery, now, wants_status=True, is_to_all=False)
        solicit = Solicit(echo=echo, wants_members=wants_members, wants_status=wants_status)
        self.send(solicit, addresses)
        if to_ask:
            self.send(Solicit(echo=status_echo, wants_status=True), to_ask, is_to_all=False)

    def ask_clocks(self, discovery: Discovery, now: float) -> None:
        """Ask robots for beacons, which show their clocks; also robots that have just started."""
        with self._arrivals.lock:
            echo = self._new_echo(discovery, now)
            addresses = discovery.to_solicit()
        self.send(Solicit(echo=echo), addresses)

    def _new_echo(
        self,
        discovery: Discovery,
        now: float,
        *,
        wants_status: bool = False,
        is_to_all: bool = True,
    ) -> int:
        """The number of a solicit that is sent now; call it with the lock held."""
        self._echo += 1
        if self.answers is not None:
            self.answers.freshness.note_echo(self._echo, now)
        self.clocks.on_solicit(self._echo, now)
        discovery.on_solicit(self._echo, now, wants_status=wants_status, is_to_all=is_to_all)
        return self._echo

    def _on_datagram(self, payload: bytes, source: Address, waited: float) -> None:
        """Check a datagram and hand it to `on_body`; the carrier's thread calls it."""
        try:
            body = unpack(self._tag, payload)
        except CodecError:
            return
        if body is None:
            return
        with self._arrivals.lock:
            now = boottime()
            if self.answers is not None and not isinstance(body, Swarm):
                body = self.answers.admit(body, payload, source, now)
                if body is None:
                    return
                if isinstance(body, Beacon):
                    self.carrier.confirm(source)
                    self.clocks.on_beacon(body, now)
            if self._on_body(body, source, now):
                self._arrivals.notify()


# s since the last new robot, after which the new robots are dialled together; at most
# MAX_GATHER_TIMES as long while robots keep being found.
GATHER_TIME = 0.004
MAX_GATHER_TIMES = 10
# The most sessions at a time, and the s between two, doubled with each session.
MAX_SESSIONS = 8
DIAL_PERIOD = 0.01
# A robot that does not answer is dialled again after REDIAL_WAIT s and REDIAL_TRIPS round trips.
REDIAL_WAIT = 1.5
REDIAL_TRIPS = 5.0
_ENDING = 1.0  # s for which the end of the program waits for a call of Zenoh, or for a close

Handler = Callable[[str, bytes], object]
"""Takes the robot and the payload of a reply or sample; may raise CodecError."""

_Addresses = dict[tuple[str, str], Address]
"""The address of each robot, by name and instance (one life of its daemon)."""


class OperatorSessions:
    """The sessions to the robots of one swarm; `identity`: of the operator in a secured swarm.

    A session that was not closed is closed when the program ends. Python aborts a program that ends
    while a daemon thread is inside a call of Zenoh; so the end waits for such a call, and keeps
    other threads from calling Zenoh again.
    """

    def __init__(
        self, settings: NetworkSettings, identity: Identity | None, arrivals: Arrivals
    ) -> None:
        self._identity = identity
        self._settings = settings
        self._asker = ANYONE if identity is None else identity.name
        self._arrivals = arrivals
        self._opened: list[zenoh.Session] = []
        self._process = os.getpid()
        self._dial_at = 0.0
        self._waiting_since: float | None = None  # since when robots wait to be dialled
        # By robot and instance: the address that was dialled last, and when.
        self._dialled: dict[tuple[str, str], tuple[Address, float]] = {}
        # The handler of each watched state (name and robot).
        self._watched: dict[tuple[str, str], Handler] = {}
        self._subscribers: dict[tuple[str, str], list[zenoh.Subscriber[None]]] = {}
        self._endpoints: set[str] = set()  # all that were dialled
        self._closing: list[threading.Thread] = []
        self._calls = threading.RLock()  # held during each call of Zenoh

    @property
    def needs_links(self) -> bool:
        """True if robots are dialled; False if routers link all robots."""
        return self._settings.profile != "routed"

    @property
    def is_open(self) -> bool:
        """True if there is a session."""
        return bool(self._opened)

    def prepare(self) -> None:
        """Load Zenoh, which takes 8 ms, before robots are dialled."""
        if self.needs_links:
            import swarmd.link.carriers.session  # noqa: F401  # a look without links does without

    def open(self) -> zenoh.Session:
        """Open a session that dials no robot."""
        from swarmd.link.carriers.session import open_operator_session

        with self._calls:
            session = open_operator_session(self._settings, (), self._identity)
        self._add([session])
        return session

    def _add(self, sessions: list[zenoh.Session]) -> None:
        """Keep open sessions, until `close` or the end of the program."""
        self._opened += sessions
        atexit.unregister(self._end)
        atexit.register(self._end)

    def take_identity(self, identity: Identity) -> None:
        """Dial as this identity from now on.

        Sessions to robots are closed, since their access rules follow from the roster of the
        identity. A session to routers has no access rules, and stays open: the carrier of datagrams
        uses this session.
        """
        self._identity = identity
        if self.needs_links:
            self.close()

    def close(self) -> list[threading.Thread]:
        """Close all sessions, each on a thread; robots are dialled anew afterwards.

        Once the main thread has ended, at which Python starts no more threads, they are closed at
        the return. A child process of `os.fork` closes none: they are its parent's.
        """
        if os.getpid() != self._process:
            return []
        if is_program_ended():
            from swarmd.link.carriers.session import end_dials

            end_dials(self._endpoints)
            for session in self._take_opened():
                _close(session)
        closing = [
            threading.Thread(target=self._close, args=(session,), name=CLOSING, daemon=True)
            for session in self._take_opened()
        ]
        self._closing += closing
        for thread in closing:
            thread.start()
        return closing

    def _take_opened(self) -> list[zenoh.Session]:
        opened = self._opened
        self._opened = []
        self._dialled.clear()
        return opened

    def _close(self, session: zenoh.Session) -> None:
        """On a thread: close a session that was taken."""
        _close(session)
        self._closing.remove(threading.current_thread())
        if not self._opened and not self._closing:
            atexit.unregister(self._end)

    def _end(self) -> None:
        """At the end of the program: close all sessions; no other thread calls Zenoh again.

        A child process of `os.fork` has none of Zenoh's threads, and a close would wait for them.
        """
        if os.getpid() != self._process:
            return
        self._calls.acquire(timeout=_ENDING)  # and never released
        self.close()
        for thread in self._closing.copy():
            thread.join(_ENDING)

    # Links

    def dial(self, discovery: Discovery, now: float, only: Collection[str] | None = None) -> float:
        """Dial the robots that `discovery` has found and that have no link, if that is due now.

        `only`: dial only these robots. None: dial all robots of `Discovery.to_link`, and dial a
        robot again if its status does not come. Beyond MAX_SESSIONS all sessions are closed and all
        robots dialled anew. Returns the s after which to call again; inf if no robot waits to be
        dialled.
        """
        reachable, to_dial = self._to_dial(discovery, now, only)
        if not to_dial or not self.needs_links:
            self._waiting_since = None
            return float("inf")
        if self._waiting_since is None:
            self._waiting_since = now
        # Wait for more robots, so that one session dials many.
        latest = self._waiting_since + MAX_GATHER_TIMES * GATHER_TIME
        gathered_at = min(discovery.found_at + GATHER_TIME, latest)
        due_at = max(gathered_at, self._dial_at)
        if now < due_at:
            return due_at - now
        if len(self._opened) >= MAX_SESSIONS:
            self.close()
            to_dial = dict(reachable)
        self._open_sessions(to_dial, now)
        return float("inf")

    def _open_sessions(self, to_dial: _Addresses, now: float) -> None:
        """Dial these robots, and subscribe to the keys that are watched.

        Zenoh cannot add an endpoint to a session, so each call opens a further session. If Zenoh
        refuses an endpoint, the call opens several sessions. The pause until the next robots are
        dialled doubles with each session.
        """
        interface = self._settings.interface_name
        endpoints = sorted({endpoint_of(address, interface) for address in to_dial.values()})
        self._endpoints.update(endpoints)
        with self._calls:
            opened = self._open_to(endpoints)
            self._add(opened)
            for session in opened:
                for name, robot in self._watched:
                    self._subscribe(session, name, robot)
        self._dialled.update({key: (address, now) for key, address in to_dial.items()})
        self._dial_at = now + DIAL_PERIOD * 2 ** len(self._opened)

    def linked(self, links: QueryLinks, robots: Collection[str]) -> set[str]:
        """The robots in `robots` to which a link is up, so that a query reaches them."""
        with self._calls:
            return links.of(robots, self._opened)

    def _open_to(self, endpoints: list[str]) -> list[zenoh.Session]:
        """A session to all endpoints; several sessions if Zenoh refuses some of the endpoints."""
        from swarmd.link.carriers.session import open_operator_session

        try:
            return [open_operator_session(self._settings, endpoints, self._identity)]
        except ForkedError:
            raise
        except NetworkError:
            if len(endpoints) < 2:
                return []
            half = len(endpoints) // 2
            first = endpoints[:half]
            second = endpoints[half:]
            return [*self._open_to(first), *self._open_to(second)]

    # Queries

    def question_links(self, name: str) -> QueryLinks:
        """Shows which robots a query `control/<name>` of this operator reaches; to be closed."""
        key = build(self._settings.swarm, ANY, CONTROL, name, self._asker)
        return QueryLinks(key, self._calls)

    def _to_dial(
        self, discovery: Discovery, now: float, only: Collection[str] | None
    ) -> tuple[_Addresses, _Addresses]:
        """Two groups: the robots that can be dialled, and among them those to dial now.

        A robot is dialled if the robot is new, has a new address, or has not answered for some
        time. `only`: consider only these robots. They have no link, so they are dialled again even
        if they answered earlier. None: consider all robots.
        """
        with self._arrivals.lock:
            reachable = discovery.to_link(now) if only is None else discovery.to_dial(now)
            if not reachable:
                return {}, {}
            answered = discovery.answered
            redial_after = REDIAL_WAIT + REDIAL_TRIPS * discovery.round_trip
        if only is not None:
            answered = frozenset()
            reachable = {key: address for key, address in reachable.items() if key[0] in only}
        to_dial: _Addresses = {}
        for (robot, instance), address in reachable.items():
            dialled_address, dialled_at = self._dialled.get((robot, instance), (None, 0.0))
            waits_since = max(dialled_at, discovery.started)
            lacks_answer = robot not in answered and now - waits_since >= redial_after
            if dialled_address != address or lacks_answer:
                to_dial[robot, instance] = address
        return reachable, to_dial

    def get(
        self, robot: str, plane: str, name: str, payload: bytes, timeout: float, handler: Handler
    ) -> None:
        """Query `<plane>/<name>` of `robot` (ANY: of all robots) in every session.

        `handler(robot, payload)` takes each reply, on a thread of Zenoh with the lock held. Replies
        on other keys are dropped. The caller repeats a query without a reply.
        """
        import zenoh
        from zenoh.handlers import Callback

        from swarmd.link.carriers.session import MAX_WIRE

        asker = self._asker if plane == CONTROL else ""  # keys of `state` end without an asker

        def on_reply(reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is None or len(sample.payload) > MAX_WIRE:
                return
            key = parse(str(sample.key_expr))
            expected = (self._settings.swarm, plane, name, asker)
            if key is None or (key.swarm, key.plane, key.name, key.last) != expected:
                return
            content = sample.payload.to_bytes()
            with self._arrivals.lock, contextlib.suppress(CodecError):
                handler(key.robot, content)
                self._arrivals.notify()

        for session in self._opened:
            with self._calls, contextlib.suppress(zenoh.ZError):
                session.get(
                    build(self._settings.swarm, robot, plane, name, asker),
                    Callback(on_reply, indirect=False),  # on Zenoh's own thread
                    target=zenoh.QueryTarget.ALL,
                    # With consolidation Zenoh would hold back replies until the query ends.
                    consolidation=zenoh.ConsolidationMode.NONE,
                    # The reply inherits DROP, and so does not block the loop of a daemon.
                    congestion_control=zenoh.CongestionControl.DROP,
                    priority=zenoh.Priority.INTERACTIVE_HIGH,
                    express=True,
                    timeout=timeout,
                    payload=payload,
                    source_info=zenoh.SourceInfo(session.id, 0),  # for the robot's log
                )

    # Subscriptions

    def watch(self, name: str, handler: Handler, robot: str) -> None:
        """Hand what robots publish on `state/<name>` to `handler`, in later sessions as well.

        ForkedError in a process to which no session would bring anything.
        """
        check_not_forked(f"nothing is heard of swarm {self._settings.swarm!r}")
        self._watched[name, robot] = handler
        with self._calls:
            for session in self._opened:
                self._subscribe(session, name, robot)

    def unwatch(self, name: str, robot: str) -> None:
        """End the subscriptions that `watch` has made."""
        if sys.is_finalizing():  # an iterator that was left; the session is closed
            return
        if os.getpid() != self._process:  # a fork closes nothing of its parent
            return
        from swarmd.link.carriers.session import undeclare

        self._watched.pop((name, robot), None)
        with self._calls:
            undeclare(*self._subscribers.pop((name, robot), ()))

    def _subscribe(self, session: zenoh.Session, name: str, robot: str) -> None:
        import zenoh

        from swarmd.link.carriers.session import MAX_WIRE, on_thread

        handler = self._watched[name, robot]
        swarm = self._settings.swarm

        def on_sample(sample: zenoh.Sample) -> None:
            key = parse(str(sample.key_expr))
            if key is None or (key.swarm, key.plane, key.name) != (swarm, "state", name):
                return
            if len(sample.payload) <= MAX_WIRE:
                with contextlib.suppress(CodecError):
                    handler(key.robot, sample.payload.to_bytes())

        with contextlib.suppress(zenoh.ZError):
            key = build(swarm, robot, "state", name)
            subscriber = session.declare_subscriber(key, on_thread(on_sample))
            self._subscribers.setdefault((name, robot), []).append(subscriber)


def endpoint_of(address: Address, interface: str) -> str:
    """The endpoint of Zenoh at an address, as dialled from this machine's interface."""
    host, port = reachable(address, interface)
    return f"tcp/[{host}]:{port}" if ":" in host else f"tcp/{host}:{port}"


def _close(session: zenoh.Session) -> None:
    with contextlib.suppress(Exception):  # any error: the command has its answer already
        session.close()
