"""The world: motion, contacts and sensors of robots."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array, Platform
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.sim.world.arena import Arena, parse_arena
from swarmd.sim.world.geometry import transform
from swarmd.sim.world.realism import IDEAL, REALISTIC, Realism
from swarmd.sim.world.world import World
from tests.support.range_ring import RING_DEG, ring_spec, with_ring

FIELD = Arena(40.0, 40.0)
ROOM = Arena(1.5, 1.5)
PLATFORMS = ("burger", "waffle_pi", "jackal")


def alone(name: str, start: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> World:
    return World({"a": load_platform(name)}, FIELD, np.array([start]))


def pair(name: str, apart: float, arena: Arena = FIELD) -> World:
    """Two robots face to face on the x axis."""
    platform = load_platform(name)
    starts = np.array([[-apart / 2.0, 0.0, 0.0], [apart / 2.0, 0.0, math.pi]])
    return World({"a": platform, "b": platform}, arena, starts)


def drive(world: World, twist: tuple[float, float, float], seconds: float) -> None:
    world.set_commands(np.tile(twist, (len(world.ids), 1)))
    world.step(round(seconds / world.dt))


def test_all_platforms_can_be_simulated() -> None:
    assert set(PLATFORMS) <= set(platform_names())
    for name in platform_names():
        drive(alone(name), (0.1, 0.0, 0.0), 0.1)


@pytest.mark.parametrize("name", PLATFORMS)
@pytest.mark.parametrize(
    ("linear", "angular"),
    [(0.2, 0.0), (-0.2, 0.0), (0.2, 1.0), (0.0, 1.8), (0.0, -1.8), (0.1, -0.5)],
)
def test_tracks_a_twist_within_a_percent(name: str, linear: float, angular: float) -> None:
    world = alone(name, (1.0, -2.0, 0.7))
    drive(world, (linear, angular, 0.0), 2.0)  # past the ramp
    twists = []
    for _ in range(100):
        world.step()
        twists.append(world.twists()[0])
    measured = np.array(twists)
    wanted = np.array([linear, angular, 0.0])
    scale = np.array([0.2, 1.8, 0.2])
    assert np.abs((measured - wanted) / scale).max() < 0.01


@pytest.mark.parametrize("name", PLATFORMS)
def test_drives_a_circle_without_drifting_sideways(name: str) -> None:
    linear, angular = 0.2, 1.0
    world = alone(name)
    drive(world, (linear, angular, 0.0), 1.0)
    x, y, yaw = world.poses()[0]
    center = np.array([x - linear / angular * math.sin(yaw), y + linear / angular * math.cos(yaw)])
    away = []
    for _ in range(3 * 628):
        world.step()
        away.append(math.hypot(*(world.poses()[0, :2] - center)))
    # Three turns; a lateral drift of 1 mm/s would add up to 19 mm.
    assert np.abs(np.array(away) - linear / angular).max() < 2e-4


@pytest.mark.parametrize("name", PLATFORMS)
def test_ramps_no_faster_than_the_platform_can(name: str) -> None:
    platform = load_platform(name)
    world = alone(name)
    world.set_commands(np.array([[9.0, 9.0, 0.0]]))
    speeds = [world.twists()[0]]
    for _ in range(300):
        world.step()
        speeds.append(world.twists()[0])
    gain = np.diff(np.array(speeds), axis=0).max(axis=0) / world.dt
    assert gain[0] <= platform.body["linear_acceleration"] * 1.001
    assert gain[1] <= platform.body["angular_acceleration"] * 1.001
    assert speeds[-1][0] == pytest.approx(platform.limits.linear)
    assert speeds[-1][1] == pytest.approx(platform.limits.angular)


def test_a_base_that_cannot_move_sideways_does_not() -> None:
    world = alone("waffle_pi")
    drive(world, (0.0, 0.0, 1.0), 1.0)
    np.testing.assert_array_equal(world.poses(), 0.0)


def test_a_nan_command_stops_the_robot() -> None:
    world = alone("waffle_pi")
    world.set_commands(np.array([[math.nan, math.inf, -math.inf]]))
    world.step(100)
    np.testing.assert_array_equal(world.poses(), 0.0)


def test_is_exactly_at_rest_after_driving() -> None:
    # A stiff servo with a force limit used to chatter here.
    world = alone("waffle_pi")
    drive(world, (0.26, 1.0, 0.0), 2.0)
    drive(world, (0.0, 0.0, 0.0), 1.0)
    before = world.poses()
    world.step(100)
    assert np.abs(world.poses() - before).max() < 1e-9
    assert np.abs(world.twists()).max() < 1e-9


@pytest.mark.parametrize("name", PLATFORMS)
@pytest.mark.parametrize("yaw", [0.0, 0.6, math.pi])
def test_a_wall_stops_a_robot_that_drives_into_it(name: str, yaw: float) -> None:
    platform = load_platform(name)
    world = World({"a": platform}, Arena(4.0, 4.0), np.array([[0.0, 0.0, yaw]]))
    deepest = 0.0
    met = set()
    for _ in range(30):
        drive(world, (platform.limits.linear, 0.0, 0.0), 1.0)
        met |= {(contact.a, contact.b) for contact in world.contacts()}
        deepest = max(
            deepest, float(np.abs(transform(platform.footprint, world.poses()[0])).max()) - 2.0
        )
    assert deepest < 1e-3
    assert met
    assert all(b.startswith("wall/") for _, b in met)
    assert np.abs(world.twists()[0, 0]) < 0.05


def test_no_robot_id_is_taken_for_a_part_of_the_arena() -> None:
    arena = parse_arena("8x8,box:1:0:0.5:0.5:45,pole:-1:0:0.1")
    ids = ("wall", "box", "pole", "wall_east", "box_0", "world")
    robots = {robot: load_platform("burger") for robot in ids}
    starts = np.array([[-2.5 + 0.5 * i, 2.0, 0.0] for i in range(len(ids))])
    assert World(robots, arena, starts).ids == ids


def test_a_head_on_contact_has_both_speeds() -> None:
    world = pair("waffle_pi", 1.0)
    world.set_commands(np.array([[0.2, 0.0, 0.0], [0.1, 0.0, 0.0]]))
    while not world.contacts():
        world.step()
    (contact,) = world.contacts()
    assert (contact.a, contact.b) == ("a", "b")
    assert contact.speed_a == pytest.approx(0.2, abs=1e-6)
    assert contact.speed_b == pytest.approx(0.1, abs=1e-6)
    assert contact.closing_speed == pytest.approx(0.3, abs=1e-6)


@pytest.mark.parametrize("place", [(0.0, 0.19), (0.16, 0.0)])
def test_the_corner_of_a_turning_robot_has_its_own_contact_speed(
    place: tuple[float, float],
) -> None:
    platform = load_platform("burger")
    # Beside or behind the other, the corner of the first reaches farther than its side does.
    starts = np.array([[0.0, 0.0, 0.0], [*place, 0.0]])
    world = World({"a": platform, "b": platform}, FIELD, starts)
    world.set_commands(np.array([[0.0, 2.0, 0.0], [0.0, 0.0, 0.0]]))
    while not world.contacts():
        world.step()
    (contact,) = world.contacts()
    assert contact.speed_a > 0.05
    assert contact.speed_b == pytest.approx(0.0, abs=1e-9)


def test_contacts_are_those_of_all_steps_of_the_last_call() -> None:
    bumper = pair("waffle_pi", 0.18)
    drive(bumper, (0.26, 0.0, 0.0), 0.5)
    (contact,) = bumper.contacts()
    assert (contact.a, contact.b) == ("a", "b")
    assert contact.closing_speed > 0.2  # of the first touch, not of the rest that followed
    drive(bumper, (-0.26, 0.0, 0.0), 0.5)
    assert bumper.contacts()  # they touched while they slowed down
    drive(bumper, (-0.26, 0.0, 0.0), 0.5)
    assert bumper.contacts() == []


def test_a_pile_neither_sinks_in_nor_blows_up() -> None:
    platform = load_platform("waffle_pi")
    n = 16
    turn = 2.0 * np.pi * np.arange(n) / n
    starts = np.stack((2.0 * np.cos(turn), 2.0 * np.sin(turn), turn + np.pi), axis=-1)
    world = World({f"r{i}": platform for i in range(n)}, Arena(6.0, 6.0), starts)
    fastest = 0.0
    for _ in range(100):
        drive(world, (0.26, 0.0, 0.0), 0.1)
        fastest = max(fastest, float(np.abs(world.data.qvel[:]).max()))
    assert fastest < 2.0
    depths = np.array([depth for depth in world.data.contact.dist])
    assert len(depths) > n / 2
    assert depths.min() > -1.5e-3


def test_steps_can_be_made_one_by_one_or_many_at_once() -> None:
    worlds = [pair("burger", 0.4), pair("burger", 0.4)]
    for world in worlds:
        world.set_commands(np.array([[0.2, 0.3, 0.0], [0.2, -0.3, 0.0]]))
    worlds[0].step(150)
    for _ in range(150):
        worlds[1].step()
    np.testing.assert_array_equal(worlds[0].poses(), worlds[1].poses())
    assert worlds[0].time == worlds[1].time == pytest.approx(1.5)


def test_odometry_begins_at_the_origin_wherever_the_robot_starts() -> None:
    world = alone("waffle_pi", (3.0, -2.0, 2.0))
    drive(world, (0.2, 0.0, 0.0), 2.0)
    (odometry,) = world.odometry()
    assert odometry.pose.x == pytest.approx(np.hypot(*(world.poses()[0, :2] - [3.0, -2.0])))
    assert odometry.pose.y == pytest.approx(0.0, abs=1e-9)
    assert odometry.pose.yaw == pytest.approx(0.0, abs=1e-9)
    assert odometry.twist.linear == pytest.approx(0.2)
    assert odometry.stamp == pytest.approx(2.0)


def test_scans_count_up_and_carry_simulated_time() -> None:
    world = pair("burger", 1.0)
    both = np.array([1, 0])
    first = world.scans(both)
    world.step(20)
    second = world.scans(np.array([1]))
    assert [scan.seq for scan in first] == [0, 0]
    assert second[0].seq == 1
    assert second[0].stamp - first[0].stamp == pytest.approx(0.2)


def test_scans_come_in_the_order_asked_for_in_a_mixed_swarm() -> None:
    robots = {name: load_platform(name) for name in ("jackal", "burger", "waffle_pi")}
    starts = np.array([[-2.0, 0.0, 0.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    world = World(robots, FIELD, starts)
    scans = world.scans(np.array([2, 0, 1]))
    assert [scan.range_min for scan in scans] == [0.12, 0.8, 0.12]
    np.testing.assert_array_equal(scans[0].ranges, world.scans(np.array([2]))[0].ranges)


def test_without_realism_the_senses_are_exact_whatever_the_seed() -> None:
    one, other = swarm(seed=1), swarm(seed=2)
    np.testing.assert_array_equal(ranges_of(one), ranges_of(other))


def test_realistic_sensor_errors_are_random_and_repeat_with_the_seed() -> None:
    exact, first = swarm(), swarm(realism=REALISTIC, seed=1)
    again, other = swarm(realism=REALISTIC, seed=1), swarm(realism=REALISTIC, seed=2)
    measured = ranges_of(first)
    hits = np.isfinite(ranges_of(exact)) & np.isfinite(measured) & (measured > 0.0)
    assert hits.mean() > 0.5
    off = measured[hits] - ranges_of(exact)[hits]
    assert 0.005 < np.abs(off).mean() < 0.1
    np.testing.assert_array_equal(measured, ranges_of(again))
    assert (measured != ranges_of(other)).any()


def test_realistic_bases_follow_late_and_slowly() -> None:
    world = swarm(realism=REALISTIC)
    world.set_commands(np.tile((0.2, 0.0, 0.0), (5, 1)))
    delay = round(REALISTIC.actuation.delay / world.dt)
    world.step(delay)
    np.testing.assert_array_equal(world.twists()[:, 0], 0.0)
    world.step(5)
    np.testing.assert_allclose(world.twists()[:, 0], 0.05, atol=1e-6)


def test_realistic_odometry_drifts_away_from_the_truth() -> None:
    world = swarm(realism=REALISTIC, seed=3)
    start = world.poses()
    world.set_commands(np.tile((0.2, 0.3, 0.0), (5, 1)))
    for _ in range(100):
        world.step(5)
        told = world.odometry()
    off = np.array([o.pose.yaw for o in told]) - (world.poses() - start)[:, 2]
    assert 1e-4 < np.abs(off).max() < 0.2
    assert len({o.pose.x for o in told}) == 5


def test_a_robot_taken_out_is_neither_touched_nor_seen() -> None:
    world = pair("burger", 1.0)
    world.take_out(1)
    assert np.isnan(world.poses()[1]).all()
    assert np.isfinite(world.poses()[0]).all()
    first, gone = world.scans(np.array([0, 1]))
    # An LDS gives 0 where nothing is.
    assert not first.ranges.any()
    assert not gone.ranges.any()
    assert all(odometry.pose.is_finite for odometry in world.odometry())
    drive(world, (0.2, 0.0, 0.0), 6.0)
    assert world.poses()[0, 0] > 0.5
    assert not world.contacts()


def test_poses_that_are_handed_out_are_copies() -> None:
    world = alone("burger")
    world.poses()[:] = 7.0
    np.testing.assert_array_equal(world.poses(), 0.0)


def test_a_platform_without_a_body_is_refused_with_the_key_that_is_missing() -> None:
    whole = load_platform("burger")
    bodiless = Platform(
        whole.name, whole.limits, whole.footprint, whole.scan, whole.provides, whole.protection
    )
    with pytest.raises(ConfigError, match=r"burger: body\.mass"):
        World({"a": bodiless}, FIELD, np.zeros((1, 3)))


@pytest.mark.parametrize("name", platform_names())
def test_every_platform_drives_in_the_world(name: str) -> None:
    world = alone(name)
    world.set_commands(np.array([[0.1, 0.0, 0.0]]))
    world.step(200)
    assert world.poses()[0, 0] == pytest.approx(0.2, abs=0.05)
    assert len(world.scans(np.array([0]))[0].ranges) == len(load_platform(name).scan.bearings)


def test_a_ring_measures_beside_the_lidar_from_its_own_offset() -> None:
    spec = ring_spec((0.1, 0.0))
    arena = Arena(2.0, 2.0)
    ringed = replace(with_ring("burger", spec), name="ringed")
    world = World({"a": ringed, "b": load_platform("burger")}, arena,
                  np.array([[0.0, 0.0, 0.0], [-0.6, 0.0, 0.0]]))  # fmt: skip
    assert world.rings == [0]
    assert world.ring_rates.tolist() == [20.0]
    seen = dict(zip(RING_DEG, world.ring_scan(0).ranges.tolist(), strict=True))
    assert seen[0.0] == pytest.approx(0.9)
    assert seen[60.0] == math.inf  # the wall is 1.15 m away
    nose = float(load_platform("burger").footprint[:, 0].max())
    assert seen[180.0] == pytest.approx(0.7 - nose)
    assert [world.ring_scan(0).seq, len(world.scans(np.array([0]))[0].ranges)] == [1, 360]


def test_the_noise_of_a_ring_is_its_own_and_changes_no_scan() -> None:
    def scans(platform: Platform) -> tuple[World, Array]:
        world = World({"a": platform}, ROOM, np.zeros((1, 3)), realism=REALISTIC, seed=3)
        if world.rings:
            world.ring_scan(0)
        return world, world.scans(np.array([0]))[0].ranges

    ringed, ranges = scans(with_ring("burger"))
    np.testing.assert_array_equal(ranges, scans(load_platform("burger"))[1])
    first, second = ringed.ring_scan(0).ranges, ringed.ring_scan(0).ranges
    assert not np.array_equal(first, second)
    assert first[RING_DEG.index(0.0)] == pytest.approx(0.75, abs=0.1)


def test_as_many_poses_as_robots_are_wanted() -> None:
    with pytest.raises(ConfigError, match="1 robots"):
        World({"a": load_platform("burger")}, FIELD, np.zeros((2, 3)))


def swarm(realism: Realism = IDEAL, seed: int = 0) -> World:
    """Five Waffle Pis in a row, between walls."""
    robots = dict.fromkeys("abcde", load_platform("waffle_pi"))
    starts = np.array([[-2.0 + x, 0.0, 0.5] for x in range(5)])
    return World(robots, Arena(6.0, 6.0), starts, realism=realism, seed=seed)


def ranges_of(world: World) -> Array:
    rows = np.arange(len(world.ids))
    return np.array([scan.ranges for scan in world.scans(rows)])


def test_a_hovering_body_drifts_and_holds_its_height_within_bounds() -> None:
    world, other = alone("crazyflie"), alone("burger")
    drifts, heights = [], []
    for _ in range(1000):
        world.step(5)
        drifts.append(world.twists()[0, [0, 2]])
        heights.append(world.readings(0)["height"])
    body = world.platforms[0].body
    assert np.abs(drifts).max() <= 2.0 * body["drift"] + 1e-9
    assert 0.4 * body["drift"] < np.std(drifts) < 1.4 * body["drift"]
    assert np.abs(np.array(heights) - 0.5).max() <= 2.0 * body["height_error"] + 1e-9
    assert 0.4 * body["height_error"] < np.std(heights) < 1.4 * body["height_error"]
    assert world.has_readings
    assert not other.has_readings
    other.step(10)
    assert not other.twists().any()
