"""Mode `barrier` with obstacles that the robot is told of: they add constraints, and no more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from msgspec import structs

from swarmd.core.messages import Body
from swarmd.core.values import (
    ZERO,
    Neighbor,
    Odometry,
    PeerPlace,
    Platform,
    Pose,
    Scan,
    SharedPose,
    TouchZone,
    Twist,
)
from swarmd.robot.protection.decision import DecisionContext, ToldObstacle
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import scan_from
from tests.support.examples import part
from tests.support.filter_sim import (
    DT,
    FilterRun,
    FilterSim,
    Shape,
    decided,
    outline_point,
    round_corners,
    under_barrier,
)
from tests.support.kernel_forms import long_run
from tests.support.protection import Protection

TICK = 0.05
NO_FAULT = 0.02  # m/s: a slower contact is not a fault of the robot
PLATFORMS = [under_barrier(load_platform(name)) for name in ("burger", "waffle_pi", "jackal")]
BURGER, WAFFLE, JACKAL = PLATFORMS
PLATFORM = st.sampled_from(PLATFORMS)
SHARE = st.floats(-1, 1)
RETURNS = st.lists(st.tuples(st.integers(0, 359), st.floats(0, 1)), max_size=8)
TOLD = st.builds(
    ToldObstacle, st.floats(-2, 2), st.floats(-2, 2), st.floats(0.05, 0.5), st.floats(0, 0.5)
)
ZONE = st.one_of(st.none(), st.builds(TouchZone, st.floats(-3, 3), st.floats(0.05, 1.0),
                                      st.floats(0.01, 0.3)))  # fmt: skip


def seeing(platform: Platform, returns: Sequence[tuple[int, float]]) -> Scan:
    """A scan with these returns: ray, and share of 2 m beyond range_min."""
    ranges = np.full(360, math.inf)
    for ray, share in returns:
        ranges[ray] = platform.scan.range_min + 2.0 * share
    return scan_from(platform, ranges, platform.scan.bearings)


def touched_at(run: FilterRun) -> float:
    """The speed in m/s of the robot's own surface at the touch; 0 without one."""
    return 0.0 if run.touch is None else run.touch.speed


def request_of(platform: Platform, v: float, w: float) -> Twist:
    return Twist(v * platform.limits.linear, w * platform.limits.angular)


@example(WAFFLE, [(0, 0.125)], [ToldObstacle(0.0, 2.0, 0.5, 0.0)], 0.125, 1.0, None)
@given(PLATFORM, RETURNS, st.lists(TOLD, min_size=1, max_size=4), SHARE, SHARE, ZONE)
def test_told_obstacles_allow_no_command_that_is_refused_without(
    platform: Platform, returns: list[tuple[int, float]], told: list[ToldObstacle], v: float,
    w: float, zone: TouchZone | None,
) -> None:  # fmt: skip
    """What they leave of a request passes without them, so the allowed commands are a subset.

    A robot that creeps, which no told obstacle is near, may not turn alone as fast as it then does.
    """
    scan, requested = seeing(platform, returns), request_of(platform, v, w)
    safe = decided(platform, scan, requested, touch=zone, told=tuple(told)).safe
    if safe == decided(platform, scan, requested, touch=zone).safe:
        return
    again = decided(platform, scan, safe, touch=zone).safe
    assert (again.linear, again.angular) == pytest.approx((safe.linear, safe.angular), abs=1e-9)


@given(PLATFORM, RETURNS, SHARE, SHARE, st.floats(-3.2, 3.2), st.floats(0, 0.5))
def test_told_obstacle_far_away_changes_nothing_bit_by_bit(
    platform: Platform, returns: list[tuple[int, float]], v: float, w: float, bearing: float,
    age: float,
) -> None:  # fmt: skip
    scan, requested = seeing(platform, returns), request_of(platform, v, w)
    far = ToldObstacle(4.0 * math.cos(bearing), 4.0 * math.sin(bearing), 0.3, age)
    assert decided(platform, scan, requested, told=(far,)) == decided(platform, scan, requested)


@given(PLATFORM, TOLD, SHARE, SHARE)
def test_robot_can_stop_before_the_disc(
    platform: Platform, told: ToldObstacle, v: float, w: float
) -> None:
    """The equation of the caps, for the nearest place of the outline and each near corner."""
    settings = platform.protection["barrier"]
    safe = decided(platform, seeing(platform, []), request_of(platform, v, w), told=(told,)).safe
    centre = np.array([told.x, told.y])
    gap, nearest, towards = outline_point(platform.footprint, centre)
    if gap == 0.0:
        return
    for at, away, way in [
        (nearest, gap, towards),
        *((c, np.hypot(*(centre - c)), (centre - c) / np.hypot(*(centre - c)))
          for c in platform.footprint if gap <= 2.0 * (settings["margin"] + told.radius)),
    ]:  # fmt: skip
        lever = at[0] * way[1] - at[1] * way[0]
        closing = safe.linear * way[0] + safe.angular * lever
        braking = abs(way[0]) * settings["braking_linear"]
        braking = max(braking + abs(lever) * settings["braking_angular"], 0.02)
        own = closing * TICK + closing**2 / (2.0 * braking)
        theirs = settings["others_speed"] * (told.age + 2.0 * TICK + closing / braking)
        room = away - told.radius - settings["margin"]
        assert closing <= 1e-9 or own + theirs <= room + 1e-9


