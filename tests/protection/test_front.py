from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from swarmd.messages import Reason
from swarmd.protection.front import Protection
from swarmd.protection.moment import Moment
from swarmd.protection.verdict import Verdict
from swarmd.settings import load_platform
from swarmd.values import ZERO, Array, Platform, Scan, Twist

WAFFLE = load_platform("waffle_pi")
WISH = Twist(0.2, 0.3)
FINITE = st.floats(-10, 10)


def scan_of(ranges: Array, platform: Platform = WAFFLE) -> Scan:
    spec = platform.scan
    return Scan(3, 1.0, ranges, spec.bearings, spec.range_min, spec.range_max)


def ahead(distance: float, rays: int, platform: Platform = WAFFLE) -> Scan:
    """Something ahead, `rays` wide, and nothing else."""
    ranges = np.full(len(platform.scan.bearings), np.inf)
    order = np.argsort(np.abs((platform.scan.bearings + math.pi) % (2.0 * math.pi) - math.pi))
    ranges[order[:rays]] = distance
    return scan_of(ranges, platform)


def decide(
    protection: Protection,
    wish: Twist | None = WISH,
    *,
    is_running: bool = True,
    hold: Reason | None = None,
    scan_age: float | None = 0.05,
) -> Verdict:
    moment = Moment(0.0, scan_age)
    return protection.decide(wish, moment, is_running=is_running, hold=hold)


def test_a_wish_passes_where_nothing_is_near() -> None:
    protection = Protection(WAFFLE)
    protection.observe(scan_of(np.full(360, np.inf)), Moment(0.0))
    verdict = decide(protection)
    assert verdict.safe == WISH
    assert (verdict.reason, verdict.is_active, verdict.min_gap) == (None, False, None)


def test_nothing_moves_before_the_first_scan() -> None:
    verdict = decide(Protection(WAFFLE), scan_age=None)
    assert verdict.safe == ZERO
    assert verdict.reason is Reason.NO_SCAN


@pytest.mark.parametrize(("is_running", "hold"), [(False, None), (True, Reason.STALE_SCAN)])
def test_exactly_zero_outside_running_and_under_a_hold_even_with_something_near(
    is_running: bool, hold: Reason | None
) -> None:
    protection = Protection(WAFFLE)
    protection.observe(ahead(0.2, 40), Moment(0.0))
    verdict = decide(protection, is_running=is_running, hold=hold)
    assert verdict.safe == ZERO
    assert verdict.reason is hold


@pytest.mark.parametrize(
    "wish", [Twist(float("nan")), Twist(0.1, float("inf")), Twist(0.0, 0.0, float("-inf"))]
)
def test_a_wish_that_is_no_number_is_none(wish: Twist) -> None:
    protection = Protection(WAFFLE)
    protection.observe(scan_of(np.full(360, np.inf)), Moment(0.0))
    verdict = decide(protection, wish)
    assert verdict.safe == ZERO
    assert verdict.reason is Reason.NO_WISH


def test_limits_hold_for_every_component() -> None:
    protection = Protection(WAFFLE)
    protection.observe(scan_of(np.full(360, np.inf)), Moment(0.0))
    verdict = decide(protection, Twist(9.0, -9.0, 9.0))
    assert verdict.safe == verdict.wish == Twist(0.26, -1.82, 0.0)


@pytest.mark.parametrize(("rays", "is_active"), [(5, False), (6, True)])
def test_the_papers_threshold_of_rays(rays: int, is_active: bool) -> None:
    protection = Protection(WAFFLE)
    protection.observe(ahead(0.4, rays), Moment(0.0))
    assert decide(protection).is_active is is_active


@pytest.mark.parametrize(("distance", "is_active"), [(0.51, False), (0.49, True)])
def test_the_papers_threshold_of_distance(distance: float, is_active: bool) -> None:
    protection = Protection(WAFFLE)
    protection.observe(ahead(distance, 40), Moment(0.0))
    assert decide(protection).is_active is is_active


def test_evades_backwards_from_a_wall_ahead_even_with_no_wish() -> None:
    protection = Protection(WAFFLE)
    protection.observe(ahead(0.3, 90), Moment(0.0))
    verdict = decide(protection, None)
    assert verdict.safe.linear < 0.0
    assert verdict.safe.linear == pytest.approx(-WAFFLE.limits.linear, rel=1e-3)
    assert verdict.is_active


def test_turns_away_from_what_is_on_its_left() -> None:
    ranges = np.full(360, np.inf)
    ranges[45:136] = 0.3
    protection = Protection(WAFFLE)
    protection.observe(scan_of(ranges), Moment(0.0))
    assert decide(protection).safe.angular == -1.82  # the paper's law alone would give 2.86


def test_drives_on_towards_something_narrow_as_the_papers_law_does() -> None:
    protection = Protection(WAFFLE)
    protection.observe(ahead(0.4, 8), Moment(0.0))
    verdict = decide(protection, Twist(0.1))
    assert verdict.is_active
    assert verdict.safe.linear == pytest.approx(0.26, rel=1e-3)


def test_too_close_to_measure_is_as_near_as_can_be_not_free() -> None:
    protection = Protection(WAFFLE)
    protection.observe(ahead(-math.inf, 90), Moment(0.0))
    verdict = decide(protection)
    assert verdict.is_active
    assert verdict.safe.linear < 0.0


def test_the_gap_is_measured_from_the_outline() -> None:
    protection = Protection(WAFFLE)
    protection.observe(ahead(1.0, 1), Moment(0.0))
    front = float(WAFFLE.footprint[:, 0].max())
    gap = decide(protection).min_gap
    assert gap == pytest.approx(1.0 + WAFFLE.scan.offset[0] - front, abs=1e-6)


@given(arrays(np.float64, 360), FINITE, FINITE, FINITE)
def test_any_scan_and_wish_give_a_finite_command_within_limits(
    ranges: Array, linear: float, angular: float, lateral: float
) -> None:
    protection = Protection(WAFFLE)
    clean = np.where(np.isnan(ranges) | (ranges < 0.12), -np.inf, ranges)
    clean = np.where(clean > 3.5, np.inf, clean)
    protection.observe(scan_of(clean), Moment(0.0))
    safe = decide(protection, Twist(linear, angular, lateral)).safe
    assert safe.is_finite
    assert abs(safe.linear) <= 0.26
    assert abs(safe.angular) <= 1.82
    assert safe.lateral == 0.0
