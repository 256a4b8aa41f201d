"""The tuner, held against the options of live links."""

from __future__ import annotations

import os
import socket
import struct
import sys
import time
from collections.abc import Iterator

import pytest
import zenoh

from swarmd.network.session import connected_sockets, open_session, tune_link
from swarmd.network.settings import NetworkSettings

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="sockets are found in /proc/self/fd"
)


def user_timeout(sock: socket.socket) -> int:
    return sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)


def lingers(sock: socket.socket) -> bool:
    return bool(struct.unpack("ii", sock.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))[0])


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    """A connected pair that is nobody's link, set as Zenoh sets its own."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        near = socket.create_connection(server.getsockname())
        far, _ = server.accept()
        near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 10))
        with near, far:
            yield near, far


def locator(name: tuple[str, int]) -> str:
    return f"tcp/{name[0]}:{name[1]}"


def test_it_tunes_the_sockets_between_two_locators(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    near, far = pair
    assert tune_link(locator(near.getsockname()), locator(far.getsockname()), 2.5) == 2
    assert [user_timeout(sock) for sock in pair] == [2500, 2500]
    assert not lingers(near)


def test_it_leaves_all_others_alone(pair: tuple[socket.socket, socket.socket]) -> None:
    near, _ = pair
    assert tune_link("tcp/127.0.0.1:1", "tcp/127.0.0.1:2", 2.5) == 0
    assert tune_link("nonsense", "unixpipe/x", 2.5) == 0
    assert user_timeout(near) == 0
    assert lingers(near)


def test_looking_leaves_every_descriptor_open_and_none_more(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    before = sorted(os.listdir("/proc/self/fd"))
    assert len(list(connected_sockets())) >= 2
    assert sorted(os.listdir("/proc/self/fd")) == before
    pair[0].sendall(b"still there")
    assert pair[1].recv(20) == b"still there"


def test_every_live_link_is_tuned(settings: NetworkSettings) -> None:
    """Both ends are in this process: each of at least three links shows up as two sockets."""
    sessions = [open_session(settings) for _ in range(3)]
    end = time.monotonic() + 20.0
    try:
        found: list[tuple[int, bool]] = []
        while len(found) < 6 or set(found) != {(2000, False)}:
            assert time.monotonic() < end, found
            found = live_sockets(sessions)
    finally:
        for session in sessions:
            session.close()


def live_sockets(sessions: list[zenoh.Session]) -> list[tuple[int, bool]]:
    """User timeout in ms, and whether close lingers, of each socket that belongs to a link."""
    links = [link for session in sessions for link in session.info.links()]
    ports = {int(one.rpartition(":")[2]) for link in links for one in (link.src, link.dst)}
    return [
        (user_timeout(sock), lingers(sock))
        for sock in connected_sockets()
        if {sock.getsockname()[1], sock.getpeername()[1]} <= ports
    ]
