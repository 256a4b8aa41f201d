"""The line that the daemon's log gets for each request."""

from __future__ import annotations

import pytest

from swarmd.core.goal import Goal
from swarmd.core.messages import Code, Epoch, Reply
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import (
    AnyRequest,
    AuditEntry,
    EstopRequest,
    ForgetRequest,
    GoalRequest,
    LabelRequest,
    ParamRequest,
    ReloadRequest,
    ResetRequest,
    RunRequest,
    StopRequest,
)
from swarmd.daemon.audit import (
    ENTRY_BURST,
    MAX_LINE,
    OTHER_BURST,
    OTHER_RATE,
    PEER_BURST,
    PEER_RATE,
    Audit,
    describe_request,
)

GOAL = Goal(generation=7, issuer="bob", id="g7", pattern=None)
TARGETS: dict[str, Epoch | None] = {"r1": Epoch("i", 1), "r2": Epoch("i", 2)}
ONE: dict[str, Epoch | None] = {"r1": Epoch("i", 1)}
APPLIED = Reply(id="x", robot="r1", code=Code.APPLIED, text="fine")
REFUSED = Reply(id="x", robot="r1", code=Code.REFUSED, refusal=Refusal.BUSY, text="loading")


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        (
            RunRequest(
                id="a", operator="o", targets=TARGETS, pattern="drive", params={"speed": 0.1}
            ),
            "run drive speed=0.1 to 2 robots",
        ),
        (
            RunRequest(
                id="a",
                operator="o",
                targets=ONE,
                pattern="drive",
                seconds=5.0,
                until=("done", "nearer:1"),
            ),
            "run drive for 5 s until done or nearer:1 to 1 robot",
        ),
        (StopRequest(id="a", operator="o"), "stop to all robots"),
        (
            EstopRequest(id="a", operator="o", targets=ONE, reason="cable"),
            "estop (cable) to 1 robot",
        ),
        (ResetRequest(id="a", operator="o", targets=TARGETS), "reset to 2 robots"),
        (
            ResetRequest(
                id="a", operator="o", targets=ONE, findings=("braked at 0.6",), reason="new tyres"
            ),
            "reset of braked at 0.6 (new tyres) to 1 robot",
        ),
        (ParamRequest(id="a", operator="o", targets=ONE, params={"k": 1}), "param k=1 to 1 robot"),
        (ReloadRequest(id="a", operator="o", targets=ONE, pattern="own"), "reload own to 1 robot"),
        (
            LabelRequest(id="a", operator="o", targets=ONE, labels=("red", "big")),
            "label red, big to 1 robot",
        ),
        (
            GoalRequest(id="a", operator="o", targets=ONE, goal=GOAL),
            "goal 7: stand to 1 robot",
        ),
        (
            RunRequest(id="a", operator="o", targets=ONE, pattern="drive", goal=GOAL),
            "run drive as goal 7 to 1 robot",
        ),
        (ForgetRequest(id="a", operator="o", targets=ONE, name="r9"), "forget r9 to 1 robot"),
    ],
)
def test_each_request_is_described(request_: AnyRequest, text: str) -> None:
    assert describe_request(request_) == text


def test_a_line_says_who_from_where_what_and_the_result() -> None:
    lines: list[str] = []
    audit = Audit(lines.append)
    audit.record("stop to 1 robot", "anna@desk", "10.0.0.5", APPLIED, 1.0)
    audit.record("run drive to 1 robot", "ben", "zenoh", REFUSED, 1.0)
    assert lines == [
        "stop to 1 robot, by anna@desk from 10.0.0.5: applied: fine",
        "run drive to 1 robot, by ben from zenoh: refused (busy): loading",
    ]


