"""Range sensors: rays, exact ranges against MuJoCo, and visibility."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from swarmd.core.values import Array, Platform, ScanSpec
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.sim.world import bodies
from swarmd.sim.world.arena import Arena, Box, Pole, parse_arena
from swarmd.sim.world.layouts import parse_layout
from swarmd.sim.world.lidar import Lidar, LidarModel, SortedRays, Visibility, shapes_of
from swarmd.sim.world.world import World
from tests.support.platforms import with_plain_scan

OBSTACLES = "7x6,box:1:1:0.5:0.3:30,box:-2:-1:0.2:1.5:-75,pole:-2:2:0.1,pole:2:-2:0.3,pole:0:0:0.02"
TIGHT = "4x4"
MOVABLE = (
    "6x6,segment:-1:-2:1.5:-1.2,segment:2:0:2:2.9,box/a:1:1:0.5:0.3:30:0.3,box:-2:-1:0.2:1.5:-75"
    ",box/b:0:0:0.3:0.3:0:1,box/c:-1:1:0.8:0.1:10:0.5,box/late:0:0:1:1:0:1:out"
)
MIXED = ("burger", "waffle_pi", "jackal", "waffle_pi", "burger", "jackal", "burger")
FIELD = Arena(20.0, 20.0)


def plain(kind: str) -> Platform:
    """With a sensor that tells near from nothing, as the caster does."""
    return with_plain_scan(load_platform(kind))


def world_of(kinds: Sequence[str], arena: str, seed: int, visibility: Visibility) -> World:
    platforms = [plain(kind) for kind in kinds]
    space = parse_arena(arena)
    starts = parse_layout("random:0.01", [p.footprint for p in platforms], space, seed=seed)
    robots = {f"r{i}": platform for i, platform in enumerate(platforms)}
    return World(robots, space, starts, lidars=LidarModel(visibility))


def oracle(world: World, robot: int, visibility: Visibility) -> Array:
    """The ranges as mj_multiRay finds them, with the meaning of a range applied."""
    mujoco.mj_kinematics(world.model, world.data)  # a step leaves it where the bodies were before
    platform = world.platforms[robot]
    spec = platform.scan
    x, y, yaw = world.poses()[robot]
    place = [
        x + math.cos(yaw) * spec.offset[0] - math.sin(yaw) * spec.offset[1],
        y + math.sin(yaw) * spec.offset[0] + math.cos(yaw) * spec.offset[1],
        bodies.heights(platform).scan_plane if visibility == "real" else 0.25,
    ]
    groups = np.zeros(6, dtype=np.uint8)
    seen = (bodies.BODY, bodies.HOUSING) if visibility == "real" else (bodies.COLLISION,)
    groups[[*seen, bodies.FIXED]] = 1
    rays = len(spec.bearings)
    headings = yaw + spec.bearings
    vectors = np.stack((np.cos(headings), np.sin(headings), np.zeros(rays)), axis=-1)
    found = np.zeros(rays, dtype=np.int32)
    distance = np.zeros(rays)
    body = world.model.body(f"robot/{world.ids[robot]}").id
    mujoco.mj_multiRay(
        world.model, world.data, place, vectors.ravel(), groups, True, body,
        found, distance, None, rays, 1e6,
    )  # fmt: skip
    distance[(found < 0) | (distance > spec.range_max)] = np.inf
    distance[distance < spec.range_min] = -np.inf
    return distance


@pytest.mark.parametrize("visibility", ["body", "real"])
@pytest.mark.parametrize("kinds", [("burger",) * 7, ("waffle_pi",) * 7, ("jackal",) * 4, MIXED])
def test_agrees_with_mujoco_to_a_nanometre(kinds: tuple[str, ...], visibility: Visibility) -> None:
    for seed in range(8):
        world = world_of(kinds, (OBSTACLES, TIGHT)[seed % 2], seed, visibility)
        robots = np.arange(len(kinds))
        for robot, scan in zip(robots, world.scans(robots), strict=True):
            expected = oracle(world, int(robot), visibility)
            np.testing.assert_allclose(scan.ranges, expected, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("visibility", ["body", "real"])
def test_agrees_with_mujoco_about_boxes_that_were_pushed_and_inner_walls(
    visibility: Visibility,
) -> None:
    compared = 0
    for seed in range(4):
        world = world_of(MIXED, MOVABLE, seed, visibility)
        world.model.geom_group[world.model.geom("box/late").id] = (
            5  # out: nor may the oracle see it
        )
        robots = np.arange(len(MIXED))
        before = world.box_poses()
        for _ in range(3):
            world.set_commands(np.tile((0.5, 0.2, 0.0), (len(MIXED), 1)))
            world.data.qvel[3 * len(MIXED) : -3] = (1.0, -1.0, 2.0) * 3  # all but the one outside
            world.step(150)
            for robot, scan in zip(robots, world.scans(robots), strict=True):
                expected = oracle(world, int(robot), visibility)
                np.testing.assert_allclose(scan.ranges, expected, rtol=0.0, atol=1e-9)
                compared += len(expected)
        assert (np.abs(world.box_poses() - before)[:3].max(axis=1) > 0.05).all()
    assert compared > 10_000


def test_a_scan_in_a_crowd_does_not_depend_on_other_observers() -> None:
    platform = plain("waffle_pi")
    arena = Arena(12.0, 12.0)
    starts = parse_layout("random:0.05", [platform.footprint] * 120, arena, seed=1)
    world = World({f"r{i}": platform for i in range(120)}, arena, starts)
    together = [scan.ranges for scan in world.scans(np.arange(120))]
    for robot in range(0, 120, 7):
        (scan,) = world.scans(np.array([robot]))
        np.testing.assert_array_equal(scan.ranges, together[robot])
        np.testing.assert_allclose(scan.ranges, oracle(world, robot, "body"), rtol=0.0, atol=1e-9)


def test_the_compared_worlds_hold_hits_misses_and_near_returns() -> None:
    # Or the comparison above would prove nothing.
    worlds = [world_of(MIXED, arena, 1, "body") for arena in (OBSTACLES, TIGHT)]
    scans = [scan for world in worlds for scan in world.scans(np.arange(len(MIXED)))]
    ranges = np.concatenate([scan.ranges for scan in scans])
    assert np.isfinite(ranges).sum() > 1000
    assert np.isposinf(ranges).sum() > 100
    assert np.isneginf(ranges).sum() > 10


def test_at_true_height_a_waffle_sees_of_a_waffle_only_the_lidar_housing() -> None:
    platform = plain("waffle_pi")
    robots = {"a": platform, "b": platform}
    starts = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    arena = Arena(20.0, 20.0)
    widths = {}
    sights: tuple[Visibility, ...] = ("body", "real")
    for visibility in sights:
        world = World(robots, arena, starts, lidars=LidarModel(visibility))
        widths[visibility] = np.isfinite(world.scans(np.array([0]))[0].ranges).sum()
    assert widths["real"] == 2 * math.floor(math.degrees(math.asin(0.055 / 1.0))) + 1
    assert widths["body"] == 21


def look(spec: ScanSpec, arena: Arena, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Array:
    """What a sensor alone in an arena sees."""
    lidar = Lidar(spec, shapes_of(arena, (), plane=None))
    ranges: Array = lidar.cast(np.array([[x, y, yaw]]), np.array([0]))[0]
    return ranges


@pytest.mark.parametrize(
    ("distance", "expected"),
    [(0.11, -np.inf), (0.13, 0.13), (3.4, 3.4), (3.6, np.inf)],
)
def test_too_near_and_too_far_differ(distance: float, expected: float) -> None:
    spec = ScanSpec(np.array([0.0]), 5.0, 0.12, 3.5)
    assert look(spec, Arena(20.0, 20.0), x=10.0 - distance)[0] == pytest.approx(expected)


def test_no_ray_slips_through_a_corner() -> None:
    corners = np.radians([45.0, 135.0, -135.0, -45.0])
    for turn in np.linspace(-7.0, 7.0, 501):
        ranges = look(ScanSpec(corners - turn, 10.0, 0.0, 10.0), Arena(4.0, 4.0), yaw=turn)
        np.testing.assert_allclose(ranges, math.sqrt(8.0), atol=1e-9)


def test_a_surface_seen_edge_on_never_counts_as_near() -> None:
    spec = ScanSpec(np.radians(np.arange(360.0)), 5.0, 0.12, 3.5)
    # The sensor stands on the line of the box's southern face.
    arena = Arena(20.0, 20.0, boxes=(Box(1.5, 0.5, 1.0, 1.0),), poles=(Pole(0.0, 3.0, 0.1),))
    for y in (0.0, 1e-17, -1e-17, 1e-13, -1e-13):
        ranges = look(spec, arena, y=y)
        assert not np.isneginf(ranges).any()
        assert not np.isnan(ranges).any()
        assert ranges[90] == pytest.approx(2.9)


def test_a_surface_seen_almost_edge_on_is_not_taken_for_near() -> None:
    # Just below the line of the box's southern face, whose line these rays cross on their way.
    spec = ScanSpec(np.linspace(2e-13, 3e-12, 20), 5.0, 0.12, 3.5)
    ranges = look(spec, Arena(20.0, 20.0, boxes=(Box(1.5, 0.5, 1.0, 1.0),)), y=-1e-13)
    np.testing.assert_allclose(ranges, 1.0)


def test_sees_footprints_of_any_number_of_corners_in_one_swarm() -> None:
    # A triangle, whose tip points at the first robot, beside a rectangle of the same reach.
    box = plain("burger")
    triangle = np.array([[-0.2, 0.0], [0.2, -0.2], [0.2, 0.2]])
    wedge = replace(box, name="wedge", footprint=triangle)
    lidar = Lidar(
        replace(box.scan, offset=(0.0, 0.0)), shapes_of(FIELD, (box, wedge, box), plane=None)
    )
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, math.pi / 2.0]])
    ranges = lidar.cast(poses, np.array([0]))[0]
    assert ranges[0] == pytest.approx(0.8)
    assert ranges[90] == pytest.approx(1.0 - 0.102)
    slant = math.radians(5.0)
    # The face from (0.8, 0) to (1.2, 0.2) along the ray at 5 degrees.
    along = 0.8 * 0.2 / (0.4 * math.sin(slant) * -1.0 + 0.2 * math.cos(slant))
    assert ranges[5] == pytest.approx(along)


def test_no_robot_sees_itself_even_with_a_sensor_outside_its_footprint() -> None:
    platform = plain("burger")
    outside = replace(platform, scan=replace(platform.scan, offset=(0.5, 0.0)))
    world = World({"a": outside}, FIELD, np.zeros((1, 3)))
    assert np.isposinf(world.scans(np.array([0]))[0].ranges).all()


EVEN = np.radians(np.arange(360.0))
SHIFTED = np.radians(np.arange(7.0, -353.0, -1.0))
UNEVEN = np.radians([40.0, -40.0, 20.0, 0.0, 170.0, -170.0, 359.0, 180.0])
FAN = np.radians(np.linspace(-120.0, 120.0, 241))


def seen_of_surface(bearings: Array, yaw: float, low: float, high: float) -> list[int]:
    """The rays that meet a surface between two bearings, at 1 m from a sensor with this yaw."""
    ends = np.array([[math.cos(yaw + end), math.sin(yaw + end)] for end in (high, low)])
    shapes = shapes_of(FIELD, [], plane=None)
    lidar = Lidar(ScanSpec(bearings, 5.0, 1e-3, 10.0), replace(shapes, walls=ends[None]))
    ranges = lidar.cast(np.array([[0.0, 0.0, yaw]]), np.array([0]))
    return np.flatnonzero(np.isfinite(ranges[0])).tolist()


@pytest.mark.parametrize("bearings", [EVEN, SHIFTED, UNEVEN, FAN])
def test_the_rays_between_the_ends_of_a_surface_meet_it(bearings: Array) -> None:
    rng = np.random.default_rng(3)
    for _ in range(400):
        low, yaw = rng.uniform(-3.0 * math.pi, 2.0 * math.pi, 2).tolist()
        width = rng.uniform(0.01, 0.99 * math.pi)
        inside = np.flatnonzero(np.mod(bearings - low, 2.0 * math.pi) <= width)
        assert seen_of_surface(bearings, yaw, low, low + width) == inside.tolist()


@pytest.mark.parametrize("bearings", [EVEN, SHIFTED, UNEVEN, FAN])
def test_a_ray_at_the_very_end_of_a_surface_meets_it_on_both_sides(bearings: Array) -> None:
    for ray, bearing in enumerate(bearings.tolist()):
        assert seen_of_surface(bearings, 0.0, bearing - 1e-3, bearing) == [ray]
        assert seen_of_surface(bearings, 0.0, bearing, bearing + 1e-3) == [ray]


@pytest.mark.parametrize("name", platform_names())
def test_the_lidars_of_our_platforms_need_no_search(name: str) -> None:
    bearings = load_platform(name).scan.bearings
    steps = np.diff(np.sort(bearings))
    is_even = np.allclose(steps, steps[0])
    assert SortedRays(bearings).is_even == is_even  # of few rays a search is as fast


def test_a_beam_with_a_cone_returns_the_nearest_object_in_it() -> None:
    bearings = np.radians([0.0, 90.0])
    arena = Arena(20.0, 20.0, poles=(Pole(1.0, 0.2, 0.05), Pole(0.4, 0.4, 0.05)))
    line = ScanSpec(bearings, 10.0, 0.05, 2.0)
    assert np.isposinf(look(line, arena)).all()
    seen = look(replace(line, cone=math.radians(27.0)), arena)
    assert 0.96 < seen[0] < 1.03  # the pole at 11 degrees; at 45 degrees no beam sees a pole
    assert np.isposinf(seen[1])
