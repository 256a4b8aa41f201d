"""Protection in every mode: holds, limits and reasons; modes `potential_field` and `stop_zone`."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Array, Odometry, Platform, Pose, Scan, TouchZone, Twist
from swarmd.protection.arbiter import Protection
from swarmd.protection.decision import Decision, DecisionContext, ModeDecision
from swarmd.protection.footprint import ScanGeometry
from swarmd.protection.settings import Mode
from swarmd.settings.settings import load_platform
from tests.support.filter_sim import FilterSim, box, decided
from tests.support.platforms import with_mode

WAFFLE, BURGER = load_platform("waffle_pi"), load_platform("burger")
FIELD, ZONE = with_mode(WAFFLE, "potential_field"), with_mode(BURGER, "stop_zone")
MODES: tuple[Mode, ...] = ("barrier", "potential_field", "stop_zone", "off")
REQUESTED = Twist(0.2, 0.3)
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
    requested: Twist | None = REQUESTED,
    *,
    is_running: bool = True,
    hold: Reason | None = None,
    scan_age: float | None = 0.05,
) -> Decision:
    context = DecisionContext(0.0, scan_age)
    return protection.decide(requested, context, is_running=is_running, hold=hold)


@pytest.fixture(params=MODES)
def protection(request: pytest.FixtureRequest) -> Protection:
    return Protection(with_mode(WAFFLE, request.param))


def test_request_passes_far_from_obstacles(protection: Protection) -> None:
    protection.observe(scan_of(np.full(360, np.inf)), DecisionContext(0.0))
    decision = decide(protection)
    assert decision.safe == REQUESTED
    assert (decision.reason, decision.is_active, decision.min_gap) == (None, False, None)


def test_zero_before_the_first_scan(protection: Protection) -> None:
    decision = decide(protection, scan_age=None)
    assert decision.safe == ZERO
    assert decision.reason is Reason.NO_SCAN


@pytest.mark.parametrize(("is_running", "hold"), [(False, None), (True, Reason.STALE_SCAN)])
def test_zero_outside_running_and_under_a_hold(
    protection: Protection, is_running: bool, hold: Reason | None
) -> None:
    protection.observe(ahead(0.2, 40), DecisionContext(0.0))
    decision = decide(protection, is_running=is_running, hold=hold)
    assert decision.safe == ZERO
    assert decision.reason is hold


@pytest.mark.parametrize(
    "requested", [Twist(float("nan")), Twist(0.1, float("inf")), Twist(0.0, 0.0, float("-inf"))]
)
def test_non_finite_request_is_zero(protection: Protection, requested: Twist) -> None:
    protection.observe(scan_of(np.full(360, np.inf)), DecisionContext(0.0))
    decision = decide(protection, requested)
    assert decision.safe == ZERO
    assert decision.reason is Reason.NO_REQUESTED_COMMAND


def test_limits_apply_to_every_component(protection: Protection) -> None:
    protection.observe(scan_of(np.full(360, np.inf)), DecisionContext(0.0))
    decision = decide(protection, Twist(9.0, -9.0, 9.0))
    assert decision.safe == decision.requested == Twist(0.26, -1.82, 0.0)


def test_gap_is_measured_from_the_outline(protection: Protection) -> None:
    protection.observe(ahead(1.0, 1), DecisionContext(0.0))
    front = float(WAFFLE.footprint[:, 0].max())
    gap = decide(protection).min_gap
    assert gap == pytest.approx(1.0 + WAFFLE.scan.offset[0] - front, abs=1e-6)


@given(st.sampled_from(MODES), arrays(np.float64, 360), FINITE, FINITE, FINITE)
def test_every_scan_and_request_give_a_finite_command_within_limits(
    mode: Mode, ranges: Array, linear: float, angular: float, lateral: float
) -> None:
    protection = Protection(with_mode(WAFFLE, mode))
    clean = np.where(np.isnan(ranges) | (ranges < 0.12), -np.inf, ranges)
    clean = np.where(clean > 3.5, np.inf, clean)
    protection.observe(scan_of(clean), DecisionContext(0.0))
    safe = decide(protection, Twist(linear, angular, lateral)).safe
    assert safe.is_finite
    assert abs(safe.linear) <= 0.26
    assert abs(safe.angular) <= 1.82
    assert safe.lateral == 0.0


def test_command_at_rounding_level_counts_as_zero() -> None:
    """The feasible command nearest to a blocked one may be 1e-17 m/s."""
    wall = ahead(0.30, 40)
    reasons = set()
    for share in np.linspace(0.01, 1.0, 60):
        protection = Protection(with_mode(WAFFLE, "barrier"))
        protection.observe(wall, DecisionContext(0.0, 0.05, Odometry(0.0, Pose(), ZERO), 0.05))
        decision = protection.decide(
            Twist(share * 0.26, share * 0.01),
            DecisionContext(0.0, 0.05, Odometry(0.0, Pose(), ZERO), 0.05),
            is_running=True,
            hold=None,
        )
        if abs(decision.safe.linear) + abs(decision.safe.angular) < 1e-9:
            reasons.add(decision.reason)
    assert reasons == {Reason.PROTECTION}


class FixedArbiter:
    """An arbiter that returns a fixed command."""

    mode = "fixed"

    def __init__(self, twist: Twist) -> None:
        self._twist = twist

    def clearance(self, speed: float) -> None:
        """Never blocks."""

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """Ignores the scan."""

    def decide(
        self, requested: Twist, context: DecisionContext, *, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The fixed command."""
        return ModeDecision(self._twist, is_active=True)


