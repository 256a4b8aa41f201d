"""The datagrams of a swarm through Zenoh routers, for profile `routed`.

The bytes of a UDP datagram are sent as a Zenoh put: to all on
`swarm/<swarm>/<sender>/multicast/all`, to one receiver on
`swarm/<swarm>/<sender>/unicast/<receiver>`. An address is the name of a robot or of an operator's
session, with port 0. A router forwards each put once on each link: a robot sends O(1) and receives
O(N) datagrams for N robots, also where multicast does not reach.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import zenoh

from swarmd.core.clock import boottime
from swarmd.core.keys import ANY, build, is_id, parse
from swarmd.link.carriers.recipients import Recipients
from swarmd.link.carriers.session import on_thread, undeclare
from swarmd.link.datagram import KIND_OFFSET, MAX_DATAGRAM, URGENT, Address, OnDatagram

if TYPE_CHECKING:
    from asyncio import AbstractEventLoop

ALL = "multicast"
ONE = "unicast"
"""The planes of the keys."""


class RoutedCarrier:
    """Sends and receives datagrams as `own`, on a session that is a client of routers."""

    port = 0

    def __init__(self, session: zenoh.Session, swarm: str, own: str) -> None:
        self._session = session
        self._swarm = swarm
        self._own = own
        self._on_datagram: OnDatagram = lambda payload, source, waited: None
        self._subscribers: tuple[Any, ...] = ()
        self._close_queue: Callable[[], None] = lambda: None
        self.recipients = Recipients(1.0, with_group=True)
        self.unsent = 0
        self.dropped: Counter[str] = Counter()

    def send(self, payload: bytes) -> None:
        """Send to all. Never raises or blocks."""
        self._put(payload, ALL, "all")

    def send_to(self, payload: bytes, address: Address) -> None:
        """Send to one robot or operator. Never raises or blocks."""
        if is_id(address[0]):
            self._put(payload, ONE, address[0])

    def attach(self, loop: AbstractEventLoop, on_datagram: OnDatagram) -> None:
        """Call `on_datagram(payload, source, waited)` on a running loop until `close`."""
        # It loads asyncio, for 39 ms; operators have no loop and do not attach.
        from swarmd.link.carriers.inbound_queue import DropCounter, InboundQueue

        drops = DropCounter()

        def take(payload: bytes, source: Address, arrived: float) -> None:
            on_datagram(payload, source, boottime() - arrived)

        plain = InboundQueue(loop, drops, "datagram")
        urgent = InboundQueue(loop, drops, "datagram", is_urgent=True)

        def queue(payload: bytes, source: Address, waited: float) -> None:
            chosen = urgent if payload[KIND_OFFSET] in URGENT else plain
            if not chosen.offer(take, payload, source, boottime() - waited):
                self.dropped["full"] += 1

        def close() -> None:
            plain.close()
            urgent.close()

        self._close_queue = close
        self.start_thread(queue)

    def start_thread(self, on_datagram: OnDatagram) -> None:
        """Call `on_datagram(payload, source, 0.0)` on a daemon thread until `close`.

        0.0: Zenoh does not report for how long a datagram waited.
        """
        self._on_datagram = on_datagram
        self._subscribers = tuple(
            self._session.declare_subscriber(
                build(self._swarm, ANY, plane, name),
                on_thread(self._on_sample),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            for plane, name in ((ALL, "all"), (ONE, self._own))
        )

    def confirm(self, source: Address) -> None:
        """Do nothing: routers find the receivers."""

    def rejoin(self) -> None:
        """Do nothing: Zenoh dials its routers again by itself."""

    def close(self) -> None:
        """Receive nothing more; the session stays open."""
        self._close_queue()
        undeclare(*self._subscribers)
        self._subscribers = ()

    def _put(self, payload: bytes, plane: str, name: str) -> None:
        is_urgent = payload[KIND_OFFSET] in URGENT
        try:
            self._session.put(
                build(self._swarm, self._own, plane, name),
                payload,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME if is_urgent else zenoh.Priority.DATA,
                express=True,
            )
        except zenoh.ZError:
            self.unsent += 1

    def _on_sample(self, sample: zenoh.Sample) -> None:
        key = parse(str(sample.key_expr))
        if key is None or key.robot == self._own or not len(sample.payload) > KIND_OFFSET:
            self.dropped["key"] += 1
        elif len(sample.payload) > MAX_DATAGRAM:
            self.dropped["oversized"] += 1
        else:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._on_datagram(sample.payload.to_bytes(), (key.robot, 0), 0.0)
