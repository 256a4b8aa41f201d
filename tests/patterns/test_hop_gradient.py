"""Hop gradient: one robot, and what it makes of its neighbours' words."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.core.values import Inputs, Message, Outputs, Value
from swarmd.patterns.hop_gradient.pattern import HopGradient
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestHopGradient(PatternContract):
    pattern = HopGradient


class Robot:
    """The robot `robot-1`, stepped every 0.5 s, so that each step sends."""

    def __init__(self, **params: Value) -> None:
        self.pattern = Subject(HopGradient, load_platform("burger"), params).make()
        self.now = 0.0

    def step(self, heard: dict[str, list[Value]] | None = None, *, after: float = 0.5) -> Outputs:
        self.now += after
        messages = tuple(Message(name, "hops", one, 0.0) for name, one in (heard or {}).items())
        return self.pattern.step(Inputs(self.now, after, messages=messages))


def place(found: Outputs) -> tuple[Value, Value]:
    return found.report["leader"], found.report["hops"]


def test_a_robot_alone_leads_and_counts_up() -> None:
    robot = Robot()
    first, second = robot.step(), robot.step()
    assert place(second) == ("robot-1", 0)
    assert (first.messages["hops"], second.messages["hops"]) == (
        [1, "robot-1", 0, 1],
        [1, "robot-1", 0, 2],
    )


def test_follows_the_lowest_id_and_is_a_hop_further_than_the_nearest_neighbour() -> None:
    robot = Robot()
    found = robot.step(
        {"x": [1, "robot-0", 4, 9], "y": [1, "robot-0", 2, 8], "z": [1, "robot-2", 0, 99]}
    )
    assert place(found) == ("robot-0", 3)
    assert found.messages["hops"] == [1, "robot-0", 3, 9]


def test_a_source_leads_whatever_its_id() -> None:
    assert place(Robot(source="here").step({"x": [1, "robot-0", 0, 9]})) == ("robot-1", 0)
    assert place(Robot().step({"x": [0, "robot-9", 1, 9]})) == ("robot-9", 2)


def test_without_a_source_there_is_no_gradient() -> None:
    found = Robot(source="elsewhere").step()
    assert place(found) == ("", -1)
    assert not found.messages


def test_a_leader_whose_count_stands_still_is_deposed_for_good() -> None:
    robot = Robot()
    for _ in range(10):
        assert place(robot.step({"x": [1, "robot-0", 0, 9]})) == ("robot-0", 1)
    robot.step({"x": [1, "robot-0", 0, 9]})
    assert place(robot.step({"x": [1, "robot-0", 0, 9]})) == ("robot-1", 0)
    assert place(robot.step({"x": [1, "robot-0", 0, 10]})) == ("robot-0", 1)


def test_a_neighbour_that_is_not_heard_any_more_is_no_way() -> None:
    robot = Robot()
    robot.step({"near": [1, "robot-0", 0, 1], "far": [1, "robot-0", 5, 1]})
    hops = [robot.step({"far": [1, "robot-0", 5, 2 + count]}).report["hops"] for count in range(12)]
    assert hops == [1] * 10 + [6] * 2


def test_a_restarted_leader_counts_on_from_what_the_others_remember() -> None:
    robot = Robot()
    found = robot.step({"x": [1, "robot-1", 1, 50]})
    assert found.messages["hops"] == [1, "robot-1", 0, 52]


@pytest.mark.parametrize(
    "value",
    [
        [1, "robot-0", 0],
        [2, "robot-0", 0, 1],
        [1, "robot-0", -1, 1],
        [1, 0, 0, 1],
        [1, "robot-0", 0, "1"],
        [1, "robot-0", 0, 1 << 50],
    ],
)
def test_a_malformed_message_is_ignored(value: list[Value]) -> None:
    assert place(Robot().step({"x": value})) == ("robot-1", 0)


def test_a_neighbour_that_names_ever_new_leaders_fills_no_memory() -> None:
    robot = Robot()
    pattern: Any = robot.pattern
    for k in range(3000):
        robot.step({"x": [1, f"robot-{k}x", 0, k], "y": [1, "robot-0", 0, 1]}, after=0.001)
    assert place(robot.step(after=0.001)) == ("robot-0", 1)
    assert len(pattern._counts) <= 1001
