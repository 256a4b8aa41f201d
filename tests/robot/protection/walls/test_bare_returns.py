"""Walls with a declared `foot`: which returns are bare, and which have the full extent.

A robot stands before a scene, and its lidar measures all rays at once. A return is *at fault* if it
is bare although a body in the scan plane is within `unseen_extent` of it. Each test has a control:
the same scene without the body, in which returns there are bare. The wanted values are those of the
five conditions in docs/walls.md. The clock is an argument.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError
from swarmd.core.values import ZERO, Array, Odometry, Platform, Pose, Scan, Twist
from swarmd.robot.protection.compatibility import body_of, longest_diagonal
from swarmd.robot.protection.decision import DecisionContext, ToldObstacle
from swarmd.robot.protection.footprint import ScanGeometry
from swarmd.settings.platforms import load_platform
from tests.support.filter_sim import under_barrier
from tests.support.kernel_forms import both_forms, interpreted

FORMS = both_forms("swarmd.robot.protection.barrier")
KERNELS = [pytest.param(form, id=name) for form, name in zip(FORMS, ("text", "used"), strict=True)]
USED = FORMS[1]
BARE = 2
WALLS = {"length": 1.0, "seconds": 1.0, "foot": 0.05}
PERIOD = 0.2
SEEN = 8  # scans, of which the last one shows a wall that stands
NAMES = ("turtlebot4", "waffle_pi", "burger")
LOST = (0.0, 0.3, 1.0)


def robot_of(name: str, **changes: Any) -> Platform:
    """A platform whose lidar measures all rays at once, among walls with a foot."""
    platform = load_platform(name)
    at_once = replace(platform, scan=replace(platform.scan, sweep=None))
    return under_barrier(at_once, **{"walls_stand": WALLS, **changes})


ROBOTS = {name: robot_of(name) for name in NAMES}
EXTENT = {name: ROBOTS[name].protection["barrier"]["unseen_extent"] for name in NAMES}


@dataclass(frozen=True)
class Line:
    """A surface from (x, y) to (to_x, to_y) in m; of its rays the share `lost` returns nothing."""

    x: float
    y: float
    to_x: float
    to_y: float
    lost: float = 0.0

    def ranges(self, x: float, y: float, cos: Array, sin: Array) -> Array:
        """(n,) m along each ray; inf: the ray misses the line."""
        dx = self.to_x - self.x
        dy = self.to_y - self.y
        with np.errstate(divide="ignore", invalid="ignore"):
            across = cos * dy - sin * dx
            distance = ((self.x - x) * dy - (self.y - y) * dx) / across
            along = ((self.x - x) * sin - (self.y - y) * cos) / across
        hits = (distance > 0.0) & (along >= 0.0) & (along <= 1.0)
        return np.where(hits, distance, math.inf)

    def distance(self, x: Array, y: Array) -> Array:
        """(n,) m from places to the line."""
        dx = self.to_x - self.x
        dy = self.to_y - self.y
        share = np.clip(((x - self.x) * dx + (y - self.y) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
        return np.hypot(x - self.x - share * dx, y - self.y - share * dy)


@dataclass(frozen=True)
class Round:
    """A round body: the housing of a lidar, a leg or a tank."""

    x: float
    y: float
    radius: float
    lost: float = 0.0

    def ranges(self, x: float, y: float, cos: Array, sin: Array) -> Array:
        """(n,) m along each ray; inf: the ray misses the body."""
        along = (self.x - x) * cos + (self.y - y) * sin
        across = (self.x - x) * sin - (self.y - y) * cos
        square = self.radius**2 - across**2
        distance = along - np.sqrt(np.maximum(square, 0.0))
        return np.where((square > 0.0) & (distance > 0.0), distance, math.inf)

    def distance(self, x: Array, y: Array) -> Array:
        """(n,) m from places to the body."""
        return np.hypot(x - self.x, y - self.y) - self.radius


Body = Line | Round
Scene = Sequence[Body]


class Watcher:
    """A robot at the origin that looks at scenes; a wall at its left side is at y = `wall`."""

    def __init__(
        self, name: str = "turtlebot4", kernel: Any = USED, *, noise: float = 0.0, **changes: Any
    ) -> None:
        self.platform = robot_of(name, **changes) if changes else ROBOTS[name]
        self.barrier = kernel.Barrier(self.platform)
        self.geometry = ScanGeometry(self.platform.scan)
        self.rng = np.random.default_rng(1)
        self.noise = noise
        self.now = 1.0
        self.seq = 0
        self.odometry = Odometry(1.0, Pose(), ZERO)
        self.x = self.y = np.empty(0)

    def see(
        self,
        scene: Scene,
        *,
        pose: Pose | None = None,
        told: Pose | None = None,
        memory: Scene = (),
        filled: Callable[[Array], NDArray[np.bool_]] | None = None,
        too_close: Sequence[int] = (),
    ) -> Watcher:
        """Take in a scan at `pose`, which odometry tells as `told`.

        `memory`: where a lost ray has the range of this scene, as the memory of rays fills it;
        without it a lost ray has no return. `filled`: of the bearings, rays that were not measured.
        `too_close`: rays whose return is too close to measure.
        """
        spec = self.platform.scan
        at = Pose() if pose is None else pose
        x = at.x + spec.offset[0] * math.cos(at.yaw)
        y = at.y + spec.offset[0] * math.sin(at.yaw)
        cos = np.cos(spec.bearings + at.yaw)
        sin = np.sin(spec.bearings + at.yaw)
        ranges, is_lost = self._cast(scene, x, y, cos, sin)
        ranges = ranges + self.noise * self.rng.normal(size=len(ranges))
        is_filled = np.zeros(len(ranges), np.bool_)
        if memory:
            is_filled |= is_lost
            ranges = np.where(is_lost, self._cast(memory, x, y, cos, sin)[0], ranges)
        else:
            ranges = np.where(is_lost, math.inf, ranges)
        if filled is not None:
            is_filled |= filled(spec.bearings)
        ranges = np.where(ranges > spec.range_max, math.inf, ranges)
        ranges = np.where(ranges < spec.range_min, math.inf, ranges)
        ranges[[*too_close]] = -math.inf
        is_return = np.isfinite(ranges)
        self.x = np.where(is_return, x + np.where(is_return, ranges, 0.0) * cos, math.nan)
        self.y = np.where(is_return, y + np.where(is_return, ranges, 0.0) * sin, math.nan)
        self.now += PERIOD
        self.seq += 1
        self.odometry = Odometry(self.now, at if told is None else told, ZERO)
        limits = spec.range_min, spec.range_max
        given = is_filled.astype(np.float64) if is_filled.any() else None
        scan = Scan(self.seq, self.now, ranges, spec.bearings, *limits, None, 0.0, given)
        context = DecisionContext(self.now, 0.0, self.odometry, 0.0)
        self.barrier.observe(scan, self.geometry, context)
        return self

    def _cast(
        self, scene: Scene, x: float, y: float, cos: Array, sin: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        """The ranges of the nearest bodies, and which of these rays are lost."""
        ranges = np.full(len(cos), math.inf)
        is_lost = np.zeros(len(cos), np.bool_)
        for body in scene:
            distance = body.ranges(x, y, cos, sin)
            is_nearer = distance < ranges
            ranges = np.where(is_nearer, distance, ranges)
            lost = self.rng.random(len(cos)) < body.lost
            is_lost = np.where(is_nearer, lost, is_lost)
        return ranges, is_lost

    def watch(self, scene: Scene, scans: int = SEEN, **options: Any) -> Watcher:
        """Look at a scene until its walls stand."""
        for _ in range(scans):
            self.see(scene, **options)
        return self

    @property
    def bare(self) -> NDArray[np.bool_]:
        """(n,) the rays whose return is bare."""
        kinds = np.array(self.barrier.kinds(), np.int64)
        return np.equal(kinds, BARE)

    def at_fault(self, body: Body, within: float | None = None) -> int:
        """The number of bare returns that are too near to a body."""
        reach = EXTENT[self.platform.name] if within is None else within
        bare = self.bare
        return int(np.sum(body.distance(self.x[bare], self.y[bare]) < reach - 0.005))

    def decide(
        self, requested: Twist, told: Iterable[ToldObstacle] = (), age: float = 0.1
    ) -> Twist:
        """The safe command `age` s after the scan."""
        odometry = Odometry(self.now + age, self.odometry.pose, ZERO)
        context = DecisionContext(self.now + age, age, odometry, 0.0, told=tuple(told))
        twist: Twist = self.barrier.decide(requested, context, ZERO, None).twist
        return twist


def side(name: str, gap: float) -> float:
    """y in m of a wall at the left side of a robot, `gap` m from its outline."""
    return float(ROBOTS[name].footprint[:, 1].max()) + gap


def wall(y: float, begin: float = -3.0, end: float = 3.0, lost: float = 0.0) -> Line:
    """A wall along x."""
    return Line(begin, y, end, y, lost)


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_plain_wall_is_bare_beside_the_robot(kernel: Any) -> None:
    seen = Watcher("burger", kernel).watch([wall(side("burger", 0.13))], SEEN)
    near = np.abs(seen.x) < 0.5
    assert seen.bare[near & (seen.y > 0.0)].all()
    assert not seen.bare[np.abs(seen.x) > 0.9].any()  # its returns are 5 cm apart from there on


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("gap", [0.10, 0.20, 0.45])
def test_a_noisy_wall_is_bare_in_most_scans(name: str, gap: float) -> None:
    seen = Watcher(name, noise=0.01).watch([wall(side(name, gap), lost=0.01)], SEEN)
    count = 0
    for _ in range(20):
        seen.see([wall(side(name, gap), lost=0.01)])
        count += int(seen.bare.sum()) > 30
    assert count >= 12


@pytest.mark.parametrize("kernel", KERNELS)
def test_without_a_foot_no_return_is_bare(kernel: Any) -> None:
    walls = {"length": 1.0, "seconds": 1.0}
    seen = Watcher("burger", kernel, walls_stand=walls).watch([wall(side("burger", 0.1))])
    assert max(seen.barrier.kinds()) == 1
    assert max(Watcher("burger", kernel, walls_stand=None).see([]).barrier.kinds()) == 0


@pytest.mark.parametrize("name", NAMES)
def test_a_robot_drives_beside_its_foot_and_not_nearer(name: str) -> None:
    """It may drive along the wall, and towards the wall until margin and foot are left."""
    along = Twist(0.1, 0.0)
    towards = Twist(0.1, 0.0)
    beside = wall(side(name, 0.08))
    near = Watcher(name, walls_stand=WALLS | {"foot": 0.0}).watch([beside])
    plain = Watcher(name, walls_stand={"length": 1.0, "seconds": 1.0}).watch([beside])
    assert near.decide(along).linear == 0.1
    assert plain.decide(along).linear < 0.1
    front = float(ROBOTS[name].footprint[:, 0].max())
    for foot, gap, least, most in (
        (0.05, 0.16, 0.03, 0.1),
        (0.05, 0.078, 0.0, 0.016),
        (0.0, 0.055, 0.02, 0.1),
        (0.06, 0.088, 0.0, 0.016),
    ):
        ahead = Line(front + gap, -3.0, front + gap, 3.0)
        seen = Watcher(name, walls_stand=WALLS | {"foot": foot}).watch([ahead])
        assert seen.bare.any()
        assert least <= seen.decide(towards).linear <= most


def housing(name: str, x: float, gap: float, wall_y: float, lost: float) -> Round:
    """The lidar's housing of a platform, `gap` m before a wall."""
    radius = float(load_platform(name).body["target_radius"])
    return Round(x, wall_y - gap - radius, radius, lost)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("peer", ["turtlebot4", "waffle_pi"])
