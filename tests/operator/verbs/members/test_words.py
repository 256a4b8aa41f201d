"""The table of members, and the notes below it."""

from __future__ import annotations

import os
import re
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec.structs import replace

from swarmd.core import codec
from swarmd.core.goal import GoalState
from swarmd.core.messages import (
    DecisionSummary,
    Health,
    Latch,
    PeerFault,
    Presence,
    ProcessUsage,
    Reason,
    State,
    StatusHeader,
)
from swarmd.operator.cli.output import print_table, terminal_width
from swarmd.operator.session.members_view import Contact, MembersView, SeenMember
from swarmd.operator.verbs.members.words import HEADER, WIDE, health, row, wide_cells
from swarmd.operator.view.screen import Screen
from tests.support.goals import goal_status, make_goal, member_with, view_of
from tests.support.statuses import ESTOPPED, make_member


def line(member: SeenMember) -> dict[str, str]:
    cells = zip((*HEADER, *WIDE), (*row(member), *wide_cells(member)), strict=True)
    return dict(cells)


def test_shows_a_running_robot() -> None:
    assert line(make_member()) == {
        "NAME": "r1",
        "STATE": "running",
        "REASON": "-",
        "PATTERN": "drive",
        "PROTECTION": "active",
        "SEEN": "now",
        "REPORT": "opinion 2",
        "GEN": "42",
        "SCAN": "5.0 Hz",
        "LOOP99": "4 ms",
        "CPU": "-",
        "VERSION": "1.2.3",
        "LABELS": "red",
        "GOAL": "-",
    }


def test_shows_the_processor_time_of_daemon_and_pattern_host() -> None:
    usage = ProcessUsage(cpu=0.25, memory=90_000_000)
    assert line(make_member(health=Health(usage=usage)))["CPU"] == "25%"
    pattern_usage = ProcessUsage(cpu=0.5, memory=60_000_000)
    assert (
        line(make_member(health=Health(usage=usage, pattern_usage=pattern_usage)))["CPU"] == "75%"
    )


def test_shows_the_report_of_the_pattern() -> None:
    assert line(make_member(report={}))["REPORT"] == "-"
    report = {"phase": "disperse", "opinion": 2, "distance": 1.4000000001}
    assert line(make_member(report=report))["REPORT"] == "phase disperse, opinion 2, distance 1.4"


