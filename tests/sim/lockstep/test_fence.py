"""The fence in lockstep: robots stay inside by true poses, and a run repeats bit by bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.robot.protection.fence.fence import Fence
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace

FENCE = {
    "frame": "world",
    "polygon": [[-1.2, -1.2], [1.2, -1.2], [1.2, 1.2], [-1.2, 1.2]],
    "keep_out": [[[0.6, 0.6], [1.2, 0.6], [1.2, 1.2]]],
}


def made(fence: dict[str, Any] | None = None, mode: str = "barrier") -> Scenario:
    return scenario_of(
        {
            "duration": 20.0,
            "arena": {"size": [8.0, 8.0]},
            "platforms": {"burger": {"protection": {"mode": mode}}},
            "groups": {"tb3": {"platform": "burger", "count": 2, "pattern": "random_walk"}},
            "start": {"layout": "grid", "spacing": 0.8},
            **({} if fence is None else {"fence": fence}),
        }
    )


def clearance(scenario: Scenario, trace: Trace) -> float:
    """m from the circles around the outlines to FENCE at the worst."""
    fence = made(FENCE).settings["tb3-01"].fence
    assert fence is not None
    judge = Fence(fence, next(iter(scenario.robots.values())))
    return float(judge.clearances(trace.pose[..., :2].reshape(-1, 2)).min())


@pytest.mark.parametrize("mode", ["barrier", "off"])
def test_robots_stay_inside_and_the_run_repeats(mode: str) -> None:
    scenario = made(FENCE, mode)
    trace = simulate_run(scenario, seed=1)
    assert clearance(scenario, trace) > 0.0
    free = simulate_run(made(mode=mode), seed=1)
    assert clearance(scenario, free) < 0.0  # without the fence they leave
    again = simulate_run(scenario_of(scenario.effective), seed=1)
    assert np.array_equal(trace.pose, again.pose)


def test_another_frame_holds() -> None:
    trace = simulate_run(made({**FENCE, "frame": "mocap"}), seed=1)
    assert np.array_equal(trace.pose[0, :, :2], trace.pose[-1, :, :2]) or (
        np.abs(trace.pose[-1] - trace.pose[0]).max() < 0.01
    )


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"polygon": [[0, 0], [2, 2], [2, 0], [0, 2]]}, "fence.polygon crosses itself"),
        ({"polygon": [[0, 0], [0.2, 0], [0, 0.2]]}, "fence is too small for platform burger"),
        ({"polygons": []}, "did you mean 'polygon'"),
    ],
)
def test_a_faulty_fence_is_refused_in_one_line(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        made({**FENCE, **changes})
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)
