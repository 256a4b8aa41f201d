"""The control of outcomes: robots of one pattern stand, other robots move."""

from __future__ import annotations

import numpy as np
import pytest

from studies.outcomes.still import control_of, still_robots
from studies.point_swarm import PointSwarm, at_places
from swarmd.sim.experiments.simulate import simulate

pytestmark = pytest.mark.long


def test_robots_of_the_pattern_have_no_path_while_it_asks_them_to_move() -> None:
    with still_robots("random_walk") as motion:
        results = simulate("random_walk", (0,), set={"duration": 3.0}, traces=False)
    assert motion.is_asked
    assert list(results.metric("path_length")) == [0.0]


def test_robots_of_other_patterns_move_and_so_do_all_robots_afterwards() -> None:
    with still_robots("flocking") as motion:
        walkers = simulate("random_walk", (0,), set={"duration": 3.0}, traces=False)
    flock = simulate("flocking", (0,), set={"duration": 3.0}, traces=False)
    assert not motion.is_asked
    assert min(*walkers.metric("path_length"), *flock.metric("path_length")) > 0.1


def test_points_of_the_pattern_keep_their_poses() -> None:
    places = at_places([(0.0, 0.0), (1.0, 0.0), (0.5, 0.8)])

    def poses() -> np.ndarray:
        return PointSwarm("hexagonal_lattice", places, seed=0, reach=3.0).run(5.0).pose

    with still_robots("hexagonal_lattice") as motion:
        pose = poses()
    assert motion.is_asked
    np.testing.assert_array_equal(pose, np.broadcast_to(places, pose.shape))
    assert not np.array_equal(poses(), pose)


def test_robots_that_never_move_miss_the_distance_that_dispersion_keeps() -> None:
    control = control_of("dispersion", 1)
    missed = {outcome.what for outcome in control if not outcome.is_reached}
    assert missed == {"least late range [m]"}
    assert {"mean path [m]", "contacts"} <= {outcome.what for outcome in control if outcome.values}


def test_a_pattern_that_asks_no_robot_to_move_has_no_control() -> None:
    assert control_of("trimmed_consensus", 1) == []
