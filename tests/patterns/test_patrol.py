"""Patrol: one robot among its places, and what it hears of others."""

from __future__ import annotations

import math
from typing import Any

import pytest

from swarmd.core.errors import ParameterError
from swarmd.core.values import Inputs, Message, Outputs, Pose, Value
from swarmd.kit.behavior import Pattern
from swarmd.patterns.patrol.pattern import Patrol, places_of
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestPatrol(PatternContract):
    pattern = Patrol


PLATFORM = TestPatrol.subject("burger").platform
ROW = "0 0, 1 0, 2 0"


def made(**params: Value) -> Pattern[Any]:
    return Subject(Patrol, PLATFORM, {"places": ROW, **params}).make()


def stepped(pattern: Pattern[Any], now: float, pose: Pose, *said: list[Value]) -> Outputs:
    messages = tuple(Message(f"b{k}", "patrol", one, 0.0) for k, one in enumerate(said))
    return pattern.step(Inputs(now, 0.1, pose=pose, messages=messages))


def test_goes_to_the_place_that_was_left_alone_for_longest() -> None:
    # It begins at the first place; the second was visited 9 s ago, the third 5 s ago.
    found = stepped(made(), 10.0, Pose(), [0, 1.0, 9.0, 5.0])
    assert found.report == {"target": 1}


def test_leaves_a_place_alone_that_another_is_on_its_way_to() -> None:
    found = stepped(made(), 10.0, Pose(), [1, 1.0, 9.0, 5.0])
    assert found.report == {"target": 2}


def test_a_robot_that_is_not_heard_is_on_its_way_to_no_place() -> None:
    pattern = made(lease=5.0)
    stepped(pattern, 10.0, Pose(), [1, 1.0, 9.0, 5.0])
    assert stepped(pattern, 16.0, Pose(2.0, 0.0)).report == {"target": 1}


def test_places_beyond_the_reach_are_not_adjacent() -> None:
    found = stepped(made(reach=1.1), 10.0, Pose(), [0, 1.0, 1.0, 9.0])
    assert found.report == {"target": 1}


def test_tells_its_target_and_the_age_of_all_visits() -> None:
    pattern = made()
    stepped(pattern, 10.0, Pose(), [0, 1.0, 9.0, 5.0])
    found = stepped(pattern, 12.0, Pose(1.0, 0.0))  # it arrives
    assert found.report == {"target": 2}
    assert found.messages == {"patrol": [2, 3.0, 0.0, 7.0]}


@pytest.mark.parametrize("yaw", [0.0, 1.0, -3.0])
def test_turns_to_the_place_in_the_shared_frame(yaw: float) -> None:
    # It is 1 m left of the first place, with the heading yaw.
    pattern = made(places="0 0, 3 1", reach=10.0)
    found = stepped(pattern, 0.0, Pose(0.0, 1.0, yaw))
    assert found.report == {"target": 1}
    assert found.twist is not None
    bearing = math.remainder(-yaw, 2.0 * math.pi)
    assert found.twist.angular == pytest.approx(max(-2.84, min(2.84, 2.0 * bearing)), abs=1e-6)


def test_ages_that_are_no_numbers_are_ignored() -> None:
    found = stepped(made(), 10.0, Pose(), [0, math.nan, "x", -1.0], [7, 1.0, 1.0, 1.0], [0])
    assert found.report["target"] in (1, 2)


@pytest.mark.parametrize("text", ["", "1 2", "1 2, 3", "1 2, x y", "0 0, nan 1"])
def test_other_texts_are_no_places(text: str) -> None:
    with pytest.raises(ParameterError):
        made(places=text)


def test_places_are_pairs_of_numbers() -> None:
    assert places_of("1 -2.5,3 4") == [(1.0, -2.5), (3.0, 4.0)]


def test_stands_and_says_nothing_without_a_fresh_pose() -> None:
    assert made().step(Inputs(1.0, 0.1)) == Outputs()
