"""All that a status holds is shown, in groups."""

from __future__ import annotations

import math
import re
from typing import Any

import msgspec
import pytest

from swarmd.core.messages import (
    BatterySummary,
    DecisionSummary,
    DelayFigure,
    FenceSummary,
    LimitingObstacle,
    Member,
    NarrowestPassage,
    PeerFault,
    Reason,
    Sandbox,
    ScanDelaySummary,
    State,
    Status,
)
from swarmd.operator.texts.status import passage_text, sections, sections_with_events
from swarmd.operator.texts.values import sandbox_text
from tests.support.statuses import ESTOPPED, make_member


def shown(member: Member) -> dict[str, dict[str, str]]:
    assert member.status is not None
    return {title: dict(rows) for title, rows in sections(member, member.status)}


def test_shows_the_status_in_groups() -> None:
    member = make_member(
        reason=Reason.NO_REQUESTED_COMMAND, detail="thinks", readings={"battery": 0.71}
    )
    groups = shown(member)
    assert groups["Parameters"] == {"speed": "0.2  from request", "turn": "0    from robot"}
    assert groups["Readings"] == {"battery": "0.71"}
    expected = {
        "Robot": {"labels": "red", "driver": "simulated (up)", "up for": "2 min"},
        "State": {"state": "running for 3.0 s", "revision": "7"},
        "Protection": {
            "mode": "potential_field, active",
            "requested": "0.200 m/s, 0.000 rad/s",
            "safe": "0.100 m/s, 0.000 rad/s",
            "nearest": "0.61 m",
        },
    }
    for group, rows in expected.items():
        assert rows.items() <= groups[group].items()
    assert shown(ESTOPPED)["Emergency stops"] == {"e1": "by bob@desk, 12.0 s ago, for swarm: smoke"}


def test_events_are_in_the_whole_status_alone() -> None:
    member = make_member()
    assert member.status is not None
    assert "Events" not in shown(member)
    *groups, last = sections_with_events(member, member.status)
    assert groups == sections(member, member.status)
    assert last == ("Events", [("3.0 s ago", "loading drive")])


def test_numbers_of_a_described_pattern_have_their_units() -> None:
    member = make_member(report={"left": 0.25, "state": "turn", "near": 3, "seen": True})
    units = {"left": "m", "state": "m", "seen": "m"}
    described = {"report_units": units, "params": [{"name": "speed", "unit": "m/s"}]}
    assert member.status is not None
    groups = dict(sections(member, member.status, described))
    assert groups["Report"] == [
        *(("left", "0.25 m"), ("state", "turn"), ("near", "3"), ("seen", "True"))
    ]
    assert dict(groups["Parameters"])["speed"] == "0.2 m/s  from request"


def test_shows_that_a_reading_is_stale() -> None:
    member = make_member(readings={"light": 0.5}, stale_readings=("temperature",))
    assert shown(member)["Readings"]["light"] == "0.5"
    assert shown(member)["Readings"]["temperature"].startswith("stale")


def test_shows_each_obstacle_that_limits_the_command() -> None:
    rows = (
        LimitingObstacle(math.radians(-30.4), 0.208, 0.0),
        LimitingObstacle(math.radians(-33.0), 0.208, 0.01),  # the same wall
        LimitingObstacle(math.pi, 0.4, 0.123),
        LimitingObstacle(1.0, 0.3, 0.05, age=0.314, age_cost=0.0961),
        LimitingObstacle(2.0, 0.3, 0.05, age=0.02, age_cost=0.004),
    )
    decision = DecisionSummary(mode="barrier", is_active=True, is_recovering=True, rows=rows)
    member = make_member(decision=decision)
    assert member.status is not None
    shown_rows = dict(sections(member, member.status))["Protection"]
    assert shown_rows[0] == ("mode", "barrier, recovering")
    assert shown_rows[3:7] == [
        ("limited by", "an obstacle at -30 deg, 0.21 m, at most 0.00 m/s"),
        ("", "an obstacle at 180 deg, 0.40 m, at most 0.12 m/s"),
        (
            "",
            "an obstacle at 57 deg, 0.30 m, at most 0.05 m/s; seen 0.31 s ago, which costs"
            " 0.10 m/s",
        ),
        ("", "an obstacle at 115 deg, 0.30 m, at most 0.05 m/s; seen 0.02 s ago"),
    ]


def test_shows_every_field_of_a_status() -> None:
    """A new field of Status must be shown too."""
    member = make_member()
    assert member.status is not None
    text = repr(sections(member, member.status))
    for field in msgspec.structs.fields(Status):
        value = getattr(member.status, field.name)
        if field.name != "robot" and isinstance(value, str) and value:  # the robot: in the title
            assert value in text, field.name
    assert "insecure" in text


def test_a_report_is_the_last_one_once_the_run_has_ended() -> None:
    assert shown(make_member())["Report"] == {"opinion": "2"}
    ended = shown(make_member(state=State.STOPPED, reason=Reason.OPERATOR, since=3.0))
    assert "Report" not in ended
    assert ended["Last report (the run has ended: stopped for 3.0 s)"] == {"opinion": "2"}


