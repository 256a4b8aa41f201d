"""Closed loop: recovery leads around obstacles and stays under protection."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import groupby, pairwise

import numpy as np
import pytest

from swarmd.core.clock import TICK
from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Array, Limits, Odometry, Platform, Pose, Scan, Twist
from swarmd.robot.protection.decision import Clearance, DecisionContext, Permit
from swarmd.robot.steering.recovery import NO_OTHERS, Others, Recovery
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import scan_from
from tests.support.filter_sim import FilterSim, RequestedCommand, Shape, box, pole, under_barrier
from tests.support.kernel_forms import long_run
from tests.support.protection import Commander

BURGER, WAFFLE = under_barrier(load_platform("burger")), under_barrier(load_platform("waffle_pi"))
MAY = Permit(may_recover=True)
AHEAD = Twist(0.22)


@pytest.mark.parametrize(("x", "way"), [(0.3, -1.0), (-0.3, 1.0)])
def test_recovery_first_moves_to_the_side_with_more_room(x: float, way: float) -> None:
    recovery = Recovery(Clearance(0.5, 0.2), Limits(0.22, 2.84), "seed")
    twist = AHEAD
    for now in (0.0, 0.1, 0.2):
        context = DecisionContext(now, 0.0)
        twist = recovery.replacement(AHEAD, ZERO, context, lambda: np.array([[x, 0.0]]))
    assert recovery.is_active
    assert math.copysign(1.0, twist.linear) == way


def test_recovery_turns_again_where_the_corridor_is_blocked_too() -> None:
    recovery = Recovery(Clearance(0.5, 0.2), Limits(0.22, 2.84), "seed")
    twist, is_turn = AHEAD, []
    for tick in range(60):
        safe = ZERO if twist.linear > 0.0 else twist
        context = DecisionContext(tick * TICK, 0.0)
        twist = recovery.replacement(AHEAD, safe, context, lambda: np.array([[0.3, 0.0]]))
        is_turn.append(twist.linear == 0.0)
    assert sum(not before and after for before, after in pairwise(is_turn)) >= 2
    assert sum(is_turn) * TICK >= 1.0


@pytest.mark.parametrize(("safe", "is_active"), [(Twist(0.0, 2.2), False), (Twist(0.03), True)])
def test_a_turn_that_protection_allows_is_not_blocked(safe: Twist, is_active: bool) -> None:
    recovery = Recovery(Clearance(0.5, 0.2), Limits(0.22, 2.84), "seed")
    for now in (0.0, 0.1, 0.2, 0.3):
        context = DecisionContext(now, 0.0)
        recovery.replacement(Twist(0.03, 2.84), safe, context, lambda: np.array([[0.3, 0.0]]))
    assert recovery.is_active == is_active


SIDES = np.array([[0.05, 0.17], [0.05, -0.17]])


def asked(
    seconds: float,
    *,
    others: Others = NO_OTHERS,
    request: Twist = AHEAD,
    points: Array = SIDES,
    safe: Callable[[Twist], Twist] = lambda twist: ZERO,
    turning: float = 0.0,
    driven: float = 0.0,
) -> list[tuple[bool, Twist]]:
    """Whether recovery is active, and its command, at each tick of a robot that does not move.

    `driven`: m that it drove before, since it was set down.
    """
    recovery = Recovery(Clearance(0.5, 0.2, 0.09), Limits(0.22, 2.84), "seed")
    for x in (0.0, driven):
        context = DecisionContext(-1.0, 0.0, Odometry(-1.0, Pose(x - driven), ZERO), 0.0)
        recovery.replacement(ZERO, ZERO, context, lambda: points)
    twist, found = request, []
    for tick in range(round(seconds / TICK)):
        odometry = Odometry(tick * TICK, Pose(0.0, 0.0, turning * tick * TICK), ZERO)
        context = DecisionContext(tick * TICK, 0.0, odometry, 0.0)
        twist = recovery.replacement(request, safe(twist), context, lambda: points, others, safe)
        found.append((recovery.has_taken_over, twist))
    return found


def first(found: list[tuple[bool, Twist]]) -> float:
    """The time in s at which recovery takes over; inf: never."""
    return next((tick * TICK for tick, (is_active, _) in enumerate(found) if is_active), math.inf)


WALL_AHEAD = np.array([[0.25, 0.0]])


@pytest.mark.parametrize(("are_near", "after"), [(False, 0.1), (True, 2.0)])
def test_a_robot_beside_others_waits_before_it_recovers(are_near: bool, after: float) -> None:
    found = asked(4.0, others=Others(AHEAD, are_near), points=WALL_AHEAD)
    assert first(found) == pytest.approx(after, abs=2.0 * TICK)


@pytest.mark.parametrize(("turning", "after"), [(0.0, 5.0), (0.5, math.inf)])
def test_a_robot_that_stays_where_it_is_recovers(turning: float, after: float) -> None:
    # Avoidance asks for nothing, and protection allows all.
    found = asked(8.0, others=Others(AHEAD), request=ZERO, safe=lambda one: one, turning=turning)
    assert first(found) == pytest.approx(after, abs=2.0 * TICK)


def test_a_robot_that_stays_where_it_is_with_nothing_near_is_not_blocked() -> None:
    found = asked(12.0, points=np.empty((0, 2)), safe=lambda one: one)
    assert found == [(False, AHEAD)] * len(found)


@pytest.mark.parametrize("are_avoided", [False, True])
def test_the_room_between_others_is_no_passage(are_avoided: bool) -> None:
    others = Others(AHEAD, are_near=True, are_avoided=are_avoided)
    twist = asked(0.5, others=others, safe=lambda one: Twist(0.6 * one.linear))[-1][1]
    assert (twist == AHEAD) == are_avoided


def test_a_robot_that_creeps_out_of_contact_goes_on() -> None:
    found = asked(4.0, points=WALL_AHEAD, safe=lambda one: Twist(max(-0.01, min(one.linear, 0.0))))
    assert all(twist.linear < 0.0 for is_active, twist in found[10:] if is_active)


@pytest.mark.parametrize(
    ("speed", "driven", "longest"),
    [(0.015, 0.0, 8.0), (0.015, 0.1, 8.0), (0.015, 0.2, 4.0), (0.05, 0.0, 4.0)],
)
def test_only_a_robot_that_creeps_where_it_was_set_down_backs_off_as_long_as_that_takes(
    speed: float, driven: float, longest: float
) -> None:
    """Protection lets it back off at this speed in m/s, less than half of what it asks for."""
    found = asked(
        12.0,
        points=WALL_AHEAD,
        safe=lambda one: Twist(max(-speed, min(one.linear, 0.0))),
        driven=driven,
    )
    backs = [twist.linear < 0.0 for _, twist in found]
    begin = backs.index(True)
    assert backs.index(False, begin) - begin == pytest.approx(longest / TICK, abs=2.0)


def test_a_robot_that_cannot_turn_moves_as_protection_allows() -> None:
    def safe(twist: Twist) -> Twist:
        return twist if twist.linear < 0.0 and twist.angular > 0.0 else ZERO

    angles = np.radians(np.arange(-130.0, 131.0, 5.0))  # all but the back
    found = asked(4.0, points=0.3 * np.stack((np.cos(angles), np.sin(angles)), axis=1), safe=safe)
    assert any(twist.linear < 0.0 and twist.angular > 0.0 for _, twist in found)


def still(platform: Platform) -> Platform:
    """Obstacles are assumed to stand and to be fully visible."""
    return under_barrier(platform, others_speed=0.001, surface_speed=0.22, unseen_extent=0.0)


def nook() -> list[Shape]:
    """A wall ahead and one to the left; the right and the back are free."""
    return [box(0.1, 4.0, Pose(0.9)), box(4.0, 0.1, Pose(0.0, 0.5))]


@long_run
@pytest.mark.parametrize("platform", [BURGER, WAFFLE], ids=lambda platform: platform.name)
def test_recovery_keeps_the_margin(platform: Platform) -> None:
    run = FilterSim(still(platform), nook()).run(AHEAD, 25.0, MAY)
    assert any(decision.is_recovering for _, decision in run.decisions)
    assert run.min_gap >= 0.025


def test_robot_without_permit_stays_blocked() -> None:
    run = FilterSim(BURGER, [box(0.1, 4.0, Pose(0.6))]).run(AHEAD, 8.0)
    assert not any(decision.is_recovering for _, decision in run.decisions)
    assert run.twists[-1].is_zero
    assert run.poses[-1].yaw == pytest.approx(0.0, abs=0.01)
    assert run.decisions[-1][1].reason is Reason.PROTECTION


@long_run
def test_recovery_leads_around_a_pole() -> None:
    sim = FilterSim(BURGER, [pole(0.1, Pose(0.8, 0.01))])
    run = sim.run(toward(sim, 3.0), 40.0, MAY)
    assert run.touch is None
    assert max(pose.x for pose in run.poses) > 1.2


def toward(sim: FilterSim, x: float) -> RequestedCommand:
    """Drives straight to (x, 0) and ignores obstacles."""

    def requested(time: float) -> Twist:
        pose = sim.pose
        off = math.remainder(math.atan2(-pose.y, x - pose.x) - pose.yaw, 2.0 * math.pi)
        return Twist(0.22 * max(math.cos(off), 0.1), 1.5 * off)

    return requested


def test_recovery_ignores_a_zero_request() -> None:
    sim = FilterSim(BURGER, [box(0.1, 4.0, Pose(0.25))])
    run = sim.run(ZERO, 4.0, MAY)
    assert all(decision.safe == ZERO for _, decision in run.decisions)


def test_recovery_ends_under_a_hold() -> None:
    sim = FilterSim(BURGER, [box(0.1, 4.0, Pose(0.6))])
    while not sim.run(AHEAD, 0.1, MAY).decisions[-1][1].is_recovering:
        assert sim.time < 8.0
    sim.sensors.on_driver(False, "gone", sim.time)
    run = sim.run(AHEAD, 4.0, MAY)
    assert all(
        decision.safe == ZERO and not decision.is_recovering for _, decision in run.decisions
    )


class Creeper:
    """A recovery in closed loop with a robot that protection lets creep: no faster in any case.

    `walls`: returns (k, 2) in m in the frame of the world, in which the robot starts at the origin.
    `stops`: gives of a pose and a twist whether protection stops this twist.
    """

    def __init__(
        self, walls: Array, stops: Callable[[Pose, Twist], bool] = lambda pose, twist: False
    ) -> None:
        self.recovery = Recovery(Clearance(0.5, 0.3, 0.15), Limits(0.26, 1.8), "seed")
        self.walls, self.stops = walls, stops
        self.pose, self.safe, self.time = Pose(), ZERO, 0.0
        self.twists: list[Twist] = []

    def step(self, requested: Twist) -> None:
        cos, sin = math.cos(self.pose.yaw), math.sin(self.pose.yaw)
        points = (self.walls - (self.pose.x, self.pose.y)) @ np.array([[cos, -sin], [sin, cos]])
        context = DecisionContext(self.time, 0.0, Odometry(self.time, self.pose, ZERO), 0.0)
        twist = self.recovery.replacement(
            requested, self.safe, context, lambda: points, NO_OTHERS, self.creeping
        )
        self.safe = self.creeping(twist)
        yaw = self.pose.yaw + self.safe.angular * TICK
        self.pose = Pose(
            self.pose.x + self.safe.linear * TICK * cos,
            self.pose.y + self.safe.linear * TICK * sin,
            yaw,
        )
        self.time += TICK
        self.twists.append(self.safe)

    def creeping(self, twist: Twist) -> Twist:
        """1.5 cm/s at 0.2 m from the axle."""
        scale = 0.015 / max(abs(twist.linear) + 0.2 * abs(twist.angular), 0.015)
        slow = Twist(twist.linear * scale, twist.angular * scale)
        return ZERO if self.stops(self.pose, slow) else slow


def lines(*ends: tuple[float, float, float, float]) -> Array:
    """Returns every 5 cm along lines from (x, y) to (x, y)."""
    parts = []
    for x, y, to_x, to_y in ends:
        share = np.linspace(0.0, 1.0, round(math.hypot(to_x - x, to_y - y) / 0.05) + 1)[:, None]
        parts.append((1.0 - share) * (x, y) + share * (to_x, to_y))
    return np.concatenate(parts)


ACROSS = lines((0.25, -1.5, 0.25, 1.5), (-0.35, -1.5, -0.35, 1.5))
NOSE_IN = lines((0.25, -1.5, 0.25, 0.25), (0.25, 0.25, -1.5, 0.25))


@pytest.mark.parametrize("asked_for", [AHEAD, Twist(0.0, 1.0), Twist(0.0, -1.0)])
def test_a_robot_that_creeps_across_a_corridor_turns_along_it(asked_for: Twist) -> None:
    """Its turn is so slow that it counted as blocked, and wider corridors lead to the walls."""
    robot = Creeper(ACROSS)
    while abs(robot.pose.yaw) < math.radians(75.0):
        robot.step(asked_for)
        assert robot.time < 40.0


def test_a_robot_that_creeps_back_does_not_drive_on_to_where_it_came_from() -> None:
    """Nose in a corner of two walls: turns are stopped, and the back is free along one wall."""
    robot = Creeper(
        NOSE_IN,
        stops=lambda pose, twist: pose.x > 0.05 or (pose.yaw < -0.1 and twist.angular < 0.0),
    )
    while robot.pose.x > -0.4:
        robot.step(Twist(0.0, -1.0))
        assert robot.time < 60.0
    ahead = [twist.linear for twist in robot.twists if twist.linear > 0.0]
    assert ahead == []


def nose_to_a_wall(platform: Platform, gap: float) -> Scan:
    """The scan of a robot whose front is at a gap in m from an endless wall."""
    ahead = np.cos(platform.scan.bearings)
    distance = platform.footprint[:, 0].max() + gap - platform.scan.offset[0]
    ranges = np.where(ahead > 1e-3, distance / np.maximum(ahead, 1e-3), math.inf)
    ranges[ranges > platform.scan.range_max] = math.inf
    return scan_from(platform, ranges, platform.scan.bearings)


@pytest.mark.parametrize(
    ("is_running", "hold", "then"), [(False, None, 8.0), (True, Reason.STALE_SCAN, 4.0)]
)
def test_a_robot_whose_run_ended_counts_as_set_down_again(
    is_running: bool, hold: Reason | None, then: float
) -> None:
    """Who stops a robot may carry it into a corner. It then backs off for 8 s, before for 4 s.

    A hold of a decision, such as of a late scan, is no time in which somebody carries it.
    """
    commander = Commander(WAFFLE)
    scan = nose_to_a_wall(WAFFLE, 0.1)
    now = 10.0

    def safe(x: float, is_running: bool = True, hold: Reason | None = None) -> Twist:
        nonlocal now
        now += TICK
        context = DecisionContext(now, 0.0, Odometry(now, Pose(x), ZERO), 0.0)
        commander.observe(scan, context)
        return commander.decide(Twist(0.26), context, is_running, hold, MAY).safe

    def back_off() -> float:
        """The s of the first way straight back, where the robot has driven to."""
        ways = [safe(0.2).linear < -0.0149 for _ in range(240)]
        begin = ways.index(True)
        return (ways.index(False, begin) - begin) * TICK

    safe(0.0)
    after_driving = back_off()
    safe(0.2, is_running, hold)
    afterwards = back_off()
    assert (after_driving, afterwards) == pytest.approx((4.0, then), abs=2.0 * TICK)


def test_a_robot_that_does_not_come_free_does_as_before_after_two_minutes() -> None:
    found = asked(
        150.0, points=WALL_AHEAD, safe=lambda one: Twist(max(-0.015, min(one.linear, 0.0)))
    )
    backs = [twist.linear < 0.0 for _, twist in found]
    lengths = [len(list(group)) * TICK for is_back, group in groupby(backs) if is_back]
    assert lengths[0] == pytest.approx(8.0, abs=2.0 * TICK)
    assert max(lengths[-3:]) <= 4.0 + 2.0 * TICK
