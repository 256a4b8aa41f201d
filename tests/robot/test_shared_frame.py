"""Peers that are told by poses in a shared frame: places, ages, errors; when none is told."""

from __future__ import annotations

import math
from typing import Any

import pytest
from msgspec.structs import replace

from swarmd.core.events import OdometryInput, PeersInput, PlaceInput, PoseInput
from swarmd.core.messages import Body, Reason, State, Status
from swarmd.core.values import Odometry, PeerPlace, Pose, SharedPose, Twist
from swarmd.robot.own_pose import FASTEST_POSE, POSE_TIMEOUT, OwnPose
from swarmd.robot.peers import TOLD_TIMEOUT, Peers
from swarmd.robot.protection.compatibility import ACCEPTS_NONE, body_of
from swarmd.robot.protection.fence.fence_settings import FenceSettings
from swarmd.robot.sensors import Sensors
from swarmd.settings.platforms import load_platform
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS

BURGER, JACKAL = body_of(load_platform("burger")), body_of(load_platform("jackal"))
REST = Twist()
HALF = 0.5 * FASTEST_POSE


def shared(x: float = 1.0, y: float = 2.0, yaw: float = 0.0, **changes: object) -> SharedPose:
    pose = SharedPose(0.0, Pose(x, y, yaw), error=0.02, yaw_error=0.01, frame="mocap")
    return replace(pose, **changes)


def place(x: float, y: float, *, age: float = 0.1, frame: str = "mocap") -> PeerPlace:
    return PeerPlace("b", frame, x, y, error=0.03, age=age)


def peers(bodies: dict[str, Body | None] | None = None, name: str = "jackal") -> Peers:
    platform = load_platform(name)
    made = Peers(platform, ACCEPTS_NONE, OwnPose(platform.limits))
    made.on_peers({"b": BURGER} if bodies is None else bodies)
    return made


def located(robot: Peers, pose: SharedPose, now: float, twist: Twist | None = REST) -> Peers:
    """The robot after poses at 50 Hz, all without delay, up to `now`."""
    for number in range(9, -1, -1):
        at = now - 0.02 * number
        robot.own_pose.take(replace(pose, stamp=at), twist, at)
    return robot


def test_a_peer_is_an_obstacle_in_the_base_frame_at_the_time_of_the_own_pose() -> None:
    robot = located(peers(), shared(1.0, 2.0, math.pi / 2), 10.0)
    assert robot.holds(10.0)
    assert robot.on_place(place(1.0, 4.0, age=0.04), 10.0)  # 2 m ahead
    assert robot.on_place(place(0.0, 2.0, age=0.04), 10.0)  # then 1 m to the left
    (told,) = robot.told(10.2)
    assert (told.x, told.y) == pytest.approx((0.0, 1.0))
    assert told.age == pytest.approx(0.2 + HALF)
    assert told.radius == pytest.approx(BURGER.radius + 0.02 + 0.03 + 0.01 * 1.0, abs=1e-4)
    assert not robot.holds(10.2)


def test_the_circle_grows_by_the_motion_of_the_peer_until_the_time_of_the_own_pose() -> None:
    robot = located(peers(), shared(), 10.0)
    sizes = []
    for age in (0.45, HALF, 0.04, 0.0):
        robot.on_place(place(2.0, 2.0, age=age), 10.0)
        sizes.append(robot.told(10.0)[0].radius)
    assert sizes[1:3] == pytest.approx([sizes[3]] * 2, abs=1e-4)
    assert sizes[0] - sizes[3] == pytest.approx(BURGER.surface_speed * 0.4, abs=1e-4)


def test_the_unknown_part_of_the_own_delay_counts_with_the_own_motion() -> None:
    still = located(peers(), shared(), 10.0)
    moving = located(peers(), shared(), 10.0, Twist(0.5, 1.0))
    unknown = located(peers(), shared(), 10.0, None)
    limits = load_platform("jackal").limits
    for robot in (still, moving, unknown):
        robot.on_place(place(3.0, 2.0), 10.0)
    radius, *others = (robot.told(10.0)[0].radius for robot in (still, moving, unknown))
    more = [HALF * (0.5 + 2.0), HALF * (limits.linear + 2.0 * limits.angular)]
    assert [other - radius for other in others] == pytest.approx(more, abs=1e-4)


def test_a_delay_of_the_own_pose_counts_as_age() -> None:
    robot = located(peers(), shared(), 10.0)
    robot.own_pose.take(shared(stamp=10.02), REST, 10.22)
    robot.on_place(place(2.0, 2.0), 10.22)
    assert robot.told(10.22)[0].age == pytest.approx(0.2 + HALF, abs=1e-3)


