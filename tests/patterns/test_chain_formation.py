"""Chain formation: one robot among members that it hears and senses."""

from __future__ import annotations

import math
from typing import Any

import pytest

from swarmd.core.values import Inputs, Message, Neighbor, Outputs, Twist, Value
from swarmd.patterns.chain_formation.pattern import ChainFormation
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import empty_scan


class TestChainFormation(PatternContract):
    pattern = ChainFormation


PLATFORM = TestChainFormation.subject("burger").platform
SCAN = empty_scan(PLATFORM, 0, 0.0)
SURE = 10.0  # 1/s: in a step of 0.1 s it happens
Other = tuple[float, float, list[Value]]
"""The distance and bearing of another robot, and what it tells."""
NEST: list[Value] = [0, "", False]
GOAL: list[Value] = [-1, "", True]


class Robot:
    """The robot `robot-1`, stepped at 10 Hz; its members are 0.6 m apart."""

    def __init__(self, **params: Value) -> None:
        self.pattern: Any = Subject(ChainFormation, PLATFORM, {"distance": 0.6, **params}).make()
        self.now = 0.0

    def step(self, **others: Other) -> Outputs:
        """A step with others by name: distance, bearing and what each tells."""
        self.now += 0.1
        found: Outputs = self.pattern.step(
            Inputs(
                self.now,
                0.1,
                SCAN,
                True,
                None,
                tuple(Neighbor(k, 0.0, far, bearing) for k, (far, bearing, _) in others.items()),
                tuple(Message(k, "chain", told, 0.0) for k, (_, _, told) in others.items()),
            )
        )
        return found

    def joined(self, **others: Other) -> Outputs:
        """The step after it has joined."""
        for _ in range(3):
            found = self.step(**others)
        assert found.report["state"] == "chain"
        return found


@pytest.mark.parametrize(("role", "hops"), [("nest", 0), ("goal", -1)])
def test_the_ends_stand_and_tell_what_they_are(role: str, hops: int) -> None:
    found = Robot(role=role).step()
    assert found.twist == Twist()
    assert found.messages == {"chain": [hops, "", False]}


def test_searches_while_no_member_is_sensed() -> None:
    found = Robot().step()
    assert found.report["state"] == "search"
    assert not found.messages


def test_drives_to_the_nest_and_joins_it_at_the_distance() -> None:
    robot = Robot(join=SURE)
    found = robot.step(nest=(1.2, 0.0, NEST))
    assert found.report["state"] == "explore"
    assert found.twist is not None
    assert found.twist.linear > 0.0
    found = robot.step(nest=(0.6, 0.0, NEST))
    assert found.messages == {"chain": [1, "nest", False]}
    assert robot.joined(nest=(0.6, 0.0, NEST)).report["hops"] == 1


def test_joins_at_the_tail_and_is_a_hop_farther() -> None:
    chain: dict[str, Other] = {"nest": (1.2, 0.0, NEST), "a": (0.6, 0.0, [1, "nest", False])}
    robot = Robot(join=SURE)
    assert robot.joined(**chain).report["hops"] == 2


def test_passes_members_that_have_one_behind_them() -> None:
    robot = Robot(join=SURE)
    found = robot.step(a=(0.6, 0.0, [1, "nest", False]), b=(0.7, 1.5, [2, "a", False]))
    assert found.report["state"] == "explore"
    assert found.twist is not None
    assert found.twist.angular > 0.0


def test_joins_nowhere_nearer_to_a_member() -> None:
    robot = Robot(join=SURE)
    found = [robot.step(a=(0.4, 0.0, [1, "nest", False])) for _ in range(20)]
    assert {one.report["state"] for one in found} == {"explore"}


def test_the_tail_leaves_by_chance_and_a_member_inside_does_not() -> None:
    robot = Robot(join=SURE, leave=SURE)
    robot.joined(a=(0.6, 0.0, [1, "nest", False]), b=(0.6, math.pi, [3, "robot-1", False]))
    found = robot.step(a=(0.6, 0.0, [1, "nest", False]), b=(0.6, math.pi, [3, "robot-1", False]))
    assert found.report["state"] == "chain"
    robot.now += 3.0  # b is not heard any more
    assert robot.step(a=(0.6, 0.0, [1, "nest", False])).report["state"] == "home"


def test_a_tail_that_sees_the_goal_stays_and_tells_so() -> None:
    robot = Robot(join=SURE, leave=SURE, sight=0.9)
    ends: dict[str, Other] = {"a": (0.6, math.pi, [1, "nest", False]), "goal": (0.8, 0.0, GOAL)}
    for _ in range(20):
        found = robot.step(**ends)
    assert found.report == {"state": "chain", "hops": 2, "leads": True}