@pytest.mark.parametrize("lost", LOST)
def test_no_return_beside_a_housing_is_bare(name: str, peer: str, lost: float) -> None:
    """A housing 15 to 95 mm before the wall; a lost ray has no return, or the wall's earlier one.

    The robot is 20 to 30 cm away from the wall, so the wall is bare up to 70 cm to each side.
    """
    y = side(name, 0.2)
    control = Watcher(name).watch([wall(y)])
    would_be = 0
    for gap, memory in ((0.015, ()), (0.055, (wall(y),)), (0.095, ())):
        for x in (-0.5, 0.3, 0.4, 0.55):
            body = housing(peer, x, gap, y, lost)
            would_be += control.at_fault(body)
            assert Watcher(name).watch([wall(y), body], memory=memory).at_fault(body) == 0
        # It came just now, before a wall that has stood.
        late = Watcher(name).watch([wall(y)]).see([wall(y), body], memory=memory)
        assert late.at_fault(body) == 0
    assert would_be > 30


@pytest.mark.parametrize("angle", [5.0, 10.0, 20.0, 30.0])
@pytest.mark.parametrize("end", ["nose", "tail", "flank"])
def test_no_return_beside_a_parked_peer_is_bare(end: str, angle: float) -> None:
    """A TurtleBot 4 that stands at the wall, and is seen along the wall at an angle."""
    faults = 0
    for peer in NAMES:
        platform = load_platform(peer)
        outline = platform.footprint
        offset = platform.scan.offset[0]
        radius = float(platform.body["target_radius"])
        to_lidar = {
            "nose": outline[:, 0].max() - offset,
            "tail": offset - outline[:, 0].min(),
            "flank": outline[:, 1].max(),
        }[end]
        y = side("turtlebot4", 0.2)
        x = (y - to_lidar) / math.tan(math.radians(angle))
        for lost in LOST:
            body = Round(x, y - float(to_lidar), radius, lost)
            faults += Watcher().watch([wall(y), body]).at_fault(body)
    assert faults == 0


