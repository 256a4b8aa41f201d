"""A scan that lacks a sector is as old as what is remembered of that sector."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.core.values import Odometry, Platform, Pose, Scan, Twist
from swarmd.robot.protection.decision import Decision, DecisionContext
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import empty_scan
from tests.support.platforms import with_mode
from tests.support.protection import Protection

SPEED = 0.2
AHEAD = Twist(SPEED)


@pytest.fixture
def platform() -> Platform:
    return with_mode(load_platform("burger"), "barrier")


def wall(platform: Platform, seq: int, x: float) -> Scan:
    """A wall across the way, x m ahead of the lidar."""
    scan = empty_scan(platform, seq, 0.2 * seq)
    ahead = np.cos(scan.bearings) > 0.5
    scan.ranges[ahead] = x / np.cos(scan.bearings[ahead])
    return scan


def drive(platform: Platform, ages: list[float | None], *, distance: float = 0.5) -> list[Decision]:
    """The decisions on the way to a wall; `ages` of each scan in s, None: no scan."""
    protection, decisions = Protection(platform), []
    known = 0.0
    for tick in range(4 * len(ages)):
        now = 10.0 + 0.05 * tick
        odometry = Odometry(now, Pose(SPEED * 0.05 * tick), AHEAD)
        seq, rest = divmod(tick, 4)
        age = ages[seq] if rest == 0 else None
        if age is not None:
            known = now - age
        context = DecisionContext(now, now - known, odometry, 0.0)
        if age is not None:
            x = distance - SPEED * (known - 10.0 - platform.scan.latency)
            protection.observe(wall(platform, seq, x), context)
        decisions.append(protection.decide(AHEAD, context, is_running=True, hold=None))
    return decisions


def test_lost_sector_equals_a_lost_scan(platform: Platform) -> None:
    lost = drive(platform, [0.0, 0.2, 0.4, 0.6])
    none = drive(platform, [0.0, None, None, None])
    assert [one.safe for one in lost] == [one.safe for one in none]
    assert lost[-1].is_active


def test_returned_sector_counts_at_once(platform: Platform) -> None:
    again = drive(platform, [0.0, 0.2, 0.4, 0.0])
    whole = drive(platform, [0.0, None, None, 0.0])
    assert [one.safe for one in again] == [one.safe for one in whole]


def test_newer_partial_scan_counts_with_its_age(platform: Platform) -> None:
    def last(*ages: float | None) -> float:
        return drive(platform, [0.0, *ages], distance=0.52)[-1].safe.linear

    assert 0.0 < last(0.2, 0.2, 0.2) < last(0.0, 0.0, 0.0)
    assert last(0.2, 0.2, 0.2) > last(None, None, None)


def test_remembered_sector_of_a_newer_scan_widens_the_gap(platform: Platform) -> None:
    """The sector is placed at the pose of the scan, although it was seen earlier."""
    whole = drive(platform, [0.0, 0.0, 0.0, 0.0], distance=0.52)[-1]
    lags = drive(platform, [0.0, 0.2, 0.2, 0.2], distance=0.52)[-1]
    aged = drive(platform, [0.0, 0.0, 0.0, None], distance=0.52)[-1]
    assert whole.safe.linear > aged.safe.linear > lags.safe.linear
