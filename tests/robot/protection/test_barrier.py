"""Mode `barrier`: properties for every scan and requested command, with independent oracles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from msgspec import structs

from swarmd.core.values import ZERO, Array, Limits, Odometry, Platform, Pose, Scan, TouchZone, Twist
from swarmd.robot.protection.barrier import SLOW_REQUEST
from swarmd.robot.protection.binding_range import REACTION_TIME
from swarmd.robot.protection.closing_speed import CREEP_SPEED
from swarmd.robot.protection.compatibility import barrier_settings
from swarmd.robot.protection.decision import DecisionContext, Permit, ToldObstacle
from swarmd.robot.protection.footprint import Footprint, ScanGeometry
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import mirrored, reordered, scan_from
from tests.support.barrier_parts import closing_cap, outline_of, separation
from tests.support.filter_sim import (
    FORMS,
    FilterSim,
    Shape,
    box,
    decided,
    outline_point,
    under_barrier,
)
from tests.support.protection import Protection

TICK = 0.05
PLATFORMS = [under_barrier(load_platform(name)) for name in ("burger", "waffle_pi", "jackal")]
BURGER, WAFFLE, JACKAL = PLATFORMS
SIDEWAYS = replace(BURGER, limits=Limits(0.22, 2.84, 0.2))
WEAK = under_barrier(WAFFLE, braking_linear=0.3)
AVOIDING = [
    replace(one, protection={**one.protection, "avoidance": "orca"}) for one in (BURGER, SIDEWAYS)
]
VARIANTS = [under_barrier(WAFFLE, keep_out=0.5)]
PLATFORM = st.sampled_from(PLATFORMS)
AGE = st.floats(0.0, 0.3)
SHARE = st.floats(-1, 1)
RAYS = 360
RETURN = st.tuples(st.integers(0, RAYS - 1), st.one_of(st.floats(0, 1), st.just(-1.0)))
RETURNS = st.lists(RETURN, max_size=12)
NEAR_RETURNS = st.lists(st.tuples(st.integers(0, RAYS - 1), st.floats(0, 0.3)), max_size=6)

Returns = Sequence[tuple[int, float]]


def seeing(platform: Platform, returns: Returns) -> Scan:
    """A scan with these returns: ray, and share of 2 m beyond range_min (negative: too close)."""
    ranges = np.full(RAYS, math.inf)
    for ray, share in returns:
        ranges[ray] = platform.scan.range_min + 2.0 * share if share >= 0.0 else -math.inf
    return scan_from(platform, ranges, platform.scan.bearings)


def request_of(platform: Platform, v: float, w: float) -> Twist:
    return Twist(v * platform.limits.linear, w * platform.limits.angular)


def passes(platform: Platform, scan: Scan, twist: Twist, age: float = 0.0) -> bool:
    """True if a command passes unchanged."""
    safe = decided(platform, scan, twist, age=age).safe
    return math.isclose(safe.linear, twist.linear, abs_tol=1e-9) and math.isclose(
        safe.angular, twist.angular, abs_tol=1e-9
    )


@given(PLATFORM, SHARE, SHARE, st.lists(st.integers(0, RAYS - 1), max_size=20), AGE)
def test_request_passes_bit_by_bit_far_from_obstacles(
    platform: Platform, v: float, w: float, rays: list[int], age: float
) -> None:
    far = platform.scan.range_max - 0.1
    ranges = np.full(RAYS, math.inf)
    ranges[rays] = far
    requested = request_of(platform, v, w)
    decision = decided(
        platform, scan_from(platform, ranges, platform.scan.bearings), requested, age=age
    )
    assert decision.safe == requested
    assert not decision.is_active
    assert decision.rows == ()


@given(PLATFORM, RETURNS, AGE)
def test_zero_request_stays_zero(platform: Platform, returns: Returns, age: float) -> None:
    decision = decided(platform, seeing(platform, returns), ZERO, age=age)
    assert decision.safe == ZERO
    assert not decision.is_active


ANYTHING = st.floats(allow_nan=True, allow_infinity=True)
WILD = st.floats(-1e6, 1e6)


@given(
    st.sampled_from([*PLATFORMS, *AVOIDING]),
    arrays(np.float64, RAYS, elements=st.one_of(st.floats(0.0, 5.0), st.sampled_from(
        [-math.inf, math.inf]))),
    st.builds(Twist, ANYTHING, ANYTHING, ANYTHING),
    st.builds(Odometry, ANYTHING, st.builds(Pose, WILD, WILD, WILD), st.builds(Twist, WILD, WILD)),
    st.floats(0, 10),
)  # fmt: skip
def test_any_input_gives_a_finite_command_within_limits(
    platform: Platform, ranges: Array, requested: Twist, odometry: Odometry, age: float
) -> None:
    protection = Protection(platform)
    clean = np.where(ranges < platform.scan.range_min, -math.inf, ranges)
    clean = np.where(clean > platform.scan.range_max, math.inf, clean)
    scan = scan_from(platform, clean, platform.scan.bearings)
    for at in (5.0, 5.2):
        context = DecisionContext(at, age, odometry, age)
        protection.observe(scan, context)
        safe = protection.decide(
            requested, context, is_running=True, hold=None, permit=Permit(may_recover=True)
        ).safe
        assert safe.is_finite
        assert platform.limits.clip(safe) == safe


SWEEP = st.sampled_from([0.0, 0.05, 0.2, 0.6])  # s
DELAY = st.sampled_from([0.0, 0.1, 0.3])


def sweeping(scan: Scan, seconds: float) -> Scan:
    """The scan as of a sensor that turns once in so many seconds."""
    ages = seconds * (1.0 - (1.0 + np.arange(len(scan.ranges))) / len(scan.ranges))
    return structs.replace(scan, ages=ages) if seconds else scan


def since_seen(platform: Platform, scan: Scan) -> Array:
    """(n,) s between the measurement of each ray and the arrival of the scan."""
    if scan.ages is None:
        return np.full(len(scan.ranges), platform.scan.latency)
    ages: Array = scan.ages + max(platform.scan.latency - scan.ages.mean(), 0.0)
    return ages


@given(
    st.sampled_from([*PLATFORMS, SIDEWAYS, WEAK]), RETURNS, SHARE, SHARE, SHARE, AGE, SWEEP, DELAY
)
@example(WEAK, [(304, 0.35)], 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
@example(BURGER, [(0, 0.2), (5, 0.2)], 1.0, 0.0, 0.0, 0.0, 0.6, 0.0)
@example(JACKAL, [(180, 0.15)], 1.0, 0.0, 0.0, 0.0, 0.2, 0.3)
@example(BURGER, [(0, 0.125)], 0.125, 0.0, 0.0, 0.25, 0.0, 0.3)
def test_robot_can_stop_before_every_return(
    platform: Platform, returns: Returns, v: float, w: float, aside: float, age: float,
    sweep: float, delay: float,
) -> None:  # fmt: skip
    """Checks the equation of the caps for each return, with places found by brute force."""
    settings = platform.protection["barrier"]
    scan, straight = sweeping(seeing(platform, returns), sweep), request_of(platform, v, w)
    requested = Twist(straight.linear, straight.angular, aside * platform.limits.lateral)
    safe = decided(platform, scan, requested, age=age, delay=delay).safe
    speed = np.array([safe.linear, safe.lateral])
    requested_velocity = np.array([requested.linear, requested.lateral])
    along = (
        requested_velocity / np.hypot(*requested_velocity)
        if requested_velocity.any()
        else np.array([1.0, 0.0])
    )
    free = settings["margin"] + settings["unseen_extent"]
    may_creep = 0.0 < abs(requested.linear) <= SLOW_REQUEST
    ages = since_seen(platform, scan)[np.isfinite(scan.ranges)] + age + delay
    for point, unseen in zip(points(platform, scan), ages, strict=True):
        gap, at, towards = outline_point(platform.footprint, point)
        if gap == 0.0:
            continue
        lever = at[0] * towards[1] - at[1] * towards[0]
        closing = float(speed @ towards) + safe.angular * lever
        braking = abs(float(along @ towards)) * settings["braking_linear"]
        braking = max(braking + abs(lever) * settings["braking_angular"], 0.02)
        own = closing * TICK + closing**2 / (2.0 * braking)
        theirs = settings["others_speed"] * (unseen + TICK + closing / braking)
        if may_creep and closing <= CREEP_SPEED + 1e-9:
            continue  # creeping has a bound of its own (envelope.py)
        assert closing <= 1e-9 or own + theirs <= gap - free + 1e-9


@given(
    st.sampled_from([*VARIANTS, SIDEWAYS, WEAK]), RETURNS, SHARE, SHARE, SHARE, AGE, SWEEP, DELAY,
    st.lists(st.builds(ToldObstacle, SHARE, SHARE, st.floats(0, 0.4), AGE), max_size=2),
)  # fmt: skip
def test_every_setting_decides_alike_compiled_and_interpreted(
    platform: Platform, returns: Returns, v: float, w: float, aside: float, age: float,
    sweep: float, delay: float, told: list[ToldObstacle],
) -> None:  # fmt: skip
    """`decided` compares both paths."""
    scan, straight = sweeping(seeing(platform, returns), sweep), request_of(platform, v, w)
    requested = Twist(straight.linear, straight.angular, aside * platform.limits.lateral)
    safe = decided(platform, scan, requested, age=age, delay=delay, told=tuple(told)).safe
    assert platform.limits.clip(safe) == safe


@given(PLATFORM, NEAR_RETURNS, SHARE, SHARE)
def test_corners_can_stop_before_the_unseen_extent(
    platform: Platform, returns: Returns, v: float, w: float
) -> None:
    """Not only the nearest place of the outline can touch the unseen part of an obstacle.

    A robot that is asked for little may creep towards it, at a speed that is no fault.
    """
    settings = platform.protection["barrier"]
    scan = seeing(platform, returns)
    safe = decided(platform, scan, request_of(platform, v, w)).safe
    free = settings["margin"] + settings["unseen_extent"]
    for point in points(platform, scan):
        if not 0.0 < outline_point(platform.footprint, point)[0] <= 2.0 * free:
            continue
        for corner in platform.footprint:
            distance = float(np.hypot(*(point - corner)))
            towards = (point - corner) / distance
            lever = float(corner[0] * towards[1] - corner[1] * towards[0])
            closing = safe.linear * float(towards[0]) + safe.angular * lever
            braking = abs(float(towards[0])) * settings["braking_linear"]
            braking = max(braking + abs(lever) * settings["braking_angular"], 0.02)
            own = closing * TICK + closing**2 / (2.0 * braking)
            theirs = settings["others_speed"] * (platform.scan.latency + TICK + closing / braking)
            assert closing <= CREEP_SPEED + 1e-9 or own + theirs <= distance - free + 1e-9


FACES = st.lists(
    st.tuples(st.floats(0.0, 0.5), st.sampled_from([0.0, 90.0, 180.0, 270.0, 45.0, 200.0])),
    min_size=1,
    max_size=3,
)


def beside(platform: Platform, faces: Sequence[tuple[float, float]], more: Returns = ()) -> Scan:
    """A scan of endless walls, each at a gap in m and in a direction in degrees, and of returns."""
    ranges = np.full(len(platform.scan.bearings), math.inf)
    for ray, share in more:
        ranges[ray] = platform.scan.range_min + 2.0 * share if share >= 0.0 else -math.inf
    for gap, direction in faces:
        way = np.array([math.cos(math.radians(direction)), math.sin(math.radians(direction))])
        distance = float((platform.footprint @ way).max() + gap - way @ platform.scan.offset)
        bearings = platform.scan.bearings
        towards = np.cos(bearings - math.radians(direction))
        seen = np.where(towards > 1e-3, distance / np.maximum(towards, 1e-3), math.inf)
        ranges = np.minimum(ranges, seen)
    ranges[ranges > platform.scan.range_max] = math.inf
    ranges[ranges < platform.scan.range_min] = -math.inf
    return scan_from(platform, ranges, platform.scan.bearings)


CREEPING = [
    under_barrier(load_platform(name))
    for name in ("burger", "waffle_pi", "turtlebot4", "rosbot_xl")
]
VISIBLE = [under_barrier(one, unseen_extent=0.0) for one in CREEPING]


@given(st.sampled_from([*CREEPING, *VISIBLE]), FACES, NEAR_RETURNS, SHARE, SHARE, SHARE, AGE)
@example(CREEPING[2], [(0.05, 270.0)], [], 1.0, 0.0, 0.0, 0.0)
@example(CREEPING[2], [(0.05, 270.0)], [(3, 0.05)], 1.0, 0.0, 0.0, 0.0)
@example(CREEPING[0], [(0.005, 270.0), (0.01, 90.0)], [(0, 0.0)], 1.0, 0.0, 0.0, 0.0)
@example(CREEPING[3], [(0.05, 270.0), (0.05, 0.0)], [], 1.0, 1.0, 1.0, 0.1)
def test_what_may_touch_is_approached_at_creep_speed_by_each_place(
    platform: Platform, faces: list[tuple[float, float]], returns: Returns, v: float, w: float,
    aside: float, age: float,
) -> None:  # fmt: skip
    """The claim is 2 cm/s (docs/safety.md). Contacts and locked robots creep together, too.

    Either no corner moves faster than CREEP_SPEED, so that no place of the outline does; or the
    robot can stop before each return, and none is so near that it may touch unseen.
    """
    settings = platform.protection["barrier"]
    scan = beside(platform, faces, returns)
    straight = request_of(platform, v, w)
    requested = Twist(straight.linear, straight.angular, aside * platform.limits.lateral)
    safe = decided(platform, scan, requested, age=age).safe
    fastest = max(
        math.hypot(safe.linear - safe.angular * y, safe.lateral + safe.angular * x)
        for x, y in platform.footprint.tolist()
    )
    if fastest <= CREEP_SPEED + 1e-9:
        return
    assert not np.isneginf(scan.ranges).any()  # a contact: the slow envelope holds
    along = np.array([requested.linear, requested.lateral])
    along = along / np.hypot(*along) if along.any() else np.array([1.0, 0.0])
    free = settings["margin"] + settings["unseen_extent"]
    unseen = platform.scan.latency + age
    for point in points(platform, scan):
        gap, at, towards = outline_point(platform.footprint, point)
        assert gap > free
        closing = closing_speed(safe, at, towards)
        lever = float(at[0] * towards[1] - at[1] * towards[0])
        braking = abs(float(along @ towards)) * settings["braking_linear"]
        braking = max(braking + abs(lever) * settings["braking_angular"], 0.02)
        own = closing * TICK + closing**2 / (2.0 * braking)
        theirs = settings["others_speed"] * (unseen + TICK + closing / braking)
        assert closing <= 1e-9 or own + theirs <= gap - free + 1e-9


@given(st.sampled_from([*CREEPING, *VISIBLE]), FACES, NEAR_RETURNS, SHARE, SHARE, SHARE, SHARE, AGE)
@example(CREEPING[0], [(0.046, 158.8)], [], 0.92, 0.0, 0.07, 0.51, 0.0)
@example(CREEPING[1], [(0.0449, 200.0)], [], -1.0, 0.0, 0.4, -0.01, 0.0)
def test_a_decision_does_not_depend_on_what_was_judged_before(
    platform: Platform, faces: list[tuple[float, float]], returns: Returns, before: float,
    before_turn: float, v: float, w: float, age: float,
) -> None:  # fmt: skip
    """Steering asks for several commands in one situation; a robot in contact stays slow."""
    scan, requested = beside(platform, faces, returns), request_of(platform, v, w)
    geometry = ScanGeometry(platform.scan)
    for form in FORMS:
        barriers = form.Barrier(platform), form.Barrier(platform)
        context = DecisionContext(10.0 + age, age, Odometry(10.0 + age, Pose(), ZERO), 0.0)
        for barrier in barriers:
            first = DecisionContext(10.0, 0.0, Odometry(10.0, Pose(), ZERO), 0.0)
            barrier.observe(scan, geometry, first)
        barriers[1].decide(request_of(platform, before, before_turn), context, ZERO, None)
        fresh, later = (one.decide(requested, context, ZERO, None).twist for one in barriers)
        assert (later.linear, later.angular) == pytest.approx(
            (fresh.linear, fresh.angular), abs=1e-12, rel=0.0
        )


@pytest.mark.parametrize("platform", CREEPING, ids=lambda one: one.name)
@pytest.mark.parametrize("direction", [90.0, 270.0])
def test_a_robot_beside_a_wall_creeps_along_it(platform: Platform, direction: float) -> None:
    """It is locked: a turn swings a corner in, and a straight line closes on returns ahead."""
    scan = beside(platform, [(0.1, direction)])
    for v in (1.0, -1.0):
        safe = decided(platform, scan, request_of(platform, v, 0.0)).safe
        assert safe.linear == pytest.approx(v * CREEP_SPEED, rel=1e-6)
        assert safe.angular == pytest.approx(0.0, abs=1e-9)
    assert decided(platform, scan, ZERO).safe == ZERO


@pytest.mark.parametrize("platform", CREEPING[1:], ids=lambda one: one.name)
def test_a_creeping_robot_keeps_off_the_wall(platform: Platform) -> None:
    """A corner of a robot that turns closes on the wall no longer, once the wall is at 1 cm."""
    turn = request_of(platform, 0.0, 1.0)
    away, near = (
        decided(platform, beside(platform, [(gap, 270.0)]), turn).safe for gap in (0.1, 0.01)
    )
    assert away.angular > 0.0
    assert near.angular == pytest.approx(0.0, abs=1e-6)


def test_only_a_locked_robot_creeps_at_a_wall() -> None:
    """A robot with its nose at a wall may back off, and so it does not creep on."""
    robot = CREEPING[2]
    scan = beside(robot, [(0.1, 0.0)])
    assert decided(robot, scan, Twist(0.2)).safe.linear <= 1e-9
    assert decided(robot, scan, Twist(-0.2)).safe.linear == pytest.approx(-CREEP_SPEED)


@pytest.mark.parametrize("half", [30.0, 45.0])
@pytest.mark.parametrize("robot", CREEPING[1:3], ids=lambda one: one.name)
def test_a_creeping_robot_does_not_touch_an_edge(robot: Platform, half: float) -> None:
    """The mean place of the returns of an edge that points at the robot is behind the edge."""
    width = 0.8 * math.tan(math.radians(half))
    edge = np.array([[0.0, 0.0], [0.8, -width], [0.8, width]])
    (rear, _), (front, side) = robot.footprint.min(axis=0), robot.footprint.max(axis=0)
    shapes = (
        Shape(edge, Pose(front + 0.04, 0.0, 0.0)),
        box(0.2, 6.0, Pose(rear - 0.15, 0.0, 0.0)),
        box(6.0, 0.2, Pose(0.0, side + 0.15, 0.0)),
    )
    run = FilterSim(robot, shapes).run(Twist(robot.limits.linear), 8.0)
    assert run.touch is None
    assert run.min_gap < 0.02


@pytest.mark.parametrize("width", [0.25, 0.4])
def test_only_a_wide_surface_may_be_closed_on(width: float) -> None:
    """What is narrower may be the head of a robot, whose body reaches farther unseen."""
    robot = CREEPING[2]
    walls = beside(robot, [(0.1, 270.0)])  # locks it
    x = 0.5 * width * np.linspace(-1.0, 1.0, 200)
    place = np.stack((x + 0.3, np.full(200, 0.17 + 0.15)), axis=1) - robot.scan.offset
    ranges = walls.ranges.copy()
    rays = np.round(np.degrees(np.arctan2(place[:, 1], place[:, 0]))).astype(int) % RAYS
    ranges[rays] = np.minimum(ranges[rays], np.hypot(*place.T))
    safe = decided(robot, scan_from(robot, ranges, robot.scan.bearings), Twist(0.2)).safe
    assert (safe.linear > 0.01) is (width > 0.3)


@pytest.mark.parametrize(
    ("longest_peer", "kept"), [(0.0, 0.0125), (0.27, 0.0125), (0.29, 0.0425), (math.inf, 0.0425)]
)
@pytest.mark.parametrize(("gap", "most"), [(0.07, 0.015), (0.046, 0.007), (0.03, 0.0)])
def test_a_surface_that_may_be_a_peer_is_closed_on_less_near(
    gap: float, most: float, longest_peer: float, kept: float
) -> None:
    """By 3 cm: a box of 0.4 m ahead, beside a wall that locks the robot.

    A peer of a diagonal of 0.283 m may fill a box whose own diagonal is 0.4 m.
    `most`: m/s, what (gap - 0.0425 m) / 0.5 s gives, and CREEP_SPEED at most.
    """
    robot = CREEPING[2]
    front = float(robot.footprint[:, 0].max())
    wall = beside(robot, [(0.1, 270.0)])
    box = np.stack((np.full(400, front + gap), np.linspace(-0.2, 0.2, 400)), axis=1)
    place = box - robot.scan.offset
    ranges = wall.ranges.copy()
    rays = np.round(np.degrees(np.arctan2(place[:, 1], place[:, 0]))).astype(int) % RAYS
    ranges[rays] = np.minimum(ranges[rays], np.hypot(*place.T))
    scan = scan_from(robot, ranges, robot.scan.bearings)
    safe = decided(robot, scan, Twist(0.2), longest_peer=longest_peer).safe
    wanted = most if kept > 0.02 else 0.015
    assert safe.linear == pytest.approx(wanted, abs=2e-4)


@pytest.mark.parametrize("turned", [40.0, 45.0, 50.0])
@pytest.mark.parametrize("name", ["turtlebot4", "waffle_pi", "rosbot_xl"])
def test_the_corner_of_a_peer_is_not_closed_on(name: str, turned: float) -> None:
    """The box around a peer that is turned is wider than the peer, but its returns are one body's.

    The corner is 2.5 cm ahead, and the mean place of its returns is at most 1.3 cm farther: less
    than the 4.25 cm to which a locked robot may close on a peer.
    """
    robot = under_barrier(load_platform(name))
    front = float(robot.footprint[:, 0].max())
    corners = robot.footprint - robot.footprint.mean(axis=0)
    yaw = math.radians(turned)
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    body = corners @ turn.T
    nearest = body[body[:, 0].argmin()]
    peer = body - nearest + np.array([front + 0.025, 0.0])
    sides = [np.linspace(peer[i - 1], peer[i], 400) for i in range(4)]
    place = np.concatenate(sides) - robot.scan.offset
    bearings = robot.scan.bearings
    spacing = 2.0 * math.pi / len(bearings)
    rays = np.round(np.arctan2(place[:, 1], place[:, 0]) / spacing).astype(int) % len(bearings)
    ranges = beside(robot, [(0.15, 270.0)]).ranges.copy()  # locks it
    np.minimum.at(ranges, rays, np.hypot(*place.T))
    scan = scan_from(robot, ranges, bearings)
    ahead = Twist(robot.limits.linear)
    diagonal = 2.0 * float(np.hypot(*robot.footprint.T).max())
    assert decided(robot, scan, ahead, longest_peer=diagonal).safe.linear <= 1e-9
    assert decided(robot, scan, ahead).safe.linear > 0.005


@pytest.mark.parametrize("pause", [0.0, 0.001])
def test_a_peer_that_is_heard_later_counts_in_the_same_scan(pause: float) -> None:
    """The gaps to wide surfaces are found once for each scan, and anew for another peer.

    So is the decision, which is repeated for the same request at the same instant.
    """
    robot = CREEPING[2]
    scan = beside(robot, [(0.03, 270.0), (0.03, 0.0)])
    geometry = ScanGeometry(robot.scan)
    for form in FORMS:
        barrier = form.Barrier(robot)
        context = DecisionContext(10.0, 0.0, Odometry(10.0, Pose(), ZERO), 0.0)
        barrier.observe(scan, geometry, context)
        found = []
        for number, longest_peer in enumerate((0.0, math.inf, 0.0)):
            barrier.hear(longest_peer)
            at = 10.0 + pause * number
            later = DecisionContext(at, at - 10.0, Odometry(at, Pose(), ZERO), 0.0)
            found.append(barrier.decide(Twist(0.2), later, ZERO, None).twist.linear)
        assert found[0] > 0.01
        assert found[1] == pytest.approx(0.0, abs=1e-9)
        assert found[2] > 0.01


POLES = st.lists(
    st.tuples(st.floats(0.0, 0.12), st.floats(0.0, 360.0), st.floats(0.02, 0.15)),
    min_size=1,
    max_size=1,
)
PART_SPEED, PART_GAP, PART_TIME = 0.004, 0.0125, 0.5  # of docs/evidence/barrier.md


def beside_poles(platform: Platform, poles: Sequence[tuple[float, float, float]]) -> Scan:
    """A scan of poles, each at a gap in m and in a direction in degrees, of a radius in m."""
    bearings = platform.scan.bearings
    rays = np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
    ranges = np.full(len(bearings), math.inf)
    for gap, direction, radius in poles:
        way = np.array([math.cos(math.radians(direction)), math.sin(math.radians(direction))])
        centre = way * (float((platform.footprint @ way).max()) + gap + radius)
        along = rays @ (centre - platform.scan.offset)
        across = np.sum((centre - platform.scan.offset) ** 2) - along**2
        depth = np.sqrt(np.maximum(radius**2 - across, 0.0))
        is_hit = (across < radius**2) & (along > 0.0)
        ranges = np.where(is_hit, np.minimum(ranges, along - depth), ranges)
    ranges[ranges < platform.scan.range_min] = -math.inf
    return scan_from(platform, ranges, bearings)


HEARD = st.sampled_from([0.0, 0.3, math.inf])


@given(st.sampled_from([*CREEPING, *VISIBLE]), POLES, SHARE, SHARE, SHARE, AGE, HEARD)
@example(CREEPING[0], [(0.05, 90.0, 0.15)], 1.0, 0.0, 0.0, 0.0, 0.0)
@example(CREEPING[0], [(0.05, 90.0, 0.15)], 0.0, 1.0, 0.0, 0.0, 0.0)
@example(CREEPING[0], [(0.05, 90.0, 0.15)], 0.4, 1.0, 0.0, 0.0, 0.0)
@example(CREEPING[0], [(0.0131, 90.0, 0.15)], -1.0, 0.0, 0.0, 0.0, 0.0)
@example(CREEPING[0], [(0.02, 90.0, 0.15)], 1.0, 0.0, 0.0, 0.1, 0.0)
@example(CREEPING[0], [(0.05, 90.0, 0.15)], 1.0, 0.0, 0.0, 0.0, 0.3)
@example(CREEPING[0], [(0.02, 90.0, 0.15)], 0.4, 1.0, 0.0, 0.0, math.inf)
def test_the_nearest_place_hardly_closes_on_a_narrow_obstacle_that_may_touch(
    platform: Platform, poles: list[tuple[float, float, float]], v: float, w: float, aside: float,
    age: float, longest_peer: float,
) -> None:  # fmt: skip
    """Nor nearer than 1.25 cm to what the scan shows, whatever holds the robot.

    Among peers not at all: the obstacle may be the head of one.
    """
    settings = platform.protection["barrier"]
    scan = beside_poles(platform, poles)
    straight = request_of(platform, v, w)
    requested = Twist(straight.linear, straight.angular, aside * platform.limits.lateral)
    safe = decided(platform, scan, requested, age=age, longest_peer=longest_peer).safe
    for point in points(platform, scan):
        gap, at, towards = outline_point(platform.footprint, point)
        if gap <= settings["margin"] + settings["unseen_extent"]:
            allowed = min(max((gap - PART_GAP) / PART_TIME, 0.0), PART_SPEED)
            allowed = 0.0 if longest_peer > 0.0 else allowed
            assert closing_speed(safe, at, towards) <= allowed + 1e-9


@pytest.mark.parametrize(
    ("gap", "closing"), [(0.012, 0.0), (0.0126, 0.0002), (0.0129, 0.0008), (0.0135, 0.002)]
)
@pytest.mark.parametrize("platform", CREEPING[1:], ids=lambda one: one.name)
def test_a_locked_robot_stops_before_a_narrow_obstacle_ahead(
    platform: Platform, gap: float, closing: float
) -> None:
    """At 1.25 cm, which it nears in 0.5 s: (gap - 0.0125 m) / 0.5 s. A pole behind locks it."""
    scan = beside_poles(platform, [(0.0126, 135.0, 0.05), (gap, 0.0, 0.02)])
    safe = decided(platform, scan, request_of(platform, 1.0, 0.0)).safe
    assert safe.linear == pytest.approx(closing, abs=1e-7)
    assert safe.angular == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("direction", [90.0, 270.0])
def test_a_robot_beside_a_pole_leaves_it(direction: float) -> None:
    """Along the flank of a Burger: its normals forbid both turns, those at the ends both ways."""
    scan = beside_poles(BURGER, [(0.05, direction, 0.15)])
    for v in (1.0, -1.0):
        safe = decided(BURGER, scan, request_of(BURGER, v, 0.0)).safe
        assert abs(safe.linear) > 0.005
        held = decided(BURGER, scan, request_of(BURGER, v, 0.0), longest_peer=0.3).safe
        assert held.linear == pytest.approx(0.0, abs=1e-9)
    assert decided(BURGER, scan, ZERO).safe == ZERO


@pytest.mark.parametrize(("index", "gap"), [(0, 0.122), (1, 0.192), (2, 0.272)])
def test_a_locked_robot_with_a_slow_request_is_no_slower(index: int, gap: float) -> None:
    """Just beyond contact creeping by a slow request has a lower cap than creeping out."""
    robot = CREEPING[index]
    scan = beside(robot, [(gap, 270.0)])
    for speed in (robot.limits.linear, 0.04):
        safe = decided(robot, scan, Twist(speed)).safe
        assert safe.linear == pytest.approx(CREEP_SPEED, rel=1e-6)


@pytest.mark.parametrize("turn", [2.5, -2.5])
def test_a_slow_robot_creeps_only_if_that_is_nearer_to_the_request(turn: float) -> None:
    """No corner of a creeping robot is faster than 15 mm/s: a Burger would turn at 0.11 rad/s."""
    scan = beside(BURGER, [(0.334, 100.0)])
    alone = decided(BURGER, scan, Twist(0.0, turn)).safe.angular
    slow = decided(BURGER, scan, Twist(0.01, turn)).safe
    assert abs(alone) > 1.0
    assert slow.angular == pytest.approx(alone, rel=0.1)
    assert slow.linear == pytest.approx(0.01, abs=1e-3)


def test_a_told_obstacle_and_a_circle_keep_a_robot_from_creeping_out() -> None:
    """What is not seen where it is may be anywhere within its disc."""
    robot = CREEPING[2]
    ahead = Twist(0.2)
    scan = beside(robot, [(0.1, 270.0)])
    told = (ToldObstacle(0.0, 1.0, 0.3, 0.0),)
    assert decided(robot, scan, ahead).safe.linear == pytest.approx(CREEP_SPEED)
    assert decided(robot, scan, ahead, told=told).safe == ZERO
    assert decided(under_barrier(robot, keep_out=0.3), scan, ahead).safe == ZERO


def test_a_flank_in_contact_lets_a_robot_go_ahead_and_back() -> None:
    """The rays to a robot beside it: ahead closes on the first ones, back on the last ones."""
    robot = VISIBLE[0]
    scan = seeing(robot, [(ray, -1.0) for ray in range(55, 106)])
    for speed in (0.22, -0.22):
        safe = decided(robot, scan, Twist(speed)).safe
        assert safe.linear == pytest.approx(math.copysign(CREEP_SPEED, speed), rel=1e-6)
        assert safe.angular == pytest.approx(0.0, abs=1e-9)
    for turn in (1.0, -1.0):  # the flank reaches from behind the axle to before it
        assert decided(robot, scan, Twist(0.0, turn)).safe.angular == pytest.approx(0.0, abs=1e-9)


def points(platform: Platform, scan: Scan) -> list[Array]:
    """The returns as points in the base frame."""
    return [
        platform.scan.offset + distance * np.array([math.cos(bearing), math.sin(bearing)])
        for bearing, distance in zip(scan.bearings, scan.ranges, strict=True)
        if math.isfinite(distance)
    ]


@given(PLATFORM, st.integers(0, RAYS - 1), SHARE, SHARE)
@example(BURGER, 1, 1.0, 0.0)
def test_only_creeps_along_a_ray_too_close_to_measure(
    platform: Platform, ray: int, v: float, w: float
) -> None:
    """A contact forbids to close across the outline, and to close faster along its ray.

    With 0 along the ray too, a flank in contact holds robots side by side for good.
    """
    scan = seeing(platform, [(ray, -1.0)])
    safe = decided(platform, scan, request_of(platform, v, w)).safe
    bearing = float(platform.scan.bearings[ray])
    way = np.array([math.cos(bearing), math.sin(bearing)])
    at = edge_along(platform, way)
    assert closing_speed(safe, at, way) <= CREEP_SPEED + 1e-9
    sides = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    across = [
        side
        for side in sides
        if abs(float((platform.footprint @ side).max() - at @ side)) < 1e-9  # the edge of the ray
    ]
    if len(across) == 1:  # not at a corner
        assert closing_speed(safe, at, across[0]) <= 1e-9


def closing_speed(command: Twist, at: Array, way: Array) -> float:
    """The speed in m/s along `way` of a place of the outline."""
    lever = float(at[0] * way[1] - at[1] * way[0])
    return (
        command.linear * float(way[0]) + command.lateral * float(way[1]) + command.angular * lever
    )


def edge_along(platform: Platform, way: Array) -> Array:
    """Where a ray from the sensor leaves the outline, by bisection."""
    inside, outside = 0.0, 2.0
    for _ in range(60):
        middle = 0.5 * (inside + outside)
        point = platform.scan.offset + middle * way
        is_inside = outline_point(platform.footprint, point)[0] == 0.0
        inside, outside = (middle, outside) if is_inside else (inside, middle)
    edge: Array = platform.scan.offset + inside * way
    return edge


def passes_as_creeping(
    platform: Platform, scan: Scan, requested: Twist, safe: Twist, age: float
) -> bool:
    """True if the safe command of a request passes, or only turns a robot that may creep.

    A robot creeps by a request for a slow speed, and its turn may be more than one without speed
    gets.
    """
    is_slow = 0.0 < abs(requested.linear) <= SLOW_REQUEST
    return passes(platform, scan, safe, age) or (is_slow and safe.linear == 0.0)


@given(PLATFORM, RETURNS, SHARE, SHARE, AGE, st.sampled_from([0.05, 0.2, 0.6]))
@example(PLATFORMS[0], [(0, 0.0625)], 0.125, 1.0, 0.25, 0.05)
def test_older_rays_never_allow_more(
    platform: Platform, returns: Returns, v: float, w: float, age: float, sweep: float
) -> None:
    scan, requested = seeing(platform, returns), request_of(platform, v, w)
    later = max(platform.scan.latency - since_seen(platform, sweeping(scan, sweep)).min(), 0.0)
    safe = decided(platform, sweeping(scan, sweep), requested, age=age + later).safe
    assert passes_as_creeping(platform, scan, requested, safe, age)
    assert decided(
        platform, structs.replace(scan, ages=np.zeros(RAYS)), requested, age=age
    ) == decided(platform, scan, requested, age=age)


@given(PLATFORM, RETURNS, SHARE, SHARE, DELAY)
def test_scan_that_is_late_is_as_old_as_one_that_waited(
    platform: Platform, returns: Returns, v: float, w: float, delay: float
) -> None:
    """Where the envelope holds in both: see the next test."""
    scan, requested = seeing(platform, [*returns, (RAYS // 2, 0.1)]), request_of(platform, v, w)
    late, waited = (
        decided(platform, scan, requested, age=age, delay=delay - age).safe for age in (0.0, delay)
    )
    assert (late.linear, late.angular) == pytest.approx((waited.linear, waited.angular), abs=1e-9)


@pytest.mark.parametrize("delay", [0.2, 0.3, 0.4])
def test_envelope_begins_farther_away_after_a_late_scan(delay: float) -> None:
    """By what obstacles move in its delay; that a scan waits until it is stale counts already."""
    platform = load_platform("waffle_pi")
    scan, requested = seeing(platform, [(0, 0.5)]), request_of(platform, 0.0, 1.0)
    late, waited = (
        decided(platform, scan, requested, age=age, delay=delay - age).safe for age in (0.0, delay)
    )
    assert late.angular == pytest.approx(1.604, abs=1e-3)
    assert waited == requested


@pytest.mark.parametrize("form", FORMS, ids=["text", "used"])
@pytest.mark.parametrize(("later", "drives"), [(-0.05, False), (0.05, True)])
def test_only_a_scan_that_is_newer_frees_an_obstacle(form: Any, later: float, drives: bool) -> None:
    """A scan that was held back shows what was there before; `later`: s after the first scan."""
    barrier, geometry = form.Barrier(BURGER), ScanGeometry(BURGER.scan)
    for seen, now, age in (
        (beside(BURGER, [(0.12, 0.0)]), 10.0, 0.0),
        (seeing(BURGER, []), 10.2, 0.2 - later),
    ):
        context = DecisionContext(now, age, Odometry(now, Pose(), ZERO), 0.0)
        barrier.observe(seen, geometry, context)
    safe = barrier.decide(Twist(0.1), context, ZERO, None).twist
    assert (safe.linear == 0.1) == drives
    assert drives or safe.linear < 0.01


@given(PLATFORM, RETURNS, SHARE, SHARE, AGE)
def test_safe_command_is_feasible_again(
    platform: Platform, returns: Returns, v: float, w: float, age: float
) -> None:
    scan = seeing(platform, returns)
    safe = decided(platform, scan, request_of(platform, v, w), age=age).safe
    assert passes_as_creeping(platform, scan, request_of(platform, v, w), safe, age)


@given(PLATFORM, RETURNS, RETURNS, SHARE, SHARE, AGE)
def test_more_returns_never_allow_more(
    platform: Platform, returns: Returns, more: Returns, v: float, w: float, age: float
) -> None:
    taken = {ray for ray, _ in returns}
    both = [*returns, *(one for one in more if one[0] not in taken)]
    safe = decided(platform, seeing(platform, both), request_of(platform, v, w), age=age).safe
    scan = seeing(platform, returns)
    assert passes_as_creeping(platform, scan, request_of(platform, v, w), safe, age)


@given(PLATFORM, RETURNS, SHARE, SHARE, AGE)
def test_mirrored_scan_gives_the_mirrored_command(
    platform: Platform, returns: Returns, v: float, w: float, age: float
) -> None:
    scan, requested = seeing(platform, returns), request_of(platform, v, w)
    safe = decided(platform, scan, requested, age=age).safe
    other = decided(
        platform, mirrored(scan), Twist(requested.linear, -requested.angular), age=age
    ).safe
    assert other.linear == pytest.approx(safe.linear, abs=1e-9)
    assert other.angular == pytest.approx(-safe.angular, abs=1e-9)


@given(PLATFORM, RETURNS, SHARE, SHARE, st.integers(0, 1000))
def test_order_and_repetition_of_rays_do_not_matter(
    platform: Platform, returns: Returns, v: float, w: float, seed: int
) -> None:
    scan, requested = seeing(platform, returns), request_of(platform, v, w)
    safe = decided(platform, scan, requested).safe
    ranges, bearings = np.tile(scan.ranges, 2), np.tile(scan.bearings, 2)
    twice = structs.replace(scan, ranges=ranges, bearings=bearings, ages=None)
    for changed in (reordered(scan, np.random.default_rng(seed)), twice):
        other = decided(platform, changed, requested).safe
        assert other.linear == pytest.approx(safe.linear, abs=1e-9)
        assert other.angular == pytest.approx(safe.angular, abs=1e-9)


@given(PLATFORM, RETURNS, SHARE, SHARE)
def test_surface_speed_holds_near_every_obstacle(
    platform: Platform, returns: Returns, v: float, w: float
) -> None:
    scan = seeing(platform, [*returns, (0, 0.1)])
    safe = decided(platform, scan, request_of(platform, v, w)).safe
    speeds = [
        math.hypot(safe.linear - safe.angular * y, safe.angular * x) for x, y in platform.footprint
    ]
    assert max(speeds) <= platform.protection["barrier"]["others_speed"] + 1e-9


@pytest.mark.parametrize("bearing", [0, 30, 150, 180])
def test_a_limiting_obstacle_has_its_age_and_what_the_age_costs(bearing: int) -> None:
    platform = under_barrier(BURGER, unseen_extent=0.0)
    assumed = barrier_settings(platform)
    assert assumed is not None
    scan = seeing(platform, [(bearing, 0.05)])
    requested = request_of(platform, math.copysign(1.0, math.cos(math.radians(bearing))), 0.0)
    first, later = (decided(platform, scan, requested, age=age).rows[0] for age in (0.0, 0.04))
    assert later.age is not None
    assert first.age is not None
    assert later.age - first.age == pytest.approx(0.04)
    assert 0.0 < first.age_cost < later.age_cost
    # Both costs lead to the cap of a return that is seen at the time of the decision.
    seen_now = first.cap + first.age_cost
    assert later.cap + later.age_cost == pytest.approx(seen_now)
    if bearing == 0:
        room = first.gap - assumed.margin
        assert seen_now == pytest.approx(
            closing_cap(room, assumed.braking_linear, assumed.others_speed, REACTION_TIME)
        )


@given(PLATFORM, RETURNS, SHARE, SHARE)
def test_reported_constraints_are_sorted_by_cap(
    platform: Platform, returns: Returns, v: float, w: float
) -> None:
    scan = seeing(platform, returns)
    decision = decided(platform, scan, request_of(platform, v, w))
    nearest = Footprint(platform.footprint).nearest(scan, ScanGeometry(platform.scan))
    assert decision.min_gap == (None if nearest is None else pytest.approx(nearest[0], abs=1e-12))
    caps = [row.cap for row in decision.rows]
    assert caps == sorted(caps)
    assert all(row.gap >= 0.0 <= row.cap for row in decision.rows)
    assert decision.is_active or not caps


@given(PLATFORM, RETURNS, SHARE, SHARE, st.floats(-3, 3), st.floats(0.05, 1.0), st.floats(0, 0.3))
@example(WAFFLE, [(55, 0.224609375)], 1.0, 1.0, 3.0, 1.0, 0.0)
def test_touch_zone_frees_only_its_sector(
    platform: Platform, returns: Returns, v: float, w: float, bearing: float, half: float,
    speed: float,
) -> None:  # fmt: skip
    zone = TouchZone(bearing, half, speed)
    scan, requested = seeing(platform, returns), request_of(platform, v, w)
    without = decided(platform, scan, requested).safe
    creeps = slowed(platform, without, 1.001 * CREEP_SPEED) == without != ZERO
    assume(not creeps)  # what may be touched keeps a locked robot from creeping out
    slow = slowed(platform, without, speed)
    while not passes(platform, scan, slow):  # slower, its stop is another one
        slow = slowed(platform, decided(platform, scan, slow).safe, 0.9 * speed)
        speed *= 0.9
    again = decided(platform, scan, slow, touch=zone).safe
    assert (again.linear, again.angular) == pytest.approx((slow.linear, slow.angular))
    outside = [one for one in returns if not within(platform, scan, one[0], zone)]
    freed = decided(platform, scan, requested, touch=zone).safe
    assert passes(platform, seeing(platform, outside), freed)


def slowed(platform: Platform, twist: Twist, speed: float) -> Twist:
    """The twist, slowed until no corner of the outline is faster than `speed`."""
    v, w = twist.linear, twist.angular
    fastest = max(math.hypot(v - w * y, w * x) for x, y in platform.footprint)
    share = min(1.0, speed / fastest) if fastest else 1.0
    return Twist(share * v, share * w)


def within(platform: Platform, scan: Scan, ray: int, zone: TouchZone) -> bool:
    """True if the return of a ray lies in the sector of the zone, or almost."""
    bearing = scan.bearings[ray]
    way = np.array([math.cos(bearing), math.sin(bearing)])
    is_seen = math.isfinite(scan.ranges[ray])
    place = platform.scan.offset + scan.ranges[ray] * way if is_seen else edge_along(platform, way)
    outline = outline_of(platform.footprint, platform.scan.offset)
    x, y = separation(outline, *place.tolist()).direction
    off = math.remainder(math.atan2(y, x) - zone.bearing, 2.0 * math.pi)
    return abs(off) <= zone.half_width + 1e-6
