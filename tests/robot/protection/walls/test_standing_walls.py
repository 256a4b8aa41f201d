"""Walls that stand: what is charged no speed of others, and what is charged as before.

A Burger stands or drives in the odometry frame among segments, and its lidar measures all rays at
once. The clock is an argument. Each case runs compiled and interpreted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import ZERO, Array, Odometry, Pose, Scan, Twist
from swarmd.robot.protection.decision import DecisionContext, MovedWall
from swarmd.robot.protection.footprint import ScanGeometry
from swarmd.robot.protection.walls.walls_settings import WallsStand
from swarmd.settings.platforms import load_platform
from tests.support.filter_sim import under_barrier
from tests.support.kernel_forms import both_forms, interpreted
from tests.support.protection import Protection

FORMS = both_forms("swarmd.robot.protection.barrier")
KERNELS = [pytest.param(form, id=name) for form, name in zip(FORMS, ("text", "used"), strict=True)]
WALLS = {"length": 0.5, "seconds": 2.0}
BURGER = under_barrier(
    replace(load_platform("burger"), scan=replace(load_platform("burger").scan, sweep=None)),
    unseen_extent=0.0,
    walls_stand=WALLS,
)
PERIOD = 0.2  # s between two scans
AGE = 0.3  # s of the scan at the decision: others may have come 9 cm nearer
FAST = 0.15  # m/s towards the wall ahead that only a wall that stands permits
HERE, TOP = Pose(), Twist(0.22)
Segment = tuple[float, float, float, float]
AHEAD: Segment = (0.2, -1.0, 0.2, 1.0)
"""A wall 16 cm before the front of the robot."""
BESIDE: Segment = (-1.0, 0.6, 0.2, 0.6)
Scene = Callable[[float], Sequence[Segment]]


def ranges_at(pose: Pose, segments: Sequence[Segment], noise: Array | float = 0.0) -> Array:
    """(n,) m from the lidar to the nearest of the segments along each ray; inf: nothing."""
    spec = BURGER.scan
    x = pose.x + spec.offset[0] * math.cos(pose.yaw)
    y = pose.y + spec.offset[0] * math.sin(pose.yaw)
    cos, sin = np.cos(spec.bearings + pose.yaw), np.sin(spec.bearings + pose.yaw)
    ranges = np.full(len(spec.bearings), math.inf)
    for x1, y1, x2, y2 in segments:
        dx, dy = x2 - x1, y2 - y1
        with np.errstate(divide="ignore", invalid="ignore"):
            across = cos * dy - sin * dx
            distance = ((x1 - x) * dy - (y1 - y) * dx) / across
            along = ((x1 - x) * sin - (y1 - y) * cos) / across
        is_hit = (distance > 0.0) & (along >= 0.0) & (along <= 1.0)
        ranges = np.where(is_hit & (distance < ranges), distance, ranges)
    ranges = ranges + noise
    return np.where(ranges < spec.range_max, ranges, math.inf)


class Robot:
    """A Burger under mode `barrier` whose walls stand."""

    def __init__(self, kernel: Any, **changes: Any) -> None:
        self.barrier = kernel.Barrier(under_barrier(BURGER, **changes))
        self.geometry = ScanGeometry(BURGER.scan)
        self.odometry = Odometry(0.0, Pose(), ZERO)
        self.now = 0.0
        self.moved: list[MovedWall] = []

    def see(
        self,
        now: float,
        segments: Sequence[Segment],
        pose: Pose = HERE,
        told: Pose | None = None,
        noise: Array | float = 0.0,
        ages: Array | None = None,
        late: float = 0.0,
        odometry_age: float = 0.0,
    ) -> None:
        """Take in a scan at `pose`, which odometry tells as `told`, `late` s after it arrived."""
        odometry = Odometry(now - odometry_age, pose if told is None else told, ZERO)
        self.now, self.odometry = now, odometry
        ranges = ranges_at(pose, segments, noise)
        spec = BURGER.scan
        scan = Scan(round(now / PERIOD), now, ranges, spec.bearings, 0.12, 3.5, ages, 0.0)
        self.barrier.observe(scan, self.geometry, DecisionContext(now, late, self.odometry, 0.0))
        if self.barrier.moved_wall is not None:
            self.moved.append(self.barrier.moved_wall)

    def allowed(self, requested: Twist, age: float = AGE) -> Twist:
        """The safe command `age` s after the scan."""
        odometry = replace_stamp(self.odometry, self.now + age)
        context = DecisionContext(self.now + age, age, odometry, 0.0)
        twist: Twist = self.barrier.decide(requested, context, ZERO, None).twist
        return twist

    def speed(self, age: float = AGE) -> float:
        """The speed ahead in m/s that the robot may drive `age` s after the scan."""
        return float(self.allowed(TOP, age).linear)


def replace_stamp(odometry: Odometry, stamp: float) -> Odometry:
    return Odometry(stamp, odometry.pose, odometry.twist)


def watch(kernel: Any, scene: Scene, seconds: float = 3.0, **changes: Any) -> Robot:
    """A robot that has stood before a scene for some time."""
    robot = Robot(kernel, **changes)
    for k in range(round(seconds / PERIOD) + 1):
        robot.see(1.0 + PERIOD * k, scene(PERIOD * k))
    return robot


def still(*segments: Segment) -> Scene:
    return lambda _: segments


def arc(radius: float) -> list[Segment]:
    """A wall ahead that bends away, 16 cm before the front."""
    angles = np.linspace(-1.2, 1.2, 60)
    x, y = 0.2 + radius * (1.0 - np.cos(angles)), radius * np.sin(angles)
    return list(zip(x[:-1], y[:-1], x[1:], y[1:], strict=True))


def row(gap: float) -> list[Segment]:
    """Eight boxes of a Burger's length side by side ahead, `gap` m between them."""
    boxes: list[Segment] = []
    for k in range(-4, 4):
        a = k * (0.14 + gap) + 0.5 * gap
        boxes += [(0.2, a, 0.2, a + 0.14), (0.2, a, 0.38, a), (0.2, a + 0.14, 0.38, a + 0.14)]
    return boxes


