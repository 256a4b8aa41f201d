"""Shepherding: one robot of each role and those around it."""

from __future__ import annotations

import math

import pytest

from swarmd.core.values import Inputs, Message, Neighbor, Outputs, Twist, Value
from swarmd.patterns.shepherding.pattern import Shepherding
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestShepherding(PatternContract):
    pattern = Shepherding


PLATFORM = TestShepherding.subject("burger").platform


def stepped(*others: tuple[str, float, float], **params: Value) -> Outputs:
    """One step with others of a role at x and y in m; the spacing is 0.4 m."""
    pattern = Subject(Shepherding, PLATFORM, {"spacing": 0.4, **params}).make()
    neighbors = tuple(
        Neighbor(f"b{k}", 0.0, math.hypot(x, y), math.atan2(y, x), 0.0)
        for k, (_, x, y) in enumerate(others)
    )
    messages = tuple(Message(f"b{k}", "role", role, 0.0) for k, (role, _, _) in enumerate(others))
    return pattern.step(Inputs(0.0, 0.1, neighbors=neighbors, messages=messages))


def bearing(found: Outputs) -> float:
    """The bearing in rad of the way, of which the turn rate is twice."""
    assert found.twist is not None
    return 0.5 * found.twist.angular


def test_tells_its_role() -> None:
    assert stepped(role="shepherd").messages == {"role": "shepherd"}


def test_the_goal_stands_and_so_do_sheep_that_nothing_is_near() -> None:
    assert stepped(("shepherd", 0.5, 0.0), role="goal").twist == Twist()
    assert stepped(("shepherd", 2.5, 0.0), ("sheep", 1.0, 0.0)).twist == Twist()


def test_a_sheep_flees_a_shepherd_that_is_near() -> None:
    found = stepped(("shepherd", -2.0, 0.0))
    assert bearing(found) == pytest.approx(0.0)
    assert found.twist is not None
    assert found.twist.linear == pytest.approx(0.67 * 0.22)


def test_a_sheep_goes_to_the_centre_of_the_others_on_its_flight() -> None:
    found = stepped(("shepherd", -2.0, 0.0), ("sheep", 1.0, 1.0), ("sheep", -1.0, 1.0))
    assert bearing(found) == pytest.approx(math.atan2(1.05, 1.0))


def test_a_sheep_keeps_its_distance_from_others() -> None:
    assert bearing(stepped(("sheep", 0.0, 0.3))) == pytest.approx(-0.5 * math.pi, abs=0.2)


def test_the_shepherd_drives_a_herd_from_behind_its_centre() -> None:
    # The centre is at (2, 0), the goal at (2, 3): behind is 0.4 sqrt(2) m on the other side.
    herd = (("sheep", 1.8, 0.0), ("sheep", 2.2, 0.0), ("goal", 2.0, 3.0))
    found = stepped(*herd, role="shepherd")
    assert found.report["state"] == "drive"
    assert bearing(found) == pytest.approx(math.atan2(-0.4 * math.sqrt(2.0), 2.0))


def test_the_shepherd_collects_a_sheep_that_is_far_from_the_herd() -> None:
    # The centre is at (3, 0), and 0.4 m behind the farthest is (3, 3.4).
    herd = (("sheep", 3.0, 3.0), ("sheep", 3.0, -1.5), ("sheep", 3.0, -1.5), ("goal", 0.0, 9.0))
    found = stepped(*herd, role="shepherd")
    assert found.report["state"] == "collect"
    assert bearing(found) == pytest.approx(math.atan2(3.4, 3.0))


def test_the_shepherd_waits_where_a_sheep_is_near_and_where_the_herd_has_arrived() -> None:
    near = stepped(("sheep", 0.5, 0.0), ("goal", 5.0, 0.0), role="shepherd")
    there = stepped(("sheep", 4.5, 0.0), ("goal", 5.0, 0.0), role="shepherd")
    assert (near.report["state"], there.report["state"]) == ("wait", "arrived")
    assert near.twist == there.twist == Twist()
