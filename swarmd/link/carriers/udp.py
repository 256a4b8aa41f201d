"""The datagrams of a swarm on UDP: by multicast, by broadcast as a fallback, and by unicast.

A datagram to all goes

- by multicast, to the IPv4 group if the interface has an IPv4 address, else to the IPv6 group of
  the link (GROUP6). While a robot without an IPv4 address is heard, robots with IPv4 also send
  copies by IPv6. The copies go to the group COPIES6: a datagram to GROUP6 shows that its sender has
  no IPv4 address.
- in profile `field` also by broadcast, since access points may drop multicast: each `Stop`, `Ack`
  and `Latches`, every fifth beacon, and every datagram while no robot has been heard by multicast
  for the time `lease` of the settings (a robot that is silent for so long counts as failed).
- by unicast to seeds and to peers that are not heard by multicast (`Recipients`).

A datagram waits in its socket while the process is frozen or busy. The kernel's time of arrival
(SO_TIMESTAMPNS, on the wall clock) gives this wait. The wall clock may be set meanwhile. Therefore
the wait counts as at most the time since the sockets were last empty.

If two copies of a datagram arrive by two ways, the later copy is dropped. Sockets are bound to the
interface and not to an address, so that a change of addresses leaves them working. Profile `dev`
uses loopback, without broadcast and IPv6.

swarmctl imports this module and must start fast, so asyncio is not imported.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import os
import select
import socket
import struct
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from enum import Enum
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from swarmd.core.bounds import keep_newest
from swarmd.core.clock import Clock, boottime
from swarmd.core.errors import NetworkError
from swarmd.link.carriers import arrival_time
from swarmd.link.carriers.flood_limits import MAX_WEIGHT, FloodLimits
from swarmd.link.carriers.interface_watch import addresses_of, index_of
from swarmd.link.carriers.packet_filter import attach_filter, swarm_filter
from swarmd.link.carriers.recipients import MAX_ADDRESSES, Recipients
from swarmd.link.datagram import (
    KIND_OFFSET,
    MAX_DATAGRAM,
    TAG_BYTES,
    URGENT,
    Address,
    Kind,
    OnDatagram,
)
from swarmd.link.members.link_quality import WaysHeard
from swarmd.link.settings import NetworkSettings, parse_endpoint

if TYPE_CHECKING:
    from asyncio import AbstractEventLoop, TimerHandle

GROUP4 = "224.0.0.226"
GROUP6 = "ff02::5357:4d44"
COPIES6 = "ff02::5357:4d45"
BROADCAST = "255.255.255.255"
GROUP_PORT = 7446

BATCH = 64  # datagrams in a turn of the loop; a dropped datagram counts an eighth
PAUSE = 0.005  # s after a full batch
OVERLOAD_TIME = 1.0  # s without an empty queue after which lost datagrams count as part of a flood
BEACONS_A_BROADCAST = 5
RESOLVE_PERIOD = 60.0  # s between two resolutions of seeds that are host names
RETRY_PERIOD = 5.0  # s between two resolutions while a name has no address
REFRESH_PERIOD = 1.0  # s between two reads of the interface's addresses
COPY_TIME = 0.1  # s within which the copies of a datagram arrive by all ways
_RECEIVE_BUFFER = 2 * 1024 * 1024  # some 2700 small datagrams
_DROP_COST = 1
_COST = 8
_PORT_TRIES = 5
_TAG = slice(5, 5 + TAG_BYTES)
# linux/in.h, linux/in6.h and asm-generic/socket.h; Python names none of them.
_IP_UNICAST_IF = 50
_IP_MULTICAST_ALL = 49
_IPV6_UNICAST_IF = 76
_IPV6_MULTICAST_ALL = 29
_SO_RCVBUFFORCE = 33
_SO_MEMINFO = 55
_MEMINFO = struct.Struct("@9I")  # linux/sock_diag.h, SK_MEMINFO_*
_QUEUED = 0  # index in _MEMINFO: bytes in the receive queue
_QUEUE_LIMIT = 1  # index in _MEMINFO: bytes that the queue may hold
_LOST = 8  # index in _MEMINFO: datagrams that were dropped
_NEARLY_FULL = 0.75  # the share of the queue's limit above which drops are counted
_NEVER = -1e9  # s
SHORT_WAIT = 0.2  # s since the sockets were empty, up to which the wait of a datagram counts as 0


class Received(NamedTuple):
    """A datagram that has arrived."""

    payload: bytes
    source: Address
    waited: float  # s from arrival until it was read


class _Way(Enum):
    """The way by which a datagram came."""

    UNICAST = "unicast"
    MULTICAST = "multicast"
    BROADCAST = "broadcast"
    COPY = "copy"  # a second copy by IPv6, from a robot that also has IPv4


class _Listener(NamedTuple):
    socket: socket.socket
    way: _Way


_PASSING = Kind.MESSAGE, Kind.PLACE, Kind.KIN  # kinds that go only to addresses that are heard


class UdpCarrier:
    """Sends and receives the datagrams of a swarm; NetworkError if the sockets cannot be opened.

    `port`: the unicast port, from which all datagrams are sent; 0: a free port. One thread may send
    while another thread receives. `is_secured`: the source of a beacon gets datagrams only after
    the caller has called `confirm`.
    """

    def __init__(
        self,
        settings: NetworkSettings,
        tag: bytes,
        *,
        port: int = 0,
        is_secured: bool = False,
        clock: Clock = boottime,
    ) -> None:
        """Open the sockets.

        `tag`: the bytes in the head of a datagram that mark the swarm.
        """
        self._clock = clock
        self._tag = tag
        self._is_secured = is_secured
        self._lock = threading.Lock()
        self._is_dev = settings.profile == "dev"
        self._multicast = settings.multicast
        self._lease = settings.lease_seconds
        self._begin_interface(settings)
        self._begin_sending(settings)
        self._begin_receiving()
        self._begin_flood_limits()
        try:
            self.port = self._open(port)
        except OSError as error:
            self.close()
            raise NetworkError(self._explain(error, port)) from error

    def _begin_interface(self, settings: NetworkSettings) -> None:
        """Set the interface; its sockets are not open yet, and its addresses not read."""
        self._interface = settings.interface_name
        self._index = index_of(self._interface)
        self._listeners: list[_Listener] = []
        self._own4: socket.socket | None = None  # sends by IPv4
        self._own6: socket.socket | None = None  # sends by IPv6
        self._addresses: frozenset[str] = frozenset()  # the addresses of the interface
        self._has_ipv4 = self._is_dev  # the interface has an IPv4 address
        self._refreshed_at = _NEVER  # when the addresses were last read

    def _begin_sending(self, settings: NetworkSettings) -> None:
        """Set what decides the receivers of a datagram, before any robot is heard."""
        self._seeds = _Seeds(settings.seeds)
        self._beacons = 0  # the count of beacons sent to all
        self._multicast_at = _NEVER  # when a robot was last heard by multicast
        self._ipv6_only_at = _NEVER  # when a robot without an IPv4 address was last heard
        self.unsent = 0  # the count of datagrams that could not be sent
        self.recipients = Recipients(self._lease, with_group=self._multicast)

    def _begin_receiving(self) -> None:
        """Set the state of reading, before any datagram has arrived."""
        # By source: the way of its last beacon, which is not verified yet and waits for `confirm`.
        self._unconfirmed: dict[Address, _Way] = {}
        # By source and payload: when and by which way the first copy of a datagram came.
        self._first_copies: dict[tuple[Address, bytes], tuple[float, _Way]] = {}
        self._detach: Callable[[], None] = lambda: None  # ends the reading, from `attach` on
        self._is_full = False  # the last `receive` has left datagrams in a socket
        self._emptied_at = self._clock()  # when the sockets were last empty
        self._turns = 0  # calls of `receive`
        # Beacons go out once a second, and every fifth beacon also as a broadcast. A way counts as
        # heard for the time between three broadcasts, in s, so that the loss of a single broadcast
        # does not show.
        self.ways = WaysHeard(max(2 * self._lease, 2.0 * BEACONS_A_BROADCAST))

    def _begin_flood_limits(self) -> None:
        """Set the limits of received datagrams, without a flood."""
        self._limits = FloodLimits()
        self._rules = self._limits.rules(0.0)  # the present rules of the kernel's packet filters
        self._reads = 0  # datagrams read since `_weigh`
        self._weight = 1.0  # of a datagram in the flood limits, see `_weigh`
        # By socket: the count of datagrams that the kernel had dropped at the last look.
        self._lost: dict[socket.socket, int] = {}

    @property
    def filenos(self) -> tuple[int, ...]:
        """The descriptors that become readable."""
        return tuple(listener.socket.fileno() for listener in self._listeners)

    @property
    def dropped(self) -> Counter[str]:
        """Datagrams that this class dropped, by kind; without those that the kernel dropped."""
        return self._limits.dropped

    def close(self) -> None:
        """Close the sockets and end the thread; more than once is harmless."""
        self._detach()
        self._detach = lambda: None
        with self._lock:
            for listener in self._listeners:
                listener.socket.close()
            self._listeners.clear()
            self._own4 = None
            self._own6 = None

    # Sending

    def send(self, payload: bytes) -> None:
        """Send to all: the group, and copies as the module says. Never raises or blocks."""
        kind = payload[KIND_OFFSET]
        now = self._clock()
        is_urgent = kind in URGENT
        with self._lock:
            self._refresh(now)
            if self._multicast:
                self._send_to_groups(payload, kind, is_urgent, now)
            for address in self.recipients.unicast(now, is_message=kind in _PASSING):
                self._send_to(payload, address)

    def send_to(self, payload: bytes, address: Address) -> None:
        """Send to one address. Never raises or blocks."""
        with self._lock:
            self._send_to(payload, address)

    def _send_to_groups(self, payload: bytes, kind: int, is_urgent: bool, now: float) -> None:
        if self._has_ipv4:
            self._emit(self._own4, payload, (GROUP4, GROUP_PORT))
            self._beacons += kind == Kind.BEACON
            is_fifth = kind == Kind.BEACON and self._beacons % BEACONS_A_BROADCAST == 0
            if not self._is_dev and (is_urgent or is_fifth or self._needs_broadcast(now)):
                self._emit(self._own4, payload, (BROADCAST, GROUP_PORT))
        if self._own6 is not None and not self._has_ipv4:
            self._emit(self._own6, payload, (GROUP6, GROUP_PORT, 0, self._index))
        elif self._own6 is not None and now - self._ipv6_only_at <= 2 * self._lease:
            self._emit(self._own6, payload, (COPIES6, GROUP_PORT, 0, self._index))

    def _needs_broadcast(self, now: float) -> bool:
        return now - self._multicast_at > self._lease

    def _send_to(self, payload: bytes, address: Address) -> None:
        target = _sockaddr(address, self._index)
        if target is None:
            self.unsent += 1
        else:
            self._emit(self._own4 if len(target) == 2 else self._own6, payload, target)

    def _emit(
        self,
        sock: socket.socket | None,
        payload: bytes,
        target: tuple[str, int] | tuple[str, int, int, int],
    ) -> None:
        try:
            if sock is None:
                raise OSError(errno.EAFNOSUPPORT, "no socket of this family")
            sock.sendto(payload, target)
        except (OSError, OverflowError, ValueError):  # no route, full queue, no permission, ...
            self.unsent += 1

    def _refresh(self, now: float) -> None:
        """Read the own addresses and those of seeds again, at most once per REFRESH_PERIOD."""
        if now - self._refreshed_at < REFRESH_PERIOD:
            return
        self._refreshed_at = now
        self._addresses = frozenset(addresses_of(self._index))
        self._has_ipv4 = self._is_dev or any(":" not in address for address in self._addresses)
        if (addresses := self._seeds.addresses(now)) is not None:
            self.recipients.set_seeds(addresses)

    # Receiving

    def receive(self) -> list[Received]:
        """Read the datagrams that have arrived, at most BATCH; never waits.

        A listener is a socket that receives datagrams of one way, such as multicast. Each call
        begins with another listener, and a listener uses at most half of what remains of BATCH: a
        flood at one socket does not shut out the datagrams of another socket.
        """
        received: list[Received] = []
        with self._lock:
            now = self._clock()
            self._refresh(now)
            self._weigh(now)
            self._is_full = False
            self._turns += 1
            first = self._turns % max(len(self._listeners), 1)
            budget = BATCH * _COST
            for listener in (*self._listeners[first:], *self._listeners[:first]):
                budget -= self._take_from(listener, budget // 2, now, received)
            self._update_filters(now)
            if not self._is_full:
                self._emptied_at = now
        return received

    def _update_filters(self, now: float) -> None:
        """Replace the kernel's packet filters if a flood has begun or ended."""
        rules = self._limits.rules(now)
        if rules is not self._rules:
            self._rules = rules
            for sock, _ in self._listeners:
                self._attach_filter(sock)

    def _weigh(self, now: float) -> None:
        """Update the weight of a datagram in the flood limits: arrived divided by read datagrams.

        The weight is 1 while the process reads all datagrams. A process with little CPU time reads
        so few datagrams of a flood that `FloodLimits` would not detect the flood, and the kernel
        drops the rest, stops included. Then the weight is above 1.
        """
        if now - self._emptied_at < OVERLOAD_TIME:
            self._weight = 1.0
            self._lost.clear()
        else:
            before = self._lost
            self._lost = {}
            for sock, _ in self._listeners:
                if (count := _count_lost(sock)) is not None:
                    self._lost[sock] = count
            lost = sum(count - before.get(sock, count) for sock, count in self._lost.items())
            self._weight = min(1.0 + lost / max(self._reads, 1), MAX_WEIGHT)
        self._reads = 0

    def _take_from(
        self, listener: _Listener, budget: int, now: float, received: list[Received]
    ) -> int:
        """Append the datagrams of a listener to `received`; returns their cost.

        A datagram that is taken costs _COST units, a dropped datagram only _DROP_COST. Reading ends
        once the socket is empty, or once the cost has reached `budget`. In the second case more
        datagrams may wait in the socket, and `_is_full` is set.
        """
        cost = 0
        longest_wait = now - self._emptied_at  # a datagram waits at most this time
        while cost < budget:
            try:
                payload, name, waited = _read(listener.socket, longest_wait)
            except BlockingIOError:
                return cost
            except OSError:  # the network's error report on a datagram that was sent
                cost += _DROP_COST
                continue
            source = self._admit(payload, name, listener.way, now)
            cost += _DROP_COST if source is None else _COST
            if source is not None:
                received.append(Received(payload, source, waited))
        self._is_full = True
        return cost

    def _admit(
        self, payload: bytes, name: tuple[str, int], way: _Way, now: float
    ) -> Address | None:
        """Admit or drop a datagram; returns its source, None if it is dropped.

        `name`: the source as the socket gives it. Dropped are the robot's own datagrams, datagrams
        that are too short for a kind, datagrams beyond the flood limits, and the second copy of a
        datagram that came by two ways. The way of a beacon of this swarm is noted for the user
        (`ways`), and decides how datagrams are sent to the source. In a secured swarm a beacon may
        be forged: its way decides only once the caller has called `confirm`.
        """
        host = name[0]
        port = name[1]
        self._reads += 1  # `_weigh` compares the datagrams read with the datagrams lost
        if port == self.port and (host in self._addresses or self._is_dev):
            return None  # this robot's own datagram, which its multicast brought back
        source = _address(name)
        if len(payload) <= KIND_OFFSET:
            self.dropped["datagram:short"] += 1
            return None
        if not self._limits.admits(source, payload[KIND_OFFSET], now, self._weight):
            return None
        is_beacon = payload[KIND_OFFSET] == Kind.BEACON and payload[_TAG] == self._tag
        if is_beacon:  # the way of both copies is noted, since each copy shows that its way works
            shown_way = _Way.MULTICAST if way is _Way.COPY else way
            self.ways.on_heard(source, shown_way.value, now)
        is_second_copy = self._note_copy(payload, source, way, now)
        if is_second_copy:
            return None
        if is_beacon and self._is_secured:
            keep_newest(self._unconfirmed, source, way, MAX_ADDRESSES)  # until `confirm`
        elif is_beacon:
            self._note_robot(source, way, now)
        return source

    def confirm(self, source: Address) -> None:
        """Send datagrams to this source: its last beacon is signed and fresh."""
        with self._lock:
            way = self._unconfirmed.pop(source, None)
            if way is not None:
                self._note_robot(source, way, self._clock())

    def _note_robot(self, source: Address, way: _Way, now: float) -> None:
        """Note by which way a robot was heard, which decides how the next datagrams are sent."""
        is_by_group = way in (_Way.MULTICAST, _Way.COPY)
        if is_by_group:
            self._multicast_at = now
        if way is _Way.MULTICAST and ":" in source[0]:
            self._ipv6_only_at = now
        if way is _Way.BROADCAST:
            is_by_group = self._needs_broadcast(now)
        self.recipients.on_heard(source, is_by_group, now)

    def _note_copy(self, payload: bytes, source: Address, way: _Way, now: float) -> bool:
        """Note a datagram; True if the same datagram has come by another way within COPY_TIME."""
        key = (source, payload)
        first_at, first_way = self._first_copies.get(key, (_NEVER, way))
        if now - first_at <= COPY_TIME:
            return first_way is not way
        if len(self._first_copies) >= BATCH:
            self._first_copies = {
                copy: (at, by) for copy, (at, by) in self._first_copies.items()
                if now - at <= COPY_TIME
            }  # fmt: skip
        if len(self._first_copies) < BATCH:
            self._first_copies[key] = (now, way)
        return False

    def attach(self, loop: AbstractEventLoop, on_datagram: OnDatagram) -> None:
        """Call `on_datagram(payload, source, waited)` on a running loop until `close`.

        `waited`: s from the arrival of the datagram until it was read. After a full batch the loop
        does not read for PAUSE s, so that a flood leaves time for its other work.
        """
        descriptors = self.filenos
        pause: TimerHandle | None = None

        def add_readers() -> None:
            for descriptor in descriptors:
                loop.add_reader(descriptor, on_readable)

        def remove_readers() -> None:
            for descriptor in descriptors:
                loop.remove_reader(descriptor)

        def on_readable() -> None:
            nonlocal pause
            received = self.receive()
            if self._is_full:
                remove_readers()
                pause = loop.call_later(PAUSE, add_readers)
            for datagram in received:
                on_datagram(datagram.payload, datagram.source, datagram.waited)

        def detach() -> None:
            remove_readers()
            if pause is not None:
                pause.cancel()

        self._detach = detach
        add_readers()

    def start_thread(self, on_datagram: OnDatagram) -> None:
        """Call `on_datagram(payload, source, waited)` on a new thread until `close`.

        `waited`: s from the arrival of the datagram until it was read.
        """
        wake_read, wake_write = os.pipe()  # a byte in this pipe ends the poll of the thread
        is_closed = threading.Event()
        poll = select.poll()
        for descriptor in (*self.filenos, wake_read):
            poll.register(descriptor, select.POLLIN)

        def run() -> None:
            while not is_closed.is_set():
                poll.poll()
                if is_closed.is_set():
                    break
                for datagram in self.receive():
                    on_datagram(datagram.payload, datagram.source, datagram.waited)
                if self._is_full:
                    is_closed.wait(PAUSE)

        thread = threading.Thread(target=run, name="swarmd-udp", daemon=True)

        def detach() -> None:
            is_closed.set()
            os.write(wake_write, b"x")
            if threading.current_thread() is not thread:  # `close` may come from `on_datagram`
                thread.join()
            os.close(wake_read)
            os.close(wake_write)

        self._detach = detach
        thread.start()

    # Sockets

    def rejoin(self) -> None:
        """Join the groups again after the interface was down or missing. Never raises."""
        with self._lock, contextlib.suppress(OSError, NetworkError):
            self._refreshed_at = _NEVER
            self._index = index_of(self._interface)
            for listener in self._listeners:
                with contextlib.suppress(OSError):
                    self._bind_to_interface(listener.socket)
                if listener.way in (_Way.MULTICAST, _Way.COPY):
                    with contextlib.suppress(OSError):
                        self._join(listener, socket.IP_DROP_MEMBERSHIP, socket.IPV6_LEAVE_GROUP)
                    self._join(listener, socket.IP_ADD_MEMBERSHIP, socket.IPV6_JOIN_GROUP)

    def _open(self, port: int) -> int:
        bound = self._open_unicast(port)
        if self._multicast:
            self._listen(socket.AF_INET, GROUP4, GROUP_PORT, _Way.MULTICAST)
            if not self._is_dev:
                self._listen(socket.AF_INET, BROADCAST, GROUP_PORT, _Way.BROADCAST)
            if self._own6 is not None:
                with contextlib.suppress(OSError):  # IPv6 is switched off on this interface
                    self._listen(socket.AF_INET6, GROUP6, GROUP_PORT, _Way.MULTICAST)
                    self._listen(socket.AF_INET6, COPIES6, GROUP_PORT, _Way.COPY)
        self._refresh(self._clock())
        return bound

    def _open_unicast(self, port: int) -> int:
        """Open the sockets that send, for IPv4 and IPv6 with one port; returns the port.

        With `port` 0 the system chooses a port that is free for IPv4. If this port is in use for
        IPv6, another port is tried.
        """
        tries = 1 if port else 1 + _PORT_TRIES
        for attempt in range(1, tries + 1):
            host = "127.0.0.1" if self._is_dev else "0.0.0.0"
            self._own4 = self._listen(socket.AF_INET, host, port, _Way.UNICAST)
            bound = int(self._own4.getsockname()[1])
            if self._is_dev:
                break
            try:
                self._own6 = self._listen(socket.AF_INET6, "::", bound, _Way.UNICAST)
                break
            except OSError as error:
                if error.errno != errno.EADDRINUSE:  # there is no IPv6 on this machine
                    break
                if attempt == tries:
                    raise
                self._listeners.pop().socket.close()
        return bound

    def _listen(self, family: int, host: str, port: int, way: _Way) -> socket.socket:
        """Open a bound socket for datagrams of one way, and add it to the listeners."""
        sock = socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        listener = _Listener(sock, way)
        try:
            self._attach_filter(sock)
            self._bind_to_interface(sock)
            if family == socket.AF_INET6:
                sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            if way is not _Way.UNICAST:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            scope = self._index if host.startswith("ff") else 0
            sock.bind((host, port) if family == socket.AF_INET else (host, port, 0, scope))
            self._enlarge(sock)
            sock.setsockopt(socket.SOL_SOCKET, arrival_time.SO_TIMESTAMPNS, 1)
            if way in (_Way.MULTICAST, _Way.COPY):
                self._join(listener, socket.IP_ADD_MEMBERSHIP, socket.IPV6_JOIN_GROUP)
        except OSError:
            sock.close()
            raise
        self._listeners.append(listener)
        return sock

    def _bind_to_interface(self, sock: socket.socket) -> None:
        """Let the socket send and receive on this interface only."""
        if sock.family == socket.AF_INET:
            index = struct.pack("4s4si", bytes(4), bytes(4), self._index)
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, index)
            sock.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        else:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, self._index)
            sock.setsockopt(socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)
        if self._is_dev:
            return
        try:
            name = self._interface.encode()
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, name)
        except PermissionError:  # before Linux 5.7, or bound already
            index = struct.pack("!I", self._index)
            if sock.family == socket.AF_INET:
                sock.setsockopt(socket.IPPROTO_IP, _IP_UNICAST_IF, index)
            else:
                sock.setsockopt(socket.IPPROTO_IPV6, _IPV6_UNICAST_IF, index)

    def _join(self, listener: _Listener, ipv4: int, ipv6: int) -> None:
        if listener.socket.family == socket.AF_INET:
            group = socket.inet_aton(GROUP4)
            membership = struct.pack("4s4si", group, bytes(4), self._index)
            listener.socket.setsockopt(socket.IPPROTO_IP, ipv4, membership)
        else:
            text = GROUP6 if listener.way is _Way.MULTICAST else COPIES6
            group = socket.inet_pton(socket.AF_INET6, text)
            membership = struct.pack("16si", group, self._index)
            listener.socket.setsockopt(socket.IPPROTO_IPV6, ipv6, membership)

    def _attach_filter(self, sock: socket.socket) -> None:
        """Replace the kernel's packet filter; if that fails, only `FloodLimits` drops datagrams."""
        for rules in (self._rules, self._rules.shortened()):
            program = swarm_filter(self._tag, rules, is_ipv6=sock.family == socket.AF_INET6)
            with contextlib.suppress(OSError):  # no memory for a long filter, or no filters here
                attach_filter(sock, program)
                return

    def _enlarge(self, sock: socket.socket) -> None:
        try:
            sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER)
        except PermissionError:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)

    def _explain(self, error: OSError, port: int) -> str:
        if error.errno == errno.EADDRINUSE:
            return (
                f"udp port {port or GROUP_PORT} is in use on this machine; give this robot a"
                " `listen` with another port"
            )
        return f"no datagrams on {self._interface}: {error.strerror}"


