"""Closed loop: obstacles that the sensor does not see because they are too near."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import msgspec
import numpy as np
import pytest

from swarmd.core.values import Odometry, Platform, Pose, Twist
from swarmd.robot.protection.binding_range import REACTION_TIME
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import scan_from
from tests.support.barrier_parts import reciprocal_cap
from tests.support.examples import part
from tests.support.filter_sim import FilterSim, Shape, box, decided, pole, under_barrier
from tests.support.kernel_forms import long_run

BURGER, JACKAL = under_barrier(load_platform("burger")), under_barrier(load_platform("jackal"))
BLIND = JACKAL.scan.range_min
AHEAD = Twist(0.5)
NO_FAULT = 0.02


def calm(platform: Platform, near: str = "lost", **more: object) -> Platform:
    """Obstacles are assumed to stand and to be fully visible; there is no keep-out circle."""
    scan = replace(platform.scan, near=near)  # type: ignore[arg-type]  # one of the two words
    settings = {"others_speed": 0.001, "surface_speed": 5.0, "unseen_extent": 0.0, "keep_out": None}
    return under_barrier(replace(platform, scan=scan), **{**settings, **more})


def test_return_too_close_to_measure_counts_as_contact() -> None:
    """A Jackal whose sensor reports near obstacles, with a pole 0.5 m ahead."""
    platform = calm(JACKAL, near="reported")
    run = FilterSim(platform, [pole(0.1, Pose(0.6))]).run(AHEAD, 4.0)
    assert run.touch is None
    assert run.poses[-1].x == pytest.approx(0.0, abs=1e-6)


def test_robot_creeps_away_from_a_contact() -> None:
    platform = calm(JACKAL, near="reported")
    run = FilterSim(platform, [pole(0.1, Pose(0.6))]).run(Twist(-0.5), 4.0)
    assert run.poses[-1].x == pytest.approx(-0.015 * 3.9, abs=0.01)


@pytest.mark.parametrize(("gap", "is_hidden"), [(0.06, True), (0.10, False)])
def test_robot_creeps_beside_a_possible_unseen_contact(gap: float, is_hidden: bool) -> None:
    """The front of a Burger lies 5 cm within the blind zone of its lidar."""
    platform = under_barrier(BURGER, unseen_extent=0.0, others_speed=0.5, surface_speed=0.3)
    ranges = np.full(360, math.inf)
    ranges[0] = gap + 0.07
    scan = scan_from(platform, ranges, platform.scan.bearings)
    back = Twist(-0.2)
    safe = decided(platform, scan, back).safe
    assert decided(platform, scan, Twist(0.2)).safe.linear == 0.0
    assert safe == back if not is_hidden else -0.015 - 1e-9 <= safe.linear < -0.01


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_corner_does_not_graze_a_slanted_face_too_close_to_measure(side: float) -> None:
    """The corner of a Burger lies within the blind zone of its lidar.

    The place of the outline nearest to such a return is on its side, so the constraint there does
    not bound the motion ahead.
    """
    wedge = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.25, 0.3]])
    wedge = wedge if side > 0.0 else (wedge * (1.0, -1.0))[::-1]
    near = Shape(wedge, Pose(0.012, side * 0.093))
    run = FilterSim(calm(BURGER, near="reported", margin=0.0), [near]).run(Twist(0.22), 3.0)
    assert run.touch is None


def test_obstacle_that_enters_the_blind_zone_is_not_closed_on() -> None:
    """A pole approaches at `others_speed` while the Jackal drives at it."""
    speed = JACKAL.protection["barrier"]["others_speed"]
    for phase in (0.0, 0.03, 0.06):
        comes = pole(0.15, Pose(2.0, 0.05), velocity=(-speed, 0.0))
        run = FilterSim(JACKAL, [comes], phase=phase, noise=0.01).run(AHEAD, 5.0)
        assert run.touch is not None
        assert run.touch.speed <= NO_FAULT


def test_keep_out_keeps_standing_obstacles_out_of_the_blind_zone() -> None:
    """By the keep-out circle alone: others neither move nor extend beyond their returns."""
    sim = FilterSim(calm(JACKAL, keep_out=0.85), [box(0.1, 4.0, Pose(2.0))])
    run = sim.run(AHEAD, 8.0)
    assert run.poses[-1].x > 0.9
    assert 1.95 - run.poses[-1].x >= BLIND


def test_keep_out_leaves_half_of_the_room_to_the_other() -> None:
    platform = calm(JACKAL, keep_out=0.85)
    ranges = np.full(360, math.inf)
    ranges[0] = 1.2
    safe = decided(platform, scan_from(platform, ranges, platform.scan.bearings), AHEAD).safe
    age = platform.scan.latency + REACTION_TIME
    cap = reciprocal_cap(1.2 - 0.85, 1.0, age)
    assert 0.0 < safe.linear == pytest.approx(cap)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_keep_out_bounds_turns_that_swing_the_circle(side: float) -> None:
    """A Waffle Pi's lidar is 6 cm behind its axle: to turn right swings it to the left."""
    waffle = calm(load_platform("waffle_pi"), near="reported", keep_out=0.6, margin=0.0)
    ranges = np.full(360, math.inf)
    ranges[90 if side > 0.0 else 270] = 0.6
    scan = scan_from(waffle, ranges, waffle.scan.bearings)
    away, towards = Twist(0.0, side), Twist(0.0, -side)
    assert decided(waffle, scan, away).safe == away
    assert abs(decided(waffle, scan, towards).safe.angular) < 0.01


