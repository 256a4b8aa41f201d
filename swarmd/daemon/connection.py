"""Opens and reopens the carrier of datagrams (UDP sockets or a router) and the Zenoh session.

1. A change of the interface's address, or of the identity, closes and reopens carrier and session.
   The robot stops first.
2. A flood of connections, or a new IPv4 address, reopens only the session. The run continues.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Protocol

import zenoh
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.errors import NetworkError
from swarmd.core.token_bucket import TokenBucket
from swarmd.link.carriers.bus import ZenohBus
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.carriers.interface_watch import (
    InterfaceChange,
    InterfaceState,
    InterfaceWatch,
    read_state,
)
from swarmd.link.carriers.link_gate import (
    CLOSED_TIME,
    LINE_BURST,
    LINE_RATE,
    LinkFlood,
    LinkGate,
    LinkShares,
    open_files,
)
from swarmd.link.carriers.routed import RoutedCarrier
from swarmd.link.carriers.session import (
    address_of,
    default_listen,
    end_links,
    open_in_thread,
    open_session,
)
from swarmd.link.carriers.udp import UdpCarrier
from swarmd.link.datagram import Address
from swarmd.link.keys.identity import Identity
from swarmd.link.keys.roster_change import is_revoked
from swarmd.link.settings import Endpoint, NetworkSettings, parse_endpoint

log = logging.getLogger(__name__)

MAX_PORT_TRIES = 5
CLOSE_TIMEOUT = 1.0  # s
REOPEN_PERIOD = 1.0  # s between two tries to open
ANSWER_TIME = 0.1
"""Seconds for answers to be sent before the session closes. An asker without an answer repeats."""


class ConnectionOwner(Protocol):
    """The callbacks of a connection, all called on the loop."""

    def on_datagram(self, payload: bytes, source: Address, waited: float) -> None:
        """Take a datagram; the arguments are as in `OnDatagram`."""

    def on_interface(self, change: InterfaceChange) -> None:
        """Act on a change of the interface, before anything is reopened."""

    def on_reopened(self) -> None:
        """Act on a reopened session; the carrier is open, too."""

    def on_event(self, text: str) -> None:
        """Log a line among the robot's events."""


