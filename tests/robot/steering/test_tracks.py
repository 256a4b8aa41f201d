"""Tracks of moving discs before a wall, from scans that are computed here."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from swarmd.core.values import ZERO, Array, Odometry, Pose, Scan, Twist
from swarmd.robot.protection.decision import DecisionContext, ToldObstacle
from swarmd.robot.steering.tracks import Surroundings, Tracker
from swarmd.settings.platforms import load_platform
from tests.support.kernel_forms import both_forms, compares_forms
from tests.support.tracks import numbers_of

BURGER = load_platform("burger")
BEARINGS = BURGER.scan.bearings
WALL = -1.8  # m, y of a wall
Place = tuple[float, float]
Way = Callable[[float], Place]


def ranges_at(pose: Pose, discs: list[tuple[Place, float]], wall: float = WALL) -> Array:
    """The nearest hits of all rays on discs of a centre and a radius, and on the wall."""
    angles = BEARINGS + pose.yaw
    dx, dy = np.cos(angles), np.sin(angles)
    ox, oy = BURGER.scan.offset
    x = pose.x + math.cos(pose.yaw) * ox - math.sin(pose.yaw) * oy
    y = pose.y + math.sin(pose.yaw) * ox + math.cos(pose.yaw) * oy
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(dy < 0.0, (wall - y) / dy, np.inf)
    for (cx, cy), radius in discs:
        along = (cx - x) * dx + (cy - y) * dy
        off = np.abs((cx - x) * dy - (cy - y) * dx)
        is_hit = (off < radius) & (along > 0.0)
        depth = np.sqrt(np.maximum(radius * radius - off * off, 0.0))
        found = np.where(is_hit, np.minimum(found, along - depth), found)
    return np.where(found > BURGER.scan.range_max, np.inf, found)


class Watch:
    """A tracker that is fed by a robot on its way, with odometry at 20 Hz."""

    def __init__(
        self,
        discs: list[tuple[Way, float]],
        *,
        own: Twist = ZERO,
        rate: float = 5.0,
        noise: float = 0.0,
        lost: float = 0.0,
        kind: type[Tracker] = Tracker,
    ) -> None:
        self.tracker, self.discs, self.own = kind(BURGER), discs, own
        self.rate, self.noise, self.lost = rate, noise, lost
        self.rng = np.random.default_rng(1)
        self.now, self.scans, self.ticks, self.wall = 0.0, 0, 0, WALL
        self.order = np.arange(len(BEARINGS))  # of the rays in a scan
        self.told: Way | None = None  # of a disc that others tell of
        self.told_rate = 10.0

    def pose(self, at: float | None = None) -> Pose:
        """The pose after driving straight ahead or turning on the spot."""
        now = self.now if at is None else at
        return Pose(self.own.linear * now, 0.0, self.own.angular * now)

    def context(self) -> DecisionContext:
        """That of a decision now, with an odometry that has just arrived."""
        told: tuple[ToldObstacle, ...] = ()
        if self.told is not None:
            at = math.floor(self.now * self.told_rate) / self.told_rate - 0.1
            (x, y), pose = self.told(at), self.pose(at)
            cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
            dx, dy = x - pose.x, y - pose.y
            told = (ToldObstacle(cos * dx + sin * dy, cos * dy - sin * dx, 0.2, self.now - at),)
        return DecisionContext(self.now, 0.0, self.odometry(), 0.0, told=told)

    def odometry(self) -> Odometry:
        """The true motion."""
        return Odometry(self.now, self.pose(), self.own)

    def run(self, seconds: float) -> Surroundings:
        """Go on for some time; what surrounds the robot then."""
        for _ in range(round(seconds * 20.0)):
            self.ticks += 1
            self.now = self.ticks / 20.0
            self.tracker.on_odometry(self.odometry())
            if self.now * self.rate >= self.scans + 1:
                self.scans += 1
                self.scan()
        around: Surroundings = self.tracker.surroundings(self.context())
        return around

    def scan(self) -> None:
        """Show one scan, all rays of which are of this instant."""
        ranges = ranges_at(self.pose(), [(way(self.now), r) for way, r in self.discs], self.wall)
        ranges = ranges + self.noise * self.rng.standard_normal(len(ranges))
        ranges[self.rng.random(len(ranges)) < self.lost] = np.inf
        rays = self.order
        scan = Scan(self.scans, self.now, ranges[rays], BEARINGS[rays], 0.12, 3.5, None, 0.0)
        self.tracker.observe(scan, self.context())


def crossing(t: float) -> Place:
    """A way from the right ahead to the left."""
    return 1.0, -0.5 + 0.2 * t


@pytest.mark.parametrize("rate", [5.0, 10.0])
@pytest.mark.parametrize(
    ("noise", "lost", "tolerance"),
    [(0.0, 0.0, 0.05), (0.01, 0.0, 0.07), (0.02, 0.0, 0.09), (0.01, 0.3, 0.09)],
)
def test_a_crossing_object_is_tracked(
    rate: float, noise: float, lost: float, tolerance: float
) -> None:
    watch = Watch([(crossing, 0.1)], rate=rate, noise=noise, lost=lost)
    watch.run(2.0)
    errors = []
    for _ in range(10):
        (track,) = watch.run(1.0 / 5.0).tracks
        x, y = crossing(watch.now)
        errors.append((math.hypot(track.x - x, track.y - y), track.vx, track.vy - 0.2))
    place, vx, vy = np.sqrt(np.mean(np.square(errors), axis=0))
    assert place < 0.05
    assert math.hypot(vx, vy) < tolerance


@pytest.mark.parametrize("own", [Twist(0.2), Twist(0.0, 0.8)], ids=["drives", "turns"])
def test_own_motion_moves_no_object(own: Twist) -> None:
    found = Watch([(lambda t: (0.9, 0.4), 0.1)], own=own, noise=0.005).run(2.4)
    (track,) = found.tracks
    assert math.hypot(track.vx, track.vy) < 0.06


def test_a_wall_is_no_track() -> None:
    found = Watch([], own=Twist(0.2), noise=0.01).run(3.0)
    assert found.tracks == ()
    assert found.walls[:, 1].min() == pytest.approx(WALL, abs=0.05)


def test_the_part_of_a_wall_between_two_objects_is_no_track() -> None:
    discs: list[tuple[Way, float]] = [
        (lambda t: (0.15 + 0.1 * t, -0.7), 0.1),
        (lambda t: (-0.25 + 0.1 * t, -0.7), 0.1),
    ]
    assert len(Watch(discs, noise=0.005).run(3.0).tracks) == 2


def test_an_object_that_has_gone_is_forgotten_after_two_scans() -> None:
    watch = Watch([(lambda t: (1.0, 0.0) if t < 2.0 else (50.0, 0.0), 0.1)])
    assert len(watch.run(1.9).tracks) == 1
    assert watch.run(0.6).tracks == ()


def test_a_hidden_object_is_remembered_where_it_moves() -> None:
    def screen(t: float) -> Place:
        return (0.5, 0.0) if t > 2.0 else (50.0, 0.0)

    watch = Watch([(lambda t: (1.2, 0.05 * (t - 2.5)), 0.1), (screen, 0.12)])
    watch.run(2.0)
    found = watch.run(1.0).tracks
    assert len(found) == 2
    assert max(track.x for track in found) == pytest.approx(1.2, abs=0.1)


def test_odometry_that_jumps_forgets_all() -> None:
    watch = Watch([(lambda t: (1.0, 0.0), 0.1)])
    assert len(watch.run(2.0).tracks) == 1
    watch.tracker.on_odometry(Odometry(watch.now + 0.05, Pose(5.0), Twist()))
    assert watch.tracker.surroundings(watch.context()).tracks == ()


def test_without_odometry_nothing_is_tracked() -> None:
    tracker, ranges = Tracker(BURGER), ranges_at(Pose(), [((1.0, 0.0), 0.1)])
    context = DecisionContext(1.0, 0.0)
    tracker.observe(Scan(1, 1.0, ranges, BEARINGS, 0.12, 3.5, None, 0.0), context)
    assert tracker.surroundings(context).tracks == ()


def test_two_objects_in_an_open_field_are_two_tracks() -> None:
    discs: list[tuple[Way, float]] = [(lambda t: (0.9, 0.2), 0.1), (lambda t: (0.9, -0.2), 0.1)]
    watch = Watch(discs)
    watch.wall = -100.0
    assert len(watch.run(1.0).tracks) == 2


@pytest.mark.parametrize("told_rate", [2.0, 10.0])
@pytest.mark.parametrize("own", [ZERO, Twist(0.1), Twist(0.0, 0.5)])
def test_an_object_that_is_told_and_not_seen_is_tracked(own: Twist, told_rate: float) -> None:
    watch = Watch([], own=own, rate=10.0)
    watch.told, watch.told_rate = crossing, told_rate
    (track,) = watch.run(3.0).tracks
    pose, (x, y) = watch.pose(), crossing(watch.now)
    dx, dy = x - pose.x, y - pose.y
    cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
    place = cos * dx + sin * dy, cos * dy - sin * dx
    assert (track.x, track.y) == pytest.approx(place, abs=0.04)
    assert math.hypot(track.vx, track.vy) == pytest.approx(0.2, abs=0.04)
    assert track.radius == pytest.approx(0.2)


def test_an_object_that_is_told_and_seen_is_one_track() -> None:
    watch = Watch([(crossing, 0.1)])
    watch.told = lambda t: (1.0, crossing(t)[1] + 0.18)
    (track,) = watch.run(3.0).tracks
    assert track.radius < 0.15


def test_an_object_that_is_told_no_longer_is_forgotten() -> None:
    watch = Watch([])
    watch.told = crossing
    assert len(watch.run(2.0).tracks) == 1
    watch.told = None
    assert watch.run(2.0).tracks == ()


@pytest.mark.parametrize("order", ["rotated", "overlapping", "falling", "mixed"])
def test_the_order_of_the_rays_changes_nothing(order: str) -> None:
    rays = np.arange(len(BEARINGS))
    half = len(rays) // 2
    orders = {
        "rotated": np.roll(rays, 100),
        "overlapping": np.r_[rays[:half], rays[half::2], rays[half + 1 :: 2]],  # a single fall
        "falling": rays[::-1],
        "mixed": np.random.default_rng(2).permutation(rays),
    }
    sorted_rays, watch = Watch([(crossing, 0.1)]), Watch([(crossing, 0.1)])
    watch.order = orders[order]
    expected, seen = sorted_rays.run(2.0), watch.run(2.0)
    assert numbers_of(seen.tracks) == numbers_of(expected.tracks)
    assert seen.walls.tolist() == expected.walls.tolist()
    assert len(seen.tracks) == 1


class FarFromStart(Watch):
    """The same way, begun so far away that each cut of a scan is found by places."""

    def odometry(self) -> Odometry:
        pose = self.pose()
        return Odometry(self.now, Pose(pose.x + 2e5, pose.y, pose.yaw), self.own)


@pytest.mark.parametrize("lost", [0.0, 0.3])
def test_ranges_cut_a_scan_as_places_do(lost: float) -> None:
    discs: list[tuple[Way, float]] = [
        (crossing, 0.1),
        (lambda t: (0.9, 0.4 - 0.1 * t), 0.15),
        (lambda t: (1.2, 0.05 * t), 0.1),
        (lambda t: (-0.7, -0.4), 0.2),
    ]
    made = [
        kind(discs, own=Twist(0.05, 0.8), noise=0.02, lost=lost) for kind in (Watch, FarFromStart)
    ]
    most = 0
    for _ in range(25):
        near, far = (watch.run(0.2) for watch in made)
        assert np.allclose(numbers_of(near.tracks), numbers_of(far.tracks), rtol=0.0, atol=1e-6)
        assert near.walls.shape == far.walls.shape
        assert np.allclose(near.walls, far.walls, rtol=0.0, atol=1e-6)
        most = max(most, len(near.tracks))
    assert most >= 4


@compares_forms
@pytest.mark.parametrize("lost", [0.0, 0.3])
@pytest.mark.parametrize("own", [Twist(0.2), Twist(0.05, 0.8)], ids=["drives", "turns"])
def test_compiled_and_interpreted_code_find_the_same_tracks(own: Twist, lost: float) -> None:
    found = []
    for kernel in both_forms("swarmd.robot.steering.tracks"):
        discs: list[tuple[Way, float]] = [
            (crossing, 0.1),
            (lambda t: (0.6, 0.5 - 0.1 * t), 0.15),
            (lambda t: (1.2, 0.05 * t), 0.1),
            (lambda t: (-0.7, -0.4), 0.2),
        ]
        watch = Watch(discs, own=own, noise=0.01, lost=lost, kind=kernel.Tracker)
        watch.told = lambda t: (-0.9, 0.3 * t - 0.5)
        some = [watch.run(0.1) for _ in range(40)]
        found.append([(numbers_of(each.tracks), each.walls.tolist()) for each in some])
    assert found[0] == found[1]
    assert max(len(tracks) for tracks, _ in found[0]) >= 4
    assert all(walls for _, walls in found[0][3:])


def test_a_place_from_before_the_first_reading_is_where_the_robot_was_then() -> None:
    """By the twist of the first reading, 0.15 s after the place was measured."""
    watch = Watch([], own=Twist(0.5), rate=20.0)
    watch.told, watch.told_rate = (lambda at: (1.5, 0.5)), 2.0
    (track,) = watch.run(0.25).tracks
    assert (track.x, track.y) == pytest.approx((1.5 - 0.5 * 0.25, 0.5), abs=1e-6)
