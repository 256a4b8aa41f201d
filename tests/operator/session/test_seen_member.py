"""How one robot is shown, by what is heard, reported and answered."""

from __future__ import annotations

import pytest

from swarmd.core import codec
from swarmd.core.messages import Epoch, StatusHeader
from swarmd.link.datagram import Flag
from swarmd.operator.session.members_view import Contact
from tests.operator.session.discovery_rig import ALIVE, FAILED, LEFT, Rig, heard, life
from tests.support.fake_daemon import light_status


@pytest.fixture
def rig() -> Rig:
    return Rig()


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


def test_a_robot_that_says_that_it_leaves_has_left(rig: Rig) -> None:
    rig.hear("a", "b")
    rig.tell("a", heard("b"))
    rig.answer("b")
    rig.hear("b", flags=int(Flag.LEFT), at=0.05)
    assert rig.found.result(0.1).members["b"].presence is LEFT
    assert rig.found.result(0.1).expected == {"a"}


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
