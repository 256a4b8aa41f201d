"""In closed loop: a lidar that repeats itself, or sends but some of its rays."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.values import Array, Platform, Pose, Scan, Twist
from swarmd.settings.settings import load_platform
from tests.support.filter_sim import FilterSim, box, under_barrier

PLATFORMS = [under_barrier(load_platform(name)) for name in ("burger", "waffle_pi", "jackal")]


class StuckYard(FilterSim):
    """From `stuck` s on the lidar gives the last ranges again and again, with new stamps."""

    stuck = math.inf
    last: Array | None = None

    def sweep(self) -> Scan:
        scan = super().sweep()
        if self.time < self.stuck or self.last is None:
            self.last = scan.ranges
        return replace(scan, ranges=self.last)


@pytest.mark.parametrize("platform", PLATFORMS, ids=lambda platform: platform.name)
@pytest.mark.parametrize("distance", [0.6, 0.9, 1.3, 1.8])
def test_a_lidar_that_repeats_itself_does_not_lead_into_a_wall(
    platform: Platform, distance: float
) -> None:
    """Each repeat would put the wall back to where it was once."""
    front = float(platform.footprint[:, 0].max())
    speed = platform.limits.linear
    yard = StuckYard(platform, [box(0.2, 6.0, Pose(front + distance + 0.1))], noise=0.01)
    yard.stuck = max(distance - 0.5, 0.0) / speed
    ride = yard.run(Twist(speed), yard.stuck + 6.0)
    assert ride.touch is None
    assert ride.twists[-1].linear == pytest.approx(0.0, abs=1e-9)


class BlinkeredYard(FilterSim):
    """The lidar sends the rays from `first` to `last` alone."""

    first, last = 0, 360

    def sweep(self) -> Scan:
        scan = super().sweep()
        rays = slice(self.first, self.last)
        return replace(scan, ranges=scan.ranges[rays], bearings=scan.bearings[rays])


@pytest.mark.parametrize("platform", PLATFORMS, ids=lambda platform: platform.name)
@pytest.mark.parametrize(("first", "last"), [(0, 90), (0, 1), (0, 180), (200, 360)])
def test_where_it_does_not_look_it_does_not_drive(
    platform: Platform, first: int, last: int
) -> None:
    back = float(-platform.footprint[:, 0].min())
    yard = BlinkeredYard(platform, [box(0.2, 0.8, Pose(-back - 0.5))])
    yard.first, yard.last = first, last
    ride = yard.run(Twist(-platform.limits.linear), 6.0)
    assert ride.touch is None
    assert not np.array([twist.linear for twist in ride.twists]).any()
