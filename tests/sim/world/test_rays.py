"""Which rays lie between two bearings: worked out, searched, and simply counted."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.core.values import Array
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.sim.world.lidar import Rays

EVEN = np.radians(np.arange(360.0))
SHIFTED = np.radians(np.arange(7.0, -353.0, -1.0))
UNEVEN = np.radians([40.0, -40.0, 20.0, 0.0, 170.0, -170.0, 359.0, 180.0])
FAN = np.radians(np.linspace(-120.0, 120.0, 241))


@pytest.mark.parametrize("bearings", [EVEN, SHIFTED, UNEVEN, FAN])
def test_finds_the_rays_between_two_bearings(bearings: Array) -> None:
    rng = np.random.default_rng(3)
    low = rng.uniform(-3.0 * math.pi, 2.0 * math.pi, 400)
    high = low + rng.uniform(0.0, math.pi, 400)
    rays = Rays(bearings)
    places, counts = rays.within(low, high)
    found = np.split(rays.number[places], np.cumsum(counts)[:-1])
    for index, numbers in enumerate(found):
        after = np.mod(bearings - low[index], 2.0 * math.pi)
        inside = np.flatnonzero(after <= high[index] - low[index])
        assert sorted(numbers.tolist()) == inside.tolist()


@pytest.mark.parametrize("bearings", [EVEN, SHIFTED, UNEVEN, FAN])
def test_a_ray_at_the_very_end_of_an_interval_is_in_it_on_both_sides(bearings: Array) -> None:
    rays = Rays(bearings)
    for bearing in bearings.tolist():
        for low, high in ((bearing - 1e-3, bearing), (bearing, bearing + 1e-3)):
            places, counts = rays.within(np.array([low]), np.array([high]))
            assert counts.tolist() == [1]
            np.testing.assert_allclose(rays.cos[places], math.cos(bearing), atol=1e-12)
            np.testing.assert_allclose(rays.sin[places], math.sin(bearing), atol=1e-12)


def test_an_interval_without_rays_takes_no_place() -> None:
    low, high = np.radians([0.2, 3.5, 5.2]), np.radians([0.8, 5.5, 5.8])
    places, counts = Rays(EVEN).within(low, high)
    assert counts.tolist() == [0, 2, 0]
    assert (places % 360).tolist() == [(180 + 4) % 360, (180 + 5) % 360]


@pytest.mark.parametrize("name", platform_names())
def test_the_lidars_of_our_platforms_need_no_search(name: str) -> None:
    bearings = load_platform(name).scan.bearings
    assert Rays(bearings)._is_even == (len(bearings) > 7)  # of few rays a search is as fast
