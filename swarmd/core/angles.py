"""Arithmetic of angles in radians."""

from __future__ import annotations

import math


def wrap(angle: float) -> float:
    """The same direction within [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def difference(to: float, origin: float) -> float:
    """The turn from `origin` to `to`, within [-pi, pi), counter-clockwise positive."""
    return wrap(to - origin)
