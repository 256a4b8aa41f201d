"""Errors of range sensors: bias, noise, rounding, lost rays and the minimum range."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from swarmd.core.kernels import compiled_kernel
from swarmd.core.values import Array, Platform, ScanSpec
from swarmd.sim.world.geometry import Indices
from swarmd.sim.world.realism import LidarNoise
from swarmd.sim.world.seeding import generator

if TYPE_CHECKING:  # where it is not compiled the numpy code runs
    from swarmd.sim.world.lidar_kernel import Errors

    _Compiled = tuple[Errors, Array, NDArray[np.float32]]

BLOCK = 6
"""Rays in one packet of an LDS, which its driver loses together."""

_BATCH = 32  # scans a step, so that its arrays stay within a processor's cache


class NoisyLidar:
    """Sensor errors of a swarm; a robot's errors do not depend on which others scan with it."""

    def __init__(
        self, noise: LidarNoise, platforms: Sequence[Platform], ids: Sequence[str], seed: int
    ) -> None:
        """`platforms` and `ids` (n,) in the order of rows."""
        specs = [platform.scan for platform in platforms]
        self._noise = noise
        self._rngs = [generator(seed, "lidar", robot) for robot in ids]
        self._factors = np.array([1.0 + noise.bias * r.standard_normal() for r in self._rngs])
        self._reach = np.array([(spec.range_min, spec.range_max) for spec in specs]).reshape(-1, 2)
        # A lost ray is 0, unless zeros mean too close (REP 117).
        self._lost = np.array([math.nan if s.zero == "too_close" else 0.0 for s in specs])
        self._near = np.array([_near(spec) for spec in specs])
        self._nothing = np.array([_nothing(spec) for spec in specs])
        blocks = [noise.block_dropout if spec.zero == "lds" else 0.0 for spec in specs]
        self._block_dropout = np.array(blocks)
        changed = (noise.bias, noise.near_sd, noise.far_sd, noise.resolution)
        self._is_exact = not any((*changed, noise.dropout, *blocks))
        self._kernel = compiled_kernel("swarmd.sim.world.lidar_kernel")
        self._compiled: dict[int, _Compiled] = {}

    def apply(self, rows: Indices, ranges: Sequence[Array]) -> list[Array]:
        """The measurements of robots `rows` (m,) for exact `ranges`, (rays,) each.

        Rays without a return stay so. Measurements beyond range_max become +inf, nearer than
        range_min -inf, and a lost ray NaN if the sensor's zeros mean too close, else 0. The result
        is encoded as by the sensor's driver: an LDS reports no return as 0, and a sensor with
        `near: lost` reports a return nearer than range_min as no return.
        """
        if self._kernel is not None:
            return [self._measured(row, r) for row, r in zip(rows.tolist(), ranges, strict=True)]
        measured = list(ranges) if self._is_exact else self._noisy(rows, ranges)
        return [self._encoded(row, r) for row, r in zip(rows.tolist(), measured, strict=True)]

    def _measured(self, row: int, ranges: Array) -> Array:
        """`ranges` (rays,) as the kernel measures and encodes them; a copy where they differ."""
        if self._is_exact and self._near[row] == -np.inf and self._nothing[row] == np.inf:
            return ranges
        measured, rays = ranges.copy(), len(ranges)
        if rays not in self._compiled:
            self._compiled[rays] = self._compile(rays)
        errors, normal, even = self._compiled[rays]
        if self._is_exact:
            errors.encode(row, measured)
            return measured
        rng = self._rngs[row]
        rng.standard_normal(out=normal)
        rng.random(dtype=np.float32, out=even)
        errors.measure(row, measured)
        return measured

    def _compile(self, rays: int) -> _Compiled:
        normal, even = np.empty(rays), np.empty(rays + math.ceil(rays / BLOCK), dtype=np.float32)
        encoded = np.stack((self._near, self._nothing), axis=-1)
        errors = self._kernel.Errors(
            self._noise,
            self._factors,
            self._reach,
            self._lost,
            encoded,
            self._block_dropout,
            normal,
            even,
        )
        return errors, normal, even

    def _encoded(self, row: int, ranges: Array) -> Array:
        """`ranges` (rays,) of robot `row` as its driver encodes them; a copy where they differ."""
        near, nothing = self._near[row], self._nothing[row]
        if near == -np.inf and nothing == np.inf:
            return ranges
        encoded = np.where(ranges == np.inf, nothing, ranges)
        np.copyto(encoded, near, where=ranges == -np.inf)
        return encoded

    def _noisy(self, rows: Indices, ranges: Sequence[Array]) -> list[Array]:
        alike: dict[int, list[int]] = {}
        for place, row in enumerate(ranges):
            alike.setdefault(len(row), []).append(place)
        measured: list[Array] = list(ranges)
        for places in alike.values():
            for first in range(0, len(places), _BATCH):
                some = places[first : first + _BATCH]
                noisy = self._measure(rows[some], np.array([ranges[place] for place in some]))
                for place, row in zip(some, noisy, strict=True):
                    measured[place] = row
        return measured

    def _measure(self, rows: Indices, exact: Array) -> Array:
        """Measure `exact` (m, rays) with the sensors of robots `rows` (m,), in place."""
        noise, rays = self._noise, exact.shape[1]
        normal, even = self._draw(rows, rays)
        is_known = np.isfinite(exact)
        r = np.where(is_known, exact, 0.0)
        spread = noise.far_sd * r
        np.copyto(spread, noise.near_sd, where=r < noise.near)
        r *= self._factors[rows, None]
        r += np.multiply(spread, normal, out=normal)
        if noise.resolution > 0.0:
            r /= noise.resolution
            np.rint(r, out=r)
            r *= noise.resolution
        np.copyto(r, -np.inf, where=r < self._reach[rows, :1])
        np.copyto(r, np.inf, where=r > self._reach[rows, 1:])
        np.copyto(r, self._lost[rows, None], where=self._losses(rows, even, rays))
        np.copyto(exact, r, where=is_known)
        return exact

    def _draw(self, rows: Indices, rays: int) -> tuple[Array, NDArray[np.float32]]:
        """Normal numbers (m, rays), and uniform ones for each ray and then each block."""
        normal = np.empty((len(rows), rays))
        even = np.empty((len(rows), rays + math.ceil(rays / BLOCK)), dtype=np.float32)
        for place, row in enumerate(rows.tolist()):
            rng = self._rngs[row]
            rng.standard_normal(out=normal[place])
            rng.random(dtype=np.float32, out=even[place])
        return normal, even

    def _losses(self, rows: Indices, draws: NDArray[np.float32], rays: int) -> NDArray[np.bool_]:
        alone = draws[:, :rays] < self._noise.dropout
        blocks = draws[:, rays:] < self._block_dropout[rows, None]
        return np.logical_or(alone, np.repeat(blocks, BLOCK, axis=1)[:, :rays])


def _nothing(spec: ScanSpec) -> float:
    """The range of a ray without return: an LDS reports 0."""
    return 0.0 if spec.zero == "lds" else math.inf


def _near(spec: ScanSpec) -> float:
    """The range of a return nearer than range_min."""
    return _nothing(spec) if spec.near == "lost" else -math.inf
