"""Recorded scans, odd ones, and what a test compares of them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from swarmd.core.kernels import HELPERS, UNITS
from swarmd.core.values import Array, ScanSpec
from swarmd.settings.platforms import load_platform, platform_names
from tests.support.kernel_forms import both_forms

FORMS = both_forms(*(name for name in UNITS["swarmd.robot.sensing._scans"] if name not in HELPERS))
KERNEL = FORMS[1]
# What an implementation with numpy gave, which does not exist any more.
RECORDED = dict(np.load(Path(__file__).parents[1] / "robot/sensing/recorded_scans.npz"))

SPECS = [load_platform(name).scan for name in platform_names()]
SPECS = [spec for spec in SPECS if len(spec.bearings)]
SEEDS = st.integers(0, 2**32 - 1)

Rays = tuple[Array, Array, Array]


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


def assert_same(ours: Iterable[Array] | None, theirs: Iterable[Array] | None) -> None:
    assert (ours is None) == (theirs is None)
    for one, other in zip(
        () if ours is None else ours, () if theirs is None else theirs, strict=True
    ):
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12)


def recorded(kind: str) -> list[dict[str, Array]]:
    """The recorded cases of a kind, each with its arrays by name."""
    cases: dict[str, dict[str, Array]] = {}
    for key, values in RECORDED.items():
        case, _, name = key.rpartition("_")
        if case.startswith(kind):
            cases.setdefault(case, {})[name] = values
    return list(cases.values())


def moved(module: Any, rays: Rays, path: Array, limits: Array) -> Array:
    """Ranges and bearings (2, n) at the end of a path."""
    ranges, bearings, ages = rays
    found = np.empty((2, len(ranges)))
    directions = np.cos(bearings), np.sin(bearings)
    module.move_rays(ranges, bearings, *directions, ages, path, len(path), limits, *found)
    return found


def in_sector(
    module: Any, rays: Rays, first: int, way: Array, sector: Array, limits: Array
) -> Array:
    """Ranges, bearings and ages (3, k) of the rays in a sector."""
    found = np.empty((3, len(rays[0])))
    return found[:, : module.rays_in_sector(*rays, first, way, sector, limits, *found)]
