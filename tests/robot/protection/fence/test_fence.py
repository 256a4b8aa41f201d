"""The fence: pure properties with a handed-in clock, and the faults of its polygons."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.messages import FenceSummary
from swarmd.core.values import Array, Odometry, Platform, Pose, Scan, SharedPose, Twist
from swarmd.robot.protection.decision import Anchor, DecisionContext, ModeDecision
from swarmd.robot.protection.fence.fence import Fence, fence_fault
from swarmd.robot.protection.fence.fence_pose import CONFIRM_TIME, CONFIRMATIONS, FencePose
from swarmd.robot.protection.fence.fence_settings import FenceSettings, fence_text, polygon_fault
from swarmd.settings.platforms import load_platform
from tests.support.examples import examples
from tests.support.numpy_fence import NumpyFence
from tests.support.protection import Protection

TICK = 0.05
TIMEOUT = 0.5
BOUND = 0.0
"""m that the outline of a robot within the assumptions may be outside."""
GROWTH = 0.002
"""m that the distance of a robot outside may grow by the rounding of twelve steps of a stop."""
ERROR, YAW_ERROR = 0.03, 0.03  # m and rad: bounds of the errors of poses that are drawn anew
SLACK = 0.005
"""m that the distance of a robot outside may grow with these errors, since the fence tries eight
places around the robot, not all."""
SQUARE = FenceSettings(frame="w", polygon=[(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)])
BURGER = load_platform("burger")


def in_mode(platform: Platform, mode: str) -> Platform:
    return replace(platform, protection={**platform.protection, "mode": mode})


def polygon(rng: np.random.Generator, *, convex: bool) -> list[tuple[float, float]]:
    """A simple polygon around the origin; a star of random radii unless `convex`."""
    n = int(rng.integers(3, 9))
    angles = np.sort(rng.uniform(0.0, 2.0 * math.pi, n)) if not convex else None
    if angles is None or np.diff(angles, append=angles[0] + 2.0 * math.pi).max() > 2.8:
        angles = np.arange(n) * 2.0 * math.pi / n
    radii = np.full(n, 2.0) if convex else rng.uniform(0.8, 3.0, n)
    return [
        (float(r * math.cos(a)), float(r * math.sin(a))) for r, a in zip(radii, angles, strict=True)
    ]


def outline_outside(fence: Fence, platform: Platform, pose: Array) -> float:
    """m that the farthest corner or edge point of the true outline is outside; 0 inside."""
    corners = platform.footprint
    parts = np.linspace(0.0, 1.0, 9)[:, None, None]
    points = (corners + parts * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    placed = points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
    away = fence.clearances(placed) + fence.radius
    return max(-float(away.min()), 0.0)


class Base:
    """A base within the assumptions: late by 0 to 50 ms, brakes at the declared rate or better.

    `pose` (x, y, yaw) is true; `odometry` drifts by up to 4 % of way and turn.
    """

    def __init__(self, platform: Platform, pose: Array, rng: np.random.Generator) -> None:
        self.pose, self.rng = pose.copy(), rng
        self.odometry = np.zeros(3)
        self.speeds = np.zeros(3)  # ahead, left, turn
        barrier = platform.protection["barrier"]
        better = rng.uniform(1.0, 3.0, 2)
        rates = barrier["braking_linear"] * better[0], barrier["braking_angular"] * better[1]
        self.rates = np.array([rates[0], rates[0], rates[1]])
        self.lateness = int(rng.integers(0, 6))  # in hundredths of a second
        self.scale, self.turn_scale = 1.0 + rng.uniform(-0.04, 0.04, 2)
        self.queue = [np.zeros(3)] * self.lateness
        self.bend = 0.0  # rad by which odometry turns on 1 m of way, since the wheels differ

    def drive(self, command: Twist) -> None:
        """Move for one tick under a command, in steps of 10 ms."""
        wanted = np.array([command.linear, command.lateral, command.angular])
        for _ in range(5):
            self.queue.append(wanted)
            target = self.queue.pop(0)
            step = 0.01 * self.rates
            self.speeds += np.clip(target - self.speeds, -step, step)
            moved = 0.01 * self.speeds
            for pose, scale, turn in (
                (self.pose, 1.0, 1.0),
                (self.odometry, self.scale, self.turn_scale),
            ):
                if pose is self.odometry:
                    pose[2] += self.bend * moved[0]
                yaw = pose[2] + 0.5 * turn * moved[2]
                cos, sin = math.cos(yaw), math.sin(yaw)
                pose[0] += scale * (cos * moved[0] - sin * moved[1])
                pose[1] += scale * (sin * moved[0] + cos * moved[1])
                pose[2] += turn * moved[2]

    def reading(self, now: float) -> Odometry:
        twist = Twist(float(self.speeds[0]), float(self.speeds[2]), float(self.speeds[1]))
        return Odometry(now, Pose(*self.odometry.tolist()), twist)


def run(
    made: FenceSettings,
    platform: Platform,
    start: Array,
    rng: np.random.Generator,
    *,
    seconds: float = 12.0,
    gap: float = 0.1,
    jumps: bool = False,
) -> tuple[list[float], float]:
    """Drive at random; (m that the outline is outside at each tick, m driven).

    `gap`: s between poses. `jumps`: some poses are false by metres.
    """
    fence, known = Fence(made, platform), FencePose(made, TIMEOUT)
    base, limits = Base(platform, start, rng), platform.limits
    command, asked, next_pose = Twist(), Twist(), 0.0
    outside, driven = [outline_outside(fence, platform, base.pose)], 0.0
    history: list[tuple[float, Array]] = []
    for number in range(int(seconds / TICK)):
        now = number * TICK
        reading = base.reading(now)
        known.on_odometry(reading)
        history.append((now, base.pose.copy()))
        if now >= next_pose:
            at, true = history[max(len(history) - 1 - int(rng.integers(0, 4)), 0)]
            off, turn = rng.uniform(-0.02, 0.02), rng.uniform(-0.02, 0.02)
            way = rng.uniform(-math.pi, math.pi)
            x, y = true[0] + off * math.cos(way), true[1] + off * math.sin(way)
            if jumps and rng.random() < 0.15:
                x, y = x + rng.uniform(-3.0, 3.0), y + rng.uniform(-3.0, 3.0)
            shared = SharedPose(now, Pose(x, y, true[2] + turn), 0.02, 0.02, "w")
            known.on_pose(shared, at, (0.02, 0.02), now)
            next_pose = now + gap * rng.uniform(0.5, 1.5)
        if rng.random() < 0.1:
            shares = rng.uniform(-1.0, 1.0, 3) if rng.random() < 0.7 else rng.choice([-1, 0, 1], 3)
            asked = limits.clip(
                Twist(
                    float(shares[0]) * limits.linear,
                    float(shares[1]) * limits.angular,
                    float(shares[2]) * limits.lateral,
                )
            )
        context = DecisionContext(now, 0.0, reading, 0.0, anchor=known.anchor(now))
        is_held = now > known.until
        command = Twist() if is_held else fence.limit(asked, context, command)
        if asked.is_zero:
            assert command.is_zero
        before = base.pose[:2].copy()
        base.drive(command)
        driven += math.dist(before, base.pose[:2])
        outside.append(outline_outside(fence, platform, base.pose))
    return outside, driven


def inner_start(made: FenceSettings, platform: Platform, rng: np.random.Generator) -> Array | None:
    """A pose whose circle is inside with the margin; None if no place was drawn."""
    fence = Fence(made, platform)
    for _ in range(200):
        place = rng.uniform(-3.0, 3.0, 2)
        if fence.clearances(place[None])[0] > made.margin:
            return np.array([*place, rng.uniform(-math.pi, math.pi)])
    return None


@settings(max_examples=examples(100), deadline=None)
@given(
    seed=st.integers(0, 10_000),
    convex=st.booleans(),
    keeps_out=st.booleans(),
    name=st.sampled_from(["burger", "waffle_pi", "turtlebot4"]),
    gap=st.sampled_from([0.05, 0.1, 0.3, 0.7]),
    jumps=st.booleans(),
)
def test_a_robot_that_starts_inside_stays_inside(
    seed: int, convex: bool, keeps_out: bool, name: str, gap: float, jumps: bool
) -> None:
    rng, platform = np.random.default_rng(seed), load_platform(name)
    keep_out = [[(0.3, 0.3), (0.6, 0.3), (0.31, 0.34), (0.3, 0.6)]] if keeps_out else []
    made = FenceSettings(frame="w", polygon=polygon(rng, convex=convex), keep_out=keep_out)
    start = inner_start(made, platform, rng)
    if start is not None:
        outside, _ = run(made, platform, start, rng, gap=gap, jumps=jumps)
        assert max(outside) <= BOUND


@settings(max_examples=examples(60), deadline=None)
@given(seed=st.integers(0, 10_000), convex=st.booleans())
def test_a_robot_that_starts_outside_only_comes_nearer(seed: int, convex: bool) -> None:
    rng = np.random.default_rng(seed)
    made = FenceSettings(frame="w", polygon=polygon(rng, convex=convex))
    fence = Fence(made, BURGER)
    way = rng.uniform(-math.pi, math.pi)
    start = np.array([4.0 * math.cos(way), 4.0 * math.sin(way), rng.uniform(-3.0, 3.0)])
    distances: list[float] = []
    known, base, command = FencePose(made, TIMEOUT), Base(BURGER, start, rng), Twist()
    for number in range(200):
        now = number * TICK
        known.on_odometry(base.reading(now))
        shared = SharedPose(now, Pose(*base.pose.tolist()), 0.0, 0.02, "w")
        known.on_pose(shared, now, (0.0, 0.02), now)
        distances.append(-float(fence.clearances(base.pose[None, :2])[0]))
        asked = Twist(float(rng.uniform(-0.22, 0.22)), float(rng.uniform(-2.0, 2.0)))
        context = DecisionContext(now, 0.0, base.reading(now), 0.0, anchor=known.anchor(now))
        command = Twist() if now > known.until else fence.limit(asked, context, command)
        base.drive(command)
    assert np.diff(distances).max() <= GROWTH
    assert max(distances) - distances[0] <= GROWTH


def growth_outside(
    made: FenceSettings,
    platform: Platform,
    start: Array,
    rng: np.random.Generator,
    asks: Callable[[int, Array], Twist],
) -> float:
    """m by which the distance to the fence grew at most, over the least distance before.

    The poses have errors of up to ERROR and YAW_ERROR, drawn anew each 0.1 s.
    """
    fence, known = Fence(made, platform), FencePose(made, TIMEOUT)
    base, command = Base(platform, start, rng), Twist()
    least, growth = math.inf, 0.0
    for number in range(300):
        now = number * TICK
        known.on_odometry(base.reading(now))
        if number % 2 == 0:
            way, far = rng.uniform(-math.pi, math.pi), ERROR * math.sqrt(rng.uniform())
            x, y = base.pose[:2] + far * np.array([math.cos(way), math.sin(way)])
            yaw = base.pose[2] + rng.uniform(-YAW_ERROR, YAW_ERROR)
            told = SharedPose(now, Pose(float(x), float(y), float(yaw)), ERROR, YAW_ERROR, "w")
            known.on_pose(told, now, (ERROR, YAW_ERROR), now)
        context = DecisionContext(now, 0.0, base.reading(now), 0.0, anchor=known.anchor(now))
        asked = asks(number, base.pose)
        command = Twist() if now > known.until else fence.limit(asked, context, command)
        base.drive(command)
        distance = -float(fence.clearances(base.pose[None, :2])[0])
        least = min(least, max(distance, 0.0))
        growth = max(growth, distance - least)
    return growth


def towards(pose: Array, way: float) -> Twist:
    """The command at 0.1 m/s in the direction `way` of the frame of the fence."""
    return Twist(0.1 * math.cos(way - pose[2]), 0.0, 0.1 * math.sin(way - pose[2]))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("corner", [25.0, 70.0, 115.0])
@pytest.mark.parametrize("is_kept_out", [False, True])
def test_a_robot_outside_drives_no_farther_into_a_corner(
    seed: int, corner: float, is_kept_out: bool
) -> None:
    """The command must lead inwards from each place within the declared error.

    The robot has equal distances to the two edges of a corner: of the outer polygon, so that the
    outline is across both edges, or of an area to keep out of, in which the robot is. It asks for a
    direction 10 degrees off one edge that is inwards by this edge, and outwards by the other. The
    other edge is the nearer one by the true pose, so that a false pose alone permits the command.
    The two directions are 45, 90 or 135 degrees from each other, and the base looks along one: so
    its two linear speeds are equal, or one is zero, and it brakes on a straight line.
    """
    rng, platform = np.random.default_rng(seed), load_platform("rosbot_xl")
    half = math.radians(0.5 * corner)
    ends = [(6.0 * math.cos(way), 6.0 * math.sin(way)) for way in (-half, half)]
    wedge = [(0.0, 0.0), *ends]
    made = FenceSettings(frame="w", polygon=wedge)
    away = Fence(made, platform).radius - 0.1
    if is_kept_out:
        outer = [(-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0)]
        made = FenceSettings(frame="w", polygon=outer, keep_out=[wedge])
        away = 0.3
    aside = half + math.radians(10.0)
    middle = 0.0 if is_kept_out else math.pi
    start = np.array([away / math.sin(half), 0.0, middle + aside])

    def along_the_farther_edge(number: int, pose: Array) -> Twist:
        side = -1.0 if pose[1] > 0.0 else 1.0
        return towards(pose, middle + side * aside)

    growth = growth_outside(made, platform, start, rng, along_the_farther_edge)
    assert growth <= SLACK


def context_at(x: float, y: float, yaw: float, twist: Twist = Twist()) -> DecisionContext:  # noqa: B008  # it is frozen
    known = FencePose(SQUARE, TIMEOUT)
    odometry = Odometry(0.0, Pose(0.0, 0.0, 0.0), twist)
    for number in range(CONFIRMATIONS + 3):
        now = 0.1 * number
        known.on_odometry(Odometry(now, odometry.pose, twist))
        known.on_pose(SharedPose(now, Pose(x, y, yaw), 0.01, 0.01, "w"), now, (0.01, 0.01), now)
    return DecisionContext(now, 0.0, odometry, 0.0, anchor=known.anchor(now))


@settings(max_examples=examples(200), deadline=None)
@given(
    linear=st.floats(-0.22, 0.22),
    angular=st.floats(-2.0, 2.0),
    x=st.floats(-1.0, 1.0),
    y=st.floats(-1.0, 1.0),
    yaw=st.floats(-4.0, 4.0),
)
def test_far_from_the_fence_a_command_passes_unchanged(
    linear: float, angular: float, x: float, y: float, yaw: float
) -> None:
    asked = Twist(linear, angular)
    assert Fence(SQUARE, BURGER).limit(asked, context_at(x, y, yaw), Twist()) is asked


@pytest.mark.parametrize("turn", [0.0, 0.5 * math.pi, math.pi])
def test_the_room_of_a_place_is_not_used_at_its_mirrored_place(turn: float) -> None:
    """20 m are free at (-10, 0), and 2 m less the radius at (10, 0), 20 m away."""
    corners = np.array([[-40.0, -20.0], [12.0, -20.0], [12.0, 20.0], [-40.0, 20.0]])
    turned = corners @ [[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]
    fence = Fence(FenceSettings(frame="w", polygon=[(x, y) for x, y in turned.tolist()]), BURGER)
    away = Twist(BURGER.limits.linear)
    ahead = math.cos(turn), math.sin(turn)
    context = context_at(-10.0 * ahead[0], -10.0 * ahead[1], turn)
    assert fence.limit(away, context, Twist()) is away
    context = context_at(11.85 * ahead[0], 11.85 * ahead[1], turn)
    assert fence.limit(away, context, Twist()).linear < 0.5 * away.linear
    place = Pose(10.0 * ahead[0], 10.0 * ahead[1], turn)
    assert fence._room(Pose(-place.x, -place.y, turn)) > 19.0
    assert fence._room(place) == pytest.approx(2.0 - fence.radius)


@pytest.mark.parametrize("first", [0, 1])
def test_the_widest_circle_of_a_strip_is_half_as_wide(first: int) -> None:
    strip = [[11.0, 0.0], [12.0, 0.0], [12.0, 4.0], [11.0, 4.0]]
    corners = [(corner[first], corner[1 - first]) for corner in strip]
    made = FenceSettings(frame="w", polygon=corners if first == 0 else corners[::-1])
    assert Fence(made, BURGER).widest() == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("x", [0.0, 1.8, 2.0, 3.0])
def test_zero_stays_zero(x: float) -> None:
    assert Fence(SQUARE, BURGER).limit(Twist(), context_at(x, 0.0, 0.0), Twist()).is_zero


@pytest.mark.parametrize(
    ("x", "asked", "limited"),
    [
        (1.83, Twist(0.2, 0.5), Twist(0.0, 0.5)),  # ahead is the fence: only the turn is left
        (1.83, Twist(-0.2, 0.5), Twist(-0.2, 0.5)),
        (3.0, Twist(0.2, 0.0), Twist()),  # outside, and farther out
        (3.0, Twist(-0.2, 0.0), Twist(-0.2, 0.0)),
        (3.0, Twist(0.0, 1.0), Twist(0.0, 1.0)),
    ],
)
def test_a_limited_command_keeps_what_the_fence_permits(
    x: float, asked: Twist, limited: Twist
) -> None:
    assert Fence(SQUARE, BURGER).limit(asked, context_at(x, 0.0, 0.0), Twist()) == limited


@pytest.mark.parametrize("yaw", [0.0, 0.5 * math.pi])
@pytest.mark.parametrize(("ahead", "limited"), [(0.0, Twist(0.2, 0.5)), (0.83, Twist(0.0, 0.5))])
def test_the_way_since_the_last_pose_counts_in_the_frame_of_the_fence(
    yaw: float, ahead: float, limited: Twist
) -> None:
    """The fence is 2 m from the middle; the last pose was at 1 m, where odometry said 5 m."""
    began = Pose(5.0, 3.0, 0.0)
    anchor = Anchor(Pose(math.cos(yaw), math.sin(yaw), yaw), began, 0.01, 0.01, 0.0, 0.0)
    odometry = Odometry(0.0, Pose(5.0 + ahead, 3.0, 0.0), Twist())
    context = DecisionContext(0.0, 0.0, odometry, 0.0, anchor=anchor)
    assert Fence(SQUARE, BURGER).limit(Twist(0.2, 0.5), context, Twist()) == limited


@pytest.mark.parametrize(
    ("anchor", "odometry", "age", "error"),
    [
        ((0.05, 0.0, 0.0, 0.0), (0.0, 0.0), 0.0, 0.05),  # the told error
        ((0.0, 0.1, 0.0, 0.0), (1.0, 0.0), 0.0, 0.1),  # the told error of the yaw, 1 m away
        ((0.0, 0.0, 2.0, 0.0), (0.0, 0.0), 0.0, 0.1),  # 5 % of 2 m of way
        ((0.0, 0.0, 2.0, 1.0), (0.0, 0.0), 0.0, 0.2),  # and of 1 rad of turn, along that way
        ((0.0, 0.0, 0.0, 0.0), (0.0, 0.2), 0.0, 0.01),  # it may brake at once: 0.05 s at 0.2 m/s
        ((0.0, 0.0, 0.0, 0.0), (0.0, 0.2), 0.1, 0.03),  # and since odometry: 0.15 s
        ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0), 0.35, 0.044),  # 0.2 s too old, at 0.22 m/s
        ((0.01, 0.1, 1.0, 0.0), (0.5, 0.1), 0.0, 0.01 + 0.05 + 0.05 + 0.005),  # all add up
    ],
)
def test_the_error_of_a_pose_has_each_part_of_the_page(
    anchor: tuple[float, float, float, float],
    odometry: tuple[float, float],
    age: float,
    error: float,
) -> None:
    """docs/configuration.md and assumption 7 and 13 of docs/safety.md: odometry counts for 0.15 s.

    `anchor`: told errors in m and rad, m of way, rad of turn; `odometry`: m from there, and m/s.
    """
    moved, speed = odometry
    told = Anchor(Pose(0.5, 0.0, 0.3), Pose(), *anchor)
    reading = Odometry(0.0, Pose(moved, 0.0, 0.0), Twist(speed))
    context = DecisionContext(0.0, 0.0, reading, age, anchor=told)
    view = Fence(SQUARE, BURGER).view(context)
    assert view is not None
    assert view.error == pytest.approx(error)


@pytest.mark.parametrize(("slack", "is_permitted"), [(0.003, True), (-0.003, False)])
def test_a_stop_begins_50_ms_and_a_tick_after_the_decision(
    slack: float, is_permitted: bool
) -> None:
    """Assumption 1 of docs/safety.md: the base responds within 50 ms, then brakes at 1.0 m/s2."""
    radius = math.hypot(0.102, 0.089)  # config/platforms/burger.yaml
    stop = 0.22 * 0.05 + 0.22 * TICK + 0.22**2 / (2.0 * 1.0)
    x = 2.0 - radius - SQUARE.margin - stop - slack
    anchor = Anchor(Pose(x, 0.0, 0.0), Pose(), 0.0, 0.0, 0.0, 0.0)
    odometry = Odometry(0.0, Pose(), Twist(0.22))
    context = DecisionContext(0.0, 0.0, odometry, 0.0, anchor=anchor)
    limited = Fence(SQUARE, BURGER).limit(Twist(0.22), context, Twist(0.22))
    assert (limited == Twist(0.22)) is is_permitted
    assert limited.linear < 0.22 or is_permitted


@settings(max_examples=examples(200), deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_kernel_limits_as_arrays_of_numpy_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    platform = load_platform(str(rng.choice(["burger", "waffle_pi", "rosbot_xl", "crazyflie"])))
    at, side = rng.uniform(-1.5, 1.5, 2), rng.uniform(0.02, 1.0)
    shape = [(0.0, 0.0), (1.0, 0.1), (0.9, 1.0), (0.4, 0.3)]
    keep_out = [[(float(at[0] + side * x), float(at[1] + side * y)) for x, y in shape]]
    made = FenceSettings(
        frame="w",
        polygon=polygon(rng, convex=bool(rng.random() < 0.5)),
        keep_out=keep_out if rng.random() < 0.5 else [],
    )
    fence, arrays = Fence(made, platform), NumpyFence(made, platform)
    places = rng.uniform(-4.0, 4.0, (20, 2))
    assert fence.clearances(places) == pytest.approx(arrays.clearances(places), abs=1e-12)
    for _ in range(10):
        share = platform.limits.linear, platform.limits.angular, platform.limits.lateral
        asked, command, twist = (
            Twist(*(float(rng.uniform(-1.0, 1.0) * most) for most in share)) for _ in range(3)
        )
        x, y, yaw = rng.uniform(-3.0, 3.0, 3).tolist()
        anchor = Anchor(Pose(x, y, yaw), Pose(0.1, 0.2, 0.3), 0.02, 0.02, 0.1, 0.2)
        odometry = Odometry(0.0, Pose(0.15, 0.2, 0.35), twist)
        context = DecisionContext(0.0, 0.0, odometry, 0.02, anchor=anchor)
        is_even = bool(rng.random() < 0.5)
        given = asked, context, command
        limited = fence.limit(*given, is_even=is_even)
        assert limited == arrays.limit(*given, is_even=is_even)
        assert (limited is asked) is (limited == asked)


def a_scan() -> Scan:
    spec = BURGER.scan
    ranges = np.full(len(spec.bearings), np.inf)
    return Scan(1, 0.0, ranges, spec.bearings, spec.range_min, spec.range_max)


@pytest.mark.parametrize("mode", ["barrier", "stop_zone", "potential_field", "off"])
def test_the_fence_acts_in_every_mode(mode: str) -> None:
    context = context_at(1.83, 0.0, 0.0)
    free, fenced = (Protection(in_mode(BURGER, mode), made) for made in ([], [SQUARE]))
    for one in (free, fenced):
        one.observe(a_scan(), context)
    asked = Twist(0.2, 0.5)
    assert free.decide(asked, context, True, None).safe == asked
    decision = fenced.decide(asked, context, True, None)
    assert decision.safe == Twist(0.0, 0.5)
    assert decision.is_bounded
    assert decision.is_active
    far = context_at(0.0, 0.0, 0.0)
    assert fenced.decide(asked, far, True, None).safe == asked
    assert not fenced.decide(asked, far, True, None).is_bounded


class Swerving:
    """A mode that asks for ahead and a turn, whatever it is asked."""

    def decide(self, *_: object) -> ModeDecision:
        return ModeDecision(Twist(0.2, 0.5), True, ())

    def __getattr__(self, name: str) -> Any:
        return getattr(self.real, name)

    def __init__(self, real: Any) -> None:
        self.real = real


def test_what_a_mode_asks_in_place_of_the_request_is_bounded_by_one_share() -> None:
    """The fence acts in every protection mode (docs/configuration.md).

    Only a share of all speeds keeps what the mode permits: with the turn alone, which the fence
    permits, a corner may meet what the mode drives around.
    """
    decisions = []
    for x in (0.0, 1.79, 1.83):  # free, room for a part of the speed, no room ahead
        protection = Protection(in_mode(BURGER, "off"), [SQUARE])
        protection._mode = Swerving(protection._mode)
        decisions.append(protection.decide(Twist(0.0, 0.1), context_at(x, 0.0, 0.0), True, None))
    free, near, at = (decision.safe for decision in decisions)
    assert free == Twist(0.2, 0.5)
    assert 0.0 < near.linear < 0.2
    assert near.angular == pytest.approx(near.linear * 0.5 / 0.2)
    assert at == Twist()
    assert [decision.is_bounded for decision in decisions] == [False, True, True]


class Told:
    """A `FencePose` of a robot at rest that gets a pose each 0.1 s."""

    def __init__(self, **changes: Any) -> None:
        self.known = FencePose(replace_settings(SQUARE, **changes), TIMEOUT)
        self.now = 0.0

    def tell(self, x: float, *, frame: str = "w", times: int = 1) -> None:
        for _ in range(times):
            self.now += 0.1
            self.known.on_odometry(Odometry(self.now, Pose(0.0, 0.0, 0.0), Twist()))
            pose = SharedPose(self.now, Pose(x, 0.0, 0.0), 0.01, 0.01, frame)
            self.known.on_pose(pose, self.now, (0.01, 0.01), self.now)

    @property
    def holds(self) -> bool:
        return self.now > self.known.until


def replace_settings(made: FenceSettings, **changes: Any) -> FenceSettings:
    from msgspec.structs import replace as replaced

    return replaced(made, **changes)


def test_a_first_pose_is_used_once_it_is_confirmed() -> None:
    told = Told()
    assert told.holds
    assert "no pose in the frame 'w'" in told.known.text(told.now)
    for number in range(CONFIRMATIONS):
        told.tell(0.0)
        assert told.holds, number
    told.tell(0.0)
    assert not told.holds
    assert told.known.text(told.now) == ""


def test_a_jump_holds_until_it_is_confirmed() -> None:
    told = Told()
    told.tell(0.0, times=6)
    told.tell(1.5)
    assert told.holds
    assert told.known.text(told.now) == "the pose jumped by 1.50 m; waits until poses agree"
    assert told.known.anchor(told.now) is None
    told.tell(1.5, times=CONFIRMATIONS)
    assert not told.holds
    anchor = told.known.anchor(told.now)
    assert anchor is not None
    assert anchor.pose.x == 1.5
    assert CONFIRM_TIME <= 0.1 * CONFIRMATIONS + 1e-9


def test_a_single_false_pose_holds_for_one_pose_only() -> None:
    told = Told()
    told.tell(0.0, times=6)
    told.tell(1.5)
    assert told.holds
    told.tell(0.0)
    assert not told.holds


def test_poses_that_do_not_agree_are_never_used() -> None:
    told = Told()
    for number in range(20):
        told.tell(0.5 * number)
        assert told.holds


def test_a_pose_in_another_frame_holds_and_names_both_frames() -> None:
    told = Told()
    told.tell(0.0, times=6)
    told.tell(0.0, frame="map")
    assert told.holds
    assert told.known.text(told.now) == "the fence is in the frame 'w', the pose in 'map'"
    told.tell(0.0, times=CONFIRMATIONS + 1)
    assert not told.holds


def test_an_old_pose_holds() -> None:
    told = Told()
    told.tell(0.0, times=6)
    told.now += TIMEOUT + 0.1
    assert told.holds
    assert told.known.text(told.now) == "the last pose is 0.6 s old"


def test_odometry_that_jumps_holds_until_poses_agree() -> None:
    told = Told()
    told.tell(0.0, times=6)
    told.known.on_odometry(Odometry(told.now + 0.05, Pose(5.0, 0.0, 0.0), Twist()))
    assert told.holds


Source = Callable[[float, Pose], Pose]
"""The pose that a tracker tells, from s since it began to fail, and the true pose."""


def frozen(at: float, true: Pose) -> Pose:
    return Pose(0.0, 0.0, 0.0)


def drifting(rate: float, way: float = 0.0) -> Source:
    return lambda at, true: Pose(
        true.x + rate * at * math.cos(way), true.y + rate * at * math.sin(way), true.yaw
    )


def turned(deg: float) -> Source:
    return lambda at, true: Pose(true.x, true.y, true.yaw + math.radians(deg))


def mirrored(at: float, true: Pose) -> Pose:
    return Pose(-true.x, true.y, true.yaw)


class Failing:
    """A robot that drives straight on from the origin, and a tracker that fails then.

    Poses come each 0.1 s; their told errors are 0.05 m and 3 degrees.
    """

    def __init__(self, source: Source, speed: float) -> None:
        """The robot stands for 2 s before."""
        self.known = FencePose(SQUARE, TIMEOUT)
        self.source, self.speed = source, speed
        self.now, self.x, self.began = 0.0, 0.0, math.inf
        self.advance(2.0, 0.0)
        assert not self.holds
        self.began = self.now

    def advance(self, seconds: float, speed: float) -> None:
        """Drive at a speed."""
        for _ in range(round(seconds / 0.1)):
            self.now += 0.1
            self.x += 0.1 * speed
            self.known.on_odometry(Odometry(self.now, Pose(self.x, 0.0, 0.0), Twist(speed)))
            true = Pose(self.x, 0.0, 0.0)
            told = self.source(max(self.now - self.began, 0.0), true)
            errors = 0.05 + 0.05 * abs(speed), math.radians(3.0)
            self.known.on_pose(SharedPose(self.now, told, *errors, "w"), self.now, errors, self.now)

    @property
    def holds(self) -> bool:
        return self.now > self.known.until

    def drive(self, seconds: float) -> float | None:
        """Drive until the fence holds: s since the tracker began to fail; None without a hold."""
        while self.now < self.began + seconds - 1e-9:
            self.advance(0.1, self.speed)
            if self.holds:
                return self.now - self.began
        return None


@pytest.mark.parametrize(
    ("source", "speed", "within"),
    [
        (frozen, 0.22, 1.0),
        (frozen, 0.03, 9.0),
        (drifting(0.15), 0.22, 1.5),
        (drifting(0.15, math.pi), 0.22, 1.5),
        (drifting(0.15, math.pi / 2.0), 0.0, 1.0),
        (turned(90.0), 0.22, 1.5),
        (turned(30.0), 0.22, 3.0),
        (mirrored, 0.22, 1.0),
        # The rates of row 13 of docs/safety.md.
        (drifting(0.02), 0.0, 10.0),
        (drifting(0.07), 0.22, 10.0),
        (drifting(0.15), 0.5, 10.0),
    ],
)
def test_poses_that_odometry_does_not_explain_hold(
    source: Source, speed: float, within: float
) -> None:
    failing = Failing(source, speed)
    found = failing.drive(within)
    assert found is not None
    assert failing.known.anchor(failing.now) is None


@pytest.mark.parametrize("way", [0.0, math.pi])
def test_a_long_way_before_explains_no_failure(way: float) -> None:
    """Errors grow with the way between two poses, not with the way of the run: 26 m here."""
    failing = Failing(drifting(0.15, way), 0.22)
    failing.began = math.inf
    failing.advance(120.0, 0.22)
    assert not failing.holds
    failing.began = failing.now
    assert failing.drive(1.5) is not None


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ({"clearance": 0.42, "error": 0.03}, "0.42 m inside (+- 0.03 m), in frame mocap"),
        ({"clearance": 0.42, "error": 0.03, "limits": True}, "in frame mocap; limits the command"),
        ({"clearance": -0.1, "error": 0.03}, "0.10 m outside (+- 0.03 m), in frame mocap"),
        ({"text": "no pose"}, "in frame mocap; the robot stands: no pose"),
    ],
)
def test_the_place_against_the_fence_in_words(place: dict[str, Any], text: str) -> None:
    """As on docs/operating.md."""
    said = fence_text(FenceSummary(frame="mocap", **place))
    assert said.endswith(text)
    assert ("limits" in said) == ("limits" in place)


def test_a_drift_holds_longer_than_a_run_lasts_and_tells_its_figure() -> None:
    """Any hold of 2 s ends the run (docs/safety.md)."""
    failing = Failing(frozen, 0.22)
    failing.drive(2.0)
    text = failing.known.text(failing.now)
    assert re.fullmatch(
        r"in \d\.\d s the pose moved otherwise than odometry by 0\.1\d m and 0 deg,"
        r" errors explain 0\.1\d m and \d deg; waits until poses agree for 5 s",
        text,
    )
    for _ in range(40):
        failing.advance(0.1, 0.0)
        assert failing.holds
        assert failing.known.text(failing.now) == text
    failing.advance(1.5, 0.0)  # the frozen pose agrees with a robot that stands
    assert not failing.holds


def test_a_tracker_that_finds_the_robot_again_ends_the_hold() -> None:
    failing = Failing(frozen, 0.22)
    failing.drive(2.0)
    failing.source = lambda at, true: true
    failing.advance(0.1, 0.0)
    assert not failing.holds


def test_a_second_jump_holds_longer_than_a_run_lasts() -> None:
    told = Told()
    told.tell(0.0, times=6)
    told.tell(1.5, times=CONFIRMATIONS + 1)
    assert not told.holds
    told.tell(0.0, times=40)
    assert told.holds
    assert "waits until poses agree for 5 s" in told.known.text(told.now)


@pytest.mark.parametrize("times", [1, 2, 3, 6])
def test_poses_that_stop_for_long_count_anew(times: int) -> None:
    told = Told()
    told.tell(0.0, times=times)
    told.now += 30.0
    told.tell(0.0, times=CONFIRMATIONS)
    assert told.holds
    told.tell(0.0)
    assert not told.holds


def test_a_false_pose_within_the_bounds_is_no_drift() -> None:
    told = Told()
    told.tell(0.0, times=20)
    for _ in range(10):
        told.tell(0.035)  # the bounds permit 0.04 m
        assert not told.holds
        told.tell(0.0, times=9)
        assert not told.holds


@pytest.mark.parametrize(("error", "late"), [(0.10, 0.0), (0.02, 0.5)])
def test_errors_as_declared_hold_nothing(error: float, late: float) -> None:
    """Odometry errs by up to 5 % and bends; half of the poses are late by up to 0.1 s."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        base, known = Base(BURGER, np.zeros(3), rng), FencePose(SQUARE, TIMEOUT)
        base.scale, base.turn_scale = 1.0 + rng.choice([-0.05, 0.05], 2)
        base.bend, asked = float(rng.choice([-0.09, 0.09])), Twist()
        poses: list[Array] = []
        for number in range(300):
            now = number * TICK
            known.on_odometry(base.reading(now))
            poses.append(base.pose.copy())
            back = int(rng.integers(0, 3)) if rng.random() < late else 0
            true = poses[max(number - back, 0)]
            far, way = error * rng.uniform(), rng.uniform(-math.pi, math.pi)
            x, y = true[0] + far * math.cos(way), true[1] + far * math.sin(way)
            told = Pose(x, y, true[2] + error * rng.uniform(-1.0, 1.0))
            errors = error + 0.05 * abs(base.speeds[0]), error + 0.05 * abs(base.speeds[2])
            if number % 2 == 0:
                pose = SharedPose(now, told, error, error, "w")
                known.on_pose(pose, now - back * TICK, errors, now)
            assert now < 1.0 or now <= known.until
            if rng.random() < 0.05:
                asked = Twist(0.22 * rng.uniform(-0.3, 1.0), rng.uniform(-1.0, 1.0))
            base.drive(asked)


