"""Datagrams on real sockets on loopback."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.errors import NetworkError
from swarmd.link.carriers.flood_limits import KNOWN_TIME, FloodRules
from swarmd.link.carriers.udp import UdpCarrier
from swarmd.link.datagram import ANY_SWARM, Address, Beacon, Solicit, Stop, pack, tag_of
from swarmd.link.settings import NetworkSettings
from tests.link.conftest import Until
from tests.support.processes import free_port

TAG = tag_of("dev", f"test-{secrets.token_hex(6)}")
OTHER = tag_of("dev", "another")
SEARCH = pack(ANY_SWARM, Solicit(echo=0))
"""That of an operator for any swarm: another process of this host may send it at any time."""


def beacon(number: int = 0, tag: bytes = TAG) -> bytes:
    body = Beacon(robot="r1", instance=bytes(6), sequence=number, wire=1, state=0, revision=0)
    return pack(tag, body)


def stop(name: str, tag: bytes = TAG) -> bytes:
    return pack(tag, Stop(id=name, verb="stop", operator="anna"))


@pytest.fixture
def left() -> Iterator[contextlib.ExitStack]:
    with contextlib.ExitStack() as stack:
        yield stack


class Peers:
    """Carriers of one swarm, closed at the end."""

    def __init__(self, settings: NetworkSettings, left: contextlib.ExitStack) -> None:
        self._settings, self._left = settings, left

    def open(
        self, tag: bytes = TAG, port: int = 0, is_secured: bool = False, **changes: object
    ) -> UdpCarrier:
        settings = replace(self._settings, **changes)
        made = UdpCarrier(settings, tag, port=port, is_secured=is_secured)
        self._left.callback(made.close)
        return made


@pytest.fixture
def peers(settings: NetworkSettings, left: contextlib.ExitStack) -> Peers:
    return Peers(settings, left)


def arrived(carrier: UdpCarrier, count: int = 1) -> list[tuple[bytes, Address]]:
    """What arrives until these many have, or nothing does for 10 s."""
    found: list[tuple[bytes, Address]] = []
    deadline = time.monotonic() + 10.0
    while len(found) < count and time.monotonic() < deadline:
        found += [one[:2] for one in carrier.receive() if one.payload != SEARCH]
        time.sleep(0.001)
    return found


def of(carrier: UdpCarrier) -> Address:
    return ("127.0.0.1", carrier.port)


def test_what_is_sent_reaches_all_but_the_sender(peers: Peers) -> None:
    a, b, c = peers.open(), peers.open(), peers.open()
    a.send(beacon())
    for one in (b, c):
        assert arrived(one) == [(beacon(), of(a))]
    b.send(beacon(1))
    assert arrived(a) == [(beacon(1), of(b))]
    assert a.unsent == 0


def test_a_datagram_by_unicast_reaches_one(peers: Peers) -> None:
    a, b, c = peers.open(), peers.open(), peers.open()
    a.send_to(stop("s1"), of(b))
    assert arrived(b) == [(stop("s1"), of(a))]
    a.send(beacon())
    assert arrived(c) == [(beacon(), of(a))]


def test_in_a_secured_swarm_only_confirmed_sources_get_copies(peers: Peers) -> None:
    a, stranger = peers.open(is_secured=True), peers.open()
    stranger.send_to(beacon(), of(a))
    assert arrived(a)
    assert a.recipients.unicast(boottime()) == []
    a.confirm(("127.0.0.1", 9))  # of which no beacon came
    assert a.recipients.unicast(boottime()) == []
    a.confirm(of(stranger))
    assert a.recipients.unicast(boottime()) == [of(stranger)]


def test_other_swarms_and_junk_are_dropped_by_the_kernel(peers: Peers) -> None:
    a, other = peers.open(), peers.open(OTHER)
    long = beacon() + bytes(1400)
    for payload in (b"", b"SWMD", b"junk" * 20, beacon(tag=OTHER), stop("s", ANY_SWARM), long):
        other.send_to(payload, of(a))
    other.send(beacon(tag=OTHER))
    solicit = pack(ANY_SWARM, Solicit(echo=1))
    other.send(solicit)
    other.send_to(beacon(), of(a))
    assert {payload for payload, _ in arrived(a, 2)} == {solicit, beacon()}
    assert not a.dropped


def test_without_multicast_seeds_and_those_who_answer_hear(peers: Peers) -> None:
    a = peers.open(multicast=False)
    b = peers.open(multicast=False, seeds=(f"tcp/127.0.0.1:{a.port}",))
    c = peers.open()
    b.send(beacon())
    assert arrived(a) == [(beacon(), of(b))]
    a.send(beacon(1))
    assert arrived(b) == [(beacon(1), of(a))]
    c.send(beacon(2))
    a.send_to(beacon(3), of(b))
    assert [payload for payload, _ in arrived(b)] == [beacon(3)]


def test_an_operator_asks_and_stops_a_silent_seed_without_a_pause(peers: Peers) -> None:
    a = peers.open(multicast=False)
    b = peers.open(multicast=False, seeds=(f"tcp/127.0.0.1:{a.port}",))
    said = [stop("s1"), *(pack(TAG, Solicit(echo=echo)) for echo in range(3)), stop("s2"), beacon()]
    for payload in said:
        b.send(payload)
    assert [payload for payload, _ in arrived(a, len(said))] == said


def test_only_robots_of_the_swarm_get_copies(peers: Peers) -> None:
    a, other = peers.open(), peers.open(OTHER)
    operator = peers.open()
    other.send_to(pack(ANY_SWARM, Solicit(echo=1)), of(a))
    operator.send_to(pack(TAG, Solicit(echo=1)), of(a))
    operator.send_to(stop("s"), of(a))
    assert len(arrived(a, 3)) == 3
    assert a.recipients.unicast(boottime()) == []
    operator.send_to(beacon(), of(a))
    arrived(a)
    assert a.recipients.unicast(boottime()) == [of(operator)]


def test_a_seed_may_be_a_name(peers: Peers) -> None:
    a = peers.open(multicast=False)
    b = peers.open(multicast=False, seeds=(f"tcp/localhost:{a.port}",))
    found: list[tuple[bytes, Address]] = []
    deadline = time.monotonic() + 20.0
    while not found and time.monotonic() < deadline:
        b._refreshed_at = -1e9  # a look at the name's address is due
        b.send(beacon())
        found += [one[:2] for one in a.receive()]
        time.sleep(0.01)
    assert found[0] == (beacon(), of(b))


def test_a_datagram_tells_for_how_long_it_waited_here(peers: Peers) -> None:
    a, b = peers.open(), peers.open()
    b.receive()
    a.send_to(stop("waits"), of(b))
    began = time.monotonic()
    time.sleep(0.4)  # the process of b does not read
    # A search for any swarm, of another process of this host, may arrive beside it.
    found = [one for one in b.receive() if one.source == of(a)]
    assert [one.payload for one in found] == [stop("waits")]
    assert 0.3 < found[0].waited <= time.monotonic() - began + 0.1
    began = time.monotonic()
    a.send_to(stop("waits not"), of(b))
    (last,) = (one for one in b.receive() if one.source == of(a))
    assert last.waited <= time.monotonic() - began + 0.1


def test_a_copy_by_another_way_is_dropped_and_a_repeat_by_the_same_is_not(peers: Peers) -> None:
    a, b = peers.open(), peers.open()
    for _ in range(2):
        a.send(stop("s"))
        a.send_to(stop("s"), of(b))
    a.send_to(beacon(), of(b))
    found = [payload for payload, _ in arrived(b, 3)]
    while beacon() not in found:
        found += [payload for payload, _ in arrived(b)]
    assert found.count(stop("s")) == 2


@pytest.mark.parametrize(
    "address",
    [
        ("240.0.0.1", 7440),
        ("::1", 7440),
        ("fe80::1%2", 7440),
        ("a.name", 7440),
        ("127.0.0.1", 0),
        ("127.0.0.1", 70000),
        ("127.0.0.1%2", 7440),
        ("", 7440),
        ("a\0b", 1),
    ],
)
def test_what_cannot_be_sent_is_counted(peers: Peers, address: Address) -> None:
    a = peers.open()
    a.send_to(beacon(), address)
    assert a.unsent == 1


def test_a_full_queue_is_no_error(peers: Peers) -> None:
    a, b = peers.open(), peers.open()
    for number in range(20_000):
        a.send_to(beacon(number), of(b))
    assert arrived(b)


def test_the_port_is_the_one_that_was_given(peers: Peers) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        port = free_port()
        probe.bind(("127.0.0.1", port))
        with pytest.raises(NetworkError, match=f"udp port {port} is in use"):
            peers.open(port=port)
    assert peers.open(port=port).port == port


def test_an_interface_that_is_not_there_is_named(peers: Peers) -> None:
    with pytest.raises(NetworkError, match=r"'wlan7'.*there are: .*lo"):
        peers.open(profile="field", interface="wlan7")


def test_the_loop_is_told_of_each_datagram_until_the_carrier_is_closed(
    peers: Peers, until: Until
) -> None:
    a, b = peers.open(), peers.open()
    found: list[tuple[bytes, Address, float]] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        b.attach(loop, lambda *one: found.append(one) if one[0] != SEARCH else None)
        for number in range(300):
            a.send(beacon(number))
        await until(lambda: len(found) == 300)
        b.close()
        a.send(beacon())
        await asyncio.sleep(0)

    asyncio.run(main())
    assert [payload for payload, _, _ in found] == [beacon(number) for number in range(300)]


def test_a_thread_tells_of_each_datagram_until_the_carrier_is_closed(peers: Peers) -> None:
    a, b = peers.open(), peers.open()
    found: list[tuple[bytes, Address, float]] = []
    b.start_thread(lambda *one: found.append(one) if one[0] != SEARCH else None)
    for number in range(300):
        a.send(beacon(number))
    deadline = time.monotonic() + 20.0
    while len(found) < 300 and time.monotonic() < deadline:
        time.sleep(0.001)
    assert [payload for payload, _, _ in found] == [beacon(number) for number in range(300)]
    b.close()
    b.close()


def test_rejoining_is_harmless(peers: Peers) -> None:
    a, b = peers.open(), peers.open()
    b.rejoin()
    a.send(beacon())
    assert arrived(b) == [(beacon(), of(a))]


# Floods


def test_the_kernel_drops_by_the_rules(peers: Peers) -> None:
    a, loud, quiet = peers.open(), peers.open(), peers.open()
    for rules, passing in (
        (FloodRules(blocked=(of(loud), ("fe80::1%2", 7440))), {"quiet"}),
        (FloodRules(only_known=True, known=(of(loud),)), {"loud"}),
        (FloodRules(only_known=True), set()),
        (FloodRules(), {"loud", "quiet"}),
    ):
        a._rules = rules
        for sock, _ in a._listeners:
            a._attach_filter(sock)
        a._rules = a._limits.rules(0.0)
        for number, one in enumerate((loud, quiet)):
            one.send_to(beacon(number), of(a))
            one.send(stop(f"s{number}"))
        found = arrived(a, 2 + len(passing))
        assert {stop("s0"), stop("s1")} <= {payload for payload, _ in found}
        beacons = {
            name
            for number, name in enumerate(("loud", "quiet"))
            if beacon(number) in {payload for payload, _ in found}
        }
        assert beacons == passing


def test_the_kernel_thins_stops_of_one_source_or_of_all(peers: Peers) -> None:
    a, loud, quiet = peers.open(), peers.open(), peers.open()
    for rules, is_all in (
        (FloodRules(thinned=((of(loud), 0.25),)), False),
        (FloodRules(share=0.25), True),
        (FloodRules(share=0.25, known=(of(quiet),)), False),
    ):
        a._rules = rules
        for sock, _ in a._listeners:
            a._attach_filter(sock)
        a._rules = a._limits.rules(0.0)
        for number in range(200):
            loud.send_to(stop(f"loud{number}"), of(a))
            quiet.send_to(stop(f"quiet{number}"), of(a))
        last = beacon(1)
        quiet.send_to(last, of(a))
        found: list[bytes] = []
        while last not in found:
            found += [payload for payload, _ in arrived(a)]
        from_loud = sum(b"loud" in payload for payload in found)
        from_quiet = sum(b"quiet" in payload for payload in found)
        assert 10 <= from_loud <= 100
        assert (from_quiet <= 100) is is_all


FLOODS = {
    "of another swarm": (stop("x", OTHER), 1),
    "of beacons": (beacon(7), 1),
    "of beacons from 500 sources": (beacon(7), 500),
    "of stops from 500 sources": (stop("x"), 500),
    "of solicits of any swarm": (pack(ANY_SWARM, Solicit(echo=1)), 1),
}


@pytest.mark.integration
@pytest.mark.timeout(400)
@pytest.mark.parametrize("kind", ["of beacons", "of stops"])
def test_a_reader_with_little_time_hears_a_robot_in_a_flood(peers: Peers, kind: str) -> None:
    payload, sources = FLOODS[f"{kind} from 500 sources"]
    a, b = peers.open(), peers.open()
    found: list[bytes] = []

    def read(said: bytes) -> None:
        """One turn, 20 times a second: 1,280 datagrams at most, below the budget of strangers."""
        b.send(said)
        found.extend(one.payload for one in a.receive() if one.source == of(b))
        time.sleep(0.05)

    def become_known() -> None:
        """Without a flood, whose block lasts for up to 60 s: until it is heard for some seconds."""
        since = began = time.monotonic()
        while (now := time.monotonic()) - since < KNOWN_TIME + 2.0 and now - began < 90.0:
            count = len(found)
            read(beacon(7))
            if len(found) == count:
                since = now

    become_known()
    words = [payload.hex(), str(a.port), str(sources), "12000", "390"]
    with subprocess.Popen(
        [sys.executable, "-m", "tests.support.flood", *words], cwd=Path(__file__).parents[2]
    ) as flood:
        try:
            deadline = time.monotonic() + 40.0
            while f"flood:{kind[3:-1]}" not in a.dropped and time.monotonic() < deadline:
                read(beacon(100))
            assert f"flood:{kind[3:-1]}" in a.dropped
            said: list[bytes] = []
            hears = False
            deadline = time.monotonic() + 240.0
            while not hears and time.monotonic() < deadline:
                said.append(stop(f"real{len(said)}"))
                read(said[-1])
                if len(said) % 100 == 0:  # a busy machine has forgotten it
                    flood.send_signal(signal.SIGSTOP)
                    become_known()
                    flood.send_signal(signal.SIGCONT)
                hears = len(said) > 20 and all(stop in found for stop in said[-20:-5])
            assert hears
            assert flood.poll() is None
        finally:
            flood.kill()


@pytest.mark.integration
@pytest.mark.parametrize("name", FLOODS)
def test_beacons_and_a_stop_arrive_in_a_flood(peers: Peers, name: str) -> None:
    payload, sources = FLOODS[name]
    a, b = peers.open(), peers.open()
    found: list[bytes] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        a.attach(loop, lambda payload, source, _: found.append(payload) if source == of(b) else 0)

        async def become_known() -> None:
            for number in range(35 if sources > 1 else 5):  # it is known after a while
                b.send(beacon(number))
                await asyncio.sleep(0.1)
            found.clear()

        await become_known()
        words = [payload.hex(), str(a.port), str(sources), "50000", "60"]
        with subprocess.Popen(
            [sys.executable, "-m", "tests.support.flood", *words],
            cwd=Path(__file__).parents[2],
            stdout=subprocess.PIPE,
        ) as flood:
            try:
                assert flood.stdout is not None
                await asyncio.to_thread(flood.stdout.readline)
                for window in range(20):
                    cpu, began = time.process_time(), loop.time()
                    said = [beacon(1000 + 100 * window + number) for number in range(20)]
                    said.insert(10, stop(f"real{window}"))
                    for one in said:
                        b.send(one)
                        await asyncio.sleep(0.1)
                    passed = loop.time() - began
                    cpu = 100 * (time.process_time() - cpu) / passed
                    heard = sum(one in found for one in said)
                    print(
                        f"flood {name}: {heard}/21 heard; late by {1e3 * (passed / 21 - 0.1):.1f}"
                        f" ms a turn; CPU {cpu:.1f} %; {dict(a.dropped)}"
                    )
                    if heard == len(said):
                        break
                    # A reader that stood still has forgotten it, and learns no name in a flood.
                    flood.send_signal(signal.SIGSTOP)
                    await become_known()
                    flood.send_signal(signal.SIGCONT)
            finally:
                flood.kill()
        assert heard == len(said)

    asyncio.run(main())
