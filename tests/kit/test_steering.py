"""Keeping clear and steering."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.values import Array, Twist
from swarmd.kit.steering import NearPoints, from_base, keep_clear, steer

NOTHING = np.empty((0, 2))
UNIT = st.floats(-1.0, 1.0)
BEARING = st.floats(-math.pi, math.pi)


def command(x: float, y: float, points: Array = NOTHING, *, may_back: bool = False) -> Twist:
    return steer(
        np.array([x, y]), 0.2, 2.0, points=points, spacing=0.5, brake=0.5, may_back=may_back
    )


def test_points_are_moved_from_the_sensor_to_the_base() -> None:
    points = from_base(np.array([[1.0, 0.0], [1.0, math.pi], [1.0, math.pi / 2]]), (-0.5, 0.0))
    expected = [[0.5, 0.0], [1.5, math.pi], [math.hypot(0.5, 1.0), math.atan2(1.0, -0.5)]]
    np.testing.assert_allclose(points, expected)
    left = from_base(np.array([[1.0, math.pi / 2]]), (0.0, 0.5))
    np.testing.assert_allclose(left, [[1.5, math.pi / 2]])


@pytest.mark.parametrize(("distance", "speed"), [(2.0, 1.0), (1.0, 1.0), (0.75, 0.5), (0.5, 0.0)])
def test_the_speed_towards_a_point_falls_to_zero_at_the_spacing(
    distance: float, speed: float
) -> None:
    points = np.array([[distance, 0.0]])
    cleared = keep_clear(np.array([1.0, 0.0]), points, spacing=0.5, brake=0.5)
    np.testing.assert_allclose(cleared, [speed, 0.0], atol=1e-12)


def test_nearer_than_the_spacing_it_is_pushed_away() -> None:
    cleared = keep_clear(np.zeros(2), np.array([[0.4, math.pi / 2]]), spacing=0.5, brake=0.5)
    np.testing.assert_allclose(cleared, [0.0, -0.2], atol=1e-12)


def test_motion_past_a_point_is_not_limited() -> None:
    cleared = keep_clear(np.array([1.0, 1.0]), np.array([[0.5, 0.0]]), spacing=0.5, brake=0.5)
    np.testing.assert_allclose(cleared, [0.0, 1.0], atol=1e-12)


@given(x=UNIT, y=UNIT, bearings=st.lists(BEARING, min_size=1, max_size=6))
def test_the_nearest_point_is_obeyed_exactly(x: float, y: float, bearings: list[float]) -> None:
    points = np.array([[0.3 + 0.1 * i, b] for i, b in enumerate(bearings)])
    cleared = keep_clear(np.array([x, y]), points, spacing=0.5, brake=0.5)
    towards = cleared @ [math.cos(bearings[0]), math.sin(bearings[0])]
    assert towards <= -0.4 + 1e-9


def test_ahead_it_drives_straight_at_the_vectors_speed() -> None:
    assert command(0.5, 0.0) == Twist(linear=0.1)
    assert command(3.0, 0.0) == Twist(linear=0.2)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_aside_it_turns_without_driving(side: float) -> None:
    twist = command(0.0, side)
    assert twist.linear == pytest.approx(0.0, abs=1e-12)
    assert twist.angular == 2.0 * side


def test_behind_it_turns_in_place() -> None:
    assert command(-1.0, 0.1) == Twist(angular=2.0)


def test_behind_it_reverses_at_half_speed_with_may_back() -> None:
    assert command(-1.0, 0.0, may_back=True) == Twist(linear=-0.1)
    assert command(-1.0, 0.1, may_back=True).angular < 0.0


def test_a_point_ahead_limits_speed_while_it_turns() -> None:
    # The vector leads past the point, but the robot still heads for it.
    ahead = np.array([[0.5, 0.0]])
    twist = command(0.7, 0.7, ahead)
    assert twist.linear == 0.0
    assert twist.angular > 0.0


@pytest.mark.parametrize("vector", [(0.0, 0.0), (math.nan, 0.0), (0.0, math.inf)])
def test_no_direction_is_no_motion(vector: tuple[float, float]) -> None:
    assert command(*vector) == Twist()


def test_no_distance_to_brake_and_an_infinite_bearing_are_errors() -> None:
    near = NearPoints([(0.4, 0.0)])
    with pytest.raises(ZeroDivisionError):
        near.keep_clear(1.0, 0.0, spacing=0.5, brake=0.0)
    with pytest.raises(ZeroDivisionError):
        near.steer(1.0, 0.0, 0.2, 2.0, spacing=0.5, brake=0.0)
    with pytest.raises(ValueError, match="infinite"):
        NearPoints([(0.4, math.inf)])


def test_near_points_know_the_nearest_range() -> None:
    assert NearPoints(()).nearest == math.inf
    assert NearPoints([(0.4, 1.0), (0.3, 2.0), (0.5, 0.0)]).nearest == 0.3


@given(x=UNIT, y=UNIT, bearings=st.lists(BEARING, max_size=6))
def test_near_points_serve_several_steps(x: float, y: float, bearings: list[float]) -> None:
    points = np.array([[0.4 + 0.1 * i, b] for i, b in enumerate(bearings)]).reshape(-1, 2)
    near = NearPoints(points.tolist())
    for _ in range(2):
        vector = near.keep_clear(x, y, spacing=0.5, brake=0.5)
        assert list(vector) == list(keep_clear(np.array([x, y]), points, spacing=0.5, brake=0.5))
        twist = near.steer(*vector, 0.2, 2.0, spacing=0.5, brake=0.5)
        assert twist == command(*vector, points)