def staggered(depth: float) -> list[Segment]:
    """Twelve faces of 12 cm side by side ahead, every second `depth` m farther back."""
    lines: list[Segment] = []
    for k in range(-6, 6):
        x = 0.2 + depth * (k % 2)
        lines += [(x, 0.12 * k, x, 0.12 * (k + 1)), (0.2, 0.12 * k, 0.2 + depth, 0.12 * k)]
    return lines


def bend(angle: float) -> list[Segment]:
    """Two faces of 30 cm ahead that meet at an angle."""
    x, y = 0.2 + 0.3 * math.sin(0.5 * angle), 0.3 * math.cos(0.5 * angle)
    return [(0.2, 0.0, x, y), (0.2, 0.0, x, -y)]


def after(seconds: float, before: Sequence[Segment], then: Sequence[Segment]) -> Scene:
    return lambda t: before if t < seconds - 1e-6 else then


def moved(x: float) -> Segment:
    return (0.2 + x, -1.0, 0.2 + x, 1.0)


def at_times(*parts: tuple[float, Sequence[Segment]]) -> Scene:
    """What is there from each time in s on."""
    return lambda t: [scene for since, scene in parts if t >= since - 1e-6][-1]


HIDING: Segment = (0.1, -0.1, 0.1, 0.1)
SHORT: Segment = (0.2, -0.22, 0.2, 0.22)
GRAZED: Segment = (0.2, 0.03, 1.4, 0.03)
"""A wall that begins ahead. Its returns lie more than 12 cm apart from 0.45 m on."""
ASLANT: Segment = (0.0, -0.2, 0.7, 0.15)
"""A wall of 0.78 m, 0.45 m of it to the right of the first ray, with most returns at its begin."""
BEYOND: Segment = (0.19, 1.0, 0.23, 1.0)
"""A body whose returns are on the line of a wall ahead, 0.7 m to the left of its end."""


def piece(radius: float) -> list[Segment]:
    """The middle 0.5 to 0.6 m of a wall ahead that bends away."""
    return [one for one in arc(radius) if max(abs(one[1]), abs(one[3])) < 0.32]


