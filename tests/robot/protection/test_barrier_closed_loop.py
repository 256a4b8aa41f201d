"""Closed loop: mode barrier stops in time, keeps to touch zones, and withstands failing sensors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from numpy.random import Generator

from swarmd.core.clock import TICK
from swarmd.core.messages import Reason
from swarmd.core.values import Limits, Odometry, Platform, Pose, Scan, TouchZone, Twist
from swarmd.robot.protection.binding_range import BindingRange
from swarmd.robot.protection.compatibility import barrier_settings
from swarmd.robot.protection.decision import NO_PERMIT, Permit
from swarmd.settings.settings import load_platform
from tests.support.examples import part
from tests.support.filter_sim import (
    HERE,
    FilterRun,
    FilterSim,
    Shape,
    box,
    placed,
    pole,
    round_corners,
    separation,
    under_barrier,
)
from tests.support.kernel_forms import long_run

pytestmark = long_run

BURGER, WAFFLE = under_barrier(load_platform("burger")), under_barrier(load_platform("waffle_pi"))
MARGIN = 0.03
ROUNDING = 0.005  # m, for slanted rays and the length of a tick
NO_FAULT = 0.02  # m/s: a slower contact is not a fault of the robot


def standing(platform: Platform) -> Platform:
    """Obstacles are assumed to stand and to be fully visible; the envelope is off."""
    return under_barrier(platform, others_speed=0.001, surface_speed=5.0, unseen_extent=0.0)


def extent(platform: Platform, way: int) -> float:
    """How far the outline reaches ahead (way 1) or back (-1) of the axle."""
    return float((way * platform.footprint[:, 0]).max())


@pytest.mark.parametrize("platform", [BURGER, WAFFLE], ids=lambda platform: platform.name)
@pytest.mark.parametrize("way", [1, -1], ids=["ahead", "reversing"])
@pytest.mark.parametrize("distance", part([0.05, 1.1], [0.4]))
def test_stops_at_a_wall_with_the_margin_left(
    platform: Platform, way: int, distance: float
) -> None:
    wall = box(0.1, 4.0, Pose(way * (extent(platform, way) + distance + 0.05)))
    run = FilterSim(standing(platform), [wall]).run(Twist(way * platform.limits.linear), 8.0)
    assert run.min_gap == pytest.approx(MARGIN + 0.0005, abs=ROUNDING)
    assert abs(run.twists[-1].linear) < 0.001


def short_sighted(linear: float, others_speed: float, braking: float) -> tuple[Platform, float]:
    """A Burger with these m/s and m/s2, and how far its sensor must see."""
    settings = {"others_speed": others_speed, "braking_linear": braking}
    platform = under_barrier(replace(BURGER, limits=Limits(linear, 2.84)), **settings)
    barrier = barrier_settings(platform)
    assert barrier is not None
    return platform, BindingRange(platform, barrier, TICK).for_sensor()


def hardest_touch(platform: Platform, range_max: float, phases: int = 4) -> float:
    """The own speed in m/s at the touch of walls that come into sight as scans begin to be lost."""
    platform = replace(platform, scan=replace(platform.scan, range_max=range_max))
    speed, others = platform.limits.linear, platform.protection["barrier"]["others_speed"]
    touches = [0.0]
    for coming in (0.0, others):
        for later in 0.05 * np.arange(phases):
            front = range_max + 3.0 * (speed + coming)  # in sight after 3 s
            wall = box(0.2, 40.0, Pose(front + 0.1), velocity=(-coming, 0.0))
            sim = FilterSim(platform, [wall])

            def requested(at: float, sim: FilterSim = sim, end: float = 3.0 + later) -> Twist:
                sim.has_lidar = at < end
                return Twist(speed)

            touch = sim.run(requested, 14.0).touch
            touches.append(0.0 if touch is None else touch.speed)
    return max(touches)


@pytest.mark.parametrize(
    ("linear", "others_speed", "braking"),
    part([(2.0, 1.2, 1.0)], [(1.0, 0.3, 0.5), (2.0, 0.3, 0.7)]),
)
def test_a_sensor_that_sees_as_far_as_needed_sees_far_enough(
    linear: float, others_speed: float, braking: float
) -> None:
    platform, needed = short_sighted(linear, others_speed, braking)
    assert hardest_touch(platform, needed) <= NO_FAULT
    assert (
        hardest_touch(platform, 0.6 * needed, phases=1) > 0.4
    )  # so the distance is not by far too long


@pytest.mark.parametrize("late", [0.2, 0.4])
def test_late_scan_is_shifted_by_the_motion_since(late: float) -> None:
    """At full speed a Waffle Pi drives 0.10 m within 0.4 s: three margins."""
    platform = replace(standing(WAFFLE), scan=replace(WAFFLE.scan, latency=late))
    wall = box(0.1, 4.0, Pose(1.2))
    run = FilterSim(platform, [wall]).run(Twist(0.26), 8.0)
    assert run.min_gap == pytest.approx(MARGIN, abs=ROUNDING)


def test_late_scan_is_rotated_by_the_turn_since() -> None:
    """At 1.8 rad/s a scan is rotated by 40 degrees when it takes effect."""
    platform = replace(standing(WAFFLE), scan=replace(WAFFLE.scan, latency=0.4))
    for phase in (0.0, 0.05, 0.1, 0.15):
        sim = FilterSim(platform, [pole(0.03, Pose(0.05, 0.27))], phase=phase)
        assert sim.run(lambda t: Twist(0.0, 1.8 * math.sin(3.0 * t)), 5.0).touch is None


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("platform", [BURGER, WAFFLE], ids=lambda platform: platform.name)
def test_corner_does_not_swing_into_an_obstacle_beside(platform: Platform, side: float) -> None:
    half = float(platform.footprint[:, 1].max())
    wall = box(4.0, 0.1, Pose(0.0, side * (half + 0.035 + 0.05)))
    for way in (1.0, -1.0):
        run = FilterSim(standing(platform), [wall]).run(
            Twist(0.0, way * platform.limits.angular), 3.0
        )
        assert run.min_gap >= MARGIN - ROUNDING


@pytest.mark.parametrize("bearing", part([0.0, 0.6, math.pi], [-0.9, 2.6]))
@pytest.mark.parametrize("platform", [BURGER, WAFFLE], ids=lambda platform: platform.name)
def test_rammed_robot_does_not_close_on_the_other(platform: Platform, bearing: float) -> None:
    speed = platform.protection["barrier"]["others_speed"]
    way = math.cos(bearing), math.sin(bearing)
    front = box(0.2, 3.0, Pose(1.6 * way[0], 1.6 * way[1], bearing),
                velocity=(-speed * way[0], -speed * way[1]))  # fmt: skip
    requested = Twist(math.copysign(platform.limits.linear, way[0]))
    run = FilterSim(platform, [front], noise=0.01).run(requested, 9.0)
    assert run.touch is not None
    assert run.touch.speed <= NO_FAULT


def test_standing_obstacle_may_start_to_move() -> None:
    """A box starts to approach when the gap just suffices for a standing robot."""
    starts = box(0.2, 0.3, Pose(0.6), velocity=(-0.30, 0.0), begin=2.0)
    run = FilterSim(BURGER, [starts]).run(Twist(0.22), 5.0)
    assert run.touch is not None
    assert run.touch.speed <= NO_FAULT


def test_unseen_extent_of_another_robot_is_not_touched() -> None:
    """A level lidar sees only the lidar housing of a Burger."""
    corners = BURGER.footprint - BURGER.scan.offset
    seen = under_barrier(BURGER, others_speed=0.001, surface_speed=5.0)
    for yaw in (0.0, 0.8, math.pi / 2, 2.2, math.pi):
        other = replace(
            pole(0.055, Pose(0.6, 0.0, yaw)), corners=corners, seen=round_corners(0.055)
        )
        run = FilterSim(seen, [other]).run(Twist(0.22), 5.0)
        assert run.min_gap >= MARGIN - ROUNDING


def test_frozen_lidar_stops_the_robot_in_time() -> None:
    sim = FilterSim(BURGER, [box(0.1, 4.0, Pose(3.3))])
    assert sim.run(Twist(0.22), 1.0).twists[-1].linear == pytest.approx(0.22)
    sim.has_lidar = False
    run = sim.run(Twist(0.22), 1.5)
    still_at = next(
        t for t, twist in zip(run.times, run.twists, strict=True) if twist.linear == 0.0
    )
    ages = BURGER.scan.latency + 1.0 / BURGER.scan.rate  # the last scan may be that new
    assert still_at <= 1.0 + ages + BURGER.scan.stale_after + 0.05 + 0.04 + 0.22
    assert run.decisions[-1][1].reason is Reason.STALE_SCAN


@pytest.mark.parametrize("at", part([0.4, 1.4, 2.4], [0.9, 1.9]))
def test_lost_odometry_stops_the_robot_with_the_margin_left(at: float) -> None:
    sim = FilterSim(standing(BURGER), [box(0.1, 4.0, Pose(0.6))])
    sim.run(Twist(0.22), at)
    sim.has_odometry = False
    run = sim.run(Twist(0.22), 2.0)
    assert run.min_gap >= MARGIN - ROUNDING
    assert run.decisions[-1][1].reason is Reason.STALE_ODOMETRY


TOUCH_SPEED = 0.05
ZONE_AHEAD = Permit(touch=TouchZone(0.0, math.radians(20.0), TOUCH_SPEED))


@pytest.mark.parametrize("permit", [NO_PERMIT, ZONE_AHEAD], ids=["no touch", "touch ahead"])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("distance", part([1.0, 1.2, 1.4], [1.1, 1.3]))
def test_spinning_robot_stops_before_its_corner_can_hit(
    side: float, distance: float, permit: Permit
) -> None:
    """A corner 0.135 m from the axle moves at 0.38 m/s in the fastest turn of a Burger.

    A linear constraint does not see the corner swing out during the stop; the stop check does.
    """
    comes = box(0.3, 0.2, Pose(-0.03, side * distance), velocity=(0.0, side * -0.30))
    run = FilterSim(BURGER, [comes]).run(Twist(0.0, 2.84), 6.0, permit)
    assert run.touch is not None
    assert run.touch.speed <= NO_FAULT
    assert max(abs(twist.angular) for twist in run.twists) > 1.5


def test_touches_in_its_sector_at_its_speed() -> None:
    run = FilterSim(BURGER, [box(0.2, 0.12, Pose(0.5))]).run(Twist(0.22), 12.0, ZONE_AHEAD)
    assert run.touch is not None
    assert run.touch.speed == pytest.approx(TOUCH_SPEED, abs=0.002)


def test_moving_obstacle_in_the_sector_is_met_at_its_speed() -> None:
    comes = box(0.2, 0.12, Pose(0.9), velocity=(-0.2, 0.0))
    run = FilterSim(BURGER, [comes]).run(Twist(0.22), 12.0, ZONE_AHEAD)
    assert run.touch is not None
    assert run.touch.speed <= TOUCH_SPEED + 0.002


@pytest.mark.parametrize("way", [math.pi, 2.0, -2.0])
def test_obstacles_outside_the_sector_are_not_touched(way: float) -> None:
    wall = box(0.1, 4.0, Pose(0.7 * math.cos(way), 0.7 * math.sin(way), way))
    run = FilterSim(BURGER, [wall]).run(Twist(-0.22), 8.0, ZONE_AHEAD)
    assert run.touch is None
    assert run.min_gap >= 0.05


KINDS = {name: under_barrier(load_platform(name)) for name in ("burger", "waffle_pi", "jackal")}


def seen_whole(name: str, **settings: object) -> Platform:
    """The platform among robots that a lidar sees completely."""
    return under_barrier(KINDS[name], unseen_extent=0.0, **settings)


@pytest.mark.parametrize("turn", [1.0, -1.0])
@pytest.mark.parametrize("start", part([1.20, 1.30], [1.25, 1.35]))
@pytest.mark.parametrize("name", ["burger", "waffle_pi"])
def test_corner_does_not_swing_into_an_obstacle_that_stopped_beside(
    name: str, start: float, turn: float
) -> None:
    """A pole stops 1 cm beside a spinning robot before the robot has braked."""
    platform = seen_whole(name)
    speed, half = platform.protection["barrier"]["others_speed"], platform.footprint[:, 1].max()
    for gap in (0.01, -1.0):
        end = (start - half - 0.03 - gap) / speed
        comes = pole(0.03, Pose(0.0, start), velocity=(0.0, -speed), end=end)
        run = FilterSim(platform, [comes]).run(Twist(0.0, turn * platform.limits.angular), 6.0)
        assert run.touch is None or run.touch.speed <= NO_FAULT


class Lossy(FilterSim):
    """Some scans lack sectors: first and last scan, middle and half width in rad."""

    lost: tuple[tuple[int, int, float, float], ...] = ()

    def scan(self) -> Scan:
        scan = super().scan()
        ranges = scan.ranges.copy()
        for first, last, middle, half in self.lost:
            if first <= scan.seq <= last:
                off = (scan.bearings - middle + np.pi) % (2.0 * np.pi) - np.pi
                ranges[np.abs(off) <= half] = np.nan
        return structs.replace(scan, ranges=ranges)


@pytest.mark.parametrize("distance", part([0.2, 0.4], [0.3, 0.5]))
@pytest.mark.parametrize("name", ["burger", "waffle_pi"])
def test_sectors_lost_in_turn_hide_no_obstacle(name: str, distance: float) -> None:
    """First behind, then ahead: each scan is newer than the last whole one, but not ahead."""
    platform = seen_whole(name)
    speed, drives = platform.protection["barrier"]["others_speed"], platform.limits.linear
    front, begin = float(platform.footprint[:, 0].max()), 4.0 / platform.scan.rate
    x = front + distance + 0.05 + (0.9 * drives + speed) * begin
    for count in (1, 2, 3):
        sim = Lossy(platform, [box(0.1, 0.4, Pose(x), velocity=(-speed, 0.0))])
        sim.lost = (4, 3 + count, math.pi, 0.5), (5, 4 + count, 0.0, math.radians(60.0))
        run = sim.run(Twist(drives), 5.0)
        assert run.touch is not None
        assert run.touch.speed <= NO_FAULT


class Restarting(FilterSim):
    """Its odometry restarts at the origin, with its clock, at `restart` s."""

    restart = 0.0
    origin: Pose | None = None

    def odometry(self) -> Odometry:
        if self.time < self.restart:
            return super().odometry()
        self.origin = self.origin or self.pose
        here = Pose(self.pose.x - self.origin.x - 1.0, self.pose.y, self.pose.yaw)
        return Odometry(self.time - self.restart, here, self.twist)


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("name", ["burger", "waffle_pi"])
def test_restarted_odometry_does_not_move_a_wall_away(name: str) -> None:
    """The last scan has no valid pose any more, so the robot stops until the next one."""
    platform = seen_whole(name, others_speed=0.001, surface_speed=5.0)
    for restart in np.arange(3.0, 5.0, 0.33):  # 7 phases between the scans
        sim = Restarting(platform, [box(0.1, 3.0, Pose(0.9))])
        sim.restart = float(restart)
        run = sim.run(Twist(platform.limits.linear), float(restart) + 2.0)
        assert run.touch is None
        assert run.min_gap >= MARGIN - ROUNDING
        assert abs(run.poses[-1].x - 0.85 + platform.footprint[:, 0].max() + MARGIN) < 2 * ROUNDING


def twists(platform: Platform, rng: Generator) -> Callable[[float], Twist]:
    """Another twist every second, every third at full speed."""
    shares = rng.uniform(-1.0, 1.0, (20, 2))
    shares[::3, 0] = np.sign(shares[::3, 0])
    limits = platform.limits

    def requested(time: float) -> Twist:
        v, w = shares[int(time) % len(shares)]
        return Twist(float(v) * limits.linear, float(w) * limits.angular)

    return requested


def obstacles(platform: Platform, rng: Generator, speed: float) -> list[Shape]:
    """Poles and boxes at some distance, each moving past the robot at up to `speed`."""
    found: list[Shape] = []
    nearest = max(platform.scan.range_min, float(np.hypot(*platform.footprint.T).max())) + 0.3
    while len(found) < 5:
        bearing, distance = rng.uniform(-math.pi, math.pi), rng.uniform(nearest + 0.3, nearest + 2)
        x, y = distance * math.cos(bearing), distance * math.sin(bearing)
        aim, share = rng.uniform(-0.3, 0.3, 2), rng.choice([0.3, 1.0, 1.0])
        way = (aim - (x, y)) / np.hypot(*(aim - (x, y)))
        velocity = (float(way[0] * share * speed), float(way[1] * share * speed))
        pose = Pose(x, y, float(rng.uniform(-math.pi, math.pi)))
        begin, a, b = rng.uniform(0.05, (3.0, 0.5, 0.5)).tolist()
        corners = box(a, b).corners if rng.random() < 0.5 else pole(0.4 * a).corners
        one = Shape(corners, pose, velocity=velocity, begin=begin)
        if separation(placed(platform.footprint, HERE), placed(one.corners, pose))[0] > nearest:
            found.append(one)
    return found


def random_run(kind: str, seed: int, share: float, seconds: float) -> FilterRun:
    platform, rng = KINDS[kind], np.random.default_rng(seed)
    speed = share * platform.protection["barrier"]["others_speed"]
    sim = FilterSim(
        platform,
        obstacles(platform, rng, speed),
        phase=rng.uniform(0.0, 1.0 / platform.scan.rate),
        noise=0.01,
        seed=seed,
    )
    return sim.run(twists(platform, rng), seconds)


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("seed", part([0], [1, 2, 3, 4]))
@pytest.mark.parametrize("kind", KINDS)
def test_standing_obstacles_are_never_touched(kind: str, seed: int) -> None:
    done = random_run(kind, seed, 0.0, 10.0)
    assert done.touch is None


@pytest.mark.parametrize("seed", part(range(2), range(2, 10)))
@pytest.mark.parametrize("kind", ["burger", "waffle_pi"])
def test_obstacles_at_the_assumed_speed_are_not_closed_on(kind: str, seed: int) -> None:
    """Not for a Jackal, which does not see obstacles within 0.8 m."""
    done = random_run(kind, seed, 1.0, 6.0)
    assert done.touch is None or done.touch.speed <= NO_FAULT


@pytest.mark.parametrize(("speed", "gap"), [(0.04, 0.03 + 0.05), (0.05, 0.09)])
def test_only_a_slow_request_creeps_up_to_the_contact_gap(speed: float, gap: float) -> None:
    """5 cm of the blind zone of a Burger lie ahead of it; the margin is 3 cm."""
    seen_whole = under_barrier(BURGER, unseen_extent=0.0)
    run = FilterSim(seen_whole, [box(0.1, 4.0, Pose(0.5))]).run(Twist(speed), 30.0)
    assert run.min_gap == pytest.approx(gap, abs=0.004)


@pytest.mark.parametrize("begin", part([6.0, 9.97, 10.03], [2.0]))
@pytest.mark.parametrize("aside", [0.0, 0.2])
def test_a_creeping_robot_is_not_at_fault(aside: float, begin: float) -> None:
    """A box starts to approach at the assumed speed, straight or past a front corner."""
    speed = math.sqrt(0.3**2 - aside**2)
    comes = box(0.1, 0.3, Pose(0.32, -aside), velocity=(-speed, aside), begin=begin)
    run = FilterSim(under_barrier(BURGER, unseen_extent=0.0), [comes]).run(Twist(0.04, 0.5), 15.0)
    assert run.touch is not None
    assert run.touch.speed <= NO_FAULT
