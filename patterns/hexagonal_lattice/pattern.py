"""Hexagonal lattice: the robots settle in a lattice of triangles, by virtual forces.

Source: Spears, Spears, Hamann and Heil, "Distributed, physics-based control of swarms of vehicles",
Autonomous Robots 17, 2004 (physicomimetics): each robot feels from each neighbour a force G / r^p
of at most F_max, which repels nearer than the distance R and attracts from there to 1.5 R. A robot
has at most six neighbours at R, and those behind them, at 1.73 R, are not felt.

Ours: the sum of the forces is a velocity, not an acceleration, so that no friction is needed. A
force falls to zero within `band` of R, where the force of the source jumps from full repulsion to
full attraction.

Limits: the robots may end in several grains of a lattice, with faults between them. Where F_max is
small, two points share a place of the lattice (the clusters of the source).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Annotated

from swarmd.api import (
    ZERO,
    Context,
    Inputs,
    MovementPattern,
    Neighbor,
    Params,
    Recovery,
    Scalar,
    TopSpeed,
    TopTurn,
    Twist,
    about,
    drive_along,
    of_threshold,
)

# Of the distance: the source's reach, between the first neighbours and those behind them.
_REACH = 1.5


class HexagonalLatticeParams(Params, frozen=True, kw_only=True):
    """The distance of neighbours, the force and the speeds."""

    speed: TopSpeed
    turn: TopTurn
    distance: Annotated[
        float,
        about(
            "distance of neighbours in the lattice, from axle to axle",
            ge=0.05,
            le=100.0,
            unit="m",
            source="Spears et al. 2004, R; the value: 1.4 times the protection threshold",
            derived=of_threshold(1.4),
        ),
    ]
    force: Annotated[
        float,
        about(
            "the speed that one neighbour at the distance asks for, beyond the band",
            ge=0.001,
            le=2.0,
            unit="m/s",
            source="Spears et al. 2004, G / R^p; the value: ours",
        ),
    ] = 0.2
    exponent: Annotated[
        float,
        about(
            "a force falls with this power of the distance",
            ge=0.0,
            le=5.0,
            source="Spears et al. 2004, p = 2",
        ),
    ] = 2.0
    strongest: Annotated[
        float,
        about(
            "largest force, as a multiple of that at the distance",
            ge=1.0,
            le=10.0,
            source="Spears et al. 2004, F_max; the value: ours, see the page",
        ),
    ] = 4.0
    band: Annotated[
        float,
        about(
            "a force falls to zero within this share of the distance",
            ge=0.01,
            le=0.49,
            source="ours: robots rest; the source has a jump and friction",
        ),
    ] = 0.1
    tolerance: Annotated[
        float,
        about(
            "rests where the forces ask for less",
            ge=0.0,
            le=1.0,
            unit="m/s",
            source="ours: a centimetre of error of one neighbour",
        ),
    ] = 0.01
    recovery: Recovery = False


class HexagonalLattice(MovementPattern[HexagonalLatticeParams]):
    """Drives along the sum of the forces, forward or backward."""

    group = "formation"
    params_type = HexagonalLatticeParams
    needs = frozenset({"neighbors.distance", "neighbors.bearing"})

    def __init__(self, params: HexagonalLatticeParams, context: Context) -> None:
        super().__init__(params, context)
        self._near = 0

    def report(self) -> Mapping[str, Scalar]:
        """The number of neighbours within reach of the force."""
        return {"near": self._near}

    def drive(self, inputs: Inputs) -> Twist:
        """Along the force, forward or backward, whichever needs less of a turn."""
        params = self.params
        x, y = self._force(inputs.neighbors)
        if math.hypot(x, y) <= params.tolerance:
            return ZERO
        return drive_along(x, y, speed=params.speed, turn=params.turn)

    def _force(self, neighbors: Iterable[Neighbor]) -> tuple[float, float]:
        """The sum of all forces as a velocity in m/s, in the base frame."""
        params = self.params
        x = 0.0
        y = 0.0
        self._near = 0
        for neighbor in neighbors:
            if neighbor.distance is None or neighbor.bearing is None:
                continue
            share = neighbor.distance / params.distance
            if share < _REACH:
                self._near += 1
                force = min(max(share, 1e-3) ** -params.exponent, params.strongest)
                force *= params.force * max(-1.0, min(1.0, (share - 1.0) / params.band))
                x += force * math.cos(neighbor.bearing)
                y += force * math.sin(neighbor.bearing)
        return x, y
