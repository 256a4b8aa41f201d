"""Whom a stop must still reach, and what is sent."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import pytest

from swarmd.core.messages import Code, Presence
from swarmd.core.refusal import Refusal
from swarmd.link.datagram import MAX_MS, Ack, Flag, Stop, pack, tag_of
from swarmd.operator.session.discovery import Discovery
from swarmd.operator.session.exit_codes import PARTIAL, TIMEOUT
from swarmd.operator.session.member_reports import FRESH_TIME, MemberReports
from swarmd.operator.session.senders import STOP_CAP, STOP_WAIT, PendingStop
from tests.operator.session.discovery_rig import Rig, heard, life

REQUEST = Stop(id="q", verb="estop", operator="anna@laptop")


def ack(pending: PendingStop, robot: str, *, instance: int = 1, **fields: Any) -> None:
    fields = {"code": Code.APPLIED, **fields}
    pending.on_ack(Ack(id="q", robot=robot, instance=life(instance), revision=0, **fields), 0.0)


def make(rig: Rig, **options: Any) -> PendingStop:
    return PendingStop(REQUEST, rig.found, 0.0, **options)


@pytest.fixture
def rig() -> Rig:
    """Two robots that know each other."""
    made = Rig()
    made.hear("a", "b")
    made.tell("a", heard("b"))
    made.tell("b", heard("a"))
    return made


def test_a_stop_of_all_names_no_targets_and_grows_older(rig: Rig) -> None:
    ((sent, _),) = make(rig).datagrams(1.5)
    assert (sent.id, sent.targets, sent.age) == ("q", None, 1500)


def test_it_is_done_when_all_have_acked(rig: Rig) -> None:
    pending = make(rig)
    assert pending.lacking(0.02) == ("a", "b")
    ((_, addresses),) = pending.datagrams(0.02)
    assert len(addresses) == 2
    ack(pending, "a")
    assert (pending.lacking(0.02), pending.is_done(0.02)) == (("b",), False)
    ack(pending, "b", via="a")
    assert pending.is_done(0.02)
    outcome = pending.outcome(0.02)
    assert (outcome.exit_code, outcome.reached) == (0, 2)


def test_a_turn_of_a_stop_reads_no_reports_of_silent_robots(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def of(self: MemberReports, robot: str) -> None:
        raise AssertionError("the reports on 100 robots by 100 robots take 20 ms")

    monkeypatch.setattr(MemberReports, "of", of)
    pending = make(rig)
    silent = FRESH_TIME + STOP_WAIT + 1.0  # s: neither a nor b is heard any more
    assert pending.lacking(silent) == ("a", "b")
    assert pending.is_done(silent) is False
    assert silent < STOP_CAP
    assert pending.is_over(silent) is True


def test_a_robot_that_left_as_others_say_is_no_target_until_it_is_heard(rig: Rig) -> None:
    rig.tell("a", heard("b"), heard("c", Presence.LEFT))
    pending = make(rig)
    assert pending.lacking(0.02) == ("a", "b")
    rig.tell("b", heard("a"), heard("c"), at=0.03)
    assert pending.lacking(0.04) == ("a", "b", "c")
    rig.tell("b", heard("a"), heard("c", Presence.LEFT), at=0.05)
    assert pending.lacking(0.06) == ("a", "b")
    rig.hear("c", at=0.07)
    assert pending.lacking(0.08) == ("a", "b", "c")


def test_a_turn_of_a_stop_makes_no_view_of_all_robots(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def result(self: Discovery, now: float) -> None:
        raise AssertionError("a view takes ms, and each datagram that arrives begins a turn")

    monkeypatch.setattr(Discovery, "result", result)
    pending = make(rig)
    assert pending.is_over(STOP_WAIT / 2) is False
    assert pending.is_done(0.02) is False
    assert pending.lacking(0.02) == pending.silent(0.02) == ("a", "b")
    ((_, addresses),) = pending.datagrams(0.02)
    assert len(addresses) == 2
    assert pending.outcome(0.02).missing == ("a", "b")


def test_a_turn_of_a_stop_asks_of_no_further_robot_once_one_still_moves(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each ack of a base that moves begins a turn: those of N robots would cost N * N answers."""
    pending = make(rig)
    ack(pending, "a", is_moving=True)
    ack(pending, "b", is_moving=True)
    asked: set[str] = set()
    holders = rig.found.holders

    def noted(robot: str) -> frozenset[str]:
        asked.add(robot)
        return holders(robot)

    monkeypatch.setattr(rig.found, "holders", noted)
    assert not pending.is_done(0.02)
    assert len(asked) == 1
    assert pending.lacking(0.02) == ("a", "b")


