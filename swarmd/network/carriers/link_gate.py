"""Keeps a flood of connections from the port for links of a secured robot.

Zenoh takes every TCP connection, gives its TLS handshake 10 s, and waits for 100 ms after each one
that failed. So 20 failed handshakes a second keep operators out, and silent connections use up the
files that the process may open (measured: 4096 within a second, and none of them free for minutes
after the flood). `LinkFlood` notices connections that wait, by the number of open files; for some
time the kernel then takes only connections from hosts that sent a datagram with a valid signature.
Stops, beacons and answers are datagrams, and need no connection.
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

LOOK_PERIOD = 0.25  # s
MAX_WAITING = 48  # connections without a link, beside what else a daemon opens in a run
CLOSED_TIME, MAX_CLOSED_TIME = 60.0, 600.0  # s; doubled if the flood is back within that time
RENEW_PERIOD = 30.0  # s between two new sessions, which end the links of operators, too
KNOWN_TIME = 600.0  # s after which a host is forgotten
MAX_HOSTS = 64  # places in the kernel's filter
LINE_RATE, LINE_BURST = 0.1, 5.0
"""Lines of `watch_links` per second, and at once."""
_FDS = "/proc/self/fd"
_SO_DETACH_FILTER = 27


class LinkFlood:
    """When the port is closed to unknown hosts, and to whom it is open. Pure; times in s.

    `files`: the open files of the process without links.
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
        """A host sent a datagram that counts; True if it was unknown."""
        is_new = host not in self._heard
        keep_newest(self._heard, host, now, 2 * MAX_HOSTS)
        return is_new

    def known(self, now: float) -> tuple[str, ...]:
        """The hosts that may connect while the port is closed.

        They were heard within KNOWN_TIME, the latest MAX_HOSTS of them.
        """
        recent = [host for host, at in self._heard.items() if now - at <= KNOWN_TIME]
        return tuple(recent[-MAX_HOSTS:])

    def is_due(self, now: float) -> bool:
        """True if it is time for another look."""
        return now >= self._look_at

    def look(self, files: int, links: Callable[[], int], now: float) -> bool:
        """Take the number of open files; True if connections wait that a new session would end.

        `links` counts the links of the session; it is called if there are many files.
        """
        self._look_at = now + LOOK_PERIOD
        self.waiting = files - self._files
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
    """The listening sockets of this process at some ports, which Zenoh has opened. Linux only."""

    def __init__(self, ports: Collection[int]) -> None:
        self._sockets = [
            socket.socket(fileno=listener.detach())  # `dup` would let Zenoh's socket block
            for listener in own_sockets()
            if listener.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
            and listener.getsockname()[1] in ports
        ]
        self.is_closed = False

    def admit(self, hosts: Collection[str] | None) -> None:
        """Take connections from these hosts only; None: from all. Links that exist go on."""
        self.is_closed = hosts is not None
        for listener in self._sockets:
            with contextlib.suppress(OSError):  # no filter is attached, or none can be
                if hosts is None:
                    listener.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)
                    continue
                attach_filter(listener, host_filter(map(ipaddress.ip_address, hosts)))

    def close(self) -> None:
        """Let go of the sockets."""
        for listener in self._sockets:
            listener.close()
        self._sockets = []


def open_files() -> int:
    """The number of files that this process has open; its limit if it cannot open one more."""
    try:
        return len(os.listdir(_FDS))
    except OSError:
        return os.sysconf("SC_OPEN_MAX")


def watch_links(
    session: zenoh.Session, roster: Roster, loop: AbstractEventLoop, on_event: Callable[[str], None]
) -> None:
    """Call `on_event` on the loop with a line for each link of a name that the roster lacks.

    Its certificate is valid, and nothing passes. Zenoh denies silently, so that a name that was
    revoked and goes on trying would not be noticed. The rate of lines is limited.
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
