"""The four horizontal sensors of the Multi-ranger, in the order of the rays, and the battery."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from swarmd.core.values import Array

SENSORS = ("front", "left", "back", "right")
"""By bearing: 0, 90, 180, -90 degrees."""
BATTERY_VOLTS = 3.0, 4.2
"""V of an empty and of a full battery."""
NO_RETURN = 8000
"""mm: cflib takes this and more for no return (utils/multiranger.py)."""


def ranges_of(values: Mapping[str, float], range_min: float, range_max: float) -> Array:
    """(4,) ranges in m from logged mm: infinite for no return, minus infinite for too near."""
    ranges = np.empty(len(SENSORS))
    for index, name in enumerate(SENSORS):
        distance = values[f"range.{name}"]
        ranges[index] = 1e-3 * distance if distance < NO_RETURN else math.inf
    ranges[ranges > range_max] = math.inf
    ranges[ranges < range_min] = -math.inf
    return ranges
