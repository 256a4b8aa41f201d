"""Errors of range sensors against their stated sizes.

Tolerances are 5 standard errors of the sample at hand; seeds are fixed.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.values import Array, Platform
from swarmd.settings.platforms import load_platform
from swarmd.sim.world.noise import NoisyLidar
from swarmd.sim.world.ray_caster import BLOCK
from swarmd.sim.world.realism import IDEAL, REALISTIC, LidarNoise
from tests.support.platforms import with_plain_scan

BURGER = load_platform("burger")
JACKAL = load_platform("jackal")
PLAIN = with_plain_scan(BURGER)
RAYS = 360


def names(n: int) -> list[str]:
    return [f"r-{row}" for row in range(n)]


def sensors(
    noise: LidarNoise, n: int = 1, platform: Platform = BURGER, seed: int = 3
) -> NoisyLidar:
    return NoisyLidar(noise, [platform] * n, names(n), seed)


def measured(noisy: NoisyLidar, distance: float, scans: int, n: int = 1) -> Array:
    """(scans, n, rays) of robots in the middle of a ring."""
    rows, ring = np.arange(n), [np.full(RAYS, distance)] * n
    return np.array([noisy.apply(rows, ring) for _ in range(scans)])


def test_an_ideal_sensor_gives_the_same_ranges() -> None:
    noisy = sensors(IDEAL.lidar, 2, PLAIN)
    exact = [np.array([1.0, np.inf, -np.inf, 0.123456789]), np.full(RAYS, 0.1)]
    given = noisy.apply(np.arange(2), exact)
    for one, other in zip(given, exact, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(("distance", "sd"), [(0.3, 0.010), (1.0, 0.012), (2.5, 0.030)])
def test_noise_has_the_stated_standard_deviation(distance: float, sd: float) -> None:
    noise = LidarNoise(near_sd=0.010, near=0.5, far_sd=0.012)
    off = measured(sensors(noise), distance, 100) - distance
    assert abs(off.mean()) < 5.0 * sd / math.sqrt(off.size)
    assert off.std() == pytest.approx(sd, rel=5.0 / math.sqrt(2.0 * off.size))


def test_bias_is_a_robots_own_and_stays() -> None:
    n = 400
    noisy = sensors(LidarNoise(bias=0.017), n)
    factors = measured(noisy, 2.0, 2, n) / 2.0
    assert np.ptp(factors, axis=(0, 2)).max() < 1e-12
    bias = factors[0, :, 0] - 1.0
    assert abs(bias.mean()) < 5.0 * 0.017 / math.sqrt(n)
    assert bias.std() == pytest.approx(0.017, rel=5.0 / math.sqrt(2.0 * n))
    assert noisy.apply(np.array([4]), [np.full(RAYS, 1.0)])[0][0] == pytest.approx(1.0 + bias[4])


def test_ranges_are_whole_millimetres() -> None:
    steps = measured(sensors(REALISTIC.lidar), 1.23456, 5) * 1000.0
    assert np.abs(steps - np.rint(steps)).max() < 1e-9
    assert len(np.unique(steps)) > 20


def test_rays_are_lost_one_by_one_as_often_as_stated() -> None:
    lost = measured(sensors(LidarNoise(dropout=0.01)), 1.0, 300) == 0.0
    assert lost.mean() == pytest.approx(0.01, abs=5.0 * math.sqrt(0.01 / lost.size))


def test_an_lds_loses_whole_blocks_of_six() -> None:
    lost = measured(sensors(LidarNoise(block_dropout=0.05)), 1.0, 300) == 0.0
    blocks = lost.reshape(-1, RAYS // BLOCK, BLOCK)
    assert np.array_equal(blocks.any(axis=-1), blocks.all(axis=-1))
    share = blocks.all(axis=-1)
    assert share.mean() == pytest.approx(0.05, abs=5.0 * math.sqrt(0.05 / share.size))


def test_only_an_lds_loses_blocks() -> None:
    ouster = sensors(LidarNoise(block_dropout=1.0), platform=JACKAL)
    assert np.array_equal(measured(ouster, 2.0, 3), np.full((3, 1, RAYS), 2.0))


@pytest.mark.parametrize(
    ("zero", "lost"),
    [("lds", 0.0), ("no_return", 0.0), ("unknown", 0.0), ("too_close", math.nan)],
)
def test_a_lost_ray_never_looks_like_a_near_return(zero: str, lost: float) -> None:
    platform = replace(BURGER, scan=replace(BURGER.scan, zero=zero))
    noisy = sensors(LidarNoise(dropout=1.0), platform=platform)
    assert np.array_equal(measured(noisy, 1.0, 1), np.full((1, 1, RAYS), lost), equal_nan=True)


def test_rays_without_return_are_unchanged() -> None:
    exact = np.tile([np.inf, -np.inf, np.nan], RAYS // 3)
    noise = LidarNoise(bias=0.2, near_sd=1.0, far_sd=0.2, resolution=0.1, dropout=1.0)
    given = sensors(noise, platform=PLAIN).apply(np.arange(1), [exact.copy()])[0]
    assert np.array_equal(given, exact, equal_nan=True)


def test_ranges_outside_the_limits_are_infinite() -> None:
    noise = LidarNoise(near_sd=0.05, near=100.0)
    far = measured(sensors(noise, platform=PLAIN), BURGER.scan.range_max, 5)
    near = measured(sensors(noise, platform=PLAIN), BURGER.scan.range_min, 5)
    assert np.isposinf(far).mean() == pytest.approx(0.5, abs=0.06)
    assert np.isneginf(near).mean() == pytest.approx(0.5, abs=0.06)
    assert far[np.isfinite(far)].max() <= BURGER.scan.range_max
    assert near[np.isfinite(near)].min() >= BURGER.scan.range_min


@pytest.mark.parametrize("noise", [IDEAL.lidar, LidarNoise(near_sd=1e-9, far_sd=1e-9)])
@pytest.mark.parametrize(("platform", "nothing"), [(BURGER, 0.0), (JACKAL, np.inf)])
def test_a_too_near_return_is_no_return_where_the_sensor_loses_it(
    noise: LidarNoise, platform: Platform, nothing: float
) -> None:
    within = platform.scan.range_min + 0.1
    exact = np.array([np.inf, -np.inf, within, np.nan])
    given = sensors(noise, platform=platform).apply(np.arange(1), [exact])[0]
    assert given == pytest.approx([nothing, nothing, within, np.nan], abs=1e-6, nan_ok=True)


def test_exact_ranges_are_left_alone() -> None:
    exact = np.linspace(0.2, 3.4, RAYS)
    before = exact.copy()
    sensors(REALISTIC.lidar).apply(np.arange(1), [exact])
    assert np.array_equal(exact, before)


def test_noise_does_not_depend_on_other_observers() -> None:
    n = 70
    exact = list(np.random.default_rng(0).uniform(0.0, 4.0, (n, RAYS)))
    together = sensors(REALISTIC.lidar, n)
    alone = sensors(REALISTIC.lidar, n)
    for _ in range(3):
        given = together.apply(np.arange(n), exact)
        for row in reversed(range(n)):
            lone = alone.apply(np.array([row]), [exact[row]])[0]
            assert np.array_equal(lone.view(np.int64), given[row].view(np.int64))


def test_noise_does_not_depend_on_other_robots() -> None:
    ring = [np.full(RAYS, 1.0)]
    many = NoisyLidar(REALISTIC.lidar, [JACKAL, BURGER, BURGER], ["z", "r-0", "b"], 3)
    assert np.array_equal(
        many.apply(np.array([1]), ring)[0], sensors(REALISTIC.lidar).apply(np.arange(1), ring)[0]
    )


def test_sensors_of_different_ray_counts_scan_together() -> None:
    wide = replace(BURGER, scan=replace(BURGER.scan, bearings=np.linspace(0.0, 6.0, 100)))
    platforms, ids = [BURGER, wide, BURGER], names(3)
    exact = [np.full(len(p.scan.bearings), 1.0 + i) for i, p in enumerate(platforms)]
    mixed = NoisyLidar(REALISTIC.lidar, platforms, ids, 3).apply(np.arange(3), exact)
    assert [len(row) for row in mixed] == [360, 100, 360]
    alone = NoisyLidar(REALISTIC.lidar, platforms, ids, 3)
    for row in range(3):
        lone = alone.apply(np.array([row]), [exact[row]])[0]
        assert np.array_equal(lone, mixed[row])