@pytest.mark.parametrize(("columns", "width"), [("120", 120), ("", 80), ("wide", 80), ("0", 80)])
def test_the_width_is_that_of_the_terminal(
    monkeypatch: pytest.MonkeyPatch, columns: str, width: int
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    with Path("/dev/null").open() as nothing:
        monkeypatch.setattr("os.get_terminal_size", partial(os.get_terminal_size, nothing.fileno()))
        assert terminal_width() == width


def test_a_terminal_without_a_size_counts_as_80_by_24(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    monkeypatch.setattr("os.get_terminal_size", lambda *_: os.terminal_size((0, 0)))
    assert terminal_width() == 80
    screen = SimpleNamespace(_output=sys.__stdout__)
    assert Screen.size.fget(screen) == (80, 24)  # type: ignore[attr-defined]


def test_the_last_column_is_cut_to_the_width(capsys: pytest.CaptureFixture[str]) -> None:
    long = make_member("tb3-01", pattern="attraction", report={"text": "long " * 30})
    print_table(HEADER, [row(long), row(make_member("tb3-02"))], width=80)
    lines = capsys.readouterr().out.splitlines()
    assert 70 < max(map(len, lines)) <= 80
    assert lines[1].endswith("...")
    assert lines[2].endswith("  opinion 2")


@pytest.mark.parametrize(
    ("changes", "cells"),
    [
        (
            {"state": State.STOPPED, "reason": Reason.STALE_SCAN, "pattern": None},
            {"STATE": "stopped", "REASON": "stale_scan", "PATTERN": "-", "REPORT": "-"},
        ),
        ({"decision": DecisionSummary()}, {"PROTECTION": "clear"}),
        (
            {"presence": Presence.FAILED, "age": 38.0},
            {"STATE": "silent", "REASON": "failed", "PATTERN": "-", "SEEN": "38.0 s ago"},
        ),
        ({"presence": Presence.LEFT, "pattern": None}, {"STATE": "left", "REASON": "-"}),
        (
            {"reason": Reason.NO_REQUESTED_COMMAND},
            {"STATE": "at rest", "REASON": "no_requested_command", "PATTERN": "drive"},
        ),
        ({"reason": Reason.STALE_SCAN}, {"STATE": "held", "REASON": "stale_scan"}),
    ],
)
def test_shows_a_robot_in_each_presence(changes: dict[str, Any], cells: dict[str, str]) -> None:
    assert cells.items() <= line(make_member(**changes)).items()


HEARD = SeenMember(
    robot="r1",
    instance="x",
    presence=Presence.ALIVE,
    age=0.3,
    contact=Contact.NO_ANSWER,
    state="running",
)
DISTANT = replace(HEARD, robot="r2", age=0.4, contact=Contact.UNREACHABLE, state="", by="r1")
OTHER = replace(
    HEARD, robot="r3", contact=Contact.OTHER_VERSION, wire=codec.VERSION + 1, version="9.9"
)


@pytest.mark.parametrize(
    ("member", "cells"),
    [
        (HEARD, {"STATE": "no answer", "REASON": "-", "SEEN": "300 ms ago"}),
        (
            DISTANT,
            {"STATE": "silent", "REASON": "unreachable", "SEEN": "400 ms ago by r1"},
        ),
        (OTHER, {"STATE": "running", "VERSION": "9.9", "SEEN": "now", "REASON": "-"}),
        (
            replace(
                OTHER,
                header=StatusHeader(
                    robot="r3", instance="x", state="stopped", reason="operator", pattern="drive"
                ),
            ),
            {"REASON": "operator", "PATTERN": "drive"},
        ),
    ],
    ids=["no answer", "unreachable", "other version", "other version with a status"],
)
def test_shows_how_far_a_robot_was_reached(member: SeenMember, cells: dict[str, str]) -> None:
    assert cells.items() <= line(member).items()


def test_figures_that_are_old_say_so() -> None:
    assert line(make_member(age=2.5))["SEEN"] == "2.5 s ago"


def test_names_robots_that_did_not_answer_as_they_should() -> None:
    assert notes(HEARD, DISTANT, OTHER)[1:] == [
        "alive, but no answer: r1 (heard 300 ms ago, running)",
        "not reachable from here: r2 (alive by r1's word, 400 ms ago)",
        f"other version: r3 speaks {codec.VERSION + 1}, this swarmctl {codec.VERSION}",
    ]


def notes(*members: SeenMember) -> list[str]:
    """The notes on a look that asked each robot for its status."""
    by_name = {member.robot: member for member in members}
    answered = {name for name, one in by_name.items() if one.contact is not Contact.NO_ANSWER}
    return list(health(MembersView(members=by_name, answered=frozenset(answered))))


def test_names_robots_with_problems() -> None:
    lost = Health(driver="no odometry for 2 s", driver_up=False)
    members = {
        "r1": HEARD,
        "r2": make_member("r2", presence=Presence.FAILED, age=5.0),
        "r3": make_member("r3", presence=Presence.LEFT, age=600.0),
        "r5": make_member("r5", health=lost),
    }
    view = MembersView(
        members=members,
        answered=frozenset(members) - {"r1"},
        roster=frozenset({"r1", "r4"}),
        duplicates={"r1": ("a", "b")},
    )
    assert [note.partition(";")[0] for note in health(view)] == [
        "2/5 alive",
        "failed: r2 (5.0 s ago)",
        "left: r3 (10 min ago)",
        "alive, but no answer: r1 (heard 300 ms ago, running)",
        "in the roster and never seen: r4",
        "two daemons have one id: r1",
        "driver lost: r5 (no odometry for 2 s)",
    ]


def test_names_robots_that_protection_keeps_in_place() -> None:
    held = make_member("r1", held_for=12.0), make_member("r2"), make_member("r3", held_for=64.0)
    members = {member.robot: member for member in held}
    view = MembersView(members=members, answered=frozenset(members))
    lines = [line for line in health(view) if "free floor" in line]
    assert len(lines) == 1
    assert re.findall(r"r\d \([^)]+\)", lines[0]) == ["r1 (12.0 s)", "r3 (64.0 s)"]


def test_names_robots_whose_emergency_stops_would_not_outlive_a_restart() -> None:
    full = Health(driver_up=True, storage="/s cannot be written (No space left on device)")
    (note,) = notes(make_member("r1", health=full), make_member("r2"))[1:]
    assert "r1" in note
    assert "r2" not in note
    assert full.storage in note


def test_warns_that_anyone_on_an_open_network_can_drive() -> None:
    open_to_all = make_member("r2", profile="field")
    text = notes(make_member(profile="field", is_secured=True), open_to_all)[-1]
    assert "anyone on this network can drive r2" in text
    assert notes(make_member(profile="field", is_secured=True)) == ["1/1 alive"]


def test_wide_shows_labels_and_goals_and_a_note_names_offers() -> None:
    goal = make_goal(7, "flocking")
    offered = member_with("r2", goal_status(goal, state=GoalState.OFFERED), labels=("red", "fast"))
    assert wide_cells(offered)[-2:] == ("red fast", "goal 7 of anna: flocking (offered)")
    assert wide_cells(make_member("r1", Presence.FAILED))[-2:] == ("-", "-")
    running = member_with("r1", goal_status(goal))
    notes = [note for note in health(view_of(running, offered)) if "offered" in note]
    assert len(notes) == 1
    assert notes[0].endswith("swarmctl resume r2")
    latched = member_with("r3", goal_status(goal, state=GoalState.OFFERED), state=State.ESTOPPED)
    notes = [note for note in health(view_of(offered, latched)) if "offered" in note]
    assert notes[0].endswith("swarmctl resume r2 r3; first reset r3")


def test_each_emergency_stop_is_told_once_with_its_robots() -> None:
    assert ESTOPPED.status is not None
    swarm_wide = ESTOPPED.status.latches
    own = {"e2": Latch(issuer="anna", scope="robots", reason="wheel", age=3.0)}
    view = view_of(
        ESTOPPED, make_member("r1"), make_member("r3", latches={**own, **swarm_wide}, uptime=1.0)
    )
    assert [note for note in health(view) if "emergency" in note] == [
        "emergency stop: r2, r3 (by bob@desk, 12.0 s ago, for swarm: smoke)",
        "emergency stop: r3 (by anna, 3.0 s ago, for robots: wheel)",
    ]


def test_names_a_fault_that_peers_tell_once_and_who_alone_suspects_it() -> None:
    mute = PeerFault(robot="r3", kind="mute", by=2, of=3, since=7.0)
    unheard = PeerFault(robot="r2", kind="unheard", by=0, of=2, since=9.0)
    members = [
        make_member("r1", peer_faults=(unheard, mute)),
        make_member("r2", peer_faults=(replace(mute, by=3),)),
    ]
    lines = [line for line in health(view_of(*members)) if "mute" in line or "unheard" in line]
    assert len(lines) == 2
    alone, named = lines
    assert [word in alone for word in ("r2", "r1", "9")] == [True] * 3
    assert [word in named for word in ("r3", "3 of 3", "r1")] == [True, True, False]
