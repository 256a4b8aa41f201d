"""Beacons that an operator hears: instances that come, leave and return, and the round trip."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.core.messages import State
from swarmd.link.datagram import STATES, Flag
from swarmd.operator.session.clocks import MAX_ROUND_TRIP
from swarmd.operator.session.member_reports import FRESH_TIME
from swarmd.operator.session.members_view import Contact
from tests.operator.session.discovery_rig import LEFT, Rig, address, beacon, heard, life


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_a_robot_that_does_not_own_its_id_yet_is_no_member(rig: Rig) -> None:
    rig.hear("a", flags=int(Flag.JOINING))
    assert rig.found.known == set()


def test_only_a_beacon_that_shows_something_new_wakes_a_call(rig: Rig) -> None:
    def is_news(robot: str, at: tuple[str, int] = ("10.0.0.1", 7440), **told: Any) -> bool:
        return rig.found.on_beacon(beacon(robot, **told), at, 0.1)

    for echo in (1, 2):
        rig.found.on_solicit(echo, 0.05)
    assert is_news("a")  # a robot is found
    assert is_news("a", sequence=2, echo=1)  # it answers
    assert not is_news("a", sequence=3, echo=2)
    assert not is_news("a", sequence=4, revision=7)
    assert is_news("a", sequence=5, at=("10.0.0.2", 7440))  # it is to be dialled elsewhere
    assert is_news("a", sequence=1, instance=2)  # a second daemon has its id
    assert is_news("a", sequence=6, at=("10.0.0.2", 7440))  # and the first one is there, too
    assert is_news("a", sequence=7, flags=Flag.LEFT)


def test_a_beacon_of_a_robot_that_counted_as_gone_wakes_a_call(rig: Rig) -> None:
    def is_news(sequence: int, now: float) -> bool:
        told = beacon("c", sequence=sequence)
        return rig.found.on_beacon(told, ("10.0.0.1", 7440), now)

    assert is_news(1, 0.0)
    assert not is_news(2, 1.0)
    rig.tell("a", heard("c", LEFT), at=1.5)
    assert rig.found.left(1.5) == frozenset()
    silent = 1.0 + FRESH_TIME + 0.5
    assert rig.found.left(silent) == {"c"}  # nothing came meanwhile
    assert is_news(3, silent)  # a call that waits for robots waits for it again
    assert rig.found.left(silent) == frozenset()
    assert not is_news(4, silent + 0.1)


def test_the_farewell_of_a_robot_wakes_a_call(rig: Rig) -> None:
    rig.hear("a", sequence=1)
    farewell = beacon("a", sequence=2, flags=Flag.LEFT)
    assert rig.found.on_beacon(farewell, address("a"), 0.1)


def test_a_beacon_that_shows_which_of_two_lives_goes_on_wakes_a_call(rig: Rig) -> None:
    def is_news(instance: int, now: float, **told: Any) -> bool:
        told = {"instance": instance} | told
        return rig.found.on_beacon(beacon("a", **told), ("10.0.0.1", 7440), now)

    assert is_news(1, 0.0)
    assert is_news(2, 0.1)
    assert is_news(2, 0.2, sequence=2, flags=Flag.LEFT)
    assert rig.found.to_dial(0.3) == {}
    assert is_news(1, 0.3, sequence=2)
    assert rig.found.to_dial(0.3) == {("a", life(1).hex()): ("10.0.0.1", 7440)}


def test_what_is_known_follows_each_beacon_list_and_answer(rig: Rig) -> None:
    assert not rig.found.heard
    assert not rig.found.answered
    assert not rig.found.unlisted
    rig.hear("a")
    assert rig.found.heard == {"a"}
    assert rig.found.unlisted == ("a",)
    rig.tell("a", heard("b"))
    assert not rig.found.unlisted
    assert not rig.found.answered
    rig.answer("a")
    assert rig.found.answered == {"a"}
    rig.hear("a", flags=Flag.LEFT)
    assert not rig.found.heard
    assert rig.found.left(0.1) == {"a"}


def test_a_beacon_that_was_overtaken_changes_nothing(rig: Rig) -> None:
    rig.hear("a", sequence=5)
    rig.hear("a", sequence=4, state=STATES.index(State.IDLE))
    assert rig.found.result(0.1).members["a"].state == "running"


def test_a_delayed_beacon_does_not_revive_a_robot_that_left(rig: Rig) -> None:
    rig.hear("a")
    rig.hear("a", sequence=3, flags=Flag.LEFT)
    rig.hear("a", sequence=2)
    assert not rig.found.heard


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


def test_a_restart_is_no_duplicate(rig: Rig) -> None:
    rig.hear("a", instance=1, at=0.01)
    rig.answer("a", instance=1)
    rig.hear("a", instance=2, at=1.5)
    assert rig.found.holders("a") == {life(2).hex()}
    assert rig.contact("a", 1.5) is Contact.NO_ANSWER  # the answer was that of the first


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
