"""Closed loop: recovery leads around obstacles and stays under protection."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from swarmd.core.clock import TICK
from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Limits, Platform, Pose, Twist
from swarmd.protection.decision import DecisionContext, Permit
from swarmd.protection.recovery import Clearance, Recovery
from swarmd.settings.settings import load_platform
from tests.support.filter_sim import FilterSim, RequestedCommand, Shape, box, pole, under_barrier

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


def still(platform: Platform) -> Platform:
    """Obstacles are assumed to stand and to be fully visible."""
    return under_barrier(platform, others_speed=0.001, surface_speed=0.22, unseen_extent=0.0)


def nook() -> list[Shape]:
    """A wall ahead and one to the left; the right and the back are free."""
    return [box(0.1, 4.0, Pose(0.9)), box(4.0, 0.1, Pose(0.0, 0.5))]


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
    sim.sensors.on_driver(False, "gone")
    run = sim.run(AHEAD, 4.0, MAY)
    assert all(
        decision.safe == ZERO and not decision.is_recovering for _, decision in run.decisions
    )
