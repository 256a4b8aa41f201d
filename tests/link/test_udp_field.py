"""Datagrams in profile field: two hosts, each a thread in a network namespace of its own."""

from __future__ import annotations

import contextlib
import ctypes
import os
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import pytest

from swarmd.link.carriers.interface_watch import read_state
from swarmd.link.carriers.udp import BEACONS_A_BROADCAST, GROUP4, UdpCarrier, _Way
from swarmd.link.datagram import Address, Beacon, Solicit, Stop, pack, tag_of
from swarmd.link.settings import NetworkSettings
from tests.support.forked import CLONE_NEWNET

pytestmark = pytest.mark.integration

SETTINGS = NetworkSettings(swarm="lab", profile="field", interface="radio", lease=1.0)
TAG = tag_of("field", "lab")
T = TypeVar("T")


def beacon(number: int) -> bytes:
    body = Beacon(robot="r1", instance=bytes(6), sequence=number, wire=1, state=0, revision=0)
    return pack(TAG, body)


def stop(name: str) -> bytes:
    return pack(TAG, Stop(id=name, verb="stop", operator="anna"))


class Host:
    """A thread in a namespace of its own, and its carrier; `now` is the carrier's clock."""

    def __init__(self, number: int) -> None:
        self._pool = ThreadPoolExecutor(1)
        self.address = f"10.70.0.{number}"
        self.now = 1000.0
        if self.do(lambda: ctypes.CDLL(None).unshare(CLONE_NEWNET)) != 0:
            pytest.skip("network namespaces are not permitted here")
        self.thread = self.do(threading.get_native_id)
        self.carrier: UdpCarrier

    def do(self, function: Callable[[], T]) -> T:
        return self._pool.submit(function).result()

    def ip(self, *lines: str) -> None:
        for line in lines:
            self.do(lambda: subprocess.run(["ip", *line.split()], check=True))  # noqa: B023

    def open(self) -> None:
        self.carrier = self.do(lambda: UdpCarrier(SETTINGS, TAG, clock=lambda: self.now))

    def send(self, payload: bytes) -> None:
        self.do(lambda: self.carrier.send(payload))

    def send_to(self, payload: bytes, address: Address) -> None:
        self.do(lambda: self.carrier.send_to(payload, address))

    def hear(self, *wanted: bytes) -> list[tuple[bytes, Address]]:
        """What arrives until all that is wanted has; AssertionError after 10 s."""
        found: list[tuple[bytes, Address]] = []
        deadline = time.monotonic() + 10.0
        while not set(wanted) <= {payload for payload, _ in found}:
            assert time.monotonic() < deadline, found
            found += [one[:2] for one in self.do(self.carrier.receive)]
        return found

    def close(self) -> None:
        if hasattr(self, "carrier"):
            self.carrier.close()
        self._pool.shutdown()


@pytest.fixture
def hosts() -> Iterator[tuple[Host, Host]]:
    """Two hosts on one link, with addresses of both families, without carriers yet."""
    if os.geteuid() != 0:
        pytest.skip("a network namespace needs root")
    with contextlib.ExitStack() as left:
        a, b = (left.enter_context(contextlib.closing(Host(number))) for number in (1, 2))
        a.ip(f"link add radio type veth peer name radio netns {b.thread}")
        for one in (a, b):
            one.ip("link set lo up", f"addr add {one.address}/24 dev radio", "link set radio up")
        for one in (a, b):
            await_link_local(one)
        yield a, b


def await_link_local(host: Host) -> None:
    deadline = time.monotonic() + 20.0
    while not host.do(lambda: read_state("radio")).link_local:
        assert time.monotonic() < deadline, "the kernel makes no link-local address"
        time.sleep(0.02)


def leave_group(host: Host) -> None:
    """As behind an access point that drops multicast."""
    membership = struct.pack("4s4si", socket.inet_aton(GROUP4), bytes(4), host.carrier._index)
    for sock, way in host.carrier._listeners:
        if way is _Way.MULTICAST and sock.family == socket.AF_INET:
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, membership)


