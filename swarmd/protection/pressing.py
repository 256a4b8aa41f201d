"""What a touch zone covers, and how fast an outline presses into its directions.

A lidar does not show what touches the robot, and what is pushed moves along with it. So the speed
of a zone is not that of closing on what is seen, but of moving its way at all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swarmd.protection.footprint import Facing
from swarmd.values import Array, TouchZone

_STEP = math.radians(15.0)  # between directions: what lies between is at most 1 % faster
_FACE = 1e-9  # m: corners that are as far out belong to one face


class Pressing(NamedTuple):
    """Directions `nx`, `ny` (n,) in which the outline's corners `x`, `y` (n,) in m may press."""

    nx: Array
    ny: Array
    x: Array
    y: Array


def covered(facing: Facing, zone: TouchZone) -> NDArray[np.bool_]:
    """(k,) true for what an outline faces in the sector of the zone."""
    off = np.arctan2(facing.ny, facing.nx) - zone.bearing
    found: NDArray[np.bool_] = np.abs((off + np.pi) % (2.0 * np.pi) - np.pi) <= zone.half_width
    return found


def pressing(corners: Array, zone: TouchZone) -> Pressing:
    """The corners (k, 2) of a convex outline that are foremost in directions of the zone."""
    count = math.ceil(2.0 * zone.half_width / _STEP)
    ways = np.linspace(zone.bearing - zone.half_width, zone.bearing + zone.half_width, count + 1)
    edges = np.roll(corners, -1, axis=0) - corners
    faces = np.arctan2(-edges[:, 0], edges[:, 1])  # outward normals of a counter-clockwise outline
    off = (faces - zone.bearing + np.pi) % (2.0 * np.pi) - np.pi
    ways = np.concatenate((ways, faces[np.abs(off) <= zone.half_width]))
    directions = np.stack((np.cos(ways), np.sin(ways)), axis=1)
    heights = directions @ corners.T
    way, corner = np.nonzero(heights >= heights.max(axis=1, keepdims=True) - _FACE)
    return Pressing(*directions[way].T, *corners[corner].T)