class _Seeds:
    """The addresses of seeds; a thread resolves host names, since that may take seconds."""

    def __init__(self, endpoints: Iterable[str]) -> None:
        parsed = [parse_endpoint(endpoint) for endpoint in endpoints]
        self._names = [(endpoint.host, endpoint.port) for endpoint in parsed]
        self._is_numeric = all(_sockaddr(name, 0) for name in self._names)
        self._next = _NEVER
        self._resolved: list[list[Address]] = []  # results of the thread, not taken yet
        self._is_under_way = False

    def addresses(self, now: float) -> list[Address] | None:
        """The addresses if they are new since the last call, else None.

        Starts the next resolution if it is due.
        """
        addresses = self._resolved.pop() if self._resolved else None
        if addresses is not None and len(addresses) < len(self._names):
            self._next = min(self._next, now + RETRY_PERIOD)
        if now >= self._next and not self._is_under_way and self._names:
            self._next = now + RESOLVE_PERIOD
            if self._is_numeric:
                self._next = float("inf")
                return self._names
            self._is_under_way = True
            threading.Thread(target=self._resolve, name="swarmd-seeds", daemon=True).start()
        return addresses

    def _resolve(self) -> None:
        addresses: list[Address] = []
        for host, port in self._names:
            with contextlib.suppress(OSError, UnicodeError):
                for *_, name in socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[:1]:
                    addresses.append(_address(name))
        self._resolved.append(addresses)
        self._is_under_way = False


