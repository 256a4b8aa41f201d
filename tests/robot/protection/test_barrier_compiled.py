"""Mode `barrier` compiled and interpreted: the recorded decisions, and odd inputs.

`decided` of tests/support/filter_sim.py compares both paths for each property.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.values import ZERO, Odometry, Platform, Pose, Scan, Twist
from swarmd.robot.protection.decision import DecisionContext, ModeDecision, ToldObstacle
from swarmd.robot.protection.footprint import ScanGeometry
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import scan_from
from tests.support.decision_corpus import Stream, decided, platform_of, read
from tests.support.filter_sim import assert_alike, under_barrier
from tests.support.kernel_forms import both_forms, compares_forms

FORMS = both_forms("swarmd.robot.protection.barrier")
KERNEL = FORMS[1]
BURGER, WAFFLE, JACKAL = (
    under_barrier(load_platform(name)) for name in ("burger", "waffle_pi", "jackal")
)
NOW = 5.0
HERE = Pose(1.0, -2.0, 3.0)


class Robot:
    """A robot with mode `barrier`, and a face of `rays` rays ahead, m beyond range_min."""

    def __init__(self, platform: Platform, beyond: float, rays: int = 36) -> None:
        self.barrier, self.platform = KERNEL.Barrier(platform), platform
        self.ranges = np.full(360, math.inf)
        self.ranges[:rays] = platform.scan.range_min + beyond

    def see(self, odometry: Odometry, at: float = NOW) -> None:
        scan = scan_from(self.platform, self.ranges, self.platform.scan.bearings)
        context = DecisionContext(at, 0.0, odometry, 0.0)
        self.barrier.observe(scan, ScanGeometry(self.platform.scan), context)

    def decide(
        self,
        requested: Twist,
        odometry: Odometry,
        after: float = 0.01,
        told: tuple[ToldObstacle, ...] = (),
        command: Twist = ZERO,
    ) -> ModeDecision:
        context = DecisionContext(NOW + after, after, odometry, 0.0, told=told)
        found: ModeDecision = self.barrier.decide(requested, context, command=command, touch=None)
        return found


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", ["stamp", "x", "yaw", "linear"])
def test_odometry_that_is_not_finite_lets_no_command_pass(place: str, number: float) -> None:
    """Protection gives zero for a command that is not finite."""
    values = {"stamp": NOW, "x": 0.0, "yaw": 0.0, "linear": 0.0, place: number}
    pose = Pose(values["x"], 0.0, values["yaw"])
    odometry = Odometry(values["stamp"], pose, Twist(values["linear"]))
    robot = Robot(WAFFLE, 0.2)
    robot.see(odometry)
    twist = robot.decide(Twist(WAFFLE.limits.linear), odometry).twist
    assert twist.is_zero or not twist.is_finite


def test_contact_stays_one_after_the_robot_has_moved_away() -> None:
    """Its cap is 0 although there is room by then."""
    calm = under_barrier(BURGER, others_speed=0.001, surface_speed=5.0, unseen_extent=0.0)
    robot = Robot(calm, -math.inf, 8)
    robot.see(Odometry(NOW, Pose(), ZERO))
    away = Odometry(NOW + 0.2, Pose(-0.13), ZERO)
    for angular in (0.8, -0.8):
        assert robot.decide(Twist(0.22, angular), away, 0.2).is_active


@pytest.mark.parametrize(("distance", "nearer"), [(0.13, 0.0), (0.16, 0.02)])
def test_contact_with_what_is_seen_lasts_until_the_next_scan(
    distance: float, nearer: float
) -> None:
    """By odometry a robot that is pushed leaves the obstacle, which follows it.

    The return lies less than 4 cm beside the robot in the scan, or once the robot is `nearer`.
    """
    robot = Robot(under_barrier(BURGER, unseen_extent=0.0), math.inf)
    robot.ranges[55] = distance
    robot.see(Odometry(NOW, Pose(), ZERO))
    for after, y in ((0.02, nearer), (0.1, -0.05)):
        odometry = Odometry(NOW + after, Pose(0.0, y), ZERO)
        decision = robot.decide(Twist(-0.22), odometry, after)
        assert -0.015 - 1e-9 <= decision.twist.linear < -0.01
    robot.ranges[55] = 0.2
    robot.see(Odometry(NOW + 0.2, Pose(0.0, -0.05), ZERO))
    assert not robot.decide(Twist(-0.22), Odometry(NOW + 0.21, Pose(0.0, -0.05), ZERO)).is_active


@pytest.mark.parametrize(
    ("command", "has_left"),
    [(Twist(-0.22), True), (Twist(-0.03), False), (ZERO, False), (Twist(0.22), False)],
)
def test_only_motion_that_commands_explain_leaves_a_hidden_obstacle(
    command: Twist, has_left: bool
) -> None:
    """What is in the blind zone ahead may push the robot back, by 0.4 m in all."""
    robot = Robot(BURGER, 0.01)
    robot.see(Odometry(NOW - 0.2, Pose(), ZERO), NOW - 0.2)
    robot.ranges[:] = math.inf
    for i in range(11):
        odometry = Odometry(NOW + 0.2 * i, Pose(-0.04 * i), Twist(-0.2))
        robot.see(odometry, odometry.stamp)
        decision = robot.decide(Twist(0.22), odometry, 0.2 * i + 0.01, command=command)
        assert i > 0 or decision.is_active
    assert decision.is_active != has_left


@pytest.mark.parametrize("x", [0.0, -0.0, 1e-17, -1e-17])
@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.0, -3.0])
def test_an_obstacle_told_at_the_axle_is_reported_ahead(x: float, yaw: float) -> None:
    """Its direction is not defined: the signs of zeros and rounding must not decide."""
    robot, odometry = Robot(WAFFLE, math.inf), Odometry(NOW, Pose(1.0, -2.0, yaw), ZERO)
    robot.see(odometry)
    told = (ToldObstacle(x, -x, 0.0, 0.0),)
    slow = Twist(0.01), Twist(-0.01, 0.0036)  # below the speed in contact
    rows = [row for twist in slow for row in robot.decide(twist, odometry, told=told).rows]
    assert {row.bearing for row in rows} == {0.0}


def test_other_odometry_at_the_same_time_is_another_situation() -> None:
    robot, before = Robot(WAFFLE, 0.45), Odometry(NOW, HERE, ZERO)
    robot.see(before)
    later = Odometry(NOW + 0.01, Pose(1.05, -2.0, 3.05), Twist(0.1))
    top = Twist(WAFFLE.limits.linear)
    assert robot.decide(top, before, 0.0).twist != robot.decide(top, later, 0.0).twist


def test_equal_told_obstacles_at_the_same_time_are_the_same_situation() -> None:
    """The command that takes effect first has changed, and is not looked at again."""
    robot, odometry = Robot(BURGER, math.inf), Odometry(NOW, HERE, ZERO)
    robot.see(odometry)
    told: dict[str, float] = {"x": 0.0, "y": 0.0, "radius": 0.0, "age": 0.0}
    first, second = (
        robot.decide(Twist(-0.22, 2.84), odometry, 0.0, (ToldObstacle(**told),), command)
        for command in (ZERO, Twist(-0.01, 0.1))
    )
    assert first == second
    assert first.is_active


@pytest.mark.parametrize("kind", [np.float32, np.int64])
def test_ranges_may_be_of_any_number_type(kind: type) -> None:
    robot, odometry = Robot(JACKAL, 0.0), Odometry(NOW, HERE, ZERO)
    robot.ranges = np.full(360, 1, kind)
    robot.see(odometry)
    assert robot.decide(Twist(0.5, 0.3), odometry).is_active


@pytest.mark.parametrize("before", [1, 3])
def test_a_scan_with_more_ranges_than_rays_is_refused_and_frees_no_way(before: int) -> None:
    """The rays of the scan before, of which there were `before`, do not count."""
    barrier, geometry = KERNEL.Barrier(BURGER), ScanGeometry(BURGER.scan)
    context, bearings = DecisionContext(1.0, 0.0), np.zeros(1)
    scan = Scan(1, 1.0, np.array([0.2]), bearings, 0.1, 3.5)
    rays = {"ranges": np.full(before, 0.2), "bearings": np.zeros(before)}
    barrier.observe(replace(scan, **rays), geometry, context)
    barrier.observe(scan, geometry, context)
    for ranges, ages in ((np.full(2, np.inf), None), (np.array([np.inf]), np.zeros(2))):
        with pytest.raises(IndexError):
            barrier.observe(replace(scan, ranges=ranges, ages=ages), geometry, context)
    decision = barrier.decide(Twist(0.22), context, command=ZERO, touch=None)
    assert decision.is_active
    assert decision.twist.linear < 0.22


@pytest.mark.short_rows(5)
@compares_forms
@pytest.mark.parametrize("stream", read(), ids=lambda stream: stream.scene)
def test_recorded_decisions_are_made_again(stream: Stream) -> None:
    """Robots in crowds and among rammers; studies/record_decisions.py wrote the file."""
    platform = platform_of(stream)
    one, other = (decided(stream, kernel.Barrier(platform)) for kernel in FORMS)
    for (event, expected), (_, found) in zip(one, other, strict=True):
        assert_alike(expected, found)
        assert event.twist is not None
        assert event.is_active == expected.is_active
        assert expected.twist.linear == pytest.approx(event.twist.linear)
        assert expected.twist.angular == pytest.approx(event.twist.angular)
