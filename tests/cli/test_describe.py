"""All that a status holds is shown, in groups."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec

from swarmd.cli.describe import sections
from swarmd.core.messages import DecisionSummary, Member, Reason, Row, Status

MakeMember = Callable[..., Member]


def shown(member: Member) -> dict[str, dict[str, str]]:
    assert member.status is not None
    return {title: dict(rows) for title, rows in sections(member, member.status)}


def test_shows_parameters_with_their_sources(make_member: MakeMember) -> None:
    assert shown(make_member())["Parameters"] == {
        "speed": "0.2  from runtime",
        "turn": "0    from robot",
    }


def test_shows_the_requested_and_the_safe_command(make_member: MakeMember) -> None:
    rows = shown(make_member())["Protection"]
    assert rows["mode"] == "potential_field, active"
    assert rows["requested"] == "0.200 m/s, 0.000 rad/s"
    assert rows["safe"] == "0.100 m/s, 0.000 rad/s"
    assert rows["nearest"] == "0.61 m"


def test_shows_each_obstacle_that_limits_the_command(
    make_member: MakeMember,
) -> None:
    rows = (
        Row(math.radians(-30.4), 0.208, 0.0),
        Row(math.radians(-33.0), 0.208, 0.01),  # the same wall
        Row(math.pi, 0.4, 0.123),
    )
    decision = DecisionSummary(mode="barrier", is_active=True, is_recovering=True, rows=rows)
    member = make_member(decision=decision)
    assert member.status is not None
    shown_rows = dict(sections(member, member.status))["Protection"]
    assert shown_rows[0] == ("mode", "barrier, recovering")
    assert shown_rows[3:5] == [
        ("limited by", "an obstacle at -30 deg, 0.21 m, at most 0.00 m/s"),
        ("", "an obstacle at 180 deg, 0.40 m, at most 0.12 m/s"),
    ]


def test_shows_the_state_and_who_changed_it(make_member: MakeMember) -> None:
    member = make_member(reason=Reason.NO_REQUESTED_COMMAND, detail="thinks")
    assert shown(member)["State"] == {
        "state": "running for 3.0 s",
        "reason": "no_requested_command",
        "detail": "thinks",
        "pattern": "drive",
        "generation": "42",
        "revision": "7",
        "changed by": "ann@desk (run drive)",
    }


def test_shows_the_robot(make_member: MakeMember) -> None:
    rows = shown(make_member())["Robot"]
    assert rows["labels"] == "red"
    assert rows["driver"] == "simulated (up)"
    assert rows["up for"] == "2 min"


def test_shows_the_issuer_of_an_emergency_stop(estopped: Member) -> None:
    assert shown(estopped)["Emergency stops"] == {"e1": "by bob@desk, for swarm: smoke"}


def test_shows_readings(make_member: MakeMember) -> None:
    member = make_member(readings={"battery": 0.71, "battery_voltage": 11.5})
    assert shown(member)["Readings"] == {"battery": "0.71", "battery_voltage": "11.5"}


def test_shows_events_by_their_age(make_member: MakeMember) -> None:
    assert shown(make_member())["Events"] == {"3.0 s ago": "loading drive"}


def test_shows_every_field_of_a_status(make_member: MakeMember) -> None:
    """A new field of Status must be shown too."""
    member = make_member()
    assert member.status is not None
    text = repr(sections(member, member.status))
    left_out = {"robot", "has_left", "epoch", "is_secured"}  # in the title, or within other lines
    for field in msgspec.structs.fields(Status):
        value = getattr(member.status, field.name)
        if field.name not in left_out and isinstance(value, str) and value:
            assert value in text, field.name
    assert "revision" in text
    assert "without certificates" in text


def test_shows_no_minus_zero(make_member: MakeMember) -> None:
    rows = (Row(-0.001, -0.001, -0.001),)
    decision = DecisionSummary(requested_angular=-1e-5, safe_linear=-0.0, rows=rows)
    text = repr(shown(make_member(decision=decision, report={"turn": -0.0}, readings={"x": -0.0})))
    assert "-0" not in text
