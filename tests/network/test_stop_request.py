"""Whom a stop must still reach."""

from __future__ import annotations

import pytest

from swarmd.core.codec import Decoder
from swarmd.core.messages import Code, Epoch, EstopRequest, Member, PeerView, Presence, Reply
from swarmd.network.discovery import Discovery
from swarmd.network.outcome import PARTIAL, TIMEOUT
from swarmd.network.stop_request import DISCOVERY_TIMEOUT, PendingStop
from tests.support.fake_daemon import light_status

decode = Decoder(EstopRequest)
REQUEST = EstopRequest(id="q", operator="anna@laptop")


def view(robot: str, *others: tuple[str, Presence]) -> PeerView:
    members = tuple(
        Member(robot=name, instance="1", presence=presence, age=1.0) for name, presence in others
    )
    return PeerView(robot=robot, status=light_status(robot, "1"), members=members)


def ack(pending_stop: PendingStop, robot: str, instance: str = "1") -> None:
    epoch = Epoch(instance=instance, revision=0)
    pending_stop.acks.on_reply(robot, Reply(id="q", robot=robot, code=Code.APPLIED, epoch=epoch))


@pytest.fixture
def discovery() -> Discovery:
    found = Discovery(0.0)
    found.on_view(view("a", ("b", Presence.ALIVE)), 0.01)
    found.on_view(view("b", ("a", Presence.ALIVE)), 0.01)
    return found


@pytest.fixture
def pending_stop(discovery: Discovery) -> PendingStop:
    return PendingStop(REQUEST, None, discovery, 0.0)


def test_a_stop_of_all_names_no_targets(pending_stop: PendingStop) -> None:
    assert decode(pending_stop.payload()) == REQUEST


def test_it_is_done_when_all_have_acked(pending_stop: PendingStop) -> None:
    assert pending_stop.pending() == ("a", "b")
    ack(pending_stop, "a")
    assert pending_stop.pending() == ("b",)
    assert not pending_stop.is_done(0.02)
    ack(pending_stop, "b")
    assert pending_stop.is_done(0.02)
    assert pending_stop.outcome(0.02).exit_code == 0


def test_acks_do_not_suffice_before_the_membership_is_known() -> None:
    discovery = Discovery(0.0)
    pending_stop = PendingStop(REQUEST, None, discovery, 0.0)
    discovery.on_token("a", "1", True, 0.01)
    ack(pending_stop, "a")
    assert not pending_stop.is_done(0.02)
    assert pending_stop.is_done(DISCOVERY_TIMEOUT)


def test_without_members_it_is_never_done() -> None:
    pending_stop = PendingStop(REQUEST, None, Discovery(0.0), 0.0)
    assert not pending_stop.is_done(2.9)
    assert pending_stop.outcome(3.0).targeted == 0


@pytest.mark.parametrize(("presence", "missing"), [(Presence.FAILED, ("c",)), (Presence.LEFT, ())])
def test_a_failed_robot_must_ack_too_and_one_that_left_need_not(
    pending_stop: PendingStop, discovery: Discovery, presence: Presence, missing: tuple[str, ...]
) -> None:
    discovery.on_view(view("a", ("b", Presence.ALIVE), ("c", presence)), 0.02)
    ack(pending_stop, "a")
    ack(pending_stop, "b")
    assert pending_stop.is_done(2.0) is (not missing)
    outcome = pending_stop.outcome(3.0)
    assert outcome.missing == missing
    assert outcome.exit_code == (PARTIAL if missing else 0)


def test_the_roster_must_ack_before_any_robot_is_found() -> None:
    pending_stop = PendingStop(REQUEST, None, Discovery(0.0, ["a"]), 0.0)
    assert pending_stop.pending() == ("a",)
    assert pending_stop.outcome(3.0).exit_code == TIMEOUT


def test_a_selection_names_its_targets_and_grows(discovery: Discovery) -> None:
    def picked(names: object) -> set[str]:
        return {name for name in names if name != "a"}  # type: ignore[attr-defined]

    pending_stop = PendingStop(REQUEST, picked, discovery, 0.0)
    assert pending_stop.pending() == ("b",)
    discovery.on_token("c", "1", True, 0.02)
    assert decode(pending_stop.payload()).targets == {"b": None, "c": None}
    ack(pending_stop, "b")
    ack(pending_stop, "c")
    assert pending_stop.is_done(DISCOVERY_TIMEOUT)
    assert pending_stop.outcome(DISCOVERY_TIMEOUT).targeted == 2


def test_of_two_daemons_with_one_id_both_must_ack(
    pending_stop: PendingStop, discovery: Discovery
) -> None:
    discovery.on_token("a", "1", True, 0.02)
    discovery.on_token("a", "2", True, 0.02)
    ack(pending_stop, "a", "1")
    ack(pending_stop, "b")
    assert pending_stop.pending() == ("a",)
    assert pending_stop.outcome(3.0).line == "2 targeted, 1 applied, 1 no answer (a)"
    ack(pending_stop, "a", "2")
    assert pending_stop.is_done(DISCOVERY_TIMEOUT)
    assert pending_stop.outcome(3.0).line == "2 targeted, 2 applied"
