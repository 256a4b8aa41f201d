"""Order of motion: 1 where it must be 1, 0 where it must be 0."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.metrics import collective_motion
from tests.sim.metrics.runs import run

SECONDS = 0.1 * np.arange(21)


def moving(*velocities: tuple[float, float]) -> Array:
    """Robots in a square around the origin, each at a velocity of its own; yaw is never that."""
    corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])[: len(velocities)]
    pose = np.full((21, len(velocities), 3), 0.7)
    pose[..., :2] = corners + SECONDS[:, None, None] * np.array(velocities)
    return pose


def circling(speed: float, *phases: float) -> Array:
    """Robots on a circle of 2 m."""
    angle = np.array(phases) + SECONDS[:, None] * speed / 2.0
    return np.stack((2.0 * np.cos(angle), 2.0 * np.sin(angle), 0.0 * angle), axis=-1)


@pytest.mark.parametrize(
    ("velocities", "order"),
    [
        ([(0.2, 0.0)] * 4, 1.0),
        ([(0.2, 0.0), (0.4, 0.0)], 1.0),  # speed does not weigh
        ([(0.2, 0.0), (-0.2, 0.0)], 0.0),
        ([(0.2, 0.0), (0.0, 0.2)], np.sqrt(0.5)),
        ([(0.2, 0.0), (0.0, 0.0)], 0.5),  # who stands takes no part
        ([(0.0, 0.0)] * 3, 0.0),
        ([(0.009, 0.0)] * 3, 0.0),  # slower than 1 cm/s is standing
        ([(0.011, 0.0)] * 3, 1.0),
    ],
)
def test_polarisation(velocities: list[tuple[float, float]], order: float) -> None:
    orders = collective_motion.polarisations(run(moving(*velocities)))
    np.testing.assert_allclose(orders, np.full(21, order), atol=1e-9)


def test_robots_on_a_circle_are_not_polarised() -> None:
    phases = (0.0, np.pi / 2.0, np.pi, 1.5 * np.pi)
    for speed in (0.4, -0.4):
        trace = run(circling(speed, *phases))
        np.testing.assert_allclose(collective_motion.polarisations(trace), np.zeros(21), atol=1e-9)


def test_only_present_robots_count() -> None:
    present: NDArray[np.bool_] = np.ones((21, 2), dtype=bool)
    present[:, 1] = False
    trace = run(moving((0.2, 0.0), (-0.2, 0.0)), present=present)
    np.testing.assert_allclose(collective_motion.polarisations(trace), np.ones(21))
    nobody = run(moving((0.2, 0.0)), present=np.zeros((21, 1), dtype=bool))
    assert np.isnan(collective_motion.polarisations(nobody)).all()


def test_an_instant_alone_shows_no_motion() -> None:
    assert np.isnan(collective_motion.polarisations(run(np.zeros((1, 3, 3))))).all()


def test_the_way_of_the_centroid() -> None:
    # Two seconds at 0.2 m/s; who goes the other way takes half of it back.
    np.testing.assert_allclose(
        collective_motion.centroid_path_lengths(run(moving((0.2, 0.0))))[-1], 0.4
    )
    trace = run(moving(*[(0.2, 0.0)] * 3, (-0.2, 0.0)))
    assert collective_motion.centroid_path_length(trace) == pytest.approx(0.2)
    assert collective_motion.centroid_path_length(run(circling(0.4, 0.0, np.pi))) == pytest.approx(
        0.0
    )
    assert collective_motion.centroid_path_length(run(np.zeros((0, 3, 3)))) is None


def test_a_robot_that_joins_or_leaves_does_not_move_the_centroid() -> None:
    present: NDArray[np.bool_] = np.ones((21, 2), dtype=bool)
    present[5:, 1] = False
    trace = run(moving((0.0, 0.0), (0.0, 0.0)), present=present)
    assert collective_motion.centroid_path_length(trace) == 0.0