@pytest.mark.parametrize("source", [frozen, drifting(0.15), turned(90.0)])
def test_a_failed_tracker_lets_no_robot_far_out_of_its_fence(source: Source) -> None:
    """From rest in the middle of a square of 2.4 m a Burger drives on for 20 s."""
    made = replace_settings(SQUARE, polygon=[(-1.2, -1.2), (1.2, -1.2), (1.2, 1.2), (-1.2, 1.2)])
    fence, known, rng = Fence(made, BURGER), FencePose(made, TIMEOUT), np.random.default_rng(1)
    base, command, kept = Base(BURGER, np.array([0.0, 0.0, 0.3]), rng), Twist(), Pose()
    outside, held, is_running = 0.0, 0.0, True
    for number in range(400):
        now = number * TICK
        known.on_odometry(base.reading(now))
        if number % 2 == 0:
            true = Pose(*base.pose.tolist())
            kept = true if now < 3.0 else kept
            told = kept if source is frozen else source(max(now - 3.0, 0.0), true)
            known.on_pose(SharedPose(now, told, 0.05, 0.05, "w"), now, (0.06, 0.05), now)
        held = held + TICK if now > known.until else 0.0
        is_running &= now < 1.5 or held < 2.0
        context = DecisionContext(now, 0.0, base.reading(now), 0.0, anchor=known.anchor(now))
        asked = Twist(0.22, 0.0) if is_running and held == 0.0 else Twist()
        command = fence.limit(asked, context, command)
        base.drive(command)
        outside = max(outside, outline_outside(fence, BURGER, base.pose))
    assert outside <= 0.10
    assert not is_running


