"""Lloyd coverage: the robots spread so that every place is near one of them.

Source: Cortes, Martinez, Karatas and Bullo, "Coverage control for mobile sensing networks", IEEE
Trans. Robotics and Automation 20(2), 2004: each robot drives to the centroid of its Voronoi cell,
the places that are nearer to it than to another robot. The cost, the mean square distance of all
places to the nearest robot, never rises (Lloyd's algorithm).

Ours: the cell ends at the returns of the lidar and at `reach`, so that the robots need no map and
no shared frame. On an open floor, without walls in reach, the robots spread until cells are discs.

Limits: a place behind a corner is in no cell. The cost has many minima.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np

from swarmd.api import (
    ZERO,
    Array,
    Context,
    Inputs,
    MovementPattern,
    Neighbor,
    Params,
    Recovery,
    Scalar,
    Scan,
    TopSpeed,
    TopTurn,
    Twist,
    about,
    drive_along,
)

# rad between two rays beyond which the floor between them counts as unseen.
_MAX_GAP = 0.5
_LEAST_COSINE = 1e-9  # of the angle between a ray and the direction of a neighbor
_ROUNDING = 1e-9  # rad
_TURN = 2.0 * math.pi


class LloydCoverageParams(Params, frozen=True, kw_only=True):
    """The reach of a cell and the speeds."""

    speed: TopSpeed
    turn: TopTurn
    reach: Annotated[
        float,
        about(
            "places farther away are in no cell, nor are those beyond the lidar's range",
            ge=0.05,
            le=100.0,
            unit="m",
            source="ours: the lidar's range",
            derived=lambda platform: platform.scan.range_max,
        ),
    ]
    gain: Annotated[
        float,
        about(
            "speed for each metre to the centroid",
            ge=0.01,
            le=10.0,
            unit="1/s",
            source="Cortes et al. 2004, k_prop; the value: ours",
        ),
    ] = 0.5
    tolerance: Annotated[
        float,
        about(
            "rests where the centroid is nearer",
            ge=0.0,
            le=5.0,
            unit="m",
            source="ours: a tenth of a body",
        ),
    ] = 0.025
    recovery: Recovery = False


class LloydCoverage(MovementPattern[LloydCoverageParams]):
    """Drives to the centroid of the places that are nearer to it than to another robot."""

    group = "spread"
    params_type = LloydCoverageParams
    report_units = {"off": "m"}  # noqa: RUF012 - a Mapping, as in the base
    needs = frozenset({"scan", "neighbors.distance", "neighbors.bearing"})

    def __init__(self, params: LloydCoverageParams, context: Context) -> None:
        super().__init__(params, context)
        self._scan_seq: int | None = None  # of the scan that the centroid is from
        self._centroid = (0.0, 0.0)

    def report(self) -> Mapping[str, Scalar]:
        """The distance to the centroid in m."""
        return {"off": math.hypot(*self._centroid)}

    def drive(self, inputs: Inputs) -> Twist:
        """To the centroid, forward or backward, whichever needs less of a turn."""
        params = self.params
        scan = inputs.scan
        if scan is not None and scan.seq != self._scan_seq:
            self._scan_seq = scan.seq
            self._centroid = self._cell_centroid(scan, inputs.neighbors)
        x, y = self._centroid
        if math.hypot(x, y) <= params.tolerance:
            return ZERO
        return drive_along(x, y, speed=params.speed, turn=params.turn, gain=params.gain)

    def _cell_centroid(self, scan: Scan, neighbors: Sequence[Neighbor]) -> tuple[float, float]:
        """The centroid (x, y) of the robot's Voronoi cell in m in the base frame.

        The cell consists of triangles, each between two neighbouring rays. A ray ends at its
        return, at `reach`, or at the line halfway to a neighbour. (0, 0) for an empty cell.
        """
        # 1. The ends of the rays as bearing and distance from the axle, in the order of bearings.
        is_known = ~np.isnan(scan.ranges)
        reach = min(self.params.reach, scan.range_max)
        ranges = np.minimum(np.maximum(scan.ranges[is_known], 0.0), reach)
        bearings = scan.bearings[is_known]
        lidar_x, lidar_y = self.context.platform.scan.offset
        x = ranges * np.cos(bearings) + lidar_x
        y = ranges * np.sin(bearings) + lidar_y
        angle = np.arctan2(y, x)
        order = np.argsort(angle)
        angle = angle[order]
        length = np.minimum(np.hypot(x, y)[order], reach)
        # 2. Shorten the rays at the line halfway to each neighbour.
        for neighbor in neighbors:
            if neighbor.distance is not None and neighbor.bearing is not None:
                _cut_halfway(length, angle, 0.5 * neighbor.distance, neighbor.bearing, reach)
        # 3. Twice the area of the triangle from each ray to the next; the first ray follows the
        # last ray. Rays that are too far apart have no triangle, and the area 0.
        gap = np.concatenate((angle[1:] - angle[:-1], angle[:1] + _TURN - angle[-1:]))
        gap = np.where(gap <= _MAX_GAP, gap, 0.0)
        double_area = length * _following(length) * np.sin(gap)
        total = float(double_area.sum())
        if not total > 0.0:
            return 0.0, 0.0
        # 4. The mean of the triangles' centroids, weighted by area. The centroid is a third of the
        # sum of the corners, and one corner is the robot at (0, 0).
        x = length * np.cos(angle)
        y = length * np.sin(angle)
        return (
            float((double_area * (x + _following(x))).sum()) / (3.0 * total),
            float((double_area * (y + _following(y))).sum()) / (3.0 * total),
        )


def _cut_halfway(
    length: Array, angle: Array, halfway: float, bearing: float, longest: float
) -> None:
    """Shorten the rays that cross the line halfway to a neighbor, in place.

    Only rays within acos(halfway / longest) of the neighbor can cross the line, so no cosine is
    computed for the others. With six neighbors this takes a third off a step.

    Args:
        length: (n,) m, of each ray, at most `longest`.
        angle: (n,) rad, of each ray, from -pi to pi, rising.
        halfway: m to the line.
        bearing: rad, of the neighbor.
        longest: m.
    """
    if not halfway < longest:
        return
    half_width = min(math.acos(halfway / longest) + _ROUNDING, 0.5 * math.pi)
    middle = math.remainder(bearing, _TURN)
    for turns in (-1.0, 0.0, 1.0):
        first = middle + turns * _TURN - half_width
        last = middle + turns * _TURN + half_width
        if last < -math.pi or first > math.pi:
            continue
        begin, end = np.searchsorted(angle, (first, last)).tolist()
        cosine = np.cos(angle[begin:end] - bearing)
        cut = halfway / np.maximum(cosine, _LEAST_COSINE)
        np.minimum(length[begin:end], cut, out=length[begin:end])


def _following(values: Array) -> Array:
    """The value behind each value (n,); the first value is behind the last. n > 0."""
    return np.concatenate((values[1:], values[:1]))
