"""A flood of connections is noticed, and the kernel refuses those of unknown hosts."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator

import pytest

from swarmd.network.carriers.link_gate import (
    CLOSED_TIME,
    KNOWN_TIME,
    LOOK_PERIOD,
    MAX_HOSTS,
    MAX_WAITING,
    RENEW_PERIOD,
    LinkFlood,
    LinkGate,
    open_files,
)

FILES = 30


@pytest.fixture
def flood() -> LinkFlood:
    return LinkFlood(FILES, 0.0)


def test_links_and_some_more_files_close_nothing(flood: LinkFlood) -> None:
    assert not flood.look(FILES + MAX_WAITING, lambda: 0, 0.0)
    assert not flood.look(FILES + MAX_WAITING + 200, lambda: 200, 1.0)
    assert not flood.is_closed(1.0)


def test_connections_that_wait_close_the_port_for_a_while(flood: LinkFlood) -> None:
    assert flood.look(FILES + MAX_WAITING + 21, lambda: 20, 5.0)
    assert flood.waiting == MAX_WAITING + 1
    assert flood.is_closed(5.0 + CLOSED_TIME - 0.1)
    assert not flood.is_closed(5.0 + CLOSED_TIME)


def test_a_flood_that_is_back_closes_it_longer(flood: LinkFlood) -> None:
    assert flood.look(1000, lambda: 0, 0.0)
    assert flood.look(1000, lambda: 0, CLOSED_TIME + 1.0)
    assert flood.closed_until == pytest.approx(3 * CLOSED_TIME + 1.0)
    assert flood.look(1000, lambda: 0, 1e4)
    assert flood.closed_until == pytest.approx(1e4 + CLOSED_TIME)


def test_sessions_are_renewed_seldom(flood: LinkFlood) -> None:
    """A new session ends the links of operators, too."""
    assert flood.look(1000, lambda: 0, 0.0)
    assert not flood.look(1000, lambda: 0, RENEW_PERIOD - 0.1)
    assert flood.look(1000, lambda: 0, RENEW_PERIOD)


def test_looks_are_a_period_apart(flood: LinkFlood) -> None:
    assert flood.is_due(0.0)
    flood.look(FILES, lambda: 0, 0.0)
    assert not flood.is_due(0.9 * LOOK_PERIOD)
    assert flood.is_due(LOOK_PERIOD)


def test_the_newest_hosts_are_known(flood: LinkFlood) -> None:
    assert flood.hear("10.0.0.1", 0.0)
    assert not flood.hear("10.0.0.1", 1.0)
    for number in range(2 * MAX_HOSTS):
        flood.hear(f"10.0.1.{number}", 2.0)
    assert flood.known(2.0) == tuple(f"10.0.1.{n}" for n in range(MAX_HOSTS, 2 * MAX_HOSTS))
    assert flood.known(2.0 + KNOWN_TIME + 1.0) == ()


@pytest.fixture(params=["127.0.0.1", "::"])
def listener(request: pytest.FixtureRequest) -> Iterator[socket.socket]:
    """A listening socket of IPv4, or one of both families."""
    family = socket.AF_INET6 if ":" in request.param else socket.AF_INET
    try:
        made = socket.socket(family, socket.SOCK_STREAM)
    except OSError:
        pytest.skip("no IPv6 here")
    with made:
        if family == socket.AF_INET6:
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        made.bind((request.param, 0))
        made.listen()
        yield made


def is_taken(listener: socket.socket, source: str) -> bool:
    host = "::1" if ":" in source else "127.0.0.1"
    address = host, listener.getsockname()[1]
    with (
        contextlib.suppress(TimeoutError),
        socket.create_connection(address, timeout=0.3, source_address=(source, 0)),
    ):
        return True
    return False


def test_the_kernel_takes_connections_of_the_hosts_that_are_named(listener: socket.socket) -> None:
    gate = LinkGate({listener.getsockname()[1]})
    with contextlib.closing(gate):
        gate.admit(["127.0.0.1", "10.0.0.7", "fe80::1"])
        assert is_taken(listener, "127.0.0.1")
        assert not is_taken(listener, "127.0.0.2")
        gate.admit(["127.0.0.2"])
        assert not is_taken(listener, "127.0.0.1")
        gate.admit([])
        assert not is_taken(listener, "127.0.0.2")
        gate.admit(None)
        assert is_taken(listener, "127.0.0.1")
        assert is_taken(listener, "127.0.0.2")


@pytest.mark.parametrize("listener", ["::"], indirect=True)
def test_hosts_of_both_families_are_told_apart(listener: socket.socket) -> None:
    gate = LinkGate({listener.getsockname()[1]})
    with contextlib.closing(gate):
        gate.admit(["::1"])
        assert is_taken(listener, "::1")
        assert not is_taken(listener, "127.0.0.1")
        gate.admit(["127.0.0.1"])
        assert not is_taken(listener, "::1")


def test_connections_that_exist_go_on(listener: socket.socket) -> None:
    port = listener.getsockname()[1]
    gate = LinkGate({port})
    with contextlib.closing(gate), socket.create_connection(("127.0.0.1", port)) as one:
        taken, _ = listener.accept()
        with taken:
            gate.admit([])
            one.sendall(b"x")
            taken.settimeout(10.0)
            assert taken.recv(1) == b"x"


def test_other_ports_stay_open(listener: socket.socket) -> None:
    gate = LinkGate(set())
    with contextlib.closing(gate):
        gate.admit([])
        assert is_taken(listener, "127.0.0.1")


def test_open_files_are_counted() -> None:
    before = open_files()
    with contextlib.ExitStack() as left:
        for _ in range(40):
            left.enter_context(socket.socket())
        assert open_files() >= before + 30
