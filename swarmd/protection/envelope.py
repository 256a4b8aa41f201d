"""The envelope: the twists with which no corner of a robot is faster than others rely on.

Each robot assumes that no surface around it moves faster than `others_speed`. This makes that true
of the robot itself, corners in a turn included (protection against others rests on a promise that
all of them keep; compare "passive safety" in Mitsch et al., IJRR 2017).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swarmd.protection.feasible import Point
from swarmd.values import Array

BOX: tuple[Point, ...] = ((1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0))
"""All twists within the limits."""

_DIRECTIONS = 48  # multiples of 7.5 degrees: the corners of the box are among them


def envelope(corners: Array, along: Point, limits: Point, speed: float) -> tuple[Point, ...]:
    """The polygon of (linear, angular), each over its limit, with which no corner exceeds `speed`.

    `corners` (k, 2) in the base frame in m; `along` the direction of the linear motion, of length
    1; `limits` m/s and rad/s; `speed` m/s. An inner approximation: its corners are exact, and what
    it approximates is convex.
    """
    angles = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    ways = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    ways /= np.abs(ways).max(axis=1)[:, None]  # on the box of the limits
    linear, angular = (ways * limits).T[:, :, None]
    x = linear * along[0] - angular * corners[:, 1]
    y = linear * along[1] + angular * corners[:, 0]
    fastest = np.hypot(x, y).max(axis=1)
    shares = np.minimum(1.0, speed / np.maximum(fastest, 1e-12))
    return tuple((float(a), float(b)) for a, b in ways * shares[:, None])


def half_planes(polygon: Sequence[Point]) -> tuple[Array, Array]:
    """Normals (k, 2) and caps (k,): normals @ point <= caps for each point of a convex polygon."""
    corners = np.array(polygon)
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.stack((edges[:, 1], -edges[:, 0]), axis=1)
    normals /= np.hypot(normals[:, 0], normals[:, 1])[:, None]
    return normals, np.einsum("ka,ka->k", normals, corners)
