"""The compiled kernel gives what numpy gives, bit for bit where both round alike."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from swarmd.core.kernels import compiled_kernel
from swarmd.core.values import Array, Scan, ScanSpec
from swarmd.sensing import conditioning_numpy, rays_numpy
from swarmd.sensing.rays import RayClusters
from swarmd.settings.platforms import load_platform, platform_names
from tests.support.examples import examples

kernel = compiled_kernel("swarmd.sensing.scan_kernel")
if kernel is None:
    pytest.skip("scan_kernel was not built; `make kernels` builds it", allow_module_level=True)

SPECS = [load_platform(name).scan for name in platform_names()]
SPECS = [spec for spec in SPECS if len(spec.bearings)]
ZEROS = ("no_return", "too_close", "unknown", "lds")
SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module", autouse=True)
def path() -> None:
    """These tests name the path themselves."""


@st.composite
def layouts(draw: st.DrawFn, n: int | None = None) -> Array:
    """Bearings: of a platform, or odd ones."""
    kind = draw(st.sampled_from(("platform", "platform", "uneven", "turned", "clockwise", "twice")))
    rng = np.random.default_rng(draw(SEEDS))
    bearings = draw(st.sampled_from(SPECS)).bearings
    if kind == "uneven":
        bearings = rng.uniform(-7.0, 7.0, draw(st.integers(1, 60)))
    if kind == "turned":
        bearings = np.roll(bearings, draw(st.integers(0, 400))) + draw(st.floats(-4.0, 4.0))
    if kind == "clockwise":
        bearings = -bearings
    if kind == "twice":
        bearings = rng.permutation(np.tile(bearings[:: draw(st.integers(1, 30))], 2))
    return np.ascontiguousarray(bearings)


def ranges_of(n: int, spec: ScanSpec, seed: int, calm: float) -> Array:
    """Raw ranges with surfaces, steps, near returns, lost and odd rays; few for a `calm` near 1."""
    rng = np.random.default_rng(seed)
    ranges = np.full(n, rng.choice((1.0, 2.0, math.inf, 0.9 * spec.range_max)))
    ranges += rng.normal(0.0, 0.01, n)
    least, most = spec.range_min, spec.range_max
    odd = [0.0, math.nan, math.inf, -math.inf, -1.0, 1e9, 0.5, 1.0, 0.5 * least, least, most]
    odd.append(least + 0.05)
    for _ in range(int(rng.integers(0, 8))):
        first, width = int(rng.integers(n)), int(rng.integers(1, max(2, n // 4)))
        value = rng.choice(odd) if rng.random() > 0.4 else rng.uniform(0.0, 1.2 * spec.range_max)
        slope = rng.choice((0.0, 0.01, 0.05))
        rays = np.arange(first, first + width) % n
        ranges[rays] = value + slope * np.arange(width)
    scattered = rng.random(n) > calm
    ranges[scattered] = rng.choice(odd, int(scattered.sum()))
    return ranges


CALM = st.sampled_from((1.0, 1.0, 0.97, 0.7))


def assert_same(one: RayClusters, other: RayClusters) -> None:
    assert one.counts.tolist() == other.counts.tolist()
    assert one.is_free.tolist() == other.is_free.tolist()
    for name in ("ranges", "bearings", "widths", "counts", "is_free"):
        here, there = getattr(one, name), getattr(other, name)
        assert here.dtype == there.dtype
        assert here.flags.writeable == there.flags.writeable
        np.testing.assert_allclose(here, there, rtol=0.0, atol=1e-12)


@given(
    layouts(),
    st.sampled_from(SPECS),
    SEEDS,
    CALM,
    st.sampled_from((0.0, 0.5, 1.0, 3.0, math.inf)),
    st.sampled_from((1, 2, 3, 8, 24, 100)),
    st.floats(-7.0, 7.0),
    st.sampled_from((0.1, 1.0, 3.0, math.pi)),
)
@settings(max_examples=examples(300), deadline=None)
@example(SPECS[0].bearings, SPECS[0], 0, 1.0, math.inf, 24, 0.0, math.pi)
def test_features_are_those_of_numpy(
    bearings: Array,
    spec: ScanSpec,
    seed: int,
    calm: float,
    within: float,
    count: int,
    bearing: float,
    half_width: float,
) -> None:
    ranges = ranges_of(len(bearings), spec, seed, calm)
    scan = Scan(0, 0.0, ranges, bearings, spec.range_min, spec.range_max)
    where = {"bearing": bearing, "half_width": half_width}
    assert kernel.nearest(scan, **where) == rays_numpy.nearest(scan, **where)
    points = kernel.closest_points(scan, within=within, count=count)
    expected = rays_numpy.closest_points(scan, within=within, count=count)
    assert points.shape == expected.shape
    assert points.tolist() == expected.tolist()
    for jump, grazing in ((0.06, math.radians(10.0)), (0.2, 0.3)):
        how = {"within": min(within, 50.0), "jump": jump, "grazing": grazing}
        assert_same(kernel.clusters(scan, **how), rays_numpy.clusters(scan, **how))


@given(
    st.sampled_from(SPECS),
    st.sampled_from(ZEROS),
    st.booleans(),
    st.lists(
        st.tuples(
            SEEDS,
            CALM,
            st.sampled_from((0.05, 0.2, 0.2, 0.7, 3.0)),
            st.sampled_from((0.0, 0.0, 0.004, -0.3, 2.0, math.nan)),
        ),
        min_size=1,
        max_size=12,
    ),
    st.lists(layouts(), max_size=2),
)
@settings(max_examples=examples(200), deadline=None)
def test_conditioning_is_that_of_numpy(
    spec: ScanSpec,
    zero: str,
    guesses_near: bool,
    steps: list[tuple[int, float, float, float]],
    others: list[Array],
) -> None:
    """A sequence of scans of a turning robot; now and then the bearings change."""
    spec = replace(spec, zero=zero)
    pair = [
        module.RayMemory(spec, guesses_near=guesses_near) for module in (conditioning_numpy, kernel)
    ]
    now = yaw = 0.0
    for seed, calm, passed, turned in steps:
        now += passed
        yaw = turned if math.isnan(turned) or math.isnan(yaw) else yaw + turned
        rng = np.random.default_rng(seed)
        bearings = spec.bearings
        if others and rng.random() < 0.3:
            bearings = others[seed % len(others)]
        raw = ranges_of(len(bearings), spec, seed % 5 if rng.random() < 0.5 else seed, calm)
        expected, got = (memory.condition(raw, bearings, yaw, now) for memory in pair)
        assert pair[1].known_at == pair[0].known_at
        assert (got is None) == (expected is None)
        if got is not None:
            assert got.dtype == expected.dtype
            assert got.tolist() == expected.tolist()


def test_two_rays_in_one_direction_keep_a_memory_each() -> None:
    """The bearings come in another array that holds the same."""
    spec = replace(load_platform("burger").scan, zero="no_return")
    bearings = np.tile(spec.bearings, 2)
    pair = [module.RayMemory(spec, guesses_near=False) for module in (conditioning_numpy, kernel)]
    for raw in (np.linspace(1.0, 2.0, 720), np.where(np.arange(720) % 9, 1.5, np.nan)):
        expected, got = (memory.condition(raw, bearings.copy(), 0.0, 1.0) for memory in pair)
        assert got.tolist() == expected.tolist()
