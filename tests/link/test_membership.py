"""The bounds of a membership: a flood of names must not push living robots out."""

from __future__ import annotations

from msgspec.structs import replace

from swarmd.core.messages import Body, Presence
from swarmd.link.datagram import (
    MAX_HOPS,
    MAX_MS,
    TAG_BYTES,
    Beacon,
    BodyReport,
    Flag,
    MemberList,
    MemberReport,
    pack,
    unpack,
)
from swarmd.link.members.membership import MAX_MEMBERS, STRANGER_KEPT, Membership

ADDRESS = ("10.0.0.1", 7440)
LEASE = 3.0
TAG = bytes(TAG_BYTES)


def beacon(robot: str, sequence: int = 1, instance: bytes = b"abcdef", flags: int = 0) -> Beacon:
    return Beacon(
        robot=robot,
        instance=instance,
        sequence=sequence,
        wire=1,
        state=0,
        revision=0,
        flags=flags,
    )


def word(*members: MemberReport, robot: str = "r2") -> MemberList:
    return MemberList(robot=robot, instance=b"123456", members=members)


def heard(robot: str, age: int = 0, hops: int = 0) -> MemberReport:
    return MemberReport(robot=robot, instance=b"abcdef", presence=0, age=age, hops=hops)


def test_living_members_beyond_the_bound_are_ignored_and_counted() -> None:
    membership = Membership("me", LEASE)
    for number in range(MAX_MEMBERS + 5):
        membership.on_beacon(beacon(f"r{number}"), ADDRESS, 0.0)
    assert len(membership.members(0.0)) == MAX_MEMBERS
    assert membership.ignored == 5


def test_a_new_robot_replaces_the_one_that_is_gone_the_longest() -> None:
    membership = Membership("me", LEASE)
    for number in range(MAX_MEMBERS):
        membership.on_beacon(beacon(f"r{number}"), ADDRESS, float(number == 7))
    membership.advance(LEASE + 0.5)  # all but r7 have failed
    assert membership.on_beacon(beacon("new"), ADDRESS, 3.6)
    members = membership.members(3.6)
    assert len(members) == MAX_MEMBERS
    assert {"r7", "new"} <= members.keys()


def test_strangers_that_were_heard_briefly_are_dropped_and_members_stay() -> None:
    membership = Membership("me", LEASE)
    membership.on_beacon(beacon("ghost"), ADDRESS, 0.0)
    for second in range(20):
        membership.on_beacon(beacon("friend", second), ADDRESS, float(second))
    membership.advance(30.0)
    assert set(membership.members(30.0)) == {"friend", "ghost"}
    membership.advance(30.0 + STRANGER_KEPT + 1.0)
    members = membership.members(200.0)
    assert {name: member.presence for name, member in members.items()} == {
        "friend": Presence.FAILED
    }


def test_beacons_that_are_late_repeated_joining_or_own_change_nothing() -> None:
    membership = Membership("me", LEASE)
    membership.on_beacon(beacon("r1", 5), ADDRESS, 0.0)
    membership.on_beacon(beacon("r1", 6, flags=Flag.LEFT), ADDRESS, 0.1)
    assert not membership.on_beacon(beacon("r1", 5), ADDRESS, 0.2)
    assert not membership.on_beacon(beacon("r2", 1, flags=Flag.JOINING), ADDRESS, 0.2)
    assert not membership.on_beacon(beacon("r3", 1, flags=Flag.LEFT), ADDRESS, 0.2)
    assert not membership.on_beacon(beacon("me"), ADDRESS, 0.2)
    members = membership.members(0.2)
    assert {name: one.presence for name, one in members.items()} == {"r1": Presence.LEFT}


def test_forgotten_robots_return_when_they_are_heard() -> None:
    membership = Membership("me", LEASE)
    membership.on_beacon(beacon("r1"), ADDRESS, 0.0)
    assert not membership.forget("r1"), "it is alive"
    membership.advance(5.0)
    assert membership.forget("r1")
    assert membership.members(5.0) == {}
    assert membership.on_beacon(beacon("r1", 2), ADDRESS, 6.0)


def test_hearsay_is_bounded_in_number_distance_and_time() -> None:
    membership = Membership("me", LEASE)
    membership.on_beacon(beacon("r2"), ADDRESS, 0.0)
    membership.on_member_list(word(heard("me"), heard("r2"), heard("far", hops=MAX_HOPS)), 0.0)
    assert not membership.indirect
    membership.on_member_list(word(heard("r3", age=400)), 0.0)
    membership.on_member_list(word(heard("r3", age=900), robot="r5"), 0.0)
    assert membership.indirect["r3"].by == "r2"
    told = {one.robot: one for one in membership.reports(1.0)}
    assert (told["r3"].age, told["r3"].hops) == (1400, 1)
    for number in range(MAX_MEMBERS + 5):
        membership.on_member_list(word(heard(f"x{number}")), 0.0)
    assert len(membership.indirect) == MAX_MEMBERS
    membership.advance(STRANGER_KEPT + 1.0)
    assert not membership.indirect


