"""A pose that odometry carries on between the poses of a localisation such as AMCL."""

from __future__ import annotations

import math

import pytest

from swarmd.core.values import Odometry, Pose, SharedPose, Twist
from swarmd.drivers.ros.carried_pose import CarriedPose

STILL = Twist()


def odometry(stamp: float, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Odometry:
    return Odometry(stamp, Pose(x, y, yaw), STILL)


def located(stamp: float, x: float, y: float, yaw: float) -> SharedPose:
    return SharedPose(stamp, Pose(x, y, yaw), error=0.1, yaw_error=0.05, frame="map")


def step(carried: CarriedPose, reading: Odometry) -> SharedPose | None:
    """The pose that is carried to a reading, if any."""
    inputs = carried.on_odometry(reading)
    return inputs[0].pose if inputs else None


def drive(carried: CarriedPose, since: float, until: float, speed: float = 0.2) -> list[SharedPose]:
    """The carried poses while odometry drives along its x axis, at 20 Hz; x is 0 at 0 s."""
    stamps = [0.05 * tick for tick in range(round(20 * since), round(20 * until) + 1)]
    found = (step(carried, odometry(stamp, speed * stamp)) for stamp in stamps)
    return [pose for pose in found if pose is not None]


def test_a_robot_at_rest_keeps_its_pose_and_its_error() -> None:
    carried = CarriedPose()
    drive(carried, 0.0, 1.0, speed=0.0)
    carried.on_pose(located(0.9, 5.0, 1.0, 2.0))
    poses = drive(carried, 1.05, 61.0, speed=0.0)
    last = poses[-1]
    assert last.stamp == pytest.approx(61.0)
    assert (last.pose.x, last.pose.y, last.pose.yaw) == pytest.approx((5.0, 1.0, 2.0))
    assert (last.error, last.yaw_error, last.frame) == (0.1, 0.05, "map")
    assert 15 * 60 <= len(poses) <= 20 * 60


def test_odometry_carries_the_pose_in_the_shared_frame_and_the_error_grows() -> None:
    carried = CarriedPose()
    drive(carried, 0.0, 1.0)
    # At 0.8 s, with 0.16 m of odometry, the robot faces +y of the map. The pose comes at 1 s.
    carried.on_pose(located(0.8, 5.0, 1.0, math.pi / 2))
    last = drive(carried, 1.05, 2.8)[-1]
    assert (last.pose.x, last.pose.y) == pytest.approx((5.0, 1.0 + 0.2 * 2.0))
    assert last.pose.yaw == pytest.approx(math.pi / 2)
    # 5 % of the way, and the error of yaw over the way.
    assert last.error == pytest.approx(0.1 + (0.05 + 0.05) * 0.4, abs=0.002)


@pytest.mark.parametrize("rate", [50, 100, 1000])
def test_a_pose_that_is_two_seconds_late_is_carried_at_any_rate_of_odometry(rate: int) -> None:
    carried = CarriedPose()
    for tick in range(4 * rate + 1):
        step(carried, odometry(tick / rate, 0.2 * tick / rate))
    carried.on_pose(located(2.0, 5.0, 1.0, math.pi / 2))
    last = step(carried, odometry(4.0 + 1 / rate, 0.2 * (4.0 + 1 / rate)))
    assert last is not None
    assert (last.pose.x, last.pose.y) == pytest.approx((5.0, 1.4), abs=0.005)


def test_a_turn_makes_the_yaw_less_certain() -> None:
    carried = CarriedPose()
    drive(carried, 0.0, 1.0, speed=0.0)
    carried.on_pose(located(1.0, 0.0, 0.0, 0.5))
    turns = [step(carried, odometry(1.0 + 0.1 * n, yaw=0.1 * n)) for n in range(1, 11)]
    last = turns[-1]
    assert last is not None
    assert last.pose.yaw == pytest.approx(1.5)
    assert last.yaw_error == pytest.approx(0.05 + 0.05 * 1.0)


def test_noise_of_odometry_at_rest_is_no_way() -> None:
    carried = CarriedPose()
    drive(carried, 0.0, 1.0, speed=0.0)
    carried.on_pose(located(1.0, 0.0, 0.0, 0.0))
    poses = [step(carried, odometry(1.0 + 0.05 * n, x=0.002 * (-1) ** n)) for n in range(1, 2001)]
    assert poses[-1] is not None
    assert poses[-1].error == 0.1


def test_a_jump_of_the_localisation_is_a_jump_of_the_pose() -> None:
    carried = CarriedPose()
    drive(carried, 0.0, 1.0)
    carried.on_pose(located(1.0, 5.0, 1.0, 0.0))
    drive(carried, 1.05, 2.0)
    carried.on_pose(located(2.0, 9.0, 9.0, 0.0))
    first = drive(carried, 2.05, 3.0)[0]
    assert (first.pose.x, first.pose.y) == pytest.approx((9.0 + 0.2 * (first.stamp - 2.0), 9.0))


def test_a_source_of_four_poses_a_second_is_not_carried() -> None:
    carried, found = CarriedPose(), []
    for tick in range(200):
        stamp = 0.05 * tick
        if tick % 4 == 0:
            carried.on_pose(located(stamp, 0.0, 0.0, 0.0))
        found.append(step(carried, odometry(stamp)))
    assert found == [None] * 200


def test_without_a_pose_for_two_metres_the_localisation_has_ended() -> None:
    carried = CarriedPose()
    drive(carried, 0.0, 1.0)
    carried.on_pose(located(1.0, 0.0, 0.0, 0.0))
    stamps = [pose.stamp for pose in drive(carried, 1.05, 15.0)]
    assert stamps[-1] == pytest.approx(1.0 + 2.0 / 0.2, abs=0.2)


@pytest.mark.parametrize("stamp", [-0.5, 1.5, 1000.0])
def test_a_pose_of_another_clock_is_not_carried(stamp: float) -> None:
    carried = CarriedPose()
    drive(carried, 0.0, 1.0)
    carried.on_pose(located(stamp, 0.0, 0.0, 0.0))
    assert drive(carried, 1.05, 2.0) == []


@pytest.mark.parametrize("jump", [odometry(2.05, x=30.0), odometry(0.5)])
def test_after_a_jump_of_odometry_the_pose_is_not_known(jump: Odometry) -> None:
    carried = CarriedPose()
    drive(carried, 0.0, 1.0)
    carried.on_pose(located(1.0, 0.0, 0.0, 0.0))
    assert drive(carried, 1.05, 2.0)
    assert step(carried, jump) is None


def test_a_kept_pose_counts_from_the_first_reading_with_the_motion_that_it_may_hide() -> None:
    carried = CarriedPose()
    carried.on_kept_pose(located(-500.0, 5.0, 1.0, 0.0))
    first, *_ = drive(carried, 0.0, 1.0, speed=0.0)
    assert (first.pose.x, first.pose.y) == (5.0, 1.0)
    assert first.error == pytest.approx(0.1 + 0.25)  # m, AMCL's update_min_d
    assert first.yaw_error == pytest.approx(0.05 + 0.2)  # rad, its update_min_a
    carried.on_pose(located(1.0, 7.0, 1.0, 0.0))
    carried.on_kept_pose(located(-500.0, 5.0, 1.0, 0.0))
    assert drive(carried, 1.05, 2.0, speed=0.0)[-1].pose.x == 7.0


@pytest.mark.parametrize(
    ("moved", "after", "is_kept"),
    [
        ((0.0, 0.0, 0.0), 0.05, True),
        ((0.3, 0.0, 0.0), 0.05, False),  # a base at rest, whose odometry begins anew
        ((0.0, 0.0, 0.9), 0.05, False),
        ((0.0, 0.0, 0.0), 3.0, True),  # a late reading of a base at rest
        ((0.3, 0.0, 0.0), 3.0, False),
    ],
)
def test_odometry_that_may_have_begun_anew_carries_nothing(
    moved: tuple[float, float, float], after: float, is_kept: bool
) -> None:
    carried = CarriedPose()
    drive(carried, 0.0, 1.0, speed=0.0)
    carried.on_pose(located(0.9, 1.5, 0.5, 2.0))
    assert drive(carried, 1.05, 4.0, speed=0.0)
    assert (step(carried, odometry(4.0 + after, *moved)) is not None) is is_kept


def test_the_error_of_yaw_that_a_turn_adds_counts_for_the_way_behind_it() -> None:
    """0.9 turns with 5 % of error in yaw, then 1.9 m: 0.28 rad, some 0.53 m beside."""
    carried = CarriedPose()
    step(carried, odometry(0.0))
    carried.on_pose(located(0.0, 0.0, 0.0, 0.0))
    turn = 0.9 * math.tau
    readings = [odometry(0.05 * n, yaw=min(0.1 * n, turn)) for n in range(1, 60)]
    way = [odometry(3.0 + 0.05 * n, x=0.05 * n, yaw=turn) for n in range(39)]
    poses = [step(carried, one) for one in (*readings, *way)]
    assert poses[-1] is not None
    assert poses[-1].error >= 0.1 + 1.9 * (0.05 + 0.05 * turn)
    assert abs(poses[-1].pose.yaw) <= math.pi


def test_a_turn_without_a_pose_ends_it() -> None:
    carried = CarriedPose()
    step(carried, odometry(0.0))
    carried.on_pose(located(0.0, 0.0, 0.0, 0.0))
    poses = [step(carried, odometry(0.05 * n, yaw=0.1 * n)) for n in range(1, 80)]
    assert poses[60] is not None
    assert poses[-1] is None


def test_a_pose_that_is_delivered_again_changes_nothing() -> None:
    carried = CarriedPose()
    drive(carried, 0.0, 1.0, speed=0.0)
    carried.on_pose(located(0.9, 1.5, 0.5, 2.0))
    drive(carried, 1.05, 40.0, speed=0.0)
    carried.on_pose(located(0.9, 1.5, 0.5, 2.0))
    assert drive(carried, 40.05, 41.0, speed=0.0)


def test_a_localisation_that_has_ended_gives_no_pose_before_its_next_one() -> None:
    carried = CarriedPose()
    drive(carried, 0.0, 1.0, speed=0.0)
    carried.on_pose(located(0.9, 1.5, 0.5, 2.0))
    carried.forget()
    carried.on_kept_pose(located(0.9, 1.5, 0.5, 2.0))
    assert not drive(carried, 1.05, 3.0, speed=0.0)
    carried.on_pose(located(2.9, 1.5, 0.5, 2.0))
    assert drive(carried, 3.05, 4.0, speed=0.0)