STANDS: dict[str, tuple[Scene, float]] = {
    "it has stood for the time": (still(AHEAD), 2.0),
    "as long as it must be": (still((0.2, -0.26, 0.2, 0.26)), 3.0),
    "it stands again after a time": (after(1.0, [moved(0.1)], [AHEAD]), 3.0),
    "it is 15 mm farther": (after(3.0, [AHEAD], [moved(0.015)]), 3.0),
    "beside another wall": (still(AHEAD, BESIDE), 3.0),
    "it meets another wall to its right at 30 deg": (
        still((0.2, -0.1, 0.2, 0.9), (0.2, -0.1, 0.5, -0.62)),
        3.0,
    ),
    "it meets another wall to its left at 30 deg": (
        still((0.2, 0.1, 0.2, -0.9), (0.2, 0.1, 0.5, 0.62)),
        3.0,
    ),
    "it bends with a radius of 2.5 m": (still(*arc(2.5)), 3.0),
    "its end, where a ray happens to meet it": (
        after(3.0, [(0.2, -1.0, 0.2, 0.03)], [(0.2, -1.0, 0.2, 0.07)]),
        3.0,
    ),
    "scans that do not follow each other did not show it": (
        at_times((0.0, [AHEAD]), (1.0, [SHORT]), (1.2, [AHEAD]), (2.6, [SHORT]), (2.8, [AHEAD])),
        3.0,
    ),
    "it has a bulge of 25 mm": (still(AHEAD, (0.175, -0.03, 0.175, 0.03)), 3.0),
    "it leads aslant across the first ray": (still(ASLANT), 3.0),
    "a piece bends with a radius of 2.5 m, a body is on its line": (
        still(*piece(2.5), BEYOND),
        3.0,
    ),
    "one scan did not show it": (at_times((0.0, [AHEAD]), (2.6, [SHORT]), (2.8, [AHEAD])), 3.0),
}
CHARGED: dict[str, tuple[Scene, float]] = {
    "it has not stood for the time": (still(AHEAD), 1.8),
    "its part has stood for 1.8 s": (
        at_times((0.0, [(0.2, -1.0, 0.2, -0.06)]), (0.2, [AHEAD])),
        2.0,
    ),
    "it is shorter": (still(SHORT), 3.0),
    "it is curved": (still(*arc(0.35)), 3.0),
    "it is a tank of 1 m radius": (still(*arc(1.0)), 3.0),
    "it bends with a radius of 1.4 m": (still(*arc(1.4)), 3.0),
    "a piece bends with a radius of 1.4 m, a body is on its line": (
        still(*piece(1.4), BEYOND),
        3.0,
    ),
    "most of it is seen at a grazing angle": (still(GRAZED), 3.0),
    "its end has become longer than by a bin": (
        after(3.0, [(0.2, -1.0, 0.2, -0.06)], [(0.2, -1.0, 0.2, 0.08)]),
        3.0,
    ),
    "two scans did not show it": (
        at_times((0.0, [AHEAD]), (2.4, [SHORT]), (2.8, [AHEAD])),
        3.0,
    ),
    "one scan showed it elsewhere": (
        at_times((0.0, [AHEAD]), (2.6, [moved(0.06)]), (2.8, [AHEAD])),
        3.0,
    ),
    "it has a bulge of 45 mm": (still(AHEAD, (0.155, -0.03, 0.155, 0.03)), 3.0),
    "rays pass through a gap of 15 mm": (
        still((0.2, -0.3, 0.2, -0.0075), (0.2, 0.0075, 0.2, 0.3), (0.5, -1.0, 0.5, 1.0)),
        3.0,
    ),
    "a row of bodies": (still(*row(0.05)), 3.0),
    "it appears": (after(3.0, [BESIDE], [AHEAD, BESIDE]), 3.0),
    "it is nearer than expected": (after(3.0, [moved(0.06)], [AHEAD]), 3.0),
    "it is farther than expected": (after(3.0, [moved(-0.03)], [AHEAD]), 3.0),
    "it was hidden": (
        lambda t: [AHEAD, HIDING] if 2.1 < t < 2.3 else [AHEAD],
        3.0,
    ),
    "it has moved before": (after(2.0, [moved(0.04)], [AHEAD]), 3.0),
    "it moves slowly": (lambda t: [moved(0.02 * (4.0 - t))], 4.0),
    "it has become shorter": (after(3.0, [AHEAD], [SHORT]), 3.0),
    "it has become curved": (after(3.0, [AHEAD], arc(1.0)), 3.0),
    "it is hidden": (after(3.0, [AHEAD], [AHEAD, HIDING]), 3.0),
    "it turns about its right end": (
        after(3.0, [(0.2, -0.6, 0.2, 0.6)], [(0.2, -0.6, 0.26, 0.6)]),
        3.0,
    ),
    "it turns about its left end": (
        after(3.0, [(0.2, -0.6, 0.2, 0.6)], [(0.26, -0.6, 0.2, 0.6)]),
        3.0,
    ),
    "it turns": (after(3.0, [AHEAD], [(0.2, -1.0, 0.2, 0.0), (0.2, 0.0, 0.35, 1.0)]), 3.0),
}


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("name", STANDS)
def test_a_wall_that_has_stood_is_charged_no_speed(kernel: Any, name: str) -> None:
    robot = watch(kernel, *STANDS[name])
    assert robot.speed() > FAST


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("name", CHARGED)
def test_all_else_is_charged_as_before(kernel: Any, name: str) -> None:
    scene, seconds = CHARGED[name]
    robot = watch(kernel, scene, seconds)
    assert robot.speed() == watch(kernel, scene, seconds, walls_stand=None).speed() < FAST


