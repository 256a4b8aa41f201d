"""Returns beyond the binding range never change a decision."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.clock import TICK
from swarmd.core.values import Odometry, Platform, Pose, Twist
from swarmd.protection.barrier import Barrier
from swarmd.protection.constraints import BindingRange
from swarmd.protection.decision import DecisionContext
from swarmd.protection.footprint import ScanGeometry
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import scan_from
from tests.support.filter_sim import under_barrier

KINDS = [under_barrier(load_platform(name)) for name in ("burger", "waffle_pi", "jackal")]
KINDS += [under_barrier(KINDS[0], unseen_extent=0.0), under_barrier(KINDS[2], others_speed=0.4)]
ALONE = {"others_speed": 0.001, "surface_speed": 0.25, "unseen_extent": 0.0}
KINDS += [under_barrier(KINDS[0], **ALONE), under_barrier(KINDS[1], **ALONE)]
KINDS += [under_barrier(KINDS[2], surface_speed=0.3, envelope_within=0.2)]  # slower near others
SHARE = st.sampled_from([-1.0, -0.5, 0.0, 0.3, 1.0])
RETURNS = st.lists(st.tuples(st.integers(0, 359), st.integers(1, 30), st.floats(0, 2)), max_size=3)
BEGIN = 10.0


FAR = 100.0


class Everywhere(BindingRange):
    """A binding range without limit."""

    def for_scan_age(self, age: float) -> float:
        return FAR


class SeesAll(Barrier):
    """A barrier that considers every return."""

    def __init__(self, platform: Platform) -> None:
        super().__init__(platform)
        assert self._furthest < FAR
        self._binding_range = Everywhere(platform, self._settings, TICK)
        self._furthest = FAR


def driving(twist: Twist, seconds: float) -> Odometry:
    """Odometry after `seconds` at a constant twist from the origin."""
    v, turn = twist.linear, twist.angular * seconds
    radius = v / twist.angular if twist.angular else 0.0
    there = Pose(radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn)
    return Odometry(BEGIN + seconds, there if turn else Pose(v * seconds), twist)


def decided(
    barrier: Barrier, platform: Platform, returns: Sequence[tuple[int, int, float]], twist: Twist,
    age: float,
) -> Twist:  # fmt: skip
    """The decision on a request to go on at the same twist, `age` s after a scan."""
    ranges = np.full(360, math.inf)
    for first, count, beyond in returns:
        ranges[np.arange(first, first + count) % 360] = platform.scan.range_min + beyond
    scan = scan_from(platform, ranges, platform.scan.bearings)
    before = DecisionContext(BEGIN - 0.1, None, driving(twist, -0.1), 0.0)
    barrier.decide(twist, before, command=twist, touch=None)
    now = DecisionContext(BEGIN, 0.0, driving(twist, 0.0), 0.0)
    barrier.observe(scan, ScanGeometry(platform.scan), now)
    later = now if age == 0.0 else DecisionContext(BEGIN + age, age, driving(twist, age), 0.0)
    return barrier.decide(twist, later, command=twist, touch=None).twist


@given(st.sampled_from(KINDS), RETURNS, SHARE, SHARE, st.sampled_from([0.0, 0.1, 0.4, 1.0]))
def test_returns_beyond_the_binding_range_change_nothing(
    platform: Platform, returns: list[tuple[int, int, float]], v: float, w: float, share: float
) -> None:
    age = share * platform.scan.stale_after
    twist = Twist(v * platform.limits.linear, w * platform.limits.angular)
    some = decided(Barrier(platform), platform, returns, twist, age)
    every = decided(SeesAll(platform), platform, returns, twist, age)
    assert (some.linear, some.angular) == pytest.approx((every.linear, every.angular), abs=1e-9)
