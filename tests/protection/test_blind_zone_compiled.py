"""The blind-zone memory remembers the same compiled and interpreted."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarmd.core.kernels import load_kernel
from swarmd.core.values import Array, Pose, Scan, ScanSpec
from swarmd.protection import blind_zone as interpreted
from swarmd.protection.footprint import ScanGeometry
from swarmd.settings.platforms import load_platform, platform_names
from tests.support.examples import examples

compiled = load_kernel("swarmd.protection.blind_zone")
if compiled is interpreted:
    pytest.skip("the kernels are not compiled", allow_module_level=True)

SPECS = [load_platform(name).scan for name in platform_names()]
SPECS = [spec for spec in SPECS if spec.range_min > 0.0]
SEEDS = st.integers(0, 2**32 - 1)


@st.composite
def layouts(draw: st.DrawFn, spec: ScanSpec) -> Array:
    """The bearings of the platform, or odd ones."""
    kind = draw(st.sampled_from(("platform", "platform", "uneven", "clockwise", "twice", "dense")))
    rng = np.random.default_rng(draw(SEEDS))
    if kind == "uneven":
        return rng.uniform(-7.0, 7.0, draw(st.integers(1, 60)))
    if kind == "clockwise":
        return -spec.bearings
    if kind == "twice":
        return rng.permutation(np.tile(spec.bearings[:: draw(st.integers(1, 20))], 2))
    if kind == "dense":
        return np.linspace(-math.pi, math.pi, 1500, endpoint=False)
    return spec.bearings


class Surroundings:
    """Faces that move about the sensor, seen along some bearings; within range_min they vanish."""

    def __init__(self, spec: ScanSpec, rng: np.random.Generator) -> None:
        self.spec, self.rng = spec, rng
        self.beyond = rng.choice((math.inf, 1.1 * spec.range_min, spec.range_max))
        self.faces = [self._face() for _ in range(int(rng.integers(1, 4)))]

    def _face(self) -> list[float]:
        """Distance, bearing, half width, approach and drift per scan."""
        rng, near = self.rng, self.spec.range_min
        wide = math.radians(rng.choice((3.0, 5.0, 15.0, 40.0, 80.0, 170.0)))
        return [rng.uniform(0.9, 1.8) * near, rng.uniform(-4, 4), wide, *rng.normal(0.0, 0.04, 2)]

    def scan(self, bearings: Array, seq: int) -> Scan:
        rng, spec = self.rng, self.spec
        ranges = np.full(len(bearings), self.beyond)
        for face in self.faces:
            face[0], face[1] = abs(face[0] - abs(face[3])), face[1] + face[4]
            off = (bearings - face[1] + math.pi) % (2.0 * math.pi) - math.pi
            is_on = np.abs(off) < face[2]
            bent = face[0] / np.maximum(np.cos(off[is_on]), 0.2) if face[4] > 0.0 else face[0]
            ranges[is_on] = np.minimum(ranges[is_on], bent)
        ranges += rng.normal(0.0, rng.choice((0.0, 0.01)), len(bearings))
        is_lost = ranges < spec.range_min
        ranges[is_lost] = rng.choice((math.inf, -math.inf), p=(0.9, 0.1))
        ranges[rng.random(len(bearings)) < rng.choice((0.0, 0.02))] = math.inf
        return Scan(seq, 0.1 * seq, ranges, bearings, spec.range_min, spec.range_max)


@given(st.data(), st.sampled_from(SPECS), SEEDS, st.sampled_from((0.02, 0.3, 1.1)))
@settings(max_examples=examples(60), deadline=None)
def test_hidden_obstacles_are_the_same(
    data: st.DataObject, spec: ScanSpec, seed: int, speed: float
) -> None:
    """A robot that turns and moves among faces that come and go; the bearings change at times."""
    rng = np.random.default_rng(seed)
    given_bearings = [data.draw(layouts(spec)) for _ in range(2)]
    offset = (float(rng.uniform(-0.3, 0.3)), float(rng.uniform(-0.1, 0.1)))
    geometry = ScanGeometry(replace(spec, offset=offset))
    period = 1.0 / spec.rate
    pair = [
        module.BlindZoneMemory(spec.range_min, speed, period) for module in (interpreted, compiled)
    ]
    around = Surroundings(spec, rng)
    turn = float(rng.choice((0.0, 0.003, 0.05, 0.4)))
    for seq in range(25):
        bearings = given_bearings[int(rng.random() < 0.05)]
        scan = around.scan(bearings, seq)
        x, y = rng.uniform(-0.1, 0.1, 2).tolist()
        moved = Pose(x, y, float(rng.choice((turn, -turn, turn))))
        seconds = float(rng.choice((period, period, 0.0, 2.0)))
        for memory in pair:
            memory.update(scan, geometry, moved, seconds)
        expected, got = pair
        assert len(got.bearings) == len(expected.bearings)
        np.testing.assert_allclose(got.bearings, expected.bearings, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(got.nearest, expected.nearest, rtol=0.0, atol=1e-12)
