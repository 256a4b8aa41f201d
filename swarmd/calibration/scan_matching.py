"""Estimates the pose of a scan by matching its points to a reference scan. Pure.

Iterative closest point (ICP) with point-to-line distances (Chen and Medioni, IVC 1992; Censi, ICRA
2008). The surroundings must constrain each coordinate: in a bare corridor the place along the
corridor stays unknown, in a round room the heading.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from swarmd.core.values import Array, Pose, Scan

_BINS = 360
_REACH = 4  # neighbours to each side of a point to which its line is fitted
_NEIGHBOR = 0.3  # m; the greatest distance of such a neighbour
_FEWEST = 5  # points of a line, at least
_FLAT = 0.1  # (thickness / length of a line) squared, at most
# m; the greatest distance of matched points in each iteration.
_GATES = (0.5, 0.35, 0.25, 0.18, 0.12, 0.1, 0.08, 0.08, 0.08, 0.08)
_LEAST_POINTS = 40
_LEAST_SHARE = 0.5  # share of the points of a scan that must match
_LEAST_RELIEF = 0.15  # share of normals that must constrain a coordinate; noise gives less


class Located(NamedTuple):
    """The pose of a scan in the reference frame; `binds_...`: the coordinate is constrained."""

    pose: Pose
    binds_place: bool
    binds_yaw: bool


def points_of(scan: Scan, offset: tuple[float, float]) -> Array:
    """(k, 2) returns in the base frame in m; `offset`: of the sensor in the base frame, m."""
    is_return = (scan.ranges >= scan.range_min) & (scan.ranges <= scan.range_max)
    ranges, bearings = scan.ranges[is_return], scan.bearings[is_return]
    x, y = offset[0] + ranges * np.cos(bearings), offset[1] + ranges * np.sin(bearings)
    return np.stack((x, y), axis=1)


class Reference:
    """The points of the surroundings, with the normals of the lines on which they lie."""

    def __init__(self, scans: Sequence[Array]) -> None:
        """`scans`: points (k, 2) in m of scans taken at one pose, which becomes the origin."""
        places = _middle(np.concatenate(scans))
        normals = [_normal(places, i) for i in range(len(places))]
        flat = [i for i, normal in enumerate(normals) if normal is not None]
        self._points = places[flat]
        self._normals = np.array([n for n in normals if n is not None]).reshape(-1, 2)
        self._squares = (self._points * self._points).sum(axis=1)

    def locate(self, points: Array, guess: Pose) -> Located | None:
        """The pose at which `points` (k, 2) were seen; None if they do not match."""
        if min(len(points), len(self._points)) < _LEAST_POINTS:
            return None
        x, y, yaw = guess.x, guess.y, guess.yaw
        count, matrix = 0, np.eye(3)
        for gate in _GATES:
            cos, sin = math.cos(yaw), math.sin(yaw)
            turned = points @ np.array(((cos, sin), (-sin, cos)))
            placed = turned + np.array((x, y))
            # Squared distances, without the term that is equal for all points of the reference.
            nearest = (self._squares - 2.0 * placed @ self._points.T).argmin(axis=1)
            off = placed - self._points[nearest]
            is_match = (off * off).sum(axis=1) < gate * gate
            count = int(is_match.sum())
            if count < max(_LEAST_POINTS, _LEAST_SHARE * len(points)):
                return None
            nearest, turned = nearest[is_match], turned[is_match]
            normals = self._normals[nearest]
            errors = (off[is_match] * normals).sum(axis=1)
            levers = turned[:, 0] * normals[:, 1] - turned[:, 1] * normals[:, 0]
            sides = np.column_stack((normals, levers))
            matrix = sides.T @ sides
            # The small diagonal keeps unconstrained coordinates at the guess.
            change = np.linalg.solve(matrix + 1e-6 * count * np.eye(3), sides.T @ errors)
            x, y, yaw = x - float(change[0]), y - float(change[1]), yaw - float(change[2])
        size = float(np.median(np.hypot(points[:, 0], points[:, 1])))
        place = float(np.linalg.eigvalsh(matrix[:2, :2])[0])
        heading = float(matrix[2, 2]) / size**2
        least = count * _LEAST_RELIEF**2
        return Located(Pose(x, y, yaw), place >= least, heading >= least)


def _middle(points: Array) -> Array:
    """(n, 2) the median point of each bearing bin, in the order of bearings."""
    ranges, bearings = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    bins = ((bearings + np.pi) * (_BINS / (2.0 * np.pi))).astype(np.intp) % _BINS
    middle = []
    for number in np.unique(bins):
        among = bins == number
        middle.append((float(np.median(ranges[among])), float(np.median(bearings[among]))))
    r, b = np.array(middle).T
    return np.stack((r * np.cos(b), r * np.sin(b)), axis=1)


def _normal(places: Array, i: int) -> Array | None:
    """The unit normal of the line through the neighbours of place `i`; None without a line."""
    near = places.take(range(i - _REACH, i + _REACH + 1), axis=0, mode="wrap")
    near = near[np.hypot(*(near - places[i]).T) <= _NEIGHBOR]
    if len(near) < _FEWEST:
        return None
    off = near - near.mean(axis=0)
    sizes, axes = np.linalg.eigh(off.T @ off)
    return axes[:, 0] if sizes[0] <= _FLAT * sizes[1] else None
