"""Areas of runs whose geometry is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.sim.metrics import coverage
from tests.sim.metrics.runs import line, run


def test_a_robot_at_rest_covers_its_disc() -> None:
    disc = pytest.approx(math.pi / 4.0, rel=0.01)
    assert coverage.covered_area(run(line(0.0)), radius=0.5, cell=0.01) == disc
    assert coverage.covered_area(run(line(0.0, 0.0, 0.0)), radius=0.5, cell=0.01) == disc
    two = pytest.approx(math.pi / 2.0, rel=0.01)
    assert coverage.covered_area(run(line(0.0, 9.0)), radius=0.5, cell=0.01) == two


def test_squares_of_the_usual_size_count_what_was_near_and_no_more() -> None:
    """All that is covered, square by square and instant by instant."""
    t = np.linspace(0.0, 6.0, 150)
    pose = np.zeros((150, 2, 3))
    pose[:, 0, :2] = np.stack((1.3 * np.cos(t), 0.9 * np.sin(1.7 * t)), axis=-1)
    pose[:, 1, :2] = np.stack((0.31 * t - 1.0, 0.4 + 0.0 * t), axis=-1)
    x, y = np.meshgrid(np.arange(-3.0, 3.0, 0.1) + 0.05, np.arange(-3.0, 3.0, 0.1) + 0.05)
    away = np.hypot(x[..., None, None] - pose[..., 0], y[..., None, None] - pose[..., 1])
    expected = np.cumsum((away <= 0.5).any(axis=-1), axis=-1).astype(bool).sum(axis=(0, 1)) * 0.01
    areas = coverage.covered_areas(run(pose))
    np.testing.assert_allclose(areas, expected, rtol=0.005, atol=0.011)


def test_what_lies_outside_the_arena_is_not_covered() -> None:
    half = pytest.approx(math.pi / 8.0, rel=0.05)
    pose = line(2.0)  # at a wall of an arena of 4 m
    assert coverage.covered_area(run(pose, meta={"arena": "4x9"}), cell=0.02) == half
    turned = pose[..., [1, 0, 2]]
    assert coverage.covered_area(run(turned, meta={"arena": "9x4"}), cell=0.02) == half


def test_absent_robots_cover_nothing() -> None:
    trace = run(line(0.0, 5.0), present=np.array([[True, False]]))
    assert coverage.covered_area(trace, cell=0.02) == pytest.approx(math.pi / 4.0, rel=0.05)
    nobody = run(line(0.0), present=np.array([[False]]))
    assert coverage.covered_area(nobody) == 0.0


def test_far_ways_are_counted_more_coarsely() -> None:
    covered = coverage.covered_area(
        run(np.array([[[0.0, 0.0, 0.0], [4e3, 4e3, 0.0]]])), radius=50.0
    )
    assert covered == pytest.approx(2.0 * math.pi * 50.0**2, rel=0.1)
