"""A window counts as held if a robot with free floor asks for motion and stands."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from msgspec import structs

from studies.safety.held import MODES, SWARMS, WINDOW, Run, measure, scenario_for
from studies.safety.judgement import judge
from studies.safety.runs import total
from swarmd.core.values import Array
from swarmd.sim.trace import Trace

ARENA = "2x2"
SQUARE = np.array(((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)))


def made(poses: list[tuple[float, float, float]], **changes: Any) -> Trace:
    """Robots of 0.2 x 0.2 m that ask for motion and stand for two windows."""
    t = np.arange(0.0, 2.0 * WINDOW + 0.01, 0.5)
    count = len(poses)
    pose = np.broadcast_to(np.array(poses), (len(t), count, 3)).copy()
    asked = np.zeros((len(t), count, 3))
    asked[..., 0] = 0.1
    values: dict[str, Any] = {
        "ids": tuple(f"r{number}" for number in range(count)),
        "t": t,
        "pose": pose,
        "safe": np.zeros_like(asked),
        "requested": asked,
        "contact_t": np.zeros(0),
        "contact_pair": np.zeros((0, 2), dtype=np.int64),
        "contact_speed": np.zeros((0, 2)),
        "platforms": ("square",) * count,
        "footprints": {"square": SQUARE},
        "meta": {"arena": ARENA},
    }
    return Trace(**{**values, **changes})


def held(trace: Trace) -> int:
    return measure(trace).held


def test_a_robot_with_free_floor_is_held_in_each_window() -> None:
    found = measure(made([(0.0, 0.85, 0.0)]))  # 5 cm from the wall at y = 1 m
    assert (found.windows, found.held, found.longest) == (2, 2, 2.0 * WINDOW)


@pytest.mark.parametrize(
    "poses",
    [
        # A corner at its nose, and another robot behind it.
        [(0.85, 0.85, 0.0), (0.6, 0.85, 0.0)],
    ],
)
def test_a_robot_without_floor_is_not_held(poses: list[tuple[float, float, float]]) -> None:
    whole = measure(made(poses))
    assert whole.held == 2  # the robot behind can back out, the one in the corner cannot


@pytest.mark.parametrize(
    ("parts", "held_windows"),
    [
        (",box:0.3:0:0.2:0.2,box:-0.3:0:0.2:0.2", 0),
        (",pole:0.3:0:0.1,segment:-0.3:-0.5:-0.3:0.5", 0),
        (",box:0.3:0:0.2:0.2", 2),
        (",box:0.6:0:0.2:0.2,box:-0.3:0:0.2:0.2", 2),
    ],
)
def test_floor_is_free_of_boxes_poles_and_inner_walls(parts: str, held_windows: int) -> None:
    """The robot asks to move 0.3 m ahead or back; its outline reaches 0.1 m."""
    trace = made([(0.0, 0.0, 0.0)], meta={"arena": f"{ARENA}{parts}"})
    assert held(trace) == held_windows


def test_a_judgement_has_the_time_in_which_protected_robots_were_held() -> None:
    trace = made([(0.0, 0.0, 0.0), (0.5, 0.5, 0.0)], meta={"arena": ARENA})
    assert judge(trace).held == 4.0 * WINDOW
    assert judge(trace, ["r1"]).held == 2.0 * WINDOW
    assert judge(made([(0.0, 0.0, 0.0)], requested=None)).held is None
    known, unknown = judge(trace), structs.replace(judge(trace), held=None)
    assert total([known, known]).held == 8.0 * WINDOW
    assert total([known, unknown]).held is None


def test_a_robot_that_moves_or_asks_for_nothing_or_touches_is_not_held() -> None:
    trace = made([(0.0, 0.0, 0.0)])
    moving: Array = trace.pose.copy()
    moving[:, 0, 0] = 0.01 * trace.t
    assert held(made([(0.0, 0.0, 0.0)], pose=moving)) == 0
    assert held(made([(0.0, 0.0, 0.0)], requested=np.zeros_like(trace.safe))) == 0
    touching = {
        "contact_t": np.array([3.0]),
        "contact_pair": np.array([[0, -1]]),
        "contact_speed": np.zeros((1, 2)),
    }
    assert held(made([(0.0, 0.0, 0.0)], **touching)) == 1


@pytest.mark.parametrize("swarm", SWARMS)
def test_each_swarm_is_a_scenario_in_each_mode(swarm: str) -> None:
    counts = {len(scenario_for(Run(swarm, mode, 1)).robots) for mode in MODES}
    assert counts == {SWARMS[swarm].count}
