"""Lloyd coverage: the robots spread so that every place is near one of them.

Source: Cortes, Martinez, Karatas and Bullo, "Coverage control for mobile sensing networks", IEEE
Trans. Robotics and Automation 20(2), 2004: each robot drives to the centroid of its Voronoi cell,
the places that are nearer to it than to another robot. The cost, the mean square distance of all
places to the nearest robot, never rises (Lloyd's algorithm).

Ours: the cell ends at what the lidar sees and at `reach`, so that no map and no shared frame is
needed. Where no wall is in reach the robots spread over an open floor until cells are discs.

Limits: a place behind a corner is in no cell. The cost has many minima.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np

from swarmd.api import (
    ZERO,
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
        self._seq: int | None = None  # of the scan that the centroid is from
        self._centroid = (0.0, 0.0)

    def report(self) -> Mapping[str, Scalar]:
        """The distance to the centroid in m."""
        return {"off": math.hypot(*self._centroid)}

    def drive(self, inputs: Inputs) -> Twist:
        """To the centroid, forward or backward, whichever needs less of a turn."""
        params, scan = self.params, inputs.scan
        if scan is not None and scan.seq != self._seq:
            self._seq = scan.seq
            self._centroid = self._find(scan, inputs.neighbors)
        x, y = self._centroid
        if math.hypot(x, y) <= params.tolerance:
            return ZERO
        return drive_along(x, y, speed=params.speed, turn=params.turn, gain=params.gain)

    def _find(self, scan: Scan, neighbors: Sequence[Neighbor]) -> tuple[float, float]:
        """The centroid of the cell in m in the base frame; (0, 0) if the cell is empty.

        The cell is a star of triangles from the robot to each two neighbouring rays. A ray ends at
        its return, at `reach`, or at the line halfway to a neighbour.
        """
        is_known, reach = ~np.isnan(scan.ranges), min(self.params.reach, scan.range_max)
        ranges = np.clip(scan.ranges[is_known], 0.0, reach)
        bearings = scan.bearings[is_known]
        across, up = self.context.platform.scan.offset
        x, y = ranges * np.cos(bearings) + across, ranges * np.sin(bearings) + up
        angle = np.arctan2(y, x)
        order = np.argsort(angle)
        angle = angle[order]
        far = np.minimum(np.hypot(x, y)[order], reach)
        for neighbor in neighbors:
            if neighbor.distance is not None and neighbor.bearing is not None:
                ahead = np.cos(angle - neighbor.bearing)
                # Up to the line halfway to the neighbour.
                limit = 0.5 * neighbor.distance / np.maximum(ahead, 1e-9)
                far = np.where(ahead > 0.0, np.minimum(far, limit), far)
        gap = np.append(np.diff(angle), angle[:1] + 2.0 * math.pi - angle[-1:])
        gap = np.where(gap <= _MAX_GAP, gap, 0.0)
        far_next = np.roll(far, -1)
        area = far * far_next * np.sin(gap)
        total = float(area.sum())
        if not total > 0.0:
            return 0.0, 0.0
        x, y = far * np.cos(angle), far * np.sin(angle)
        return (
            float((area * (x + np.roll(x, -1))).sum()) / (3.0 * total),
            float((area * (y + np.roll(y, -1))).sum()) / (3.0 * total),
        )
