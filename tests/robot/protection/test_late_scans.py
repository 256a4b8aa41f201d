"""Closed loop: scans that come later than declared, against obstacles at full speed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import Platform, Pose, Twist
from swarmd.settings.settings import load_platform
from tests.support.filter_sim import FilterRun, FilterSim, box, under_barrier
from tests.support.kernel_forms import long_run

NAMES = ("burger", "waffle_pi")
NO_FAULT = 0.02  # m/s
BEGIN = 5.0  # s, when the delay is known and the robot starts to drive


def at_ten_hertz(name: str) -> Platform:
    """The platform with a lidar as fast as that of a Jackal."""
    platform = under_barrier(load_platform(name), unseen_extent=0.0)
    return replace(platform, scan=replace(platform.scan, rate=10.0, latency=0.05, sweep=None))


def met(name: str, late: Callable[[int], float], *, measures: bool = True) -> FilterRun:
    """A robot drives at full speed at a front that comes at exactly `others_speed`."""
    platform = under_barrier(load_platform(name), unseen_extent=0.0)
    speed = platform.protection["barrier"]["others_speed"]
    front = box(0.2, 3.0, Pose(2.0), velocity=(-speed, 0.0), begin=BEGIN)
    sim = FilterSim(platform, [front], phase=0.07, noise=0.005, late=late)
    if not measures:
        sim.sensors.scan_delay = SimpleNamespace(  # type: ignore[assignment]
            on_scan=lambda scan, now: None, added=0.0, is_late=False
        )
    top = platform.limits.linear
    return sim.run(lambda time: Twist(top if time > BEGIN else 0.0), BEGIN + 8.0)


@long_run
@pytest.mark.parametrize("late", [0.1, 0.2, 0.35])
@pytest.mark.parametrize("name", NAMES)
def test_late_scans_lead_to_no_fault_once_the_delay_is_measured(name: str, late: float) -> None:
    run = met(name, lambda seq: late)
    assert run.touch is not None
    assert run.touch.speed <= NO_FAULT


@pytest.mark.parametrize("late", [0.23, 0.35, 0.48])
def test_later_scans_that_a_pattern_permits_lead_to_no_fault(late: float) -> None:
    """Later than the bound of a Waffle Pi with a lidar of 10 Hz, which is 0.2 s."""
    platform = at_ten_hertz("waffle_pi")
    assert platform.scan.max_scan_delay < late
    speed = platform.protection["barrier"]["others_speed"]
    front = box(0.2, 3.0, Pose(2.0), velocity=(-speed, 0.0), begin=BEGIN)
    sim = FilterSim(platform, [front], phase=0.07, noise=0.005, late=lambda seq: late)
    sim.sensors.permit_delay(0.5)
    top = platform.limits.linear
    run = sim.run(lambda time: Twist(top if time > BEGIN else 0.0), BEGIN + 8.0)
    assert max(twist.linear for twist in run.twists) > 0.5 * top
    assert run.touch is not None
    assert run.touch.speed <= NO_FAULT


@pytest.mark.parametrize(("permitted", "held"), [(0.0, True), (0.5, False), (0.3, True)])
def test_permitted_delay_is_the_bound_of_a_hold(permitted: float, held: bool) -> None:
    sim = FilterSim(at_ten_hertz("waffle_pi"), late=lambda seq: 0.35)
    sim.sensors.permit_delay(permitted)
    reasons = [decision.reason for _, decision in sim.run(Twist(0.1), 6.0).decisions]
    assert (reasons[-1] is Reason.LATE_SCAN) == held
    assert (reasons[-1] is None) != held


def test_permitted_late_scans_become_stale_within_two_periods() -> None:
    sim = FilterSim(at_ten_hertz("waffle_pi"), late=lambda seq: 0.35)
    sim.sensors.permit_delay(0.5)
    sim.run(Twist(), 6.0)
    sim.has_lidar = False
    decisions = sim.run(Twist(0.1), 1.5).decisions
    stale = next(time for time, decision in decisions if decision.reason is Reason.STALE_SCAN)
    assert stale - 6.0 < 0.35 + 0.2 + 0.1  # the scans under way still arrive


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
