"""The table of members, and the notes below it."""

from __future__ import annotations

from collections.abc import Callable

from swarmd.cli.members import HEADER, health, row
from swarmd.core.messages import Condition, DecisionSummary, Health, Member, Reason, State
from swarmd.network.discovery import MembersView

MakeMember = Callable[..., Member]


def line(member: Member) -> dict[str, str]:
    return dict(zip(HEADER, row(member), strict=True))


def test_shows_a_running_robot(make_member: MakeMember) -> None:
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


def test_shows_the_report_of_the_pattern_cut_to_its_column(make_member: MakeMember) -> None:
    assert line(make_member(report={}))["REPORT"] == "-"
    report = {"phase": "disperse", "opinion": 2, "distance": 1.4000000001}
    assert line(make_member(report=report))["REPORT"] == "phase disperse, opinion 2, distance 1.4"
    assert len(line(make_member(report={"text": "long " * 30}))["REPORT"]) == 60


def test_shows_what_protection_is_doing(make_member: MakeMember) -> None:
    for decision, word in (
        (DecisionSummary(), "clear"),
        (DecisionSummary(is_active=True), "active"),
        (DecisionSummary(is_active=True, is_recovering=True), "recovering"),
    ):
        assert line(make_member(decision=decision))["PROTECTION"] == word


def test_shows_the_reason_of_a_stopped_robot(make_member: MakeMember) -> None:
    shown = line(make_member(state=State.STOPPED, reason=Reason.STALE_SCAN, pattern=None))
    assert (shown["STATE"], shown["REASON"], shown["PATTERN"]) == ("stopped", "stale_scan", "-")


def test_marks_the_last_pattern_of_a_failed_robot(make_member: MakeMember) -> None:
    shown = line(make_member(condition=Condition.FAILED, age=38.0))
    assert (shown["STATE"], shown["PATTERN"], shown["SCAN"]) == ("failed", "drive?", "-")
    assert shown["SEEN"] == "38.0 s ago"


def test_a_robot_that_left_without_a_pattern_has_no_mark(make_member: MakeMember) -> None:
    shown = line(make_member(condition=Condition.LEFT, age=1.0, pattern=None))
    assert (shown["STATE"], shown["PATTERN"]) == ("left", "-")


def test_lists_a_robot_without_a_status() -> None:
    member = Member(robot="r1", instance="x", condition=Condition.ALIVE, age=0.0)
    assert line(member)["STATE"] == "no answer"


def notes(*members: Member, roster: tuple[str, ...] = ()) -> list[str]:
    view = MembersView(
        members={member.robot: member for member in members},
        answered=frozenset(member.robot for member in members),
        roster=frozenset(roster),
    )
    return list(health(view))


def test_without_problems_the_only_note_is_the_count(make_member: MakeMember) -> None:
    assert notes(make_member("r1"), make_member("r2")) == ["2/2 alive"]


def test_names_robots_that_failed_left_or_were_never_seen(make_member: MakeMember) -> None:
    found = notes(
        make_member("r1"),
        make_member("r2", condition=Condition.FAILED, age=5.0),
        make_member("r3", condition=Condition.LEFT, age=600.0),
        roster=("r1", "r4"),
    )
    assert found == [
        "1/4 alive",
        "failed: r2 (5.0 s ago)",
        "left: r3 (10 min ago)",
        "in the roster and never seen: r4",
    ]


def test_names_robots_with_a_lost_driver(make_member: MakeMember) -> None:
    lost = make_member("r2", health=Health(driver="no odometry for 2 s", driver_up=False))
    assert notes(make_member("r1"), lost)[1:] == ["driver lost: r2 (no odometry for 2 s)"]


def test_warns_that_anyone_on_an_open_network_can_drive(make_member: MakeMember) -> None:
    open_to_all = make_member("r2", profile="field")
    text = notes(make_member(profile="field", is_secured=True), open_to_all)[-1]
    assert "anyone on this network can drive these robots" in text
    assert notes(make_member(profile="field", is_secured=True)) == ["1/1 alive"]


def test_names_ids_of_two_daemons(make_member: MakeMember) -> None:
    view = MembersView(
        members={"r1": make_member()},
        answered=frozenset({"r1"}),
        duplicates={"r1": ("a", "b")},
    )
    assert list(health(view))[1].startswith("two daemons have one id: r1; ")


def test_names_robots_that_are_alive_and_do_not_answer(make_member: MakeMember) -> None:
    view = MembersView(
        members={"r1": make_member(), "r2": make_member("r2")}, answered=frozenset({"r1"})
    )
    assert list(health(view))[1] == "alive, but no answer: r2"
