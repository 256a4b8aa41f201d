"""Constraints: limits, caps, binding range, envelope, side constraints, touch zones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from swarmd.core.clock import TICK
from swarmd.core.values import ZERO, Array, Limits, Odometry, Platform, Pose, Scan, TouchZone, Twist
from swarmd.robot.protection.barrier_assumptions import SIDE_RESERVE
from swarmd.robot.protection.binding_range import REACTION_TIME, BindingRange
from swarmd.robot.protection.closing_speed import CREEP_SPEED
from swarmd.robot.protection.compatibility import barrier_settings
from swarmd.robot.protection.constraints import linear_limit
from swarmd.robot.protection.decision import DecisionContext, ToldObstacle
from swarmd.robot.protection.footprint import ScanGeometry
from swarmd.robot.protection.modes import Mode
from swarmd.robot.protection.touch_zone import touch_directions
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import scan_from
from tests.support.barrier_parts import (
    braking,
    closing_cap,
    envelope,
    nearest,
    nearest_feasible,
    outline_of,
    part,
    reciprocal_cap,
    separation,
    wall_cap,
)
from tests.support.filter_sim import decided, under_barrier
from tests.support.kernel_forms import interpreted

KERNEL = "swarmd.robot.protection.barrier"
OF_C = "a part is asked alone"
if TYPE_CHECKING:
    from swarmd.robot.protection.barrier import Barrier
else:
    Barrier = interpreted(KERNEL, because="a method of C is replaced, fields are read").Barrier


@pytest.mark.parametrize(
    ("degrees", "limit"), [(0.0, 0.5), (180.0, 0.5), (90.0, 0.2), (-90.0, 0.2), (45.0, 0.2828)]
)
def test_linear_limit_of_a_direction(degrees: float, limit: float) -> None:
    along = (math.cos(math.radians(degrees)), math.sin(math.radians(degrees)))
    assert linear_limit(Limits(0.5, 2.0, 0.2), *along) == pytest.approx(limit, abs=1e-4)


ROOM = st.floats(-0.5, 5.0)
BRAKING = st.floats(0.02, 5.0)
OTHERS_SPEED = st.floats(0.0, 1.5)
SECONDS = st.floats(0.0, 1.0)


@pytest.mark.parametrize(("room", "unseen"), [(math.nan, 0.1), (0.3, math.nan)])
def test_what_is_no_number_caps_all(room: float, unseen: float) -> None:
    """A constraint with the cap NaN leaves zero alone (`Projection`)."""
    assert math.isnan(closing_cap(room, 0.5, 0.0, unseen))
    assert math.isnan(wall_cap(room, 0.5, 0.0, unseen))


@given(ROOM, BRAKING, OTHERS_SPEED, SECONDS)
def test_stop_from_the_closing_cap_uses_up_the_room(
    room: float, braking: float, others: float, unseen: float
) -> None:
    cap = closing_cap(room, braking, others, unseen)
    own = cap * TICK + cap**2 / (2.0 * braking)
    theirs = others * (unseen + TICK + cap / braking)
    least = others * (unseen + TICK)  # they approach that far even if the robot stands
    assert cap >= 0.0  # so the zero command is always feasible
    assert own + theirs == pytest.approx(max(room, least), rel=1e-9, abs=1e-9)


@given(ROOM, BRAKING, SECONDS)
def test_stop_from_the_reciprocal_cap_uses_half_the_room(
    room: float, braking: float, unseen: float
) -> None:
    cap = reciprocal_cap(room, braking, unseen)
    own = cap * (2.0 * TICK + unseen) + cap**2 / (2.0 * braking)
    assert cap >= 0.0
    assert own == pytest.approx(0.5 * max(room, 0.0), rel=1e-9, abs=1e-9)


PLATFORMS = [load_platform(name) for name in ("burger", "waffle_pi", "jackal")]
LOPSIDED = np.array([[-0.2, -0.02], [0.1, -0.02], [0.2, 0.1], [0.0, 0.3], [-0.2, 0.25]])
ANY_PLATFORM = st.sampled_from(PLATFORMS)
SPEED = st.floats(0.05, 2.0)
AHEAD, LEFT = (1.0, 0.0), (0.0, 1.0)


def polygon_of(platform: Platform, speed: float, along: tuple[float, float] = AHEAD) -> Array:
    return envelope(platform, speed, along)[0]


def fastest_corner(platform: Platform, twist: Array, along: tuple[float, float] = AHEAD) -> float:
    """The speed in m/s of the fastest corner, by rigid-body kinematics."""
    v, w = twist * (platform.limits.linear, platform.limits.angular)
    speeds = [math.hypot(v * along[0] - w * y, v * along[1] + w * x) for x, y in platform.footprint]
    return max(speeds)


@given(ANY_PLATFORM, SPEED, st.floats(-1, 1), st.floats(-1, 1), st.sampled_from([AHEAD, LEFT]))
def test_envelope_bounds_the_speed_of_every_corner(
    platform: Platform, speed: float, v: float, w: float, along: tuple[float, float]
) -> None:
    polygon = polygon_of(platform, speed, along)
    allowed = nearest([tuple(point) for point in polygon.tolist()], (v, w))
    assert fastest_corner(platform, np.array(allowed), along) <= speed + 1e-9
    assert np.abs(allowed).max() <= 1.0 + 1e-12


def test_a_direction_in_which_no_corner_moves_keeps_its_limit() -> None:
    """A base that only turns: its linear limit is 0, and the other directions stay bounded."""
    turning = replace(PLATFORMS[0], limits=Limits(0.0, 2.84))
    vertices, _, caps = envelope(turning, 0.2, AHEAD)
    assert vertices[0] == pytest.approx((1.0, 0.0))
    assert np.isfinite(caps).all()
    assert fastest_corner(turning, np.array((0.0, vertices[:, 1].max()))) == pytest.approx(0.2)


@given(ANY_PLATFORM, SPEED)
def test_envelope_is_convex_and_contains_zero(platform: Platform, speed: float) -> None:
    polygon = polygon_of(platform, speed)
    edges = np.roll(polygon, -1, axis=0) - polygon
    after = np.roll(edges, -1, axis=0)
    assert (edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0] >= -1e-9).all()
    assert (edges[:, 0] * -polygon[:, 1] + edges[:, 1] * polygon[:, 0] > 0.0).all()


@pytest.mark.parametrize("platform", PLATFORMS, ids=lambda platform: platform.name)
def test_envelope_is_exact_straight_and_on_the_spot(platform: Platform) -> None:
    speed = 0.2
    polygon = [tuple(point) for point in polygon_of(platform, speed).tolist()]
    straight = nearest(polygon, (1.0, 0.0))[0] * platform.limits.linear
    spin = nearest(polygon, (0.0, 1.0))[1] * platform.limits.angular
    radius = float(np.hypot(*platform.footprint.T).max())
    assert straight == pytest.approx(speed)
    assert spin == pytest.approx(speed / radius)


@given(ANY_PLATFORM, SPEED, st.floats(-1, 1), st.floats(-1, 1))
def test_half_planes_describe_the_polygon(
    platform: Platform, speed: float, v: float, w: float
) -> None:
    polygon, normals, caps = envelope(platform, speed, AHEAD)
    allowed, _ = nearest_feasible((v, w), normals, caps)
    corners = [tuple(point) for point in polygon.tolist()]
    assert allowed == pytest.approx(nearest(corners, (v, w)), abs=1e-9)


@pytest.mark.parametrize("outline", [PLATFORMS[0].footprint, LOPSIDED], ids=["even", "lopsided"])
def test_vertices_of_the_envelope_lie_within_its_half_planes(outline: Array) -> None:
    robot = replace(PLATFORMS[0], footprint=outline)
    polygon, normals, caps = envelope(robot, 0.2, AHEAD)
    assert (normals @ polygon.T <= caps[:, None] + 1e-9).all()


WAFFLE = under_barrier(load_platform("waffle_pi"), unseen_extent=0.0)
HALF_WIDTH = float(WAFFLE.footprint[:, 1].max())
MARGIN = WAFFLE.protection["barrier"]["margin"]
REAR, FRONT = (
    float(bound) for bound in (WAFFLE.footprint[:, 0].min(), WAFFLE.footprint[:, 0].max())
)

SIDE_ANGLE = math.radians(60.0)
TOP = WAFFLE.limits.linear


def return_beside(gap: float, side: float) -> Scan:
    """One return at that gap, directly to the left or right of the lidar."""
    ranges = np.full(360, math.inf)
    ray = int(np.abs(WAFFLE.scan.bearings - side * math.pi / 2.0).argmin())
    ranges[ray] = HALF_WIDTH + gap
    return scan_from(WAFFLE, ranges, WAFFLE.scan.bearings)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
@pytest.mark.parametrize("way", [1.0, -1.0], ids=["ahead", "reversing"])
def test_nearer_obstacle_is_passed_more_slowly(side: float, way: float) -> None:
    """Half of the gap each until the next scan of both, less a share of `others_speed`.

    In directions 60 degrees aside.
    """
    reserve = SIDE_RESERVE * WAFFLE.protection["barrier"]["others_speed"]
    for gap in (0.02, 0.05, 0.095, 0.1):
        seconds = WAFFLE.scan.latency + REACTION_TIME + TICK
        closing = max(0.5 * (gap - MARGIN) / seconds - reserve, CREEP_SPEED)
        safe = decided(WAFFLE, return_beside(gap, side), Twist(way * TOP)).safe
        corner = np.array((FRONT if way > 0.0 else REAR, side * HALF_WIDTH))
        aside = np.array((way * math.sin(SIDE_ANGLE), side * math.cos(SIDE_ANGLE)))
        speed = safe.linear - safe.angular * corner[1], safe.angular * corner[0]
        assert 0.0 < aside @ speed <= closing + 1e-9
        if closing > CREEP_SPEED:  # else the envelope or the stop check holds it, too
            assert aside @ speed == pytest.approx(min(closing, TOP * math.sin(SIDE_ANGLE)))


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
@pytest.mark.parametrize("way", [1.0, -1.0], ids=["ahead", "reversing"])
@pytest.mark.parametrize("room", [0.01, 0.02])
def test_an_obstacle_that_may_come_to_the_side_is_braked_for_early(
    room: float, side: float, way: float
) -> None:
    """The speed once it is there, and what the brakes take off while it covers the room."""
    others = WAFFLE.protection["barrier"]["others_speed"]
    seconds = WAFFLE.scan.latency + REACTION_TIME + TICK
    gap = MARGIN + others * seconds + room
    beside = (0.5 - SIDE_RESERVE) * others / math.sin(SIDE_ANGLE)
    safe = decided(WAFFLE, return_beside(gap, side), Twist(way * TOP)).safe
    braking = 1.0  # m/s2, the default of braking_linear
    assert safe.linear == pytest.approx(way * (beside + braking * room / others), abs=1e-6)


@pytest.mark.parametrize(("gap", "is_near"), [(0.47, True), (0.49, False)])
def test_corners_count_within_twice_the_free_distance_at_the_next_decision(
    gap: float, is_near: bool
) -> None:
    """0.2 m to be free; in 0.15 s and a tick of 0.05 s the obstacle comes by 0.08 m."""
    assert part("constraints")._is_near_corners(gap, 0.2, 0.15, 0.4) == is_near


@pytest.mark.parametrize("along", [(1.0, 0.0), (0.6, 0.8)])
def test_a_touch_zone_limits_its_corners_in_the_direction_of_motion(
    along: tuple[float, float],
) -> None:
    """A corner's speed in the zone's direction (0, 1) is that of the base in this direction."""
    constraints = Barrier(WAFFLE)._feasible.constraints
    constraints.axes.along_x, constraints.axes.along_y = along
    constraints.axes.limit = 0.2
    constraints.axes.angular_limit = 2.0
    constraints.touch.corners = np.array([[0.0, 1.0, 0.1, 0.1], [1.0, 0.0, 0.1, 0.2]])
    constraints.touch.speed = 0.05
    constraints.rows.count = 0
    constraints.allow_touch()
    rows = constraints.rows
    assert list(rows.x)[:2] == pytest.approx([0.2 * along[1], 0.2 * along[0]])
    assert list(rows.y)[:2] == pytest.approx([0.1 * 2.0, -0.2 * 2.0])
    assert list(rows.cap)[:2] == [0.05, 0.05]


def test_without_walls_that_stand_nothing_is_known_of_any_return() -> None:
    barrier = Barrier(WAFFLE)
    decided_by(barrier, WAFFLE, [(0, 3, 0.5)], Twist(TOP), 0.0)
    assert barrier.kinds() == [0] * 360


def test_counts_from_another_memory_are_refused() -> None:
    """Those of a new mode are right."""
    constraints = Barrier(WAFFLE)._feasible.constraints
    for counts, field in (
        (constraints.placed, "contacts"),
        (constraints.placed, "discs"),
        (constraints.rows, "count"),
        (constraints.rows, "all"),
    ):
        checked = constraints.placed if counts is constraints.placed else constraints
        checked.check_indices()
        was = getattr(counts, field)
        wrong_counts = (-1,) if field == "contacts" else (-1, len(counts.x) + 1)
        for wrong in wrong_counts:
            setattr(counts, field, wrong)
            with pytest.raises(ValueError, match=str(wrong)):
                checked.check_indices()
        setattr(counts, field, was)
        checked.check_indices()


def test_the_number_of_points_beside_a_stop_is_one_of_its_arrays() -> None:
    """A robot that saw none has none."""
    because = "the compiled form hides the number"
    points = interpreted("swarmd.robot.protection.stopping", because=because).StopPoints()
    points.count = 0
    points.check_indices()
    for wrong in (-1, len(points.x) + 1):
        points.count = wrong
        with pytest.raises(ValueError, match=str(wrong)):
            points.check_indices()


@pytest.mark.parametrize("nearest", [0, 1, 2])
def test_without_a_tight_constraint_the_nearest_obstacle_is_reported(nearest: int) -> None:
    """Then the stop check alone limits the command."""
    rays = (0, 45, 315)
    near_range = 0.5 - WAFFLE.scan.range_min
    returns = [
        (ray, 1, near_range if k == nearest else near_range + 0.1) for k, ray in enumerate(rays)
    ]
    barrier = Barrier(WAFFLE)
    decided_by(barrier, WAFFLE, returns, Twist(TOP), 0.0)
    rows = barrier._feasible.constraints.rows
    for row in range(rows.all):
        rows.cap[row] = math.inf
    (found,) = barrier._limiting.report(0.0, 0.0)
    way = math.radians(rays[nearest])
    x, y = np.array(WAFFLE.scan.offset) + 0.5 * np.array((math.cos(way), math.sin(way)))
    assert found.bearing == pytest.approx(math.atan2(y, x), abs=0.1)  # it drives meanwhile


def test_a_told_obstacle_nearer_than_all_returns_is_reported() -> None:
    """Its gap is that of its rim, and its bearing that of its middle."""
    barrier, told = Barrier(WAFFLE), ToldObstacle(0.0, 0.4, 0.1, 0.0)
    scan = return_beside(0.5, -1.0)
    context = DecisionContext(BEGIN, 0.0, Odometry(BEGIN, Pose(), ZERO), 0.0, told=(told,))
    barrier.observe(scan, ScanGeometry(WAFFLE.scan), context)
    barrier.decide(Twist(TOP), context, ZERO, None)
    rows = barrier._feasible.constraints.rows
    for row in range(rows.all):
        rows.cap[row] = math.inf
    (found,) = barrier._limiting.report(0.0, 0.0)
    assert found.bearing == pytest.approx(0.5 * math.pi, abs=0.01)
    assert found.gap == pytest.approx(0.4 - 0.1 - HALF_WIDTH, abs=1e-3)


def test_the_gap_of_a_side_constraint_is_that_to_the_rim() -> None:
    """A told obstacle is 0.1 m beside the robot, and its cap is 0: a row for it and for each side.

    All corners are farther away.
    """
    barrier, told = Barrier(WAFFLE), ToldObstacle(-0.064, HALF_WIDTH + 0.25, 0.15, 0.9)
    context = DecisionContext(BEGIN, 0.0, Odometry(BEGIN, Pose(), ZERO), 0.0, told=(told,))
    barrier.observe(return_beside(3.0, -1.0), ScanGeometry(WAFFLE.scan), context)
    barrier.decide(Twist(TOP), context, ZERO, None)
    rows = barrier._feasible.constraints.rows
    gaps = sorted(list(rows.gap)[: rows.count])
    assert gaps[:3] == pytest.approx([0.1] * 3, abs=1e-3)
    assert gaps[3] > 0.11


@pytest.mark.parametrize("turn", np.linspace(0.0, 2.0 * math.pi, 13).tolist())
def test_a_told_circle_holds_what_is_within_its_reach(turn: float) -> None:
    circles = interpreted("swarmd.robot.protection.constraints", because=OF_C).ToldPlaces()
    circles.begin(2)
    circles.add(-5.0, 5.0, 0.2)
    circles.add(1.0, -2.0, 0.5)
    x, y = math.cos(turn), math.sin(turn)
    assert circles.hold(1.0 + 0.49 * x, -2.0 + 0.49 * y)
    assert not circles.hold(1.0 + 0.51 * x, -2.0 + 0.51 * y)
    assert circles.hold(math.nan, 0.0)


def test_far_obstacle_is_passed_at_full_speed() -> None:
    for gap in (0.25, 0.4):
        requested = Twist(TOP)
        assert decided(WAFFLE, return_beside(gap, 1.0), requested).safe == requested


BURGER_OUTLINE = load_platform("burger").footprint
TWIST_SPEED = st.floats(-2.0, 2.0)


def touch_speed(corners: Array, zone: TouchZone, v: float, w: float) -> float:
    """The highest speed in m/s of the outline in directions of the zone."""
    nx, ny, x, y = touch_directions(corners, zone)
    return float((nx * (v - w * y) + ny * w * x).max())


@pytest.mark.parametrize(
    ("bearing", "twist", "speed"),
    [
        (0.0, (0.2, 0.0), 0.2),
        (0.0, (-0.2, 0.0), -0.2 * math.cos(math.radians(20.0))),
        (180.0, (-0.2, 0.0), 0.2),
        (90.0, (0.0, 1.0), 0.038),  # of the left side its front corner, which swings outwards
        (-90.0, (0.0, 1.0), 0.102),  # of the right side the rear one
        (0.0, (0.0, 1.0), 0.089),  # of the front its right corner
    ],
)
def test_foremost_corner_decides_the_touch_speed(
    bearing: float, twist: tuple[float, float], speed: float
) -> None:
    zone = TouchZone(math.radians(bearing), math.radians(20.0), 0.1)
    assert touch_speed(BURGER_OUTLINE, zone, *twist) == pytest.approx(speed, abs=2e-3)


TRIANGLE = np.array([[0.2, -0.1], [0.2, 0.1], [-0.2, 0.0]])


@pytest.mark.parametrize(
    ("outline", "ends"),
    [(BURGER_OUTLINE, {(0.038, -0.089), (0.038, 0.089)}), (TRIANGLE, {(0.2, -0.1), (0.2, 0.1)})],
    ids=["rectangle", "triangle"],
)
def test_touch_directions_hold_both_ends_of_a_face(
    outline: Array, ends: set[tuple[float, float]]
) -> None:
    zone = TouchZone(0.0, math.radians(1.0), 0.1)
    found = zip(*touch_directions(outline, zone), strict=True)
    assert {(x, y) for nx, _, x, y in found if nx > 0.9999999} == ends


@given(st.floats(-3.0, 3.0), st.floats(0.05, 1.04), TWIST_SPEED, TWIST_SPEED)
def test_touch_directions_cover_the_zone_within_1_percent(
    bearing: float, half: float, v: float, w: float
) -> None:
    found = touch_speed(BURGER_OUTLINE, TouchZone(bearing, half, 0.1), v, w)
    for way in np.linspace(bearing - half, bearing + half, 101):
        nx, ny = math.cos(way), math.sin(way)
        x, y = max(BURGER_OUTLINE.tolist(), key=lambda corner: nx * corner[0] + ny * corner[1])
        assert nx * (v - w * y) + ny * w * x <= found + 0.01 * math.hypot(v - w * y, w * x) + 1e-9


def test_reported_constraints_bind_and_have_a_return() -> None:
    square = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])
    barrier = Barrier(replace(KINDS[0], footprint=square))
    constraints = barrier._feasible.constraints
    rows, placed = constraints.rows, constraints.placed
    constraints.axes.limit = KINDS[0].limits.linear
    placed.seen = rows.count = 4
    rows.all = 5  # the last row is of the envelope
    rows.cap = [0.3, 0.1, 0.2, 0.0, 0.0]
    rows.x, rows.y = [0.3, 0.0, 0.2, 0.0, 0.0], [0.0] * 5  # all but the second are tight
    rows.gap, rows.source = [0.9, 1.9, 2.9, math.inf, 0.0], list(range(5))
    placed.x, placed.y = [1.0, 2.0, 3.0, 4.0], [0.0] * 4
    reported = barrier._limiting.report(1.0, 0.0)
    assert [(row.cap, row.bearing) for row in reported] == [(0.2, 0.0), (0.3, 0.0)]
    assert [row.gap for row in reported] == pytest.approx([2.9, 0.9])


@pytest.mark.parametrize("seed", range(8))
def test_of_many_tight_constraints_those_of_the_lowest_caps_and_gaps_are_reported(
    seed: int,
) -> None:
    rng, count = np.random.default_rng(seed), 12
    barrier = Barrier(KINDS[0])
    constraints = barrier._feasible.constraints
    rows, placed = constraints.rows, constraints.placed
    constraints.axes.limit = KINDS[0].limits.linear
    placed.seen = rows.count = rows.all = count
    rows.cap = rows.x = rng.choice([0.0, 0.1, 0.2], count).tolist()  # all are tight at (1, 0)
    rows.y, rows.gap = [0.0] * count, rng.choice([0.1, 0.2, 0.3, math.inf], count).tolist()
    rows.source = list(range(count))
    placed.x, placed.y = [1.0 + i for i in range(count)], [0.0] * count
    ranked = sorted((rows.cap[i], rows.gap[i], i) for i in range(count))
    expected = [i for _, gap, i in ranked if gap < math.inf][:4]
    front = KINDS[0].footprint[:, 0].max()
    reported = barrier._limiting.report(1.0, 0.0)
    assert [round(row.gap + front - 1.0) for row in reported] == expected


def test_constraint_across_the_motion_brakes_by_its_lever_only() -> None:
    """The stop check hides a wrong brake from tests of decisions."""
    rows = (0.0, -0.1), (1.0, 0.0), (-0.6, 0.1), (0.0, 0.0)
    assert [braking(*row, 1.0, 3.0) for row in rows] == pytest.approx([0.3, 1.0, 0.9, 0.02])


@pytest.mark.parametrize("speed", [0.1, 0.2])
def test_binding_range_ends_where_the_cap_reaches_the_speed(speed: float) -> None:
    platform = under_barrier(load_platform("burger"), braking_angular=100.0)
    settings = barrier_settings(platform)
    assert settings is not None
    gap = BindingRange(platform, settings, TICK).for_fresh_scan(speed)
    room = gap - settings.margin - settings.unseen_extent
    reached = closing_cap(room, settings.braking_linear, settings.others_speed, 0.0)
    assert reached == pytest.approx(speed)


KINDS = [under_barrier(load_platform(name)) for name in ("burger", "waffle_pi", "jackal")]
KINDS += [under_barrier(KINDS[0], unseen_extent=0.0), under_barrier(KINDS[2], others_speed=0.4)]
ALONE = {"others_speed": 0.001, "surface_speed": 0.25, "unseen_extent": 0.0}
KINDS += [under_barrier(KINDS[0], **ALONE), under_barrier(KINDS[1], **ALONE)]
SHARE = st.sampled_from([-1.0, -0.5, 0.0, 0.3, 1.0])
RETURNS = st.lists(st.tuples(st.integers(0, 359), st.integers(1, 30), st.floats(0, 2)), max_size=3)
BEGIN = 10.0
FAR = 100.0


def sees_all(platform: Platform) -> Any:
    """A barrier that considers every return."""
    barrier = Barrier(platform)
    feasible = barrier._feasible
    assumptions = feasible.assumptions

    class SeesAll(type(assumptions)):  # type: ignore[misc]  # the class has no name for mypy
        def binding_range(self, age: float) -> float:
            assert super().binding_range(age) < FAR
            return FAR

    patient = SeesAll(platform, barrier_settings(platform))
    feasible.assumptions = feasible.near._assumptions = patient
    feasible.constraints._assumptions = patient
    return barrier


def driving(twist: Twist, seconds: float) -> Odometry:
    """Odometry after `seconds` at a constant twist from the origin."""
    v, turn = twist.linear, twist.angular * seconds
    radius = v / twist.angular if twist.angular else 0.0
    there = Pose(radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn)
    return Odometry(BEGIN + seconds, there if turn else Pose(v * seconds), twist)


def decided_by(
    barrier: Mode, platform: Platform, returns: Sequence[tuple[int, int, float]], twist: Twist,
    age: float, sweep: float = 0.0,
) -> Twist:  # fmt: skip
    """The decision on a request to go on at the same twist, `age` s after a scan.

    The first ray of the scan is `sweep` s older than the last one.
    """
    ranges = np.full(360, math.inf)
    for first, count, beyond in returns:
        ranges[np.arange(first, first + count) % 360] = platform.scan.range_min + beyond
    scan = scan_from(platform, ranges, platform.scan.bearings)
    if sweep:
        scan = structs.replace(scan, ages=np.linspace(sweep, 0.0, 360))
    before = DecisionContext(BEGIN - 0.1, None, driving(twist, -0.1), 0.0)
    barrier.decide(twist, before, command=twist, touch=None)
    now = DecisionContext(BEGIN, 0.0, driving(twist, 0.0), 0.0)
    barrier.observe(scan, ScanGeometry(platform.scan), now)
    later = now if age == 0.0 else DecisionContext(BEGIN + age, age, driving(twist, age), 0.0)
    return barrier.decide(twist, later, command=twist, touch=None).twist


@given(
    st.sampled_from(KINDS),
    RETURNS,
    SHARE,
    SHARE,
    st.sampled_from([0.0, 0.1, 0.4, 1.0]),
    st.sampled_from([0.0, 0.1, 0.2]),
)
def test_returns_beyond_the_binding_range_of_their_age_change_nothing(
    platform: Platform,
    returns: list[tuple[int, int, float]],
    v: float,
    w: float,
    share: float,
    sweep: float,
) -> None:
    age = share * platform.scan.stale_after
    twist = Twist(v * platform.limits.linear, w * platform.limits.angular)
    some = decided_by(Barrier(platform), platform, returns, twist, age, sweep)
    every = decided_by(sees_all(platform), platform, returns, twist, age, sweep)
    assert (some.linear, some.angular) == pytest.approx((every.linear, every.angular), abs=1e-9)


SECTORS = st.lists(st.floats(0.05, 1.0), min_size=3, max_size=9)
LENGTH = st.floats(-0.5, 0.5)


@given(SECTORS, st.floats(0.05, 1.0), LENGTH, LENGTH, st.floats(0.01, 0.8), st.floats(-4.0, 4.0))
def test_what_is_farther_than_the_hidden_gap_is_beyond_range_min(
    sectors: list[float], radius: float, ahead: float, left: float, blind: float, bearing: float
) -> None:
    angles = 2.0 * np.pi * np.cumsum(sectors) / sum(sectors)
    ring = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    lidar = (ahead, left)
    outline = outline_of(radius * ring, lidar)
    towards = np.array((math.cos(bearing), math.sin(bearing)))
    for way in (0.0, 0.02, 0.1, 0.5, 2.0):
        place = np.array(lidar) + (blind + way) * towards
        gap, direction, hidden = separation(outline, float(place[0]), float(place[1]), blind=blind)
        normal = np.array(direction)
        if gap == 0.0:
            continue
        if way == 0.0:  # where an obstacle enters the blind zone, it may be in contact
            assert gap <= hidden + 1e-6
        on = place - gap * normal
        beyond, within = (math.dist(on + (hidden + more) * normal, lidar) for more in (1e-6, -1e-6))
        assert beyond >= blind
        assert hidden < 2e-6 or within <= blind


@pytest.mark.parametrize(
    ("ahead", "left", "hidden"), [(1.0, 0.0, 0.050), (0.0, 1.0, 0.0267), (1.0, 1.0, 0.0068)]
)
def test_hidden_gap_of_a_burger(ahead: float, left: float, hidden: float) -> None:
    burger = load_platform("burger")
    corner = burger.footprint.max(axis=0)
    place = (corner * (ahead, left) + (0.04 * ahead, 0.04 * left)).tolist()
    outline = outline_of(burger.footprint, burger.scan.offset)
    separated = separation(outline, place[0], place[1], blind=burger.scan.range_min)
    assert separated.hidden == pytest.approx(hidden, abs=1e-3)


def test_a_decision_leaves_out_what_cannot_have_come_near_enough_since_its_own_ray() -> None:
    """Of a sweep, the same range counts where it was measured first, and not where last."""
    platform = KINDS[0]
    barrier = Barrier(platform)
    feasible = barrier._feasible
    binding_range = feasible.assumptions.binding_range
    gap = binding_range(0.5 * platform.scan.latency + 0.1 + REACTION_TIME)
    ring = [(0, 360, gap + float(np.hypot(*platform.footprint.T).min()) - platform.scan.range_min)]
    decided_by(barrier, platform, ring, Twist(0.1), 0.0, 0.2)
    passed = feasible.situation.now - feasible.motion.measured_at + REACTION_TIME
    near, seen = feasible.near.points, feasible.constraints.placed.seen
    points = list(zip(near.gap, near.age, strict=True))[: near.count]
    assert seen == sum(gap < binding_range(passed + age) for gap, age in points)
    assert seen < sum(gap < binding_range(passed + 0.2) for gap, _ in points)
