"""The operator's side: finds the members of a swarm, sends requests and collects the acks.

Synchronous, without asyncio and numpy, since a command must start fast::

    with Operator(settings) as operator:
        view = operator.members()
        outcome = operator.request(RunRequest, view.epochs(names), pattern="attraction")
        outcome = operator.send_stop("estop", reason="...")

Robots are found, stopped and emergency-stopped by datagrams. Everything else goes by Zenoh, on
links that the operator dials to the addresses of the robots that it found. Threads of Zenoh and of
the carrier only put what they receive into tables (`Arrivals` of `clocks.py`); the caller's thread
waits.
"""

from __future__ import annotations

import contextlib
import math
import os
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from msgspec.structs import replace

from swarmd.core.clock import boottime, clock_id
from swarmd.core.closing import Closing
from swarmd.core.errors import CodecError, ConfigError, RequestError
from swarmd.core.keys import ANY
from swarmd.core.messages import Epoch
from swarmd.core.verbs import AnyRequest, starts_motion
from swarmd.link.access import may_ask
from swarmd.link.datagram import (
    ANY_SWARM,
    Ack,
    Address,
    Beacon,
    Datagram,
    MemberList,
    RunLease,
    Solicit,
    StatusPart,
    Stop,
    Swarm,
    pack,
    tag_of,
)
from swarmd.link.keys.identity import Identity, authority_of
from swarmd.link.keys.roster import Role
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.carriers import (
    Carrier,
    OperatorDatagrams,
    OperatorSessions,
    endpoint_of,
)
from swarmd.operator.session.clocks import Arrivals, LoopWatch, RepeatTimer
from swarmd.operator.session.discovery import DEV_WAIT, FIRST_ROBOT_TIMEOUT, Discovery
from swarmd.operator.session.exit_codes import FAILED
from swarmd.operator.session.looks import MemberSearch
from swarmd.operator.session.members_view import Dials, MembersView
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.roster import RosterFollower
from swarmd.operator.session.senders import (
    REQUEST_WAIT,
    PendingStop,
    Renew,
    RequestSender,
    Select,
    StopOrigin,
    StopSender,
    request_timeout,
    stood_still,
)
from swarmd.operator.session.targets import (
    operator_name,
    request_reason,
    sendable_name,
    stop_reason,
)

if TYPE_CHECKING:
    from swarmd.operator.session.admission import OperatorAdmission

CLOCK_PERIOD = 1.0
"""Seconds between two questions for the clocks of robots, while a lease is renewed: a robot that
starts meanwhile hears of the lease after that."""
CLOSE_TIMEOUT = 0.2
MAX_SWARMS = 256
SWARMS_TIME = 0.3
START_STEP = 0.01
"""Seconds to which Linux tells when a process began (proc_pid_stat(5))."""
R = TypeVar("R", bound=AnyRequest)
D = TypeVar("D")

StopVerb = Literal["stop", "estop"]


