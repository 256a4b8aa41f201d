"""Rolling scans: each ray is measured at its own time; transport delays the whole scan."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.values import Array, Platform, Scan, Sweep
from swarmd.settings.platforms import load_platform
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.lidar import sweep_order
from swarmd.sim.world.realism import IDEAL, REALISTIC, LidarNoise, Realism
from swarmd.sim.world.world import World

ROOM = "6x6,box:1:1:0.5:0.3:30,pole:-1.5:1:0.1,segment:-2:-2:0:-1.5"
ROLLING = Realism(lidar=LidarNoise(rolling=True))
BURGER = load_platform("burger")
SWEEPS = (
    Sweep(0.0, 1.0, 0.2),
    Sweep(math.pi, -1.0, 0.2),
    Sweep(1.0, 1.0, 0.17),
)


def turning(sweep: Sweep, platform: Platform = BURGER) -> Platform:
    return replace(platform, scan=replace(platform.scan, sweep=sweep))


def world_of(
    platform: Platform,
    realism: Realism = ROLLING,
    arena: str = ROOM,
    robots: int = 1,
    seed: int = 0,
) -> World:
    starts = np.array([[0.9 * row - 0.5, 0.1, 0.5 + row] for row in range(robots)])
    robots_by_id = {f"r{row}": platform for row in range(robots)}
    return World(robots_by_id, parse_arena(arena), starts, realism=realism, seed=seed)


def after(world: World, robots: int = 1) -> tuple[dict[int, Scan], list[Array]]:
    """The first scans by robot, and the poses at each step."""
    poses = [world.poses()]
    scans: dict[int, Scan] = {}
    world.begin_scans(np.arange(robots))
    while len(scans) < robots:
        scans.update(world.arrived_scans())
        world.step()
        poses.append(world.poses())
    return scans, poses


@pytest.mark.parametrize("measures_late", [False, True])
@pytest.mark.parametrize("sweep", SWEEPS)
def test_rays_are_those_of_scans_at_the_poses_of_their_times(
    sweep: Sweep, measures_late: bool
) -> None:
    platform = turning(sweep)
    world = world_of(platform, robots=2)
    world.measures_late = measures_late
    world.set_commands(np.array([[0.2, 2.5, 0.0], [-0.1, -1.0, 0.0]]))
    world.step(100)
    begun = world.time
    scans, poses = after(world, robots=2)
    order, times = sweep_order(platform.scan.bearings, sweep)
    for row, scan in scans.items():
        assert scan.stamp == pytest.approx(begun)
        assert scan.ages is not None
        steps = np.round((sweep.duration - scan.ages) / world.dt).astype(int)
        np.testing.assert_allclose(steps[order] * world.dt, times, atol=world.dt + 1e-9)
        for step in np.unique(steps):
            still = world_of(platform, IDEAL, robots=2)
            still._qpos[:6] = poses[step].ravel()
            (exact,) = still.scans(np.array([row]))
            of = steps == step
            np.testing.assert_allclose(scan.ranges[of], exact.ranges[of], rtol=0.0, atol=1e-9)
        assert len(np.unique(steps)) >= 10


def test_a_sweep_begins_at_its_start_and_goes_its_way() -> None:
    left, right = (
        sweep_order(BURGER.scan.bearings, Sweep(math.pi / 2.0, turn, 0.2)) for turn in (1.0, -1.0)
    )
    degrees = np.rint(np.degrees(BURGER.scan.bearings))
    assert degrees[left[0][:3]].tolist() == [90.0, 91.0, 92.0]
    assert degrees[right[0][:3]].tolist() == [90.0, 89.0, 88.0]
    np.testing.assert_allclose(left[1], np.arange(360) * 0.2 / 360, atol=1e-9)


@pytest.mark.parametrize("realism", [ROLLING, REALISTIC])
def test_at_rest_in_a_static_scene_the_ranges_are_those_of_an_instant(realism: Realism) -> None:
    at_once = replace_lidar(realism, rolling=False)
    found = []
    for one in (realism, at_once):
        scans, _ = after(world_of(turning(SWEEPS[0]), one))
        found.append(scans[0])
    np.testing.assert_array_equal(found[0].ranges, found[1].ranges)
    assert found[0].ages is not None
    assert found[1].ages is not None
    assert not found[1].ages.any()


def test_a_box_is_seen_where_it_is_when_the_beam_passes() -> None:
    # A box ahead appears in the middle of the sweep, after the rays to the right.
    platform = turning(Sweep(-math.pi, 1.0, 0.2))
    world = world_of(platform, arena="6x6,box/b:2:2:0.6:0.6:0:1", robots=1)
    world.begin_scans(np.array([0]))
    world.step(10)
    x, y, yaw = world.poses()[0]
    world.place("b", (x + math.cos(yaw), y + math.sin(yaw), yaw))
    world.step(10)
    ((_, scan),) = world.arrived_scans()
    bearings = platform.scan.bearings
    is_left = (bearings > math.radians(18.5)) & (bearings < math.radians(22.0))
    is_right = (bearings < -math.radians(18.5)) & (bearings > -math.radians(22.0))
    assert (np.abs(scan.ranges[is_left] - 0.75) < 0.1).all()
    assert not ((scan.ranges[is_right] > 0.0) & (scan.ranges[is_right] < 1.5)).any()


def replace_lidar(realism: Realism, **values: float) -> Realism:
    lidar = {name: getattr(realism.lidar, name) for name in realism.lidar.__struct_fields__}
    return Realism(
        lidar=LidarNoise(**{**lidar, **values}),
        odometry=realism.odometry,
        actuation=realism.actuation,
    )


def arrivals(world: World, seconds: float, period: int = 20) -> list[float]:
    """Times at which scans of robot 0 arrive that begin every `period` steps."""
    times = []
    for step in range(round(seconds / world.dt)):
        if step % period == 0:
            world.begin_scans(np.array([0]))
        times += [world.time for row, _ in world.arrived_scans() if row == 0]
        world.step()
    return times


@pytest.mark.parametrize(
    ("noise", "first"),
    [
        (LidarNoise(latency=0.5), 0.1),  # all rays at once: their mean age is the latency
        (LidarNoise(rolling=True), 0.2),  # with the last ray
        (LidarNoise(rolling=True, latency=0.5), 0.2),  # half a period is that of the sweep itself
        (LidarNoise(rolling=True, latency=0.75), 0.25),
        (LidarNoise(rolling=True, latency=0.5, delay=0.1), 0.3),
        (LidarNoise(delay=0.1), 0.1),
    ],
)
def test_the_mean_age_on_arrival_is_the_latency_and_the_delay(
    noise: LidarNoise, first: float
) -> None:
    times = arrivals(world_of(turning(SWEEPS[0]), Realism(lidar=noise)), 1.0)
    assert times[:3] == pytest.approx([first, first + 0.2, first + 0.4])


def test_jitter_is_drawn_for_each_scan_and_robot_and_keeps_their_order() -> None:
    noise = LidarNoise(rolling=True, jitter=0.5)
    world = world_of(turning(SWEEPS[0]), Realism(lidar=noise), robots=2)
    late: dict[int, list[float]] = {0: [], 1: []}
    seqs: dict[int, list[int]] = {0: [], 1: []}
    for step in range(2000):
        if step % 20 == 0:
            world.begin_scans(np.arange(2))
        for row, scan in world.arrived_scans():
            late[row].append(world.time - scan.stamp - 0.2)
            seqs[row].append(scan.seq)
        world.step()
    assert late[0] != late[1]
    for row in late:
        assert seqs[row] == sorted(seqs[row])
        assert min(late[row]) < 0.1
        assert 0.4 < max(late[row]) <= 0.51


def test_a_scan_that_begins_during_one_waits_for_its_end() -> None:
    times = arrivals(world_of(turning(SWEEPS[0])), 1.0, period=15)
    assert times == pytest.approx([0.2, 0.4, 0.6, 0.8])


def test_a_platform_without_a_sweep_measures_all_rays_at_once() -> None:
    platform = load_platform("thymio")
    assert platform.scan.sweep is None
    scans, _ = after(world_of(platform))
    assert scans[0].ages is None
