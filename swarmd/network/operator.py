"""The operator's side: finds the members of a swarm, sends requests and collects the acks.

Synchronous, without asyncio and numpy, since a command must start fast::

    with Operator(settings) as operator:
        view = operator.members()
        outcome = operator.request(RunRequest, view.epochs(names), pattern="attraction")
        outcome = operator.send_stop("estop", reason="...")

Robots are found, stopped and emergency-stopped by datagrams. Everything else goes by Zenoh, on
links that the operator dials to the addresses of the robots that it found. Zenoh's threads and the
carrier's thread only put what they receive into tables under one lock; the caller's thread waits.
"""

from __future__ import annotations

import contextlib
import getpass
import os
import socket
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, Protocol, Self, TypeVar

from msgspec.structs import replace

from swarmd.core import codec
from swarmd.core.clock import boottime
from swarmd.core.codec import MAX_CONTROL, Decoder, encode, version_of
from swarmd.core.errors import CodecError, ConfigError, NetworkError
from swarmd.core.keys import ANY, ANYONE, CONTROL, build, parse
from swarmd.core.messages import (
    AnyRequest,
    Code,
    Epoch,
    MembersQuery,
    PeerView,
    Refusal,
    Reply,
    ReplyHeader,
    StatusHeader,
)
from swarmd.network.access import may_ask
from swarmd.network.datagram import (
    ANY_SWARM,
    Ack,
    Address,
    Beacon,
    Datagram,
    MemberList,
    OnDatagram,
    Solicit,
    Stop,
    Swarm,
    pack,
    tag_of,
    unpack,
)
from swarmd.network.discovery import DEV_WAIT, FIRST_ROBOT_TIMEOUT, Discovery
from swarmd.network.members_view import MembersView
from swarmd.network.outcome import Acks, Outcome
from swarmd.network.query_links import QueryLinks
from swarmd.network.repeat_timer import RepeatTimer
from swarmd.network.roster_follower import CLOSING, RosterFollower
from swarmd.network.settings import NetworkSettings
from swarmd.network.stop_request import PendingStop, Renew, Select
from swarmd.security.identity import Identity, authority_of

if TYPE_CHECKING:
    import zenoh

    from swarmd.network.answers import Answers

# (until, period) in s since the start: often at first, then sparing the network.
SOLICIT_PACE = ((0.5, 0.1), (float("inf"), 0.5))
STOP_PACE = ((1.0, 0.1), (float("inf"), 0.25))
POLL_PACE = ((0.2, 0.015), (float("inf"), 0.1))
# A request without a reply is repeated after this time, in s: a congested or closing link loses it.
REPEAT_PERIOD = 0.5
# How long a request waits by default, in s, in round trips, and times the loss (see discovery.py).
REQUEST_WAIT, REQUEST_TRIPS, REQUEST_LOSS_WAIT = 5.0, 8.0, 15.0
REQUEST_CAP = 45.0  # or `least`, if that is longer
# Robots found within this time of each other are dialled together, in s.
GATHER_TIME = 0.004
# Sessions at a time, and the time before a second one, in s; it doubles with each.
MAX_SESSIONS, DIAL_PERIOD = 8, 0.01
# A robot that is heard and does not answer is dialled again after this time, in s and round trips.
REDIAL_WAIT, REDIAL_TRIPS = 1.5, 5.0
# How often a request looks for links that have come up, in s.
LINK_PERIOD = 0.003
# A look that needs no status asks for them only after this time, in s: it takes longer than most.
STATUS_DELAY = 0.1
CLOSE_TIMEOUT = 0.2
MAX_SWARMS = 256
MAX_EXCUSED = 512  # names in a question for members: they fit one request
SWARMS_TIME = 0.3
PROGRESS_PERIOD = 3.0
# What a request may hold, in characters, and in bytes where it must fit a datagram.
MAX_OPERATOR, MAX_OPERATOR_BYTES = 128, 256
MAX_REASON, MAX_REASON_BYTES = 256, 512
COMMANDING, LOOKING = "swarmd-commanding", "swarmd-looking"
"""The names of the daemon threads that carry commands of a view out, and that look for it."""

R = TypeVar("R", bound=AnyRequest)
D = TypeVar("D")

StopVerb = Literal["stop", "estop"]

