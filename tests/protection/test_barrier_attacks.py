"""Closed loop: failing sensors and attacks on protection that once succeeded."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.values import ZERO, Odometry, Platform, Pose, Scan, Twist
from swarmd.settings.settings import load_platform
from tests.support.filter_sim import (
    FilterRun,
    FilterSim,
    box,
    placed,
    pole,
    round_corners,
    separation,
    under_barrier,
)

KINDS = {name: under_barrier(load_platform(name)) for name in ("burger", "waffle_pi", "jackal")}
MARGIN = 0.03
ROUNDING = 0.005
NO_FAULT = 0.02


def seen_whole(name: str, **told: object) -> Platform:
    """The platform among robots that a lidar sees completely."""
    return under_barrier(KINDS[name], unseen_extent=0.0, **told)


@pytest.mark.parametrize("turn", [1.0, -1.0])
@pytest.mark.parametrize("start", [1.20, 1.25, 1.30, 1.35])
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


@pytest.mark.parametrize(
    ("name", "seed"),
    [("burger", seed) for seed in (13, 31, 60, 253, 394, 471, 535)]
    + [("waffle_pi", seed) for seed in (328, 401, 533)],
)
def test_robot_does_not_hit_an_obstacle_at_the_end_of_its_path(name: str, seed: int) -> None:
    """Seeds that led to contact before the stop check existed.

    A pole stops 4 mm from the place where the requested motion ends. The base brakes one of its
    speeds four times as fast as assumed, or both exactly as assumed.
    """
    run = rendezvous(seen_whole(name), seed)
    assert run.touch is None or run.touch.speed <= NO_FAULT


def rendezvous(platform: Platform, seed: int) -> FilterRun:
    rng, told = np.random.default_rng(seed), platform.protection["barrier"]
    linear, angular = ((1, 1), (4, 1), (1, 4))[int(rng.integers(3))]
    braking = linear * told["braking_linear"], angular * told["braking_angular"]
    v, w = rng.choice([-1, 1]) * rng.uniform(0.2, 1), rng.choice([-1, 1]) * rng.uniform(0.3, 1)
    requested = Twist(float(v) * platform.limits.linear, float(w) * platform.limits.angular)
    end, then = float(rng.uniform(1.5, 2.5)), ZERO
    if rng.random() >= 0.6:
        is_back = rng.random() < 0.5
        then = (
            replace_signs(requested, -1.0, 1.0) if is_back else replace_signs(requested, 1.0, -1.0)
        )
    phase = 0.01 * float(rng.integers(20))
    last = FilterSim(platform, braking=braking, phase=phase).run(requested, end).poses[-1]
    bearing = rng.uniform(-math.pi, math.pi)
    target = placed(beside(platform, bearing), last)[0]
    way = rng.uniform(-0.6, 0.6) + bearing + last.yaw
    speed = rng.uniform(0.5, 1) * told["others_speed"]
    x, y = -speed * math.cos(way), -speed * math.sin(way)
    comes = pole(0.02, Pose(target[0] - x * end, target[1] - y * end), velocity=(x, y), end=end)
    sim = FilterSim(platform, [comes], braking=braking, phase=phase)
    return sim.run(lambda time: requested if time < end else then, end + 1.5)


def replace_signs(twist: Twist, linear: float, angular: float) -> Twist:
    return Twist(linear * twist.linear, angular * twist.angular)


def beside(platform: Platform, bearing: float) -> np.ndarray:
    """(1, 2) the centre of a pole that almost touches the outline at that bearing."""
    middle, way = platform.footprint.mean(axis=0), np.array([math.cos(bearing), math.sin(bearing)])
    for distance in np.arange(0.05, 0.5, 0.005):
        place = middle + distance * way
        if separation(platform.footprint, placed(round_corners(0.02), Pose(*place)))[0] > 0.004:
            break
    found: np.ndarray = place[None]
    return found


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
        return replace(scan, ranges=ranges)


@pytest.mark.parametrize("distance", [0.2, 0.3, 0.4, 0.5])
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


@pytest.mark.parametrize("name", ["burger", "waffle_pi"])
def test_restarted_odometry_does_not_move_a_wall_away(name: str) -> None:
    """The last scan has no valid pose any more, so the robot stops until the next one."""
    platform = seen_whole(name, others_speed=0.001, surface_speed=5.0)
    for restart in np.arange(3.0, 5.0, 0.11):
        sim = Restarting(platform, [box(0.1, 3.0, Pose(0.9))])
        sim.restart = float(restart)
        run = sim.run(Twist(platform.limits.linear), float(restart) + 2.0)
        assert run.touch is None
        assert run.min_gap >= MARGIN - ROUNDING
        assert abs(run.poses[-1].x - 0.85 + platform.footprint[:, 0].max() + MARGIN) < 2 * ROUNDING
