"""Vicsek alignment: each robot takes the mean heading of the robots near it, with some noise.

Source: Vicsek, Czirok, Ben-Jacob, Cohen and Shochet, "Novel type of phase transition in a system of
self-driven particles", Phys. Rev. Lett. 75, 1995: at each update a particle of constant speed takes
the mean heading of all within the radius, itself included, plus a random angle from an interval of
width eta. Order vanishes as the noise grows.

Ours: a robot senses the headings of its neighbours, and needs time to turn to its new heading.
Limits: no rule holds the robots together, so that they separate in open space. Only protection and
recovery turn them at walls. The pattern flocking keeps a group together.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

from swarmd.api import (
    Context,
    Inputs,
    MovementPattern,
    Params,
    Scalar,
    TopSpeed,
    TopTurn,
    Twist,
    about,
    wrap,
)


class VicsekAlignmentParams(Params, frozen=True, kw_only=True):
    """The radius, the noise and the times."""

    speed: TopSpeed
    turn: TopTurn
    radius: Annotated[
        float,
        about(
            "headings of nearer robots count",
            ge=0.05,
            le=100.0,
            unit="m",
            source="Vicsek et al. 1995, r = 1",
        ),
    ] = 1.0
    noise: Annotated[
        float,
        about(
            "width of the interval of the random angle",
            ge=0.0,
            le=2.0 * math.pi,
            unit="rad",
            source="Vicsek et al. 1995, eta; the value: ours",
        ),
    ] = 0.5
    update_period: Annotated[
        float,
        about(
            "time between two updates of the heading",
            ge=0.1,
            le=60.0,
            unit="s",
            source="Vicsek et al. 1995, 1; the robot turns within it",
        ),
    ] = 1.0


class VicsekAlignment(MovementPattern[VicsekAlignmentParams]):
    """Drives at constant speed and turns to the mean heading of the robots near it."""

    group = "move together"
    params_type = VicsekAlignmentParams
    needs = frozenset({"neighbors.distance", "neighbors.heading"})

    def __init__(self, params: VicsekAlignmentParams, context: Context) -> None:
        super().__init__(params, context)
        self._update_at: float | None = None
        self._left = 0.0  # rad to turn to the new heading
        self._rate = 0.0  # rad/s of the last command
        self._near = 0

    def report(self) -> Mapping[str, Scalar]:
        """How many robots it aligned with last."""
        return {"near": self._near}

    def drive(self, inputs: Inputs) -> Twist:
        """The constant speed, and the turn that is left to the new heading."""
        params = self.params
        self._left -= self._rate * inputs.dt
        if self._update_at is None:  # robots update at different times
            first = float(self.context.rng.random()) * params.update_period
            self._update_at = inputs.now + first
        if inputs.now >= self._update_at:
            self._update_at = inputs.now + params.update_period
            spread = params.noise * (float(self.context.rng.random()) - 0.5)
            self._left = wrap(self._mean_heading(inputs) + spread)
        rate = self._left * self.rate  # done by the next step
        self._rate = max(-params.turn, min(params.turn, rate))
        return Twist(linear=params.speed, angular=self._rate)

    def _mean_heading(self, inputs: Inputs) -> float:
        """The mean heading in rad, relative to the own one, which counts as one."""
        headings = [
            neighbor.heading
            for neighbor in inputs.neighbors
            if neighbor.heading is not None
            and neighbor.distance is not None
            and neighbor.distance <= self.params.radius
        ]
        self._near = len(headings)
        x = 1.0 + math.fsum(map(math.cos, headings))
        return math.atan2(math.fsum(map(math.sin, headings)), x)
