"""The numbers of a demo, and its problems."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from swarmd.core.messages import DecisionSummary, Health, Reason, State
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.summary import DemoSummary, mean_duty, numbers_of, problems_of
from swarmd.sim.trace import Trace, TraceBuilder
from tests.support.statuses import status

BURGER = load_platform("burger")


def problem(**end: Any) -> tuple[str, ...]:
    here = {"a": status("a")}
    return problems_of(["a"], here, here, {"a": status("a", **end)}, contacts=0)


def closing_in() -> Trace:
    """Two robots on the x axis, 2 m apart, that come to 0.5 m within 10 s and then stand 10 s."""
    recorder = TraceBuilder(("a", "b"), (BURGER, BURGER), {})
    for time in np.arange(0.0, 20.0 + 1e-9, 0.1):
        half = max(1.0 - 0.075 * time, 0.25)
        poses = np.array([[-half, 0.0, 0.0], [half, 0.0, np.pi]])
        recorder.add(float(time), poses, np.zeros((2, 3)))
    recorder.add_contact(12.0, "a", "wall_east", 0.1, 0.0)
    return recorder.trace()


def summary(**changes: Any) -> DemoSummary:
    numbers = numbers_of(closing_in(), {"burger": BURGER}, 0.25, 0.99)
    plain: dict[str, Any] = {
        "pattern": "attraction",
        "platform": "burger",
        "robots": ("a", "b"),
        "arena": "4x4",
        "layout": "row:1",
        "seed": 0,
        "seconds_to_moving": 1.5,
        "kernels": "compiled",
        "numbers": numbers,
        "problems": (),
    }
    return DemoSummary(**{**plain, **changes})


def test_numbers_of_two_robots_that_meet() -> None:
    numbers = summary().numbers
    assert numbers.seconds == pytest.approx(20.0)
    assert numbers.centroid_before == pytest.approx(1.0)
    assert numbers.centroid_after == pytest.approx(0.25)
    assert numbers.link == pytest.approx(2.0 * 0.5)  # twice the Burger's threshold
    assert (numbers.clusters_before, numbers.clusters_after) == (2, 1)
    assert numbers.largest_cluster == 2
    assert (numbers.contacts, numbers.arena_contacts) == (0, 1)
    assert numbers.minimum_gap == pytest.approx(0.5 - 2.0 * 0.038)  # nose to nose
    assert numbers.mean_speed_late == pytest.approx(0.0, abs=1e-12)
    assert numbers.protection_duty == 0.25


def test_a_robot_alone_has_no_gap() -> None:
    recorder = TraceBuilder(("a",), (BURGER,), {})
    for time in (0.0, 1.0):
        recorder.add(time, np.zeros((1, 3)), np.zeros((1, 3)))
    numbers = numbers_of(recorder.trace(), {"burger": BURGER}, None, 1.0)
    assert numbers.minimum_gap is None
    assert numbers.clusters_after == 1


def test_lines_name_unknown_values() -> None:
    lines = dict(summary(seconds_to_moving=None).lines())
    assert lines["all moving after"] == "not all moved"
    assert lines["distance to centroid"] == "1.00 m -> 0.25 m"
    assert lines["protection active"] == "25 % of decisions"


def test_robots_that_ran_to_the_end_are_no_problem() -> None:
    assert problem() == ()
    assert problem(state=State.IDLE, reason=Reason.FINISHED) == ()


@pytest.mark.parametrize(
    ("end", "line"),
    [
        ({"state": State.STOPPED, "reason": Reason.STALE_SCAN}, r"a ended stopped \(stale_scan\)"),
        ({"state": State.FAULTED, "detail": "it raised"}, r"a ended faulted: it raised"),
        ({"state": State.IDLE, "reason": Reason.RESET}, r"a ended idle \(reset\)"),
        ({"instance": "other"}, r"a was restarted"),
        ({"generation": 2}, r"a was given another request"),
        ({"generation": 2, "health": Health(host_restarts=1)}, r"a: its pattern failed"),
    ],
)
def test_a_robot_that_did_not_run_to_the_end_is_a_problem(end: dict[str, Any], line: str) -> None:
    (found,) = problem(**end)
    assert re.match(line, found)


def test_a_pattern_that_failed_before_the_first_status_of_its_run_is_a_problem() -> None:
    failed = {"a": status("a", generation=2, health=Health(host_restarts=1))}
    (found,) = problems_of(["a"], {"a": status("a")}, failed, failed, contacts=0)
    assert found.startswith("a: its pattern failed")


def test_a_silent_robot_and_a_touch_are_problems() -> None:
    here = {"a": status("a"), "b": status("b")}
    found = problems_of(["a", "b"], here, here, {"a": status("a")}, 2)
    assert found == ("b did not answer at the end", "robots touched each other 2 times")


def test_duty_is_weighted_by_decisions() -> None:
    statuses = {
        "a": status("a", decision=DecisionSummary(duty=0.5, decisions=300)),
        "b": status("b", decision=DecisionSummary(duty=0.1, decisions=100)),
        "c": status("c"),
    }
    assert mean_duty(statuses) == pytest.approx(0.4)
    assert mean_duty({"c": status("c")}) is None


def test_the_arena_is_told_without_its_items() -> None:
    arena = "4x4,pole:1:1:0.1,item/food-1:0:0:0.05,item/food-2:0:0:0.05"
    assert "attraction, 4x4,pole:1:1:0.1 m" in dict(summary(arena=arena).lines())["robots"]
