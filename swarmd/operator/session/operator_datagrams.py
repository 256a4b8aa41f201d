"""The datagrams of an operator: signed and sent by a carrier, verified when they arrive."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Protocol

from swarmd.core.clock import boottime
from swarmd.core.errors import CodecError
from swarmd.link.datagram import (
    Address,
    Beacon,
    Datagram,
    OnDatagram,
    Solicit,
    Swarm,
    pack,
    unpack,
)
from swarmd.operator.session.arrivals import Arrivals
from swarmd.operator.session.discovery import Discovery
from swarmd.operator.session.robot_clocks import RobotClocks

if TYPE_CHECKING:
    from swarmd.operator.session.operator_admission import OperatorAdmission

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
