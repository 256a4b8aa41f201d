"""Protection in every mode: holds, limits and reasons."""

from __future__ import annotations

import math
from dataclasses import replace
from random import Random
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from msgspec import structs

from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Array, Odometry, Pose, Scan, TouchZone, Twist
from swarmd.robot.protection.decision import (
    Clearance,
    Decision,
    DecisionContext,
    ModeDecision,
    Permit,
    Steered,
    ToldObstacle,
)
from swarmd.robot.protection.footprint import ScanGeometry
from swarmd.robot.protection.settings import Mode, Speed
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import scan_from
from tests.support.kernel_forms import both_forms, compares_forms, interpreted
from tests.support.platforms import with_mode
from tests.support.protection import Commander, Protection

if TYPE_CHECKING:
    from swarmd.robot.steering.right_of_way import RightOfWay
else:
    RightOfWay = interpreted(
        "swarmd.robot.steering.right_of_way", because="a test replaces a part of it"
    ).RightOfWay

WAFFLE, BURGER = load_platform("waffle_pi"), load_platform("burger")
MODES: tuple[Mode, ...] = ("barrier", "potential_field", "stop_zone", "off")
REQUESTED = Twist(0.2, 0.3)
FINITE = st.floats(-10, 10)


def scan_of(ranges: Array) -> Scan:
    return scan_from(WAFFLE, ranges, WAFFLE.scan.bearings)


