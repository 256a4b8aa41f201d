"""Lockstep swarms in which one assumption of docs/safety.md does not hold."""

from __future__ import annotations

import math

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.world.geometry import Indices


def lose_rays(lab: Lockstep, share: float, half: float, seed: int) -> None:
    """Lose a share of all rays within `half` rad of ahead, in each scan other ones."""
    noise, rng = lab.world._noise, np.random.default_rng(seed)
    measured = noise.measured

    def lossy(row: int, ranges: Array) -> Array:
        seen = measured(row, ranges)
        is_ahead = np.cos(lab.world.platforms[row].scan.bearings) >= math.cos(half)
        seen[is_ahead & (rng.random(len(seen)) < share)] = noise._lost[row]
        return seen

    noise.measured = lossy  # type: ignore[method-assign]


def freeze_rays(lab: Lockstep, half: float) -> None:
    """All rays within `half` rad of ahead repeat their next ranges from then on."""
    noise, kept = lab.world._noise, dict[int, Array]()
    measured = noise.measured

    def frozen(row: int, ranges: Array) -> Array:
        seen = measured(row, ranges)
        is_ahead = np.cos(lab.world.platforms[row].scan.bearings) >= math.cos(half)
        seen[is_ahead] = kept.setdefault(row, seen[is_ahead])
        return seen

    noise.measured = frozen  # type: ignore[method-assign]


def scale_odometry(lab: Lockstep, share: float) -> None:
    """Odometry shows this share of each way that the bases drive."""
    odometers = lab.world._odometers
    read, ways = odometers.read, np.array([share, share, 1.0])

    def scaled(rows: Indices, poses: Array, twists: Array) -> tuple[Array, Array]:
        poses, twists = read(rows, poses, twists)
        return poses * ways, twists * ways[[0, 2, 1]]

    odometers.read = scaled  # type: ignore[method-assign]


def shift_ranges(lab: Lockstep, metres: float) -> None:
    """All ranges are so much too long."""
    noise = lab.world._noise
    measured = noise.measured
    noise.measured = lambda row, ranges: measured(row, ranges) + metres  # type: ignore[method-assign]
