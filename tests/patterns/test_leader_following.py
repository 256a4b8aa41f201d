"""Leader following: one robot of a chain and the robots before it."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.core.values import Inputs, Message, Neighbor, Outputs, Twist, Value
from swarmd.kit.behavior import Pattern
from swarmd.patterns.leader_following.pattern import LeaderFollowing
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestLeaderFollowing(PatternContract):
    pattern = LeaderFollowing


PLATFORM = TestLeaderFollowing.subject("burger").platform
# The robot itself is "robot-1".
FIRST, SECOND, BEHIND = "a-1", "b-1", "z-1"


def made(**params: Value) -> Pattern[Any]:
    return Subject(LeaderFollowing, PLATFORM, {"lag": 0.0, **params}).make()


def stepped(
    pattern: Pattern[Any], now: float, *near: tuple[str, float, float], said: str = ""
) -> Outputs:
    """A step with others at range and bearing; the robot `FIRST` says who leads."""
    neighbors = tuple(Neighbor(name, 0.0, far, bearing, 0.0) for name, far, bearing in near)
    messages = (Message(FIRST, "leader", said, 0.0),) if said else ()
    return pattern.step(Inputs(now, 0.1, neighbors=neighbors, messages=messages))


def test_the_gap_is_standstill_and_headway_times_speed() -> None:
    found = stepped(made(standstill=0.5, headway=2.0), 0.0, (FIRST, 0.8, 0.0))
    assert found.twist is not None
    assert found.twist.linear == pytest.approx(0.15)
    assert found.report["before"] == FIRST


def test_follows_the_last_of_those_before_it() -> None:
    found = stepped(made(), 0.0, (FIRST, 0.8, 0.0), (SECOND, 0.6, 0.3), (BEHIND, 0.4, 0.0))
    assert found.report["before"] == SECOND
    assert found.twist is not None
    assert found.twist.angular == pytest.approx(0.6)


def test_the_leader_that_is_named_is_first() -> None:
    found = stepped(made(leader=BEHIND), 0.0, (BEHIND, 0.8, 0.0))
    assert found.report["before"] == BEHIND


def test_turns_to_a_robot_behind_before_it_drives() -> None:
    twist = stepped(made(), 0.0, (FIRST, 2.0, 2.5)).twist
    assert twist is not None
    assert twist.linear == 0.0
    assert twist.angular > 0.0


def test_passes_the_id_of_the_leader_on() -> None:
    found = stepped(made(), 0.0, (FIRST, 0.8, 0.0), said="a-0")
    assert found.messages == {"leader": "a-0"}
    assert found.report["leader"] == "a-0"


def test_a_lost_leader_is_named_and_replaced_after_the_lease() -> None:
    pattern = made(lease=1.0, standstill=0.5)
    moving = stepped(pattern, 0.0, (FIRST, 0.8, 0.0), said=FIRST).twist
    assert stepped(pattern, 0.9).twist == Twist(moving.linear if moving else 0.0)
    found = stepped(pattern, 1.2)
    assert found.twist == Twist(0.11)
    assert found.report["lost"] == FIRST
    assert found.report["leader"] == "robot-1"


def test_waits_for_the_lease_before_it_leads_at_the_start() -> None:
    pattern = made(lease=1.0)
    assert [stepped(pattern, now).twist for now in (0.0, 0.9)] == [Twist(), Twist()]
    assert stepped(pattern, 1.1).twist == Twist(0.11)
