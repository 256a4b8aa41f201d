"""The switch of the other tests really does to frames what they ask of it."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from tests.support.field import Field

pytestmark = pytest.mark.integration

PORT = 7000
COUNT = 200  # small ones that the buffer of a socket holds
GROUP = "224.0.0.199"
PATIENCE = 20.0  # s for what has to arrive


@dataclass(frozen=True)
class Pair:
    """Two hosts, each with a socket."""

    field: Field
    a: socket.socket
    b: socket.socket

    def send(self, count: int = COUNT, *, least: int | None = None) -> list[int]:
        """The numbers that reach b of those that a sends, in the order of their arrival.

        `least`: how many of them arrive at least, all without it.
        """
        for number in range(count):
            self.a.sendto(str(number).encode(), (self.field.address("b"), PORT))
        return self.heard(self.b, count if least is None else least)

    def heard(self, by: socket.socket, least: int) -> list[int]:
        """The numbers that arrive until as many have, and then nothing for half a second."""
        found: list[int] = []
        with contextlib.suppress(TimeoutError):
            while True:
                by.settimeout(PATIENCE if len(found) < least else 0.5)
                found.append(int(by.recv(100)))
        return found


@pytest.fixture(scope="module")
def field(namespaces_permitted: None) -> Iterator[Field]:
    with contextlib.closing(Field(("a", "b", "c"))) as made:
        yield made


@pytest.fixture
def pair(field: Field) -> Iterator[Pair]:
    """Both know each other's link address already, and no rule holds."""
    field.clear()
    with field.socket("a", PORT) as a, field.socket("b", PORT) as b:
        made = Pair(field, a, b)
        for one, other in ((a, "b"), (b, "a")):
            one.settimeout(PATIENCE)
            one.sendto(b"0", (field.address(other), PORT))
        assert (a.recv(100), b.recv(100)) == (b"0", b"0")
        b.settimeout(0.5)
        yield made


def test_a_frame_arrives_at_once_and_once_without_rules(pair: Pair) -> None:
    assert pair.send() == list(range(COUNT))


def test_a_delay_holds_for_its_direction(pair: Pair) -> None:
    pair.field.set(source="a", target="b", delay=1.0)
    began = time.monotonic()
    pair.a.sendto(b"1", (pair.field.address("b"), PORT))
    pair.b.sendto(b"2", (pair.field.address("a"), PORT))
    assert pair.a.recv(100) == b"2"
    with pytest.raises(TimeoutError):
        pair.b.recv(100)
    pair.b.settimeout(10.0)
    assert pair.b.recv(100) == b"1"
    assert time.monotonic() - began >= 1.0


def test_loss_takes_its_share(pair: Pair) -> None:
    pair.field.set(source="a", target="b", loss=0.5)
    heard = pair.send(least=int(0.35 * COUNT) + 1)
    assert heard == sorted(set(heard))
    assert 0.35 * COUNT < len(heard) < 0.65 * COUNT


def test_duplicates_arrive_twice(pair: Pair) -> None:
    pair.field.set(duplicate=1.0)
    assert pair.send(50, least=100) == [number for number in range(50) for _ in range(2)]


@pytest.mark.parametrize("rule", [{"reorder": 0.2}, {"delay": 0.05, "jitter": 0.04}])
def test_reordering_and_jitter_change_the_order_and_lose_nothing(
    pair: Pair, rule: dict[str, Any]
) -> None:
    pair.field.set(**rule)
    heard = pair.send()
    assert sorted(heard) == list(range(COUNT))
    assert heard != sorted(heard)


def test_a_cut_holds_for_its_direction_until_it_is_healed(pair: Pair) -> None:
    pair.field.set(source="a", target="b", is_cut=True)
    assert pair.send(5, least=0) == []
    pair.b.sendto(b"7", (pair.field.address("a"), PORT))
    assert pair.heard(pair.a, 1) == [7]
    pair.field.heal()
    assert pair.send(5) == list(range(5))


def test_a_cut_takes_what_is_under_way(pair: Pair) -> None:
    pair.field.set(delay=1.0)
    pair.a.sendto(b"1", (pair.field.address("b"), PORT))
    pair.field.split("a")
    pair.b.settimeout(1.5)
    with pytest.raises(TimeoutError):
        pair.b.recv(100)


def test_traffic_is_counted_by_sender_and_apart_for_groups(pair: Pair) -> None:
    pair.field.traffic()
    pair.send(10)
    pair.a.setsockopt(
        socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(pair.field.address("a"))
    )
    for _ in range(3):
        pair.a.sendto(b"x" * 100, (GROUP, PORT))
    pair.send(1)  # after these are counted
    sent = pair.field.traffic()
    assert sent["a"].unicast_frames >= 11
    assert sent["a"].group_frames >= 3
    assert sent["a"].group_bytes >= 3 * (14 + 20 + 8 + 100)
    assert sent["b"].unicast_frames < 11