def test_shows_no_minus_zero() -> None:
    rows = (LimitingObstacle(-0.001, -0.001, -0.001),)
    decision = DecisionSummary(requested_angular=-1e-5, safe_linear=-0.0, rows=rows)
    text = repr(shown(make_member(decision=decision, report={"turn": -0.0}, readings={"x": -0.0})))
    assert "-0" not in text


def test_shows_the_lateral_speed_of_a_base_that_slides_sideways() -> None:
    decision = DecisionSummary(requested_lateral=0.25, safe_lateral=-0.125)
    member = make_member(decision=decision)
    assert member.status is not None
    rows = dict(dict(sections(member, member.status))["Protection"])
    assert ("0.250" in rows["requested"], "-0.125" in rows["safe"]) == (True, True)


def test_shows_how_late_scans_arrive_and_what_is_used() -> None:
    figures = (
        DelayFigure(method="stamps", delay=0.18, spread=0.004, samples=20, age=0.1),
        DelayFigure(method="turns", text="it has not turned"),
    )
    delay = ScanDelaySummary(declared=0.1, added=0.082, bound=0.4, figures=figures)
    member = make_member(scan_delay=delay)
    assert member.status is not None
    rows = dict(sections(member, member.status))["Protection"]
    first = rows.index(("scan delay", "declared 100 ms, used 182 ms, hold beyond 500 ms"))
    assert "0.180 s +- 0.004 s, 20 samples" in rows[first + 1][1]
    assert "turns: not known: it has not turned" in rows[first + 2][1]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"clearance": 0.5, "error": 0.02}, "0.50 m inside (+- 0.02 m), in frame mocap"),
        (
            {"clearance": -0.5, "error": 0.02, "limits": True},
            "0.50 m outside (+- 0.02 m), in frame mocap; limits the command",
        ),
        ({"text": "too old"}, "in frame mocap; the robot stands: too old"),
        ({"text": "too old", "holds": False}, "in frame mocap; it does not limit: too old"),
    ],
)
def test_the_place_against_the_fence_is_told(changes: dict[str, Any], text: str) -> None:
    member = make_member(fence=FenceSummary(frame="mocap", **changes))
    assert member.status is not None
    assert ("fence", text) in dict(sections(member, member.status))["Protection"]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"charge": 0.62}, "0.62; below 0.2 the robot stands"),
        ({"charge": None, "pattern": "home"}, "no fresh reading; below 0.2 the robot runs home"),
        ({"charge": 0.25, "is_low": True}, "0.25: low, since it was below 0.2"),
        (
            {"charge": 0.1, "is_low": True, "pattern": "home", "runs": True},
            "0.10: low, since it was below 0.2; the robot runs home",
        ),
    ],
)
def test_the_battery_is_told(changes: dict[str, Any], text: str) -> None:
    member = make_member(battery=BatterySummary(**{"below": 0.2, "is_low": False, **changes}))
    assert member.status is not None
    assert ("battery", text) in dict(sections(member, member.status))["State"]


def test_the_words_of_the_platform_are_told() -> None:
    words = {"stop": "hovers, and lands after land_after", "estop": "lands at once"}
    member = make_member(words=words)
    assert member.status is not None
    assert dict(sections(member, member.status))["Meaning of words"] == [*words.items()]


def test_shows_the_share_of_the_speed_after_a_violated_assumption() -> None:
    member = make_member(decision=DecisionSummary(mode="barrier", is_active=True, speed_share=0.6))
    assert member.status is not None
    rows = dict(sections(member, member.status))["Protection"]
    assert rows[0] == ("mode", "barrier, active, speed 60%")


def test_what_a_pattern_host_is_denied_and_what_not() -> None:
    assert sandbox_text(Sandbox(denied=("files", "network"))) == "files, network denied"
    open_host = Sandbox(denied=("network",), missing="files: no Landlock")
    assert "files: no Landlock" in sandbox_text(open_host)
    assert "denied:" not in sandbox_text(Sandbox(denied=("files",)))


def test_findings_of_the_assumption_monitor_are_lines_of_protection() -> None:
    found = ("braked at 0.60 +- 0.02 m/s2 in 3 stops, declared 1.00", "2 things came at 0.60 m/s")
    member = make_member(findings=found)
    assert member.status is not None
    lines = dict(sections(member, member.status))["Protection"]
    assert ("findings", found[0]) in lines
    assert ("", found[1]) in lines


def test_shows_floats_in_short() -> None:
    report = {"width": 0.833607, "far": 12345.678, "whole": 3.0, "count": 123456}
    assert shown(make_member(report=report))["Report"] == {
        "width": "0.8336",
        "far": "12345.7",
        "whole": "3",
        "count": "123456",
    }


def test_the_narrowest_passages_are_rounded_up_and_explained() -> None:
    text = passage_text(NarrowestPassage(door=0.951, corridor=0.96, meeting=1.8201))
    assert re.findall(r"[\d.]+ m", text) == ["0.96 m", "0.96 m", "1.83 m"]
    assert "gap" in text


def test_shows_the_faults_that_peers_tell_with_their_robots() -> None:
    fault = PeerFault(robot="r3", kind="deaf", by=4, of=5, since=7.0)
    ((robot, text),) = shown(make_member(peer_faults=(fault,)))["Told by peers"].items()
    assert robot == "r3"
    assert [word in text for word in ("deaf", "4 of 5", "7")] == [True] * 3