def test_a_robot_that_does_not_rest_yet_is_waited_for_and_never_counts(rig: Rig) -> None:
    pending = make(rig)
    ack(pending, "a")
    ack(pending, "b", is_moving=True)
    assert (pending.lacking(0.02), pending.is_done(0.02)) == (("b",), False)
    ((_, addresses),) = pending.datagrams(0.1)  # the stop is repeated to it
    assert len(addresses) == 1
    outcome = pending.outcome(0.1)
    assert (outcome.applied, outcome.failed, outcome.missing) == (("a",), ("b",), ())
    assert outcome.replies["b"].refusal is Refusal.NOT_STOPPED
    assert outcome.exit_code == PARTIAL
    ack(pending, "b", via="a")  # also if only another robot hears it by then
    ack(pending, "b", via="a", is_moving=True)  # an older ack, handed on late
    assert pending.is_done(0.5)
    assert pending.outcome(0.5).exit_code == 0


def test_a_robot_that_says_that_it_has_not_stopped_is_not_waited_for(rig: Rig) -> None:
    pending = make(rig)
    ack(pending, "a")
    ack(pending, "b", is_moving=True)
    ack(pending, "b", code=Code.FAILED, refusal=Refusal.NOT_STOPPED)
    assert pending.is_done(2.5)
    assert pending.outcome(2.5).failed == ("b",)


def test_a_daemon_that_ended_before_its_base_rested_is_not_waited_for(rig: Rig) -> None:
    pending = make(rig)
    ack(pending, "a")
    ack(pending, "b", is_moving=True)
    rig.hear("b", instance=2, at=0.5)
    assert pending.lacking(0.5) == ("b",)  # the next daemon has not answered
    ack(pending, "b", instance=2)
    assert pending.is_done(2.0)
    outcome = pending.outcome(2.0)
    assert (outcome.applied, outcome.failed, outcome.duplicates) == (("a", "b"), (), ())


def test_acks_do_not_suffice_before_robots_have_told_whom_they_know() -> None:
    rig = Rig()
    rig.hear("a")
    pending = make(rig)
    ack(pending, "a")
    assert not pending.is_done(2.0)
    rig.tell("a", heard("b"), at=2.0)
    assert not pending.is_done(2.5)
    ack(pending, "b")
    assert pending.is_done(2.5)


def test_an_ack_is_no_success_while_a_robot_has_not_listed_those_that_it_knows() -> None:
    """At a timeout: there may be robots of which nothing is known yet."""
    rig = Rig()
    rig.hear("a")
    pending = make(rig)
    ack(pending, "a")
    outcome = pending.outcome(1.0)
    assert (outcome.exit_code, outcome.unlisted) == (PARTIAL, ("a",))
    named = make(rig, select=lambda known: {"a"}, names=("a",))
    ack(named, "a")
    assert named.outcome(1.0).exit_code == 0


def test_without_members_it_is_never_done_and_over_after_a_while() -> None:
    pending = make(Rig())
    assert not pending.is_done(2.9)
    assert (pending.is_over(STOP_WAIT - 0.01), pending.is_over(STOP_WAIT)) == (False, True)
    outcome = pending.outcome(3.0)
    assert (outcome.targeted, outcome.reached) == (0, 0)


@pytest.mark.parametrize(("presence", "missing"), [(Presence.FAILED, ("c",)), (Presence.LEFT, ())])
def test_a_failed_robot_must_ack_too_and_one_that_left_need_not(
    rig: Rig, presence: Presence, missing: tuple[str, ...]
) -> None:
    rig.tell("a", heard("b"), heard("c", presence), at=0.02)
    pending = make(rig)
    ack(pending, "a")
    ack(pending, "b")
    assert pending.is_done(2.0) is (not missing)
    outcome = pending.outcome(3.0)
    assert outcome.missing == missing
    assert outcome.exit_code == (PARTIAL if missing else 0)


