"""Floods of connections and of links are noticed, and the kernel refuses those of some hosts."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from swarmd.link.carriers.link_gate import (
    CLOSED_TIME,
    KNOWN_TIME,
    LOOK_PERIOD,
    MAX_ENDED,
    MAX_HOSTS,
    MAX_WAITING,
    RENEW_PERIOD,
    LinkFlood,
    LinkGate,
    LinkShares,
    open_files,
)
from swarmd.link.carriers.session import (
    address_of,
    end_links,
    open_pull_session,
    open_with,
    session_options,
)
from swarmd.link.keys.roster import Roster
from swarmd.link.settings import NetworkSettings
from tests.support.keys import SwarmKeys
from tests.support.processes import free_endpoint, unique_swarm, wait_until

FILES = 30


@pytest.fixture
def flood() -> LinkFlood:
    return LinkFlood(FILES, 0.0)


def test_links_and_some_more_files_close_nothing(flood: LinkFlood) -> None:
    assert not flood.look(FILES + MAX_WAITING, 0, 0.0)
    assert not flood.look(FILES + MAX_WAITING + 200, 200, 1.0)
    assert not flood.is_closed(1.0)


def test_connections_that_wait_close_the_port_for_a_while(flood: LinkFlood) -> None:
    assert flood.look(FILES + MAX_WAITING + 21, 20, 5.0)
    assert flood.waiting == MAX_WAITING + 1
    assert flood.is_closed(5.0 + CLOSED_TIME - 0.1)
    assert not flood.is_closed(5.0 + CLOSED_TIME)


def test_a_flood_that_is_back_closes_it_longer(flood: LinkFlood) -> None:
    assert flood.look(1000, 0, 0.0)
    assert flood.look(1000, 0, CLOSED_TIME + 1.0)
    assert flood.closed_until == pytest.approx(3 * CLOSED_TIME + 1.0)
    assert flood.look(1000, 0, 1e4)
    assert flood.closed_until == pytest.approx(1e4 + CLOSED_TIME)


def test_sessions_are_renewed_seldom(flood: LinkFlood) -> None:
    """A new session ends the links of operators, too."""
    assert flood.look(1000, 0, 0.0)
    assert not flood.look(1000, 0, RENEW_PERIOD - 0.1)
    assert flood.look(1000, 0, RENEW_PERIOD)


def test_looks_are_a_period_apart(flood: LinkFlood) -> None:
    assert flood.is_due(0.0)
    flood.look(FILES, 0, 0.0)
    assert not flood.is_due(0.9 * LOOK_PERIOD)
    assert flood.is_due(LOOK_PERIOD)


def test_the_newest_hosts_are_known(flood: LinkFlood) -> None:
    assert flood.hear("10.0.0.1", 0.0)
    assert not flood.hear("10.0.0.1", 1.0)
    for number in range(2 * MAX_HOSTS):
        flood.hear(f"10.0.1.{number}", 2.0)
    assert flood.known(2.0) == tuple(f"10.0.1.{n}" for n in range(MAX_HOSTS, 2 * MAX_HOSTS))
    assert flood.known(2.0 + KNOWN_TIME + 1.0) == ()


def test_a_host_of_many_ended_links_is_refused_for_a_while(flood: LinkFlood) -> None:
    assert flood.end(["10.0.0.8"] * MAX_ENDED, 0.0) == []
    assert flood.end(["10.0.0.7", *["10.0.0.9"] * (MAX_ENDED + 1)], 1.0) == ["10.0.0.9"]
    assert flood.refused(1.0) == ("10.0.0.9",)
    assert flood.refused(1.0 + CLOSED_TIME) == ()


def test_a_host_of_an_operator_is_not_refused(flood: LinkFlood) -> None:
    flood.hear("10.0.0.7", 0.0, is_operator=True)
    flood.hear("10.0.0.8", 0.0)
    hosts = ["10.0.0.7", "10.0.0.8"] * (MAX_ENDED + 1)
    assert flood.end(hosts, 1.0) == ["10.0.0.8"]
    assert flood.end(["10.0.0.7"] * (MAX_ENDED + 1), KNOWN_TIME + 1.0) == ["10.0.0.7"]


ROSTER = Roster(
    swarm="x",
    generation=3,
    robots=("r1", "r2"),
    operators={"anna": b"k" * 64, "bob": b"k" * 64},
    viewers=("class", "eve"),
    secret_digest=bytes(32),
)


def links_of(**counts: int) -> dict[str, str]:
    """Links of names, by the locator of the far end."""
    return {f"tls/{name}:{i}": name for name, count in counts.items() for i in range(count)}


def test_a_name_has_no_more_links_than_its_share() -> None:
    shares = LinkShares(ROSTER, per_name=3, others=100)
    assert shares.excess(links_of(anna=3, eve=3, r1=3)) == {}
    ended = shares.excess(links_of(anna=5, eve=4, bob=3, r2=1))
    assert set(ended) == {"tls/anna:3", "tls/anna:4", "tls/eve:3"}


def test_robots_and_viewers_together_leave_links_to_operators() -> None:
    shares = LinkShares(ROSTER, per_name=3, others=5)
    ended = shares.excess(links_of(r1=2, r2=2, eve=3, anna=3, bob=3))
    assert set(ended) == {"tls/eve:1", "tls/eve:2"}


def test_a_link_of_a_name_that_is_not_on_the_roster_ends() -> None:
    ended = LinkShares(ROSTER).excess(links_of(mallory=1, anna=1) | {"tls/nameless:1": ""})
    assert set(ended) == {"tls/mallory:0", "tls/nameless:1"}
    assert "roster 3" in ended["tls/mallory:0"]


def test_the_oldest_links_stay() -> None:
    shares = LinkShares(ROSTER, per_name=2, others=100)
    assert shares.excess({"tls/b:1": "eve", "tls/c:1": "eve"}) == {}
    assert set(shares.excess({"tls/a:1": "eve", "tls/b:1": "eve", "tls/c:1": "eve"})) == {"tls/a:1"}
    assert shares.excess({"tls/a:1": "eve", "tls/c:1": "eve"}) == {}


@pytest.mark.parametrize(
    ("locator", "address"),
    [
        ("tls/10.0.0.9:7440", ("10.0.0.9", 7440)),
        ("tls/[::ffff:10.0.0.9]:7440", ("10.0.0.9", 7440)),
        ("tls/[fe80::1%lo]:7440#iface=lo", ("fe80::1", 7440)),
        ("unixpipe/x", None),
    ],
)
def test_an_address_is_read_from_a_locator(locator: str, address: tuple[str, int] | None) -> None:
    assert address_of(locator) == address


def test_one_link_of_a_session_ends_and_the_others_stay(tmp_path: Path) -> None:
    name, endpoint = unique_swarm(), free_endpoint()
    keys = SwarmKeys(tmp_path, name, ["r1"], operators=["anna"], viewers=["eve"])
    settings = NetworkSettings(swarm=name, listen=(endpoint,))
    address = "127.0.0.1", int(endpoint.rpartition(":")[2])
    with contextlib.ExitStack() as left:
        robot = open_with(session_options(settings, keys["r1"]), "r1")
        left.callback(robot.close)
        for owner in ("anna", "eve"):
            left.callback(open_pull_session(settings, address, keys[owner]).close)

        def names() -> set[str | None]:
            return {link.auth_identifier for link in robot.info.links()}

        wait_until(lambda: names() == {"anna", "eve"}, "both have links")
        links = {link.auth_identifier: link for link in robot.info.links()}
        end_links([(str(links["eve"].src), str(links["eve"].dst))])
        wait_until(
            lambda: str(links["eve"].dst) not in {str(one.dst) for one in robot.info.links()},
            "the link of eve ends",
        )
        assert str(links["anna"].dst) in {str(one.dst) for one in robot.info.links()}


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


@pytest.mark.integration
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


@pytest.mark.integration
def test_the_kernel_refuses_the_hosts_that_are_named(listener: socket.socket) -> None:
    gate = LinkGate({listener.getsockname()[1]})
    with contextlib.closing(gate):
        gate.admit(None, ["127.0.0.2", "fe80::1"])
        assert is_taken(listener, "127.0.0.1")
        assert not is_taken(listener, "127.0.0.2")
        gate.admit(["127.0.0.1", "127.0.0.2"], ["127.0.0.2"])
        assert is_taken(listener, "127.0.0.1")
        assert not is_taken(listener, "127.0.0.2")
        gate.admit(None)
        assert is_taken(listener, "127.0.0.2")


@pytest.mark.integration
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
