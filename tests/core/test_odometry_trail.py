"""The trail of odometry: which readings it keeps, and poses at its edges."""

from __future__ import annotations

import math

import pytest

from swarmd.core.odometry_trail import ANEW, NEXT, REFUSED, SAME, OdometryTrail
from swarmd.core.values import Odometry, Pose, Twist

AHEAD = Twist(0.2)


def reading(stamp: float, x: float = 0.0, yaw: float = 0.0, twist: Twist = AHEAD) -> Odometry:
    return Odometry(stamp, Pose(x, 0.0, yaw), twist)


@pytest.mark.parametrize(
    ("given", "taken", "oldest"),
    [
        (reading(1.2, 0.24), NEXT, 1.0),
        (reading(1.1, 0.22), SAME, 1.0),  # a copy
        (reading(1.1, 0.25, twist=Twist(0.1)), SAME, 1.0),  # a clock that stands
        (reading(1.1, 0.8), ANEW, 1.1),  # 0.58 m in no time
        (reading(1.2, 1.8), ANEW, 1.2),  # 1.58 m in 0.1 s, of at most 1.5 m
        (reading(1.2, 1.7), NEXT, 1.0),
        (reading(1.2, 0.24, yaw=1.6), ANEW, 1.2),
        (reading(1.2, 0.24, yaw=6.2), NEXT, 1.0),  # 0.08 rad the short way
        (reading(1.09, 0.22), ANEW, 1.09),  # a stamp that goes back
        (reading(1.2, math.nan), REFUSED, 1.0),
        (reading(math.inf), REFUSED, 1.0),
        (reading(1.2, 1.1e9), REFUSED, 1.0),
    ],
)
def test_a_reading_goes_on_begins_anew_or_changes_nothing(
    given: Odometry, taken: int, oldest: float
) -> None:
    trail = OdometryTrail()
    assert [trail.take(reading(1.0, 0.2)), trail.take(reading(1.1, 0.22))] == [NEXT, NEXT]
    before = trail.pose_at(1.1)
    assert trail.take(given, True) == taken
    assert (trail.pose_at(1.1) == before) or taken == ANEW
    # 0.15 s before the oldest reading are covered.
    assert [trail.covers(oldest - 0.14), trail.covers(oldest - 0.16)] == [True, False]


@pytest.mark.parametrize(
    ("stamp", "x"),
    [
        (1.05, 0.21),
        (1.2, 0.24),
        (1.3, 0.25),  # 0.15 s after the newest at most
        (0.5, 0.1),  # back at the twist of the oldest
    ],
)
def test_a_pose_is_interpolated_and_extrapolated(stamp: float, x: float) -> None:
    trail = OdometryTrail()
    for one in (reading(1.0, 0.2), reading(1.1, 0.22)):
        trail.take(one)
    assert trail.pose_at(stamp).x == pytest.approx(x)


def test_a_trail_keeps_the_last_forty_readings_and_forgets_them_when_cleared() -> None:
    trail = OdometryTrail()
    for n in range(50):
        trail.take(reading(1.0 * n, 0.2 * n))
    assert [trail.covers(9.9), trail.covers(9.8)] == [True, False]
    assert trail.pose_at(12.5).x == pytest.approx(2.5)
    trail.clear()
    assert not trail.covers(49.0)
    assert trail.take(reading(0.0, 7.0)) == NEXT


@pytest.mark.parametrize("rate", [20.0, 41.0, 50.0, 100.0, 333.0, 1000.0, 10_000.0])
def test_a_trail_reaches_back_for_a_second_at_any_rate(rate: float) -> None:
    """docs/drivers.md. The robot turns at 0 to 2 rad/s and back in a second."""
    trail = OdometryTrail()
    count = round(3.0 * rate)
    for n in range(count + 1):
        at = n / rate
        trail.take(Odometry(at, Pose(0.2 * at, 0.0, 1.0 - math.cos(2.0 * at)), AHEAD))
    newest = count / rate
    assert trail.covers(newest - 1.0)
    for before in (0.0, 0.01, 0.0333, 0.5, 0.9, 0.97):
        at = newest - before
        pose = trail.pose_at(at)
        assert pose.x == pytest.approx(0.2 * at, abs=1e-6)
        # Between two readings 0.05 s apart: 4 rad/s2 times their square, by 8.
        assert pose.yaw == pytest.approx(1.0 - math.cos(2.0 * at), abs=1.3e-3)


def test_readings_of_forty_a_second_and_fewer_are_all_kept() -> None:
    trail = OdometryTrail()
    readings = [reading(0.026 * n + 0.0004 * (n % 3), 0.01 * (n * n % 7)) for n in range(40)]
    for one in readings:
        assert trail.take(one) == NEXT
    for one in readings:
        assert trail.pose_at(one.stamp).x == pytest.approx(one.pose.x)


def test_a_turning_robot_moves_along_the_chord() -> None:
    trail = OdometryTrail()
    trail.take(reading(0.0, twist=Twist(0.2, 1.0, 0.1)))
    pose, (ahead, left) = trail.pose_at(0.1), (0.02, 0.01)
    c, s = math.cos(0.05), math.sin(0.05)
    wanted = (c * ahead - s * left, s * ahead + c * left, 0.1)
    assert (pose.x, pose.y, pose.yaw) == pytest.approx(wanted)
