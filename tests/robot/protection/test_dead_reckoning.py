from __future__ import annotations

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from swarmd.core.values import MAX_EXTRAPOLATION, ZERO, Odometry, Pose, Twist
from swarmd.robot.protection.binding_range import REACTION_TIME
from tests.support.barrier_parts import DeadReckoning

SPEED = st.floats(-1, 1)
PERIOD = 0.05


def arc(twist: Twist, time: float) -> Pose:
    """The pose after `time` at a constant twist from the origin, in closed form."""
    v, w = twist.linear, twist.angular
    if abs(w) < 1e-9:
        return Pose(v * time, 0.0, 0.0)
    turn = w * time
    return Pose(v / w * math.sin(turn), v / w * (1.0 - math.cos(turn)), turn)


def driven(twist: Twist, until: float = 1.0) -> tuple[DeadReckoning, Odometry]:
    """Dead reckoning after driving with a constant twist, and the last reading."""
    motion, reading = DeadReckoning(), Odometry(0.0, Pose(), twist)
    for n in range(round(until / PERIOD) + 1):
        reading = Odometry(n * PERIOD, arc(twist, n * PERIOD), twist)
        motion.update(reading)
    return motion, reading


def near(pose: Pose, other: Pose, tolerance: float) -> bool:
    far = math.hypot(pose.x - other.x, pose.y - other.y)
    return far <= tolerance and abs(pose.yaw - other.yaw) <= tolerance


@given(SPEED, SPEED, st.floats(0.0, 0.9), st.floats(0.0, 0.1))
@example(1.0, 1.0, 0.0, 0.1)
def test_pose_is_interpolated_and_extrapolated(v: float, w: float, ago: float, age: float) -> None:
    motion, _ = driven(Twist(v, w))
    at = motion.pose(age, ago)
    assert near(at, arc(Twist(v, w), 1.0 + age - ago), 2e-3)  # a chord for an arc of 0.1 rad


def test_pose_before_the_first_reading_is_extrapolated_back() -> None:
    motion, _ = driven(Twist(0.2), until=0.1)
    assert near(motion.pose(0.0, 0.3), Pose(-0.04), 1e-9)


@pytest.mark.parametrize(
    ("now", "command", "age"),
    [(0.0, 0.2, 0.0), (0.2, 0.0, 0.04), (0.2, 0.2, 0.1), (0.2, -0.2, 0.0), (0.02, 0.0, 0.1)],
)
def test_predicted_pose_ramps_to_the_present_command(
    now: float, command: float, age: float
) -> None:
    motion, last = driven(Twist(now))
    ahead = motion.predicted_pose(age, Twist(command))
    speed, x, dt = now, last.pose.x, 1e-5
    for _ in range(round((age + REACTION_TIME) / dt)):
        speed += min(max(command - speed, -1.0 * dt), 1.0 * dt)
        x += speed * dt
    assert ahead.x == pytest.approx(x, abs=1e-5)


def test_extrapolation_of_an_old_reading_is_bounded() -> None:
    motion, last = driven(Twist(0.2))
    ahead = motion.predicted_pose(2.0, Twist(0.2))
    assert ahead.x == pytest.approx(last.pose.x + 0.2 * (MAX_EXTRAPOLATION + REACTION_TIME))


def test_clock_that_goes_back_resets_the_history() -> None:
    motion, _ = driven(Twist(0.2))
    again = Odometry(0.3, Pose(7.0), ZERO)
    motion.update(again)
    assert motion.pose(0.0, 0.2) == Pose(7.0)
    assert motion.resets == 1


def test_repeated_reading_is_not_a_clock_reset() -> None:
    motion, last = driven(Twist(0.2))
    for reading in (last, Odometry(last.stamp, last.pose, last.twist)):  # as it may come again
        motion.update(reading)
    assert motion.resets == 0
    assert near(motion.pose(0.1, 0.5), Pose(0.2 * 0.6), 1e-9)


def test_a_clock_that_stands_is_no_reset() -> None:
    """Simulators publish several readings of one time."""
    motion, last = driven(Twist(0.2))
    motion.update(Odometry(last.stamp, Pose(0.21), Twist(0.1)))
    assert motion.resets == 0
    assert near(motion.pose(0.1, 0.5), Pose(0.2 * 0.6), 1e-9)


def test_new_reading_with_an_old_stamp_is_a_clock_reset() -> None:
    motion, last = driven(Twist(0.2))
    again = Odometry(last.stamp, Pose(7.0), last.twist)
    motion.update(again)
    assert motion.resets == 1
    assert motion.pose(0.0, 0.0) == Pose(7.0)


def test_pose_without_readings_is_the_origin() -> None:
    motion = DeadReckoning()
    assert motion.pose(0.0, 0.1) == motion.predicted_pose(0.0, Twist(0.2)) == Pose()


def test_headings_are_interpolated_the_short_way() -> None:
    motion = DeadReckoning()
    for stamp, yaw in ((0.0, 3.1), (0.1, -3.1)):
        motion.update(Odometry(stamp, Pose(0.0, 0.0, yaw), ZERO))
    between = motion.pose(0.0, 0.05).yaw
    assert math.cos(between) == pytest.approx(-1.0, abs=1e-9)


@pytest.mark.parametrize("jump", [Pose(0.2, 5.0), Pose(0.2, 0.0, 1.5)])
def test_a_pose_that_jumps_is_a_clock_reset(jump: Pose) -> None:
    motion, last = driven(Twist(0.2))
    again = Odometry(last.stamp + 0.05, jump, last.twist)
    motion.update(again)
    assert motion.resets == 1
    assert motion.pose(0.0, 0.0) == again.pose
