"""Simulated bodies that hover: they drift, and the height that they hold has an error.

Drift and height error are processes with a memory of _MEMORY s (Ornstein-Uhlenbeck), cut at two
standard deviations. A body that hovers has `body: {drift: ..., height_error: ...}`, the standard
deviations in m/s and m. The world stays planar: the height is a reading, and changes no scan.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from swarmd.core.values import Array, Platform
from swarmd.sim.world.bodies import heights
from swarmd.sim.world.seeding import generator

HEIGHT = "height"
"""The reading of the height in m above the floor."""

_MEMORY = 2.0  # s, our choice
_CUT = 2.0  # standard deviations
_DRAWS = 256  # steps drawn at once


class Hovering:
    """Drift and height of the robots that hover; false if no robot hovers."""

    def __init__(
        self, platforms: Sequence[Platform], ids: Sequence[str], drift: Array, dt: float, seed: int
    ) -> None:
        """`drift` (n, 2): m/s along the world's x and y, which `step` writes; `dt` in s."""
        self._drift = drift
        self._rows = [row for row, one in enumerate(platforms) if _spreads(one)]
        count = len(self._rows)
        self._index = {row: index for index, row in enumerate(self._rows)}
        self._spread = np.array([_spreads(platforms[row]) for row in self._rows]).reshape(count, 3)
        self._nominal = [heights(platforms[row]).scan_plane for row in self._rows]
        self._generators = [generator(seed, "hovering", ids[row]) for row in self._rows]
        # A step keeps this share of an error, and adds so much noise that the variance stays 1.
        self._keep = math.exp(-dt / _MEMORY)
        self._new = math.sqrt(1.0 - self._keep**2)
        self._errors = np.zeros((count, 3))  # of x, y and height, in standard deviations
        self._drawn = np.zeros((count, 0, 3))
        self._next = 0

    def __bool__(self) -> bool:
        return bool(self._rows)

    def step(self) -> None:
        """Advance by one step of the world."""
        if not self._rows:
            return
        if self._next == self._drawn.shape[1]:
            self._drawn = np.array([one.standard_normal((_DRAWS, 3)) for one in self._generators])
            self._next = 0
        self._errors = self._keep * self._errors + self._new * self._drawn[:, self._next]
        self._next += 1
        self._drift[self._rows] = (self._cut_errors() * self._spread)[:, :2]

    def readings(self, row: int) -> Mapping[str, float]:
        """The height of robot `row`; empty if it does not hover."""
        index = self._index.get(row)
        if index is None:
            return {}
        error = self._cut_errors()[index, 2] * self._spread[index, 2]
        return {HEIGHT: self._nominal[index] + float(error)}

    def _cut_errors(self) -> Array:
        return np.clip(self._errors, -_CUT, _CUT)


def _spreads(platform: Platform) -> tuple[float, float, float] | None:
    """The standard deviations of drift (twice, m/s) and height (m); None if it does not hover."""
    drift, height = (platform.body.get(key, 0.0) for key in ("drift", "height_error"))
    return (drift, drift, height) if drift > 0.0 or height > 0.0 else None
