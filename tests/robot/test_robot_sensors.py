"""What one robot senses, and when it must not move on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swarmd.api import Scan, Twist
from swarmd.core.messages import Reason, State
from swarmd.testing.scans import empty_scan
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, standing_state, started


def test_missing_scan_holds_and_then_stops() -> None:
    harness = RobotHarness(patterns=PATTERNS)
    harness.scans = lambda seq, now: None
    harness.advance(1.0)
    harness.ask("run", pattern="forward")
    harness.advance(1.0)
    assert standing_state(harness) == (State.RUNNING, Reason.NO_SCAN)
    harness.advance(1.2)
    assert standing_state(harness) == (State.STOPPED, Reason.NO_SCAN)
    assert all(twist.is_zero for _, twist in harness.commands)


def test_stale_scan_zeroes_at_its_deadline() -> None:
    harness = started()
    scan_at = harness.now  # advance(0.5) ends between two sweeps; find the last one
    age = harness.status.decision.scan_age
    assert age is not None
    scan_at -= age
    harness.scans = lambda seq, now: None
    harness.commands.clear()
    harness.advance(1.5)
    limit = scan_at + harness.platform.scan.stale_after
    moving = [at for at, twist in harness.commands if not twist.is_zero]
    stood = [at for at, twist in harness.commands if twist.is_zero]
    assert max(moving) <= limit
    assert min(stood) <= limit + 0.001
    assert harness.status.reason is Reason.STALE_SCAN
    harness.advance(1.6)
    assert standing_state(harness) == (State.STOPPED, Reason.STALE_SCAN)


def test_occasional_lost_scan_does_not_stop() -> None:
    harness = started()
    harness.scans = lambda seq, now: (
        None if seq % 3 == 0 else empty_scan(harness.platform, seq, now)
    )
    harness.commands.clear()
    harness.advance(10.0)
    assert all(twist == Twist(0.2) for _, twist in harness.commands)


def test_frozen_scans_stop_the_robot() -> None:
    harness = started()
    frozen = empty_scan(harness.platform, 10_000, 5.0)
    harness.scans = lambda seq, now: frozen
    harness.advance(1.5)
    assert harness.status.reason is Reason.FROZEN_SCAN


@pytest.mark.parametrize("what", ["all_nan", "sector", "lengths", "empty"])
def test_invalid_scans_stop_the_robot(what: str) -> None:
    harness = started()

    def bad(seq: int, now: float) -> Scan:
        scan = empty_scan(harness.platform, seq, now, 2.0)
        if what == "all_nan":
            return replace(scan, ranges=np.full(360, np.nan))
        if what == "sector":
            return replace(scan, ranges=np.where(np.arange(360) < 30, np.nan, scan.ranges))
        if what == "lengths":
            return replace(scan, ranges=scan.ranges[:-7])
        return replace(scan, ranges=np.empty(0), bearings=np.empty(0))

    harness.scans = bad
    harness.advance(2.0)
    assert harness.status.reason is Reason.INVALID_SCAN
    assert harness.twist.is_zero
    harness.advance(1.6)
    assert standing_state(harness) == (State.STOPPED, Reason.INVALID_SCAN)


def test_lost_sector_zeroes_at_its_deadline() -> None:
    harness = started()
    age = harness.status.decision.scan_age
    assert age is not None
    limit = harness.now - age + harness.platform.scan.stale_after
    harness.scans = harness.nan_scan(0.0, sector=(0.0, 0.5))
    harness.commands.clear()
    harness.advance(1.5)
    moving = [at for at, twist in harness.commands if not twist.is_zero]
    stood = [at for at, twist in harness.commands if twist.is_zero]
    assert limit - 0.05 < max(moving) <= limit
    assert limit < min(stood) <= limit + 0.001
    assert harness.status.reason is Reason.INVALID_SCAN


def test_single_unknown_rays_do_not_stop() -> None:
    harness = started()
    harness.scans = harness.nan_scan(0.1)
    harness.commands.clear()
    harness.advance(10.0)
    assert all(twist == Twist(0.2) for _, twist in harness.commands)


def test_changing_number_of_rays_does_not_stop() -> None:
    harness = started()

    def changing(seq: int, now: float) -> Scan:
        n = 350 + 5 * (seq % 4)
        bearings = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
        scan = empty_scan(harness.platform, seq, now)
        return replace(scan, ranges=np.full(n, 2.0 + 1e-6 * seq), bearings=bearings)

    harness.scans = changing
    harness.commands.clear()
    harness.advance(10.0)
    assert all(twist == Twist(0.2) for _, twist in harness.commands)


def test_stale_odometry_holds() -> None:
    harness = started()
    harness.odometry = None
    harness.advance(0.6)
    assert harness.twist.is_zero
    assert harness.status.reason is Reason.STALE_ODOMETRY


def test_returned_driver_does_not_start_a_stopped_robot() -> None:
    harness = started()
    harness.carry_out(harness.robot.on_driver(False, "cable", harness.now))
    assert harness.twist.is_zero
    assert harness.status.reason is Reason.DRIVER_LOST
    harness.advance(2.2)
    assert standing_state(harness) == (State.STOPPED, Reason.DRIVER_LOST)
    harness.carry_out(harness.robot.on_driver(True, "there", harness.now))
    harness.advance(2.0)
    assert harness.twist.is_zero


def test_protection_acts_only_while_running() -> None:
    harness = started()
    harness.scans = lambda seq, now: replace(
        empty_scan(harness.platform, seq, now),
        ranges=np.where(np.abs(np.arange(360) - 180) > 150, 0.3, np.inf),
    )
    harness.advance(0.5)
    assert harness.twist.linear < 0.0
    assert harness.status.decision.is_active
    harness.ask("stop")
    harness.advance(1.0)
    assert harness.twist.is_zero