def test_hearsay_with_the_greatest_age_can_be_handed_on() -> None:
    """A list with an age beyond its bound would be dropped whole by all others."""
    membership = Membership("me", LEASE)
    membership.on_member_list(word(heard("r3", age=MAX_MS)), 0.0)
    told = word(*membership.reports(1.0), robot="me")
    assert unpack(TAG, pack(TAG, told)) == told


def test_a_robot_that_is_heard_is_no_hearsay_and_is_probed_before_it_fails() -> None:
    membership = Membership("me", LEASE)
    membership.on_member_list(word(heard("r3")), 0.0)
    membership.on_beacon(beacon("r3"), ADDRESS, 1.0)
    assert not membership.indirect
    assert membership.to_probe(2.0) == []
    assert membership.to_probe(2.6) == [ADDRESS]
    assert membership.to_probe(2.7) == []
    assert membership.to_probe(2.9) == [ADDRESS]
    membership.advance(4.5)
    assert membership.to_probe(4.6) == []


def test_a_forged_number_or_farewell_hides_a_robot_for_a_moment_only() -> None:
    membership = Membership("me", LEASE)
    for forged in (beacon("r1", 2**53), beacon("r1", 2**53, flags=Flag.LEFT)):
        membership.on_beacon(beacon("r1", 1), ADDRESS, 0.0)
        membership.on_beacon(forged, ADDRESS, 0.5)
        for second in range(1, 5):
            membership.on_beacon(beacon("r1", 1 + second), ADDRESS, float(second))
            membership.advance(float(second))
        assert membership.members(4.0)["r1"].presence is Presence.ALIVE


def test_a_robot_that_was_heard_for_long_keeps_its_place_beside_new_ones() -> None:
    membership = Membership("me", LEASE)
    for second in range(20):
        membership.on_beacon(beacon("friend", second), ADDRESS, float(second))
    membership.advance(30.0)  # it has failed, as while it boots again
    for number in range(MAX_MEMBERS + 50):
        membership.on_beacon(beacon(f"ghost-{number}"), ADDRESS, 31.0)
    assert membership.members(31.0)["friend"].presence is Presence.FAILED


def test_only_addresses_are_taken_from_the_lists_of_others() -> None:
    membership = Membership("me", LEASE)
    hosts = {"r1": "10.0.0.9", "r2": "fe80::1%3", "r3": "a b/c#?", "r4": "example.org"}
    for robot, host in hosts.items():
        membership.on_member_list(word(replace(heard(robot), host=host, port=22)), 0.0)
    known = {robot: membership.indirect_address(robot) for robot in hosts}
    assert known == {
        "r1": ("10.0.0.9", 22),
        "r2": ("fe80::1%3", 22),
        "r3": ("", 0),
        "r4": ("", 0),
    }


def test_an_instance_without_a_body_does_not_take_back_what_another_told() -> None:
    """As a forged beacon would, or a robot that restarts with an older version."""
    body = Body(platform="burger", surface_speed=0.3, radius=0.136)
    membership = Membership("me", LEASE)
    told = replace(beacon("r1"), body=BodyReport.of(body))
    membership.on_beacon(told, ADDRESS, 0.0)
    for number in range(10):
        membership.on_beacon(beacon("r1", instance=bytes([number]) * 6), ADDRESS, 0.1)
        membership.on_beacon(beacon("r1", 2 + number), ADDRESS, 0.1)
        assert membership.bodies() == {"r1": body}
    other = replace(body, surface_speed=0.5)
    latest = replace(beacon("r1", instance=b"latest"), body=BodyReport.of(other))
    membership.on_beacon(latest, ADDRESS, 0.2)
    membership.on_beacon(replace(told, sequence=50), ADDRESS, 0.3)
    assert membership.bodies() == {"r1": other}


def test_the_body_of_a_member_stays_known_until_it_is_forgotten() -> None:
    body = Body(platform="burger", surface_speed=0.3, radius=0.136)
    membership = Membership("me", LEASE)
    told = replace(beacon("r1"), body=BodyReport.of(body))
    for second in range(12):
        membership.on_beacon(replace(told, sequence=second), ADDRESS, float(second))
    membership.on_beacon(beacon("old"), ADDRESS, 11.0)
    assert membership.bodies() == {"r1": body, "old": None}
    membership.on_beacon(replace(told, sequence=12, flags=Flag.LEFT), ADDRESS, 12.0)
    membership.advance(1000.0)
    membership.advance(2000.0)  # one that was heard for a moment only is dropped
    assert membership.bodies() == {"r1": body}
    assert membership.forget("r1")
    assert membership.bodies() == {}