def test_each_datagram_arrives_once_by_whatever_way(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    a.open()
    b.open()
    a.send(beacon(1))
    a.send(stop("s"))
    a.send_to(beacon(2), (b.address, b.carrier.port))
    source = (a.address, a.carrier.port)
    assert sorted(b.hear(beacon(2))) == sorted(
        [(beacon(1), source), (stop("s"), source), (beacon(2), source)]
    )
    b.send(beacon(3))
    assert a.hear(beacon(3)) == [(beacon(3), (b.address, b.carrier.port))]  # not its own


def test_broadcast_reaches_those_whom_multicast_does_not(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    a.open()
    b.open()
    leave_group(b)
    a.send(beacon(1))  # a has heard nobody
    b.hear(beacon(1))
    b.send(beacon(2))
    a.hear(beacon(2))
    for number in range(3, 3 + BEACONS_A_BROADCAST):  # a hears b by multicast
        a.send(beacon(number))
    a.send(stop("s"))
    found = [payload for payload, _ in b.hear(stop("s"))]
    assert len(found) == 2, found  # the stop, and one of the five
    b.send(beacon(20))
    a.hear(beacon(20))
    a.now += 2.0  # a hears nobody any more
    a.send(beacon(21))
    b.hear(beacon(21))


def test_hosts_with_and_without_ipv4_hear_each_other(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    b.ip("-4 addr flush dev radio")
    a.open()
    b.open()
    b.send(beacon(1))
    ((_, (host, port)),) = a.hear(beacon(1))
    assert host.startswith("fe80::")
    assert int(host.partition("%")[2]) == a.carrier._index
    a.send(beacon(2))
    source = b.hear(beacon(2))[-1][1]
    assert source[0].startswith("fe80::")
    a.send_to(beacon(3), (host, port))
    b.hear(beacon(3))
    a.send_to(beacon(4), (host.partition("%")[0], port))  # the interface's own scope
    b.hear(beacon(4))
    a.send_to(beacon(5), (host.replace(f"%{a.carrier._index}", "%radio"), port))
    b.hear(beacon(5))


def test_copies_by_ipv6_end_after_those_without_ipv4(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    a.open()
    b.open()
    for one, other in ((a, b), (b, a)):
        one.carrier._ipv6_only_at = one.now  # as if a third without IPv4 had just been heard
        one.send(beacon(1))
        other.hear(beacon(1))
    for one, other in ((a, b), (b, a)):
        one.now += 3.0
        one.send(beacon(2))
        found = other.hear(beacon(2))
        assert [source[0] for _, source in found if ":" in source[0]] == []


def test_an_address_that_changes_needs_no_new_socket(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    a.open()
    b.open()
    a.ip("-4 addr flush dev radio", "addr add 10.70.0.9/24 dev radio")
    a.now += 2.0
    a.send(beacon(1))
    assert ("10.70.0.9", a.carrier.port) in [source for _, source in b.hear(beacon(1))]
    b.send_to(beacon(2), ("10.70.0.9", a.carrier.port))
    a.hear(beacon(2))
    b.send(beacon(3))
    a.hear(beacon(3))


def test_nothing_is_sent_and_nothing_raised_without_a_link(hosts: tuple[Host, Host]) -> None:
    a, b = hosts
    a.open()
    b.open()
    a.ip("link set radio down")
    a.send(stop("s"))
    a.send_to(stop("s"), (b.address, b.carrier.port))
    assert a.carrier.unsent >= 2
    a.ip("link set radio up")
    a.do(a.carrier.rejoin)
    deadline = time.monotonic() + 30.0
    while beacon(1) not in [one[0] for one in a.do(a.carrier.receive)]:
        assert time.monotonic() < deadline, "nothing is heard after the link has returned"
        b.send(beacon(1))  # what is sent before the link has its carrier is lost
        time.sleep(0.05)
    a.ip("link del radio")
    unsent = a.carrier.unsent
    a.now += 2.0
    a.send(stop("s"))
    assert a.carrier.unsent > unsent
    a.do(a.carrier.rejoin)
    assert a.do(a.carrier.receive) == []


def test_a_solicit_reaches_a_host_by_unicast_from_an_ephemeral_port(
    hosts: tuple[Host, Host],
) -> None:
    a, b = hosts
    a.open()
    b.open()
    solicit = pack(TAG, Solicit(echo=7))
    a.send_to(solicit, (b.address, b.carrier.port))
    ((_, source),) = b.hear(solicit)
    b.send_to(beacon(1), source)
    a.hear(beacon(1))