def test_refused_junk_is_left_out_and_counted_and_hides_no_stop() -> None:
    lines: list[str] = []
    audit = Audit(lines.append)
    for n in range(1000):
        audit.record("run x to 1 robot", "eve", "zenoh", REFUSED, 1.0 + 0.001 * n)
    assert len(lines) == OTHER_BURST
    audit.record("stop to 1 robot", "anna", "zenoh", APPLIED, 2.0)
    assert lines[-1].startswith(f"[{1000 - int(OTHER_BURST)} requests left out")
    assert "stop to 1 robot, by anna" in lines[-1]
    audit.record("run x to 1 robot", "eve", "zenoh", REFUSED, 2.0 + 1.0 / OTHER_RATE)
    assert lines[-1].startswith("run x")


def test_a_flood_of_stops_is_bounded_too() -> None:
    lines: list[str] = []
    audit = Audit(lines.append)
    for _ in range(1000):
        audit.record("stop to all robots", "eve", "zenoh", APPLIED, 1.0)
    assert len(lines) == 1 + OTHER_BURST  # the first, and its repeats as refused requests


def test_texts_of_an_operator_are_bounded_and_stay_in_one_line() -> None:
    lines: list[str] = []
    long = ParamRequest(id="a", operator="o", targets=ONE, params={"k": "v" * 200})
    what = describe_request(long)
    Audit(lines.append).record(
        what, "x\nroot: all well\x1b[2J" + "y" * 999, "z" * 999, REFUSED, 1.0
    )
    assert len(lines[0]) <= MAX_LINE
    assert lines[0].isprintable()
    assert ": refused (busy): loading" in lines[0]


def test_an_entry_has_times_operator_and_targets() -> None:
    kept: list[AuditEntry] = []
    audit = Audit(lambda line: None, kept.append, clock="c0", wall=lambda: 1.8e9)
    audit.record("stop to 2 robots", "anna", "10.0.0.5:4", APPLIED, 7.5, targets=2)
    audit.note("latch 1f", "ben", "a peer", "cable", 8.0)
    assert kept[0] == AuditEntry(
        boot=7.5,
        clock="c0",
        wall=1.8e9,
        operator="anna",
        source="10.0.0.5:4",
        verb="stop",
        targets=2,
        what="stop to 2 robots",
        result="applied",
        text="fine",
    )
    assert (kept[1].verb, kept[1].operator, kept[1].result) == ("latch", "ben", "taken")


def test_a_clock_that_was_not_set_is_no_wall_time() -> None:
    kept: list[AuditEntry] = []
    Audit(lambda line: None, kept.append, wall=lambda: 12.0).note("latch", "ben", "peer", "", 1.0)
    assert kept[0].wall is None


def test_more_entries_than_lines_are_kept_and_a_flood_is_counted() -> None:
    kept: list[AuditEntry] = []
    audit = Audit(lambda line: None, kept.append)
    for _ in range(1000):
        audit.record("run x", "eve", "zenoh", REFUSED, 1.0)
    assert len(kept) == ENTRY_BURST
    audit.record("stop", "anna", "zenoh", APPLIED, 1.0)
    assert kept[-1].left_out == 1000 - ENTRY_BURST


ROOM = 10_000  # requests, docs/evidence/security.md


@pytest.mark.parametrize("reply", [REFUSED, APPLIED], ids=["refused", "applied"])
def test_a_day_of_one_stop_after_the_other_leaves_room_for_what_others_asked(reply: Reply) -> None:
    kept: list[AuditEntry] = []
    audit = Audit(lambda line: None, kept.append)
    audit.record("stop to 1 robot", "anna", "10.0.0.5", APPLIED, 0.0)
    for now in range(1, 86_401):
        audit.record("stop to 1 robot", "ROS", "ROS topic /r/swarmd/stop", reply, float(now))
    assert 200 <= len(kept) < ROOM
    assert len(kept) + sum(entry.left_out for entry in kept) > 86_390  # all are counted


