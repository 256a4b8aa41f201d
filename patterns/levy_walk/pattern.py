"""Levy walk: straight flights whose lengths follow a power law, with turns to random headings.

Source: Viswanathan et al., "Optimizing the success of random searches", Nature 401, 1999: a flight
is longer than l with probability (l / shortest)^(1 - mu). With mu near 1 the motion is ballistic.
2 is the best mu for a search of sparse targets that return. With mu of 3 and more the walk
diffuses. On robots: Dimidov, Oriolo and Trianni, "Random walks in swarm robotics: an experiment
with Kilobots", ANTS 2016.

Ours: before an obstacle the robot ends the flight and turns away. A drawn flight that is longer
than `longest` is drawn again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

from swarmd.api import (
    Ahead,
    Context,
    Inputs,
    MovementPattern,
    Params,
    Ray,
    Scalar,
    TopSpeed,
    TopTurn,
    Twist,
    about,
    of_threshold,
)


class LevyWalkParams(Params, frozen=True, kw_only=True):
    """The lengths of the flights, the speeds and the clearance."""

    speed: TopSpeed
    turn: TopTurn
    exponent: Annotated[
        float,
        about(
            "mu of the power law; near 1: ballistic, 3 and more: diffusing",
            ge=1.01,
            le=10.0,
            source="Viswanathan et al. 1999: 2 is the best for sparse targets",
        ),
    ] = 2.0
    shortest: Annotated[
        float,
        about("shortest flight", ge=0.01, le=100.0, unit="m", source="ours: two bodies"),
    ] = 0.3
    longest: Annotated[
        float,
        about("longest flight", ge=0.02, le=10000.0, unit="m", source="ours: the size of a hall"),
    ] = 20.0
    clearance: Annotated[
        float,
        about(
            "turns away from nearer obstacles ahead; 0: never",
            ge=0.0,
            le=20.0,
            unit="m",
            source="ours: that of random_walk, to turn before protection acts",
            derived=of_threshold(1.6),
        ),
    ]

    def __post_init__(self) -> None:
        """Check that shortest is below longest."""
        if self.shortest >= self.longest:
            raise ValueError(f"shortest is {self.shortest:g} m, longest {self.longest:g} m")


class LevyWalk(MovementPattern[LevyWalkParams]):
    """Alternates between a flight of random length and a turn in place to a random heading."""

    group = "search"
    params_type = LevyWalkParams
    report_units = {"left": "m"}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: LevyWalkParams, context: Context) -> None:
        super().__init__(params, context)
        self._left = 0.0  # rad to turn
        self._flight = 0.0  # m to drive
        self._last = Twist()
        self._ahead = Ahead()

    def report(self) -> Mapping[str, Scalar]:
        """Its state, and the m that are left of the flight."""
        return {"state": "turn" if self._left else "flight", "left": self._flight}

    def drive(self, inputs: Inputs) -> Twist:
        """The rest of the turn, or of the flight; a new turn and flight when both are done."""
        dt = inputs.dt
        step = 1.0 / self.rate
        self._left -= self._last.angular * dt
        self._flight -= self._last.linear * dt
        blocking = self._ahead.within(self.params.clearance, inputs.scan)
        if abs(self._left) <= 1e-6:
            self._left = 0.0
            if blocking is not None or self._flight <= 0.0:
                self._draw(blocking)
        if self._left:
            turn = self.params.turn
            self._last = Twist(angular=max(-turn, min(turn, self._left / step)))
        else:
            self._last = Twist(linear=self.params.speed)
        return self._last

    def _draw(self, blocking: Ray | None) -> None:
        """A new heading, away from what blocks, and the length of the flight there."""
        rng = self.context.rng
        params = self.params
        if blocking is None:
            self._left = float(rng.uniform(-math.pi, math.pi))
        else:
            side = -math.copysign(1.0, blocking.bearing)
            self._left = side * float(rng.uniform(0.5 * math.pi, math.pi))
        # The inverse of the distribution that ends at `longest`: what is longer is drawn again.
        power = 1.0 - params.exponent
        most = (params.longest / params.shortest) ** power
        share = float(rng.random()) * (1.0 - most) + most
        self._flight = params.shortest * float(share ** (1.0 / power))
