"""Putting the swarm together from what is heard, what others say, and what robots answer."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from swarmd.core import codec
from swarmd.core.messages import Epoch, Member, PeerView, Presence, State, StatusHeader
from swarmd.network.datagram import PRESENCES, STATES, Beacon, Flag, MemberList, MemberReport
from swarmd.network.discovery import (
    ANSWER_WAIT,
    FIRST_ROBOT_TIMEOUT,
    GONE_WAIT,
    INDIRECT_TIME,
    LOOK_CAP,
    MAX_COPIES,
    MAX_INDIRECT_DIALS,
    MAX_ROBOTS,
    MAX_ROUND_TRIP,
    QUIET_TIME,
    UNREACHABLE_WAIT,
    Discovery,
    reported_address,
)
from swarmd.network.members_view import Contact
from tests.support.fake_daemon import light_status

ALIVE, LEFT, FAILED = Presence.ALIVE, Presence.LEFT, Presence.FAILED


def life(instance: int = 1) -> bytes:
    return bytes([instance] * 6)


def beacon(robot: str, *, instance: int = 1, sequence: int = 1, **changes: Any) -> Beacon:
    fields = {"wire": codec.VERSION, "state": STATES.index(State.RUNNING), "revision": 0} | changes
    return Beacon(robot=robot, instance=life(instance), sequence=sequence, **fields)


def heard(
    robot: str, presence: Presence = ALIVE, *, instance: int = 1, age: int = 0
) -> MemberReport:
    return MemberReport(
        robot=robot,
        instance=life(instance),
        presence=PRESENCES.index(presence),
        age=age,
        host="10.0.0.9",
        port=7440,
    )


def word(
    robot: str,
    *others: MemberReport,
    part: int = 0,
    parts: int = 1,
    echo: int = 0,
    roster: Any = (),
) -> MemberList:
    return MemberList(
        robot=robot,
        instance=life(),
        members=others,
        part=part,
        parts=parts,
        echo=echo,
        roster=roster,
    )


def view(robot: str, *others: str, instance: int = 1, roster: tuple[str, ...] = ()) -> PeerView:
    members = tuple(
        Member(robot=name, instance=life().hex(), presence=ALIVE, age=9.0) for name in others
    )
    status = light_status(robot, life(instance).hex())
    return PeerView(robot=robot, status=status, members=members, roster=roster)


def address(robot: str) -> tuple[str, int]:
    return (f"10.0.0.{ord(robot[0])}", 7440)


class Rig:
    """A look that began at 0."""

    def __init__(self, *roster: str, needs_status: bool = True) -> None:
        self.found = Discovery(0.0, roster, needs_status=needs_status)

    def hear(self, *robots: str, at: float = 0.01, **changes: Any) -> None:
        for robot in robots:
            self.found.on_beacon(beacon(robot, **changes), address(robot), at)

    def tell(self, robot: str, *others: MemberReport, at: float = 0.01, **changes: Any) -> None:
        self.found.on_member_list(word(robot, *others, **changes), at)

    def answer(self, robot: str, *others: str, at: float = 0.02, **changes: Any) -> None:
        self.found.on_view(view(robot, *others, **changes), at)

    def contact(self, robot: str, now: float = 0.1) -> Contact:
        return self.found.result(now).members[robot].contact


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_nobody_is_never_complete_and_over_after_a_while(rig: Rig) -> None:
    assert not rig.found.is_complete(2.9)
    assert not rig.found.is_over(FIRST_ROBOT_TIMEOUT - 0.01)
    assert rig.found.is_over(FIRST_ROBOT_TIMEOUT)
    assert rig.found.result(3.0).members == {}


def test_one_robot_that_answered_is_complete_only_after_the_quiet_time(rig: Rig) -> None:
    rig.hear("a")
    rig.answer("a")
    assert not rig.found.is_complete(0.02 + QUIET_TIME / 2)
    assert rig.found.is_complete(0.021 + QUIET_TIME)


@pytest.mark.parametrize("do_agree", [True, False])
def test_views_that_agree_are_complete_at_once(rig: Rig, do_agree: bool) -> None:
    rig.hear("a", "b")
    rig.answer("a", "b")
    rig.answer("b", *(["a"] if do_agree else []))
    assert rig.found.is_complete(0.02) is do_agree
    assert rig.found.is_complete(0.021 + QUIET_TIME)


def test_the_quiet_time_is_two_round_trips_of_the_slowest(rig: Rig) -> None:
    rig.found.on_solicit(7, 0.0)
    rig.hear("a", at=0.4, echo=7)
    rig.hear("a", at=0.5, echo=7, sequence=2)  # a copy of the same answer
    assert rig.found.round_trip == pytest.approx(0.4)
    rig.answer("a", at=2.0)
    assert not rig.found.is_complete(2.7)
    assert rig.found.is_complete(2.81)


@pytest.mark.parametrize("source", ["beacon", "word", "view", "roster"])
def test_a_robot_that_anything_names_must_answer(source: str) -> None:
    rig = Rig(*(["b"] if source == "roster" else []))
    rig.hear("a", *(["b"] if source == "beacon" else []))
    rig.tell("a", *([heard("b")] if source == "word" else []))
    rig.answer("a", *(["b"] if source == "view" else []))
    assert not rig.found.is_complete(1.0)
    assert rig.found.result(1.0).missing == ("b",)
    rig.hear("b", at=1.0)
    rig.answer("b", "a", at=1.0)
    assert rig.found.is_complete(1.01 + QUIET_TIME)


def test_a_robot_is_heard_or_known_by_the_word_of_others(rig: Rig) -> None:
    rig.hear("a", "b")
    others = [heard("c", age=400), heard("d", FAILED, age=5000), heard("e", LEFT)]
    rig.tell("a", *others, at=0.1)
    rig.answer("a")
    members = rig.found.result(0.2).members
    assert {name: one.contact for name, one in members.items()} == {
        "a": Contact.ANSWERED,
        "b": Contact.NO_ANSWER,
        "c": Contact.UNREACHABLE,
        "d": Contact.GONE,
        "e": Contact.GONE,
    }
    assert (members["b"].state, round(members["b"].age, 3)) == ("running", 0.19)
    assert (members["c"].by, members["c"].presence) == ("a", ALIVE)
    assert members["c"].age == pytest.approx(0.5)
    assert (members["d"].presence, round(members["d"].age, 3)) == (FAILED, 5.1)
    assert rig.found.result(0.2).missing == ("b", "c", "d")  # `e` left in order


def test_an_old_word_does_not_make_a_robot_alive(rig: Rig) -> None:
    rig.hear("a")
    rig.tell("a", heard("c", age=60_000))
    member = rig.found.result(0.1).members["c"]
    assert (member.presence, round(member.age)) == (FAILED, 60)


@pytest.mark.parametrize(
    ("words", "truth"),
    [
        ((heard("x", FAILED, age=1), heard("x", ALIVE, age=9)), ALIVE),
        ((heard("x", FAILED, age=1), heard("x", LEFT, age=9)), LEFT),
        ((heard("x", FAILED, age=1), heard("x", LEFT, instance=2, age=9)), FAILED),
        ((heard("x", FAILED, age=9), heard("x", LEFT, instance=2, age=1)), LEFT),
    ],
)
def test_the_more_certain_of_two_words_counts(
    rig: Rig, words: tuple[MemberReport, MemberReport], truth: Presence
) -> None:
    rig.hear("a", "b")
    rig.tell("a", words[0])
    rig.tell("b", words[1])
    assert rig.found.result(0.1).members["x"].presence is truth


def test_a_robot_that_changes_its_word_is_believed(rig: Rig) -> None:
    rig.hear("a")
    rig.tell("a", heard("b", ALIVE))
    rig.tell("a", heard("b", FAILED), at=1.0)
    assert rig.found.result(1.0).members["b"].presence is FAILED


def test_words_come_in_parts(rig: Rig) -> None:
    rig.hear("a")
    rig.tell("a", heard("b", LEFT), parts=2)
    assert not rig.found.has_all_lists(5.0)
    rig.tell("a", heard("c", LEFT), part=1, parts=2, roster=("z",))
    assert rig.found.known == {"a", "b", "c", "z"}
    assert rig.found.has_all_lists(5.0)


def test_a_robot_that_says_that_it_leaves_has_left(rig: Rig) -> None:
    rig.hear("a", "b")
    rig.tell("a", heard("b"))
    rig.answer("b")
    rig.hear("b", flags=int(Flag.LEFT), at=0.05)
    assert rig.found.result(0.1).members["b"].presence is LEFT
    assert rig.found.result(0.1).expected == {"a"}


def test_a_robot_that_does_not_own_its_id_yet_is_no_member(rig: Rig) -> None:
    rig.hear("a", flags=int(Flag.JOINING))
    assert rig.found.known == set()


def test_a_robot_that_fell_silent_has_failed(rig: Rig) -> None:
    rig.hear("a")
    assert rig.contact("a", 3.0) is Contact.NO_ANSWER
    member = rig.found.result(4.01).members["a"]
    assert (member.presence, round(member.age, 2)) == (FAILED, 4.0)


def test_the_epochs_are_those_that_robots_showed(rig: Rig) -> None:
    rig.hear("a")
    rig.answer("a", instance=9)
    rig.hear("a", instance=9, at=0.03)
    rig.hear("b", sequence=2, revision=7)
    rig.hear("b", sequence=1, revision=6)
    epochs = rig.found.result(0.1).epochs(["a", "b", "zz"])
    b = Epoch(life().hex(), 7)
    assert epochs == {"a": light_status("a", life(9).hex()).epoch, "b": b, "zz": None}


def test_without_need_of_a_status_an_echo_and_a_list_are_an_answer() -> None:
    rig = Rig(needs_status=False)
    rig.found.on_solicit(5, 0.0)
    rig.hear("a", "b", echo=5)
    rig.tell("a", heard("b"))
    assert not rig.found.is_complete(0.02)
    rig.tell("b", heard("a"))
    assert rig.found.is_complete(0.02)
    assert rig.found.result(0.02).missing == ()


def test_without_need_of_a_status_a_beacon_that_answers_nothing_is_no_answer() -> None:
    rig = Rig(needs_status=False)
    rig.found.on_solicit(5, 0.0)
    rig.hear("a", echo=5)
    rig.hear("b")
    rig.tell("a", heard("b"))
    rig.tell("b", heard("a"))
    assert not rig.found.is_complete(1.0)
    assert rig.found.result(1.0).missing == ("b",)


def test_without_need_of_a_status_an_id_that_two_hold_needs_both_statuses() -> None:
    rig = Rig(needs_status=False)
    rig.found.on_solicit(5, 0.0)
    for at in (0.01, 0.05):
        rig.hear("a", instance=1, echo=5, at=at)
        rig.hear("a", instance=2, echo=5, at=at)
    rig.tell("a")
    assert not rig.found.is_complete(1.0)
    rig.answer("a", instance=1, at=1.0)
    assert not rig.found.is_complete(2.0)
    rig.answer("a", instance=2, at=1.0)
    assert rig.found.is_complete(2.0)


def test_without_need_of_a_status_a_robot_that_others_name_is_missing() -> None:
    rig = Rig(needs_status=False)
    rig.found.on_solicit(5, 0.0)
    rig.hear("a", echo=5)
    rig.tell("a", heard("b"))
    assert not rig.found.is_complete(1.0)
    assert rig.found.result(1.0).missing == ("b",)


def test_both_daemons_of_one_id_must_answer(rig: Rig) -> None:
    rig.hear("b")
    for at in (0.01, 0.05):
        rig.hear("a", instance=1, at=at)
        rig.hear("a", instance=2, at=at + 0.01)
    rig.answer("a", "b", instance=1)
    rig.answer("b", "a")
    assert not rig.found.is_complete(0.5)
    assert rig.found.result(0.1).duplicates == {"a": (life(1).hex(), life(2).hex())}
    rig.answer("a", "b", instance=2)
    assert rig.found.is_complete(0.1)


def test_a_restart_is_no_duplicate(rig: Rig) -> None:
    rig.hear("a", instance=1, at=0.01)
    rig.answer("a", instance=1)
    rig.hear("a", instance=2, at=1.5)
    assert rig.found.holders("a") == {life(2).hex()}
    assert rig.contact("a", 1.5) is Contact.NO_ANSWER  # the answer was that of the first


def test_a_robot_of_another_version_answers_by_its_beacon(rig: Rig) -> None:
    rig.hear("a", wire=codec.VERSION + 1, version="9.1")
    assert rig.found.of_other_version == {"a"}
    member = rig.found.result(0.1).members["a"]
    assert (member.contact, member.state) == (Contact.OTHER_VERSION, "running")
    assert (member.wire, member.version) == (codec.VERSION + 1, "9.1")
    assert rig.found.result(0.1).missing == ()
    header = StatusHeader(robot="a", instance=life().hex(), state="idle", reason="finished")
    rig.found.on_header(header, 0.1)
    assert rig.found.result(0.2).members["a"].header == header
    assert rig.found.is_complete(0.3)


# How long to wait


def over_at(rig: Rig, now: float = 0.0) -> float:
    """When the look is over, in steps of 10 ms."""
    while not rig.found.is_over(now):
        now = round(now + 0.01, 2)
    return now


def test_one_that_is_heard_is_worth_waiting_for(rig: Rig) -> None:
    rig.hear("a", "b", at=0.5)
    rig.answer("a")
    assert over_at(rig) == pytest.approx(0.5 + ANSWER_WAIT, abs=0.02)


def test_the_wait_grows_with_the_round_trip_and_the_loss(rig: Rig) -> None:
    rig.found.on_solicit(1, 0.0)
    rig.hear("a", at=0.4, echo=1)
    assert rig.found.ends_at(0.5, ["a"]) == pytest.approx(0.4 + 14 * 0.4)
    for echo in range(2, 12):  # and none of these is answered
        rig.found.on_solicit(echo, 0.4)
    rig.hear("a", at=2.0, sequence=2)
    assert rig.found.ends_at(2.0, ["a"]) > 0.4 + 14 * 0.4 + 10.0


@pytest.mark.parametrize(
    ("presence", "wait"), [(ALIVE, UNREACHABLE_WAIT), (FAILED, GONE_WAIT), (None, GONE_WAIT)]
)
def test_one_that_is_not_heard_is_waited_for_less(presence: Presence | None, wait: float) -> None:
    rig = Rig(*([] if presence else ["b"]))
    rig.hear("a")
    rig.answer("a")
    if presence is not None:
        rig.tell("a", heard("b", presence))
    assert over_at(rig) == pytest.approx(wait, abs=0.02)


def test_words_are_asked_for_until_all_that_are_heard_have_told(rig: Rig) -> None:
    asked = [at / 100 for at in range(0, 300, 10) if rig.found.wants_members(at / 100)]
    assert asked == [0.0, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.1, 2.4, 2.7]
    rig.hear("a")
    rig.tell("a")
    assert not rig.found.wants_members(3.9)
    rig.hear("b", at=3.9)
    assert rig.found.wants_members(3.9)


# Whom to ask


def test_robots_are_dialled_where_they_are_heard_or_said_to_be(rig: Rig) -> None:
    rig.hear("a")
    rig.tell("a", heard("b"), heard("c", FAILED))
    assert rig.found.to_dial(0.1) == {
        ("a", life().hex()): address("a"),
        ("b", life().hex()): ("10.0.0.9", 7440),
    }
    assert rig.found.to_solicit() == (("10.0.0.9", 7440),)
    rig.hear("b", at=0.1)
    assert rig.found.to_dial(0.1)["b", life().hex()] == address("b")


def test_false_words_do_not_make_a_flood() -> None:
    rig = Rig()
    for number in range(300):
        where = f"10.1.{number // 100}.{number % 100}"
        rig.tell("a", replace(heard(f"x{number}"), host=where), part=number % 200, parts=200)
    asked: set[tuple[str, int]] = set()
    for echo in range(3):
        some = rig.found.to_solicit()
        assert len(some) <= MAX_COPIES
        asked.update(some)
        rig.found.on_solicit(echo, 0.1)
    assert len(asked) == 200  # each in its turn


def test_a_robot_that_moved_is_found_at_its_new_address(rig: Rig) -> None:
    rig.hear("a")
    rig.found.on_beacon(beacon("a", sequence=2), ("10.0.1.1", 7440), 0.1)
    assert rig.found.address("a") == ("10.0.1.1", 7440)


def test_a_beacon_that_was_overtaken_changes_nothing(rig: Rig) -> None:
    rig.hear("a", sequence=5)
    rig.hear("a", sequence=4, state=STATES.index(State.IDLE))
    assert rig.found.result(0.1).members["a"].state == "running"


def test_strangers_are_bounded() -> None:
    rig = Rig("own")
    for number in range(2 * MAX_ROBOTS):
        rig.hear(f"r{number}")
        rig.tell(f"t{number}", heard(f"x{number}"))
        rig.answer(f"v{number}")
    assert len(rig.found.known) <= MAX_ROBOTS + 1
    assert "own" in rig.found.result(0.1).missing


def test_parts_of_two_answers_are_no_whole_list(rig: Rig) -> None:
    """Part 1 of an old answer may lack the robot that part 1 of the new one has."""
    rig.hear("a")
    rig.tell("a", heard("b"), part=1, parts=2, echo=1)
    rig.tell("a", heard("c"), part=0, parts=2, echo=2)
    assert not rig.found.has_all_lists(10.0)
    rig.tell("a", heard("b"), heard("d"), part=1, parts=2, echo=2)
    assert rig.found.has_all_lists(10.0)
    assert rig.found.known == {"a", "b", "c", "d"}


def test_a_delayed_beacon_does_not_revive_a_robot_that_left(rig: Rig) -> None:
    rig.hear("a")
    rig.hear("a", sequence=3, flags=Flag.LEFT)
    rig.hear("a", sequence=2)
    assert not rig.found.heard


@pytest.mark.parametrize(
    ("host", "port", "is_taken"),
    [
        ("10.0.0.5", 7440, True),
        ("fd00::5", 7440, True),
        ("fe80::1%2", 7440, True),
        ("fe80::1%a b/c#?", 7440, False),
        ("fd00::5%2", 7440, False),
        ("a b/c#?", 7440, False),
        ("robot.example", 7440, False),
        ("10.0.0.5", 0, False),
        ("0.0.0.0", 7440, False),
        ("224.0.0.226", 7440, False),
        ("127.0.0.1", 22, False),
        ("::1", 22, False),
    ],
)
def test_only_addresses_that_a_robot_can_have_are_taken_from_others(
    host: str, port: int, is_taken: bool
) -> None:
    assert reported_address(host, port, is_local=False) == ((host, port) if is_taken else None)
    rig = Rig()
    rig.tell("a", replace(heard("b"), host=host, port=port))
    assert list(rig.found.to_dial(0.1).values()) == ([(host, port)] if is_taken else [])


def test_on_loopback_only_addresses_of_loopback_are_taken() -> None:
    assert reported_address("127.0.0.9", 7440, is_local=True) == ("127.0.0.9", 7440)
    assert reported_address("10.0.0.5", 7440, is_local=True) is None
    assert reported_address("::1", 7440, is_local=True) is None


def test_robots_known_by_the_word_of_others_are_dialled_some_at_a_time(rig: Rig) -> None:
    for part in range(10):
        some = (heard(f"x{part}-{number}") for number in range(60))
        rig.tell("forger", *some, part=part, parts=10)
    rig.hear("a", "c")
    rig.tell("c", heard("real"))
    wanted = {robot for robot, _ in rig.found.to_dial(0.1)}
    assert len(wanted) == MAX_INDIRECT_DIALS + 2
    assert {"a", "c", "real"} <= wanted
    rig.answer("real")  # one that answered makes room for another
    assert len(rig.found.to_dial(0.1)) == MAX_INDIRECT_DIALS + 3


def test_robots_that_only_send_beacons_do_not_prolong_a_look(rig: Rig) -> None:
    """A beacon of another stranger every half second."""
    rig.hear("a")
    rig.answer("a")
    now = 0.0
    while not rig.found.is_over(now) and now < LOOK_CAP:
        now = round(now + 0.5, 2)
        rig.hear(f"x{now}", at=now)
        rig.hear("a", at=now, sequence=round(now * 10))
    assert now < 10.0
    rig.tell("a", *(heard(f"y{number}") for number in range(3)), at=now)
    assert not rig.found.is_over(now + 0.1)  # another robot knows these


def test_nothing_prolongs_a_look_for_ever(rig: Rig) -> None:
    rig.hear("a")
    now = 0.0
    while not rig.found.is_over(now):
        now = round(now + 0.5, 2)
        rig.found.on_solicit(round(now * 2), now - 0.4)
        rig.hear(f"x{now}", at=now, echo=round(now * 2))
        rig.tell("a", heard(f"y{now}"), at=now)
        assert now <= LOOK_CAP


def test_late_answers_do_not_make_the_round_trip_long(rig: Rig) -> None:
    for echo in range(1, 5):
        rig.found.on_solicit(echo, 0.0)
    for echo in (1, 2):
        rig.hear("a", at=0.1, echo=echo, sequence=echo)
    rig.hear("once", at=4.0, echo=1)
    assert rig.found.round_trip == pytest.approx(0.1)
    for echo in (1, 2):
        rig.hear("late", at=100.0, echo=echo, sequence=echo)
    assert rig.found.round_trip == MAX_ROUND_TRIP
    for robot in "bcdefghi":
        for echo in (3, 4):
            rig.hear(robot, at=0.2, echo=echo, sequence=echo)
    assert rig.found.round_trip == pytest.approx(0.2)


@pytest.mark.parametrize("sequence", [2, 10**9])
def test_a_robot_that_is_heard_after_a_false_leave_is_there(rig: Rig, sequence: int) -> None:
    rig.hear("a")
    rig.found.on_solicit(1, 0.02)
    rig.hear("a", sequence=sequence, flags=Flag.LEFT, at=0.03)
    rig.hear("a", sequence=2, echo=1, at=0.04)  # the answer to what was sent before
    assert not rig.found.heard
    rig.found.on_solicit(2, 0.05)
    rig.hear("a", sequence=3, echo=2, at=0.06)
    assert rig.found.heard == {"a"}
    rig.hear("a", sequence=sequence + 9, flags=Flag.LEFT, at=0.07)  # nor does a repeat count
    assert rig.found.heard == {"a"}


@pytest.mark.parametrize("forger", ["forger", "a"])
def test_a_robot_that_was_named_once_is_dropped(rig: Rig, forger: str) -> None:
    """A forged list named it: of an unknown robot, or of a robot that lists others since."""
    rig.hear("a")
    rig.tell(forger, heard("ghost"), heard("b"), at=0.1, echo=1)
    assert "ghost" in rig.found.known
    rig.tell("a", heard("b", FAILED), at=1.0, echo=2)
    assert "ghost" in rig.found.known
    end = 0.2 + INDIRECT_TIME
    assert {robot for robot, _ in rig.found.to_dial(end)} == {"a"}  # too long ago
    rig.hear("a", sequence=2, at=end)
    rig.tell("a", heard("b", FAILED), at=end, echo=3)
    assert rig.found.known == {"a", "b"}
    assert rig.found.result(end).expected == {"a", "b"}


def test_no_robot_is_dropped_while_no_newer_list_comes(rig: Rig) -> None:
    """The list of a silent robot counts, and a robot that was heard stays listed."""
    rig.hear("a", "b")
    rig.tell("a", heard("c"))
    rig.found.is_over(60.0)
    assert rig.found.result(60.0).expected == {"a", "b", "c"}
    rig.hear("a", sequence=2, at=60.0)
    rig.tell("a", heard("c", FAILED), at=60.0, echo=2)
    assert rig.found.result(60.0).expected == {"a", "b", "c"}


def test_robots_of_an_earlier_look_stay_expected(rig: Rig) -> None:
    rig.hear("a", "b")
    rig.tell("a", heard("b"), heard("ghost"))
    later = Discovery(1.0, earlier=rig.found.result(1.0))
    end = 1.1 + INDIRECT_TIME
    later.on_beacon(beacon("a"), address("a"), end)
    later.on_member_list(word("a"), end)
    assert later.known == {"a", "b"}


def test_links_are_pairs_that_report_each_other_as_alive(rig: Rig) -> None:
    rig.hear("a", "b", "c", "d")
    rig.tell("a", heard("b"), heard("c"), heard("d"))
    rig.tell("b", heard("a"))
    rig.tell("c", heard("a", FAILED))
    assert rig.found.links(0.1) == {("a", "b")}
    rig.tell("d", heard("a"), at=0.2)
    assert rig.found.links(0.3) == {("a", "b"), ("a", "d")}
    assert rig.found.links(60.0) == set()
