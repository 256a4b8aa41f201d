"""Modes `potential_field` and `stop_zone`."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.values import ZERO, Platform, Pose, Scan, Twist
from swarmd.robot.protection.decision import Decision, DecisionContext
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import scan_from
from tests.support.filter_sim import FilterSim, box, decided
from tests.support.platforms import with_mode
from tests.support.protection import Protection

WAFFLE, BURGER = load_platform("waffle_pi"), load_platform("burger")
FIELD, ZONE = with_mode(WAFFLE, "potential_field"), with_mode(BURGER, "stop_zone")
REQUESTED = Twist(0.2, 0.3)
FINITE = st.floats(-10, 10)


def ahead(distance: float, rays: int, platform: Platform = WAFFLE, *, middle: int = 0) -> Scan:
    """Returns in `rays` rays around ray `middle`, one ray a degree, and nothing else."""
    ranges = np.full(360, np.inf)
    ranges[np.arange(rays) - rays // 2 + middle] = distance
    return scan_from(platform, ranges, platform.scan.bearings)


def decide_by_field(scan: Scan, requested: Twist | None = REQUESTED) -> Decision:
    """The decision directly after a scan."""
    protection = Protection(FIELD)
    protection.observe(scan, DecisionContext(0.0))
    return protection.decide(requested, DecisionContext(0.0, 0.05), is_running=True, hold=None)


@pytest.mark.parametrize(
    ("distance", "rays", "is_active"),
    [(0.4, 5, False), (0.4, 6, True), (0.51, 40, False), (0.49, 40, True)],
)
def test_field_thresholds_are_those_of_the_paper(
    distance: float, rays: int, is_active: bool
) -> None:
    assert decide_by_field(ahead(distance, rays)).is_active is is_active


def test_field_evades_backwards_even_without_a_request() -> None:
    decision = decide_by_field(ahead(0.3, 90), None)
    assert decision.safe.linear == pytest.approx(-FIELD.limits.linear, rel=1e-3)
    assert decision.is_active


def test_field_turns_away_from_an_obstacle_on_the_left() -> None:
    seen = ahead(0.3, 91, middle=90)
    assert decide_by_field(seen).safe.angular == -1.82  # the paper's law alone would give 2.86


def test_field_drives_on_towards_a_narrow_obstacle() -> None:
    decision = decide_by_field(ahead(0.4, 8), Twist(0.1))
    assert decision.is_active
    assert decision.safe.linear == pytest.approx(0.26, rel=1e-3)


def test_field_evades_a_return_too_close_to_measure() -> None:
    decision = decide_by_field(ahead(-math.inf, 90))
    assert decision.is_active
    assert decision.safe.linear < 0.0


FRONT = 0.038 + 0.032  # m from the lidar to the foremost of the outline


def before(gap: float) -> Scan:
    """One return, so far from the front of the outline."""
    return ahead(FRONT + gap, 1, ZONE)


@pytest.mark.parametrize(("gap", "share"), [(0.26, 1.0), (0.24, 0.3), (0.11, 0.3), (0.09, 0.0)])
def test_stop_zone_slows_and_stops(gap: float, share: float) -> None:
    decision = decided(ZONE, before(gap), REQUESTED)
    assert decision.safe.linear == pytest.approx(share * 0.2)
    assert decision.safe.angular == pytest.approx(share * 0.3)
    assert decision.is_active is (share < 1.0)


@given(st.floats(-0.22, 0.22), st.floats(-2.84, 2.84), st.floats(0.06, 1.0))
def test_stop_zone_only_slows_down(v: float, w: float, gap: float) -> None:
    safe = decided(ZONE, before(gap), Twist(v, w)).safe
    share = safe.linear / v if abs(v) > 1e-6 else 1.0
    assert 0.0 <= share <= 1.0
    assert abs(safe.angular) <= abs(w)


@pytest.mark.parametrize(("gap", "cap"), [(0.2, 0.3 * 0.22), (0.05, 0.0)])
def test_stop_zone_reports_the_nearest_return(gap: float, cap: float) -> None:
    (row,) = decided(ZONE, before(gap), REQUESTED).rows
    assert (row.bearing, row.gap, row.cap) == pytest.approx((0.0, gap, cap), abs=1e-9)


def test_stop_zone_is_inactive_for_a_zero_request() -> None:
    decision = decided(ZONE, before(0.05), ZERO)
    assert (decision.safe, decision.is_active) == (ZERO, False)


def test_stop_zone_stops_at_a_wall_and_cannot_leave() -> None:
    """So it is not the default mode."""
    sim = FilterSim(ZONE, [box(0.1, 4.0, Pose(0.6))])
    assert 0.05 < sim.run(Twist(0.22), 6.0).min_gap < 0.10
    stood = sim.pose
    sim.run(Twist(-0.22), 2.0)
    assert sim.pose.x == pytest.approx(stood.x)


def test_return_too_close_to_measure_stops_in_stop_zone() -> None:
    decision = decided(ZONE, ahead(-math.inf, 1, ZONE, middle=90), REQUESTED)
    assert decision.safe == ZERO
    assert (decision.rows[0].gap, decision.min_gap) == (0.0, 0.0)


def test_jackal_stops_outside_its_blind_zone() -> None:
    sim = FilterSim(with_mode(load_platform("jackal"), "stop_zone"), [box(0.1, 4.0, Pose(2.0))])
    run = sim.run(Twist(0.5), 8.0)
    assert run.touch is None
    assert run.min_gap > 0.8 - 0.254
