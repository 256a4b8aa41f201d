"""Sectors that lose their returns at once, freeze, or return nothing where the base is blocked."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import event, given
from hypothesis import strategies as st

from swarmd.core.messages import Reason
from swarmd.core.values import Array, Odometry, Pose, Twist
from swarmd.robot.sensing.blind_sector import BlindSectors
from swarmd.robot.sensing.conditioning import ScanConditioner
from swarmd.robot.sensing.sector_history import frozen_sectors
from swarmd.robot.sensors import Sensors
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import Disc, scan_from, scan_of

BURGER = load_platform("burger")
SPEC = BURGER.scan
PERIOD = 0.2  # s between two scans of a Burger
Path = Callable[[float], Pose]
See = Callable[[float, Pose], Array]
FRONT = np.cos(SPEC.bearings) > math.cos(math.radians(72.5))  # 145 degrees ahead
HALF = np.cos(SPEC.bearings) > 0.0


def straight(time: float) -> Pose:
    return Pose(-0.9 + 0.22 * time, 0.1, 0.2)


def at_rest(time: float) -> Pose:
    return Pose(-0.3, 0.2, 0.4)


def turning(time: float) -> Pose:
    return Pose(0.1, 0.2, 1.5 * time)


def arc(time: float) -> Pose:
    return Pose(0.5 * math.sin(0.4 * time), -0.5 * math.cos(0.4 * time), 0.4 * time)


def in_room(time: float, pose: Pose) -> Array:
    return scan_of(BURGER, room=3.0, pose=pose).ranges


def texts(see: See, path: Path, seconds: float, nothing: float = 0.0) -> list[str]:
    """What is said of the sectors, scan by scan; ranges have 1 cm of noise, and 2 % are lost.

    `nothing`: the range of a ray without a return.
    """
    sectors, rng, said = BlindSectors(SPEC), np.random.default_rng(7), []
    for step in range(1, round(seconds / PERIOD) + 1):
        time = PERIOD * step
        pose = path(time)
        ranges = see(time, pose)
        is_return = np.isfinite(ranges) & (ranges > 0.0) & (rng.random(len(ranges)) >= 0.02)
        noisy = ranges + rng.normal(0.0, 0.01, len(ranges))
        ranges = np.where(is_return, noisy, nothing)
        sectors.take(ranges, SPEC.bearings, Odometry(time, pose, Twist()), time)
        said.append(sectors.text)
    return said


@pytest.mark.parametrize("nothing", [0.0, math.inf])
@pytest.mark.parametrize("path", [at_rest, straight, turning])
def test_a_front_that_loses_its_returns_is_blind_at_once(path: Path, nothing: float) -> None:
    def see(time: float, pose: Pose) -> Array:
        ranges = in_room(time, pose)
        return np.where(FRONT & (time > 1.1), math.inf, ranges)

    said = texts(see, path, 1.4, nothing)
    assert said[:5] == [""] * 5
    assert "lost their returns at once" in said[5]


@pytest.mark.parametrize("path", [straight, arc])
def test_a_front_that_repeats_its_ranges_is_frozen_within_half_a_metre_of_way(path: Path) -> None:
    kept = in_room(0.8, path(0.8))

    def see(time: float, pose: Pose) -> Array:
        return np.where(HALF & (1.0 < time < 4.5), kept, in_room(time, pose))

    said = texts(see, path, 6.0)
    assert said[:5] == [""] * 5
    assert "equal ranges" in said[round(3.6 / PERIOD)]
    assert said[-1] == ""  # the returns that differ have ended it


def frozen_by_hand(means: list[float], look: list[float], pose: Pose, before: Pose) -> list[bool]:
    """The sectors of `frozen_sectors`, one after the other, by what it promises."""
    count, width = len(means), math.tau / len(means)
    static = [math.inf] * count
    for sector, distance in enumerate(look):
        if not math.isnan(distance):
            angle = (sector + 0.5) * width + before.yaw
            x = before.x + distance * math.cos(angle) - pose.x
            y = before.y + distance * math.sin(angle) - pose.y
            place = math.floor((math.atan2(y, x) - pose.yaw) / width) % count
            static[place] = min(static[place], math.hypot(x, y))
    moved, equal = 0, []
    for sector, (now, then) in enumerate(zip(means, look, strict=True)):
        off = min(abs(static[(sector + k) % count] - now) for k in (-1, 0, 1))
        moved += abs(now - then) > 0.1 and off <= 0.05
        equal.append(abs(now - then) <= 0.03 and 0.1 < off < math.inf)
    frozen = [False] * count
    if moved >= 11 and not all(equal):
        start = equal.index(False)
        run: list[int] = []
        for sector in [(start + k) % count for k in range(count + 1)]:
            if equal[sector]:
                run.append(sector)
                continue
            if len(run) >= 11 and sum(means[one] for one in run) * width >= 1.0:
                for one in run:
                    frozen[one] = True
            run = []
    return frozen


@given(
    seed=st.integers(0, 2**16),
    frozen=st.integers(8, 40),
    others=st.integers(8, 50),
    way=st.floats(0.2, 0.6),
)
def test_frozen_sectors_are_those_of_the_docstring(
    seed: int, frozen: int, others: int, way: float
) -> None:
    """Of a wavy room, with so many sectors that freeze, and so many others that return at all."""
    rng, sectors = np.random.default_rng(seed), np.arange(90)
    before, pose = Pose(0.0, 0.0, float(rng.uniform(-3.0, 3.0))), Pose(way, 0.1, 0.3)
    waves = 1.6 + 0.4 * np.sin(sectors / float(rng.uniform(3.0, 9.0)))
    look = np.where(rng.random(90) < 0.05, math.nan, waves)
    angles = (sectors + 0.5) * math.tau / 90 + before.yaw
    x, y = look * np.cos(angles) - way, look * np.sin(angles) - 0.1
    means = np.full(90, math.nan)
    for sector, distance in zip(
        np.floor((np.arctan2(y, x) - pose.yaw) / (math.tau / 90)), np.hypot(x, y), strict=True
    ):
        if not math.isnan(distance):
            means[int(sector) % 90] = distance + rng.normal(0.0, 0.01)
    start = int(rng.integers(90))
    rest = np.roll(sectors, -start)[frozen:]
    means[np.roll(sectors, -start)[:frozen]] = look[np.roll(sectors, -start)[:frozen]]
    means[rest[others:]] = math.nan
    found = frozen_sectors(means, look, pose, before).tolist()
    event(f"frozen: {any(found)}")
    assert found == frozen_by_hand(means.tolist(), look.tolist(), pose, before)


def to_walls(walls: list[tuple[float, float, float, float]], pose: Pose, most: float) -> Array:
    """Ranges to walls from (x, y) to (x, y); beyond `most` rad from their normal, none."""
    angles = SPEC.bearings + pose.yaw
    dx, dy = np.cos(angles), np.sin(angles)
    x, y = pose.x - 0.032 * math.cos(pose.yaw), pose.y - 0.032 * math.sin(pose.yaw)
    best = np.full(len(angles), np.inf)
    for ax, ay, bx, by in walls:
        length = math.hypot(bx - ax, by - ay)
        tx, ty = (bx - ax) / length, (by - ay) / length
        facing = dx * ty - dy * tx
        with np.errstate(divide="ignore", invalid="ignore"):
            range_ = ((ax - x) * ty - (ay - y) * tx) / facing
            along = (x - ax) * tx + (y - ay) * ty + range_ * (dx * tx + dy * ty)
        hit = (range_ > 0.0) & (along >= 0.0) & (along <= length)
        hit &= np.abs(facing) >= math.cos(most)
        best = np.where(hit, np.minimum(best, range_), best)
    best[best > SPEC.range_max] = np.inf
    best[best < SPEC.range_min] = -np.inf
    return best


OPAQUE = math.radians(89.9)
LANE = [(-9.0, 0.5, 9.0, 0.5), (9.0, -0.5, -9.0, -0.5)]
ROOM = [(2.0, -2.0, 2.0, 2.0), (2.0, 2.0, -2.0, 2.0), (-2.0, 2.0, -2.0, -2.0)]
ROOM.append((-2.0, -2.0, 2.0, -2.0))


def walls(walls: list[tuple[float, float, float, float]], most: float = OPAQUE) -> See:
    return lambda time, pose: to_walls(walls, pose, most)


def along(time: float) -> Pose:
    return Pose(-0.5 + 0.22 * time, 0.2, 0.0)


def out_of_a_lane(time: float) -> Pose:
    return Pose(8.0 + 0.22 * time, 0.0, 0.0)


def past_a_door(time: float, pose: Pose) -> Array:
    return to_walls([(-9.0, 0.45, 0.2, 0.45), (1.0, 0.45, 9.0, 0.45)], pose, OPAQUE)


def a_walker_leaves(time: float, pose: Pose) -> Array:
    """A body of 0.5 m before the robot, in the open, goes aside at 1.5 m/s from 1 s on."""
    aside = 1.5 * max(time - 1.0, 0.0)
    return scan_of(BURGER, (Disc(pose.x + 0.65, pose.y + aside, 0.25),), pose=pose).ranges


def one_comes_into_the_blind_zone(time: float, pose: Pose) -> Array:
    """A robot comes from ahead at 0.3 m/s until it touches, before a wall."""
    x = max(1.2 - 0.3 * time, 0.15)
    face = (x - 0.07, -0.09, x - 0.07, 0.09)
    seen = to_walls([(2.0, -3.0, 2.0, 3.0), face], Pose(), OPAQUE)
    near = to_walls([face], Pose(), OPAQUE) == -np.inf
    return np.where(near, np.inf, seen)  # an LDS returns nothing


def others_go_along(time: float, pose: Pose) -> Array:
    """Four robots keep their places around the robot, in a room."""
    discs = tuple(Disc(pose.x + 0.4 * math.cos(k), pose.y + 0.4 * math.sin(k)) for k in range(4))
    return scan_of(BURGER, discs, room=5.0, pose=pose).ranges


def a_box_is_pushed(time: float, pose: Pose) -> Array:
    x, y = pose.x + 0.15, pose.y
    return to_walls([*ROOM, (x, y - 0.4, x, y + 0.4)], pose, OPAQUE)


@pytest.mark.parametrize(
    ("see", "path"),
    [
        pytest.param(in_room, straight, id="a room"),
        pytest.param(in_room, arc, id="a room, on an arc"),
        pytest.param(walls([]), straight, id="an open field"),
        pytest.param(walls(LANE), along, id="a lane"),
        pytest.param(walls(LANE), out_of_a_lane, id="the end of a lane"),
        pytest.param(past_a_door, along, id="a door"),
        pytest.param(walls(ROOM, 0.4), straight, id="glass"),
        pytest.param(walls(ROOM, 0.4), turning, id="glass, turning"),
        pytest.param(a_walker_leaves, at_rest, id="a walker"),
        pytest.param(one_comes_into_the_blind_zone, at_rest, id="the blind zone"),
        pytest.param(others_go_along, along, id="robots that go along"),
        pytest.param(a_box_is_pushed, along, id="a box that is pushed"),
    ],
)
def test_a_whole_sensor_is_not_blind(see: See, path: Path) -> None:
    assert texts(see, path, 6.0) == [""] * 30


def after(see: See, path: Path) -> BlindSectors:
    """The sectors after a scan."""
    sectors = BlindSectors(SPEC)
    scan(sectors, see, path, PERIOD)
    return sectors


def scan(sectors: BlindSectors, see: See, path: Path, time: float) -> Array:
    ranges = see(time, path(time))
    return sectors.take(ranges, SPEC.bearings, Odometry(time, path(time), Twist()), time)


def dead_front(time: float, pose: Pose) -> Array:
    return np.where(FRONT, math.inf, in_room(time, pose))


def test_a_blocked_base_doubts_the_sector_without_returns_ahead_until_it_returns() -> None:
    sectors = after(dead_front, at_rest)
    sectors.on_blocked(0.0, 2.3)
    assert sectors.text.startswith("rays 288..72 deg return nothing, and the base does not move")
    blind = np.isnan(scan(sectors, dead_front, at_rest, 2.4))
    assert blind[HALF].sum() >= 140
    assert not blind[~HALF].any()
    for time in (2.6, 2.8):
        assert np.isfinite(scan(sectors, in_room, at_rest, time)).all()
        assert sectors.text
    scan(sectors, in_room, at_rest, 3.0)
    assert not sectors.text


def test_a_direction_that_returned_something_just_before_is_not_doubted() -> None:
    """A pusher that came into the blind zone, for instance."""
    sectors = after(lambda time, pose: np.where(FRONT, 3.0, in_room(time, pose)), at_rest)
    scan(sectors, dead_front, at_rest, 0.4)
    sectors.on_blocked(0.0, 1.5)
    assert not sectors.text
    sectors.on_blocked(0.0, 2.5)
    assert sectors.text


@pytest.mark.parametrize("turn", [-0.4, 0.0, 0.4])
def test_a_box_that_the_robot_pushes_is_no_doubt_of_the_sensor(turn: float) -> None:
    """Its front is too near to be measured ahead, and returns something on one side at least."""
    along = SPEC.bearings - turn
    front = 0.8 * SPEC.range_min / np.maximum(np.cos(along), 1e-9)
    box = np.where(front < SPEC.range_min, math.inf, front)

    def at_box(time: float, pose: Pose) -> Array:
        return np.where(np.cos(along) > 0.5, box, in_room(time, pose))

    sectors = after(at_box, at_rest)
    sectors.on_blocked(0.0, 2.3)
    assert not sectors.text


def test_a_new_run_ends_the_doubt_of_a_blocked_base_and_no_other() -> None:
    sectors = after(dead_front, at_rest)
    sectors.on_blocked(0.0, 2.3)
    sectors.on_new_run(2.4)
    assert not sectors.text
    sectors = after(in_room, at_rest)
    scan(sectors, dead_front, at_rest, 0.4)
    sectors.on_new_run(0.5)
    assert "lost" in sectors.text


@pytest.mark.parametrize("bearing", [math.pi, 0.5 * math.pi, -0.5 * math.pi])
def test_a_base_that_is_blocked_where_rays_return_is_no_matter_of_the_sensor(
    bearing: float,
) -> None:
    sectors = after(dead_front, at_rest)
    sectors.on_blocked(bearing, 2.3)
    assert not sectors.text


def test_conditioning_rejects_a_front_that_is_lost_once_the_memory_is_stale() -> None:
    conditioner, results = ScanConditioner(SPEC), []
    for seq in range(1, 15):
        time = PERIOD * seq
        see = in_room if seq <= 5 else dead_front
        ranges = see(time, straight(time)) + 1e-6 * seq
        odometry = Odometry(time, straight(time), Twist(0.22))
        results.append(
            conditioner.take(scan_from(BURGER, ranges, SPEC.bearings, seq=seq), odometry, time)
        )
    assert Reason.INVALID_SCAN not in results[:8]
    assert results[10:] == [Reason.INVALID_SCAN] * 4


def driven(side: float, before: float, *, is_frozen: bool = False) -> list[str]:
    """What a robot says of its blind sectors, scan by scan, as it drives ahead at 0.2 m/s.

    Its odometry is reset to zero near the middle of a room of 4 m. `side`: m to the left that the
    pose has before. `before`: m driven before, which decides when the last look was. `is_frozen`:
    half of the rays repeat their ranges from the reset on.
    """
    sensors, said = Sensors(BURGER), list[str]()
    kept: Array | None = None
    for step in range(1, 400):
        time = round(0.05 * step, 9)
        x = 0.2 * time - 1.5 - before
        if x > 1.2:
            break
        pose = Pose(x, side, 0.0) if x < -0.03 else Pose(x + 0.03, 0.0, 0.0)
        sensors.on_odometry(Odometry(time, pose, Twist(0.2)), time)
        if step % 4:
            continue
        ranges = scan_of(BURGER, room=4.0, pose=Pose(x, 0.3, 0.0)).ranges
        noise = np.random.default_rng(step).normal(0.0, 0.004, len(ranges))
        ranges = np.where(np.isfinite(ranges), ranges + noise, 0.0)
        if is_frozen and x > -0.03:
            kept = ranges if kept is None else kept
            ranges = np.where(HALF, kept, ranges)
        sensors.on_scan(scan_from(BURGER, ranges, SPEC.bearings, seq=step // 4), time)
        said.append(sensors.blind_text)
    return said


@pytest.mark.parametrize("before", [0.0, 0.05, 0.1, 0.15, 0.2, 0.25])
@pytest.mark.parametrize("side", [0.15, 0.3, 0.6, 0.8, 1.5, 3.0])
def test_a_reset_of_odometry_makes_no_sector_frozen(side: float, before: float) -> None:
    """By the reset pose the walls beside the robot should be nearer, and those ahead moved."""
    assert set(driven(side, before)) == {""}


def test_a_sector_that_freezes_as_odometry_is_reset_is_found_after_it() -> None:
    assert "equal ranges" in driven(0.6, 0.1, is_frozen=True)[-1]


@pytest.mark.parametrize(
    ("side", "turn", "every"),
    [(0.2, 0.0, 1.0), (0.4, 0.0, 1.0), (0.4, 0.0, 2.0), (0.0, 0.4, 1.0), (0.0, 0.4, 2.0)],
)
def test_odometry_that_shifts_again_and_again_hides_no_frozen_half(
    side: float, turn: float, every: float
) -> None:
    """One reset ends what is compared by motion; shifts to and fro (m, rad; s) must not."""
    sensors = Sensors(BURGER)
    kept: Array | None = None
    for step in range(1, 280):  # 2.8 m at 0.2 m/s
        time = round(0.05 * step, 9)
        x = 0.2 * time - 1.5
        there = int(time / every) % 2
        pose = Pose(x, 0.3 + side * there, turn * there)
        sensors.on_odometry(Odometry(time, pose, Twist(0.2)), time)
        if step % 4:
            continue
        ranges = scan_of(BURGER, room=4.0, pose=Pose(x, 0.3, 0.0)).ranges
        noise = np.random.default_rng(step).normal(0.0, 0.004, len(ranges))
        ranges = np.where(np.isfinite(ranges), ranges + noise, 0.0)
        if x > -1.0:
            kept = ranges if kept is None else kept
            ranges = np.where(HALF, kept, ranges)
        sensors.on_scan(scan_from(BURGER, ranges, SPEC.bearings, seq=step // 4), time)
    assert sensors.blind_text


def test_a_sector_that_was_blind_before_a_reset_stays_so() -> None:
    """A reset ends comparisons, no finding: else a sensor would be trusted after each reset."""
    sectors = BlindSectors(SPEC)
    kinds = np.zeros(90, np.uint8)
    kinds[10:20] = 4
    sectors.restore(kinds, 0.0)
    text = sectors.text
    sectors.forget_motion()
    assert text
    assert sectors.text == text
    assert np.count_nonzero(sectors.kinds) == 10