def test_a_member_tells_what_those_behind_it_found() -> None:
    robot = Robot(join=SURE)
    nest: dict[str, Other] = {"nest": (0.6, math.pi, NEST)}
    robot.joined(**nest)
    assert robot.step(**nest, b=(0.6, 0.0, [2, "robot-1", True])).report["leads"]
    assert not robot.step(**nest, b=(0.6, 0.0, [2, "other", True])).report["leads"]


def test_a_member_keeps_its_distance_in_line() -> None:
    robot = Robot(join=SURE, leave=0.0)
    robot.joined(a=(0.6, 0.0, [1, "nest", False]), nest=(1.2, 0.0, NEST))
    rests = robot.step(a=(0.62, 0.0, [1, "nest", False]), nest=(1.22, 0.0, NEST))
    far = robot.step(a=(0.9, 0.0, [1, "nest", False]), nest=(1.5, 0.0, NEST))
    assert rests.twist == Twist()
    assert far.twist is not None
    assert far.twist.linear > 0.0


def test_a_member_of_a_chain_that_leads_to_the_goal_stands() -> None:
    robot = Robot(join=SURE, leave=0.0)
    robot.joined(nest=(0.6, 0.0, NEST))
    found = robot.step(nest=(0.9, 0.0, NEST), b=(0.6, math.pi, [2, "robot-1", True]))
    assert found.twist == Twist()
    assert found.report["leads"]


def test_of_two_members_at_one_place_the_higher_id_leaves() -> None:
    a: Other = (0.6, 0.0, [1, "nest", False])
    lower, higher = Robot(join=SURE, leave=0.0), Robot(join=SURE, leave=0.0)
    lower.joined(a=a)
    higher.joined(a=a)
    assert lower.step(a=a, z=(0.1, 1.0, [2, "a", False])).report["state"] == "chain"
    assert higher.step(a=a, c=(0.1, 1.0, [2, "a", False])).report["state"] == "home"


def test_of_two_members_at_one_place_the_one_that_leads_to_the_goal_stays() -> None:
    nest: Other = (0.6, math.pi, NEST)
    leading, other = Robot(join=SURE, leave=0.0), Robot(join=SURE, leave=0.0)
    leading.joined(nest=nest)
    other.joined(nest=nest)
    found = leading.step(nest=nest, goal=(0.5, 0.0, GOAL), c=(0.1, 1.0, [1, "nest", False]))
    assert found.report == {"state": "chain", "hops": 1, "leads": True}
    assert other.step(nest=nest, z=(0.1, 1.0, [1, "nest", True])).report["state"] == "home"


def test_of_two_members_at_one_place_the_one_with_a_chain_behind_it_stays() -> None:
    nest: Other = (0.6, 0.0, NEST)
    long, tail = Robot(join=SURE, leave=0.0), Robot(join=SURE, leave=0.0)
    long.joined(nest=nest)
    tail.joined(nest=nest)
    behind: Other = (0.6, math.pi, [2, "robot-1", False])
    found = long.step(nest=nest, a=(0.1, 1.0, [1, "nest", False]), b=behind)
    assert found.report["state"] == "chain"
    other: dict[str, Other] = {
        "z": (0.1, 1.0, [1, "nest", False]),
        "b": (0.6, 2.0, [2, "z", False]),
    }
    assert tail.step(nest=nest, **other).report["state"] == "home"


def test_a_member_whose_member_before_is_gone_leaves() -> None:
    robot = Robot(join=SURE, leave=0.0)
    robot.joined(nest=(0.6, 0.0, NEST))
    robot.step()
    assert robot.step().report["state"] != "chain"


def test_the_chain_turns_about_the_nest_until_it_leads() -> None:
    nest: dict[str, Other] = {"nest": (0.6, math.pi / 2.0, NEST)}
    turning, standing = Robot(join=SURE, leave=0.0), Robot(join=SURE, leave=0.0, sweep=0.0)
    turning.joined(**nest)
    standing.joined(**nest)
    moving = turning.step(**nest).twist
    assert moving is not None
    assert moving.linear != 0.0
    assert standing.step(**nest).twist == Twist()
    found = turning.step(**nest, goal=(0.5, 0.0, GOAL))
    assert found.report["leads"]


def test_an_explorer_rests_at_the_tail_of_a_chain_that_leads_to_the_goal() -> None:
    robot = Robot(join=SURE)
    chain: dict[str, Other] = {"nest": (1.2, math.pi, NEST), "a": (0.6, math.pi, [1, "nest", True])}
    found = [robot.step(**chain) for _ in range(5)][-1]
    assert found.report["state"] == "rest"
    assert found.twist == Twist()


@pytest.mark.parametrize(
    "value",
    [[1, "nest"], [-2, "", False], [1, 2, False], ["1", "nest", False], [1, "nest", 1]],
)
def test_a_malformed_message_is_ignored(value: list[Value]) -> None:
    robot = Robot()
    assert robot.step(a=(0.6, 0.0, value)).report["state"] == "search"
