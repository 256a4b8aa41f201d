"""Circle formation: one step at a time, and its arithmetic."""

from __future__ import annotations

import math

import numpy as np

from swarmd.core.values import Inputs, Odometry, Pose, Scan, Twist, Value
from swarmd.kit.formation_geometry import place_on_circle, radius_of
from swarmd.patterns.circle_formation.pattern import CircleFormation
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_of

BURGER = load_platform("burger")


class TestCircleFormation(PatternContract):
    pattern = CircleFormation


class TestCircleFormationOfARadius(PatternContract):
    pattern = CircleFormation
    platforms = ("burger", "jackal")
    params = {"radius": 2.0}  # noqa: RUF012 - read only


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
