from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.values import Platform, Pose, Twist
from swarmd.settings.settings import load_platform
from tests.support.filter_sim import (
    FilterSim,
    box,
    cast,
    driver_ranges,
    placed,
    pole,
    ramped,
    separation,
)

BURGER = load_platform("burger")
UNIT = box(1.0, 1.0).corners


def off(platform: Platform) -> Platform:
    """With a protection that never finds anything near enough."""
    return replace(platform, protection={**platform.protection, "rays": 10_000, "mode":
        "potential_field"})  # fmt: skip


@pytest.mark.parametrize(
    ("pose", "gap"),
    [
        (Pose(2.0, 0.0, 0.0), 1.0),
        (Pose(4.0, 5.0, 0.0), 5.0),  # 3-4-5 between corners
        (Pose(1.0 + math.sqrt(0.5), 0.0, math.pi / 4), 0.5),  # corner against face
        (Pose(0.9, 0.0, 0.3), 0.0),
        (Pose(0.0, 0.0, 0.3), 0.0),
    ],
)
def test_gap_of_two_outlines(pose: Pose, gap: float) -> None:
    other = placed(UNIT, pose)
    assert separation(UNIT, other)[0] == pytest.approx(gap, abs=1e-12)
    assert separation(other, UNIT)[0] == pytest.approx(gap, abs=1e-12)


def test_rays_end_at_the_nearest_outline() -> None:
    angles = np.array([0.0, math.pi / 4, math.pi / 2, math.pi])
    outlines = [placed(UNIT, Pose(3.0, 0.0)), placed(UNIT, Pose(5.0, 0.0)),
                placed(UNIT, Pose(2.0, 2.0))]  # fmt: skip
    ranges = cast(np.zeros(2), angles, outlines)
    assert ranges == pytest.approx([2.5, 1.5 * math.sqrt(2.0), np.inf, np.inf])


def test_driver_ranges_of_near_and_no_returns() -> None:
    truth = np.array([0.05, 1.0, np.inf])
    reported = replace(BURGER.scan, near="reported")
    assert driver_ranges(truth, reported).tolist() == [-np.inf, 1.0, 0.0]
    assert driver_ranges(truth, replace(reported, near="lost")).tolist() == [0.0, 1.0, 0.0]
    lost = replace(reported, near="lost", zero="no_return")
    assert driver_ranges(truth, lost).tolist() == [np.inf, 1.0, np.inf]


@pytest.mark.parametrize(
    ("now", "told", "then"),
    [
        (0.2, 0.0, 0.19),
        (0.005, -1.0, 0.0),
        (-0.2, 0.1, -0.19),
        (0.1, 0.3, 0.125),
        (0.0, 0.01, 0.01),
    ],
)
def test_speeds_change_at_the_rates_of_the_base(now: float, told: float, then: float) -> None:
    assert ramped(now, told, accelerating=2.5, braking=1.0) == pytest.approx(then)


def test_commands_and_scans_are_delayed() -> None:
    sim = FilterSim(off(BURGER), [pole(0.1, Pose(3.0, 0.0))], delay=0.03)
    run = sim.run(Twist(0.2), 1.0)
    moving = next(t for t, twist in zip(run.times, run.twists, strict=True) if twist.linear > 0)
    first = next(t for t, decision in run.decisions if decision.safe.linear > 0)
    assert first == pytest.approx(BURGER.scan.latency, abs=0.011)
    assert moving == pytest.approx(first + 0.04)  # 30 ms late, and noted at the step's end


def test_touch_ends_the_run_and_has_the_own_speed() -> None:
    sim = FilterSim(off(BURGER), [box(0.2, 0.2, Pose(0.5, 0.0), velocity=(-0.05, 0.0))])
    run = sim.run(Twist(0.2), 9.0)
    assert run.touch is not None
    assert run.touch.speed == pytest.approx(0.2)
    assert run.poses[-1].x == pytest.approx(0.4 - 0.05 * run.touch.time - 0.038, abs=0.003)
    assert run.min_gap == 0.0


def test_spinning_robot_touches_with_its_corner() -> None:
    sim = FilterSim(off(BURGER), [box(0.2, 2.0, Pose(0.25, 0.0))])
    run = sim.run(Twist(0.0, 2.0), 9.0)
    assert run.touch is None
    sim = FilterSim(off(BURGER), [box(2.0, 0.2, Pose(0.0, 0.21))])
    run = sim.run(Twist(0.0, 2.0), 9.0)
    assert run.touch is not None
    assert 0.05 < run.touch.speed < 2.0 * 0.135
