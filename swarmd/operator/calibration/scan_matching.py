"""Estimates the pose of a scan by matching its points to a reference scan. Pure.

Iterative closest point (ICP) with point-to-line distances (Chen and Medioni, IVC 1992; Censi, ICRA
2008). A coordinate stays unknown if the surroundings do not constrain it: the place along a bare
corridor, or the heading in a round room.
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
_DAMPING = 1e-6  # for each matched point
# Least root mean square of the normals' components along a coordinate; noise gives less.
_LEAST_RELIEF = 0.15


class Located(NamedTuple):
    """The pose of a scan in the reference frame."""

    pose: Pose
    binds_place: bool  # the points constrain x and y
    binds_yaw: bool  # the points constrain the heading


def points_of(scan: Scan, offset: tuple[float, float]) -> Array:
    """(k, 2) returns in the base frame in m; `offset`: of the sensor in the base frame, m."""
    is_return = (scan.ranges >= scan.range_min) & (scan.ranges <= scan.range_max)
    ranges = scan.ranges[is_return]
    bearings = scan.bearings[is_return]
    x = offset[0] + ranges * np.cos(bearings)
    y = offset[1] + ranges * np.sin(bearings)
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
        """The pose in the reference frame at which `points` were seen, by point-to-line ICP.

        `points`: (k, 2) m in the base frame. `guess`: a pose near the result, such as odometry's.
        None if too few points match. `Located` also says which coordinates the points constrain.
        """
        if min(len(points), len(self._points)) < _LEAST_POINTS:
            return None
        x = guess.x
        y = guess.y
        yaw = guess.yaw
        match_count = 0
        normal_matrix = np.eye(3)
        for max_distance in _GATES:
            # 1. Match each point with the nearest point of the reference. The squared distances
            # |p|^2 - 2 p q + |q|^2 lack |p|^2, which is equal for all points q of the reference.
            cos = math.cos(yaw)
            sin = math.sin(yaw)
            rotated = points @ np.array(((cos, sin), (-sin, cos)))
            placed = rotated + np.array((x, y))
            nearest = (self._squares - 2.0 * placed @ self._points.T).argmin(axis=1)
            offsets = placed - self._points[nearest]
            is_match = (offsets * offsets).sum(axis=1) < max_distance * max_distance
            match_count = int(is_match.sum())
            if match_count < max(_LEAST_POINTS, _LEAST_SHARE * len(points)):
                return None

            # 2. One Gauss-Newton step on the distances from the reference's lines. The columns of
            # the Jacobian are the derivatives by x, y and yaw.
            nearest = nearest[is_match]
            rotated = rotated[is_match]
            normals = self._normals[nearest]
            errors = (offsets[is_match] * normals).sum(axis=1)
            by_yaw = rotated[:, 0] * normals[:, 1] - rotated[:, 1] * normals[:, 0]
            jacobian = np.column_stack((normals, by_yaw))
            normal_matrix = jacobian.T @ jacobian
            # The small diagonal keeps unconstrained coordinates at the guess.
            damped = normal_matrix + _DAMPING * match_count * np.eye(3)
            change = np.linalg.solve(damped, jacobian.T @ errors)
            x = x - float(change[0])
            y = y - float(change[1])
            yaw = yaw - float(change[2])

        # 3. A coordinate is constrained if enough normals point along it. The place counts in the
        # direction in which the normals constrain it least (the smaller eigenvalue). A turn moves a
        # point by angle times range, so the heading's value is divided by the range squared.
        median_range = float(np.median(np.hypot(points[:, 0], points[:, 1])))
        place_information = float(np.linalg.eigvalsh(normal_matrix[:2, :2])[0])
        heading_information = float(normal_matrix[2, 2]) / median_range**2
        least = match_count * _LEAST_RELIEF**2
        pose = Pose(x, y, yaw)
        return Located(pose, place_information >= least, heading_information >= least)


def _middle(points: Array) -> Array:
    """(n, 2) the median point of each bearing bin, in the order of bearings."""
    ranges = np.hypot(*points.T)
    bearings = np.arctan2(points[:, 1], points[:, 0])
    bins = ((bearings + np.pi) * (_BINS / (2.0 * np.pi))).astype(np.intp) % _BINS
    medians = []
    for bin_index in np.unique(bins):
        is_in_bin = bins == bin_index
        medians.append((float(np.median(ranges[is_in_bin])), float(np.median(bearings[is_in_bin]))))
    r, b = np.array(medians).T
    return np.stack((r * np.cos(b), r * np.sin(b)), axis=1)


def _normal(places: Array, i: int) -> Array | None:
    """The unit normal of the line through the neighbours of place `i`; None without a line."""
    near = places.take(range(i - _REACH, i + _REACH + 1), axis=0, mode="wrap")
    near = near[np.hypot(*(near - places[i]).T) <= _NEIGHBOR]
    if len(near) < _FEWEST:
        return None
    centred = near - near.mean(axis=0)
    sizes, axes = np.linalg.eigh(centred.T @ centred)
    return axes[:, 0] if sizes[0] <= _FLAT * sizes[1] else None
