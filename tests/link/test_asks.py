"""Whom a robot asks for what beacons show, and how often."""

from __future__ import annotations

from swarmd.link.spread.asks import MAX_KNOWN, Asks


def test_a_peer_is_asked_once_a_period_and_a_group_only_so_often() -> None:
    asks = Asks(15.0, at_once=2, window=5.0)
    assert asks.take("a", 0.0, "hosts")
    assert not asks.take("a", 14.9, "hosts")
    assert asks.take("a", 15.0, "hosts")
    assert asks.take("b", 15.0, "hosts")
    assert not asks.take("c", 15.0, "hosts")
    assert asks.take("c", 15.0), "of no group"
    assert asks.take("d", 20.0, "hosts")


def test_an_answer_counts_for_its_digest_until_it_is_forgotten() -> None:
    asks = Asks(1.0)
    asks.answered("a", b"one")
    assert asks.knows("a", b"one")
    assert not asks.knows("a", b"two")
    asks.forget("a")
    assert not asks.knows("a", b"one")


def test_strangers_push_out_the_oldest_peers_alone() -> None:
    asks = Asks(1e9)
    for number in range(MAX_KNOWN + 1):
        asks.answered(number, b"one")
        assert asks.take(number, 0.0)
    assert asks.take(0, 1.0)
    assert not asks.knows(0, b"one")
    assert not asks.take(2, 1.0)
    assert asks.knows(2, b"one")
