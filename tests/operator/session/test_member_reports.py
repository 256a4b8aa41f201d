"""What robots report of others: lists in parts, reports that differ, addresses."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from swarmd.core.messages import Presence
from swarmd.link.datagram import MemberReport
from swarmd.operator.session.member_reports import reported_address
from tests.operator.session.discovery_rig import ALIVE, FAILED, LEFT, Rig, heard, life


@pytest.fixture
def rig() -> Rig:
    return Rig()


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


def test_parts_of_two_answers_are_no_whole_list(rig: Rig) -> None:
    """Part 1 of an old answer may lack the robot that part 1 of the new one has."""
    rig.hear("a")
    rig.tell("a", heard("b"), part=1, parts=2, echo=1)
    rig.tell("a", heard("c"), part=0, parts=2, echo=2)
    assert not rig.found.has_all_lists(10.0)
    rig.tell("a", heard("b"), heard("d"), part=1, parts=2, echo=2)
    assert rig.found.has_all_lists(10.0)
    assert rig.found.known == {"a", "b", "c", "d"}


def test_a_part_beyond_the_number_of_parts_is_dropped(rig: Rig) -> None:
    rig.tell("forger", heard("b"), part=5, parts=1)
    assert rig.found.known == set()


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


def test_links_are_pairs_that_report_each_other_as_alive(rig: Rig) -> None:
    rig.hear("a", "b", "c", "d")
    rig.tell("a", heard("b"), heard("c"), heard("d"))
    rig.tell("b", heard("a"))
    rig.tell("c", heard("a", FAILED))
    assert rig.found.links(0.1) == {("a", "b")}
    rig.tell("d", heard("a"), at=0.2)
    assert rig.found.links(0.3) == {("a", "b"), ("a", "d")}
    assert rig.found.links(60.0) == set()


def test_two_lives_in_two_parts_of_a_list_are_both_known(rig: Rig) -> None:
    rig.hear("a")
    rig.tell("a", heard("b", instance=1), part=0, parts=2, echo=1)
    rig.tell("a", heard("b", instance=2), heard("c"), part=1, parts=2, echo=1, at=0.02)
    reports = rig.found._reports
    assert {one.instance for one in reports.of("b")} == {life(1).hex(), life(2).hex()}
    assert reports.doubles("b") == {life(1).hex(), life(2).hex()}
    assert reports.listed_alive("a") == {"b", "c"}


def test_a_newer_list_replaces_an_older_one_once_it_is_whole(rig: Rig) -> None:
    rig.hear("a")
    rig.tell("a", heard("b"), heard("c"), echo=1)
    rig.tell("a", heard("d"), part=0, parts=2, echo=2, at=0.02)
    assert rig.found._reports.listed_alive("a") == {"b", "c", "d"}
    rig.tell("a", heard("b", instance=2), part=1, parts=2, echo=2, at=0.03)
    assert rig.found._reports.listed_alive("a") == {"b", "d"}
    assert [one.instance for one in rig.found._reports.of("b")] == [life(2).hex()]
