"""Keeps a peer that vanished from stalling the links to those that are still there.

Zenoh sets SO_LINGER to 10 s on its TCP sockets. When a lease expires with unacknowledged data,
close() then blocks one of the two receiving threads in the kernel, and the survivors hear nothing
from each other for up to 10 s (measured: 10.1 s with six of eight robots gone). Linux only, since
the sockets are found in /proc/self/fd; elsewhere nothing is tuned.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import socket
import struct
import sys
from collections.abc import Iterator

import zenoh

_FDS = "/proc/self/fd"
# Off: close() returns at once, and what is unsent is still delivered in the background. On with
# 0 s would cut off the last words of a daemon that leaves.
_NO_LINGER = struct.pack("ii", 0, 0)

Address = tuple[str, int]


def tune_sockets(session: zenoh.Session, lease: float) -> None:
    """Tune every link of the session, now and later, until it closes. `lease` in s."""
    if not sys.platform.startswith("linux"):
        return

    def on_link(event: zenoh.LinkEvent) -> None:
        # On a thread of its own, which Zenoh starts for this callback.
        if event.kind == zenoh.SampleKind.PUT:
            tune_link(event.link.src, event.link.dst, lease)

    session.info.declare_link_events_listener(on_link, history=True)


def tune_link(src: str, dst: str, lease: float) -> int:
    """Tune the sockets between two locators such as `tcp/127.0.0.1:7447`; says how many."""
    ends = {_address(src), _address(dst)}
    tuned = 0
    for sock in connected_sockets():
        with contextlib.suppress(OSError):  # closed meanwhile
            if _canonical(sock.getsockname()) in ends and _canonical(sock.getpeername()) in ends:
                _tune(sock, lease)
                tuned += 1
    return tuned


def connected_sockets() -> Iterator[socket.socket]:
    """This process's connected TCP sockets, each as a duplicate that is closed after its turn.

    The descriptors belong to other threads, which may close and reuse them at any moment: a
    duplicate stays what it is while it is looked at.
    """
    for name in os.listdir(_FDS):
        try:
            duplicate = _duplicate(int(name))
        except OSError:
            continue
        if duplicate is None:
            continue
        with duplicate:
            if _is_tcp(duplicate):
                yield duplicate


def _duplicate(fd: int) -> socket.socket | None:
    if not os.readlink(f"{_FDS}/{fd}").startswith("socket:"):
        return None
    copy = os.dup(fd)
    try:
        return socket.socket(fileno=copy)
    except OSError:
        os.close(copy)
        return None


def _is_tcp(sock: socket.socket) -> bool:
    if sock.family not in (socket.AF_INET, socket.AF_INET6) or sock.type != socket.SOCK_STREAM:
        return False
    try:
        sock.getpeername()
    except OSError:
        return False
    return True


def _tune(sock: socket.socket, lease: float) -> None:
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NO_LINGER)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(lease * 1000))


def _address(locator: str) -> Address | None:
    host, _, port = locator.partition("/")[2].partition("#")[0].partition("?")[0].rpartition(":")
    return _canonical((host.strip("[]"), int(port))) if port.isdecimal() else None


def _canonical(name: object) -> Address | None:
    if not isinstance(name, tuple) or len(name) < 2:
        return None
    try:
        address = ipaddress.ip_address(str(name[0]).partition("%")[0])
    except ValueError:
        return None
    mapped = getattr(address, "ipv4_mapped", None)
    return str(mapped or address), int(name[1])