@pytest.mark.parametrize(
    ("name", "gap", "pole", "body"),
    [
        ("turtlebot4", 0.221, Round(-0.38, 0.05, 0.094), Round(-0.72, 0.27, 0.036)),
        ("waffle_pi", 0.24, Round(-0.36, 0.07, 0.087), Round(-0.63, 0.27, 0.036)),
        ("burger", 0.30, Round(0.27, 0.19, 0.084), Round(0.32, 0.31, 0.036)),
    ],
)
def test_no_return_beside_the_shadow_of_a_pole_is_bare(
    name: str, gap: float, pole: Round, body: Round
) -> None:
    """A body may stand at the wall in the shadow, farther than `unseen_extent` from the pole."""
    y = side(name, gap)
    plain = Watcher(name).watch([wall(y)])
    seen = Watcher(name).watch([wall(y), pole, body])
    assert plain.at_fault(body) > 5
    assert seen.at_fault(body) == 0
    assert seen.bare.sum() > 10  # the wall on the other side


@pytest.mark.parametrize("yaw", [0.7, -0.7, 2.2])
def test_the_heading_of_the_robot_frees_no_return_in_a_shadow(yaw: float) -> None:
    """The wall is aslant in the frame of the robot; the scene of a Burger is that above."""
    scene: Scene = (wall(side("burger", 0.30)), Round(0.27, 0.19, 0.084))
    body = Round(0.32, 0.31, 0.036)
    plain = Watcher("burger").watch(scene[:1], pose=Pose(0.0, 0.0, yaw))
    seen = Watcher("burger").watch([*scene, body], pose=Pose(0.0, 0.0, yaw))
    assert plain.at_fault(body) > 5
    assert seen.at_fault(body) == 0
    assert seen.bare.sum() > 10  # the wall on the other side


