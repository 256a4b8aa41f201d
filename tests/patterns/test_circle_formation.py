"""Circle formation: one step at a time, and its arithmetic."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.values import Array, Inputs, Odometry, Pose, Scan, Twist, Value
from swarmd.kit.formation_geometry import place_on_circle, radius_of
from swarmd.patterns.circle_formation import CircleFormation
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_of

BURGER = load_platform("burger")


class TestCircleFormation(PatternContract):
    pattern = CircleFormation


class TestCircleFormationOfARadius(PatternContract):
    pattern = CircleFormation
    params = {"radius": 2.0}  # noqa: RUF012 - read only


def polygon(count: int, radius: float, first: float = 0.4) -> Array:
    angles = first + 2.0 * math.pi / count * np.arange(count)
    return radius * np.stack((np.cos(angles), np.sin(angles)), axis=-1)


def seen_from(points: Array, robot: int) -> Array:
    """The others as seen from one of points (n, 2)."""
    others: Array = np.delete(points, robot, axis=0) - points[robot]
    return others


def requested(scan: Scan, **params: Value) -> Twist:
    """The first requested command on a scan."""
    pattern = Subject(CircleFormation, BURGER, params).make()
    odometry = Odometry(0.0, Pose(), Twist())
    twist = pattern.step(Inputs(0.0, 0.0, scan, is_new_scan=True, odometry=odometry)).twist
    assert twist is not None
    return twist


def test_its_circle_leaves_the_spacing_between_the_robots() -> None:
    pattern = Subject(CircleFormation, BURGER, {"spacing": 1.5}).make()
    assert isinstance(pattern, CircleFormation)
    place = pattern.place(np.array([(1.0, 1.0), (1.0, -1.0)]))
    np.testing.assert_allclose(place, np.array((2.0 / 3.0 - 1.5 / math.sqrt(3.0), 0.0)), atol=1e-9)


@pytest.mark.parametrize("count", [2, 3, 6, 8])
def test_a_robot_in_its_place_stays(count: int) -> None:
    points = polygon(count, radius_of(1.1, count))
    assert np.hypot(*(points[1] - points[0])) == pytest.approx(1.1)
    for own in range(count):
        place = place_on_circle(seen_from(points, own), radius_of(1.1, count))
        np.testing.assert_allclose(place, np.zeros(2), atol=1e-9)


@pytest.mark.parametrize("robot", [0, 2])
def test_it_corrects_the_radius_of_the_circle(robot: int) -> None:
    points = polygon(5, 1.0)
    outwards = points[robot] / np.hypot(*points[robot])
    larger = place_on_circle(seen_from(points, robot), 1.3)
    np.testing.assert_allclose(larger, 0.3 * outwards, atol=1e-9)
    smaller = place_on_circle(seen_from(points, robot), 0.8)
    np.testing.assert_allclose(smaller, -0.2 * outwards, atol=1e-9)


def test_robots_that_see_the_same_agree() -> None:
    points = np.random.default_rng(5).uniform(-2.0, 2.0, (7, 2))
    radius = radius_of(1.1, 7)
    placed = np.array([p + place_on_circle(seen_from(points, i), radius)
                       for i, p in enumerate(points)])  # fmt: skip
    away = placed - points.mean(axis=0)
    np.testing.assert_allclose(np.hypot(*away.T), np.full(7, radius), atol=1e-9)
    angles = np.sort(np.arctan2(away[:, 1], away[:, 0]))
    np.testing.assert_allclose(np.diff(angles), np.full(6, 2.0 * math.pi / 7.0), atol=1e-9)


def test_alone_it_stays() -> None:
    np.testing.assert_array_equal(place_on_circle(np.empty((0, 2)), 1.0), np.zeros(2))
    assert radius_of(1.1, 1) == 0.0
    assert requested(scan_of(BURGER)) == Twist()


def test_two_robots_that_are_too_near_back_off() -> None:
    ahead = scan_of(BURGER, [Disc(0.8, 0.0, 0.09)])
    assert requested(ahead).linear < 0.0
    # Two on a circle of radius 0.6 are 1.2 m apart.
    assert requested(scan_of(BURGER, [Disc(1.2, 0.0, 0.09)]), radius=0.6) == Twist()
    assert requested(scan_of(BURGER, [Disc(1.6, 0.0, 0.09)]), radius=0.6).linear > 0.0
