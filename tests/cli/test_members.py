"""The table of members and what it says of those that are not well."""

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


def test_shows_what_a_pattern_reports_as_far_as_there_is_room(make_member: MakeMember) -> None:
    assert line(make_member(report={}))["REPORT"] == "-"
    told = {"phase": "disperse", "opinion": 2, "distance": 1.4000000001}
    assert line(make_member(report=told))["REPORT"] == "phase disperse, opinion 2, distance 1.4"
    assert len(line(make_member(report={"text": "long " * 30}))["REPORT"]) == 60


def test_shows_what_protection_is_doing(make_member: MakeMember) -> None:
    for decision, word in (
        (DecisionSummary(), "clear"),
        (DecisionSummary(is_active=True), "active"),
        (DecisionSummary(is_active=True, is_recovering=True), "recovering"),
    ):
        assert line(make_member(decision=decision))["PROTECTION"] == word


def test_shows_why_a_robot_stands(make_member: MakeMember) -> None:
    shown = line(make_member(state=State.STOPPED, reason=Reason.STALE_SCAN, pattern=None))
    assert (shown["STATE"], shown["REASON"], shown["PATTERN"]) == ("stopped", "stale_scan", "-")


def test_marks_what_a_failed_robot_was_last_known_to_do(make_member: MakeMember) -> None:
    shown = line(make_member(condition=Condition.FAILED, age=38.0))
    assert (shown["STATE"], shown["PATTERN"], shown["SCAN"]) == ("failed", "drive?", "-")
    assert shown["SEEN"] == "38.0 s ago"


def test_has_no_pattern_to_mark_where_none_ran(make_member: MakeMember) -> None:
    shown = line(make_member(condition=Condition.LEFT, age=1.0, pattern=None))
    assert (shown["STATE"], shown["PATTERN"]) == ("left", "-")


def test_lists_a_robot_that_has_not_told_how_it_is() -> None:
    member = Member(robot="r1", instance="x", condition=Condition.ALIVE, age=0.0)
    assert line(member)["STATE"] == "no answer"


def notes(*members: Member, roster: tuple[str, ...] = ()) -> list[str]:
    view = MembersView(
        members={member.robot: member for member in members},
        answered=frozenset(member.robot for member in members),
        roster=frozenset(roster),
    )
    return list(health(view))


def test_says_nothing_but_the_count_if_all_are_well(make_member: MakeMember) -> None:
    assert notes(make_member("r1"), make_member("r2")) == ["2/2 alive"]


def test_names_who_failed_left_or_never_came(make_member: MakeMember) -> None:
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


def test_names_whose_driver_is_lost(make_member: MakeMember) -> None:
    lost = make_member("r2", health=Health(driver="no odometry for 2 s", driver_up=False))
    assert notes(make_member("r1"), lost)[1:] == ["driver lost: r2 (no odometry for 2 s)"]


def test_warns_that_anyone_on_an_open_network_can_drive(make_member: MakeMember) -> None:
    open_to_all = make_member("r2", profile="field")
    text = notes(make_member(profile="field", is_secured=True), open_to_all)[-1]
    assert "anyone on this network can drive these robots" in text
    assert notes(make_member(profile="field", is_secured=True)) == ["1/1 alive"]


def test_names_the_ids_that_two_daemons_hold(make_member: MakeMember) -> None:
    view = MembersView(
        members={"r1": make_member()},
        answered=frozenset({"r1"}),
        duplicates={"r1": ("a", "b")},
    )
    assert list(health(view))[1].startswith("two daemons have one id: r1; ")


def test_names_who_is_there_and_does_not_answer(make_member: MakeMember) -> None:
    view = MembersView(
        members={"r1": make_member(), "r2": make_member("r2")}, answered=frozenset({"r1"})
    )
    assert list(health(view))[1] == "alive, but no answer: r2"