@pytest.mark.parametrize("surface", [arc(0.25), arc(0.35), bend(0.7), bend(1.05), staggered(0.06)])
def test_no_part_of_a_curved_or_rough_surface_stands(surface: list[Segment]) -> None:
    robot = watch(FORMS[0], still(*surface))
    assert not any(robot.barrier._walls.kinds)


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_wall_that_stands_keeps_its_margin(kernel: Any) -> None:
    """3 cm for ranges, and 2.5 cm/s for the age of the scan; 3 cm more within which it is slow."""

    def speed(gap: float) -> float:
        return watch(kernel, still((0.038 + gap, -1.0, 0.038 + gap, 1.0))).speed()

    assert 0.0 <= speed(0.0385) <= 0.016
    assert speed(0.045) == pytest.approx(0.05) == speed(0.065)
    assert speed(0.09) > 0.1


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(
    ("scene", "least", "most"),
    [([AHEAD, BESIDE], 8, 10), (arc(1.0), 0, 0)],
    ids=["a wall", "a tank of 1 m radius"],
)
def test_noise_of_ranges_does_not_change_the_status(
    kernel: Any, scene: Sequence[Segment], least: int, most: int
) -> None:
    """Before how many of ten robots the surface stands after 3 s."""
    fast = 0
    for seed in range(10):
        rng, robot = np.random.default_rng(seed), Robot(kernel)
        for k in range(16):
            robot.see(1.0 + PERIOD * k, scene, noise=rng.normal(0.0, 0.01, 360))
        fast += robot.speed() > FAST
    assert least <= fast <= most


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_wall_stands_while_the_robot_drives_and_turns(kernel: Any) -> None:
    robot = Robot(kernel)
    for k in range(20):
        pose = Pose(-0.4 + 0.02 * k, 0.0, 0.3 * math.sin(0.3 * k))
        robot.see(1.0 + PERIOD * k, [AHEAD, BESIDE], pose)
    robot.see(5.0, [AHEAD, BESIDE], Pose(0.0, 0.0, 0.0))
    assert robot.speed() > FAST


def test_a_long_wall_stands_beside_a_robot_that_drives() -> None:
    robot = Robot(FORMS[0])
    beside = np.abs(BURGER.scan.bearings - 0.5 * math.pi) < 0.2
    for k in range(36):
        robot.see(1.0 + PERIOD * k, [(-2.0, 0.3, 9.0, 0.3)], Pose(0.1 * k))
        stands = np.all(np.array(robot.barrier._walls.kinds)[beside] == 1)
        assert stands == (k >= 10)


