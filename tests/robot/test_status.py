"""The status of a robot: protection and readings."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace

from swarmd.core.avoided import Avoided, WayState
from swarmd.core.codec import Decoder, encode
from swarmd.core.events import DriverInput, ReadingsInput
from swarmd.core.messages import DecisionSummary, LimitingObstacle, Reason, Status
from swarmd.core.values import Neighbor, Scan, Twist
from swarmd.robot.protection.decision import Decision
from swarmd.robot.sensors import Sensors
from swarmd.robot.status import MAX_ROWS
from swarmd.robot.status import _avoided as avoided_text
from swarmd.robot.status import _summary as make_summary
from swarmd.robot.ticker import DutyCycle
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import empty_scan
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS

decode = Decoder(Status)
BARRIER = "extends: waffle_pi\nprotection: {mode: barrier}\n"


@pytest.fixture
def harness(tmp_path: Path) -> RobotHarness:
    """A robot in mode barrier that is asked to drive straight on."""
    path = tmp_path / "careful.yaml"
    path.write_text(BARRIER)
    harness = RobotHarness(str(path), patterns=PATTERNS)
    harness.advance(0.5)
    return harness


def summary(
    harness: RobotHarness, bearing_deg: float, distance: float, *, recovery: bool = False
) -> DecisionSummary:
    """The reported decision with an obstacle 20 degrees wide in the way."""

    def scans(seq: int, now: float) -> Scan:
        scan = empty_scan(harness.platform, seq, now)
        off = np.abs(
            np.remainder(scan.bearings - math.radians(bearing_deg) + np.pi, 2 * np.pi) - np.pi
        )
        return replace(scan, ranges=np.where(off < 0.17, distance, np.inf))

    harness.scans = scans
    harness.ask("run", pattern="forward", params={"recovery": recovery})
    harness.advance(0.25)
    return harness.status.decision


def test_status_reports_the_tightest_constraint_first(harness: RobotHarness) -> None:
    shown = summary(harness, -20.0, 0.45)
    assert (shown.mode, shown.is_active) == ("barrier", True)
    assert 1 <= len(shown.rows) <= MAX_ROWS
    tightest = shown.rows[0]
    assert tightest.cap == min(row.cap for row in shown.rows)
    assert math.radians(-40.0) < tightest.bearing < math.radians(-5.0)
    assert tightest.gap == pytest.approx(shown.min_gap, abs=0.05)
    assert shown.scan_age is not None


def test_status_reports_no_constraint_that_does_not_bind(harness: RobotHarness) -> None:
    shown = summary(harness, 180.0, 2.0)
    assert (shown.is_active, shown.rows, shown.is_recovering) == (False, (), False)


def test_status_reports_the_lateral_speed() -> None:
    requested, safe = Twist(0.0, 0.0, 0.25), Twist(0.0, 0.0, 0.125)
    decision = Decision("barrier", requested, safe, None, True, (), None, None, 1)
    shown = make_summary(decision, DutyCycle())
    assert (shown.requested_lateral, shown.safe_lateral) == (0.25, 0.125)


def test_status_reports_recovery(harness: RobotHarness) -> None:
    blocked = summary(harness, 0.0, 0.3)
    assert harness.status.reason is Reason.PROTECTION
    assert (blocked.is_recovering, blocked.rows[0].cap) == (False, 0.0)
    assert (blocked.requested_linear, blocked.requested_angular) == (0.2, 0.0)
    commanded = harness.twist
    assert (blocked.safe_linear, blocked.safe_angular) == (commanded.linear, commanded.angular)
    assert summary(harness, 0.0, 0.3, recovery=True).is_recovering
    harness.ask("param", params={"recovery": False})
    harness.advance(0.2)
    assert not harness.status.decision.is_recovering


@pytest.mark.parametrize(
    ("bearing", "named"),
    [(0.5, "avoiding tb3-04"), (-0.5, "avoiding an object at 29 deg")],
    ids=["there", "not"],
)
def test_what_is_avoided_has_the_name_of_the_neighbor_there(bearing: float, named: str) -> None:
    sensors = Sensors(load_platform("burger"))
    others = (Neighbor("tb3-03", 0.0), Neighbor("tb3-04", 0.0, 0.8, bearing))
    sensors.on_neighbors(others, 1.0)
    decision = Decision("barrier", Twist(0.2), Twist(0.1), None, True, (), None, None, 1)
    assert avoided_text(decision, sensors, 1.0) == ""
    decision = structs.replace(decision, avoided=Avoided(0.5, 0.9))
    assert avoided_text(decision, sensors, 1.0) == named
    decision = structs.replace(decision, avoided=Avoided(0.5, 0.9, WayState.WAIT))
    text = avoided_text(decision, sensors, 1.0)
    assert text == "gives way at an opening, 0.9 m"


def test_status_reports_finite_readings(harness: RobotHarness) -> None:
    readings = {"battery": 0.71, "yaw": -1.5, "odd": math.nan}
    harness.robot.step(ReadingsInput(readings), harness.now)
    assert harness.status.readings == {"battery": 0.71, "yaw": -1.5}
    assert harness.status.stale_readings == ("odd",)
    assert decode(encode(harness.status)).readings == harness.status.readings


def test_readings_are_stale_while_the_base_is_lost(harness: RobotHarness) -> None:
    harness.robot.step(ReadingsInput({"light": 0.5}), harness.now)
    harness.robot.step(DriverInput(False, "lost"), harness.now)
    assert harness.robot.readings == {}
    assert harness.status.stale_readings == ("light",)
    harness.robot.step(DriverInput(True, "back"), harness.now)
    harness.robot.step(ReadingsInput({"light": 0.6}), harness.now)
    assert harness.status.readings == {"light": 0.6}
    assert not harness.status.stale_readings


def test_an_obstacle_that_odometry_has_put_far_away_leaves_a_status_that_peers_can_read(
    harness: RobotHarness,
) -> None:
    shown = summary(harness, 0.0, 0.3)
    rows = (LimitingObstacle(0.0, 2e6, 0.1), *shown.rows)
    harness.robot.decision = structs.replace(harness.robot.decision, rows=rows)
    assert decode(encode(harness.status)).decision.rows == shown.rows[: MAX_ROWS - 1]