_header = Decoder(StatusHeader, any_version=True)
_reply_header = Decoder(ReplyHeader, any_version=True)
_reply = Decoder(Reply, MAX_CONTROL)


class Carrier(Protocol):
    """What carries datagrams; see `udp.UdpCarrier`."""

    def send(self, payload: bytes) -> None:
        """Send to all."""

    def send_to(self, payload: bytes, address: Address) -> None:
        """Send to one address."""

    def confirm(self, source: Address) -> None:
        """The last beacon from this source counts, in a secured swarm."""

    def start_thread(self, on_datagram: OnDatagram) -> None:
        """Hand what arrives to `on_datagram`."""

    def close(self) -> None:
        """End."""


def operator_name() -> str:
    """The name of this operator, such as `anna@laptop`."""
    try:
        user = getpass.getuser()
    except (OSError, KeyError):
        user = f"uid{os.getuid()}"
    return _sendable(f"{user}@{socket.gethostname()}", MAX_OPERATOR, MAX_OPERATOR_BYTES)


def _sendable(text: str, length: int, room: int) -> str:
    """The first `length` characters and `room` bytes; what UTF-8 cannot carry becomes `?`.

    A stop must not fail because of its reason, so the reason is mended and not refused.
    """
    whole = text.encode("utf-8", "replace").decode()[:length]
    return whole.encode()[:room].decode(errors="ignore")