@pytest.mark.parametrize("platform", PLATFORMS, ids=lambda platform: platform.name)
def test_no_surface_is_faster_than_others_assume_near_a_told_obstacle(platform: Platform) -> None:
    """It is behind, so that it does not limit the drive itself."""
    requested = request_of(platform, 1.0, 1.0)
    behind = ToldObstacle(-float(np.hypot(*platform.footprint.T).max()) - 0.3, 0.0, 0.15, 0.0)
    safe = decided(platform, seeing(platform, []), requested, told=(behind,)).safe
    speeds = [
        math.hypot(safe.linear - safe.angular * y, safe.angular * x) for x, y in platform.footprint
    ]
    assert not safe.is_zero
    assert max(speeds) <= platform.protection["barrier"]["others_speed"] + 1e-9
    assert decided(platform, seeing(platform, []), requested).safe == requested


@pytest.mark.parametrize(("gap", "is_slow"), [(0.0, True), (0.29, True), (0.31, False)])
def test_robot_creeps_where_a_told_obstacle_may_touch_it(gap: float, is_slow: bool) -> None:
    """The disc is on its left; the obstacle in it may be ahead. It moves at 0.30 m/s at most."""
    age, radius = 0.9, 0.15  # with reaction and tick 1.0 s
    beside = ToldObstacle(0.0, 0.089 + radius + gap, radius, age)
    safe = decided(BURGER, seeing(BURGER, []), Twist(0.2), told=(beside,)).safe
    assert (0.01 < safe.linear <= 0.015) if is_slow else safe.linear > 0.03


def test_touch_zone_and_keep_out_are_not_for_told_obstacles() -> None:
    ahead = (ToldObstacle(0.20, 0.0, 0.14, 0.0),)
    zone = TouchZone(0.0, 0.5, 0.1)
    assert decided(BURGER, seeing(BURGER, []), Twist(0.1), touch=zone, told=ahead).safe == ZERO
    beside = (ToldObstacle(0.0, 0.80, 0.14, 0.0),)  # within a Jackal's circle of 0.92 m
    requested = Twist(0.0, 0.05)
    assert decided(JACKAL, seeing(JACKAL, []), requested, told=beside).safe == requested


def test_told_obstacle_is_moved_by_odometry_from_its_own_time() -> None:
    """The robot has driven 0.1 m towards it since it was measured."""
    protection = Protection(BURGER)
    protection.observe(
        seeing(BURGER, []), DecisionContext(10.0, 0.0, Odometry(10.0, Pose(), ZERO), 0.0)
    )
    later = Odometry(10.1, Pose(0.1), ZERO)

    def safe(told: tuple[ToldObstacle, ...]) -> Twist:
        context = DecisionContext(10.1, 0.1, later, 0.0, told=told)
        return protection.decide(Twist(0.22), context, is_running=True, hold=None).safe

    measured, fresh, nearer = (
        safe((ToldObstacle(x, 0.0, 0.1, age),)).linear
        for x, age in ((0.375, 0.1), (0.275, 0.0), (0.275 - 0.3 * 0.1, 0.0))
    )
    assert 0.0 < measured < fresh < 0.22
    assert measured == pytest.approx(nearer, rel=0.05)  # others move at 0.3 m/s


def test_new_told_obstacles_count_at_once() -> None:
    """At the time of the last decision, with the same scan and odometry."""
    protection, odometry = Protection(WAFFLE), Odometry(10.0, Pose(), ZERO)
    protection.observe(seeing(WAFFLE, []), DecisionContext(10.0, 0.0, odometry, 0.0))
    found = []
    for told in ((), (ToldObstacle(0.35, 0.0, 0.1, 0.0),), (ToldObstacle(0.4, 0.0, 0.1, 0.0),), ()):
        context = DecisionContext(10.0, 0.0, odometry, 0.0, told=told)
        decision = protection.decide(Twist(0.26), context, is_running=True, hold=None)
        found.append(decision.safe.linear)
    assert found[1] < found[2] < found[0] == found[3] == 0.26