def mirrored(scene: Scene) -> Scene:
    """A scene with left and right exchanged."""
    found: list[Body] = []
    for body in scene:
        if isinstance(body, Round):
            found.append(Round(body.x, -body.y, body.radius, body.lost))
        else:
            found.append(Line(body.to_x, -body.to_y, body.x, -body.y, body.lost))
    return found


@pytest.mark.parametrize("lost", [0.0, 1.0])
@pytest.mark.parametrize(
    ("name", "gap", "pole"),
    [
        ("turtlebot4", 0.221, Round(-0.38, 0.05, 0.094)),
        ("waffle_pi", 0.24, Round(-0.36, 0.07, 0.087)),
        ("burger", 0.30, Round(0.27, 0.19, 0.084)),
    ],
)
def test_a_mirrored_scene_has_the_mirrored_bare_returns(
    name: str, gap: float, pole: Round, lost: float
) -> None:
    """A pole before a wall; seen, or lost to the lidar with all behind it."""
    scene: Scene = (wall(side(name, gap)), Round(pole.x, pole.y, pole.radius, lost))
    left = Watcher(name).watch(scene)
    right = Watcher(name).watch(mirrored(scene))
    count = len(left.bare)
    exchanged = -np.arange(count) % count
    assert left.platform.scan.offset[1] == 0.0
    assert left.bare.sum() > 10
    assert right.bare.tolist() == left.bare[exchanged].tolist()


