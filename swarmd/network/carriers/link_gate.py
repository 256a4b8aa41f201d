"""Protects the TCP port of a secured robot from a flood of connections.

Zenoh accepts every TCP connection, gives its TLS handshake 10 s, and waits 100 ms after each
handshake that failed. So 20 failed handshakes a second keep operators out. Connections that send
nothing use up the files that the process may open. Measured: a flood took all 4096 files within a
second, and none was free for minutes after the flood.

`LinkFlood` detects waiting connections by the number of open files. For some time the kernel's
packet filter (`LinkGate`) then accepts only connections from known hosts: hosts that sent a
datagram with a valid signature. Stops, beacons and answers are datagrams, and need no connection.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import socket
from asyncio import AbstractEventLoop
from collections.abc import Callable, Collection

import zenoh

from swarmd.core.bounds import keep_newest
from swarmd.core.clock import boottime
from swarmd.core.threads import hand_over
from swarmd.core.token_bucket import TokenBucket
from swarmd.network.carriers.packet_filter import attach_filter, host_filter
from swarmd.network.carriers.session import own_sockets
from swarmd.security.roster import Roster

LOOK_PERIOD = 0.25  # s between two counts of the open files
MAX_WAITING = 48  # open files beyond those at the start and those of links that make a flood
CLOSED_TIME, MAX_CLOSED_TIME = 60.0, 600.0  # s; doubled if the flood is back within that time
RENEW_PERIOD = 30.0  # s between two new sessions: a new session also ends the links of operators
KNOWN_TIME = 600.0  # s after which a host is forgotten
MAX_HOSTS = 64  # hosts in the kernel's filter
LINE_RATE, LINE_BURST = 0.1, 5.0
"""Lines of `watch_links` per second, and at once."""
_FDS = "/proc/self/fd"
_SO_DETACH_FILTER = 27


class LinkFlood:
    """Decides when the port is closed to unknown hosts, and which hosts are known. Pure.

    `files`: the number of open files of the process at the start, without links. Times in s.
    """

    def __init__(self, files: int, now: float) -> None:
        self._files = files
        self._look_at = now
        self._renew_at = -1e9
        self._closed_time = CLOSED_TIME
        self._heard: dict[str, float] = {}
        self.closed_until = -1e9
        self.waiting = 0

    def is_closed(self, now: float) -> bool:
        """True while only known hosts may connect."""
        return now < self.closed_until

    def hear(self, host: str, now: float) -> bool:
        """Note a host that sent a datagram with a valid signature; True if it was unknown."""
        is_new = host not in self._heard
        keep_newest(self._heard, host, now, 2 * MAX_HOSTS)
        return is_new

    def known(self, now: float) -> tuple[str, ...]:
        """The hosts that may connect while the port is closed.

        The last MAX_HOSTS hosts that were heard within KNOWN_TIME.
        """
        recent = [host for host, at in self._heard.items() if now - at <= KNOWN_TIME]
        return tuple(recent[-MAX_HOSTS:])

    def is_due(self, now: float) -> bool:
        """True if `look` is to be called."""
        return now >= self._look_at

    def look(self, files: int, links: Callable[[], int], now: float) -> bool:
        """Compare the number of open files with the limit; True if a flood has just been detected.

        `files`: the number of open files. `links` returns the number of links of the session; it is
        called only if many files are open. After a flood was detected, `is_closed` is True for some
        time. The caller must let only known hosts connect, and open a new session, which ends the
        connections that wait.
        """
        self._look_at = now + LOOK_PERIOD
        self.waiting = files - self._files  # an upper bound: the links of the session are included
        if self.waiting > MAX_WAITING:
            self.waiting -= links()
        if self.waiting <= MAX_WAITING or now < self._renew_at:
            return False
        is_back = now - self.closed_until <= self._closed_time
        self._closed_time = min(2 * self._closed_time, MAX_CLOSED_TIME) if is_back else CLOSED_TIME
        self.closed_until = now + self._closed_time
        self._renew_at = now + RENEW_PERIOD
        return True


class LinkGate:
    """The packet filter on the sockets with which Zenoh listens at some ports. Linux only."""

    def __init__(self, ports: Collection[int]) -> None:
        self._sockets = [
            socket.socket(fileno=listener.detach())  # `dup` would let Zenoh's socket block
            for listener in own_sockets()
            if listener.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
            and listener.getsockname()[1] in ports
        ]
        self.is_closed = False

    def admit(self, hosts: Collection[str] | None) -> None:
        """Accept connections only from these hosts; None: from all. Existing links stay."""
        self.is_closed = hosts is not None
        for listener in self._sockets:
            with contextlib.suppress(OSError):  # no filter to detach, or filters are forbidden
                if hosts is None:
                    listener.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)
                    continue
                attach_filter(listener, host_filter(map(ipaddress.ip_address, hosts)))

    def close(self) -> None:
        """Close the duplicates of the sockets."""
        for listener in self._sockets:
            listener.close()
        self._sockets = []


def open_files() -> int:
    """The number of open files of this process; the limit if no further file can be opened."""
    try:
        return len(os.listdir(_FDS))
    except OSError:
        return os.sysconf("SC_OPEN_MAX")


def watch_links(
    session: zenoh.Session, roster: Roster, loop: AbstractEventLoop, on_event: Callable[[str], None]
) -> None:
    """Call `on_event` on the loop with a line for each link to a name that is not on the roster.

    Such a name was revoked: its certificate is valid, but the access rules permit none of its
    messages. Zenoh drops these messages silently: without the line an attempt would go unnoticed.
    The rate of lines is limited.
    """
    rate = TokenBucket(LINE_RATE, LINE_BURST)

    def on_link(event: zenoh.LinkEvent) -> None:
        name = event.link.auth_identifier
        if event.kind != zenoh.SampleKind.PUT or name is None or roster.role_of(name) is not None:
            return
        if rate.take(1.0, boottime()):
            address = str(event.link.dst).partition("/")[2]
            text = f"{address} has a certificate of {name[:63]!r}, which is not on roster"
            hand_over(loop, on_event, f"{text} {roster.generation}: nothing passes this link")

    session.info.declare_link_events_listener(on_link, history=True)
