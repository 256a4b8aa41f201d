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


def test_no_scan_yet_holds_and_then_stops() -> None:
    story = RobotHarness(patterns=PATTERNS)
    story.scans = lambda seq, now: None
    story.advance(1.0)
    story.ask("run", pattern="forward")
    story.advance(1.0)
    assert standing_state(story) == (State.RUNNING, Reason.NO_SCAN)
    story.advance(1.2)
    assert standing_state(story) == (State.STOPPED, Reason.NO_SCAN)
    assert all(twist.is_zero for _, twist in story.commands)


def test_a_stale_scan_zeroes_exactly_when_it_is_too_old() -> None:
    story = started()
    scan_at = story.now  # advance(0.5) ends between two sweeps; find the last one
    age = story.status.decision.scan_age
    assert age is not None
    scan_at -= age
    story.scans = lambda seq, now: None
    story.commands.clear()
    story.advance(1.5)
    limit = scan_at + story.platform.scan.stale_after
    moving = [at for at, twist in story.commands if not twist.is_zero]
    stood = [at for at, twist in story.commands if twist.is_zero]
    assert max(moving) <= limit
    assert min(stood) <= limit + 0.001
    assert story.status.reason is Reason.STALE_SCAN
    story.advance(1.6)
    assert standing_state(story) == (State.STOPPED, Reason.STALE_SCAN)


def test_a_lost_scan_now_and_then_does_not_stop_it() -> None:
    story = started()
    story.scans = lambda seq, now: None if seq % 3 == 0 else empty_scan(story.platform, seq, now)
    story.commands.clear()
    story.advance(10.0)
    assert all(twist == Twist(0.2) for _, twist in story.commands)


def test_frozen_scans_stop_it_with_their_own_reason() -> None:
    story = started()
    frozen = empty_scan(story.platform, 10_000, 5.0)
    story.scans = lambda seq, now: frozen
    story.advance(1.5)
    assert story.status.reason is Reason.FROZEN_SCAN


@pytest.mark.parametrize("what", ["all_nan", "sector", "lengths", "empty"])
def test_invalid_scans_stop_it_with_their_own_reason(what: str) -> None:
    story = started()

    def bad(seq: int, now: float) -> Scan:
        scan = empty_scan(story.platform, seq, now, 2.0)
        if what == "all_nan":
            return replace(scan, ranges=np.full(360, np.nan))
        if what == "sector":
            return replace(scan, ranges=np.where(np.arange(360) < 30, np.nan, scan.ranges))
        if what == "lengths":
            return replace(scan, ranges=scan.ranges[:-7])
        return replace(scan, ranges=np.empty(0), bearings=np.empty(0))

    story.scans = bad
    story.advance(2.0)
    assert story.status.reason is Reason.INVALID_SCAN
    assert story.twist.is_zero
    story.advance(1.6)
    assert standing_state(story) == (State.STOPPED, Reason.INVALID_SCAN)


def test_a_lost_sector_zeroes_exactly_stale_after_it_was_last_seen() -> None:
    story = started()
    age = story.status.decision.scan_age
    assert age is not None
    limit = story.now - age + story.platform.scan.stale_after
    story.scans = story.nan_scan(0.0, sector=(0.0, 0.5))
    story.commands.clear()
    story.advance(1.5)
    moving = [at for at, twist in story.commands if not twist.is_zero]
    stood = [at for at, twist in story.commands if twist.is_zero]
    assert limit - 0.05 < max(moving) <= limit
    assert limit < min(stood) <= limit + 0.001
    assert story.status.reason is Reason.INVALID_SCAN


def test_single_unknown_rays_do_not_stop_it() -> None:
    story = started()
    story.scans = story.nan_scan(0.1)
    story.commands.clear()
    story.advance(10.0)
    assert all(twist == Twist(0.2) for _, twist in story.commands)


def test_a_changing_number_of_rays_does_not_stop_it() -> None:
    story = started()

    def changing(seq: int, now: float) -> Scan:
        n = 350 + 5 * (seq % 4)
        bearings = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
        scan = empty_scan(story.platform, seq, now)
        return replace(scan, ranges=np.full(n, 2.0 + 1e-6 * seq), bearings=bearings)

    story.scans = changing
    story.commands.clear()
    story.advance(10.0)
    assert all(twist == Twist(0.2) for _, twist in story.commands)


def test_stale_odometry_holds_a_robot_that_has_odometry() -> None:
    story = started()
    story.odometry = None
    story.advance(0.6)
    assert story.twist.is_zero
    assert story.status.reason is Reason.STALE_ODOMETRY


def test_a_lost_driver_holds_and_its_return_does_not_start_a_stopped_robot() -> None:
    story = started()
    story.carry_out(story.robot.on_driver(False, "cable", story.now))
    assert story.twist.is_zero
    assert story.status.reason is Reason.DRIVER_LOST
    story.advance(2.2)
    assert standing_state(story) == (State.STOPPED, Reason.DRIVER_LOST)
    story.carry_out(story.robot.on_driver(True, "there", story.now))
    story.advance(2.0)
    assert story.twist.is_zero


def test_protection_overrules_the_wish_while_running_and_only_then() -> None:
    story = started()
    story.scans = lambda seq, now: replace(
        empty_scan(story.platform, seq, now),
        ranges=np.where(np.abs(np.arange(360) - 180) > 150, 0.3, np.inf),
    )
    story.advance(0.5)
    assert story.twist.linear < 0.0
    assert story.status.decision.is_active
    story.ask("stop")
    story.advance(1.0)
    assert story.twist.is_zero
