"""The stop check, compared with a finer and independent simulation of stops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.values import Array, Platform, Pose
from swarmd.robot.protection.stopping import NEGLIGIBLE_SPEED
from swarmd.settings.platforms import load_platform
from tests.support.barrier_parts import after_stop_check, part
from tests.support.filter_sim import outline_point, placed

TICK, LINEAR, ANGULAR = 0.05, 1.0, 3.0
BURGER = load_platform("burger")
PLATFORMS = [BURGER, load_platform("waffle_pi"), load_platform("jackal")]
FRONT, HALF = 0.038, 0.089  # m, of a Burger's outline; its rear corners are 0.135 m from the axle
STEP = 0.002  # s
SAG = 0.004  # m by which the path of a corner deviates between two simulated poses

SHARE = st.floats(-1, 1)


def cleared(
    speeds: tuple[float, float],
    *points: tuple[float, float],
    free: tuple[float, float] = (0.01, 0.0),
    platform: Platform = BURGER,
    along: tuple[float, float] = (1.0, 0.0),
) -> tuple[float, float]:
    """The speeds that the stop check leaves beside points in the base frame."""
    return after_stop_check(
        platform,
        speeds,
        points,
        along=along,
        free=free[0],
        others_speed=free[1],
        braking=(LINEAR, ANGULAR),
    )


def way(speed: float) -> float:
    """The stopping distance in m."""
    return speed * TICK + speed * speed / (2.0 * LINEAR)


def test_straight_stop_keeps_the_free_gap() -> None:
    free, point = 0.05, 0.30
    enough = FRONT + free + way(0.2)
    assert cleared((0.2, 0.0), (enough + 0.002, 0.0), free=(free, 0.0)) == (0.2, 0.0)
    assert cleared((0.2, 0.0), (enough - 0.002, 0.0), free=(free, 0.0)) == (0.75 * 0.2, 0.0)
    assert cleared((-0.2, 0.0), (enough - 0.002, 0.0), free=(free, 0.0)) == (-0.2, 0.0)
    assert cleared((0.2, 0.0), (-point, 0.0), free=(free, 0.0)) == (0.2, 0.0)


def test_free_gap_grows_while_others_approach() -> None:
    """The stop from 0.2 m/s takes 0.25 s; an obstacle at 0.3 m/s moves 75 mm in that time."""
    enough = FRONT + 0.05 + way(0.2) + 0.3 * (TICK + 0.2)
    assert cleared((0.2, 0.0), (enough + 0.003, 0.0), free=(0.05, 0.3)) == (0.2, 0.0)
    assert cleared((0.2, 0.0), (enough - 0.01, 0.0), free=(0.05, 0.3))[0] < 0.2


@pytest.mark.parametrize("linear", [0.0, 0.005, -0.005])
def test_a_turn_that_ends_before_others_arrive_passes(linear: float) -> None:
    """The stop from 0.5 rad/s takes 0.217 s, with a linear speed that ends earlier, too.

    The rear corner moves 9 mm in that time, and the obstacle beside it 65 mm.
    """
    turn, others, free, radius = -0.5, 0.3, 0.01, 0.1345
    arc = abs(turn) * (TICK + 0.5 * abs(turn) / ANGULAR)
    gap = free + others * (TICK + abs(turn) / ANGULAR) + arc * radius
    beside = (-0.1, HALF + gap + 0.002)
    assert cleared((linear, turn), beside, free=(free, others)) == (linear, turn)
    near = (-0.1, HALF + 0.5 * gap)
    assert cleared((linear, turn), near, free=(free, others)) != (linear, turn)


def test_a_gap_within_a_rounding_of_the_bound_is_examined() -> None:
    """The obstacle moves 75 mm in 0.25 s, and a place of the outline 40 mm."""
    bound = 0.05 + 0.3 * 0.25 + 0.04
    safe = part("stopping")._safe_gap(0.05, 0.3, 0.25, 0.04)
    assert bound + 1e-12 < safe < bound + 1e-6


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_turn_stops_before_the_corner_arrives(side: float) -> None:
    """The nearest place of the outline does not close in a turn, but a rear corner swings in.

    In the other direction the front corner passes, which is nearer to the axle.
    """
    beside, clear = (0.0, side * (HALF + 0.03)), (0.0, side * (0.136 + 0.01))
    for turn in (2.84, -2.84):
        linear, angular = cleared((0.0, turn), beside)
        assert linear == 0.0
        assert abs(angular) < 2.84 if side * turn < 0.0 else angular == turn
        assert angular * turn >= 0.0
        assert cleared((0.0, turn), clear) == (0.0, turn)


@pytest.mark.parametrize("way", [1.0, -1.0], ids=["turn ends first", "drive ends first"])
def test_stop_of_two_speeds_that_cancel_out(way: float) -> None:
    """The front corner keeps its x while both speeds last, and moves ahead once one has ended."""
    speeds = way * 0.2, way * 0.2 / HALF
    before = FRONT + 0.015, HALF + 0.001
    assert cleared(speeds, before) != speeds
    assert cleared(speeds, (before[0] + 0.2, before[1])) == speeds


def test_closing_at_a_negligible_speed_passes() -> None:
    assert cleared((0.9 * NEGLIGIBLE_SPEED, 0.0), (FRONT + 0.001, 0.0)) == (
        0.9 * NEGLIGIBLE_SPEED,
        0.0,
    )
    assert cleared((0.0, 0.9 * NEGLIGIBLE_SPEED / 0.14), (0.0, HALF + 0.001)) == (
        0.0,
        0.9 * NEGLIGIBLE_SPEED / 0.14,
    )
    assert cleared((2.0 * NEGLIGIBLE_SPEED, 0.0), (FRONT + 0.001, 0.0))[0] < NEGLIGIBLE_SPEED


def test_lateral_motion_is_checked() -> None:
    beside = (0.0, HALF + 0.015)
    assert cleared((0.2, 0.0), beside, along=(0.0, -1.0)) == (0.2, 0.0)
    assert cleared((0.2, 0.0), beside, along=(0.0, 1.0))[0] < 0.2


def test_gives_zero_between_walls() -> None:
    walls = [(x, y) for x in np.arange(-0.15, 0.1, 0.01) for y in (-HALF - 0.002, HALF + 0.002)]
    assert cleared((0.0, 1.0), *walls) == (0.0, 0.0)


POINTS = st.lists(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)), min_size=1, max_size=4)


def outside(platform: Platform, points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    return [at for at in points if outline_point(platform.footprint, np.array(at))[0] > 0.0]


@given(st.sampled_from(PLATFORMS), POINTS, SHARE, SHARE, st.floats(0.0, 0.1))
def test_no_nearer_share_of_the_grid_is_clear(
    platform: Platform, points: list[tuple[float, float]], v: float, w: float, free: float
) -> None:
    seen = outside(platform, points)
    speeds = v * platform.limits.linear, w * platform.limits.angular
    left = cleared(speeds, *seen, free=(free, 0.0), platform=platform)
    assert cleared(left, *seen, free=(free, 0.0), platform=platform) == left
    shares = [(a, b) for a in np.linspace(0, 1, 5) for b in np.linspace(0, 1, 5)]
    chosen = [s for s in shares if np.allclose((s[0] * speeds[0], s[1] * speeds[1]), left)]
    assert chosen
    cost = min((1.0 - a) ** 2 + (1.0 - b) ** 2 for a, b in chosen)
    for a, b in shares:
        if (1.0 - a) ** 2 + (1.0 - b) ** 2 < cost - 1e-9:
            other = a * speeds[0], b * speeds[1]
            assert cleared(other, *seen, free=(free, 0.0), platform=platform) != other


@given(
    st.sampled_from(PLATFORMS), POINTS, SHARE, SHARE, st.floats(0.0, 0.1),
    st.sampled_from([(1.0, 1.0), (math.inf, 1.0), (1.0, math.inf)]),
)  # fmt: skip
def test_stop_keeps_the_free_gap_with_any_brakes(
    platform: Platform,
    points: list[tuple[float, float]],
    v: float,
    w: float,
    free: float,
    better: tuple[float, float],
) -> None:
    seen = outside(platform, points)
    speeds = v * platform.limits.linear, w * platform.limits.angular
    linear, angular = cleared(speeds, *seen, free=(free, 0.0), platform=platform)
    for at in seen:
        first = outline_point(platform.footprint, np.array(at))[0]
        creeps = NEGLIGIBLE_SPEED * (TICK + max(abs(linear) / LINEAR, abs(angular) / ANGULAR))
        least = min(nearness(platform, np.array(at), linear, angular, better))
        assert least >= min(first, free) - creeps - SAG


def nearness(
    platform: Platform, at: Array, v: float, w: float, better: tuple[float, float]
) -> list[float]:
    """Gaps to a point during a stop, with brakes better by these factors."""
    pose, gaps, time = Pose(), [], 0.0
    while v or w:
        if time >= TICK:
            v -= math.copysign(min(abs(v), better[0] * LINEAR * STEP), v)
            w -= math.copysign(min(abs(w), better[1] * ANGULAR * STEP), w)
        yaw = pose.yaw + 0.5 * w * STEP
        x, y = pose.x + v * STEP * math.cos(yaw), pose.y + v * STEP * math.sin(yaw)
        pose = Pose(x, y, yaw + 0.5 * w * STEP)
        time += STEP
        gaps.append(outline_point(placed(platform.footprint, pose), at)[0])
    return gaps or [math.inf]


@pytest.mark.parametrize("turn", [2.0, -2.0])
def test_a_stop_follows_the_arc_of_its_speeds(turn: float) -> None:
    """0.2 m/s and 2 rad/s for 0.2 s: 0.1 m * sin(0.4) ahead, 0.1 m * (1 - cos(0.4)) aside."""
    motion = part("stopping").StopMotion()
    motion.begin(1.0, 0.0, 0.0)
    for step in range(4):
        middle = 0.05 * (step + 0.5)
        motion.advance(middle, 0.05, 0.2, 0.0, turn, 0.2, 0.0, turn, 1e-9, 1e-9)
    side = math.copysign(0.1 * (1.0 - math.cos(0.4)), turn)
    assert (motion.x, motion.y) == pytest.approx((0.1 * math.sin(0.4), side), abs=1e-4)
    assert motion.turned == pytest.approx(0.2 * turn, abs=1e-6)
