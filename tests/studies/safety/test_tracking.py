"""Tracks beside the truth: the errors are those of tracks, and a false one is noticed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from studies.safety.scenes import Scene, scenario
from studies.safety.tracking import (
    COMPARED,
    LIDARS,
    ComparedTracker,
    Lidar,
    Run,
    perform,
    replace_trackers,
    true_tracks,
    with_lidar,
)
from swarmd.core.values import Odometry, Scan
from swarmd.robot.protection.decision import DecisionContext
from swarmd.robot.steering.tracks import Surroundings, Track
from swarmd.sim.lockstep.lockstep import Lockstep

pytestmark = pytest.mark.long

DENSE = scenario(Scene("goals", "burger", "body", "orca", duration=6.0))


class Told:
    """A tracker that gives the true tracks of a robot, and one of nothing."""

    def __init__(self, run: Lockstep, row: int) -> None:
        self.run, self.row = run, row

    def reset(self) -> None:
        """Forget nothing."""

    def on_odometry(self, odometry: Odometry) -> None:
        """Take no reading."""

    def observe(self, scan: Scan, context: DecisionContext) -> None:
        """Take no scan."""

    def surroundings(self, context: DecisionContext) -> Surroundings:
        false = Track(99, 0.0, 1.0, 0.0, 0.0, 0.1)
        found = (*true_tracks(self.run.world, self.row, COMPARED), false)
        return Surroundings(found, np.empty((0, 2)))


def test_a_true_track_is_where_its_robot_is_and_moves_as_it_does() -> None:
    run = Lockstep(DENSE, 1)
    run.advance(3.0)
    before = true_tracks(run.world, 0, 9.0)
    pose = run.world.poses()[0]
    run.advance(0.02)
    x, y, yaw = run.world.poses()[0]
    cos, sin = math.cos(yaw - pose[2]), math.sin(yaw - pose[2])
    dx, dy = x - pose[0], y - pose[1]
    ahead, aside = math.cos(pose[2]), math.sin(pose[2])
    own = ahead * dx + aside * dy, ahead * dy - aside * dx
    assert len(before) == len(DENSE.robots) - 1
    for one, later in zip(before, true_tracks(run.world, 0, 9.0), strict=True):
        place = own[0] + cos * later.x - sin * later.y, own[1] + sin * later.x + cos * later.y
        assert place == pytest.approx((one.x + 0.02 * one.vx, one.y + 0.02 * one.vy), abs=0.002)


def test_true_tracks_have_no_error_and_a_track_of_nothing_is_false() -> None:
    run = Lockstep(DENSE, 1)
    found = ComparedTracker(Told(run, 0), run.world, 0)
    run.advance(4.0)
    assert found.tracks == 0
    context = DecisionContext(4.0)
    found.observe(Scan(1, 4.0, np.empty(0), np.empty(0), 0.1, 3.5), context)
    assert (found.false, found.found) == (1, found.robots)
    assert found.tracks == found.robots + 1
    assert np.allclose(np.array(found.errors)[:, :2], 0.0)


@pytest.mark.parametrize("lidar", LIDARS)
def test_tracks_are_near_the_truth(lidar: str) -> None:
    found = perform(Run(lidar, 1, 6.0)).found
    place, velocity, _ = np.sqrt(np.mean(found.errors, axis=0))
    assert found.robots > len(DENSE.robots)
    assert place < 0.3
    assert velocity < 0.6
    assert found.found > 0.5 * found.robots
    assert found.false < 0.3 * found.tracks


def test_a_lidar_has_its_rate_and_its_noise() -> None:
    made = with_lidar(DENSE, Lidar(10.0, 2.0, 0.3))
    specs = [one.scan for one in made.robots.values()]
    assert {(one.rate, one.latency) for one in specs} == {(10.0, 0.05)}
    assert made.realism.lidar.dropout == 0.3
    assert made.realism.lidar.near_sd == 2.0 * DENSE.realism.lidar.near_sd


def test_a_robot_without_avoidance_has_a_tracker_that_is_not_asked() -> None:
    run = Lockstep(scenario(Scene("goals", "burger", "body", "barrier", duration=6.0)), 1)
    trackers = replace_trackers(run, ComparedTracker)
    run.advance(5.0)
    assert sum(one.tracks for one in trackers) == 0