def test_approached_obstacle_is_remembered_when_it_vanishes() -> None:
    """The robot stays before an obstacle that it no longer sees, and can creep away."""
    sim = FilterSim(calm(JACKAL), [box(0.1, 0.6, Pose(2.0))])
    run = sim.run(AHEAD, 8.0)
    assert run.touch is None
    assert run.min_gap < BLIND - 0.254
    assert run.twists[-1].linear == pytest.approx(0.0, abs=1e-6)
    assert sim.run(Twist(-0.5), 4.0).poses[-1].x < run.poses[-1].x - 0.04


@long_run
def test_hidden_obstacle_is_remembered_when_the_pose_of_odometry_jumps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sim = FilterSim(calm(JACKAL), [box(0.1, 0.6, Pose(2.0))])
    stopped = sim.run(AHEAD, 8.0).poses[-1]
    true = sim.odometry

    def jumped() -> Odometry:
        pose = true().pose
        return msgspec.structs.replace(true(), pose=Pose(pose.x + 5.0, pose.y - 3.0, pose.yaw))

    monkeypatch.setattr(sim, "odometry", jumped)
    assert sim.run(AHEAD, 4.0).poses[-1].x == pytest.approx(stopped.x, abs=1e-6)


@long_run
@pytest.mark.parametrize("bearing", [0.0, 0.5, 1.2, 2.0])
@pytest.mark.parametrize("speed", part([0.6], [0.1]))
def test_robot_does_not_turn_into_a_wide_near_face(bearing: float, speed: float) -> None:
    """A face stops 6 cm from a Jackal, which then turns; only the ends of the face are visible."""
    way = np.array([math.cos(bearing), math.sin(bearing)])
    rest = float((JACKAL.footprint @ way).max()) + 0.16
    far, velocity = 1.6, (-speed * float(way[0]), -speed * float(way[1]))
    pose = Pose(far * float(way[0]), far * float(way[1]), bearing)
    comes = box(0.2, 3.0, pose, velocity=velocity, end=(far - rest) / speed)
    sim = FilterSim(JACKAL, [comes], noise=0.01)
    assert sim.run(Twist(), (far - rest) / speed + 1.0).touch is None
    assert sim.run(Twist(0.3, 1.0), 4.0).touch is None


@long_run
def test_lost_near_returns_of_an_lds_do_not_count_as_free() -> None:
    """A zero means too near or no return: a box approaches until the lidar no longer sees it."""
    comes = box(0.2, 0.3, Pose(0.9), velocity=(-0.25, 0.0), end=0.732 / 0.25)
    sim = FilterSim(BURGER, [comes])
    assert sim.run(Twist(0.0), 4.0).min_gap == pytest.approx(0.03, abs=0.001)
    run = sim.run(Twist(0.22), 5.0)
    assert run.touch is None
    assert run.poses[-1].x == pytest.approx(0.0, abs=1e-3)
    # It can leave: it creeps until it is clear of the other's unseen part, then drives freely.
    left = sim.run(Twist(-0.22), 9.0)
    assert left.poses[300].x == pytest.approx(-0.015 * 2.9, abs=0.01)
    assert left.poses[-1].x < -0.4


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Visitor(Shape):
    """A shape with a velocity (x, y) in m/s up to each of some times in s; then it stands."""

    legs: tuple[tuple[float, tuple[float, float]], ...]

    def at(self, time: float) -> Pose:
        """Where it is."""
        x, y, begin = self.pose.x, self.pose.y, 0.0
        for end, (vx, vy) in self.legs:
            seconds = max(min(time, end) - begin, 0.0)
            x, y, begin = x + vx * seconds, y + vy * seconds, end
        return Pose(x, y)


def visited(*legs: tuple[float, tuple[float, float]], noise: float = 0.005) -> FilterSim:
    """A Burger that is seen whole, 5 mm before which another one has come to rest within 3 s."""
    come = (2.5, (-0.3, 0.0)), (3.0, (0.0, 0.0))
    visitor = Visitor(BURGER.footprint * -1.0, Pose(0.038 + 0.005 + 0.038 + 0.75), legs=come + legs)
    sim = FilterSim(under_barrier(BURGER, unseen_extent=0.0), [visitor], noise=noise)
    assert sim.run(Twist(), 3.0).touch is None
    return sim


@pytest.mark.parametrize(("speed", "seconds"), [(0.1, 4.0), (0.3, 2.0)])
def test_robot_that_is_pushed_does_not_drive_into_what_pushes_it(
    speed: float, seconds: float
) -> None:
    """By odometry it leaves the obstacle, which follows it; then both rest."""
    sim = visited((3.0 + seconds, (-speed, 0.0)))
    sim.pushed = -speed, 0.0
    pushed = sim.run(AHEAD, seconds)
    sim.pushed = 0.0, 0.0
    rested = sim.run(AHEAD, 20.0)
    assert pushed.touch is rested.touch is None
    assert rested.poses[-1].x == pytest.approx(-speed * seconds, abs=0.005)


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("away", [(0.3, 0.0), (0.1, 0.0), (0.0, 0.3), (0.0, -0.3), (0.0, 0.1)])
def test_obstacle_that_leaves_in_the_open_is_forgotten(away: tuple[float, float]) -> None:
    """Nothing behind it gives a return; it comes into view at other bearings than it vanished."""
    sim = visited((15.0, away))
    assert sim.run(Twist(), 12.0).touch is None
    run = sim.run(AHEAD, 2.0)
    assert run.touch is None
    assert run.poses[-1].x > 0.3
