"""What begins an incident between two statuses of a robot, and what does not."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from swarmd.core.incident import BEGINS, Found, IncidentKind, found, silent_id
from swarmd.core.messages import Epoch, FenceSummary, Latch, LoggedEvent, Reason, State, Status
from tests.support.page_reader import ROOT
from tests.support.statuses import RUNNING

IDLE = replace(RUNNING, state=State.IDLE, reason=Reason.NEVER_ASKED)
LATCH = Latch(issuer="anna@desk", scope="swarm", reason="a cat")
FENCE = FenceSummary(frame="hall", clearance=0.2, error=0.05)


def stopped(reason: Reason, state: State = State.STOPPED) -> Status:
    return replace(RUNNING, state=state, reason=reason)


def kind_of(what: Found | None) -> IncidentKind | None:
    return None if what is None else what.kind


@pytest.mark.parametrize(
    ("before", "now", "kind"),
    [
        (RUNNING, replace(stopped(Reason.ESTOP, State.ESTOPPED), latches={"a": LATCH}), "estop"),
        (IDLE, replace(stopped(Reason.ESTOP, State.ESTOPPED), latches={"a": LATCH}), "estop"),
        (RUNNING, stopped(Reason.QUARANTINED, State.FAULTED), "fault"),
        (IDLE, stopped(Reason.DUPLICATE_ID, State.FAULTED), "fault"),
        (RUNNING, stopped(Reason.HAZARD), "hazard"),
        (replace(RUNNING, reason=Reason.HAZARD), stopped(Reason.HAZARD), "hazard"),
        (RUNNING, stopped(Reason.LOOP_STALLED), "loop_stalled"),
        (RUNNING, stopped(Reason.FROZEN_SCAN), "assumption"),
        (replace(RUNNING, reason=Reason.NO_SCAN), stopped(Reason.NO_SCAN), "assumption"),
        (RUNNING, replace(RUNNING, reason=Reason.DRIVER_LOST), "driver_lost"),
        (RUNNING, replace(RUNNING, findings=("it brakes later than assumed",)), "assumption"),
        (
            replace(RUNNING, fence=FENCE),
            replace(RUNNING, fence=replace(FENCE, clearance=-0.1)),
            "fence",
        ),
    ],
)
def test_what_begins_an_incident(before: Status, now: Status, kind: str) -> None:
    assert kind_of(found(before, now)) == kind
    assert found(now, now) is None  # it goes on


def test_the_words_of_an_incident_are_those_of_the_robot() -> None:
    events = (LoggedEvent(at=1.0, text="started"), LoggedEvent(at=9.0, text="nothing from tcp/x"))
    before = replace(RUNNING, uptime=8.0, events=events[:1])
    lost = replace(before, reason=Reason.DRIVER_LOST, uptime=9.0)
    what = found(before, replace(lost, events=events))
    assert what is not None
    assert what.text.endswith("nothing from tcp/x")
    what = found(before, lost)
    assert what is not None
    assert "started" not in what.text


@pytest.mark.parametrize(
    ("before", "now"),
    [
        (None, stopped(Reason.ESTOP, State.ESTOPPED)),  # since before this daemon
        (RUNNING, stopped(Reason.OPERATOR)),
        (RUNNING, stopped(Reason.FINISHED, State.IDLE)),
        (RUNNING, stopped(Reason.LEASE_ENDED)),
        (RUNNING, replace(RUNNING, reason=Reason.PROTECTION)),
        (RUNNING, replace(RUNNING, reason=Reason.NO_SCAN)),
        (IDLE, stopped(Reason.HAZARD)),
        (IDLE, stopped(Reason.LOOP_STALLED)),
        (replace(RUNNING, fence=FENCE), replace(RUNNING, fence=replace(FENCE, clearance=-0.04))),
        (RUNNING, replace(RUNNING, latches={})),
        (RUNNING, replace(RUNNING, reason=Reason.HAZARD)),  # a hold
        (IDLE, replace(IDLE, reason=Reason.DRIVER_LOST)),
        (replace(RUNNING, reason=Reason.DRIVER_LOST), stopped(Reason.DRIVER_LOST)),  # told before
    ],
)
def test_what_begins_none(before: Status | None, now: Status) -> None:
    assert found(before, now) is None


def test_robots_give_one_stop_one_id_and_another_stop_another() -> None:
    ids = set()
    for robot in ("r1", "r2"):
        before = replace(IDLE, robot=robot)
        for name in ("a", "b"):
            what = found(before, replace(before, latches={name: LATCH}))
            assert what is not None
            assert "a cat" in what.text
            ids.add((name, what.id))
    assert len(ids) == 2


def test_a_stall_has_the_id_that_peers_give_a_robot_they_do_not_hear() -> None:
    before = replace(RUNNING, epoch=Epoch("0123456789ab", 7))
    now = replace(stopped(Reason.LOOP_STALLED), epoch=Epoch("0123456789ab", 8))
    what = found(before, now)
    assert what is not None
    assert what.id == silent_id("r1", "0123456789ab", 7)


def test_each_kind_stands_in_the_page_and_each_reason_has_a_row_once() -> None:
    text = (ROOT / "docs" / "recording.md").read_text()
    assert [kind for kind in IncidentKind if f"| `{kind}` |" not in text] == []
    assert {kind for kind, _ in BEGINS.values()} < set(IncidentKind)