class Operator:
    """An operator in a swarm; a context manager.

    `settings` are those of the swarm. With an `identity` the swarm is secured, and the operator's
    name is that of the identity. `roster` names robots that are expected even if no daemon
    has seen them. `takes_rosters` False: it stays with the identity's roster. Raises
    NetworkError in one line if the network cannot be used.
    """

    def __init__(
        self,
        settings: NetworkSettings,
        *,
        identity: Identity | None = None,
        name: str | None = None,
        roster: Iterable[str] = (),
        carrier: Carrier | None = None,
        takes_rosters: bool = True,
    ) -> None:
        settings.check()
        self.settings = settings
        self.identity = identity
        whole = name or operator_name() if identity is None else identity.name
        self.name = _sendable(whole, MAX_OPERATOR, MAX_OPERATOR_BYTES)
        self._asker = ANYONE if identity is None else identity.name
        self._roster = frozenset(roster)
        if identity is not None:
            self._roster |= frozenset(identity.roster.robots)
        self._tag = tag_of(settings.profile, settings.swarm, authority_of(identity))
        self._news = threading.Condition()
        self._version = 0
        self._discovery: Discovery | None = None
        self._looked = MembersView({})
        self._stop: PendingStop | None = None
        self._swarms: set[str] = set()
        self._echo = int.from_bytes(os.urandom(6), "big")
        self._rosters = RosterFollower(self, is_on=takes_rosters)
        self._answers: Answers | None = None  # in a secured swarm
        if identity is not None:
            from swarmd.network.answers import Answers

            self._answers = Answers(identity, settings.lease_seconds, self._rosters.on_shown)
        self._sessions: list[zenoh.Session] = []
        self._dial_at = 0.0
        self._wanted_at: float | None = None
        self._dialled: dict[tuple[str, str], tuple[Address, float]] = {}
        self._watched: dict[tuple[str, str], Callable[[str, bytes], object]] = {}
        self._subscribers: dict[tuple[str, str], list[zenoh.Subscriber[None]]] = {}
        self._listeners: dict[type, Callable[[Any, float], object]] = {}
        self._carrier = carrier or self._open_carrier()
        self._carrier.start_thread(self._on_datagram)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the network, within 0.2 s: sessions that take longer are closed on a thread."""
        with contextlib.suppress(Exception):
            self._carrier.close()
        closing = self._close_sessions()
        deadline = boottime() + CLOSE_TIMEOUT
        for thread in closing:
            thread.join(max(0.0, deadline - boottime()))

    def trust_notes(self) -> tuple[str, ...]:
        """Lines about robots whose keys do not fit those of this identity; for an answer."""
        with self._news:
            if self._answers is None:
                return ()
            notes = list(self._unproven(self._answers.unproven))
            for robot, (host, _) in sorted(self._answers.outdated.items()):
                notes.append(f"{robot} at {host} seems to have an older roster, and is not counted")
            if self._rosters.shown is not None:
                robot, (host, _), generation = self._rosters.shown
                notes.append(f"{robot} at {host} seems to have a newer roster, {generation}")
            return tuple(notes)

    @property
    def notices(self) -> list[str]:
        """Lines about rosters that were taken, or could not be, for the user."""
        return self._rosters.notices

    @property
    def outdated(self) -> Mapping[str, Address]:
        """The robots that were heard with an older roster than that of the identity, not proven."""
        with self._news:
            return {} if self._answers is None else dict(self._answers.outdated)

    def update_roster(self) -> bool:
        """Take the newer roster that a robot has shown, if any; True if it was taken.

        `notices` gets a line. Raises NetworkError if the own name is no longer on it.
        """
        before = self.identity
        self._rosters.update()
        return self.identity is not before

    def take_identity(self, identity: Identity) -> None:
        """Ask with this identity from the next look on: with its keys, on links of its own."""
        from swarmd.network.answers import Answers

        answers = Answers(identity, self.settings.lease_seconds, self._rosters.on_shown)
        with self._news:
            self.identity, self._answers, self._rosters.shown = identity, answers, None
            self._roster |= frozenset(identity.roster.robots)
            self._dialled.clear()
        self._close_sessions()

    def expect(self, names: Iterable[str]) -> None:
        """Expect these robots as well, as if they were on the roster."""
        self._roster |= frozenset(names)

    # Looks

    def members(self, *, timeout: float | None = None, needs_status: bool = True) -> MembersView:
        """The members, once all that are expected have answered.

        Else after `timeout` s, or after a time that follows from the round trip. Without
        `needs_status` a datagram is answer enough: its beacon has the epoch for a request. If
        robots are missing that may have a newer roster, it is taken, and the look repeated.
        """
        view = self._look(timeout, needs_status=needs_status)
        if view.missing and self.update_roster():
            view = self._look(timeout, needs_status=needs_status)
        return view

    def _look(self, timeout: float | None, *, needs_status: bool) -> MembersView:
        now = boottime()
        discovery = self._new_discovery(now, needs_status=needs_status)
        solicit, poll = RepeatTimer(now, SOLICIT_PACE), RepeatTimer(now, POLL_PACE)
        until = None if timeout is None else now + timeout
        ask_at = now if needs_status else now + STATUS_DELAY
        over = RepeatTimer(now, ((float("inf"), 0.02),))
        while True:
            with self._news:
                now, version = boottime(), self._version
                is_complete = discovery.is_complete(now)
                is_late = until is not None and now >= until
                is_over = until is None and over.is_due(now) and discovery.is_over(now)
            if is_complete or is_late or is_over:
                while is_complete and (wait := self._dial(discovery, now)) < float("inf"):
                    time.sleep(wait)
                    now = boottime()
                with self._news:
                    self._looked = discovery.result(now)
                    return self._looked
            if solicit.is_due(now):
                self._solicit(discovery, now)
            wait = self._dial(discovery, now)
            if now >= ask_at and poll.is_due(now):
                self._ask_members(discovery)
            ends = [0.02 if until is None else until - now, wait]
            self._wait(version, min(solicit.pause(now), poll.pause(now), *ends))

    def seen(self) -> MembersView:
        """The members as the last look or stop has found them by now."""
        now = boottime()
        with self._news:
            return (self._discovery or Discovery(now, self._roster)).result(now)

    def links(self) -> frozenset[tuple[str, str]]:
        """Pairs of robots that reported each other as alive to the last look."""
        with self._news:
            return frozenset() if self._discovery is None else self._discovery.links(boottime())

    def ways(self, robot: str) -> tuple[str, ...]:
        """By which ways beacons of a robot came lately; empty without any, and by routers."""
        from swarmd.network.udp import UdpCarrier

        now = boottime()
        with self._news:
            found = {} if self._discovery is None else self._discovery.to_dial(now)
            addresses = [address for (name, _), address in found.items() if name == robot]
        if not isinstance(self._carrier, UdpCarrier):
            return ()
        return tuple(way for one in addresses[:1] for way in self._carrier.ways.of(one, now))

    def swarms(self, *, timeout: float = SWARMS_TIME) -> tuple[str, ...]:
        """The names of all swarms within reach, for an operator who finds no member of this one."""
        pace = RepeatTimer(boottime(), ((float("inf"), 0.1),))
        while pace.age(now := boottime()) < timeout:
            if pace.is_due(now):
                self._carrier.send(pack(ANY_SWARM, Solicit(echo=0)))
            time.sleep(pace.pause(now))
        with self._news:
            return tuple(sorted(self._swarms))

    def watch(self, name: str, handler: Callable[[str, bytes], object], robot: str = ANY) -> None:
        """Hand what robots publish on `state/<name>` to `handler`, with the robot's name.

        On Zenoh's threads, for robots that are found now and by later looks. `unwatch` ends it.
        """
        self._watched[name, robot] = handler
        for session in self._sessions:
            self._subscribe(session, name, robot)

    def unwatch(self, name: str, robot: str = ANY) -> None:
        """End what `watch` began."""
        from swarmd.network.session import undeclare

        self._watched.pop((name, robot), None)
        undeclare(*self._subscribers.pop((name, robot), ()))

    def listen(self, kind: type[D], handler: Callable[[D, float], object] | None) -> None:
        """Hand datagrams of a kind to `handler` with the time, on the carrier's thread; None ends.

        The handler must not block and takes no lock.
        """
        with self._news:
            self._listeners.pop(kind, None)
            if handler is not None:
                self._listeners[kind] = handler

    def send_to_robots(self, make: Callable[[], Datagram], robots: Collection[str]) -> None:
        """Send a datagram, made anew for each, to robots that the last look has found."""
        with self._news:
            found = {} if self._discovery is None else self._discovery.to_dial(boottime())
        for (robot, _), address in found.items():
            if robot in robots:
                self._carrier.send_to(self._packed(make()), self._reachable(address))

    # Requests

    def request(
        self,
        kind: type[AnyRequest],
        targets: Mapping[str, Epoch | None],
        *,
        timeout: float | None = None,
        least: float = REQUEST_WAIT,
        **fields: Any,
    ) -> Outcome:
        """Send a request to the robots in `targets`, with the epoch that was seen of each.

        `fields` are those of `kind`. Repeated under one id to each robot without a reply. Returns
        as soon as all have answered, else after `timeout` s, or by default after `least` s and more
        by the round trip and the loss. Robots that the last look, and all that was heard since,
        show unreachable or gone count as missing and are not waited for. ConfigError if the role of
        the own identity does not permit it: robots would refuse it silently.
        """
        self._check_role(str(kind.__struct_config__.tag))
        view, fresh = self._looked, self.seen()
        asked = {
            name: epoch
            for name, epoch in targets.items()
            if view.is_in_reach(name) or fresh.is_in_reach(name)
        }
        others = asked.keys() & set(view.of_other_version())
        request = self._new(kind, targets=asked, **fields)
        payload, acks = encode(request), Acks(request.id)
        if timeout is None:
            timeout = least + REQUEST_TRIPS * view.round_trip + REQUEST_LOSS_WAIT * view.loss
            timeout = min(timeout, max(least, REQUEST_CAP))
        patience = min(timeout, 1.0 + 6.0 * view.round_trip)
        started = now = boottime()
        links = QueryLinks(build(self.settings.swarm, ANY, CONTROL, request.verb, self._asker))
        unlinked = set() if self.settings.profile == "routed" else set(asked)
        robots = tuple(asked)
        repeat_at = now
        while robots and (left := started + timeout - now) > 0:
            linked = links.of(unlinked, self._sessions)
            unlinked -= linked
            is_due = now >= repeat_at
            if is_due or linked:
                repeat_at = now + REPEAT_PERIOD if is_due else repeat_at
                asking = set(robots) - unlinked if is_due else linked
                for robot in (ANY,) if len(asking) == len(asked) else sorted(asking):
                    self._get(robot, CONTROL, request.verb, payload, left, _collect(acks))
            if unlinked and self._discovery is not None:
                self._dial(self._discovery, now, only=unlinked)
            pause = min(left, repeat_at - now, LINK_PERIOD if unlinked else REPEAT_PERIOD)
            with self._news:
                self._news.wait_for(lambda: not acks.missing(asked), max(pause, 0.001))
                robots, now = acks.missing(asked), boottime()
            if now - started >= patience and others.issuperset(robots):
                break  # they may not know how to refuse it
        links.close()
        with self._news:
            for name in acks.missing(others):
                acks.on_reply(name, _refused(request.id, name, view.members[name].wire))
            outcome = acks.outcome(targets, seconds=now - started, reached=len(asked))
            return replace(outcome, mute=self._mute(asked.keys() - unlinked, outcome.missing))

    def ask(self, robot: str, name: str, payload: bytes = b"", *, timeout: float) -> bytes | None:
        """The answer of one robot to a query of `control/<name>`, which moves nothing.

        Repeated while there is none, for `timeout` s; None without an answer. Call `members` first.
        ConfigError as `request`.
        """
        return self.ask_all((robot,), name, payload, timeout=timeout).get(robot)

    def ask_all(
        self, robots: Iterable[str], name: str, payload: bytes = b"", *, timeout: float
    ) -> dict[str, bytes]:
        """As `ask`, for several robots at once: the answers of those that did answer."""
        self._check_role(name)
        asked, answers = sorted(set(robots)), dict[str, bytes]()
        until = boottime() + timeout
        while len(answers) < len(asked) and (left := until - boottime()) > 0:
            for robot in asked:
                if robot not in answers:
                    self._get(robot, CONTROL, name, payload, left, answers.setdefault)
            with self._news:
                self._news.wait_for(lambda: len(answers) == len(asked), min(left, REPEAT_PERIOD))
        with self._news:
            return dict(answers)

    def send_stop(
        self,
        verb: StopVerb,
        *,
        select: Select | None = None,
        names: Collection[str] = (),
        reason: str = "",
        timeout: float | None = None,
        until_all: bool = False,
        on_progress: Callable[[tuple[str, ...]], None] = lambda missing: None,
        is_ended: Callable[[], bool] = lambda: False,
    ) -> Outcome:
        """Stop or estop by datagrams: sent at once, repeated until each expected robot has acked.

        `select` picks robots from the names known so far and is called again as more appear, beside
        `names`; None: all. An estop of all is swarm-wide: robots that join take it over. `reason`
        is kept with an estop. It ends after `timeout` s, or after a time that follows from the
        round trip; with `until_all` only when all have acked, when `is_ended` returns True, or at a
        KeyboardInterrupt, which is an end like any other. `on_progress` takes the robots without an
        ack, when they change.
        """
        self._check_role(verb)
        now = boottime()
        discovery = self._new_discovery(now)
        stop = Stop(
            id=os.urandom(6).hex(),
            verb=verb,
            operator=self.name,
            scope="swarm" if select is None else "robots",
            reason=_sendable(reason, MAX_REASON, MAX_REASON_BYTES) if verb == "estop" else "",
        )
        renew: Renew | None = None
        if self.identity is not None:
            from swarmd.network.stop_origin import StopOrigin

            numbers = StopOrigin(self.identity.folder)
            origin, counter = numbers.next()
            stop = replace(stop, origin=origin, counter=counter)
            renew = partial(numbers.next, is_new=True)
        pending = PendingStop(stop, discovery, now, select=select, names=names, renew=renew)
        with self._news:
            self._stop = pending
        until = None if timeout is None or until_all else now + timeout
        try:
            self._send_until_acked(
                pending,
                discovery,
                until,
                until_all=until_all,
                on_progress=on_progress,
                is_ended=is_ended,
            )
        except KeyboardInterrupt:
            if not until_all:
                raise
        with self._news:
            self._stop = None
            outcome = pending.outcome(boottime())
            return replace(outcome, warnings=(*outcome.warnings, *self._unproven(outcome.replies)))

    def _send_until_acked(
        self,
        pending: PendingStop,
        discovery: Discovery,
        until: float | None,
        *,
        until_all: bool,
        on_progress: Callable[[tuple[str, ...]], None],
        is_ended: Callable[[], bool],
    ) -> None:
        """Send until it is done or over."""
        now = boottime()
        solicit, repeat = RepeatTimer(now, SOLICIT_PACE), RepeatTimer(now, STOP_PACE)
        progress = RepeatTimer(now + 1.0, ((float("inf"), PROGRESS_PERIOD),))
        selected: frozenset[str] = frozenset()
        shown: tuple[str, ...] | None = None
        while True:
            with self._news:
                now, version = boottime(), self._version
                is_over = until is not None and now >= until
                if until is None and not until_all:
                    is_over = pending.is_over(now)
                if is_over or is_ended() or pending.is_done(now):
                    return
                before, selected = selected, pending.selected()
                lacking = pending.lacking(now)
                is_due, new = repeat.is_due(now), selected - before
                # Robots that were just found get a copy of their own before the next repeat.
                stops = tuple(pending.datagrams(now, None if is_due else new))
            for one, addresses in stops if is_due or new else ():
                payload = self._packed(one)
                if is_due:
                    self._carrier.send(payload)
                for address in addresses:
                    self._carrier.send_to(payload, self._reachable(address))
            self._rosters.begin()
            if solicit.is_due(now):
                self._solicit(discovery, now)
            if until_all and lacking != shown and progress.is_due(now):
                shown = lacking
                on_progress(lacking)
            pause = min(solicit.pause(now), repeat.pause(now))
            self._wait(version, min(pause, 0.05 if until is None else until - now))

    # Parts

    def _unproven(self, robots: Collection[str]) -> Iterator[str]:
        """A warning about robots whose answers this identity cannot prove."""
        unproven = set() if self._answers is None else self._answers.unproven & set(robots)
        if unproven:
            yield (
                f"answers of {', '.join(sorted(unproven))} are not proven: this identity has no key"
                " of them; install its new bundle"
            )

    def _check_role(self, verb: str) -> None:
        """Raise ConfigError if the role of the own identity does not permit a verb."""
        one = self.identity
        if one is not None and not may_ask(one.role, verb):
            raise ConfigError(
                f"{one.name} is a {one.role} of swarm {self.settings.swarm}, which may only look;"
                f" {verb} needs the identity of an operator; nothing was sent"
            )

    def _mute(self, linked: Collection[str], missing: Collection[str]) -> tuple[str, ...]:
        """Those of `missing` that answer this operator otherwise, in a secured swarm."""
        if self.identity is None:
            return ()
        return tuple(sorted((self._looked.answered | set(linked)) & set(missing)))

    def _open_carrier(self) -> Carrier:
        settings = self.settings
        if settings.profile != "routed":
            from swarmd.network.udp import UdpCarrier

            return UdpCarrier(settings, self._tag, is_secured=self.identity is not None)
        from swarmd.network.routed import RoutedCarrier
        from swarmd.network.session import open_operator_session

        session = open_operator_session(settings, (), self.identity)
        self._sessions.append(session)
        return RoutedCarrier(session, settings.swarm, f"operator-{os.urandom(6).hex()}")

    def _new(self, kind: type[R], **fields: Any) -> R:
        if "reason" in fields:
            fields["reason"] = _sendable(fields["reason"], MAX_REASON, 4 * MAX_REASON)
        return kind(id=os.urandom(6).hex(), operator=self.name, **fields)

    def _new_discovery(self, now: float, *, needs_status: bool = True) -> Discovery:
        wait = DEV_WAIT if self.settings.profile == "dev" else FIRST_ROBOT_TIMEOUT
        with self._news:
            earlier = None if self._discovery is None else self._discovery.result(now)
            discovery = Discovery(
                now,
                self._roster,
                first_robot_timeout=wait,
                earlier=earlier,
                is_local=self.settings.interface_name == "lo",
                is_secured=self.identity is not None,
                needs_status=needs_status,
            )
            self._discovery = discovery
        return discovery

    def _solicit(self, discovery: Discovery, now: float) -> None:
        self._echo += 1
        with self._news:
            if self._answers is not None:
                self._answers.liveness.note_echo(self._echo, now)
            discovery.on_solicit(self._echo, now)
            wants_members = discovery.wants_members(now)
            addresses = discovery.to_solicit()
        payload = self._packed(Solicit(echo=self._echo, wants_members=wants_members))
        self._carrier.send(payload)
        for address in addresses:
            self._carrier.send_to(payload, self._reachable(address))

    def _dial(self, discovery: Discovery, now: float, only: Collection[str] | None = None) -> float:
        """Dial the robots that were found; the time until it is to be called again, in s.

        `only` None: all of them, again if their status does not come.
        """
        with self._news:
            found = discovery.to_dial(now)
            if only is not None:
                found = {who: address for who, address in found.items() if who[0] in only}
            answered = discovery.settled if only is None else frozenset[str]()
            trip = discovery.round_trip
        again = REDIAL_WAIT + REDIAL_TRIPS * trip
        wanted: dict[tuple[str, str], Address] = {}
        for who, address in found.items():
            known, at = self._dialled.get(who, (None, 0.0))
            is_late = who[0] not in answered and now - max(at, discovery.started) >= again
            if known != address or is_late:
                wanted[who] = address
        if not wanted or self.settings.profile == "routed":
            self._wanted_at = None
            return float("inf")
        self._wanted_at = now if self._wanted_at is None else self._wanted_at
        gathered = min(discovery.found_at + GATHER_TIME, self._wanted_at + 10 * GATHER_TIME)
        due = max(gathered, self._dial_at)
        if now < due:
            return due - now
        if len(self._sessions) >= MAX_SESSIONS:
            self._close_sessions()
            wanted = dict(found)
        endpoints = sorted({_endpoint(self._reachable(one)) for one in wanted.values()})
        opened = self._open_sessions(endpoints)
        self._sessions += opened
        for session in opened:
            for name, robot in self._watched:
                self._subscribe(session, name, robot)
        self._dialled.update({who: (address, now) for who, address in wanted.items()})
        self._dial_at = now + DIAL_PERIOD * 2 ** len(self._sessions)
        return float("inf")

    def _open_sessions(self, endpoints: list[str]) -> list[zenoh.Session]:
        """One session, or several without those endpoints that Zenoh refuses."""
        from swarmd.network.session import open_operator_session

        try:
            return [open_operator_session(self.settings, endpoints, self.identity)]
        except NetworkError:
            if len(endpoints) < 2:
                return []
            half = len(endpoints) // 2
            first, second = endpoints[:half], endpoints[half:]
            return [*self._open_sessions(first), *self._open_sessions(second)]

    def _close_sessions(self) -> list[threading.Thread]:
        closing = [
            threading.Thread(target=_close, args=(session,), name=CLOSING, daemon=True)
            for session in self._sessions
        ]
        self._sessions.clear()
        self._dialled.clear()
        for thread in closing:
            thread.start()
        return closing

    def _reachable(self, address: Address) -> Address:
        """The address, with the scope of this machine if it is local to the link."""
        host, port = address
        if not host.lower().startswith("fe80:"):
            return address
        try:
            index = socket.if_nametoindex(self.settings.interface_name)
        except OSError:
            return address
        return f"{host.partition('%')[0]}%{index}", port

    def _ask_members(self, discovery: Discovery) -> None:
        if not self._sessions:
            return
        with self._news:
            known = sorted(discovery.settled)
        decode = _view_decoder()

        def on_view(robot: str, payload: bytes) -> None:
            if version_of(payload) != codec.VERSION:
                return
            view = decode(payload)
            if view.robot == robot:
                discovery.on_view(view, boottime())

        def on_status(robot: str, payload: bytes) -> None:
            header = _header(payload)
            if header.robot == robot and version_of(payload) != codec.VERSION:
                discovery.on_header(header, boottime())

        query = encode(MembersQuery(answered=tuple(known[:MAX_EXCUSED])))
        self._get(ANY, CONTROL, "members", query, 10.0, on_view)
        with self._news:
            others = discovery.of_other_version - set(known)
        for robot in sorted(others):
            self._get(robot, "state", "status", b"", 10.0, on_status)

    def _get(
        self,
        robot: str,
        plane: str,
        name: str,
        payload: bytes,
        timeout: float,
        handler: Callable[[str, bytes], object],
    ) -> None:
        """Query a key in every session; `handler` takes each reply's robot and payload, locked.

        Queries use DROP, since a reply inherits the query's congestion control and must not block
        a daemon's loop; a query that may get lost is repeated.
        """
        import zenoh
        from zenoh.handlers import Callback

        from swarmd.network.session import MAX_WIRE

        asker = self._asker if plane == CONTROL else ""

        def on_reply(reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is None or len(sample.payload) > MAX_WIRE:
                return
            key = parse(str(sample.key_expr))
            if key is None or (key.swarm, *key[2:]) != (self.settings.swarm, plane, name, asker):
                return
            answer = sample.payload.to_bytes()
            with self._news, contextlib.suppress(CodecError):
                handler(key.robot, answer)
                self._notify()

        for session in self._sessions:
            with contextlib.suppress(zenoh.ZError):
                session.get(
                    build(self.settings.swarm, robot, plane, name, asker),
                    Callback(on_reply, indirect=False),
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    congestion_control=zenoh.CongestionControl.DROP,
                    priority=zenoh.Priority.INTERACTIVE_HIGH,
                    express=True,
                    timeout=timeout,
                    payload=payload,
                    source_info=zenoh.SourceInfo(session.id, 0),  # for the robot's log
                )

    def _subscribe(self, session: zenoh.Session, name: str, robot: str) -> None:
        import zenoh

        from swarmd.network.session import MAX_WIRE

        handler, swarm = self._watched[name, robot], self.settings.swarm

        def on_sample(sample: zenoh.Sample) -> None:
            key = parse(str(sample.key_expr))
            if key is None or (key.swarm, key.plane, key.name) != (swarm, "state", name):
                return
            if len(sample.payload) <= MAX_WIRE:
                with contextlib.suppress(CodecError):
                    handler(key.robot, sample.payload.to_bytes())

        with contextlib.suppress(zenoh.ZError):
            one = session.declare_subscriber(build(swarm, robot, "state", name), on_sample)
            self._subscribers.setdefault((name, robot), []).append(one)

    def _on_datagram(self, payload: bytes, source: Address, by_group: bool) -> None:
        """A datagram came, on the carrier's thread."""
        try:
            body = unpack(self._tag, payload)
        except CodecError:
            return
        if body is None:
            return
        with self._news:
            now = boottime()
            if self._answers is not None and not isinstance(body, Swarm):
                body = self._answers.admit(body, payload, source, now)
                if body is None:
                    return
                if isinstance(body, Beacon):
                    self._carrier.confirm(source)
            if self._take(body, source, now):
                self._notify()

    def _take(self, body: Datagram, source: Address, now: float) -> bool:
        """Note what a datagram tells; False if no call waits for it."""
        if isinstance(body, Swarm):
            if len(self._swarms) < MAX_SWARMS:
                self._swarms.add(body.swarm)
            return False
        if isinstance(body, Ack):
            return self._stop is not None and self._stop.on_ack(body, now)
        if listener := self._listeners.get(type(body)):
            listener(body, now)
        if self._discovery is None:
            return False
        if isinstance(body, Beacon):
            self._discovery.on_beacon(body, source, now)
        elif isinstance(body, MemberList):
            self._discovery.on_member_list(body, now)
        else:
            return False
        return True

    def _packed(self, body: Datagram) -> bytes:
        """The bytes of a datagram of this swarm, signed if it is secured."""
        payload = pack(self._tag, body)
        return payload if self._answers is None else self._answers.sign(payload)

    def _notify(self) -> None:
        self._version += 1
        self._news.notify_all()

    def _wait(self, version: int, timeout: float) -> None:
        with self._news:
            self._news.wait_for(lambda: self._version != version, max(0.001, timeout))