def safe_command(twist: Twist) -> tuple[Twist, Reason | None]:
    """The safe command and its reason."""
    protection = Protection(BURGER)
    protection._arbiter = FixedArbiter(twist)
    context = DecisionContext(1.0, 0.1, Odometry(1.0, Pose(), ZERO), 0.0)
    decision = protection.decide(Twist(0.1), context, is_running=True, hold=None)
    return decision.safe, decision.reason


@pytest.mark.parametrize("twist", [Twist(math.nan), Twist(0.1, math.inf), Twist(0.1, -math.inf)])
def test_non_finite_command_of_an_arbiter_becomes_zero(twist: Twist) -> None:
    assert safe_command(twist) == (ZERO, Reason.PROTECTION)


def test_command_of_an_arbiter_is_clipped_to_the_limits() -> None:
    assert safe_command(Twist(-9.0, 9.0, 9.0)) == (Twist(-0.22, 2.84, 0.0), None)


def decide_by_field(scan: Scan, requested: Twist | None = REQUESTED) -> Decision:
    """The decision directly after a scan."""
    protection = Protection(FIELD)
    protection.observe(scan, DecisionContext(0.0))
    return protection.decide(requested, DecisionContext(0.0, 0.05), is_running=True, hold=None)


@pytest.mark.parametrize(("rays", "is_active"), [(5, False), (6, True)])
def test_field_threshold_of_rays_is_that_of_the_paper(rays: int, is_active: bool) -> None:
    seen = ahead(0.4, rays)
    assert decide_by_field(seen).is_active is is_active


@pytest.mark.parametrize(("distance", "is_active"), [(0.51, False), (0.49, True)])
def test_field_threshold_of_distance_is_that_of_the_paper(distance: float, is_active: bool) -> None:
    seen = ahead(distance, 40)
    assert decide_by_field(seen).is_active is is_active


def test_field_evades_backwards_even_without_a_request() -> None:
    seen = ahead(0.3, 90)
    decision = decide_by_field(seen, None)
    assert decision.safe.linear < 0.0
    assert decision.safe.linear == pytest.approx(-FIELD.limits.linear, rel=1e-3)
    assert decision.is_active


def test_field_turns_away_from_an_obstacle_on_the_left() -> None:
    ranges = np.full(360, np.inf)
    ranges[45:136] = 0.3
    seen = scan_of(ranges)
    assert decide_by_field(seen).safe.angular == -1.82  # the paper's law alone would give 2.86


def test_field_drives_on_towards_a_narrow_obstacle() -> None:
    seen = ahead(0.4, 8)
    decision = decide_by_field(seen, Twist(0.1))
    assert decision.is_active
    assert decision.safe.linear == pytest.approx(0.26, rel=1e-3)


def test_field_evades_a_return_too_close_to_measure() -> None:
    seen = ahead(-math.inf, 90)
    decision = decide_by_field(seen)
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


def test_stop_zone_reports_the_nearest_return() -> None:
    (row,) = decided(ZONE, before(0.2), REQUESTED).rows
    assert (row.bearing, row.gap) == pytest.approx((0.0, 0.2), abs=1e-9)
    assert row.cap == pytest.approx(0.3 * 0.22)


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
    ranges = np.full(360, math.inf)
    ranges[90] = -math.inf
    decision = decided(ZONE, scan_of(ranges, ZONE), REQUESTED)
    assert decision.safe == ZERO
    assert (decision.rows[0].gap, decision.min_gap) == (0.0, 0.0)


def test_jackal_stops_outside_its_blind_zone() -> None:
    sim = FilterSim(with_mode(load_platform("jackal"), "stop_zone"), [box(0.1, 4.0, Pose(2.0))])
    run = sim.run(Twist(0.5), 8.0)
    assert run.touch is None
    assert run.min_gap > 0.8 - 0.254
