"""Closed loop: random twists among standing and moving obstacles, one world per seed."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.random import Generator

from swarmd.core.values import Platform, Pose, Twist
from swarmd.settings.settings import load_platform
from tests.support.filter_sim import (
    HERE,
    FilterRun,
    FilterSim,
    Shape,
    box,
    placed,
    pole,
    separation,
    under_barrier,
)

KINDS = {name: under_barrier(load_platform(name)) for name in ("burger", "waffle_pi", "jackal")}
NO_FAULT = 0.02


def twists(platform: Platform, rng: Generator) -> Callable[[float], Twist]:
    """Another twist every second, every third at full speed."""
    shares = rng.uniform(-1.0, 1.0, (20, 2))
    shares[::3, 0] = np.sign(shares[::3, 0])
    limits = platform.limits

    def requested(time: float) -> Twist:
        v, w = shares[int(time) % len(shares)]
        return Twist(float(v) * limits.linear, float(w) * limits.angular)

    return requested


def things(platform: Platform, rng: Generator, speed: float) -> list[Shape]:
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
        things(platform, rng, speed),
        phase=rng.uniform(0.0, 1.0 / platform.scan.rate),
        noise=0.01,
        seed=seed,
    )
    return sim.run(twists(platform, rng), seconds)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kind", KINDS)
def test_standing_obstacles_are_never_touched(kind: str, seed: int) -> None:
    done = random_run(kind, seed, 0.0, 10.0)
    assert done.touch is None


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("kind", ["burger", "waffle_pi"])
def test_obstacles_at_the_assumed_speed_are_not_closed_on(kind: str, seed: int) -> None:
    """Not for a Jackal, which does not see obstacles within 0.8 m."""
    done = random_run(kind, seed, 1.0, 6.0)
    assert done.touch is None or done.touch.speed <= NO_FAULT