def _view_decoder() -> Decoder[PeerView]:
    from swarmd.network.session import MAX_WIRE

    return Decoder(PeerView, MAX_WIRE)


def _collect(acks: Acks) -> Callable[[str, bytes], object]:
    """Take a reply of this version, and what can be read of another version's."""

    def take(robot: str, payload: bytes) -> None:
        if version_of(payload) == codec.VERSION:
            acks.on_reply(robot, _reply(payload))
            return
        header = _reply_header(payload)
        reply = Reply(
            id=header.id,
            robot=header.robot,
            code=Code.REFUSED,
            refusal=Refusal.OTHER_VERSION,
            text=header.text,
        )
        acks.on_reply(robot, reply)

    return take


def _refused(request: str, robot: str, wire: int | None) -> Reply:
    """The refusal of a robot of another version that did not refuse the request itself."""
    return Reply(
        id=request,
        robot=robot,
        code=Code.REFUSED,
        refusal=Refusal.OTHER_VERSION,
        text=f"{robot} speaks {'another' if wire is None else wire}, this swarmctl {codec.VERSION}",
    )


def _endpoint(address: Address) -> str:
    host, port = address
    return f"tcp/[{host}]:{port}" if ":" in host else f"tcp/{host}:{port}"


def _close(session: zenoh.Session) -> None:
    with contextlib.suppress(Exception):  # whatever it is, the answer is out already
        session.close()