def test_a_wall_stands_between_its_returns() -> None:
    """The returns lie 9 to 10 cm apart, and at other places in each second scan."""
    robot = Robot(FORMS[0])
    for k in range(20):
        pose = Pose(0.0, 0.0, math.radians(0.5) * (k % 2))
        robot.see(1.0 + PERIOD * k, [(-0.5, 0.3, 1.45, 0.3)], pose)
    bearings = BURGER.scan.bearings
    far = (bearings > math.radians(12.7)) & (bearings < math.radians(14.3))
    assert np.all(np.array(robot.barrier._walls.kinds)[far] == 1)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(
    ("told", "periods"),
    [(Pose(0.05), 1), (Pose(0.0, 0.0, 0.15), 1), (Pose(9.0), 1), (Pose(), 2)],
    ids=["way", "turn", "jump", "lost turn"],
)
def test_wrong_odometry_or_a_lost_scan_takes_the_status(
    kernel: Any, told: Pose, periods: int
) -> None:
    robot = watch(kernel, still(AHEAD, BESIDE))
    assert robot.speed() > FAST
    robot.see(robot.now + periods * PERIOD, [AHEAD], told=told)
    assert robot.speed() < FAST


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(("age", "stands"), [(0.5 * PERIOD, True), (1.5 * PERIOD, False)])
def test_a_reset_of_odometry_takes_the_status(kernel: Any, age: float, stands: bool) -> None:
    """The clock of odometry goes back to before the last reading, while the pose fits the scan."""
    robot = watch(kernel, still(AHEAD, BESIDE))
    robot.see(robot.now + PERIOD, [AHEAD, BESIDE], odometry_age=age)
    assert (robot.speed() > FAST) == stands


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("step", [(0.06, 0.0), (0.0, 0.06)], ids=["way", "turn"])
@pytest.mark.parametrize(("scale", "stands"), [(1.06, True), (1.11, False), (0.84, False)])
def test_odometry_of_a_wrong_scale_takes_the_status(
    kernel: Any, step: tuple[float, float], scale: float, stands: bool
) -> None:
    """The wall is 0.6 m or 0.6 rad nearer each 2 s. Odometry may err by 2 cm and 5 % of that."""
    robot = Robot(kernel)
    for k in range(-20, 1):
        x, yaw = step[0] * k, step[1] * k
        told = Pose(scale * x, 0.0, scale * yaw)
        robot.see(1.0 + PERIOD * (k + 20), [AHEAD], Pose(x, 0.0, yaw), told=told)
    assert (robot.speed() > FAST) == stands


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(
    ("gap", "stands"),
    [(0.0, True), (0.025, True), (0.06, False)],
    ids=["post", "post near the end", "body"],
)
def test_the_edge_of_a_wall_belongs_to_it(kernel: Any, gap: float, stands: bool) -> None:
    """A face that meets the end of the wall stands with it; what lies before the end does not."""
    wall: Segment = (0.2 + gap, -0.11, 1.2, -0.11)
    face: Segment = (0.2, -0.11, 0.2, -0.2)
    robot = watch(kernel, still(wall, face), 4.0)
    assert (robot.speed() > FAST) == stands


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_body_that_stands_at_a_wall_does_not_belong_to_it(kernel: Any) -> None:
    """The side of the body meets the wall within 4 cm, as a post does, but is before the wall."""
    wall: Segment = (-1.0, -0.2, 0.22, -0.2)
    robot = watch(kernel, still(wall, (0.2, -0.18, 0.2, 0.05)), 4.0)
    assert robot.speed() < FAST


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(("age", "stands"), [(0.25, True), (0.35, False)])
def test_rays_of_an_earlier_turn_do_not_confirm(kernel: Any, age: float, stands: bool) -> None:
    robot = watch(kernel, still(AHEAD))
    robot.see(robot.now + PERIOD, [AHEAD], ages=np.full(360, age))
    assert (robot.speed(0.0) > FAST) == stands


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("side_reserve", [0.0, 0.1])
def test_a_robot_slides_along_a_wall_that_stands(kernel: Any, side_reserve: float) -> None:
    """No constraint holds before it that is for obstacles which move towards a corner."""
    beside = still((-1.0, 0.089 + 0.05, 1.0, 0.089 + 0.05))
    assert watch(kernel, beside, side_reserve=side_reserve).speed() > 0.1
    charged = watch(kernel, beside, walls_stand=None, side_reserve=side_reserve)
    assert charged.speed() < 0.02


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_robot_leaves_a_wall_that_stands_at_its_own_speed(kernel: Any) -> None:
    """The robot is no more in contact with what may be in its blind zone than elsewhere.

    3.2 cm ahead, and 3.5 cm behind, part of the wall is too near to be seen.
    """
    ahead, behind = 0.038 + 0.032, -0.102 - 0.035
    for x, request in ((ahead, Twist(-0.1, 0.5)), (behind, Twist(0.1))):
        wall: Segment = (x, -1.0, x, 1.0)
        lost = np.where(ranges_at(HERE, [wall]) < BURGER.scan.range_min, math.inf, 0.0)
        robot, charged = Robot(kernel), Robot(kernel, walls_stand=None)
        for k in range(16):
            robot.see(1.0 + PERIOD * k, [wall], noise=lost)
            charged.see(1.0 + PERIOD * k, [wall], noise=lost)
        allowed = robot.allowed(request)
        assert allowed.linear == pytest.approx(request.linear)
        assert allowed.angular >= 0.4 * request.angular
        assert abs(charged.allowed(request).linear) < 0.02


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_body_before_a_wall_that_stands_is_charged(kernel: Any) -> None:
    robot = watch(kernel, still((0.6, -1.0, 0.6, 1.0), (0.2, -0.1, 0.2, 0.1)))
    assert robot.speed() < FAST


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("beside", [[BESIDE], []], ids=["another wall stands", "at rest"])
@pytest.mark.parametrize("end", [moved(0.4), (0.6, -0.6, 0.4, 0.6)], ids=["way", "turn"])
def test_a_wall_that_moves_away_is_told_once(
    kernel: Any, beside: list[Segment], end: Segment
) -> None:
    begin: Segment = (0.4, -0.6, 0.4, 0.6)  # 20 cm from the end, or from its farther end
    robot = watch(kernel, after(3.0, [begin, *beside], [end, *beside]), 4.0)
    (moved_wall,) = robot.moved
    assert moved_wall.distance == pytest.approx(0.2, abs=0.01)
    assert moved_wall.speed == pytest.approx(0.5, abs=0.03)
    assert moved_wall.stood == pytest.approx(2.8, abs=0.01)


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_scan_that_is_not_newer_tells_no_wall_again(kernel: Any) -> None:
    robot = watch(kernel, after(3.0, [moved(0.3)], [moved(0.5)]), 3.2)
    assert len(robot.moved) == 1
    robot.see(robot.now, [moved(0.5)], late=0.1)
    assert len(robot.moved) == 1