def _read(sock: socket.socket, longest_wait: float) -> tuple[bytes, tuple[str, int], float]:
    """Read a datagram: payload, source, and the s for which the datagram has waited.

    The kernel's time of arrival is read only if datagrams may have waited longer than SHORT_WAIT,
    such as after a freeze of the process. Raises OSError as the socket.
    """
    if longest_wait <= SHORT_WAIT:
        payload, name = sock.recvfrom(MAX_DATAGRAM + 1)
        return payload, name, 0.0
    payload, ancillary, _, name = sock.recvmsg(MAX_DATAGRAM + 1, arrival_time.ROOM)
    return payload, name, min(max(arrival_time.waited(ancillary), 0.0), longest_wait)


def _count_lost(sock: socket.socket) -> int | None:
    """The count of datagrams that the kernel has dropped at a socket since it was opened.

    The kernel also counts datagrams that the packet filter has refused. So the count shows an
    overload only while the queue of the socket is nearly full: else None is returned. None also for
    a kernel without this count.
    """
    try:
        info = _MEMINFO.unpack(sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))
    except (OSError, struct.error):  # before Linux 4.12
        return None
    return int(info[_LOST]) if info[_QUEUED] > _NEARLY_FULL * info[_QUEUE_LIMIT] else None


def _address(name: tuple[object, ...]) -> Address:
    """The `Address` of a socket's address: a scope is appended to the host as `%<index>`."""
    host = str(name[0])
    port = int(str(name[1]))
    is_scoped = len(name) == 4 and name[3] and "%" not in host
    return (f"{host}%{name[3]}" if is_scoped else host), port


def _sockaddr(address: Address, index: int) -> tuple[str, int] | tuple[str, int, int, int] | None:
    """The socket's address of an `Address`; None if the host is a name, not an IP address.

    `index`: the interface of a link-local address without a scope.
    """
    host, _, scope = address[0].partition("%")
    try:
        ip = _ip(host)
        if scope:
            index = int(scope) if scope.isdecimal() else socket.if_nametoindex(scope)
    except (ValueError, OSError):
        return None
    if ip.version == 4:
        return None if scope else (host, address[1])
    return (host, address[1], 0, index if ip.is_link_local else 0)


@lru_cache(maxsize=2 * MAX_ADDRESSES)  # repeats go to the same hosts
def _ip(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    return ipaddress.ip_address(host)
