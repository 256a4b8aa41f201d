"""The paper's law as a mode: what it evades, and that it evades at all."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.values import Array, Scan, Twist
from swarmd.protection.arbiter import Protection
from swarmd.protection.decision import Decision, DecisionContext
from swarmd.settings.platforms import load_platform
from tests.support.platforms import with_mode

WAFFLE = with_mode(load_platform("waffle_pi"), "potential_field")
REQUESTED = Twist(0.2, 0.3)


def scan_of(ranges: Array) -> Scan:
    spec = WAFFLE.scan
    return Scan(3, 1.0, ranges, spec.bearings, spec.range_min, spec.range_max)


def ahead(distance: float, rays: int) -> Scan:
    """Something ahead, `rays` wide, and nothing else."""
    ranges = np.full(len(WAFFLE.scan.bearings), np.inf)
    ranges[np.argsort(np.abs(WAFFLE.scan.bearings))[:rays]] = distance
    return scan_of(ranges)


def decided(scan: Scan, requested: Twist | None = REQUESTED) -> Decision:
    """What a wish becomes just after that scan."""
    protection = Protection(WAFFLE)
    protection.observe(scan, DecisionContext(0.0))
    return protection.decide(requested, DecisionContext(0.0, 0.05), is_running=True, hold=None)


@pytest.mark.parametrize(("rays", "is_active"), [(5, False), (6, True)])
def test_the_papers_threshold_of_rays(rays: int, is_active: bool) -> None:
    seen = ahead(0.4, rays)
    assert decided(seen).is_active is is_active


@pytest.mark.parametrize(("distance", "is_active"), [(0.51, False), (0.49, True)])
def test_the_papers_threshold_of_distance(distance: float, is_active: bool) -> None:
    seen = ahead(distance, 40)
    assert decided(seen).is_active is is_active


def test_evades_backwards_from_a_wall_ahead_even_with_no_wish() -> None:
    seen = ahead(0.3, 90)
    decision = decided(seen, None)
    assert decision.safe.linear < 0.0
    assert decision.safe.linear == pytest.approx(-WAFFLE.limits.linear, rel=1e-3)
    assert decision.is_active


def test_turns_away_from_what_is_on_its_left() -> None:
    ranges = np.full(360, np.inf)
    ranges[45:136] = 0.3
    seen = scan_of(ranges)
    assert decided(seen).safe.angular == -1.82  # the paper's law alone would give 2.86


def test_drives_on_towards_something_narrow_as_the_papers_law_does() -> None:
    seen = ahead(0.4, 8)
    decision = decided(seen, Twist(0.1))
    assert decision.is_active
    assert decision.safe.linear == pytest.approx(0.26, rel=1e-3)


def test_too_close_to_measure_is_as_near_as_can_be_not_free() -> None:
    seen = ahead(-math.inf, 90)
    decision = decided(seen)
    assert decision.is_active
    assert decision.safe.linear < 0.0
