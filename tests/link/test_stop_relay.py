"""Bounds of the relay of stops: what a stranger can make a robot send, or keep it from sending."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from swarmd.core.messages import Code
from swarmd.link.datagram import MAX_MS, Ack, Address, Stop
from swarmd.link.stops.stop_freshness import REPLAYED
from swarmd.link.stops.stop_relay import (
    ACK_PERIOD,
    ACKS_AT_ONCE,
    DIRECT_TIMEOUT,
    LAST_INTERVAL,
    LIFETIME,
    MAX_ACKS,
    MAX_SOURCES,
    REDUNDANCY,
    TRUSTLESS_TIME,
    StopRelay,
)

OPERATOR, PEER, STRANGER = ("10.0.0.9", 1), ("10.0.0.2", 7440), ("10.0.0.66", 1)


def stop(**changes: object) -> Stop:
    fields = {"id": "s", "verb": "stop", "operator": "anna", "targets": ("r2",)} | changes
    return Stop(**fields)  # type: ignore[arg-type]


def ack(robot: str, *, is_moving: bool = False) -> Ack:
    one = Ack(id="s", robot=robot, instance=b"abcdef", revision=1, code=Code.APPLIED)
    return replace(one, is_moving=is_moving)


def refusal(robot: str, *, via: str = "") -> Ack:
    return replace(ack(robot), code=Code.REFUSED, refusal=REPLAYED, via=via)


def copies(relay: StopRelay, seconds: float, began: float = 0.0) -> list[Stop]:
    found: list[Stop] = []
    for tick in range(1, round(seconds / 0.05) + 1):
        found += relay.advance(began + tick * 0.05)
    return found


def test_a_repeat_returns_few_acks_of_others_and_in_the_end_all() -> None:
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(targets=None), OPERATOR, 0.0)
    for number in range(2 * MAX_ACKS):
        relay.on_ack(ack(f"x{number}"), PEER)
    handed: set[str] = set()
    for repeat in range(1, 40):
        sends = relay.on_stop(stop(targets=None), OPERATOR, repeat * 0.1)
        assert len(sends) <= ACKS_AT_ONCE
        handed |= {body.robot for body, _ in sends if isinstance(body, Ack)}
    assert len(handed) == MAX_ACKS
    assert relay.on_stop(stop(targets=None), OPERATOR, 3.9 + ACK_PERIOD / 2) == []


@pytest.mark.parametrize(
    ("late", "is_handed_on"),
    [
        (ack("x0"), True),
        (ack("x0", is_moving=True), False),
        (refusal("x0"), True),
        (refusal("y"), True),
        (refusal("y", via="x0"), True),
        (ack("y"), False),
        (ack("y", is_moving=True), False),
    ],
)
def test_a_full_table_of_acks_excludes_only_robots_without_a_kept_ack(
    late: Ack, is_handed_on: bool
) -> None:
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(targets=None), OPERATOR, 0.0)
    for number in range(MAX_ACKS):
        relay.on_ack(ack(f"x{number}", is_moving=True), PEER)
    expected = [(replace(late, via="r1"), OPERATOR)] if is_handed_on else []
    assert relay.on_ack(late, PEER) == expected


def test_an_operator_learns_that_each_robot_of_a_full_table_of_acks_rests() -> None:
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(), OPERATOR, 0.0)
    robots = ["r2", *(f"x{number}" for number in range(MAX_ACKS - 1))]
    for is_moving in (True, False):
        for robot in robots:
            relay.on_ack(ack(robot, is_moving=is_moving), PEER)
    repeated = [
        body
        for repeat in range(1, MAX_ACKS // ACKS_AT_ONCE + 1)
        for body, _ in relay.on_stop(stop(), OPERATOR, repeat * 0.1)
    ]
    assert repeated == [replace(ack(robot), via="r1") for robot in robots]
    copies(relay, TRUSTLESS_TIME + LAST_INTERVAL)
    assert not copies(relay, 2 * LAST_INTERVAL, began=TRUSTLESS_TIME + LAST_INTERVAL)


def test_the_ack_of_a_robot_that_rests_follows_that_of_a_robot_that_moved() -> None:
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(targets=None), OPERATOR, 0.0)
    acks = [ack("r2", is_moving=is_moving) for is_moving in (True, True, False, True, False)]
    sent = [one for number, each in enumerate(acks) for one, _ in relay.on_ack(each, PEER)]
    assert [isinstance(one, Ack) and one.is_moving for one in sent] == [True, False]
    repeated = [one for one, _ in relay.on_stop(stop(targets=None), OPERATOR, 9.0)]
    assert [isinstance(one, Ack) and one.is_moving for one in repeated] == [False]


def test_a_stop_is_handed_on_to_a_robot_that_moved_until_it_says_that_it_rests() -> None:
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(), OPERATOR, 0.0)
    relay.on_ack(ack("r2", is_moving=True), PEER)  # the copies after that are lost
    assert len(copies(relay, TRUSTLESS_TIME)) >= 12  # its base rests or it fails by then
    assert 1 <= len(copies(relay, 2 * LAST_INTERVAL, began=3.0)) <= 6
    relay.on_ack(ack("r2"), PEER)
    copies(relay, 2 * LAST_INTERVAL, began=16.0)
    assert not copies(relay, 2 * LAST_INTERVAL, began=16.0 + 2 * LAST_INTERVAL)


def test_the_refusal_of_a_replayed_stop_travels_in_no_circle() -> None:
    """Three robots that have heard the stop from each other hear the refusal of a fourth."""
    addresses = {name: (f"10.0.0.{number}", 7440) for number, name in enumerate("abc", 11)}
    relays = {name: StopRelay(name, seed=1) for name in addresses}
    for name, relay in relays.items():
        for other, address in addresses.items():
            if other != name:
                relay.on_stop(stop(targets=None, hops=1, origin=b"1234"), address, 0.0)
    under_way: list[tuple[str, Ack, Address]] = [("a", refusal("r4"), ("10.0.0.4", 7440))]
    count = 0
    while under_way:
        name, body, source = under_way.pop()
        for handed, to in relays[name].on_ack(body, source):
            count += 1
            assert count < 50
            assert isinstance(handed, Ack)
            receiver = next(key for key, one in addresses.items() if one == to)
            under_way.append((receiver, handed, addresses[name]))
    assert count >= 2


@pytest.mark.parametrize("attack", ["ack", "age", "copies"])
def test_a_stranger_does_not_keep_a_robot_from_handing_a_stop_on(attack: str) -> None:
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(), OPERATOR, 0.0)
    for _ in range(5):
        if attack == "ack":
            relay.on_ack(ack("r2"), STRANGER)
        elif attack == "age":
            relay.on_stop(stop(age=MAX_MS), STRANGER, 0.0)
        else:
            relay.on_stop(stop(hops=1), STRANGER, 0.0, is_member=False)
    sent = copies(relay, 2.0)
    assert len(sent) >= 2
    assert max(one.age for one in sent) <= 4500


@pytest.mark.parametrize("hears_operator", [0.0, 100.0])
def test_relays_end_a_minute_after_the_operator_sent_its_last_copy(hears_operator: float) -> None:
    """Three robots that hear one another feed each other; the operator repeats for a while."""
    relays = [StopRelay(f"r{number}", seed=number) for number in range(3)]
    last_sent = 0.0
    for tick in range(round((hears_operator + 5.0 * LIFETIME) / 0.05)):
        now = tick * 0.05
        if now <= hears_operator and tick % 20 == 0:
            age = round(1000.0 * now)
            relays[0].on_stop(stop(targets=None, age=age, repeated=age), OPERATOR, now)
        for index, relay in enumerate(relays):
            for sent in relay.advance(now):
                last_sent = now
                for other in {0, 1, 2} - {index}:
                    relays[other].on_stop(sent, (f"10.0.0.{index}", 7440), now + 0.01)
    assert hears_operator + LIFETIME - 2.0 * LAST_INTERVAL <= last_sent
    assert last_sent <= hears_operator + LIFETIME + 1.0


def test_a_copy_with_a_forged_age_does_not_prolong_the_relays() -> None:
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(), OPERATOR, 0.0)
    relay.on_stop(stop(age=MAX_MS, repeated=MAX_MS, hops=1), STRANGER, 1.0)
    assert copies(relay, LIFETIME + 2.0 * LAST_INTERVAL)
    assert not copies(relay, 100.0, LIFETIME + 4.0)


def test_a_stop_that_the_robot_would_refuse_is_not_handed_on() -> None:
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(age=2000), OPERATOR, 10.0)
    asked: list[tuple[str, float]] = []

    def is_over(one: Stop, issued: float) -> bool:
        asked.append((one.id, issued))
        return True

    assert [
        sent for tick in range(100) for sent in relay.advance(10.0 + tick * 0.05, is_over)
    ] == []
    assert set(asked) == {("s", 8.0)}


def test_a_late_ack_of_a_robot_that_moved_does_not_replace_that_of_its_rest() -> None:
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(targets=None), OPERATOR, 0.0)
    for is_moving in (True, False, True):
        relay.on_ack(ack("r2", is_moving=is_moving), PEER)
    repeated = [one for one, _ in relay.on_stop(stop(targets=None), OPERATOR, 9.0)]
    assert [isinstance(one, Ack) and one.is_moving for one in repeated] == [False]


@pytest.mark.parametrize(("hops", "sent"), [(3, {4}), (4, set())])
def test_a_stop_travels_at_most_four_hops_from_robot_to_robot(hops: int, sent: set[int]) -> None:
    """`MAX_HOPS` of link/datagram.py."""
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(hops=hops), PEER, 0.0)
    assert {one.hops for one in copies(relay, 5.0)} == sent


@pytest.mark.parametrize(("is_member", "is_sent"), [(False, True), (True, False)])
def test_only_copies_of_members_make_a_relay_needless(is_member: bool, is_sent: bool) -> None:
    """A stranger that repeats a stop all the time must not keep robots from handing it on."""
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(targets=None), OPERATOR, 0.0)
    sent: list[Stop] = []
    for tick in range(1, 60):
        now = 0.05 * tick
        for number in range(REDUNDANCY):
            copy = stop(targets=None, hops=1)
            relay.on_stop(copy, ("10.0.0.66", number), now, is_member=is_member)
        sent += relay.advance(now)
    assert bool(sent) is is_sent


def test_a_copy_of_a_robot_is_acked_once_the_operator_is_not_heard_directly() -> None:
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(), OPERATOR, 0.0)
    copy = stop(hops=1)
    for now, is_wanted in ((0.1, False), (DIRECT_TIMEOUT - 0.01, False), (DIRECT_TIMEOUT, True)):
        relay.on_stop(copy, PEER, now)
        assert relay.wants_ack(copy, PEER, now) is is_wanted


def test_the_operator_takes_the_place_of_the_first_of_too_many_senders() -> None:
    """Strangers that send a stop first must not keep its operator from the ack."""
    relay = StopRelay("r1", seed=1)
    senders = [("10.0.0.66", number) for number in range(MAX_SOURCES + 1)]
    copy = stop(hops=1)
    for sender in senders:
        relay.on_stop(copy, sender, 0.0)
    relay.on_stop(stop(), OPERATOR, 0.1)
    assert relay.wants_ack(stop(), OPERATOR, 0.1)
    late = 0.2 + DIRECT_TIMEOUT
    wanted = [relay.wants_ack(copy, sender, late) for sender in senders]
    assert wanted == [False, True, True, True, False]