@pytest.mark.parametrize("count", [2, 5, 10])
@pytest.mark.parametrize("has_background", [False, True])
@pytest.mark.parametrize("peer", ["burger", "turtlebot4", "thymio"])
def test_no_return_of_a_row_of_robots_is_bare(peer: str, count: int, has_background: bool) -> None:
    """A row side by side, flank to flank, broadside and at a grazing angle."""
    platform = load_platform(peer)
    radius = float(platform.body.get("target_radius", 0.055))
    pitch = float(np.ptp(platform.footprint[:, 1]))
    behind = [wall(1.2)] if has_background else []
    for first in (-0.5 * pitch * (count - 1), 0.2, 0.05):
        for gap in (0.001, 0.03):
            row = [Round(first + k * (pitch + gap), 0.3, radius) for k in range(count)]
            seen = Watcher("burger").watch([*row, *behind])
            assert sum(seen.at_fault(body, 0.02) for body in row) == 0


def test_the_control_of_a_row_of_robots_is_bare() -> None:
    assert Watcher("burger").watch([wall(0.3 - 0.055)]).bare.sum() > 60


def boxes(width: float, gap: float, count: int, y: float) -> list[Body]:
    """Faces along x with sides that lead away, beginning 0.1 m before the middle of the row."""
    begin = -0.5 * (count * (width + gap) - gap)
    row: list[Body] = []
    for k in range(count):
        x = begin + k * (width + gap)
        row += [Line(x, y, x + width, y), Line(x, y, x, y + 0.4)]
        row.append(Line(x + width, y, x + width, y + 0.4))
    return row


@pytest.mark.parametrize(
    ("width", "gap", "count"),
    [(0.45, 0.0, 2), (0.7, 0.03, 2), (0.9, 0.05, 2), *((0.12, 0.02 * k, 14) for k in range(1, 6))],
)
@pytest.mark.parametrize("y", [0.2, 0.35, 0.6])
@pytest.mark.parametrize("has_background", [False, True])
def test_boxes_and_legs_in_a_row_are_not_bare(
    width: float, gap: float, count: int, y: float, has_background: bool
) -> None:
    """Two boxes flush that are shorter than `length`, boxes with a gap, legs of 12 cm."""
    behind = [wall(1.2)] if has_background else []
    seen = Watcher("burger").watch([*boxes(width, gap, count, y), *behind])
    assert not seen.bare[np.abs(seen.y - y) < 0.1].any()


@pytest.mark.parametrize("gap", [0.0, 0.01, 0.03, 0.06])
def test_round_legs_in_a_row_are_not_bare(gap: float) -> None:
    legs = [Round((0.12 + gap) * (k - 8), 0.35, 0.06) for k in range(17)]
    assert not Watcher("burger").watch(legs).bare.any()


@pytest.mark.parametrize("radius", [0.3, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0])
@pytest.mark.parametrize("distance", [0.15, 0.25, 0.5])
def test_a_tank_is_not_bare(radius: float, distance: float) -> None:
    for seed in range(4):
        seen = Watcher("burger", noise=0.01)
        seen.rng = np.random.default_rng(seed)
        tank = Round(0.05 * seed, distance + radius, radius)
        for _ in range(SEEN + 4):
            assert not seen.see([tank]).bare.any()


@pytest.mark.parametrize("depth", [0.05, 0.15, 0.4])
@pytest.mark.parametrize("lost", LOST)
def test_no_return_beside_a_recess_with_a_robot_in_it_is_bare(depth: float, lost: float) -> None:
    """A niche of 40 cm whose back is behind the wall; a robot stands in it, its nose flush."""
    y = side("turtlebot4", 0.2)
    for x in (0.1, 0.3):
        niche = [wall(y, -3.0, x), wall(y, x + 0.4, 3.0), wall(y + depth, x, x + 0.4)]
        niche += [Line(x, y, x, y + depth), Line(x + 0.4, y, x + 0.4, y + depth)]
        inside = Round(x + 0.2, y + depth - 0.04, 0.036, lost)
        seen = Watcher().watch([*niche, inside])
        assert seen.bare.any()
        assert not (seen.bare & (seen.y > y + 0.036)).any()
        assert seen.at_fault(inside) == 0
        assert Watcher().watch([wall(y)]).at_fault(inside) > 5 or depth > 0.2