def test_decision_names_the_rim_of_the_disc() -> None:
    told = (ToldObstacle(0.0, 0.40, 0.15, 0.0),)
    decision = decided(BURGER, seeing(BURGER, []), Twist(0.0, 2.84), told=told)
    assert decision.is_active
    assert decision.rows[0].bearing == pytest.approx(math.pi / 2.0)
    assert decision.rows[0].gap == pytest.approx(0.40 - 0.15 - 0.089, abs=1e-3)


@pytest.mark.parametrize("platform", [BURGER, JACKAL], ids=lambda platform: platform.name)
def test_a_told_obstacle_at_a_corner_or_at_the_lidar_lets_a_robot_creep_at_most(
    platform: Platform,
) -> None:
    """No direction leads from the corner to its middle."""
    robot = under_barrier(platform, keep_out=0.3)
    for x, y in [*platform.footprint.tolist(), platform.scan.offset]:
        told = (ToldObstacle(float(x), float(y), 0.05, 0.0),)
        for v, w in ((0.2, 0.0), (-0.2, 0.0), (0.2, 1.0), (0.0, -1.0)):
            safe = decided(robot, seeing(robot, []), Twist(v, w), told=told).safe
            speeds = [
                math.hypot(safe.linear - safe.angular * y, safe.angular * x)
                for x, y in robot.footprint
            ]
            assert max(speeds) <= 0.015 + 1e-9


class ToldSim(FilterSim):
    """A robot that knows the one shape, a peer that its scan plane misses, only by told obstacles.

    Every 0.1 s: with `is_sensed` its range and bearing, and a place in a shared frame, `place_age`
    s after it was measured: with `is_located` the true one, else `place`, where None tells nothing.
    """

    is_sensed = True
    is_located = False
    place: tuple[float, float] | None = None
    place_age = 0.1

    def _sense(self) -> None:
        super()._sense()
        peer, now, sensors = self.shapes[0], self.time, self.sensors
        if self._step == 0:
            radius = float(np.hypot(*peer.corners.T).max())
            low = Body(platform="low", surface_speed=0.1, radius=radius, lowest=0.0, highest=0.02)
            sensors.on_peers({"b": low})
        if self._step % round(0.1 / DT):
            return
        at = peer.at(now)
        dx, dy = at.x - self.pose.x, at.y - self.pose.y
        if self.is_sensed:
            bearing = math.atan2(dy, dx) - self.pose.yaw
            sensors.on_neighbors((Neighbor("b", 0.0, math.hypot(dx, dy), bearing),), now)
        place = (at.x, at.y) if self.is_located else self.place
        if place is not None:
            sensors.on_pose(SharedPose(now, self.pose, 0.0, 0.0, "map"), now)
            sensors.on_place(PeerPlace("b", "map", *place, 0.0, self.place_age), now)


def unseen(radius: float, x: float, **motion: object) -> Shape:
    """A round peer at `x` m ahead that no scan plane meets; `motion` as in Shape."""
    nowhere = 1e3 + round_corners(radius)
    return Shape(round_corners(radius), Pose(x), seen=nowhere, **motion)  # type: ignore[arg-type]


@pytest.mark.short_rows(1)
@long_run
@pytest.mark.parametrize("platform", [BURGER, JACKAL], ids=lambda platform: platform.name)
@pytest.mark.parametrize(
    ("place", "place_age"), [((0.0, 5.0), 0.1), ((2.0, 0.0), 0.4), ((-50.0, 0.0), 0.4)]
)
def test_place_in_a_shared_frame_hides_no_peer_that_is_sensed(
    platform: Platform, place: tuple[float, float], place_age: float
) -> None:
    """The two call their frames `map`, and they are not the same."""
    sim = ToldSim(platform, [unseen(0.14, 1.6)])
    sim.place, sim.place_age = place, place_age
    assert touched_at(sim.run(Twist(platform.limits.linear), 12.0)) <= NO_FAULT


@pytest.mark.short_rows(1)
@long_run
@pytest.mark.parametrize("speed", [-1.2, 0.0])
@pytest.mark.parametrize("linear", part([2.0], [0.5]))
@pytest.mark.parametrize("source", ["sensed", "located"])
def test_peer_is_regarded_from_where_the_robot_must_brake(
    source: str, linear: float, speed: float
) -> None:
    """It is at rest, or comes as fast as assumed; the scan sees nothing of it."""
    fast = under_barrier(
        replace(BURGER, limits=structs.replace(BURGER.limits, linear=linear)), others_speed=1.2
    )
    for begin in (12.0, 12.03, 12.07):
        sim = ToldSim(fast, [unseen(0.14, begin, velocity=(speed, 0.0))])
        sim.is_sensed, sim.is_located = source == "sensed", source == "located"
        run = sim.run(Twist(linear), 12.0)
        assert max(twist.linear for twist in run.twists) == pytest.approx(linear)
        assert touched_at(run) <= NO_FAULT
