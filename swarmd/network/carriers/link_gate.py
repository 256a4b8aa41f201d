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
import struct
from array import array
from collections.abc import Callable, Collection, Iterator

from swarmd.core.bounds import keep_newest
from swarmd.network.carriers.packet_filter import host_filter

LOOK_PERIOD = 0.25  # s
MAX_WAITING = 48  # connections without a link, beside what else a daemon opens in a run
CLOSED_TIME, MAX_CLOSED_TIME = 60.0, 600.0  # s; doubled if the flood is back within that time
RENEW_PERIOD = 30.0  # s between two new sessions, which end the links of operators, too
KNOWN_TIME = 600.0  # s after which a host is forgotten
MAX_HOSTS = 64  # places in the kernel's filter
_FDS = "/proc/self/fd"
_SO_ATTACH_FILTER, _SO_DETACH_FILTER = 26, 27


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
        """The hosts that were heard last."""
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
        self._sockets = list(_listening(ports))
        self.is_closed = False

    def admit(self, hosts: Collection[str] | None) -> None:
        """Take connections from these hosts only; None: from all. Links that exist go on."""
        self.is_closed = hosts is not None
        for one in self._sockets:
            with contextlib.suppress(OSError):  # no filter is attached, or none can be
                if hosts is None:
                    one.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)
                    continue
                program = host_filter(map(ipaddress.ip_address, hosts))
                code = array("B", program)
                filter_ = struct.pack("@HP", len(program) // 8, code.buffer_info()[0])
                one.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, filter_)

    def close(self) -> None:
        """Let go of the sockets."""
        for one in self._sockets:
            one.close()
        self._sockets = []


def open_files() -> int:
    """The number of files that this process has open; its limit if it cannot open one more."""
    try:
        return len(os.listdir(_FDS))
    except OSError:
        return os.sysconf("SC_OPEN_MAX")


def _listening(ports: Collection[int]) -> Iterator[socket.socket]:
    """Duplicates of the listening TCP sockets of this process at these ports."""
    try:
        names = os.listdir(_FDS)
    except OSError:  # not Linux, or no file can be opened
        return
    for name in names:
        with contextlib.suppress(OSError):  # closed meanwhile
            if not os.readlink(f"{_FDS}/{name}").startswith("socket:"):
                continue
            one = socket.socket(fileno=os.dup(int(name)))
            if _is_listening(one) and one.getsockname()[1] in ports:
                yield one
            else:
                one.close()


def _is_listening(one: socket.socket) -> bool:
    is_tcp = one.family in (socket.AF_INET, socket.AF_INET6) and one.type == socket.SOCK_STREAM
    return is_tcp and bool(one.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN))
