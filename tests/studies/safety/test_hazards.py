"""Rammers and obstacles of a live course keep the assumptions of protection."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from studies.safety.hazards import OBSTACLES, ObstaclePlacer, Rammer, room
from swarmd.core.values import Platform, Twist
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.state import Triple, WorldState
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.contacts import ContactEpisodes
from swarmd.sim.world.geometry import gaps, radius, transform
from swarmd.sim.world.realism import REALISTIC
from swarmd.sim.world.world import World
from tests.support.traces import world_state

BURGER = load_platform("burger")
FAST = replace(BURGER, limits=structs.replace(BURGER.limits, linear=0.3))
PLATFORMS = ("burger", "waffle_pi", "jackal")


def at(place: float, *speeds: float) -> WorldState:
    """Robots in a row, `place` m apart, that drive at `speeds` in m/s."""
    poses = [(0.0, place * i, 0.0) for i in range(len(speeds))]
    return world_state(poses, [(speed, 0.0, 0.0) for speed in speeds])


def triples(rows: np.ndarray) -> list[Triple]:
    return [(float(a), float(b), float(c)) for a, b, c in rows]


def corner_speeds(before: np.ndarray, after: np.ndarray, dt: float) -> np.ndarray:
    moved = transform(BURGER.footprint, after) - transform(BURGER.footprint, before)
    speeds: np.ndarray = np.hypot(moved[..., 0], moved[..., 1]) / dt
    return speeds


def test_a_rammer_touches_all_robots_and_no_corner_of_it_is_too_fast() -> None:
    starts = np.array([(0.0, 0.0, 2.5), (2.0, 0.0, 0.0), (-1.0, 1.5, 0.0)])
    bodies = {"rammer": FAST, "a": BURGER, "b": BURGER}
    world = World(bodies, Arena(6.0, 6.0), starts, realism=REALISTIC)
    rammer, episodes = Rammer(0.3, radius(BURGER.footprint)), ContactEpisodes()
    fastest = 0.0
    for step in range(4000):
        if step % 10 == 0:  # states come at 10 Hz
            state = world_state(triples(world.poses()), triples(world.twists()), world.time)
            state = structs.replace(state, contacts=len(episodes.counts))
            twist = rammer.command(state, 0)
            world.set_commands(np.array([(twist.linear, twist.angular, 0.0), *[(0.0,) * 3] * 2]))
        before = world.poses()[0]
        world.step()
        for touch in world.contacts():
            episodes.add(world.time, touch.a, touch.b)
        if not world.contacts():
            fastest = max(fastest, float(corner_speeds(before, world.poses()[0], 0.01).max()))
    assert set(episodes.counts) == {("a", "rammer"), ("b", "rammer")}
    assert 0.28 < fastest <= 0.3 + 1e-6


@pytest.mark.parametrize("time", [0.0, 2.0])  # backing away, and straight ahead
def test_a_turn_that_continues_reduces_the_speed_of_a_rammer(time: float) -> None:
    rammer, spins = Rammer(0.3, 0.135), [(0.0, -1.0, 0.0), (0.0, 0.0, 0.0)]
    poses = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)
    rammer.command(world_state(poses, spins), 0)
    twist = rammer.command(world_state(poses, spins, time), 0)
    assert abs(twist.linear) == pytest.approx(0.3 - 0.135)
    assert twist.angular == 0.0


def test_a_rammer_that_has_touched_backs_away() -> None:
    rammer = Rammer(0.3, 0.135)
    poses = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)
    away = rammer.command(world_state(poses, [(0.0, 0.0, 0.0)] * 2), 0)
    later = rammer.command(world_state(poses, [(0.0, 0.0, 0.0)] * 2, time=2.0), 0)
    assert away == Twist(linear=-0.3)
    assert later.linear == pytest.approx(0.3)


@pytest.mark.parametrize("name", PLATFORMS)
def test_obstacles_appear_ahead_of_moving_robots_with_room_to_all(name: str) -> None:
    platform = load_platform(name)
    obstacles = ObstaclePlacer(platform, 2, seed=3)
    state = at(20.0, platform.limits.linear, 0.0, platform.limits.linear)
    appeared = []
    for _ in range(50):
        found = obstacles.next(state)
        state = structs.replace(state, time=state.time + 1.0)
        if found is not None:
            appeared.append(found)
    assert {name for name, _ in appeared} == set(OBSTACLES)
    for obstacle, pose in appeared:
        outline = transform(OBSTACLES[obstacle].shape, np.array(pose))
        apart = gaps(outline, transform(platform.footprint, np.array(state.poses)))
        assert apart.min() >= room(platform)
        assert apart.argmin() == 0  # of the first two robots only this one drives
        assert abs(math.atan2(pose[1], pose[0])) < 0.3


def test_no_obstacle_appears_too_near_to_another_robot() -> None:
    obstacles = ObstaclePlacer(BURGER, 1, seed=3)
    ahead = room(BURGER) + BURGER.footprint[:, 0].max() + 0.2
    poses = (0.0, 0.0, 0.0), (ahead, 0.0, 0.0)
    state = world_state(poses, [(0.22, 0.0, 0.0), (0.0, 0.0, 0.0)])
    assert all(obstacles.next(state) is None for _ in range(50))


def stopping(platform: Platform) -> float:
    """The distance to a stop from full speed if an obstacle appears just after a scan."""
    speed = platform.limits.linear
    return speed * (1.0 / platform.scan.rate + platform.scan.latency) + speed**2 / 2.0


@pytest.mark.parametrize("name", PLATFORMS)
def test_room_is_beyond_the_blind_zone_and_the_stopping_distance(name: str) -> None:
    platform = load_platform(name)
    assert room(platform) > platform.scan.range_min + stopping(platform)
