"""Lockstep swarms in which one assumption of docs/safety.md does not hold."""

from __future__ import annotations

import math

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.lockstep.lockstep import Lockstep


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
