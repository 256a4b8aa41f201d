"""Modes `potential_field` and `stop_zone`."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.values import ZERO, Array, Platform, Pose, Scan, Twist
from swarmd.protection.arbiter import Protection
from swarmd.protection.decision import Decision, DecisionContext
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import scan_from
from tests.support.filter_sim import FilterSim, box, decided
from tests.support.platforms import with_mode

WAFFLE = with_mode(load_platform("waffle_pi"), "potential_field")
REQUESTED = Twist(0.2, 0.3)


def field_scan(ranges: Array) -> Scan:
    spec = WAFFLE.scan
    return Scan(3, 1.0, ranges, spec.bearings, spec.range_min, spec.range_max)


def wall_ahead(distance: float, rays: int) -> Scan:
    """Something wall_ahead, `rays` wide, and nothing else."""
    ranges = np.full(len(WAFFLE.scan.bearings), np.inf)
    ranges[np.argsort(np.abs(WAFFLE.scan.bearings))[:rays]] = distance
    return field_scan(ranges)


def decide_by_field(scan: Scan, requested: Twist | None = REQUESTED) -> Decision:
    """The decision directly after a scan."""
    protection = Protection(WAFFLE)
    protection.observe(scan, DecisionContext(0.0))
    return protection.decide(requested, DecisionContext(0.0, 0.05), is_running=True, hold=None)


@pytest.mark.parametrize(("rays", "is_active"), [(5, False), (6, True)])
def test_field_threshold_of_rays_is_that_of_the_paper(rays: int, is_active: bool) -> None:
    seen = wall_ahead(0.4, rays)
    assert decide_by_field(seen).is_active is is_active


@pytest.mark.parametrize(("distance", "is_active"), [(0.51, False), (0.49, True)])
def test_field_threshold_of_distance_is_that_of_the_paper(distance: float, is_active: bool) -> None:
    seen = wall_ahead(distance, 40)
    assert decide_by_field(seen).is_active is is_active


def test_field_evades_backwards_even_without_a_request() -> None:
    seen = wall_ahead(0.3, 90)
    decision = decide_by_field(seen, None)
    assert decision.safe.linear < 0.0
    assert decision.safe.linear == pytest.approx(-WAFFLE.limits.linear, rel=1e-3)
    assert decision.is_active


def test_field_turns_away_from_an_obstacle_on_the_left() -> None:
    ranges = np.full(360, np.inf)
    ranges[45:136] = 0.3
    seen = field_scan(ranges)
    assert decide_by_field(seen).safe.angular == -1.82  # the paper's law alone would give 2.86


def test_field_drives_on_towards_a_narrow_obstacle() -> None:
    seen = wall_ahead(0.4, 8)
    decision = decide_by_field(seen, Twist(0.1))
    assert decision.is_active
    assert decision.safe.linear == pytest.approx(0.26, rel=1e-3)


def test_field_evades_a_return_too_close_to_measure() -> None:
    seen = wall_ahead(-math.inf, 90)
    decision = decide_by_field(seen)
    assert decision.is_active
    assert decision.safe.linear < 0.0


BURGER = with_mode(load_platform("burger"), "stop_zone")
REQUESTED = Twist(0.2, 0.3)
FRONT = 0.038 + 0.032  # m from the lidar to the foremost of the outline


def ahead(gap: float, platform: Platform = BURGER) -> Scan:
    """One return, so far from the front of the outline."""
    ranges = np.full(360, math.inf)
    ranges[0] = FRONT + gap
    return scan_from(platform, ranges, platform.scan.bearings)


@pytest.mark.parametrize(("gap", "share"), [(0.26, 1.0), (0.24, 0.3), (0.11, 0.3), (0.09, 0.0)])
def test_stop_zone_slows_and_stops(gap: float, share: float) -> None:
    decision = decided(BURGER, ahead(gap), REQUESTED)
    assert decision.safe.linear == pytest.approx(share * 0.2)
    assert decision.safe.angular == pytest.approx(share * 0.3)
    assert decision.is_active is (share < 1.0)


@given(st.floats(-0.22, 0.22), st.floats(-2.84, 2.84), st.floats(0.06, 1.0))
def test_stop_zone_only_slows_down(v: float, w: float, gap: float) -> None:
    safe = decided(BURGER, ahead(gap), Twist(v, w)).safe
    share = safe.linear / v if abs(v) > 1e-6 else 1.0
    assert 0.0 <= share <= 1.0
    assert abs(safe.angular) <= abs(w)


def test_stop_zone_reports_the_nearest_return() -> None:
    (row,) = decided(BURGER, ahead(0.2), REQUESTED).rows
    assert (row.bearing, row.gap) == pytest.approx((0.0, 0.2), abs=1e-9)
    assert row.cap == pytest.approx(0.3 * 0.22)


def test_stop_zone_is_inactive_for_a_zero_request() -> None:
    decision = decided(BURGER, ahead(0.05), ZERO)
    assert (decision.safe, decision.is_active) == (ZERO, False)


def test_stop_zone_stops_at_a_wall_and_cannot_leave() -> None:
    """So it is not the default mode."""
    sim = FilterSim(BURGER, [box(0.1, 4.0, Pose(0.6))])
    assert 0.05 < sim.run(Twist(0.22), 6.0).min_gap < 0.10
    stood = sim.pose
    sim.run(Twist(-0.22), 2.0)
    assert sim.pose.x == pytest.approx(stood.x)


def test_return_too_close_to_measure_stops_in_stop_zone() -> None:
    ranges = np.full(360, math.inf)
    ranges[90] = -math.inf
    decision = decided(BURGER, scan_from(BURGER, ranges, BURGER.scan.bearings), REQUESTED)
    assert decision.safe == ZERO
    assert (decision.rows[0].gap, decision.min_gap) == (0.0, 0.0)


def test_jackal_stops_outside_its_blind_zone() -> None:
    sim = FilterSim(with_mode(load_platform("jackal"), "stop_zone"), [box(0.1, 4.0, Pose(2.0))])
    run = sim.run(Twist(0.5), 8.0)
    assert run.touch is None
    assert run.min_gap > 0.8 - 0.254
