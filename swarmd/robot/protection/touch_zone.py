"""The touch zone in mode `barrier`: directions in which a pattern may touch an obstacle.

Part of the unit of barrier.py. Units: m, s, rad, in the base frame.
"""

from __future__ import annotations

import math

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import view
from swarmd.core.cython_shadow import Table, cos, sin
from swarmd.core.values import Array, TouchZone

_SAME_FACE = 1e-9  # m by which corners of one face may differ
_TOUCH_STEP = math.radians(15.0)  # directions between two of these are at most 1 % faster


@cython.cclass
class TouchSector:
    """The granted touch zone as numbers of the kernel; no zone is granted at first."""

    zone: TouchZone | None  # as it was granted, or None
    is_granted: bool
    speed: float  # m/s
    x: float  # the middle direction
    y: float
    least_cos: float  # cosine of the angle between the middle and the border of the zone
    corners: Table  # (n, 4) nx, ny, x, y: a direction, and the corner foremost in it

    def __init__(self) -> None:
        self.corners = view(np.empty((0, 4)))

    def grant(self, zone: TouchZone | None, corners: Array) -> None:
        """Grant a zone to a robot with the outline `corners` (k, 2); None: no zone."""
        self.zone = zone
        self.is_granted = zone is not None
        if zone is not None:
            self.speed = zone.speed
            self.least_cos = cos(zone.half_width)
            self.x = cos(zone.bearing)
            self.y = sin(zone.bearing)
            self.corners = view(np.stack(touch_directions(corners, zone), 1))

    def holds(self, normal_x: float, normal_y: float) -> bool:
        """True for a direction within the sector."""
        return normal_x * self.x + normal_y * self.y >= self.least_cos


def touch_directions(corners: Array, zone: TouchZone) -> tuple[Array, Array, Array, Array]:
    """Directions nx, ny (n,) of the zone, and the corners x, y (n,) in m foremost in each.

    A lidar does not show an object that touches the robot, and a pushed object moves with the
    robot. So the speed of a touch zone limits any motion in its directions, not only motion towards
    a return.
    """
    count = math.ceil(2.0 * zone.half_width / _TOUCH_STEP)
    angles = np.linspace(zone.bearing - zone.half_width, zone.bearing + zone.half_width, count + 1)
    edges = np.roll(corners, -1, axis=0) - corners
    faces = np.arctan2(-edges[:, 0], edges[:, 1])  # outward normals of a counter-clockwise outline
    off = (faces - zone.bearing + np.pi) % (2.0 * np.pi) - np.pi
    angles = np.concatenate((angles, faces[np.abs(off) <= zone.half_width]))
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    heights = directions @ corners.T
    direction, corner = np.nonzero(heights >= heights.max(axis=1, keepdims=True) - _SAME_FACE)
    return (*directions[direction].T, *corners[corner].T)
