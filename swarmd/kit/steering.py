"""From a direction vector to a command: keeps clear of near obstacles and steers the base.

Vectors are in the base frame (x forward, y left), of length 0 (stand) to 1 (full speed).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarmd.core.kernels import load_kernel
from swarmd.core.values import Array, Twist

if TYPE_CHECKING:
    from swarmd.kit.points import NearPoints, polar_from_base
else:
    _kernel = load_kernel("swarmd.kit.points")
    NearPoints, polar_from_base = _kernel.NearPoints, _kernel.polar_from_base

__all__ = ["NearPoints", "from_base", "keep_clear", "polar_from_base", "steer"]


def from_base(points: Array, offset: tuple[float, float]) -> Array:
    """Points (k, 2) of range and bearing from a sensor at `offset` (m), relative to the base."""
    return np.array(polar_from_base(points.tolist(), offset), dtype=np.float64).reshape(-1, 2)


def keep_clear(vector: Array, points: Array, *, spacing: float, brake: float) -> Array:
    """The vector limited so that it leads no closer than `spacing` m to points (k, 2).

    Points are range, bearing. The component towards a point is at most (range - spacing) / brake:
    it falls from 1 at `spacing + brake` to 0 at `spacing`; nearer points push the vector away.
    """
    x, y = float(vector[0]), float(vector[1])
    return np.array(NearPoints(points.tolist()).keep_clear(x, y, spacing=spacing, brake=brake))


def steer(
    vector: Array,
    linear_max: float,
    angular_max: float,
    *,
    points: Array,
    spacing: float,
    brake: float,
    may_back: bool = False,
) -> Twist:
    """The command of a differential base along a vector: it turns, and drives once aligned.

    For a vector that points backwards it turns in place, or reverses at half speed with `may_back`.
    Points ahead limit the speed as in `keep_clear` while the base is still turning. A zero or
    non-finite vector gives zero.
    """
    x, y = float(vector[0]), float(vector[1])
    return NearPoints(points.tolist()).steer(
        x, y, linear_max, angular_max, spacing=spacing, brake=brake, may_back=may_back
    )
