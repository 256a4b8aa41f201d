"""The arithmetic on scans: as recorded, and compiled as interpreted."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.values import Array, Odometry, Pose, Scan, ScanSpec, Twist
from swarmd.settings.platforms import load_platform, platform_names
from tests.support.examples import examples
from tests.support.kernel_forms import both_forms, compares_forms

FORMS = both_forms("swarmd.sensing.scans")
KERNEL = FORMS[1]
# What an implementation with numpy gave, which does not exist any more.
RECORDED = dict(np.load(Path(__file__).with_name("recorded_scans.npz")))

SPECS = [load_platform(name).scan for name in platform_names()]
SPECS = [spec for spec in SPECS if len(spec.bearings)]
ZEROS = ("no_return", "too_close", "unknown", "lds")
SEEDS = st.integers(0, 2**32 - 1)
LIMITS = np.array((-0.03, 0.01, 0.12, 3.5))


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


def test_features_are_as_recorded() -> None:
    for case in recorded("features"):
        ranges, bearings = case["scan"].astype(np.float64)
        range_min, range_max, within, count = case["how"].tolist()
        scan = Scan(0, 0.0, ranges, bearings, range_min, range_max)
        found = [KERNEL.nearest(scan, 0.0, math.pi), KERNEL.nearest(scan, 0.5, 1.0)]
        assert_same([case["nearest"]], [np.array([one or (math.nan,) * 2 for one in found])])
        assert_same([case["closest"]], [KERNEL.closest_points(scan, within, int(count))])
        objects = KERNEL.clusters(scan, within, 0.06, math.radians(10.0))
        objects = np.empty((5, 0)) if objects is None else objects
        assert_same(case["clusters"], [np.asarray(values, np.float64) for values in objects])


def test_malformed_scan_or_count_is_refused_and_ends_no_process() -> None:
    bearings = SPECS[0].bearings
    n = len(bearings)

    def scan(ranges: Array, bearings: Array) -> Scan:
        return Scan(1, 1.0, ranges, bearings, 0.1, 3.5)

    odd = np.array(bearings)
    odd[n // 2] = math.nan
    malformed = {
        "both \\(n,\\)": [
            scan(np.ones(n), bearings[:0]),
            scan(np.ones(n), bearings[:3]),
            scan(np.ones(n - 1), bearings),
            scan(np.ones((2, n)), np.stack((bearings, bearings))),
        ],
        "a finite angle": [scan(np.ones(n), odd)],
    }
    for text, scans in malformed.items():
        for one in scans:
            with pytest.raises(ValueError, match=text):
                KERNEL.nearest(one, 0.0, math.pi)
            with pytest.raises(ValueError, match=text):
                KERNEL.clusters(one, 2.0, 0.06, 0.2)
            with pytest.raises(ValueError, match=text):
                KERNEL.closest_points(one, 2.0, 24)
    for count in (0, -1):
        with pytest.raises(ValueError, match="at least 1 sector"):
            KERNEL.closest_points(scan(np.ones(n), bearings), 2.0, count)


def test_conditioning_is_as_recorded() -> None:
    for case in recorded("memory"):
        platform, zero, guesses_near = case["spec"].tolist()
        spec = replace(load_platform(platform).scan, zero=zero)
        memory = KERNEL.RayMemory(spec, guesses_near=guesses_near == "True")
        for raw, at, expected in zip(case["raw"], case["at"], case["ranges"], strict=True):
            yaw, now, known_at, is_valid = at.tolist()
            got = memory.condition(raw, spec.bearings, yaw, now)
            assert memory.known_at == known_at
            assert (got is not None) == is_valid
            if got is not None:
                np.testing.assert_array_equal(got.astype(np.float32), expected)


def test_moved_rays_are_as_recorded() -> None:
    for case in recorded("motion"):
        ranges, bearings, ages = case["rays"].astype(np.float64)
        path, limits = case["path"], case["limits"]
        assert_same(case["moved"], moved(KERNEL, (ranges, bearings, ages), path, limits))
        way, sector = case["way"], case["sector"]
        inside = in_sector(KERNEL, (ranges, bearings, ages), 5, way, sector, limits)
        assert_same(case["inside"], inside)


@compares_forms
@given(
    layouts(),
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
        max_size=8,
    ),
)
@settings(max_examples=examples(200), deadline=None)
def test_any_scans_of_a_turning_robot_give_the_same_compiled_and_interpreted(
    odd: Array,
    spec: ScanSpec,
    zero: str,
    guesses_near: bool,
    steps: list[tuple[int, float, float, float]],
) -> None:
    """Now and then the bearings are others."""
    spec, now, yaw = replace(spec, zero=zero), 0.0, 0.0
    pair = [module.RayMemory(spec, guesses_near=guesses_near) for module in FORMS]
    for seed, calm, passed, turned in steps:
        now += passed
        yaw = turned if math.isnan(turned) or math.isnan(yaw) else yaw + turned
        rng = np.random.default_rng(seed)
        bearings = odd if rng.random() < 0.3 else spec.bearings
        raw = ranges_of(len(bearings), spec, seed % 5 if rng.random() < 0.5 else seed, calm)
        expected, got = (memory.condition(raw, bearings, yaw, now) for memory in pair)
        assert pair[1].known_at == pair[0].known_at
        assert_same(*(None if one is None else [one] for one in (expected, got)))
        scan = Scan(0, 0.0, raw, bearings, spec.range_min, spec.range_max)
        bearing, within = float(rng.uniform(-7.0, 7.0)), float(rng.choice((0.0, 0.5, 1.0, 3.0)))
        near = [module.nearest(scan, bearing, 1.0) for module in FORMS]
        assert near[0] == near[1]
        count = int(rng.integers(1, 100))
        assert_same(*([module.closest_points(scan, within, count)] for module in FORMS))
        assert_same(*(module.clusters(scan, within, 0.06, 0.2) for module in FORMS))
        assert_same(*([module.unit_vectors(bearings)] for module in FORMS))
        rays = raw, bearings, rng.uniform(0.0, 0.3, len(raw))
        path = rng.normal(0.0, 0.1, (5, 4))
        path[:, 0] = np.linspace(0.0, 0.25, 5)
        assert_same(*(moved(module, rays, path, LIMITS) for module in FORMS))
        way, sector = rng.normal(0.0, 0.1, 3), np.array((rng.uniform(-4.0, 4.0), 1.0, 0.8))
        inside = (in_sector(module, rays, len(raw) // 4, way, sector, LIMITS) for module in FORMS)
        assert_same(*inside)


def test_two_rays_in_one_direction_keep_a_memory_each() -> None:
    """The bearings come in another array that holds the same."""
    spec = replace(load_platform("burger").scan, zero="no_return")
    bearings = np.tile(spec.bearings, 2)
    first = np.linspace(1.0, 2.0, 720)
    is_known = np.arange(720) % 9 > 0
    memory = KERNEL.RayMemory(spec, guesses_near=False)
    assert memory.condition(first, bearings.copy(), 0.0, 1.0).tolist() == first.tolist()
    got = memory.condition(np.where(is_known, 1.5, np.nan), bearings.copy(), 0.0, 1.0)
    assert got.tolist() == np.where(is_known, 1.5, first).tolist()


@pytest.mark.parametrize("unevenness", [0.0, 0.3])
@pytest.mark.parametrize("turned", [0.3, -1.0])
def test_lost_rays_have_the_range_that_was_measured_nearest_to_their_direction(
    unevenness: float, turned: float
) -> None:
    grid = np.arange(360) * math.tau / 360
    bearings = grid + unevenness * np.sin(grid)
    memory = KERNEL.RayMemory(replace(load_platform("burger").scan, bearings=grid),
                              guesses_near=False)  # fmt: skip
    first, is_lost = np.linspace(1.0, 2.0, 360), np.arange(360) % 9 == 0
    memory.condition(first, bearings, 0.0, 1.0)
    got = memory.condition(np.where(is_lost, np.nan, 1.5), bearings, turned, 1.1)
    turned = round(turned / (math.tau / 360)) * math.tau / 360
    apart = (bearings + turned - bearings[:, None] + math.pi) % math.tau - math.pi
    np.testing.assert_array_equal(got, np.where(is_lost, first[np.abs(apart).argmin(axis=0)], 1.5))


def sensed(module: Any, spec: ScanSpec, seed: int, bearings: Array) -> list[Any]:
    """All that comes of the scans and readings of a drive, with odd ones among them."""
    rng, kept = np.random.default_rng(seed), list[Any]()
    delay, conditioner = module.ScanDelay(spec), module.ScanConditioner(spec)
    history = module.OdometryHistory(delay)
    deskewer = module.Deskewer(spec, history, delay.sweep)
    rates = rng.uniform(-2.0, 2.0, 12)
    yaw, clock, at, odometry, ranges = 0.0, 0.0, -math.inf, Odometry(0.0, Pose(), Twist()), None
    ages = None if rng.random() < 0.5 else np.sort(rng.choice(12, len(bearings))) / 60.0
    for tick in range(160):
        now, rate = 0.05 * tick, float(rates[tick // 16])
        yaw += 0.05 * rate
        if rng.random() < 0.01:  # a clock is set, or the pose jumps
            clock, yaw = float(rng.choice((-1.0, 2.0))), yaw + float(rng.choice((0.0, 1.0)))
        pose = Pose(0.01 * tick, float(rng.choice((0.0, 1e-3))), yaw)
        if rng.random() < 0.95:
            odometry = Odometry(now + clock, pose, Twist(0.2, rate))
        odd = Odometry(now, pose, Twist(float(rng.choice((math.nan, 2e9)))))
        is_new = history.take(odd if rng.random() < 0.02 else odometry, now)
        at = now if is_new else at
        kept += [is_new, history.latest, delay.restarts]
        if tick % 4:
            continue
        if ranges is None or rng.random() < 0.9:
            ranges = ranges_of(len(bearings), spec, int(rng.integers(0, 3)), rng.random())
        stamp = now - 0.1 - (0.3 if rng.random() < 0.05 else 0.0)
        scan = Scan(tick, stamp, ranges, bearings, spec.range_min, spec.range_max, ages)
        taken = conditioner.take(scan, odometry, now)
        delay.on_scan(scan, now)
        kept += [conditioner.known_at, conditioner.blind_text, delay.added, delay.is_late]
        kept.append(delay.summary(now))
        if isinstance(taken, Scan):
            age = now - at if now - at < 0.5 else None
            taken = deskewer.deskew(taken, now, age, delay.added)
            rays = taken.ranges, taken.bearings, taken.ages
            kept += [None if one is None else one.tobytes() for one in rays]
            kept.append(taken.newest_age)
        else:
            kept.append(taken)
    return kept


@compares_forms
@given(layouts(), st.sampled_from(SPECS), st.sampled_from(ZEROS), st.booleans(), SEEDS)
@settings(max_examples=examples(24), deadline=None)
def test_any_drive_gives_the_same_compiled_and_interpreted(
    odd: Array, spec: ScanSpec, zero: str, measures_sweep: bool, seed: int
) -> None:
    sweep = None if measures_sweep else spec.sweep
    spec = replace(spec, zero=zero, sweep=sweep, measures_sweep=measures_sweep, max_gap=7.0)
    bearings = odd if seed % 3 == 0 else spec.bearings
    expected, got = (sensed(module, spec, seed, bearings) for module in FORMS)
    assert repr(got) == repr(expected)


Rays = tuple[Array, Array, Array]


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
