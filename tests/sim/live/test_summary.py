"""The numbers of a demo, and its problems."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swarmd.core.messages import Health, Reason, State
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.summary import METRICS, DemoSummary, all_moved_after, problems_of
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.trace import Trace, TraceBuilder
from tests.support.statuses import status

BURGER = load_platform("burger")


def problem(**end: Any) -> tuple[str, ...]:
    here = {"a": status("a")}
    return problems_of(["a"], here, here, {"a": status("a", **end)}, contacts=0)


def closing_in() -> Trace:
    """Two robots on the x axis, 2 m apart, that come to 0.5 m within 10 s and then stand 10 s."""
    recorder = TraceBuilder(("a", "b"), (BURGER, BURGER), {"thresholds": {"burger": 0.5}})
    for time in np.arange(0.0, 20.0 + 1e-9, 0.1):
        half = max(1.0 - 0.075 * time, 0.25)
        poses = np.array([[-half, 0.0, 0.0], [half, 0.0, np.pi]])
        recorder.add(float(time), poses, np.zeros((2, 3)))
    recorder.add_contact(12.0, "a", "wall_east", 0.1, 0.0)
    return recorder.trace()


def summary(**changes: Any) -> DemoSummary:
    plain: dict[str, Any] = {
        "pattern": "attraction",
        "platform": "burger",
        "robots": ("a", "b"),
        "arena": "4x4",
        "layout": "row:1",
        "seed": 0,
        "seconds_to_moving": 1.5,
        "kernels": "compiled",
        "seconds": 20.0,
        "real_time_factor": 0.99,
        "metrics": measure(closing_in(), METRICS),
        "problems": (),
    }
    return DemoSummary(**{**plain, **changes})


def test_lines_name_unknown_values() -> None:
    lines = dict(summary(seconds_to_moving=None).lines())
    assert lines["all moving after"] == "not all moved"
    assert lines["mean_distance_to_centroid_start"] == "1 m"
    assert lines["mean_distance_to_centroid_end"] == "0.25 m"
    assert lines["largest_cluster"] == "2 robots"
    assert lines["minimum_gap"] == "0.424 m"  # nose to nose, 0.038 m before the axles
    assert lines["arena_contacts"] == "1"
    assert "protection_duty" not in lines  # the trace has no decisions


def test_all_have_moved_once_each_has() -> None:
    trace = closing_in()
    assert all_moved_after(trace) == pytest.approx(0.1)
    pose = trace.pose.copy()
    pose[:, 1] = pose[0, 1]
    assert all_moved_after(replace(trace, pose=pose)) is None  # one has not moved
    pose[:50, 1, 2] += 0.0005  # less than counts as a move
    pose[50:, 1, 2] += 0.002
    assert all_moved_after(replace(trace, pose=pose)) == pytest.approx(5.0)


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


def test_the_arena_is_told_without_its_items() -> None:
    arena = "4x4,pole:1:1:0.1,item/food-1:0:0:0.05,item/food-2:0:0:0.05"
    assert "attraction, 4x4,pole:1:1:0.1 m" in dict(summary(arena=arena).lines())["robots"]
