from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.values import ZERO, Platform, Pose, Scan, Twist
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import scan_from
from tests.support.filter_sim import FilterSim, box, decided
from tests.support.platforms import with_mode

BURGER = with_mode(load_platform("burger"), "stop_zone")
REQUESTED = Twist(0.2, 0.3)
FRONT = 0.038 + 0.032  # m from the lidar to the foremost of the outline


def ahead(gap: float, platform: Platform = BURGER) -> Scan:
    """One return, so far from the front of the outline."""
    ranges = np.full(360, math.inf)
    ranges[0] = FRONT + gap
    return scan_from(platform, ranges, platform.scan.bearings)


@pytest.mark.parametrize(("gap", "share"), [(0.26, 1.0), (0.24, 0.3), (0.11, 0.3), (0.09, 0.0)])
def test_two_zones_one_slows_and_one_stops(gap: float, share: float) -> None:
    decision = decided(BURGER, ahead(gap), REQUESTED)
    assert decision.safe.linear == pytest.approx(share * 0.2)
    assert decision.safe.angular == pytest.approx(share * 0.3)
    assert decision.is_active is (share < 1.0)


@given(st.floats(-0.22, 0.22), st.floats(-2.84, 2.84), st.floats(0.06, 1.0))
def test_it_only_ever_slows_down(v: float, w: float, gap: float) -> None:
    safe = decided(BURGER, ahead(gap), Twist(v, w)).safe
    share = safe.linear / v if abs(v) > 1e-6 else 1.0
    assert 0.0 <= share <= 1.0
    assert abs(safe.angular) <= abs(w)


def test_what_is_near_is_named() -> None:
    (row,) = decided(BURGER, ahead(0.2), REQUESTED).rows
    assert (row.bearing, row.gap) == pytest.approx((0.0, 0.2), abs=1e-9)
    assert row.cap == pytest.approx(0.3 * 0.22)


def test_who_wishes_nothing_is_not_held_back() -> None:
    decision = decided(BURGER, ahead(0.05), ZERO)
    assert (decision.safe, decision.is_active) == (ZERO, False)


def test_it_stops_before_a_wall_and_cannot_leave_it() -> None:
    """Which is why it is not the default."""
    yard = FilterSim(BURGER, [box(0.1, 4.0, Pose(0.6))])
    assert 0.05 < yard.run(Twist(0.22), 6.0).min_gap < 0.10
    stood = yard.pose
    yard.run(Twist(-0.22), 2.0)
    assert yard.pose.x == pytest.approx(stood.x)


def test_what_is_too_close_to_measure_stops_it() -> None:
    ranges = np.full(360, math.inf)
    ranges[90] = -math.inf
    decision = decided(BURGER, scan_from(BURGER, ranges, BURGER.scan.bearings), REQUESTED)
    assert decision.safe == ZERO
    assert (decision.rows[0].gap, decision.min_gap) == (0.0, 0.0)


def test_a_jackal_stops_before_what_it_is_blind_for() -> None:
    yard = FilterSim(with_mode(load_platform("jackal"), "stop_zone"), [box(0.1, 4.0, Pose(2.0))])
    ride = yard.run(Twist(0.5), 8.0)
    assert ride.touch is None
    assert ride.min_gap > 0.8 - 0.254
