"""The stages of a scan, compiled as interpreted."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.values import Array, Odometry, Pose, Scan, ScanSpec, Twist
from tests.support.examples import examples
from tests.support.kernel_forms import compares_forms
from tests.support.recorded_scans import (
    FORMS,
    SEEDS,
    SPECS,
    assert_same,
    in_sector,
    layouts,
    moved,
    ranges_of,
)

ZEROS = ("no_return", "too_close", "unknown", "lds")
LIMITS = np.array((-0.03, 0.01, 0.12, 3.5))
CALM = st.sampled_from((1.0, 1.0, 0.97, 0.7))


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
        assert_same(*([np.array(module.clusters(scan, within, 0.06, 0.2))] for module in FORMS))
        assert_same(*([module.unit_vectors(bearings)] for module in FORMS))
        rays = raw, bearings, rng.uniform(0.0, 0.3, len(raw))
        path = rng.normal(0.0, 0.1, (5, 4))
        path[:, 0] = np.linspace(0.0, 0.25, 5)
        assert_same(*(moved(module, rays, path, LIMITS) for module in FORMS))
        way, sector = rng.normal(0.0, 0.1, 3), np.array((rng.uniform(-4.0, 4.0), 1.0, 0.8))
        inside = (in_sector(module, rays, len(raw) // 4, way, sector, LIMITS) for module in FORMS)
        assert_same(*inside)


def sensed(module: Any, spec: ScanSpec, seed: int, bearings: Array) -> list[Any]:
    """All that comes of the scans and readings of a drive, with odd ones among them."""
    rng, kept = np.random.default_rng(seed), list[Any]()
    delay, conditioner = module.ScanDelay(spec), module.ScanConditioner(spec)
    history = module.OdometryHistory(delay)
    deskewer = module.Deskewer(spec, history)
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
    odd: Array, spec: ScanSpec, zero: str, is_sweep_unknown: bool, seed: int
) -> None:
    sweep = None if is_sweep_unknown else spec.sweep
    spec = replace(spec, zero=zero, sweep=sweep, is_sweep_unknown=is_sweep_unknown, max_gap=7.0)
    bearings = odd if seed % 3 == 0 else spec.bearings
    expected, got = (sensed(module, spec, seed, bearings) for module in FORMS)
    assert repr(got) == repr(expected)
