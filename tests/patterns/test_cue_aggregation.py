"""Cue aggregation: one robot that meets a robot or a wall."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.core.values import Inputs, Scan, Twist, Value
from swarmd.kit.behavior import Pattern
from swarmd.patterns.cue_aggregation.pattern import CueAggregation
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, empty_scan, scan_of


class TestCueAggregation(PatternContract):
    pattern = CueAggregation


PLATFORM = TestCueAggregation.subject("burger").platform
NOTHING = empty_scan(PLATFORM, 0, 0.0)
ROBOT = scan_of(PLATFORM, [Disc(0.35, 0.05, 0.08)], seq=1)
WALL = scan_of(PLATFORM, room=0.7, seq=2)


def made(**params: Value) -> Pattern[Any]:
    return Subject(CueAggregation, PLATFORM, params).make()


def states(pattern: Pattern[Any], scan: Scan, degrees: float, seconds: float) -> list[str]:
    """Its states, ten a second."""
    steps = (
        pattern.step(Inputs(0.1 * k, 0.1, scan, k == 0, readings={"temperature": degrees}))
        for k in range(round(10 * seconds))
    )
    return [str(found.report["state"]) for found in steps]


def test_drives_straight_where_nothing_is_near() -> None:
    found = made().step(Inputs(0.0, 0.1, NOTHING, True, readings={"temperature": 30.0}))
    assert found.twist == Twist(0.22)


@pytest.mark.parametrize(("degrees", "wait"), [(20.0, 0.0), (28.0, 5.0), (44.0, 9.0)])
def test_waits_the_longer_the_warmer_it_is(degrees: float, wait: float) -> None:
    # 10 s at most, half of it at 8 above 20: c^2 / (c^2 + 8^2)
    found = states(made(wait=10.0), ROBOT, degrees, 10.0)
    assert found.count("wait") == pytest.approx(10 * wait, abs=1)
    assert "turn" in found


def test_turns_from_a_wall_without_a_wait() -> None:
    found = states(made(), WALL, 40.0, 3.0)
    assert "wait" not in found
    assert found[0] == "turn"


def test_turns_away_from_the_robot_that_it_met() -> None:
    pattern = made(wait=0.0)
    states(pattern, ROBOT, 30.0, 0.1)
    found = pattern.step(Inputs(0.1, 0.1, ROBOT, False, readings={"temperature": 30.0}))
    assert found.twist is not None
    assert found.twist.angular < 0.0  # the robot is on the left


def test_meets_no_robot_for_a_time_after_a_turn() -> None:
    found = states(made(wait=0.5, refractory=3.0, turn=2.8), ROBOT, 60.0, 4.5)
    assert found.count("wait") <= 6
