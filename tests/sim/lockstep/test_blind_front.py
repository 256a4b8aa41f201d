"""Three Burgers whose lidars go blind, or freeze, ahead: they stand before they touch."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from studies.safety.judgement import judge
from swarmd.core.messages import Reason
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenariofile import scenario_of
from tests.support.broken_assumptions import freeze_rays, lose_rays

Break = Callable[[Lockstep], None]
FRONT = partial(lose_rays, share=1.0, half=math.radians(72.5), seed=1)
FROZEN = partial(freeze_rays, half=0.5 * math.pi)
HOURS = 10.0


def scene(side: float, robots: int, pattern: str = "random_walk") -> dict[str, Any]:
    return {
        "duration": 45.0,
        "trace_rate": 20.0,
        "realism": {"preset": "realistic"},
        "arena": {"size": [side, side]},
        "lidar_visibility": "body",
        "platforms": {
            "own": {"extends": "burger", "protection": {"barrier": {"unseen_extent": 0.0}}}
        },
        "groups": {"own": {"platform": "own", "count": robots, "pattern": pattern}},
        "start": {"layout": "random", "clearance": 0.3},
    }


def run(seed: int, breaks: Break, begin: float, seconds: float) -> tuple[Lockstep, int]:
    """A run in a room of 3 m in which lidars break at `begin` s; the contacts at fault."""
    lab = Lockstep(scenario_of(scene(3.0, 3)), seed=seed)
    lab.advance(begin)
    breaks(lab)
    lab.advance(seconds - begin)
    found = judge(lab.trace())
    return lab, found.faults + found.touch_faults


def reasons(lab: Lockstep) -> list[Reason | None]:
    robots = [shell.robot for shell in lab.shells if shell is not None]
    return [robot.status(lab.world.time).reason for robot in robots]


def test_a_front_that_goes_blind_holds_all_robots_within_a_second() -> None:
    lab, faults = run(3, FRONT, 5.0, 6.0)
    assert reasons(lab) == [Reason.INVALID_SCAN] * 3
    assert faults == 0
    status = lab.shells[0].robot.status(lab.world.time)  # type: ignore[union-attr]
    assert "have lost their returns at once" in status.detail


def test_a_front_that_is_blind_from_the_start_holds_a_robot_that_pushes_at_a_wall() -> None:
    lab = Lockstep(scenario_of(scene(2.0, 1)), seed=3)
    FRONT(lab)
    lab.advance(7.0)
    robot = lab.shells[0].robot  # type: ignore[union-attr]
    texts = [event.text for event in robot.status(lab.world.time).events]
    assert reasons(lab) == [Reason.INVALID_SCAN]
    assert any("the base does not move into their direction" in text for text in texts)


@pytest.mark.evidence
@pytest.mark.parametrize(
    ("breaks", "begin", "most"), [(FRONT, 5.0, 0), (FROZEN, 5.0, 2), (FRONT, 0.0, 137)]
)
def test_robots_of_sixteen_runs_are_hardly_at_fault(breaks: Break, begin: float, most: int) -> None:
    assert sum(run(seed, breaks, begin, 45.0)[1] for seed in range(16)) <= most


@pytest.mark.evidence
@pytest.mark.parametrize("pattern", ["random_walk", "flocking", "dispersion"])
def test_no_whole_lidar_counts_as_blind_in_the_open(pattern: str) -> None:
    """A lidar of 3.5 m in an arena of 40 m."""
    seconds = HOURS / 3.0 * 3600.0 / 5.0
    lab = Lockstep(scenario_of({**scene(40.0, 5, pattern), "duration": seconds}), seed=5)
    for _ in np.arange(0.0, seconds, 10.0):
        lab.advance(10.0)
        assert Reason.INVALID_SCAN not in reasons(lab)
        robots = [shell.robot for shell in lab.shells if shell is not None]
        texts = [event.text for robot in robots for event in robot.status(lab.world.time).events]
        assert not any(text.startswith("scan: rays") for text in texts)