def test_the_hold_returns_a_second_after_the_older_pose_was_measured() -> None:
    robot = located(peers(), shared(), 10.0)
    robot.on_place(place(2.0, 2.0, age=0.3), 10.0)
    until = 9.7 + TOLD_TIMEOUT
    assert robot.hold_due_at() == pytest.approx(until)
    assert robot.told(until - 0.01)
    assert not robot.holds(until - 0.01)
    assert robot.told(until + 0.01) == ()
    assert robot.holds(until + 0.01)


@pytest.mark.parametrize(
    ("pose", "other", "now"),
    [
        (shared(frame="map"), place(2.0, 2.0), 10.0),
        (shared(), place(2.0, 2.0, age=POSE_TIMEOUT + 0.01), 10.0),
        (shared(), place(2.0, 2.0), 10.0 + POSE_TIMEOUT),
        (shared(x=math.nan), place(2.0, 2.0), 10.0),
        (shared(error=math.nan), place(2.0, 2.0), 10.0),
        (shared(error=-0.1), place(2.0, 2.0), 10.0),
        (shared(yaw_error=math.inf), place(2.0, 2.0), 10.0),
        (shared(frame=""), place(2.0, 2.0, frame=""), 10.0),
        (shared(), PeerPlace("c", "mocap", 2.0, 2.0, 0.03, 0.1), 10.0),
    ],
)  # fmt: skip
def test_other_frames_old_and_invalid_poses_and_strangers_tell_nothing(
    pose: SharedPose, other: PeerPlace, now: float
) -> None:
    robot = located(peers(), pose, 10.0)
    assert not robot.on_place(other, now)
    assert robot.told(now) == ()
    assert robot.holds(now)


def test_a_pose_whose_stamp_stands_is_not_renewed() -> None:
    robot = located(peers(), shared(), 10.0)
    for number in range(100):
        robot.own_pose.take(shared(stamp=10.0), REST, 10.0 + 0.02 * number)
    assert robot.pose_to_tell(12.0) is None
    assert not robot.on_place(place(2.0, 2.0), 12.0)


def test_the_pose_is_told_with_its_highest_age_while_a_peer_may_miss_the_robot() -> None:
    robot = located(peers({"j": JACKAL}, "burger"), shared(), 10.0)
    told = robot.pose_to_tell(10.2)
    assert told is not None
    assert told[0].pose == shared().pose
    assert told[1] == pytest.approx(0.2 + FASTEST_POSE)
    assert robot.pose_to_tell(10.0 + POSE_TIMEOUT) is None
    robot.on_peers({"b": BURGER})
    assert robot.pose_to_tell(10.2) is None  # a Burger sees a Burger
    robot.on_peers({"b": replace(BURGER, scan_plane=None)})
    assert robot.pose_to_tell(10.2) is not None


def test_a_robot_runs_beside_an_unseen_peer_while_it_is_told_and_no_longer() -> None:
    harness = RobotHarness("jackal", PATTERNS)
    harness.advance(1.0)
    harness.applied("run", pattern="forward")
    harness.advance(0.5)
    robot = harness.robot
    robot.step(PeersInput({"b": BURGER}), harness.now)
    harness.advance(0.2)
    assert harness.status.reason is Reason.INCOMPATIBLE_PEER
    for _ in range(10):
        robot.step(PoseInput(shared(stamp=harness.now)), harness.now)
        robot.step(PlaceInput(place(-3.0, 2.0)), harness.now)
        harness.advance(0.1)
    assert harness.twist.linear > 0.0
    harness.advance(TOLD_TIMEOUT)
    assert harness.twist.is_zero
    assert harness.status.reason is Reason.INCOMPATIBLE_PEER


def test_a_pattern_gets_the_own_pose_until_it_is_too_old() -> None:
    sensors = Sensors(load_platform("burger"))
    assert sensors.inputs(10.0, 0.1).pose is None
    for number in range(10):
        at = 10.0 + 0.02 * number
        sensors.on_pose(shared(1.0, 2.0, stamp=at), at)
    assert sensors.inputs(10.2, 0.1).pose == Pose(1.0, 2.0)
    last = 10.18 - HALF + POSE_TIMEOUT
    sensors.on_pose(shared(5.0, 2.0, stamp=10.18), 10.4)  # its stamp does not advance
    sensors.on_pose(shared(math.nan, 2.0, stamp=10.5), 10.5)
    assert sensors.inputs(last - 0.001, 0.1).pose == Pose(1.0, 2.0)
    assert sensors.inputs(last + 0.001, 0.1).pose is None
    sensors.on_pose(shared(3.0, 2.0, stamp=10.7), 11.1)  # 0.4 s late
    assert sensors.inputs(11.15, 0.1).pose == Pose(3.0, 2.0)
    assert sensors.inputs(11.25, 0.1).pose is None


