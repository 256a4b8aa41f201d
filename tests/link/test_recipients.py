"""Whom a datagram for all is copied to by unicast."""

from __future__ import annotations

from swarmd.link.carriers.recipients import MAX_ADDRESSES, MENTION_TIME, Recipients

LEASE = 3.0
A, B = ("10.0.0.1", 7440), ("10.0.0.2", 7440)


def test_a_peer_that_is_heard_by_the_group_gets_no_copies_until_it_is_not() -> None:
    recipients = Recipients(LEASE)
    recipients.on_heard(A, True, 0.0)
    assert recipients.unicast(0.1) == []
    recipients.on_heard(A, False, 7.0)
    assert recipients.unicast(7.1) == [A]
    recipients.on_heard(A, True, 7.2)
    assert recipients.unicast(7.3) == []


def test_a_peer_that_is_heard_by_unicast_gets_each_datagram_until_it_falls_silent() -> None:
    recipients = Recipients(LEASE)
    recipients.on_heard(A, False, 0.0)
    assert [recipients.unicast(t) for t in (0.1, 0.2, 5.9, 6.1)] == [[A], [A], [A], []]


def test_without_a_group_everybody_gets_copies() -> None:
    recipients = Recipients(LEASE, with_group=False)
    recipients.on_heard(A, True, 0.0)
    recipients.on_heard(B, False, 0.0)
    assert recipients.unicast(0.1) == [A, B]


def test_a_seed_that_does_not_answer_gets_all_but_messages_for_ever() -> None:
    recipients = Recipients(LEASE)
    recipients.set_seeds([A])
    recipients.on_heard(B, False, 0.0)
    assert recipients.unicast(0.0) == [A, B]
    assert recipients.unicast(0.0, is_message=True) == [B]
    assert recipients.unicast(1e6) == [A]


def test_a_seed_that_answers_by_the_group_gets_no_copies() -> None:
    recipients = Recipients(LEASE)
    recipients.set_seeds([A])
    recipients.on_heard(A, True, 0.0)
    assert recipients.unicast(0.1) == []
    assert recipients.unicast(2 * LEASE + 0.1) == [A]


def test_a_word_of_an_address_counts_for_a_while() -> None:
    recipients = Recipients(LEASE)
    recipients.on_mentioned(A, 0.0)
    assert recipients.unicast(0.1) == [A]
    assert recipients.unicast(MENTION_TIME + 0.2) == []


def test_a_flood_of_addresses_is_bounded_and_takes_no_place_of_those_that_are_known() -> None:
    recipients = Recipients(LEASE)
    recipients.set_seeds([A])
    recipients.on_heard(B, False, 0.0)
    for number in range(3 * MAX_ADDRESSES):
        recipients.on_heard((f"10.1.{number // 256}.{number % 256}", 7440), False, 0.0)
        recipients.on_mentioned((f"10.2.{number // 256}.{number % 256}", 7440), 0.0)
    chosen = recipients.unicast(0.1)
    assert len(chosen) == MAX_ADDRESSES
    assert {A, B} <= set(chosen)
    later = MENTION_TIME + 1.0  # there is room again
    recipients.on_heard(("10.3.0.1", 7440), False, later)
    assert recipients.unicast(later) == [A, ("10.3.0.1", 7440)]
