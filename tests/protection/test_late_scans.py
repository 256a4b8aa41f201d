"""Closed loop: scans that come later than declared, against obstacles at full speed."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import Pose, Twist
from swarmd.settings.settings import load_platform
from tests.support.filter_sim import FilterRun, FilterSim, box, under_barrier

NAMES = ("burger", "waffle_pi")
NO_FAULT = 0.02  # m/s
BEGIN = 5.0  # s, when the delay is known and the robot starts to drive


def met(name: str, late: Callable[[int], float], *, measures: bool = True) -> FilterRun:
    """A robot drives at full speed at a front that comes at exactly `others_speed`."""
    platform = under_barrier(load_platform(name), unseen_extent=0.0)
    speed = platform.protection["barrier"]["others_speed"]
    front = box(0.2, 3.0, Pose(2.0), velocity=(-speed, 0.0), begin=BEGIN)
    sim = FilterSim(platform, [front], phase=0.07, noise=0.005, late=late)
    if not measures:
        sim.sensors.scan_delay.on_scan = lambda scan, now: None  # type: ignore[method-assign]
    top = platform.limits.linear
    return sim.run(lambda time: Twist(top if time > BEGIN else 0.0), BEGIN + 8.0)


@pytest.mark.parametrize("late", [0.1, 0.2, 0.35])
@pytest.mark.parametrize("name", NAMES)
def test_late_scans_lead_to_no_fault_once_the_delay_is_measured(name: str, late: float) -> None:
    run = met(name, lambda seq: late)
    assert run.touch is not None
    assert run.touch.speed <= NO_FAULT


@pytest.mark.parametrize("name", NAMES)
def test_the_delay_must_be_measured_for_that(name: str) -> None:
    run = met(name, lambda seq: 0.2, measures=False)
    assert run.touch is not None
    assert run.touch.speed > NO_FAULT


@pytest.mark.parametrize("name", NAMES)
def test_jitter_leads_to_no_fault(name: str) -> None:
    run = met(name, lambda seq: 0.07 * (7 * seq % 4))
    assert run.touch is not None
    assert run.touch.speed <= NO_FAULT


def test_robot_does_not_drive_with_scans_later_than_protection_computes_with() -> None:
    run = met("burger", lambda seq: 0.45)
    assert run.decisions[-1][1].reason is Reason.LATE_SCAN
    assert max(abs(twist.linear) for twist in run.twists) == 0.0


def test_robot_drives_again_when_scans_are_in_time_again() -> None:
    burger = load_platform("burger")
    sim = FilterSim(burger, late=lambda seq: 0.45 if seq < 40 else 0.0)
    reasons = [decision.reason for _, decision in sim.run(Twist(0.1), 15.0).decisions]
    assert Reason.LATE_SCAN in reasons
    assert reasons[-1] is None
    changes = sum(one is not other for one, other in pairwise(reasons))
    assert changes <= 4  # it does not flap
    assert math.isclose(sim.twist.linear, 0.1)
