"""Doors and corridors that Burgers pass under protection, and those that they do not."""

from __future__ import annotations

import numpy as np
import pytest

from studies.safety.judge import collisions
from studies.safety.passages import Passage, passage_scenario
from swarmd.core.messages import NarrowestPassage
from swarmd.robot.protection.modes import make_mode, narrowest_passage
from swarmd.settings.settings import load_platform
from swarmd.sim.lockstep.lockstep import simulate_run
from tests.support.filter_sim import under_barrier

pytestmark = pytest.mark.long


def burger() -> NarrowestPassage:
    """The narrowest passage of a Burger among obstacles that are seen whole."""
    found = narrowest_passage(make_mode(under_barrier(load_platform("burger"), unseen_extent=0.0)))
    assert found is not None
    return found


def crossings(passage: Passage, seed: int) -> int:
    """How often robots changed sides, none of which touched anything."""
    trace = simulate_run(passage_scenario(passage), seed)
    assert collisions(trace) == []
    beyond = 0.5 * passage.length + 0.2
    x = trace.pose[..., 0]
    count = 0
    for robot in range(x.shape[1]):
        sides = np.sign(x[np.abs(x[:, robot]) > beyond, robot])
        count += int(np.count_nonzero(np.diff(sides)))
    return count


@pytest.mark.parametrize(("width", "is_passed"), [(1.0, True), (0.85, False)])
def test_a_robot_passes_the_narrowest_door_and_none_much_narrower(
    width: float, is_passed: bool
) -> None:
    door = Passage(width * burger().door, duration=36.0)
    assert (crossings(door, 2) > 0) == is_passed


@pytest.mark.parametrize(
    ("width", "is_passed"), [(1.0, True), pytest.param(0.85, False, marks=pytest.mark.evidence)]
)
def test_a_robot_passes_the_narrowest_corridor_and_none_much_narrower(
    width: float, is_passed: bool
) -> None:
    corridor = Passage(width * burger().corridor, 1.0, duration=48.0)
    assert (crossings(corridor, 1) > 0) == is_passed


def test_two_robots_swap_in_a_lane_again_and_again() -> None:
    """The short form of `python -m studies.safety encounters --tasks "two that swap in a lane"`."""
    lane = Passage(2.5 * 0.178, 1.0, 1, 1, mode="walls_stand", duration=150.0)
    assert crossings(lane, 1) >= 4


def test_of_two_that_meet_in_a_corridor_one_yields() -> None:
    assert crossings(Passage(0.445, 1.0, 1, 1, duration=75.0), 1) > 0


def test_a_robot_passes_a_door_of_two_bodies() -> None:
    assert crossings(Passage(2.0 * 0.178, duration=28.0), 1) > 0


def test_robots_take_turns_at_a_door_with_right_of_way() -> None:
    door = Passage(2.0 * 0.178, left=1, right=1, mode="orca", duration=80.0)
    assert crossings(door, 2) >= 2