FENCE = FenceSettings(frame="mocap", polygon=[(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)])


def told(harness: RobotHarness, seconds: float, **changes: Any) -> None:
    """Let time pass with a pose each 0.1 s."""
    for _ in range(round(seconds / 0.1)):
        harness.robot.step(PoseInput(shared(stamp=harness.now, **changes)), harness.now)
        harness.advance(0.1)


def statuses(harness: RobotHarness, count: int, **changes: Any) -> list[Status]:
    """The statuses of so many steps of `told`."""
    seen = []
    for _ in range(count):
        told(harness, 0.1, **changes)
        seen.append(harness.status)
    return seen


def test_a_fenced_robot_runs_while_it_has_a_pose_and_no_longer() -> None:
    harness = RobotHarness("burger", PATTERNS, fence=FENCE)
    harness.advance(1.0)
    harness.applied("run", pattern="forward")
    harness.advance(0.5)
    assert harness.status.reason is Reason.NO_POSE
    assert harness.status.detail == "no pose in the frame 'mocap' has arrived"
    told(harness, 1.2, yaw=1.0)
    assert harness.twist.linear > 0.0
    told(harness, 0.1, x=3.0)  # a jump
    assert harness.twist.is_zero
    assert harness.status.detail.startswith("the pose jumped by 2.00 m")
    told(harness, 0.5, x=3.0)
    assert harness.twist.linear > 0.0
    told(harness, 0.1, x=3.0, frame="map")
    assert harness.twist.is_zero
    assert harness.status.detail == "the fence is in the frame 'mocap', the pose in 'map'"
    told(harness, 0.6, x=3.0)
    assert harness.twist.linear > 0.0
    harness.advance(POSE_TIMEOUT + 0.1)
    assert harness.twist.is_zero
    assert harness.status.reason is Reason.NO_POSE
    harness.advance(2.0)
    assert harness.status.state is State.STOPPED
    assert harness.status.reason is Reason.NO_POSE


def test_a_pose_that_stands_still_ends_the_run_and_the_status_tells_the_figure() -> None:
    harness = RobotHarness("burger", PATTERNS, fence=FENCE)
    harness.odometry, x = None, 0.0

    def drive(seconds: float, speed: float) -> Status:
        nonlocal x
        for _ in range(round(seconds / 0.1)):
            x += 0.1 * speed
            harness.step(OdometryInput(Odometry(harness.now, Pose(x), Twist(speed))))
            told(harness, 0.1, x=2.0)
        return harness.status

    drive(1.0, 0.0)
    harness.applied("run", pattern="forward")
    drive(0.3, 0.0)
    assert harness.twist.linear > 0.0
    held = drive(0.8, 0.2)
    assert (held.state, held.reason) == (State.RUNNING, Reason.NO_POSE)
    assert harness.twist.is_zero
    ended = drive(2.2, 0.0)
    assert (ended.state, ended.reason) == (State.STOPPED, Reason.NO_POSE)
    for status in (held, ended):
        assert "the pose moved otherwise than odometry by 0." in status.detail
        assert status.fence is not None
        assert status.fence.text == status.detail
        assert status.fence.clearance is None


def test_a_fence_stops_a_robot_and_the_status_tells_it() -> None:
    harness = RobotHarness("burger", PATTERNS, fence=FENCE)
    harness.advance(1.0)
    harness.applied("run", pattern="forward")
    seen = [status.fence for status in statuses(harness, 30, x=3.8)]
    assert harness.twist.linear <= 0.0  # recovery backs off, as before a wall
    assert all(fence is not None for fence in seen)
    assert any(fence.limits for fence in seen if fence is not None)
    fence = seen[-1]
    assert fence is not None
    assert fence.polygons == (tuple(FENCE.polygon),)
    assert fence.clearance == pytest.approx(0.2 - BURGER.radius, abs=0.01)
    told(harness, 4.0, x=2.0)
    assert harness.twist.linear > 0.0


def test_a_fence_without_pose_may_let_the_robot_drive() -> None:
    made = replace(FENCE, without_pose="drive")
    harness = RobotHarness("burger", PATTERNS, fence=made)
    harness.advance(1.0)
    harness.applied("run", pattern="forward")
    harness.advance(1.0)
    assert harness.twist.linear > 0.0
    assert harness.status.fence is not None
    assert harness.status.fence.clearance is None
    told(harness, 1.2, x=3.8)
    assert harness.twist.linear <= 0.0