FAR_ONE: Segment = (0.6, -1.0, 0.6, 1.0)
PARTITION: Segment = (0.42, -0.9, 1.4, -0.9)
TOLD: dict[str, tuple[Scene, int]] = {
    "9 cm farther": (after(3.0, [FAR_ONE, BESIDE], [moved(0.49), BESIDE]), 0),
    "12 cm farther": (after(3.0, [FAR_ONE, BESIDE], [moved(0.52), BESIDE]), 1),
    "elsewhere in one scan": (
        at_times((0.0, [FAR_ONE, BESIDE]), (3.0, [moved(0.6), BESIDE]), (3.2, [FAR_ONE, BESIDE])),
        0,
    ),
    "it stood for 1.8 s": (after(2.0, [FAR_ONE, BESIDE], [moved(0.6), BESIDE]), 0),
    "it stood for 2 s": (after(2.2, [FAR_ONE, BESIDE], [moved(0.6), BESIDE]), 1),
    "it moves at 1.2 m/s or faster": (after(3.0, [FAR_ONE, BESIDE], [moved(0.9), BESIDE]), 0),
    "it moves by 18 cm": (after(3.0, [FAR_ONE, BESIDE], [moved(0.58), BESIDE]), 1),
    "it turns about its right end": (
        after(3.0, [(0.6, -0.6, 0.6, 0.6), BESIDE], [(0.6, -0.6, 0.8, 0.6), BESIDE]),
        1,
    ),
    "it turns about its left end": (
        after(3.0, [(0.6, -0.6, 0.6, 0.6), BESIDE], [(0.8, -0.6, 0.6, 0.6), BESIDE]),
        1,
    ),
    "it turns about its middle, its right end comes nearer": (
        after(3.0, [(0.6, -0.9, 0.6, 0.9), BESIDE], [(0.4, -0.9, 0.8, 0.9), BESIDE]),
        1,
    ),
    "it hides its old place": (after(3.0, [FAR_ONE, BESIDE], [moved(0.2), BESIDE]), 0),
    "a wall of 0.6 m": (
        after(3.0, [(0.6, -0.3, 0.6, 0.3), BESIDE], [(0.8, -0.4, 0.8, 0.4), BESIDE]),
        1,
    ),
    "a wall behind it, which was seen beside it before": (
        after(
            3.0,
            [(0.7, -0.3, 0.7, 0.3), (0.9, -1.4, 0.9, 1.4)],
            [(0.9, -1.4, 0.9, 1.4)],
        ),
        0,
    ),
    "a wall behind it, seen beside a part that is gone": (
        after(3.0, [FAR_ONE, BESIDE], [(0.6, -1.0, 0.6, 0.4), (0.8, -1.0, 0.8, 1.0), BESIDE]),
        0,
    ),
    "it is hidden, and the next partition comes into view": (
        after(3.0, [PARTITION, BESIDE], [(0.42, -0.6, 1.4, -0.6), BESIDE]),
        0,
    ),
    "a body of 0.3 m before a part of it": (
        after(3.0, [FAR_ONE, BESIDE], [FAR_ONE, BESIDE, (0.5, -0.15, 0.5, 0.15)]),
        0,
    ),
}
"""Scenes in which walls move, and how many of them are told."""


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("name", TOLD)
def test_which_walls_are_told_to_have_moved(kernel: Any, name: str) -> None:
    scene, count = TOLD[name]
    assert len(watch(kernel, scene, 5.0).moved) == count


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_wall_that_moves_away_is_told_while_the_robot_drives(kernel: Any) -> None:
    robot = Robot(kernel)
    for k in range(30):
        wall = moved(0.3 if k < 20 else 0.5)
        robot.see(1.0 + PERIOD * k, [wall, BESIDE], Pose(-0.01 * k))
    assert len(robot.moved) == 1


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(
    ("step", "off"),
    [(-0.02, Pose(-0.1, -0.1)), (0.0, Pose(0.0, 0.0, -0.1))],
    ids=["drives", "turns"],
)
def test_wrong_odometry_is_no_wall_that_moves(kernel: Any, step: float, off: Pose) -> None:
    robot = Robot(kernel)
    for k in range(30):
        pose = Pose(step * k)
        told = Pose(pose.x + off.x, off.y, off.yaw) if k > 20 else pose
        robot.see(1.0 + PERIOD * k, [moved(0.5), BESIDE], pose, told=told)
    assert robot.moved == []


