"""Whom a stop must still reach."""

from __future__ import annotations

import pytest

from swarmd.core.codec import Decoder
from swarmd.core.messages import Code, Condition, Epoch, EstopRequest, Member, PeerView, Reply
from swarmd.network.discovery import Gathering
from swarmd.network.outcome import PARTIAL, TIMEOUT
from swarmd.network.stop_request import GATHER, Halting
from tests.support.fake_daemon import light_status

decode = Decoder(EstopRequest)
REQUEST = EstopRequest(id="q", operator="anna@laptop")


def view(robot: str, *others: tuple[str, Condition]) -> PeerView:
    members = tuple(
        Member(robot=name, instance="1", condition=condition, age=1.0) for name, condition in others
    )
    return PeerView(robot=robot, status=light_status(robot, "1"), members=members)


def ack(halting: Halting, robot: str, instance: str = "1") -> None:
    epoch = Epoch(instance=instance, revision=0)
    halting.acks.on_reply(robot, Reply(id="q", robot=robot, code=Code.APPLIED, epoch=epoch))


@pytest.fixture
def gathering() -> Gathering:
    found = Gathering(0.0)
    found.on_view(view("a", ("b", Condition.ALIVE)), 0.01)
    found.on_view(view("b", ("a", Condition.ALIVE)), 0.01)
    return found


@pytest.fixture
def halting(gathering: Gathering) -> Halting:
    return Halting(REQUEST, None, gathering, 0.0)


def test_everyone_is_told_without_naming_targets(halting: Halting) -> None:
    assert decode(halting.payload()) == REQUEST


def test_those_that_acked_are_not_told_again(halting: Halting) -> None:
    assert halting.pending() == ("a", "b")
    ack(halting, "a")
    assert halting.pending() == ("b",)


def test_it_is_done_when_all_have_acked(halting: Halting) -> None:
    ack(halting, "a")
    assert not halting.is_done(0.02)
    ack(halting, "b")
    assert halting.is_done(0.02)
    assert halting.outcome(0.02).exit_code == 0


def test_acks_before_the_membership_is_known_are_not_enough() -> None:
    gathering = Gathering(0.0)
    halting = Halting(REQUEST, None, gathering, 0.0)
    gathering.on_token("a", "1", True, 0.01)
    ack(halting, "a")
    assert not halting.is_done(0.02)
    assert halting.is_done(GATHER)


def test_with_nobody_in_sight_it_is_never_done() -> None:
    halting = Halting(REQUEST, None, Gathering(0.0), 0.0)
    assert not halting.is_done(2.9)
    assert halting.outcome(3.0).targeted == 0


def test_a_failed_robot_must_ack_too(halting: Halting, gathering: Gathering) -> None:
    gathering.on_view(view("a", ("b", Condition.ALIVE), ("c", Condition.FAILED)), 0.02)
    ack(halting, "a")
    ack(halting, "b")
    assert not halting.is_done(2.0)
    outcome = halting.outcome(3.0)
    assert outcome.missing == ("c",)
    assert outcome.exit_code == PARTIAL


def test_one_that_left_need_not(halting: Halting, gathering: Gathering) -> None:
    gathering.on_view(view("a", ("b", Condition.ALIVE), ("c", Condition.LEFT)), 0.02)
    ack(halting, "a")
    ack(halting, "b")
    assert halting.is_done(0.1)


def test_the_roster_must_ack_before_anyone_is_seen() -> None:
    halting = Halting(REQUEST, None, Gathering(0.0, ["a"]), 0.0)
    assert halting.pending() == ("a",)
    assert halting.outcome(3.0).exit_code == TIMEOUT


def test_a_selection_names_its_targets_and_grows(gathering: Gathering) -> None:
    def picked(names: object) -> set[str]:
        return {name for name in names if name != "a"}  # type: ignore[attr-defined]

    halting = Halting(REQUEST, picked, gathering, 0.0)
    assert halting.pending() == ("b",)
    gathering.on_token("c", "1", True, 0.02)
    assert decode(halting.payload()).targets == {"b": None, "c": None}
    ack(halting, "b")
    ack(halting, "c")
    assert halting.is_done(GATHER)
    assert halting.outcome(GATHER).targeted == 2


def test_of_two_daemons_with_one_id_both_must_ack(halting: Halting, gathering: Gathering) -> None:
    gathering.on_token("a", "1", True, 0.02)
    gathering.on_token("a", "2", True, 0.02)
    ack(halting, "a", "1")
    ack(halting, "b")
    assert halting.pending() == ("a",)
    assert halting.outcome(3.0).line == "2 targeted, 1 applied, 1 no answer (a)"
    ack(halting, "a", "2")
    assert halting.is_done(GATHER)
    assert halting.outcome(3.0).line == "2 targeted, 2 applied"