@pytest.mark.parametrize("what", ["glass", "mirror", "black"])
@pytest.mark.parametrize("width", [0.08, 0.2, 0.6])
def test_no_return_beside_a_strip_that_the_lidar_misses_is_bare(what: str, width: float) -> None:
    """Behind glass is a room, in a mirror the room before it, and black returns nothing."""
    y = side("turtlebot4", 0.2)
    behind = {"glass": [wall(y + 1.0)], "mirror": [wall(y + 2.0)], "black": []}[what]
    for x in (-0.5, 0.05, 0.3):
        strip = wall(y, x, x + width)
        seen = Watcher().watch([wall(y, -3.0, x), wall(y, x + width, 3.0), *behind])
        assert seen.at_fault(strip, 0.01) == 0
        if what == "black":
            assert seen.at_fault(wall(y, x + 0.02, x + width - 0.02)) == 0
        assert Watcher().watch([wall(y)]).at_fault(strip) > 5


@pytest.mark.parametrize("angle", [10.0, 20.0, 45.0, 90.0])
def test_no_return_of_a_door_ajar_is_bare(angle: float) -> None:
    """A leaf of 0.8 m in a wall, which opens towards the robot."""
    y = side("turtlebot4", 0.2)
    turn = math.radians(angle)
    for x in (0.15, 0.4):
        leaf = Line(x, y, x + 0.8 * math.cos(turn), y - 0.8 * math.sin(turn))
        seen = Watcher().watch([wall(y, -3.0, x), wall(y, x + 0.8, 3.0), leaf])
        is_of_leaf = leaf.distance(seen.x, seen.y) < 0.01
        is_off = is_of_leaf & (seen.y < y - 0.035)
        assert is_off.any()
        assert not (seen.bare & is_off).any()
        ends = Line(x + 0.041 / math.tan(turn), y - 0.041, leaf.to_x, leaf.to_y)
        assert seen.at_fault(ends) == 0


@pytest.mark.parametrize("length", [0.5, 0.8, 0.95])
def test_a_board_that_is_carried_is_not_bare_after_it_stood(length: float) -> None:
    """A board shorter than `length` stands for 10 s, or comes."""
    seen = Watcher()
    y = side("turtlebot4", 0.2)
    for k in range(50):
        assert not seen.see([wall(y, 0.1 - 0.5 * length, 0.1 + 0.5 * length)]).bare.any()
        assert k < 5 or seen.now > 2.0
    long = Watcher().watch([wall(y, -0.6, 0.6)], 50)
    assert long.bare.any()  # a board as long as a wall: see the known failures
    assert not long.see([wall(y - 0.06, -0.6, 0.6)]).bare.any()


def test_a_surface_that_flickers_at_the_length_is_bare_in_scans_that_show_it() -> None:
    """And the full extent is back at once: the command is that of a robot without a foot."""
    y = side("turtlebot4", 0.15)
    seen = Watcher().watch([wall(y, -0.56, 0.5)])
    plain = Watcher(walls_stand={"length": 1.0, "seconds": 1.0}).watch([wall(y, -0.56, 0.5)])
    request = Twist(0.3, 0.0)
    for k in range(20):
        is_long = k % 2 == 1
        scene = [wall(y, -0.56 if is_long else -0.44, 0.5)]
        assert bool(seen.see(scene).bare.any()) == is_long
        plain.see(scene)
        command = seen.decide(request)
        charged = plain.decide(request)
        assert command == charged or is_long
        assert command.linear >= charged.linear
        assert abs(command.linear) <= 0.3


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_with_slip_no_return_beside_a_housing_is_bare(share: float) -> None:
    y = side("turtlebot4", 0.2)
    seen = Watcher()
    bare = 0
    for k in range(40):
        pose = Pose(0.03 * k, 0.0, 0.0)
        body = Round(1.6, y - 0.05, 0.036, LOST[k % 3])
        seen.see([wall(y), body], pose=pose, told=Pose(share * pose.x, 0.0, 0.0))
        bare += int(seen.bare.sum())
        assert seen.at_fault(body) == 0
    assert bare > 1000


