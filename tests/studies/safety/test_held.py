"""A window counts as held if a robot with free floor asks for motion and stands."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from studies.safety.held import MODES, SWARMS, WINDOW, Run, measure, scenario_for
from swarmd.core.values import Array
from swarmd.sim.trace import Trace

SIDE = 2.0
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
    }
    return Trace(**{**values, **changes})


def held(trace: Trace) -> int:
    return measure(trace, SIDE).held


def test_a_robot_with_free_floor_is_held_in_each_window() -> None:
    found = measure(made([(0.0, 0.85, 0.0)]), SIDE)  # 5 cm from the wall at y = 1 m
    assert (found.windows, found.held, found.longest) == (2, 2, 2.0 * WINDOW)


@pytest.mark.parametrize(
    "poses",
    [
        # A corner at its nose, and another robot behind it.
        [(0.85, 0.85, 0.0), (0.6, 0.85, 0.0)],
    ],
)
def test_a_robot_without_floor_is_not_held(poses: list[tuple[float, float, float]]) -> None:
    whole = measure(made(poses), SIDE)
    assert whole.held == 2  # the robot behind can back out, the one in the corner cannot


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
