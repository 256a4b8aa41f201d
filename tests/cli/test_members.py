"""The table of members, and the notes below it."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.cli.members import HEADER, health, row
from swarmd.core.messages import DecisionSummary, Health, Member, Presence, Reason, State
from swarmd.network.discovery import MembersView
from tests.support.statuses import make_member


def line(member: Member) -> dict[str, str]:
    return dict(zip(HEADER, row(member), strict=True))


def test_shows_a_running_robot() -> None:
    assert line(make_member()) == {
        "NAME": "r1",
        "STATE": "running",
        "REASON": "-",
        "PATTERN": "drive",
        "GEN": "42",
        "PROTECTION": "active",
        "SCAN": "5.0 Hz",
        "LOOP99": "4 ms",
        "SEEN": "now",
        "REPORT": "opinion 2",
    }


def test_shows_the_report_of_the_pattern_cut_to_its_column() -> None:
    assert line(make_member(report={}))["REPORT"] == "-"
    report = {"phase": "disperse", "opinion": 2, "distance": 1.4000000001}
    assert line(make_member(report=report))["REPORT"] == "phase disperse, opinion 2, distance 1.4"
    assert len(line(make_member(report={"text": "long " * 30}))["REPORT"]) == 60


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
            {"STATE": "failed", "PATTERN": "drive?", "SCAN": "-", "SEEN": "38.0 s ago"},
        ),
        ({"presence": Presence.LEFT, "pattern": None}, {"STATE": "left", "PATTERN": "-"}),
    ],
)
def test_shows_a_robot_in_each_presence(changes: dict[str, Any], cells: dict[str, str]) -> None:
    assert cells.items() <= line(make_member(**changes)).items()


def test_lists_a_robot_without_a_status() -> None:
    member = Member(robot="r1", instance="x", presence=Presence.ALIVE, age=0.0)
    assert line(member)["STATE"] == "no answer"


def notes(*members: Member) -> list[str]:
    by_name = {member.robot: member for member in members}
    return list(health(MembersView(members=by_name, answered=frozenset(by_name))))


def test_names_robots_with_problems() -> None:
    lost = Health(driver="no odometry for 2 s", driver_up=False)
    members = {
        "r1": make_member("r1"),
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
        "alive, but no answer: r1",
        "in the roster and never seen: r4",
        "two daemons have one id: r1",
        "driver lost: r5 (no odometry for 2 s)",
    ]


def test_warns_that_anyone_on_an_open_network_can_drive() -> None:
    open_to_all = make_member("r2", profile="field")
    text = notes(make_member(profile="field", is_secured=True), open_to_all)[-1]
    assert "anyone on this network can drive these robots" in text
    assert notes(make_member(profile="field", is_secured=True)) == ["1/1 alive"]