def test_rays_that_the_scan_did_not_measure_are_not_bare() -> None:
    """A mask, a blind or a frozen sector, or lost packets, which an earlier scan fills."""
    y = side("turtlebot4", 0.2)
    control = Watcher().watch([wall(y)])

    def sector(bearings: Array) -> NDArray[np.bool_]:
        return np.abs(bearings - 1.2) < 0.1

    seen = Watcher().watch([wall(y)], filled=sector)
    is_filled = sector(seen.platform.scan.bearings)
    assert control.bare[is_filled].all()
    assert not seen.bare[is_filled].any()
    edge = wall(y, float(seen.x[is_filled].min()), float(seen.x[is_filled].max()))
    assert seen.at_fault(edge) == 0
    assert control.at_fault(edge) > 10


def test_a_single_lost_ray_takes_its_neighbours_alone() -> None:
    y = side("turtlebot4", 0.2)
    lost = 70

    def one(bearings: Array) -> NDArray[np.bool_]:
        return np.equal(np.arange(len(bearings)), lost)

    control = Watcher().watch([wall(y)]).bare
    seen = Watcher().watch([wall(y)], filled=one).bare
    assert np.flatnonzero(control & ~seen).tolist() == [lost - 1, lost, lost + 1]


@pytest.mark.parametrize(("count", "is_bare"), [(4, True), (5, False)])
def test_a_stretch_has_at_most_four_sectors_of_lost_rays(count: int, is_bare: bool) -> None:
    """A row of legs has more gaps. The wall is so short that no stretch is left beside them."""
    y = side("turtlebot4", 0.2)

    def some(bearings: Array) -> NDArray[np.bool_]:
        return np.isin(np.arange(len(bearings)), 70 + 8 * np.arange(count))

    seen = Watcher().watch([wall(y, -0.6, 0.55)], filled=some)
    assert bool(seen.bare.any()) == is_bare


@pytest.mark.parametrize(("radius", "is_bare"), [(8.0, False), (15.0, True)])
def test_a_wall_that_bends_is_bare_from_a_radius_of_ten_metres_on(
    radius: float, is_bare: bool
) -> None:
    seen = Watcher("burger").watch([Round(0.0, 0.25 + radius, radius)])
    assert bool(seen.bare.any()) == is_bare


class Remembered:
    """The blind zone with one hidden obstacle, `nearest` m from the lidar."""

    def __init__(self, bearing: float, nearest: float) -> None:
        self.bearings = np.array([bearing])
        self.nearest = np.array([nearest])

    def update(self, *_: Any) -> None:
        """The memory stays as it is."""


def test_the_memory_of_the_blind_zone_takes_the_returns_near_it() -> None:
    """The memory alone: all rays show the wall."""
    y = side("burger", 0.06)
    seen = Watcher("burger", FORMS[0]).watch([wall(y)])
    place = Round(-0.032 + 0.11 * math.cos(1.2), 0.11 * math.sin(1.2), 0.001)
    assert seen.at_fault(place) > 3
    seen.barrier._hidden = Remembered(1.2, 0.11)
    assert seen.see([wall(y)]).at_fault(place) == 0


def test_a_told_place_gives_the_returns_near_it_their_extent() -> None:
    y = side("turtlebot4", 0.15)
    seen = Watcher().watch([wall(y)])
    request = Twist(0.1, 0.0)
    far = ToldObstacle(-3.0, 0.0, 0.2, 0.1)
    assert seen.decide(request, [far]) == seen.decide(request)
    # Behind the wall, where the disc itself limits a robot that drives along the wall hardly.
    beside = ToldObstacle(0.3, y + 0.45, 0.3, 0.1)
    plain = Watcher(walls_stand={"length": 1.0, "seconds": 1.0}).watch([wall(y)])
    assert seen.decide(request, [beside]).linear == plain.decide(request, [beside]).linear
    assert seen.decide(request, [beside]).linear < seen.decide(request).linear


