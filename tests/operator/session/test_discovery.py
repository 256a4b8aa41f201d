"""Putting the swarm together from what is heard, what others say, and what robots answer."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from swarmd.core.messages import Epoch, Presence
from swarmd.link.datagram import Flag
from swarmd.link.members.membership import MAX_MEMBERS
from swarmd.operator.session.clocks import QUIET_TIME
from swarmd.operator.session.discovery import (
    ANSWER_WAIT,
    FIRST_ROBOT_TIMEOUT,
    GONE_TRIPS,
    GONE_WAIT,
    LOOK_CAP,
    MAX_COPIES,
    MAX_INDIRECT_DIALS,
    UNREACHABLE_WAIT,
    Discovery,
)
from swarmd.operator.session.member_reports import INDIRECT_TIME
from tests.operator.session.discovery_rig import (
    ALIVE,
    FAILED,
    Rig,
    address,
    beacon,
    heard,
    life,
    word,
)


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


def test_a_robot_that_answered_and_is_gone_since_makes_no_complete_look(rig: Rig) -> None:
    for robot, other in (("a", "b"), ("b", "a")):
        rig.hear(robot)
        rig.answer(robot, other)
    assert rig.found.is_complete(0.2)
    end = 0.2 + INDIRECT_TIME  # the report of the other robot is old as well
    rig.hear("a", at=end)
    assert rig.found.result(end).missing == ("b",)
    assert not rig.found.is_complete(end)


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
    asked = [at / 100 for at in range(0, 300, 10) if rig.found.begin_list_request(at / 100)]
    assert asked == [0.0, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.1, 2.4, 2.7]
    rig.hear("a")
    rig.tell("a")
    assert not rig.found.begin_list_request(3.9)
    rig.hear("b", at=3.9)
    assert rig.found.begin_list_request(3.9)


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


def test_strangers_are_bounded() -> None:
    rig = Rig("own")
    for number in range(2 * MAX_MEMBERS):
        rig.hear(f"r{number}")
        rig.tell(f"t{number}", heard(f"x{number}"))
        rig.answer(f"v{number}")
    assert len(rig.found.known) <= MAX_MEMBERS + 1
    assert "own" in rig.found.result(0.1).missing


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


# A look after another one


@pytest.fixture(params=[True, False], ids=["with statuses", "without statuses"])
def looked(request: pytest.FixtureRequest) -> Rig:
    """A look that the robots a and b answered after 0.01 s; another one is to begin."""
    rig = Rig(needs_status=request.param)
    rig.found.on_solicit(1, 0.0)
    for robot, other in (("a", "b"), ("b", "a")):
        answers_with(rig, robot, other, echo=1, at=0.01)
    assert rig.found.is_complete(0.02)
    return rig


def answers_with(rig: Rig, robot: str, other: str, echo: int, at: float, age: int = 0) -> None:
    rig.hear(robot, at=at, echo=echo, sequence=echo)
    rig.tell(robot, heard(other, age=age), at=at, echo=echo)
    rig.answer(robot, other, at=at)


@pytest.mark.parametrize("gap", [1.0, 60.0])
def test_what_a_robot_answered_to_an_earlier_look_is_no_answer(looked: Rig, gap: float) -> None:
    looked.look_again(gap)
    looked.found.on_solicit(2, gap)
    answers_with(looked, "a", "b", echo=2, at=gap + 0.01, age=round(1000 * gap))
    result = looked.found.result(gap + 0.5)
    assert result.missing == ("b",)
    assert result.answered == {"a"}
    assert not looked.found.is_complete(gap + 0.5)


def test_a_robot_that_was_heard_before_the_look_alone_is_waited_for_as_one_that_is_gone(
    looked: Rig,
) -> None:
    looked.look_again(60.0)
    looked.found.on_solicit(2, 60.0)
    assert looked.found.ends_at(60.0, ["b"]) == pytest.approx(60.0 + looked.found._first_robot_wait)
    looked.hear("a", at=60.01, echo=2, sequence=2)
    ends = looked.found.ends_at(60.02, ["b"])
    assert ends == pytest.approx(60.0 + GONE_WAIT + GONE_TRIPS * looked.found.round_trip)


def test_round_trip_and_lists_are_those_of_the_look(looked: Rig) -> None:
    assert looked.found.links(0.02) == {("a", "b")}
    looked.look_again(1.0)
    found = looked.found
    assert found.round_trip == 0.0
    assert found.links(1.0) == frozenset()
    assert not found.has_all_lists(1.0)
    found.on_solicit(2, 1.0)
    looked.hear("a", at=1.3, echo=2, sequence=2)
    assert found.round_trip == pytest.approx(0.3)
    assert found.unlisted == ("a",)


def test_loss_is_that_of_the_look(looked: Rig) -> None:
    for echo in range(2, 10):  # none is answered
        looked.found.on_solicit(echo, 0.1 * echo)
    assert looked.found.result(1.5).loss > 0.8
    looked.look_again(2.0)
    looked.found.on_solicit(10, 2.0)
    answers_with(looked, "a", "b", echo=10, at=2.01)
    assert looked.found.result(2.5).loss == 0.0


def test_the_time_of_issue_on_a_robots_clock_is_never_too_late() -> None:
    """The robot's clock is 500 s ahead; its answers take 0.3 and 0.1 s, and show whole ms."""
    discovery = Discovery(10.0)
    discovery.on_solicit(1, 10.0)
    discovery.on_beacon(beacon("a", echo=1, clock=510_200), ("10.0.0.1", 7440), 10.5)
    discovery.on_solicit(2, 11.0)
    discovery.on_beacon(beacon("a", sequence=2, echo=2, clock=511_200), ("10.0.0.1", 7440), 11.3)
    discovery.on_beacon(beacon("b", clock=900_000), ("10.0.0.2", 7440), 11.3)  # answers nothing
    view = discovery.result(11.4)
    epochs = view.epochs(["a", "b", "c"])
    assert view.issue_times(epochs, 10.0) == {"a": pytest.approx(509.9, abs=1e-3)}
    assert view.issue_times(epochs, 10.0)["a"] <= 509.9
    other_life = {"a": Epoch(life(2).hex(), 0)}
    assert view.issue_times(other_life, 10.0) == {}


def test_a_report_of_a_life_that_said_farewell_makes_no_look_wait_longer(rig: Rig) -> None:
    rig.hear("a", "b")
    rig.tell("b", heard("a"))
    assert rig.found.ends_at(5.0, ["a"]) == pytest.approx(0.01 + UNREACHABLE_WAIT)
    rig.hear("a", flags=Flag.LEFT, at=0.02)
    assert rig.found.ends_at(5.0, ["a"]) == pytest.approx(0.01 + GONE_WAIT)