@pytest.mark.parametrize("kernel", KERNELS)
def test_no_wall_is_judged_alone_while_the_robot_drives(kernel: Any) -> None:
    """Odometry jumps by 20 cm: the only wall seems to move away by as much."""
    robot = Robot(kernel)
    for k in range(30):
        x = -0.02 * k
        robot.see(1.0 + PERIOD * k, [moved(0.5)], Pose(x), told=Pose(x + 0.2 * (k > 20)))
    assert robot.moved == []


def test_two_moving_walls_are_a_finding_until_it_ends() -> None:
    protection = Protection(BURGER)
    robot = Robot(FORMS[1])
    robot.barrier = protection._mode
    events: list[str] = []

    def run(scene: Scene, begin: float, seconds: float) -> None:
        for k in range(round(seconds / PERIOD)):
            now = begin + PERIOD * k
            odometry = Odometry(now, Pose(), ZERO)
            protection.on_odometry(odometry)
            ranges = ranges_at(Pose(), scene(PERIOD * k))
            spec = BURGER.scan
            scan = Scan(round(now / PERIOD), now, ranges, spec.bearings, 0.12, 3.5, None, 0.0)
            context = DecisionContext(now, 0.0, odometry, 0.0)
            protection.decide(Twist(0.0), context, True, None)
            protection.observe(scan, context)
            robot.now, robot.odometry = now, odometry
        events.extend(protection.events)

    def backward() -> float:
        context = DecisionContext(robot.now, 0.0, robot.odometry, 0.0)
        return protection.decide(Twist(-0.1), context, True, None).safe.linear

    run(after(3.0, [moved(0.3), BESIDE], [moved(0.5), BESIDE]), 1.0, 8.0)
    assert ["moving_wall" in text for text in events] == [True]
    assert not protection.findings
    run(after(3.0, [moved(0.5), BESIDE], [moved(0.7), BESIDE]), 9.0, 8.0)
    (finding,) = list(protection.findings)
    assert finding.startswith("moving_wall: 2 walls moved at 0.50 m/s or faster")
    run(still(AHEAD, BESIDE), 17.0, 4.0)
    assert backward() == pytest.approx(-0.1)
    assert robot.speed() < FAST  # the wall ahead is charged as everything else
    protection.forget_findings(protection.findings)
    run(still(AHEAD, BESIDE), 21.0, 3.0)  # the decision before was later than this scan
    assert protection.findings == ()
    assert robot.speed() > FAST


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(
    "garbage",
    [
        np.full(360, math.nan),
        np.full(360, -math.inf),
        np.full(360, 3.4),
        np.zeros(360),
        np.resize([0.2, 1.4], 360),
        np.random.default_rng(3).uniform(0.12, 1.5, 360),
    ],
    ids=["nan", "near", "far", "zero", "comb", "noise"],
)
def test_scans_of_garbage_show_no_wall(kernel: Any, garbage: Array) -> None:
    robots = Robot(kernel), Robot(kernel, walls_stand=None)
    for k in range(15):
        spec, now = BURGER.scan, 1.0 + PERIOD * k
        scan = Scan(k, now, garbage, spec.bearings, 0.12, 3.5, None, 0.0)
        context = DecisionContext(now, 0.0, Odometry(now, Pose(), ZERO), 0.0)
        twists = []
        for robot in robots:
            robot.barrier.observe(scan, robot.geometry, context)
            twists.append(robot.barrier.decide(Twist(0.1, 0.2), context, ZERO, None).twist)
            assert robot.barrier.moved_wall is None
        assert twists[0].is_finite
        assert twists[0] == twists[1]