def test_an_obstacle_in_the_blind_zone_takes_the_returns_near_it() -> None:
    """A leg that was seen between robot and wall comes nearer than the lidar measures."""
    y = side("burger", 0.13)
    seen = Watcher("burger").watch([wall(y)])
    assert seen.bare.sum() > 60
    for k in range(6):
        seen.see([wall(y), Round(-0.032, 0.16 - 0.005 * k, 0.02)])
    assert len(seen.barrier.kinds()) == 360
    leg = Round(-0.032, 0.135, 0.02)
    assert seen.at_fault(leg) == 0


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_return_too_close_to_measure_may_be_as_far_as_the_outline(kernel: Any) -> None:
    """The outline is 17 cm from the lidar, beyond `range_min` of 15 cm; the wall is 40 cm away.

    So the wall is 23 cm from the end of this part of the ray, and `unseen_extent` is 24 cm.
    """
    seen = Watcher("turtlebot4", kernel).watch([wall(0.4)])
    at_outline = Round(-0.04 + 0.17 * math.cos(math.radians(97.0)), 0.17, 0.001)
    assert seen.at_fault(at_outline) > 5
    assert seen.see([wall(0.4)], too_close=[97]).at_fault(at_outline) == 0
    assert seen.bare.sum() > 10  # the wall on the other side


@pytest.mark.parametrize(
    ("peers", "is_bare"),
    [
        ([], True),
        (["burger", "jackal", "rosbot_xl"], True),
        (["burger", None], False),
        (["long"], False),
    ],
)
def test_the_platforms_that_are_heard_must_be_shorter_than_the_wall(
    peers: list[str | None], is_bare: bool
) -> None:
    """The wall is 1.2 m long; a peer that tells nothing of its body may be of any size."""
    burger = load_platform("burger")
    names = {"long": replace(burger, footprint=5.0 * burger.footprint)}
    bodies = [
        None if peer is None else body_of(names.get(peer) or load_platform(peer)) for peer in peers
    ]
    y = side("burger", 0.1)
    seen = Watcher("burger")
    seen.barrier.hear(longest_diagonal(bodies))
    assert bool(seen.watch([wall(y, -0.6, 0.6)]).bare.any()) == is_bare


@pytest.mark.parametrize(
    ("bad", "key"),
    [
        ("{length: 1.0, foot: -0.01}", "foot"),
        ("{length: 1.0, foot: 1.5}", "foot"),
        ("{length: 1.0, foot: .nan}", "foot"),
        ("{length: 1.0, foot: .inf}", "foot"),
        ("{length: 1.0, foot: low}", "foot"),
        ("{length: 1.0, foot: [0.05]}", "foot"),
        ("{length: 1.0, foot: 0.07}", "foot"),  # beyond the unseen_extent of a Burger
        ("{length: 0.9, foot: 0.05}", "length"),
        ("{foot: 0.05}", "length"),
    ],
)
def test_hostile_values_are_refused_in_a_line(bad: str, key: str, tmp_path: Any) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(f"extends: burger\nprotection: {{barrier: {{walls_stand: {bad}}}}}\n")
    with pytest.raises(ConfigError, match=rf"walls_stand\.{key}") as caught:
        load_platform(str(file))
    assert str(caught.value).count("\n") <= 1


def test_a_lidar_of_wide_beams_takes_no_foot(tmp_path: Any) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(
        "extends: crazyflie\nprotection: {barrier: {walls_stand: {length: 1.0, foot: 0.05}}}\n"
    )
    with pytest.raises(ConfigError, match=r"walls_stand\.foot"):
        load_platform(str(file))


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
@pytest.mark.parametrize("direction", [1.0, -1.0], ids=["along", "back"])
def test_a_ray_rises_from_a_line_on_the_side_of_the_lidar(side: float, direction: float) -> None:
    """A ray at 30 degrees to a line along x leads away on the side of the lidar alone."""
    module = interpreted(
        "swarmd.robot.protection.walls.bare_returns", because="it calls C's methods"
    )
    runs = interpreted("swarmd.robot.protection.walls.straight_runs", because="it makes its types")
    scan = runs.StraightRuns(ROBOTS["burger"], 1.0)
    scan.lidar_x, scan.lidar_y = 0.0, side
    run = runs.Run()
    run.x, run.y, run.ux, run.uy = 0.0, 0.0, direction, 0.0
    bare = module.BareReturns(ROBOTS["burger"], 1.0, EXTENT["burger"])
    cos = math.cos(math.radians(30.0))
    assert bare._rise(run, scan, cos, 0.5 * side) == pytest.approx(0.5)
    assert bare._rise(run, scan, cos, -0.5 * side) == pytest.approx(-0.5)
