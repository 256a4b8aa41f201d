"""Errors of range sensors: bias, noise, rounding, lost rays and the minimum range."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array, Platform, ScanSpec
from swarmd.sim.world.geometry import Indices
from swarmd.sim.world.realism import LidarNoise
from swarmd.sim.world.seeding import generator


class NoisyLidar:
    """Sensor errors of a swarm; each robot has a random generator of its own."""

    def __init__(
        self, noise: LidarNoise, platforms: Sequence[Platform], ids: Sequence[str], seed: int
    ) -> None:
        """`platforms` and `ids` (n,) in the order of rows."""
        specs = [platform.scan for platform in platforms]
        self._noise = noise
        self._rngs = [generator(seed, "lidar", robot) for robot in ids]
        self._factors = np.array([1.0 + noise.bias * r.standard_normal() for r in self._rngs])
        self._reach = np.array([(spec.range_min, spec.range_max) for spec in specs]).reshape(-1, 2)
        self._lost = np.array([lost_range(spec) for spec in specs])
        self._near = np.array([_near(spec) for spec in specs])
        self._nothing = np.array([_nothing(spec) for spec in specs])
        blocks = [noise.block_dropout if spec.zero == "lds" else 0.0 for spec in specs]
        self._block_dropout = np.array(blocks)
        changed = (noise.bias, noise.near_sd, noise.far_sd, noise.resolution)
        self._is_exact = not any((*changed, noise.dropout, *blocks))
        # By number of rays: the kernel, and buffers of normal and of uniform random numbers.
        self._errors: dict[int, tuple[Any, Array, NDArray[np.float32]]] = {}

    def apply(self, rows: Indices, ranges: Sequence[Array]) -> list[Array]:
        """The measurements of robots `rows` (m,) for exact `ranges`, (rays,) each."""
        return [self.measured(row, r) for row, r in zip(rows.tolist(), ranges, strict=True)]

    def measured(self, row: int, ranges: Array) -> Array:
        """The measurements (rays,) of robot `row` for exact `ranges`, as a new array.

        A ray without a return stays without a return. A measurement beyond range_max becomes +inf,
        and a measurement nearer than range_min -inf. A ray that drops out becomes 0, or NaN for
        a sensor whose zeros mean "too close" (REP 117). Then the ranges are encoded as by the
        sensor's driver: an LDS reports no return as 0, and a sensor with `near: lost` reports a
        return nearer than range_min as no return.
        """
        measured = ranges.copy()
        rays = len(ranges)
        if rays not in self._errors:
            self._errors[rays] = self._errors_of(rays)
        errors, normal, uniform = self._errors[rays]  # `errors` reads the buffers of random numbers
        if self._is_exact:
            errors.encode(row, measured)
            return measured
        self._rngs[row].standard_normal(out=normal)
        self._rngs[row].random(dtype=np.float32, out=uniform)
        errors.measure(row, measured)
        return measured

    def _errors_of(self, rays: int) -> tuple[Any, Array, NDArray[np.float32]]:
        normal = np.empty(rays)
        # At the first scan: who reads a scenario needs no library of the world.
        from swarmd.sim.world.ray_caster import BLOCK, Errors

        uniform = np.empty(rays + math.ceil(rays / BLOCK), dtype=np.float32)
        encoded = np.stack((self._near, self._nothing), axis=-1)
        errors = Errors(
            self._noise,
            self._factors,
            self._reach,
            self._lost,
            encoded,
            self._block_dropout,
            normal,
            uniform,
        )
        return errors, normal, uniform


def lost_range(spec: ScanSpec) -> float:
    """The range of a lost ray: 0, or NaN for a sensor whose zeros mean "too close" (REP 117)."""
    return math.nan if spec.zero == "too_close" else 0.0


def _nothing(spec: ScanSpec) -> float:
    """The range of a ray without return: an LDS reports 0."""
    return 0.0 if spec.zero == "lds" else math.inf


def _near(spec: ScanSpec) -> float:
    """The range of a return nearer than range_min."""
    return _nothing(spec) if spec.near == "lost" else -math.inf