def ahead(distance: float, rays: int) -> Scan:
    """Returns in `rays` rays around ahead, and nothing else."""
    ranges = np.full(360, np.inf)
    ranges[np.arange(rays) - rays // 2] = distance
    return scan_of(ranges)


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


def test_a_scan_within_the_same_instant_is_decided_anew() -> None:
    """A decision is repeated for the same inputs alone."""
    protection, context = Protection(with_mode(WAFFLE, "barrier")), DecisionContext(0.0, 0.0)
    protection.observe(scan_of(np.full(360, np.inf)), context)
    assert protection.decide(REQUESTED, context, True, None).safe == REQUESTED
    protection.observe(ahead(0.2, 40), context)
    assert protection.decide(REQUESTED, context, True, None).safe.linear < REQUESTED.linear


def test_after_a_hold_a_command_of_the_same_instant_is_in_force_again() -> None:
    """The monitors compare the base with the command that it gets, not with the zero before."""
    protection, context = Protection(with_mode(WAFFLE, "barrier")), DecisionContext(0.0, 0.0)
    protection.observe(scan_of(np.full(360, np.inf)), context)
    protection.decide(REQUESTED, context, True, None)
    protection.decide(REQUESTED, context, True, Reason.STALE_SCAN)
    assert protection.mode_command == ZERO
    assert protection.decide(REQUESTED, context, True, None).safe == REQUESTED
    assert protection.mode_command == REQUESTED


@pytest.mark.parametrize(
    ("requested", "speed", "wanted"),
    [
        (Twist(0.2, 0.3), 0.1, Twist(0.1, 0.15)),  # the curve stays
        (Twist(-0.2, 0.3), 0.1, Twist(-0.1, 0.15)),
        (Twist(0.2, 0.3), 0.2, Twist(0.2, 0.3)),
        (Twist(0.0, 1.0), 0.1, Twist(0.0, 1.0)),
        (Twist(0.2), None, Twist(0.2)),
    ],
)
def test_no_command_is_faster_than_its_run_may_be(
    protection: Protection, requested: Twist, speed: float | None, wanted: Twist
) -> None:
    context = DecisionContext(0.0, 0.0)
    protection.observe(scan_of(np.full(360, np.inf)), context)
    permit = Permit(speed=speed)
    decision = protection.decide(requested, context, True, None, permit)
    assert structs.astuple(decision.safe) == pytest.approx(structs.astuple(wanted), abs=1e-12)
    assert (decision.reason, decision.is_bounded) == (None, False)

    # Steering asks for more, and the same instant is decided anew for another bound.
    steered = Steered(Twist(0.25), is_recovering=True)
    fast = protection.decide(requested, context, True, None, permit, steered)
    assert fast.safe.linear == pytest.approx(speed or 0.25)
    slower = protection.decide(requested, context, True, None, Permit(speed=0.05), steered)
    assert slower.safe.linear == pytest.approx(0.05)


@pytest.mark.parametrize("distance", [0.05, 0.2, 0.3])
def test_the_command_of_a_mode_beside_an_obstacle_keeps_the_bound(
    protection: Protection, distance: float
) -> None:
    """Modes that change a request may raise its speed, as one that backs away."""
    context = DecisionContext(0.0, 0.0)
    protection.observe(ahead(distance, 60), context)
    for requested in (Twist(0.2), Twist(0.01, 1.0), Twist(-0.2), ZERO):
        free = protection.decide(requested, context, True, None).safe
        slow = protection.decide(requested, context, True, None, Permit(speed=0.01)).safe
        assert math.hypot(slow.linear, slow.lateral) <= 0.01 + 1e-12
        assert abs(slow.angular) <= abs(free.angular) + abs(requested.angular) + 1e-12


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


@given(
    st.sampled_from(MODES),
    arrays(np.float64, 360, elements=st.floats(0.1, 4.0)),
    st.builds(Twist, st.floats(), st.floats(), st.floats()),
)
def test_what_steering_asks_gets_what_a_request_gets(
    mode: Mode, ranges: Array, asked: Twist
) -> None:
    """Steering may be wrong: its command is judged as if the pattern had requested it."""
    context = DecisionContext(1.0, 0.1, Odometry(1.0, Pose(), ZERO), 0.0)
    steered, plain = (Protection(with_mode(WAFFLE, mode)) for _ in range(2))
    for one in (steered, plain):
        one.observe(scan_of(np.where(ranges > 3.5, np.inf, ranges)), context)
    safe = steered.decide(REQUESTED, context, True, None, steered=Steered(asked)).safe
    assert safe.is_finite
    assert WAFFLE.limits.clip(safe) == safe
    if asked.is_finite:
        assert safe == plain.decide(asked, context, True, None).safe


@pytest.mark.parametrize(
    ("is_running", "hold", "scan_age"),
    [(False, None, 0.1), (True, Reason.STALE_SCAN, 0.1), (True, None, None)],
    ids=["not running", "held", "no scan"],
)
def test_steering_moves_no_robot_that_must_stand(
    is_running: bool, hold: Reason | None, scan_age: float | None
) -> None:
    protection = Protection(with_mode(WAFFLE, "off"))
    context, asked = DecisionContext(1.0, scan_age), Steered(Twist(0.1), is_recovering=True)
    assert protection.decide(REQUESTED, context, is_running, hold, steered=asked).safe == ZERO


@pytest.mark.parametrize("mode", MODES)
def test_what_protection_permits_is_what_it_then_decides(mode: Mode) -> None:
    protection = Protection(with_mode(WAFFLE, mode))
    context = DecisionContext(1.0, 0.1, Odometry(1.0, Pose(), ZERO), 0.0)
    protection.observe(ahead(0.6, 40), context)
    for twist in (Twist(0.26), Twist(9.0, 0.5), Twist(-0.1), ZERO):
        permitted = protection.permitted(context, None, twist)
        assert protection.decide(twist, context, True, None).safe == permitted


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


class FixedMode:
    """A mode that returns a fixed command."""

    mode = "fixed"

    def __init__(self, twist: Twist) -> None:
        self._twist = twist

    def clearance(self, speed: float) -> None:
        """Never blocks."""

    def observe(self, scan: Scan, geometry: ScanGeometry, context: DecisionContext) -> None:
        """Ignores the scan."""

    def decide(
        self, requested: Twist, context: DecisionContext, command: Twist, touch: TouchZone | None
    ) -> ModeDecision:
        """The fixed command."""
        return ModeDecision(self._twist, is_active=True)


def safe_command(twist: Twist) -> tuple[Twist, Reason | None]:
    """The safe command and its reason."""
    protection = Protection(BURGER)
    protection._mode = FixedMode(twist)
    context = DecisionContext(1.0, 0.1, Odometry(1.0, Pose(), ZERO), 0.0)
    decision = protection.decide(Twist(0.1), context, is_running=True, hold=None)
    return decision.safe, decision.reason


@pytest.mark.parametrize("twist", [Twist(math.nan), Twist(0.1, math.inf), Twist(0.1, -math.inf)])
def test_non_finite_command_of_a_mode_becomes_zero(twist: Twist) -> None:
    assert safe_command(twist) == (ZERO, Reason.PROTECTION)


def test_command_of_a_mode_is_clipped_to_the_limits() -> None:
    assert safe_command(Twist(-9.0, 9.0, 9.0)) == (Twist(-0.22, 2.84, 0.0), None)


def test_a_case_is_judged_once_until_something_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same command in the same context; a scan, another command or a hold ends it."""
    protection = Protection(with_mode(load_platform("waffle_pi"), "off"))
    mode, judged = protection._mode, list[Twist]()
    judge = mode.decide

    def counted(requested: Twist, *args: Any, **more: Any) -> ModeDecision:
        judged.append(requested)
        decision: ModeDecision = judge(requested, *args, **more)
        return decision

    monkeypatch.setattr(mode, "decide", counted)
    context = DecisionContext(1.0, 0.0)

    def decided(twist: Twist, at: DecisionContext, hold: Reason | None = None) -> Decision:
        return protection.decide(twist, at, is_running=True, hold=hold)

    first = decided(Twist(0.1), context)
    assert decided(Twist(0.1), context) is first
    assert len(judged) == 1
    assert decided(Twist(0.2), context).safe == Twist(0.2)
    assert decided(Twist(0.1), context).safe == Twist(0.1)
    assert decided(Twist(0.1), DecisionContext(1.0, 0.0)).safe == Twist(0.1)
    assert len(judged) == 4
    assert decided(Twist(0.1), context, Reason.STALE_SCAN).safe == Twist()
    assert decided(Twist(0.1), context).safe == Twist(0.1)
    assert len(judged) == 5


def test_right_of_way_gets_the_last_reading_before_avoidance_began_and_all_since() -> None:
    """Else it would not see a jump of the pose between the two, which moves all openings."""
    kernel = interpreted("swarmd.robot.steering.steering", because="it replaces a private part")
    readings: list[float] = []

    class Way(RightOfWay):
        def on_odometry(self, odometry: Odometry) -> None:
            readings.append(odometry.stamp)

    platform = with_mode(WAFFLE, "barrier")
    steering = kernel.Steering(platform, Protection(platform))
    steering._right_of_way = Way(Clearance(1.0, 0.3), WAFFLE.limits, "")
    permits = (False, False, True, True, False, False)  # avoidance
    for stamp, avoids in enumerate(permits):
        steering.on_odometry(Odometry(float(stamp), Pose(), ZERO))
        context = DecisionContext(float(stamp), 0.0)
        permit = Permit(may_recover=True, avoids=avoids)
        steering.steer(ZERO, context, is_running=True, hold=None, permit=permit)
    assert readings == [2.0, 3.0, 4.0, 5.0]


@compares_forms
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("avoidance", ["none", "orca"])
def test_compiled_and_interpreted_code_decide_the_same(mode: Mode, avoidance: str) -> None:
    platform = with_mode(WAFFLE, mode)
    platform = replace(platform, protection={**platform.protection, "avoidance": avoidance})
    draw = Random(3)
    kernels = map(
        both_forms, ("swarmd.robot.protection.protection", "swarmd.robot.steering.steering")
    )
    ones = [Commander(platform, forms) for forms in zip(*kernels, strict=True)]
    now, pose, twist = 10.0, Pose(), ZERO
    requested: Twist | None = None
    permit, seen = Permit(), set[tuple[Reason | None, bool, bool]]()
    for step in range(400):
        now += draw.choice((0.0, 0.05, 0.05))
        pose = Pose(pose.x + 0.05 * twist.linear, pose.y, pose.yaw + 0.05 * twist.angular)
        odometry = Odometry(now, pose, twist)
        near = (ToldObstacle(0.3, 0.1, 0.05, 0.1),) * draw.choice((0, 0, 0, 1))
        context = DecisionContext(now, draw.choice((0.0, 0.1)), odometry, 0.0, near=near)
        scan = ahead(draw.choice((0.15, 0.4, 2.0)), draw.choice((1, 60)))
        if step % 20 == 0:
            requested = draw.choice((None, ZERO, Twist(0.2), Twist(0.1, 2.5), Twist(math.nan)))
            speed = (None, 0.1)[step // 20 % 2]
            permit = Permit(True, draw.choice((None, TouchZone(0.0, 0.5, 0.05))), speed=speed)
        is_running, is_held = draw.random() < 0.95, draw.random() < 0.05
        decisions = []
        for one in ones:
            if step % 4 == 0:
                one.observe(structs.replace(scan, seq=step, stamp=now), context)
            one.on_odometry(odometry)
            for _ in range(2):
                hold = Reason.STALE_SCAN if is_held else None
                decisions.append(
                    one.decide(requested, context, is_running=is_running, hold=hold, permit=permit)
                )
        assert decisions[:2] == decisions[2:]
        first, second = (one.protection for one in ones)
        assert (first.findings, first.events) == (second.findings, second.events)
        assert first.following.text == second.following.text
        twist = decisions[0].safe
        seen.add((decisions[0].reason, decisions[0].is_active, decisions[0].is_recovering))
    assert len(seen) >= (3 if mode == "off" else 4)


@pytest.mark.parametrize(
    ("lidar", "ring", "least"),
    [(None, 1.0, 1.0), (1.0, None, 1.0), (1.0, 2.0, 1.0), (2.0, 1.0, 1.0), (None, None, None)],
)
def test_the_least_gap_is_that_of_lidar_or_ring(
    lidar: float | None, ring: float | None, least: float | None
) -> None:
    """In m from the front of a Burger, of a return straight ahead."""
    protection = Protection(with_mode(BURGER, "off"))
    front = max(x for x, _ in BURGER.footprint)
    near = () if ring is None else (ToldObstacle(front + ring, 0.0, radius=0.0, age=0.0),)
    context = DecisionContext(0.0, 0.05, near=near)
    ranges = np.full(360, np.inf)
    if lidar is not None:
        ranges[0] = lidar + front - BURGER.scan.offset[0]
    scan = scan_from(BURGER, ranges, BURGER.scan.bearings)
    protection.observe(scan, context)
    decision = protection.decide(REQUESTED, context, is_running=True, hold=None)
    assert decision.min_gap == (None if least is None else pytest.approx(least, abs=1e-6))


def test_a_speed_above_20_m_s_is_no_setting() -> None:
    assert msgspec.convert(20.0, Speed) == 20.0
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(20.5, Speed)