def test_a_robot_may_drive_without_a_pose_if_declared() -> None:
    told = Told(without_pose="drive")
    assert not told.holds
    assert told.known.anchor(told.now) is None


@pytest.mark.parametrize(
    ("corners", "fault"),
    [
        ([(0, 0), (2, 0), (2, 2), (0, 2)], ""),
        ([(0, 0), (2, 0), (1, 0.5), (0, 2)], ""),
        ([(0, 0), (2, 2), (2, 0), (0, 2)], "crosses itself: the edge from [0, 0] to [2, 2]"),
        ([(0, 0), (2, 0), (2, 0), (0, 2)], "has two equal corners: [2, 0]"),
        ([(0, 0), (4, 0), (2, 0), (0, 2)], "turns back on itself at [4, 0]"),
        ([(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)], "crosses itself"),
        ([(0, 0), (0, 4), (0, 2), (2, 0)], "turns back on itself at [0, 4]"),
        ([(0, 0), (0.5, 0.5), (0.5, 0), (0, 0.5)], "crosses itself: the edge from [0, 0]"),
    ],
)
def test_faults_of_polygons(corners: list[tuple[float, float]], fault: str) -> None:
    assert polygon_fault(corners).startswith(fault)
    assert bool(polygon_fault(corners)) == bool(fault)


@pytest.mark.parametrize(
    ("side", "keep_out", "is_fault"),
    [(2.0, [], False), (0.3, [], True), (0.5, [[(0.2, 0.2), (0.3, 0.2), (0.25, 0.3)]], True)],
)
def test_a_fence_that_is_too_small_is_a_fault(
    side: float, keep_out: list[list[tuple[float, float]]], is_fault: bool
) -> None:
    corners = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)]
    text = fence_fault(FenceSettings(frame="w", polygon=corners, keep_out=keep_out), BURGER)
    assert bool(text) == is_fault
    assert not text or text.startswith("is too small for platform burger")
