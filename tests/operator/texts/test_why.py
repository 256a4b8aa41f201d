"""Each reason why a robot does not move is explained, with what to do."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from swarmd.core.messages import (
    DecisionSummary,
    Health,
    Latch,
    LimitingObstacle,
    Presence,
    Reason,
    SetDown,
    State,
    WallsStandSummary,
)
from swarmd.operator.session.members_view import Contact, SeenMember
from swarmd.operator.texts.why import absence, obstacles, standing_time, stop_text, why
from tests.support.statuses import ESTOPPED, make_member, status

ROOT = Path(__file__).resolve().parents[3]


def test_there_is_a_sentence_for_every_reason() -> None:
    states = State.STOPPED, State.RUNNING
    texts = {
        (reason, state): why(make_member(state=state, reason=reason, detail="the detail"))
        for reason, state in itertools.product(Reason, states)
    }
    wrong = [
        text
        for (_, state), text in texts.items()
        if not text.startswith(f"{state.value}") or "{" in text or "\n" in text
    ]
    assert wrong == []


@pytest.mark.parametrize(
    "reason", [Reason.NO_SCAN, Reason.STALE_SCAN, Reason.STALE_ODOMETRY, Reason.DRIVER_LOST]
)
def test_the_diagnosis_of_the_driver_is_quoted(reason: Reason) -> None:
    diagnosis = "/scan is announced but silent; look at the sensor: ros2 topic hz /scan"
    assert f"({diagnosis})" in why(make_member(reason=reason, health=Health(driver=diagnosis)))


@pytest.mark.parametrize(
    ("state", "reason"),
    [
        (State.ESTOPPED, Reason.ESTOP),
        (State.STOPPED, Reason.DRIVER_LOST),
        (State.IDLE, Reason.RESET),
    ],
)
def test_a_standing_robot_whose_base_others_drive_says_so(state: State, reason: Reason) -> None:
    words = "someone else drives: commands on /cmd_vel"
    lost = make_member(state=state, reason=reason, health=Health(driver=words))
    assert why(lost).endswith(f"; driver lost: {words}")
    well = make_member(state=state, reason=reason, health=Health(driver="there", driver_up=True))
    assert "driver lost" not in why(well)


def test_an_emergency_stop_names_its_issuer_and_the_reset() -> None:
    text = why(ESTOPPED)
    assert "emergency stop by bob@desk, 12.0 s ago, for swarm: smoke; " in text
    assert "`swarmctl reset r2`" in text


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "by bob, 12.0 s ago, for swarm: smoke"),
        ({"reason": ""}, "by bob, 12.0 s ago, for swarm, without a reason"),
        ({"age": None}, "by bob, at an unknown time, for swarm: smoke"),
        ({"age": 7200.0}, "by bob, 2 h ago, for swarm: smoke"),
        ({"reason": "a\nb\x1b[2J\u202ec\u2066"}, "by bob, 12.0 s ago, for swarm: a?b?[2J?c?"),
        ({"issuer": "b\rob\u200f"}, "by b?ob?, 12.0 s ago, for swarm: smoke"),
        ({"reason": "<b>שלום</b>"}, "by bob, 12.0 s ago, for swarm: <b>שלום</b>"),
        ({"reason": "x" * 1000}, f"by bob, 12.0 s ago, for swarm: {'x' * 253}..."),
    ],
)
def test_who_when_and_why_of_an_emergency_stop_are_one_bounded_line(
    changes: dict[str, Any], words: str
) -> None:
    latch = Latch(issuer="bob", scope="swarm", reason="smoke", age=12.0)
    assert stop_text(replace(latch, **changes)) == words


def test_a_flood_of_emergency_stops_leaves_a_sentence() -> None:
    latch = Latch(issuer="i" * 128, scope="swarm", reason="r" * 1000, age=1.0)
    flood = {f"e{number}": latch for number in range(33)}
    text = why(make_member(state=State.ESTOPPED, reason=Reason.ESTOP, latches=flood))
    assert "; and 30 more; clear it" in text
    assert len(text) < 1400


def test_a_state_under_emergency_stops_began_with_the_first_of_known_time() -> None:
    latches = [Latch(issuer="bob", scope="swarm", age=age) for age in (3.0, 7.0, None)]
    assert standing_time(status(since=2.0)) == 2.0
    assert standing_time(status(since=2.0, latches=dict(zip("abc", latches, strict=True)))) == 7.0
    assert standing_time(status(since=2.0, latches={"c": latches[2]})) is None


@pytest.mark.parametrize(
    ("changes", "is_held", "words"),
    [
        ({}, False, "moving"),
        ({"is_active": True}, False, "moving, limited by an obstacle at -30 deg, 0.21 m"),
        (
            {"is_active": True, "is_recovering": True},
            False,
            "moving around an obstacle, limited by an obstacle at -30 deg, 0.21 m",
        ),
        (
            {"is_active": True, "avoiding": "avoiding tb3-04"},
            False,
            "moving, avoiding tb3-04, limited by an obstacle at -30 deg, 0.21 m",
        ),
        ({"is_active": True}, True, "protection holds it, limited by an obstacle at -30 deg"),
        ({"min_gap": 0.61}, True, "0.61 m away"),
        ({"avoiding": "gives way at an opening"}, True, "not moving: gives way at an opening"),
    ],
)
def test_the_obstacle_that_limits_a_robot_is_named(
    changes: dict[str, Any], is_held: bool, words: str
) -> None:
    rows = (LimitingObstacle(math.radians(-30.2), 0.214, 0.0), LimitingObstacle(0.0, 0.3, 0.1))
    decision = DecisionSummary(rows=rows if "is_active" in changes else (), **changes)
    text = why(make_member(decision=decision, reason=Reason.PROTECTION if is_held else None))
    assert text.startswith("running drive, not moving: " if is_held else "running drive, moving")
    assert words in text


def test_each_obstacle_is_given_once_and_never_at_minus_zero() -> None:
    rows = [
        LimitingObstacle(-0.001, -0.004, 0.0),
        LimitingObstacle(math.radians(9.0), 0.1, 0.1),
        LimitingObstacle(3.14, 0.2, 0.1),
        LimitingObstacle(-3.14, 0.2, 0.1),
    ]
    texts = [text for text, _ in obstacles(rows)]
    assert texts == ["an obstacle at 0 deg, 0.00 m", "an obstacle at 180 deg, 0.20 m"]


def test_a_failed_robot_has_its_age() -> None:
    text = why(make_member(presence=Presence.FAILED, age=38.0))
    assert text.startswith("failed 38.0 s ago; ")
    assert "`swarmctl members forget r1`" in text


def test_a_hold_that_lasted_is_in_the_past_tense() -> None:
    lasting = make_member(state=State.STOPPED, reason=Reason.STALE_SCAN, detail="for 2 s")
    assert why(lasting).startswith("stopped: scans stopped arriving (for 2 s); ")
    assert "`swarmctl run PATTERN r1`" in why(lasting)


@pytest.mark.parametrize(
    ("fields", "text", "short"),
    [
        ({"contact": Contact.NO_ANSWER}, "heard 3.0 s ago, no answer", "heard, no answer"),
        (
            {"contact": Contact.UNREACHABLE, "by": "r2"},
            "alive by r2's word, 3.0 s ago, not reachable from here",
            "alive by r2's word, not reachable from here",
        ),
        ({"contact": Contact.GONE, "presence": Presence.FAILED}, "failed, 3.0 s ago", "failed"),
        (
            {"contact": Contact.OTHER_VERSION, "state": "running", "version": "9"},
            *("running, of another version: 9",) * 2,
        ),
    ],
)
def test_what_is_known_of_a_robot_without_a_status(
    fields: dict[str, Any], text: str, short: str
) -> None:
    about = {"presence": Presence.ALIVE, **fields}
    member = SeenMember(robot="r1", instance="i", age=3.0, **about)
    assert absence(member) == text
    assert absence(member, has_age=False) == short
    assert absence(None) == "not seen by any robot"


def test_the_page_of_the_robot_has_each_hold_once() -> None:
    """Holds are the reasons between two comments of `Reason`."""
    source = (ROOT / "swarmd/core/messages.py").read_text()
    holds = source.partition("    # holds: ")[2].partition("    # running")[0]
    page = (ROOT / "docs/architecture/robot.md").read_text()
    table = page.partition("\n### Holds\n")[2].partition("\n## ")[0]
    rows = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    named = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert sorted(named) == sorted(re.findall(r'= "(\w+)"', holds))


def standing_beside_wall(**changes: Any) -> str:
    """Why a robot stands that an obstacle 0.30 m away on its left limits."""
    decision = DecisionSummary(
        requested_linear=0.3, is_active=True, rows=(LimitingObstacle(math.pi / 2.0, 0.3, 0.0),)
    )
    place = SetDown(gap=0.395, unseen=0.24)
    fields = {"reason": Reason.PROTECTION, "decision": decision, "set_down": place, **changes}
    return why(make_member(**fields))


def test_a_robot_that_is_held_for_long_names_cause_and_remedy() -> None:
    text = standing_beside_wall(held_for=12.0)
    assert re.findall(r"[\d.]+ (?:m|s|deg)\b", text) == [
        *("90 deg", "0.30 m", "12.0 s", "0.24 m", "0.40 m"),
    ]
    assert "`walls_stand`" in text
    assert "0.40 m" not in standing_beside_wall(held_for=None)


def test_the_remedy_names_the_circle_of_a_lidar_which_no_declaration_takes_away() -> None:
    place = SetDown(gap=0.735, lidar=0.92, unseen=0.29)
    text = standing_beside_wall(held_for=12.0, set_down=place)
    assert "0.74 m" in text
    assert "0.92 m" in text
    assert "walls_stand" not in text


def test_the_remedy_names_no_declaration_that_is_made() -> None:
    declared = WallsStandSummary(length=1.0, seconds=2.0)
    assert "walls_stand" not in standing_beside_wall(held_for=12.0, walls_stand=declared)


def test_a_mode_without_such_a_distance_names_none() -> None:
    text = standing_beside_wall(held_for=12.0, set_down=None)
    assert re.findall(r"[\d.]+ m\b", text) == ["0.30 m"]
    assert "walls_stand" not in text
