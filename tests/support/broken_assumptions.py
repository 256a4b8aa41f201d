"""Lockstep swarms in which one assumption of docs/safety.md does not hold."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from swarmd.core.values import Array
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.world.faults import fault_of


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


def give_all(lab: Lockstep, **fault: Any) -> None:
    """Give all robots a fault of the table, such as `scan="offset", offset=0.05`."""
    lab.world.change_fault(fault_of(fault, "test"), range(len(lab.world.ids)), is_on=True)
