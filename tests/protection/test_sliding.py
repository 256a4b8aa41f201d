"""Who slides along something near goes the slower the nearer it is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.values import Scan, Twist
from swarmd.protection.barrier import CREEP_SPEED, TICK
from swarmd.protection.dead_reckoning import REACTION_TIME
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import scan_from
from tests.support.filter_sim import decided, under_barrier

WAFFLE = under_barrier(load_platform("waffle_pi"), unseen_extent=0.0)
HALF_WIDTH = float(WAFFLE.footprint[:, 1].max())
TOUCH = WAFFLE.protection["barrier"]["margin"]
REAR, FRONT = (
    float(bound) for bound in (WAFFLE.footprint[:, 0].min(), WAFFLE.footprint[:, 0].max())
)
ASIDE = math.radians(60.0)
TOP = WAFFLE.limits.linear


def beside(gap: float, side: float) -> Scan:
    """One return at that gap, straight to the left of the lidar or to the right."""
    ranges = np.full(360, math.inf)
    ray = int(np.abs(WAFFLE.scan.bearings - side * math.pi / 2.0).argmin())
    ranges[ray] = HALF_WIDTH + gap
    return scan_from(WAFFLE, ranges, WAFFLE.scan.bearings)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
@pytest.mark.parametrize("way", [1.0, -1.0], ids=["ahead", "reversing"])
def test_the_nearer_it_is_the_slower_it_is_passed(side: float, way: float) -> None:
    """Half of what is left beyond touch each, until both have looked again; 60 degrees aside."""
    for gap in (0.02, 0.05, 0.07, 0.09):
        seconds = WAFFLE.scan.latency + REACTION_TIME + TICK
        closing = max(0.5 * (gap - TOUCH) / seconds, CREEP_SPEED)
        safe = decided(WAFFLE, beside(gap, side), Twist(way * TOP)).safe
        corner = np.array((FRONT if way > 0.0 else REAR, side * HALF_WIDTH))
        aside = np.array((way * math.sin(ASIDE), side * math.cos(ASIDE)))
        speed = safe.linear - safe.angular * corner[1], safe.angular * corner[0]
        assert 0.0 < aside @ speed <= closing + 1e-9
        if gap > TOUCH:  # else the envelope holds it too
            assert aside @ speed == pytest.approx(min(closing, TOP * math.sin(ASIDE)))


def test_what_leaves_room_is_passed_at_full_speed() -> None:
    for gap in (0.25, 0.4):
        requested = Twist(TOP)
        assert decided(WAFFLE, beside(gap, 1.0), requested).safe == requested


def test_from_what_is_ahead_it_backs_off_as_it_likes() -> None:
    ranges = np.full(360, math.inf)
    ranges[0] = float(WAFFLE.footprint[:, 0].max()) - WAFFLE.scan.offset[0] + TOUCH + 0.01
    scan = scan_from(WAFFLE, ranges, WAFFLE.scan.bearings)
    requested = Twist(-TOP)
    assert decided(WAFFLE, scan, requested).safe == requested
    assert decided(WAFFLE, scan, Twist(TOP)).safe.linear == 0.0