class NetworkConnection:
    """Carrier and session of the daemon of `robot`; `carrier` and `bus` are None while closed.

    `tag`: the first bytes of each datagram of the swarm. With an `identity` the session uses mTLS.
    """

    def __init__(
        self,
        settings: NetworkSettings,
        robot: str,
        tag: bytes,
        identity: Identity | None,
        drops: DropCounter,
        owner: ConnectionOwner,
    ) -> None:
        """Nothing is opened until `open`: neither the carrier of datagrams nor the Zenoh session.

        `robot`: the name of the robot. `tag`: the first bytes of each datagram of the swarm.
        `drops` counts datagrams and queries that are dropped. `owner` gets the calls of
        `ConnectionOwner`.
        """
        self._settings = settings
        self._robot = robot
        self._tag = tag
        self._identity = identity
        self._drops = drops
        self._owner = owner
        self._loop = asyncio.get_running_loop()
        self.carrier: UdpCarrier | RoutedCarrier | None = None
        self.bus: ZenohBus | None = None
        self._session: zenoh.Session | None = None
        self._opened = settings  # the settings; once a session was open, with its port
        self._flood: LinkFlood | None = None  # detects a flood of connections to the session
        self._gate: LinkGate | None = None  # lets only known hosts connect during a flood
        self._shares: LinkShares | None = None  # bounds the links of names
        self._lines = TokenBucket(LINE_RATE, LINE_BURST)  # of lines about ended links
        # Watches the interface in profile `field`, else None.
        self._watch: InterfaceWatch | None = None
        self._reopening: asyncio.Task[None] | None = None  # the task that opens the session again
        self._is_stale = False  # the sockets belong to an earlier state of the interface
        self._ipv4: tuple[str, ...] = ()  # addresses of the interface at the last change
        self._first_ipv4: tuple[str, ...] | None = None  # addresses at the first session

    @property
    def interface_text(self) -> str:
        """The state of the interface in a few words; empty if no interface is watched."""
        if self._watch is None:
            return ""
        return f"{self._settings.interface_name}: {self._watch.state.text}"

    @property
    def _answers_scouts(self) -> bool:
        return self._settings.answers_scouts(is_secured=self._identity is not None)

    def local(self, address: Address) -> Address:
        """The address; a link-local IPv6 address gets the scope id of this machine's interface."""
        host, port = address
        if host.startswith("fe80:") and self._watch is not None:
            host = f"{host.partition('%')[0]}%{self._watch.state.index}"
        return host, port

    async def open(self) -> None:
        """Open carrier and session, and watch the interface. Raises NetworkError."""
        settings = self._settings
        if settings.profile == "routed":
            await self._open_again()  # retries, since a robot may boot before its routers
        else:
            await self._open()
        if settings.profile == "field":
            self._watch = InterfaceWatch(
                self._loop, settings.interface_name, self._on_interface_change
            )
            if not self._watch.state.is_usable:
                log.warning("%s", self.interface_text)
            elif self._answers_scouts and not self._watch.state.ipv4:
                log.warning("%s: until then no Zenoh program finds it", self.interface_text)
            self._follow_ipv4(self._watch.state)

    def watch_for_flood(self, now: float) -> None:
        """Bound the links of names, and the connections that wait; called on each tick.

        While too many connections wait, only known hosts may connect. A known host has sent a
        signed datagram. At the begin of such a flood this method also reopens the session, which
        ends the connections that wait.
        """
        flood = self._flood
        session = self._session
        shares = self._shares
        if flood is None or session is None or shares is None or not flood.is_due(now):
            return
        links = self._end_excess(session, shares, flood, now)
        is_flooded = flood.look(open_files(), links, now)
        self._set_gate(now)
        if is_flooded:
            self._owner.on_event(
                f"{flood.waiting} connections wait at the port for links: for"
                f" {flood.closed_until - now:.0f} s it takes those of hosts that sent a signed"
                " datagram"
            )
            self._begin_renewal()

    def _end_excess(
        self, session: zenoh.Session, shares: LinkShares, flood: LinkFlood, now: float
    ) -> int:
        """End the links beyond the shares; returns the number of links."""
        links = {str(link.dst): link for link in session.info.links()}
        names = {far: link.auth_identifier or "" for far, link in links.items()}
        ended = shares.excess(names)
        if ended:
            end_links((str(links[far].src), far) for far in ended)
            addresses = filter(None, map(address_of, ended))
            refused = flood.end((host for host, _ in addresses), now)
            if refused or self._lines.take(1.0, now):
                far, why = next(iter(ended.items()))
                rest = f"; no connection for {CLOSED_TIME:.0f} s from {', '.join(refused)}"
                self._owner.on_event(
                    f"ended links ({len(ended)}), such as that of {far.partition('/')[2]} with a"
                    f" certificate of {names[far][:63]!r}: {why}{rest if refused else ''}"
                )
        return len(links)  # files of ended links are open for some ms more

    def admit_links_from(self, source: Address, now: float, *, is_operator: bool) -> None:
        """Let the host `source` connect: it has sent a datagram with a valid signature.

        `is_operator`: the signature is an operator's.
        """
        flood = self._flood
        host = source[0].partition("%")[0]
        if flood is not None and flood.hear(host, now, is_operator=is_operator):
            self._set_gate(now)

    def _set_gate(self, now: float) -> None:
        flood = self._flood
        if self._gate is not None and flood is not None:
            hosts = flood.known(now) if flood.is_closed(now) else None
            self._gate.admit(hosts, flood.refused(now))

    def close(self) -> None:
        """Close at once."""
        if self._reopening is not None:
            self._reopening.cancel()
        if self._watch is not None:
            self._watch.close()
        session = self._release()
        if session is not None:
            _close(session)

    def take_identity(self, identity: Identity) -> None:
        """Reopen as `identity` after ANSWER_TIME, in which pending answers are sent.

        Carrier and session stay closed for an identity that is no longer on the roster.
        """
        self._identity = identity
        self._begin_reopening(ANSWER_TIME)

    def _begin_renewal(self) -> None:
        """Reopen the session, unless carrier and session are being reopened."""
        if self._reopening is None:
            self._reopening = self._loop.create_task(self._renew_session())
            self._reopening.add_done_callback(self._end_reopening)

    def _begin_reopening(self, delay: float = 0.0) -> None:
        self._is_stale = True
        if self._reopening is None:
            self._reopening = self._loop.create_task(self._reopen(delay))
            self._reopening.add_done_callback(self._end_reopening)

    def _on_interface_change(self, change: InterfaceChange) -> None:
        """Stop the robot by the owner, then reopen, rejoin or follow the change."""
        self._owner.on_interface(change)
        if change.must_reopen:
            self._begin_reopening()
        elif change.must_rejoin and self.carrier is not None:
            self.carrier.rejoin()
        if not change.must_reopen:
            self._follow_ipv4(change.state)

    def _follow_ipv4(self, state: InterfaceState) -> None:
        """Reopen the session for a new IPv4 address: it answers no Zenoh scouts there yet."""
        is_new = not {*state.ipv4} <= {*self._ipv4}
        self._ipv4 = state.ipv4
        if not (is_new and self._answers_scouts):
            return
        if self._reopening is None:
            self._begin_renewal()
        else:  # the present reopening may have read the addresses too early: repeat it
            self._begin_reopening()

    def _opening(self, settings: NetworkSettings) -> Callable[[], zenoh.Session]:
        """A function that opens a session which answers scouts on the present IPv4 addresses."""
        late: tuple[str, ...] = ()
        if self._answers_scouts and settings.profile == "field":
            self._ipv4 = read_state(settings.interface_name).ipv4
            if self._first_ipv4 is None:
                self._first_ipv4 = self._ipv4
            first = self._first_ipv4
            late = tuple(address for address in self._ipv4 if address not in first)
        return partial(open_session, settings, self._identity, late=late)

    async def _reopen(self, delay: float = 0.0) -> None:
        """Close carrier and session after `delay` s, and reopen them as soon as possible."""
        await asyncio.sleep(delay)
        while self._is_stale:
            self._is_stale = False
            old = self._release()
            if old is not None:
                # A close that waits for a vanished operator must not delay the new session.
                closing = self._loop.run_in_executor(None, _close, old)
                await asyncio.wait({closing}, timeout=CLOSE_TIMEOUT)
            if self._identity is not None and is_revoked(self._identity):
                log.error("no longer on the roster: the network stays closed")
                return
            await self._open_again()
        self._owner.on_reopened()
        log.info("the network is open again")

    async def _renew_session(self) -> None:
        """Reopen the session at its port, which ends the connections that wait there.

        Datagrams and the run of the robot continue.
        """
        old_session = self._release_session()
        if old_session is not None:
            closing = self._loop.run_in_executor(None, _close, old_session)
            await asyncio.wait({closing}, timeout=CLOSE_TIMEOUT)
        while not self._is_stale:
            try:
                self._use(await open_in_thread(self._opening(self._opened)))
                self._owner.on_reopened()
                break
            except (NetworkError, zenoh.ZError, OSError) as error:
                log.warning("the session cannot be opened yet: %s", error)
                await asyncio.sleep(REOPEN_PERIOD)
        if self._is_stale:
            await self._reopen()

    def _end_reopening(self, task: asyncio.Task[None]) -> None:
        """End of a reopening; an exception reaches the loop's handler, which ends the daemon."""
        self._reopening = None
        if not task.cancelled():
            task.result()

    async def _open_again(self) -> None:
        """Retry to open every REOPEN_PERIOD until it succeeds; log each new reason of failure."""
        logged = ""
        while True:
            try:
                await self._open()
                return
            except (NetworkError, zenoh.ZError, OSError) as error:
                leftover = self._release()
                if leftover is not None:
                    self._loop.run_in_executor(None, _close, leftover)
                if str(error) != logged:
                    logged = str(error)
                    log.warning("the network cannot be opened yet: %s", logged)
                await asyncio.sleep(REOPEN_PERIOD)

    async def _open(self) -> None:
        settings = self._settings
        if settings.profile == "routed":
            session = await open_in_thread(partial(open_session, settings, self._identity))
            self.carrier = RoutedCarrier(session, settings.swarm, self._robot)
        else:
            self.carrier, session = await self._open_udp()
        self._use(session)
        self.carrier.attach(self._loop, self._owner.on_datagram)

    def _use(self, session: zenoh.Session) -> None:
        """Use a newly opened session. A secured one gets shares of its links and a link gate."""
        swarm = self._settings.swarm
        now = boottime()
        self._session = session
        self.bus = ZenohBus(session, swarm=swarm, robot=self._robot, drops=self._drops)
        if self._identity is None or self._settings.profile == "routed":
            return
        self._shares = LinkShares(self._identity.roster)
        self._gate = LinkGate({parse_endpoint(text).port for text in self._opened.listen})
        if self._flood is None:
            self._flood = LinkFlood(open_files(), now)
        self._set_gate(now)

    async def _open_udp(self) -> tuple[UdpCarrier, zenoh.Session]:
        """Open the UDP carrier, and a session that listens on the same port number by TCP.

        A robot dials a peer, by TCP, at the UDP port from which the beacons of the peer come. So
        both ports have one number. Without a configured port any free UDP port is taken. If the TCP
        port of this number is in use, another UDP port is tried, up to MAX_PORT_TRIES times.
        """
        settings = self._settings
        listen = settings.listen or (default_listen(settings),)
        first = parse_endpoint(listen[0])
        for trial in range(MAX_PORT_TRIES):
            carrier = UdpCarrier(
                settings, self._tag, port=first.port, is_secured=self._identity is not None
            )
            endpoint = f"{first.protocol}/{_host(first)}:{carrier.port}{first.suffix}"
            opening = self._opened = replace(settings, listen=(endpoint, *listen[1:]))
            try:
                return carrier, await open_in_thread(self._opening(opening))
            except BaseException as error:
                carrier.close()
                is_retried = isinstance(error, NetworkError) and not first.port
                if not is_retried or trial == MAX_PORT_TRIES - 1:
                    raise
        raise AssertionError("unreachable")

    def _release(self) -> zenoh.Session | None:
        """Close the carrier at once; returns the session, which the caller must close."""
        session = self._release_session()
        if self.carrier is not None:
            self.carrier.close()
            self.carrier = None
        return session

    def _release_session(self) -> zenoh.Session | None:
        """Stop answering; returns the session, which the caller must close."""
        if self.bus is not None:
            self.bus.close()
            self.bus = None
        if self._gate is not None:
            self._gate.close()  # frees the port, which any open socket would keep taken
            self._gate = None
        session = self._session
        self._session = None
        return session


def _host(endpoint: Endpoint) -> str:
    return f"[{endpoint.host}]" if ":" in endpoint.host else endpoint.host


def _close(session: zenoh.Session) -> None:
    with suppress(zenoh.ZError):  # a link to a vanished operator may not end in time
        session.close()