def test_the_roster_must_ack_before_any_robot_is_found() -> None:
    pending = make(Rig("a"))
    assert pending.lacking(0.0) == ("a",)
    assert pending.outcome(3.0).exit_code == TIMEOUT


def test_a_robot_on_the_roster_must_ack_even_if_it_left() -> None:
    rig = Rig("b")
    rig.hear("a")
    rig.tell("a", heard("b", Presence.LEFT))
    assert make(rig).lacking(0.1) == ("a", "b")


def test_a_selection_names_its_targets_and_grows(rig: Rig) -> None:
    def picked(names: Collection[str]) -> set[str]:
        return {name for name in names if name != "a"}

    pending = make(rig, select=picked)
    assert pending.lacking(0.02) == ("b",)
    rig.hear("c", at=0.02)
    ((sent, _),) = pending.datagrams(0.02)
    assert sent.targets == ("b", "c")
    ack(pending, "b")
    ack(pending, "c")
    rig.tell("c", at=0.02)
    assert pending.is_done(1.0)
    assert pending.outcome(1.0).targeted == 2


def test_a_full_name_is_sent_before_anybody_is_known() -> None:
    pending = make(Rig(), select=lambda known: (), names=("r03",))
    ((sent, _),) = pending.datagrams(0.0)
    assert sent.targets == ("r03",)
    assert pending.outcome(3.0).missing == ("r03",)


def test_a_glob_sends_nothing_before_it_matches() -> None:
    pending = make(Rig(), select=lambda known: known)
    assert list(pending.datagrams(0.0)) == []


def test_many_names_travel_in_several_datagrams() -> None:
    names = [f"{'x' * 58}{number:04}" for number in range(300)]
    stop = Stop(id="f" * 63, verb="estop", operator="ä" * 128, reason="ä" * 256, age=MAX_MS)
    pending = PendingStop(stop, Rig().found, 0.0, select=lambda known: (), names=names)
    sent = [one for one, _ in pending.datagrams(9.0)]
    assert sorted(name for one in sent for name in one.targets or ()) == names
    for one in sent:
        pack(tag_of("field", "lab"), one)


def test_of_two_daemons_with_one_id_both_must_ack(rig: Rig) -> None:
    for at in (0.02, 0.04):
        rig.hear("a", instance=1, at=at)
        rig.hear("a", instance=2, at=at + 0.01)
    pending = make(rig)
    ack(pending, "a", instance=1)
    ack(pending, "b")
    assert pending.lacking(0.1) == ("a",)
    assert pending.outcome(3.0).line == "2 targeted, 1 applied, 1 no answer (a)"
    ack(pending, "a", instance=2)
    assert pending.is_done(1.0)
    assert pending.outcome(3.0).line == "2 targeted, 2 applied"


def test_a_stop_ends_although_new_robots_appear_for_ever(rig: Rig) -> None:
    pending = make(rig)
    ack(pending, "a")
    ack(pending, "b")
    now = 0.0
    while not pending.is_over(now):
        now = round(now + 0.5, 2)
        rig.hear(f"x{now}", at=now)
        rig.tell("a", heard("b"), heard(f"y{now}"), at=now)
        assert now <= STOP_CAP
    assert pending.outcome(now).exit_code == PARTIAL


def test_a_robot_that_left_must_ack_while_another_robot_lists_it_as_alive(rig: Rig) -> None:
    """The beacon that says so may be forged, and the robot may stand still for a moment."""
    pending = make(rig)
    ack(pending, "a")
    rig.hear("b", sequence=9, flags=Flag.LEFT, at=0.1)
    assert pending.lacking(0.2) == ("b",)
    assert not pending.is_done(5.0)
    assert pending.outcome(5.0).exit_code == PARTIAL
    assert rig.found.begin_list_request(0.2)
    rig.tell("a", heard("b", Presence.LEFT), at=0.3)
    assert pending.is_done(1.0)
