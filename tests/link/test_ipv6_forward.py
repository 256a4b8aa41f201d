"""Bytes pass from loopback to an IPv6 address and back; each end sees when the other one closes."""

from __future__ import annotations

import socket
import threading

import pytest

from swarmd.link.carriers.ipv6_forward import forward_to

CAP = 20.0


@pytest.fixture
def listener() -> socket.socket:
    try:
        return socket.create_server(("::1", 0), family=socket.AF_INET6)
    except OSError as error:
        pytest.skip(f"no IPv6 on loopback: {error}")


def test_connections_are_forwarded_both_ways(listener: socket.socket) -> None:
    with listener:
        listener.settimeout(CAP)
        port = forward_to("::1", listener.getsockname()[1])
        for content in (b"first", b"x" * 300_000):
            with socket.create_connection(("127.0.0.1", port), CAP) as near:
                far, _ = listener.accept()
                with far:
                    far.settimeout(CAP)
                    sending = threading.Thread(target=near.sendall, args=(content,))
                    sending.start()
                    got = b""
                    while len(got) < len(content):
                        got += far.recv(65536)
                    sending.join()
                    assert got == content
                    far.sendall(b"answer")
                    assert near.recv(6) == b"answer"
                assert near.recv(1) == b""  # the far end closed


def test_a_connection_to_nothing_ends(listener: socket.socket) -> None:
    gone = listener.getsockname()[1]
    listener.close()
    port = forward_to("::1", gone)
    with socket.create_connection(("127.0.0.1", port), CAP) as near:
        assert near.recv(1) == b""
