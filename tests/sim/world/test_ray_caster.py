"""The compiled sensors give the bits of the interpreted file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.kernels import load_kernel
from swarmd.core.values import Array, Platform, Sweep
from swarmd.settings.platforms import load_platform, platform_names
from swarmd.sim.world import ray_caster
from swarmd.sim.world.arena import Arena, parse_arena
from swarmd.sim.world.lidar import RangeSensors, Visibility, sweep_order
from swarmd.sim.world.noise import NoisyLidar
from swarmd.sim.world.realism import IDEAL, REALISTIC, LidarNoise
from tests.support.examples import examples

if load_kernel("swarmd.sim.world.ray_caster") is ray_caster:
    pytest.skip("the kernels are not compiled", allow_module_level=True)

ARENAS = tuple(
    parse_arena(text)
    for text in (
        "4x4",
        "30x2",
        "7x6,box:1:1:0.5:0.3:30,box:-2:-1:0.2:1.5:-75,pole:-2:2:0.1,pole:2:-2:0.3,pole:0:0:0.02",
        "6x6,segment:-1:-2:1.5:-1.2,box/a:1:1:0.5:0.3:30:0.3,box/b:0:0:0.3:0.3:0:1",
    )
)
NOISES = (IDEAL.lidar, REALISTIC.lidar, LidarNoise(dropout=0.5), LidarNoise(near_sd=0.1))
PLATFORMS = tuple(load_platform(name) for name in platform_names())
TRIANGLE = replace(
    load_platform("burger"),
    name="triangle",
    footprint=np.array([[-0.2, 0.0], [0.2, -0.2], [0.2, 0.2]]),
)
FAN = replace(
    load_platform("jackal"),
    name="fan",
    scan=replace(load_platform("jackal").scan, bearings=np.linspace(-2.0, 2.0, 97)),
)


def sensors(
    platforms: Sequence[Platform], arena: Arena, visibility: Visibility, *, is_compiled: bool
) -> RangeSensors:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SWARMD_COMPILED", str(int(is_compiled)))
        return RangeSensors(platforms, arena, visibility)


def errors(noise: LidarNoise, platforms: Sequence[Platform], *, is_compiled: bool) -> NoisyLidar:
    ids = [f"r{row}" for row in range(len(platforms))]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SWARMD_COMPILED", str(int(is_compiled)))
        return NoisyLidar(noise, platforms, ids, 3)


def same_bits(a: Sequence[Array], b: Sequence[Array]) -> None:
    assert [row.tobytes() for row in a] == [row.tobytes() for row in b]


@st.composite
def poses(draw: st.DrawFn, arena: Arena, n: int) -> Array:
    """(n, 3): anywhere around the arena, often at round numbers; some rows are absent."""
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    half = np.array([0.6 * arena.length, 0.6 * arena.width, 4.0 * math.pi])
    drawn = rng.uniform(-half, half, (n, 3))
    digits = draw(st.sampled_from([0, 1, 15]))
    drawn = np.round(drawn, digits)
    drawn[rng.random(n) < draw(st.sampled_from([0.0, 0.3])), :] = np.nan
    return drawn


@settings(deadline=None, max_examples=examples(150))
@given(st.data())
def test_scans_have_the_bits_of_the_interpreted_file(data: st.DataObject) -> None:
    kinds = st.sampled_from((*PLATFORMS, TRIANGLE, FAN))
    platforms = data.draw(st.lists(kinds, min_size=1, max_size=12))
    arena = data.draw(st.sampled_from(ARENAS))
    visibility: Visibility = data.draw(st.sampled_from(("body", "real")))
    at = data.draw(poses(arena, len(platforms) + len(arena.movable_boxes)))
    noise = data.draw(st.sampled_from(NOISES))
    robots = np.arange(len(platforms))
    a, b = (sensors(platforms, arena, visibility, is_compiled=is_one) for is_one in (True, False))
    exact, reference = a.cast(at, robots), b.cast(at, robots)
    same_bits(exact, reference)
    c, d = (errors(noise, platforms, is_compiled=is_one) for is_one in (True, False))
    for _ in range(2):  # the streams of random numbers stay side by side
        same_bits(c.apply(robots, exact), d.apply(robots, reference))


@settings(deadline=None, max_examples=examples(60))
@given(st.data())
def test_sectors_have_the_bits_of_the_interpreted_file(data: st.DataObject) -> None:
    turn = data.draw(st.sampled_from((1.0, -1.0)))
    sweep = Sweep(data.draw(st.sampled_from((0.0, 1.0, math.pi))), turn, 0.2)
    platform = data.draw(st.sampled_from((*PLATFORMS, TRIANGLE, FAN)))
    platform = replace(platform, scan=replace(platform.scan, sweep=sweep))
    arena = data.draw(st.sampled_from(ARENAS))
    visibility: Visibility = data.draw(st.sampled_from(("body", "real")))
    at = data.draw(poses(arena, 5 + len(arena.movable_boxes)))
    rays = len(platform.scan.bearings)
    ends = np.array(sorted(data.draw(st.lists(st.integers(0, rays), min_size=5, max_size=5))))
    found: list[Array] = []
    whole: list[Array] = []
    for is_compiled in (True, False):
        ranges = np.full((5, rays), -7.0)
        (lidar, _), *_ = sensors([platform] * 5, arena, visibility, is_compiled=is_compiled).lidars
        first, counts = lidar.sectors(ends)
        lidar.cast_sectors(ranges, np.arange(5), at, np.arange(5), np.arange(5), first, counts)
        found.append(ranges)
        whole.append(lidar.cast(at, np.arange(5)))
    same_bits(list(found[0]), list(found[1]))
    order, _ = sweep_order(platform.scan.bearings, sweep)
    for row in range(5):
        wanted = np.full(rays, -7.0)
        some = order[ends[row] - counts[row] : ends[row]]
        wanted[some] = whole[0][row, some]
        np.testing.assert_array_equal(found[0][row], wanted)


def test_a_scan_among_a_thousand_has_the_bits_of_the_interpreted_file() -> None:
    rng = np.random.default_rng(5)
    arena, platforms = Arena(32.0, 32.0), [load_platform("waffle_pi")] * 1000
    at = rng.uniform([-16.0, -16.0, -7.0], [16.0, 16.0, 7.0], (1000, 3))
    visibilities: tuple[Visibility, ...] = ("body", "real")
    for visibility in visibilities:
        ranges = [
            sensors(platforms, arena, visibility, is_compiled=is_one).cast(at, np.arange(1000))
            for is_one in (True, False)
        ]
        same_bits(*ranges)
        assert np.isfinite(ranges[0]).mean() > 0.1
