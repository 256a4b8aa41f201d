"""Every standstill is explained in one sentence that says what to do."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from msgspec.structs import replace

from swarmd.cli.explain import obstacles, why
from swarmd.core.messages import Condition, DecisionSummary, Health, Member, Reason, Row, State

MakeMember = Callable[..., Member]


@pytest.mark.parametrize("reason", Reason)
def test_there_is_a_sentence_for_every_reason(make_member: MakeMember, reason: Reason) -> None:
    text = why(make_member(state=State.STOPPED, reason=reason, detail="the detail"))
    assert text.startswith("stopped: ")
    assert "{" not in text
    assert "\n" not in text


def test_a_moving_robot_is_said_to_move(make_member: MakeMember) -> None:
    assert why(make_member()) == "running drive, and moves"


@pytest.mark.parametrize(
    "reason", [Reason.NO_SCAN, Reason.STALE_SCAN, Reason.STALE_ODOMETRY, Reason.DRIVER_LOST]
)
def test_a_sense_that_is_missing_is_told_in_the_words_of_the_driver(
    make_member: MakeMember, reason: Reason
) -> None:
    said = "/scan is announced but silent; look at the sensor: ros2 topic hz /scan"
    text = why(make_member(reason=reason, health=Health(driver=said)))
    assert f"({said})" in text


def test_an_emergency_stop_names_its_issuer_and_the_way_out(estopped: Member) -> None:
    assert why(estopped) == (
        "estopped: it was emergency-stopped by bob@desk; `swarmctl reset r2` clears that"
    )


def test_a_robot_that_protection_holds_says_how_near_the_obstacle_is(
    make_member: MakeMember,
) -> None:
    text = why(make_member(reason=Reason.PROTECTION))
    assert text == (
        "running drive, and stands: protection holds it: the nearest obstacle is 0.61 m away"
    )


def test_a_robot_that_is_bounded_says_by_what(make_member: MakeMember) -> None:
    rows = (Row(math.radians(-30.2), 0.214, 0.0), Row(0.0, 0.3, 0.1))
    held = DecisionSummary(mode="barrier", is_active=True, rows=rows, min_gap=0.21)
    where = "limited by an obstacle at -30 deg, 0.21 m"
    text = why(make_member(decision=held, reason=Reason.PROTECTION))
    assert text == f"running drive, and stands: protection holds it, {where}"
    assert why(make_member(decision=held)) == f"running drive, and moves, {where}"
    recovering = replace(held, is_recovering=True)
    text = why(make_member(decision=recovering))
    assert text == f"running drive, and moves around what blocks it, {where}"


def test_obstacles_are_told_once_each_and_never_at_minus_zero() -> None:
    rows = (Row(-0.001, -0.004, 0.0), Row(math.radians(9.0), 0.1, 0.1), Row(3.14, 0.2, 0.1),
            Row(-3.14, 0.2, 0.1))  # fmt: skip
    told = [text for text, _ in obstacles(rows)]
    assert told == ["an obstacle at 0 deg, 0.00 m", "an obstacle at 180 deg, 0.20 m"]


def test_a_failed_robot_says_since_when_and_how_it_was(make_member: MakeMember) -> None:
    text = why(make_member(condition=Condition.FAILED, age=38.0))
    assert text == (
        "failed 38.0 s ago; last known: running; `swarmctl members forget r1` takes it off the list"
    )


def test_a_robot_without_a_status_is_to_be_asked_again() -> None:
    member = Member(robot="r1", instance="x", condition=Condition.ALIVE, age=0.0)
    assert why(member) == "alive, but it has not told how it is yet; ask again"


def test_a_hold_that_has_lasted_is_told_as_past_and_with_the_way_on(
    make_member: MakeMember,
) -> None:
    text = why(make_member(state=State.STOPPED, reason=Reason.STALE_SCAN, detail="for 2 s"))
    assert text == (
        "stopped: scans stopped coming (for 2 s);"
        " when that is mended, `swarmctl run PATTERN r1` starts it again"
    )
