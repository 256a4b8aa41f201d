"""Loss by the numbers of beacons, round trips and ways, in virtual time."""

from __future__ import annotations

import pytest

from swarmd.link.members.link_quality import (
    MAX_LINKS,
    ROUND_TRIP_KEPT,
    WINDOW,
    LinkQualities,
    LinkQuality,
    WaysHeard,
)
from tests.link.virtual_network import VirtualNetwork

ONE, TWO = bytes(6), bytes(5) + b"x"


def heard(numbers: list[int], now: float = 0.0) -> LinkQualities:
    links = LinkQualities(1.0)
    for number in numbers:
        links.on_beacon("r2", ONE, number, now)
    return links


@pytest.mark.parametrize(
    ("numbers", "received", "lost"),
    [
        ([7, 8, 9], 3, 0),
        ([1, 2, 5], 3, 2),
        ([1, 5, 3], 3, 2),
        ([1, 2, 2, 2], 2, 0),
        ([4, 0, 0], 1, 0),
        ([5, 3], 1, 0),
        (list(range(1, 200)), WINDOW, 0),
        (list(range(1, 200, 2)), WINDOW // 2, WINDOW // 2),
        ([1, 2, 3, 900], 1, WINDOW - 1),
    ],
)
def test_gaps_in_the_numbers_are_losses(numbers: list[int], received: int, lost: int) -> None:
    found = heard(numbers).quality("r2", 0.0)
    assert found == LinkQuality(received, lost, 0.0)


def test_a_beacon_that_is_overdue_is_lost() -> None:
    links = heard([1, 2, 3, 4])
    lost = [quality.lost for t in (1.4, 1.6, 9.7) if (quality := links.quality("r2", t))]
    assert lost == [0, 1, 9]
    silent = links.quality("r2", 1e6)
    assert silent is not None
    assert (silent.received, silent.loss) == (0, 1.0)


def test_another_instance_begins_anew() -> None:
    links = heard([1, 9])
    links.on_beacon("r2", TWO, 1, 0.0)
    assert links.quality("r2", 0.0) == LinkQuality(1, 0, 0.0)
    links.forget("r2")
    assert links.quality("r2", 0.0) is None


def test_a_round_trip_is_given_for_a_while() -> None:
    links = heard([1])
    links.on_round_trip("r2", 0.004, 10.0)
    links.on_round_trip("stranger", 0.1, 10.0)
    found = [links.quality("r2", 10.0 + age) for age in (0.0, ROUND_TRIP_KEPT + 1.0)]
    assert [one.round_trip for one in found if one] == [0.004, None]
    assert links.quality("stranger", 10.0) is None


def test_tables_are_bounded_and_keep_the_latest() -> None:
    links, ways = LinkQualities(1.0), WaysHeard(2.0)
    for n in range(MAX_LINKS + 5):
        links.on_beacon(f"r{n}", ONE, 1, float(n))
        ways.on_heard((f"10.0.0.{n}", 1), "multicast", float(n))
    now = float(MAX_LINKS + 5)
    known = [n for n in range(MAX_LINKS + 5) if links.quality(f"r{n}", now) is not None]
    assert known == list(range(5, MAX_LINKS + 5))
    assert ways.of((f"10.0.0.{MAX_LINKS + 4}", 1), now) == ("multicast",)


def test_ways_end_with_the_lease() -> None:
    ways = WaysHeard(2.0)
    ways.on_heard(("10.0.0.2", 1), "multicast", 0.0)
    ways.on_heard(("10.0.0.2", 1), "unicast", 1.5)
    assert ways.of(("10.0.0.2", 1), 2.0) == ("multicast", "unicast")
    assert ways.of(("10.0.0.2", 1), 3.0) == ("unicast",)
    assert ways.of(("10.0.0.3", 1), 3.0) == ()


def test_robots_count_what_the_network_loses_and_answers_are_no_losses() -> None:
    network = VirtualNetwork(4)
    network.run(WINDOW + 2.0)
    links = network.robots["r1"].peer.links
    before = [links.quality(name, network.now) for name in ("r2", "r3", "r4")]
    assert all(one is not None and one.lost == 0 for one in before)
    network.loss = 0.3
    network.run(WINDOW + 2.0)
    after = [links.quality(name, network.now) for name in ("r2", "r3", "r4")]
    assert 0.15 < sum(one.loss for one in after if one is not None) / 3 < 0.45


def test_a_ping_measures_the_round_trip() -> None:
    network = VirtualNetwork(3)
    network.delay = 0.02
    peer = network.robots["r1"].peer
    for query, address in peer.pings(("r2", "r3"), network.now):
        network._send("r1", network.robots["r1"].address, query, address)
    network.run(0.1)
    for name in ("r2", "r3"):
        found = peer.links.quality(name, network.now)
        assert found is not None
        assert found.round_trip is not None
        assert 0.04 <= found.round_trip <= 0.15  # datagrams arrive with ticks
    peer.pings(("r2",), network.now)
    trips = [peer.links.quality(name, network.now) for name in ("r2", "r3")]
    assert [one is not None and one.round_trip is None for one in trips] == [True, False]