@pytest.mark.parametrize(
    "bad",
    [
        *("{length: 0.2}", "{length: 5.0}", "{seconds: 0.5}", "{seconds: .nan}", "{width: 1.0}"),
    ],
)
def test_hostile_settings_are_refused(bad: str, tmp_path: Any) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(f"extends: burger\nprotection: {{barrier: {{walls_stand: {bad}}}}}\n")
    with pytest.raises(ConfigError, match="walls_stand"):
        load_platform(str(file))


def a_wall_and_a_run(*, is_opposite: bool) -> tuple[Any, Any, Any]:
    """Standing walls, interpreted, and a wall along the line of a run from -1 to 1 m.

    Bins are 4 cm long, and the 64th begins at the middle of the wall, which is that of the run.
    """
    module = interpreted(
        "swarmd.robot.protection.walls.standing_walls", because="it calls C's methods"
    )
    runs = interpreted("swarmd.robot.protection.walls.straight_runs", because="it makes its types")
    settings = WallsStand(length=0.5, seconds=2.0)
    wall, run = module.Wall(), runs.Run()
    wall.here_x, wall.here_y = 0.0, 0.0
    wall.here_ux, wall.here_uy = (-1.0 if is_opposite else 1.0), 0.0
    run.x, run.y, run.ux, run.uy, run.begin, run.end = 0.0, 0.0, 1.0, 0.0, -1.0, 1.0
    return module.StandingWalls(BURGER, settings, 0.0), wall, run


@pytest.mark.parametrize(
    ("is_opposite", "first", "last"), [(False, 0.08, 0.24), (True, -0.24, -0.08)]
)
def test_a_wall_and_a_run_overlap_beside_covered_bins(
    is_opposite: bool, first: float, last: float
) -> None:
    """Bins 66 to 69: 8 to 24 cm from the middle along the wall, which may lead back on the run."""
    walls, wall, run = a_wall_and_a_run(is_opposite=is_opposite)
    wall.low, wall.high = 66, 69
    assert walls._overlap(wall, run)
    assert (walls._overlap_first, walls._overlap_last) == pytest.approx((first, last))


def test_a_stretch_covers_no_bin_before_its_own() -> None:
    """It begins 6 cm and ends 10 cm behind the begin of the bins, which is 64 * 4 cm away."""
    walls, wall, run = a_wall_and_a_run(is_opposite=False)
    wall.bins[:] = wall.next_bins[:] = [math.inf] * 128
    walls._cover(wall, run, 0.06 - 2.56, 0.10 - 2.56, 7.0)
    assert [k for k, since in enumerate(wall.next_bins) if since == 7.0] == [1, 2]