def test_a_stop_that_others_run_before_is_no_repeat() -> None:
    kept: list[AuditEntry] = []
    audit = Audit(lambda line: None, kept.append)
    for _ in range(1000):
        audit.record("stop to 1 robot", "ROS", "ROS topic /r/swarmd/stop", APPLIED, 1.0)
    audit.record("run drive", "anna", "10.0.0.5", APPLIED, 1.0)
    audit.record("stop to 1 robot", "ROS", "ROS topic /r/swarmd/stop", APPLIED, 1.0)
    audit.note("goal 3", "anna", "a peer", "", 1.0)
    audit.record("stop to 1 robot", "ROS", "ROS topic /r/swarmd/stop", APPLIED, 1.0)
    assert [entry.verb for entry in kept[-4:]] == ["run", "stop", "goal", "stop"]


def test_a_stop_that_fails_amid_a_flood_of_refused_stops_is_kept() -> None:
    kept: list[AuditEntry] = []
    audit = Audit(lambda line: None, kept.append)
    for _ in range(1000):
        audit.record("stop to 1 robot", "ROS", "ROS topic /r/swarmd/stop", REFUSED, 1.0)
    moving = Reply(id="x", robot="r1", code=Code.FAILED, refusal=Refusal.NOT_STOPPED)
    audit.record("stop to 1 robot", "anna", "10.0.0.5", moving, 1.0)
    assert (kept[-1].operator, kept[-1].result) == ("anna", "failed (not_stopped)")


def test_a_stop_that_was_applied_first_and_failed_then_is_kept_twice() -> None:
    kept: list[AuditEntry] = []
    audit = Audit(lambda line: None, kept.append)
    for _ in range(1000):
        audit.record("stop to 1 robot", "ROS", "ROS topic /r/swarmd/stop", REFUSED, 1.0)
    moving = Reply(id="x", robot="r1", code=Code.FAILED, refusal=Refusal.NOT_STOPPED)
    for at, reply in ((2.0, APPLIED), (4.0, moving)):
        audit.record("stop to 1 robot", "anna", "10.0.0.5", reply, at)
    assert [entry.result for entry in kept[-2:]] == ["applied", "failed (not_stopped)"]


def test_two_stops_in_turn_with_new_reasons_leave_room_for_what_others_asked() -> None:
    kept: list[AuditEntry] = []
    audit = Audit(lambda line: None, kept.append)
    for now in range(1, 43_201):
        audit.record("stop to 1 robot", "ROS", "ROS topic /r/swarmd/stop", APPLIED, float(now))
        what = f"estop to 1 robot: obstacle at {now} mm"
        audit.record(what, "ROS", "ROS topic /r/swarmd/estop", APPLIED, float(now))
    assert 200 <= len(kept) < ROOM


def test_each_applied_run_is_kept() -> None:
    kept: list[AuditEntry] = []
    audit = Audit(lambda line: None, kept.append)
    for number in range(1000):
        audit.record("run drive", "ROS", "ROS service /r/swarmd/run/go", APPLIED, 5.0 * number)
    assert len(kept) == 1000


def test_what_robots_hand_on_does_not_push_requests_out() -> None:
    lines: list[str] = []
    entries: list[AuditEntry] = []
    audit = Audit(lines.append, entries.append)
    for number in range(10_000):  # of a robot that was taken over, for 1000 s
        now = number / 10.0
        audit.record("estop", "bob", "10.0.0.5:7440", APPLIED, now, is_relayed=True)
        audit.note(f"goal {number} of bob: stand", "bob", "a peer", "", now)
    assert len(entries) <= PEER_BURST + 1000 * PEER_RATE
    assert len(lines) <= PEER_BURST + 1000 * PEER_RATE
    assert entries[0].source == "handed on by 10.0.0.5:7440"
    assert "by bob, handed on by 10.0.0.5:7440: " in lines[0]
    audit.record("run drive", "bob", "10.0.0.7:50000", APPLIED, 1000.0)
    assert (entries[-1].what, entries[-1].source) == ("run drive", "10.0.0.7:50000")
    assert "run drive" in lines[-1]