class Operator(Closing):
    """An operator in a swarm: finds robots, sends requests and stops; a context manager.

    `settings`: of the swarm. `identity`: keys and name of the operator in a secured swarm; None: a
    swarm without keys. `roster`: robots that are expected even if no daemon has heard them.
    `takes_rosters` False: keep the identity's roster even if robots show a newer roster. Raises
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
        """Open the datagram carrier and start its thread. Zenoh sessions are opened as needed.

        `name`: the operator's name in a swarm without keys, None for this user's name. `carrier`: a
        carrier in place of UDP or routers, for tests.
        """
        settings.check()
        self.settings = settings
        self.identity = identity
        if identity is not None:
            name = identity.name
        self.name = sendable_name(name or operator_name())
        self._roster = frozenset(roster)
        if identity is not None:
            self._roster |= frozenset(identity.roster.robots)
        self._discovery: Discovery | None = None  # the last look (query of all members)
        self._last_view = MembersView({})  # the result of the last look
        self._clocks_asked_at = -math.inf  # s; for leases, see `send_lease`
        self._swarms: set[str] = set()  # names of swarms that answered a solicit of any swarm
        # The listener of each kind of datagram.
        self._listeners: dict[type, Callable[[Any, float], object]] = {}
        self._rosters = RosterFollower(self, is_on=takes_rosters)
        self._arrivals = Arrivals()
        self._sessions = OperatorSessions(settings, identity, self._arrivals)
        self._datagrams = self._open_datagrams(carrier)
        self.loops = LoopWatch()
        self._search = MemberSearch(self._datagrams, self._sessions, self._arrivals, self.loops)
        self._requests = RequestSender(self._sessions, self._arrivals, self.loops)
        self._stops = StopSender(self._datagrams, self._rosters, self._arrivals)
        self._datagrams.start()

    def _open_datagrams(self, carrier: Carrier | None) -> OperatorDatagrams:
        """The datagrams of this operator, by `carrier`, or by the carrier of the profile."""
        identity = self.identity
        settings = self.settings
        # The tag in the head of each datagram, which datagrams of other swarms lack.
        tag = tag_of(settings.profile, settings.swarm, authority_of(identity))
        return OperatorDatagrams(
            carrier or self._open_carrier(tag),
            tag,
            settings.interface_name,
            self._arrivals,
            self._take,
            # Signs datagrams, and checks the datagrams of robots.
            answers=None if identity is None else self._answers_for(identity),
        )

    def close(self) -> None:
        """Leave the network within CLOSE_TIMEOUT; threads go on closing the slow sessions."""
        if sys.is_finalizing():  # a generator that was left: no thread runs that could be joined
            return
        with contextlib.suppress(Exception):
            self._datagrams.carrier.close()
        closing = self._sessions.close()
        deadline = boottime() + CLOSE_TIMEOUT
        for thread in closing:
            thread.join(max(0.0, deadline - boottime()))

    def trust_notes(self) -> tuple[str, ...]:
        """Lines for the user about robots whose roster or keys differ from this identity's."""
        with self._arrivals.lock:
            answers = self._datagrams.answers
            if answers is None:
                return ()
            notes = list(self._unproven(answers.unproven))
            for robot, (host, _) in sorted(answers.outdated.items()):
                notes.append(f"{robot} at {host} seems to have an older roster, and is not counted")
            if self._rosters.shown is not None:
                robot, (host, _), generation = self._rosters.shown
                notes.append(f"{robot} at {host} seems to have a newer roster, {generation}")
            return tuple(notes)

    @property
    def notices(self) -> list[str]:
        """Lines for the user about rosters that were taken, or could not be taken."""
        return self._rosters.notices

    @property
    def outdated(self) -> Mapping[str, Address]:
        """Addresses of robots heard with an older roster than the identity's; not proven."""
        with self._arrivals.lock:
            answers = self._datagrams.answers
            return {} if answers is None else dict(answers.outdated)

    def update_roster(self) -> bool:
        """Take the newer roster that a robot has shown, or missing keys; True if any was taken.

        Operator and robot share a key. The identity of this operator lacks the keys of robots that
        were added later: each of these robots hands over its key. `notices` gets a line for the
        user. Raises NetworkError if the new roster lacks the name of this operator.
        """
        before = self.identity
        self._rosters.update()
        return self.identity is not before

    def take_identity(self, identity: Identity) -> None:
        """Use the keys of `identity`, on new links, from the next look (query of all members) on.

        An identity with the present roster, which only adds keys of robots, is used at once, on the
        present links.
        """
        with self._arrivals.lock:
            admission = self._datagrams.answers
            before = self.identity
            if admission is not None and before is not None and before.roster == identity.roster:
                self.identity = identity
                admission.take_keys(identity)
                return
        answers = self._answers_for(identity)
        with self._arrivals.lock:
            self.identity = identity
            self._datagrams.answers = answers
            self._rosters.shown = None
            self._roster |= frozenset(identity.roster.robots)
        self._sessions.take_identity(identity)

    def expect(self, names: Iterable[str]) -> None:
        """Expect these robots as well, as if they were on the roster."""
        self._roster |= frozenset(names)

    # Looks

    def members(
        self,
        *,
        timeout: float | None = None,
        cap: float = math.inf,
        needs_status: bool = True,
        dials: Dials = Dials.ALL,
    ) -> MembersView:
        """Query all members (a look); returns once all expected robots have answered.

        The look ends after `timeout` s at the latest; with `timeout` None, after a time that
        follows from the round trip, and after `cap` s at the latest. `needs_status` False: a beacon
        is an answer, too. A beacon shows the epoch (count of the robot's changes), and a request
        needs nothing else. `dials` UNTOLD: statuses come by datagrams, and only robots that do not
        tell theirs so are dialled; NONE: no robot is, with `needs_status` False. A request that
        follows has no links then. In a secured swarm, and by routers, UNTOLD is ALL. If robots are
        missing and a robot has shown a newer roster, this method takes the roster and looks again.
        """
        view = self._look(timeout, cap, needs_status=needs_status, dials=dials)
        if view.missing and self.update_roster():
            view = self._look(timeout, cap, needs_status=needs_status, dials=dials)
        return view

    def _look(
        self, timeout: float | None, cap: float, *, needs_status: bool, dials: Dials
    ) -> MembersView:
        if dials is Dials.UNTOLD and (self.identity is not None or not self._sessions.needs_links):
            dials = Dials.ALL
        discovery = self._new_discovery(
            boottime(), needs_status=needs_status, asks_by_datagram=dials is Dials.UNTOLD
        )
        self._last_view = self._search.look(
            discovery, timeout, cap, needs_status=needs_status, dials=dials
        )
        return self._last_view

    def seen(self) -> MembersView:
        """The members that the last look or stop has found, with all that was heard until now."""
        now = boottime()
        with self._arrivals.lock:
            return (self._discovery or Discovery(now, self._roster)).result(now)

    def links(self) -> frozenset[tuple[str, str]]:
        """Pairs of robots that reported each other as alive to the last look."""
        with self._arrivals.lock:
            return frozenset() if self._discovery is None else self._discovery.links(boottime())

    def endpoints(self) -> dict[str, str]:
        """The Zenoh endpoint of each robot that the last look has found, by robot."""
        with self._arrivals.lock:
            to_dial = {} if self._discovery is None else self._discovery.to_dial(boottime())
        interface = self.settings.interface_name
        return {robot: endpoint_of(address, interface) for (robot, _), address in to_dial.items()}

    def ways(self, robot: str) -> tuple[str, ...]:
        """The ways (such as `multicast`) by which beacons of a robot came lately.

        Empty if no beacon came, and always in profile `routed`.
        """
        from swarmd.link.carriers.udp import UdpCarrier

        now = boottime()
        with self._arrivals.lock:
            to_dial = {} if self._discovery is None else self._discovery.to_dial(now)
            addresses = [address for (name, _), address in to_dial.items() if name == robot]
        carrier = self._datagrams.carrier
        if not isinstance(carrier, UdpCarrier):
            return ()
        return tuple(way for address in addresses[:1] for way in carrier.ways.of(address, now))

    def swarms(self, *, timeout: float = SWARMS_TIME) -> tuple[str, ...]:
        """The names of all swarms within reach, for an operator who finds no member of this one."""
        pace = RepeatTimer(boottime(), ((float("inf"), 0.1),))
        while pace.age(now := boottime()) < timeout:
            if pace.is_due(now):
                self._datagrams.carrier.send(pack(ANY_SWARM, Solicit(echo=0)))
            time.sleep(pace.pause(now))
        with self._arrivals.lock:
            return tuple(sorted(self._swarms))

    def watch(self, name: str, handler: Callable[[str, bytes], object], robot: str = ANY) -> None:
        """Call `handler(robot, payload)` for each sample that robots publish on `state/<name>`.

        Zenoh's threads call the handler, for robots that are found now and by later looks, until
        `unwatch`.
        """
        self._sessions.watch(name, handler, robot)

    def unwatch(self, name: str, robot: str = ANY) -> None:
        """End the subscriptions that `watch` has made."""
        self._sessions.unwatch(name, robot)

    def listen(self, kind: type[D], handler: Callable[[D, float], object] | None) -> None:
        """Call `handler(datagram, now)` for each datagram of a kind; `handler` None ends the calls.

        The carrier's thread calls the handler with the lock held: the handler must not block or
        take a lock.
        """
        with self._arrivals.lock:
            self._listeners.pop(kind, None)
            if handler is not None:
                self._listeners[kind] = handler

    def send_to_robots(self, make: Callable[[], Datagram], robots: Collection[str]) -> None:
        """Send a datagram to each robot in `robots` that the last look has found.

        `make()` returns the datagram, and is called once for each robot.
        """
        with self._arrivals.lock:
            to_dial = {} if self._discovery is None else self._discovery.to_dial(boottime())
        for (robot, _), address in to_dial.items():
            if robot in robots:
                self._datagrams.send(make(), (address,), is_to_all=False)

    def send_lease(self, goal_id: str, count: int, robots: Collection[str]) -> None:
        """Renew the lease of a goal on each robot in `robots` that is heard.

        `count` rises with each call. In a secured swarm each lease states the time on the clock of
        its robot, by which the robot knows a replayed lease; so the clocks are asked for each
        CLOCK_PERIOD, from any robot that answers, such as one that has started meanwhile.
        """
        now = boottime()
        discovery = self._discovery
        if discovery is None:
            return
        is_secured = self.identity is not None
        if is_secured and now - self._clocks_asked_at >= CLOCK_PERIOD:
            self._clocks_asked_at = now
            self._datagrams.ask_clocks(discovery, now)
        with self._arrivals.lock:
            to_dial = discovery.to_dial(now)
        for (robot, instance), address in to_dial.items():
            if robot in robots:
                lease = self._lease(goal_id, count, robot, _instance(instance))
                self._datagrams.send(lease, (address,), is_to_all=False)

    def _lease(self, goal_id: str, count: int, robot: str, instance: bytes) -> RunLease:
        """The lease for one robot, with the time on its clock as far as it is known."""
        lease = RunLease(id=goal_id, operator=self.name[:128], count=count)
        with self._arrivals.lock:
            clock = self._datagrams.clocks.reading(robot, instance, boottime())
        return lease if clock is None else replace(lease, instance=instance, clock=clock)

    # Requests

    def request(
        self,
        kind: type[AnyRequest],
        targets: Mapping[str, Epoch | None],
        *,
        timeout: float | None = None,
        least_timeout: float = REQUEST_WAIT,
        is_ended: Callable[[], bool] = lambda: False,
        issued: float | None = None,
        ahead: float = 0.0,
        **fields: Any,
    ) -> Outcome:
        """Send a request to the robots in `targets`; repeat it to each robot without a reply.

        `issued`: when the user typed, clicked or called it, in s on the clock since boot. A robot
        that was stopped since then refuses to start a run. So does a robot that gets the request
        more than `verbs.MAX_AGE` s later, beside the time for which this operator worked and
        `ahead` (s until the time at which the run is to start). None: a stop since the last look
        began refuses the run, and its age counts from this call.

        `kind` and `fields`: the request; all repeats have one id. `targets`: for each robot the
        epoch (a count of its changes) that the operator has seen. A robot whose epoch has changed
        since then refuses the request. With None instead of an epoch the robot does not compare.

        Returns once all robots have replied, once `is_ended` returns True, and after `timeout` s at
        the latest. `timeout` None: a time of at least `least_timeout` s, which grows with the round
        trip and the loss of datagrams. A robot that is unreachable or gone counts as missing at
        once. Raises ConfigError if the role of the own identity does not permit the request, and
        RequestError for a start (`verbs.starts_motion`) if this process stood still since `issued`.
        """
        self._check_role(str(kind.__struct_config__.tag))
        last_view = self._last_view
        present_view = self.seen()
        asked = {  # the targets that were in reach at the last look, or came in reach since
            name: epoch
            for name, epoch in targets.items()
            if last_view.is_in_reach(name) or present_view.is_in_reach(name)
        }
        now = boottime()
        if issued is None:
            issued = now if self._discovery is None else self._discovery.started
            planned = now - issued
        else:
            planned = self.loops.worked(issued) + ahead
        request = self._new(
            kind,
            targets=asked,
            clock=clock_id(),
            issued=issued,
            issued_at=last_view.issue_times(asked, issued),
            planned=planned,
            **fields,
        )
        if starts_motion(request) and (stood := self.loops.stood(issued)):
            raise RequestError(stood_still(stood, "nothing was sent; type it anew"), FAILED)
        if timeout is None:
            timeout = request_timeout(last_view, least_timeout)
        outcome, linked = self._requests.send(
            request, targets, asked, last_view, self._discovery, timeout, is_ended
        )
        # Mute robots have a link and sent no reply: they may lack this operator in their roster.
        return replace(outcome, mute=self._mute(linked, outcome.missing))

    def ask(self, robot: str, name: str, payload: bytes = b"", *, timeout: float) -> bytes | None:
        """Query `control/<name>` of a robot, which moves nothing; returns the answer's bytes.

        The query is repeated for `timeout` s; None if no answer comes. Call `members` first: it
        finds the robots. Raises ConfigError if the role of the own identity does not permit the
        query.
        """
        return self.ask_all((robot,), name, payload, timeout=timeout).get(robot)

    def ask_all(
        self, robots: Iterable[str], name: str, payload: bytes = b"", *, timeout: float
    ) -> dict[str, bytes]:
        """As `ask`, for several robots at once: the answers by robot, without silent robots."""
        self._check_role(name)
        return self._requests.ask(robots, name, payload, timeout)

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
        """Stop robots by datagrams, sent at once and repeated until each expected robot has acked.

        `verb`: "stop", or "estop" for an emergency stop, of which each robot keeps `reason`.
        `select` picks the targets from the names known so far, and is called again as more names
        become known; `names` are targets in any case. `select` None: all robots. An emergency stop
        of all robots also holds for robots that join later.

        Sending ends once all expected robots have acked and rest, once `is_ended` returns True, and
        after `timeout` s at the latest; `timeout` None: a time that follows from the round trip.
        `until_all` True: there is no time limit, `on_progress` gets the robots that have not
        stopped whenever these robots change, and a KeyboardInterrupt ends sending without an error.
        `until_all` False: `on_progress` is not called, and a KeyboardInterrupt is raised.

        A command that begins after this call counts as later than the stop.
        """
        self._check_role(verb)
        now = boottime()
        discovery = self._new_discovery(now)
        stop = Stop(
            id=os.urandom(6).hex(),
            verb=verb,
            operator=self.name,
            scope="swarm" if select is None else "robots",
            clock=clock_id(),
            issued=now,
            reason=stop_reason(reason) if verb == "estop" else "",
        )
        stop, renew = self._numbered(stop)  # `renew` makes new numbers for a refused stop
        pending = PendingStop(stop, discovery, now, select=select, names=names, renew=renew)
        until = None if timeout is None or until_all else now + timeout
        outcome = self._stops.send(
            pending,
            discovery,
            until,
            until_all=until_all,
            on_progress=on_progress,
            is_ended=is_ended,
        )
        _await_next_step(now)
        with self._arrivals.lock:
            unproven = self._unproven(outcome.missing)
            return replace(outcome, warnings=(*outcome.warnings, *unproven))

    def _numbered(self, stop: Stop) -> tuple[Stop, Renew | None]:
        """In a secured swarm: the stop with numbers by which robots refuse a replayed stop.

        Also returns the function that gives new numbers, for the case that a robot refuses this
        stop as replayed. Without keys: the stop unchanged, and None.
        """
        if self.identity is None:
            return stop, None
        numbers = StopOrigin(self.identity.folder)
        origin, counter = numbers.next()
        return replace(stop, origin=origin, counter=counter), partial(numbers.next, is_new=True)

    # Parts

    def _unproven(self, robots: Collection[str]) -> Iterator[str]:
        """A warning about the robots in `robots` that were heard, but whose key is missing."""
        answers = self._datagrams.answers
        unproven = set() if answers is None else answers.unproven.keys() & set(robots)
        if unproven:
            yield (
                f"{', '.join(sorted(unproven))}: heard, not proven and not counted: this identity"
                " has no key of them, and they handed over none; install its new bundle"
            )

    def _check_role(self, verb: str) -> None:
        """Raise ConfigError if the role of the own identity does not permit a verb."""
        identity = self.identity
        if identity is not None and not may_ask(identity.role, verb):
            what = f"{identity.role} of swarm {self.settings.swarm}, which may only look"
            if identity.role is Role.PERMIT:
                what = f"name with a permit in swarm {self.settings.swarm}"
            raise ConfigError(
                f"{identity.name} is a {what}; {verb} needs the identity of an operator; nothing"
                " was sent"
            )

    def _mute(self, linked: Collection[str], missing: Collection[str]) -> tuple[str, ...]:
        """In a secured swarm: the robots in `missing` with a link, or with other answers."""
        if self.identity is None:
            return ()
        return tuple(sorted((self._last_view.answered | set(linked)) & set(missing)))

    def _open_carrier(self, tag: bytes) -> Carrier:
        settings = self.settings
        if settings.profile != "routed":
            from swarmd.link.carriers.udp import UdpCarrier

            return UdpCarrier(settings, tag, is_secured=self.identity is not None)
        from swarmd.link.carriers.routed import RoutedCarrier

        session = self._sessions.open()
        return RoutedCarrier(session, settings.swarm, f"operator-{os.urandom(6).hex()}")

    def _answers_for(self, identity: Identity) -> OperatorAdmission:
        from swarmd.operator.session.admission import OperatorAdmission  # most swarms have no keys

        rosters = self._rosters
        lease = self.settings.lease_seconds
        return OperatorAdmission(identity, lease, rosters.on_shown, rosters.on_missing_key)

    def _new(self, kind: type[R], **fields: Any) -> R:
        if "reason" in fields:
            fields["reason"] = request_reason(fields["reason"])
        return kind(id=os.urandom(6).hex(), operator=self.name, **fields)

    def _new_discovery(
        self, now: float, *, needs_status: bool = True, asks_by_datagram: bool = False
    ) -> Discovery:
        wait = DEV_WAIT if self.settings.profile == "dev" else FIRST_ROBOT_TIMEOUT
        with self._arrivals.lock:
            earlier = None if self._discovery is None else self._discovery.result(now)
            discovery = Discovery(
                now,
                self._roster,
                first_robot_timeout=wait,
                earlier=earlier,
                is_local=self.settings.interface_name == "lo",
                is_secured=self.identity is not None,
                needs_status=needs_status,
                asks_by_datagram=asks_by_datagram,
            )
            self._discovery = discovery
        return discovery

    def _take(self, body: Datagram, source: Address, now: float) -> bool:
        """Take a datagram, with the lock held; False if no waiting call need be woken."""
        if isinstance(body, Swarm):
            if len(self._swarms) < MAX_SWARMS:
                self._swarms.add(body.swarm)
            return False
        if isinstance(body, Ack):
            return self._stops.on_ack(body, now)
        if listener := self._listeners.get(type(body)):
            listener(body, now)
        if self._discovery is None:
            return False
        if isinstance(body, Beacon):
            return self._discovery.on_beacon(body, source, now)
        if isinstance(body, MemberList):
            self._discovery.on_member_list(body, now)
        elif isinstance(body, StatusPart):
            with contextlib.suppress(CodecError):
                self._discovery.on_status_part(body, now)
        else:
            return False
        return True


def _instance(text: str) -> bytes:
    """The bytes of an instance; none of what a robot reports of another one as its instance."""
    try:
        return bytes.fromhex(text)
    except ValueError:
        return b""


def _await_next_step(issued: float) -> None:
    """Return once a process that begins then counts as later than `issued`, in s since boot."""
    step_ends = (math.floor(issued / START_STEP) + 1.0) * START_STEP
    while (left := step_ends - boottime()) > 0.0:
        time.sleep(left)
