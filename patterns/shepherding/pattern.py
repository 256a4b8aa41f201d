"""Shepherding: a robot drives a herd of others to a goal.

Source: Strombom, Mann, Wilson, Hailes, Morton, Sumpter and King, "Solving the shepherding problem:
heuristics for herding autonomous, interacting agents", J. Royal Society Interface 11, 2014: where a
sheep is farther from the herd's centre than r_a N^(2/3) the shepherd collects it, from r_a behind
it; else it drives the herd, from r_a sqrt(N) behind the centre. A sheep with the shepherd within
r_s flees it, keeps r_a from others and goes to the centre of its nearest others; the weights are
those of the source.

Ours: a third role, the goal, is a robot that stands there, so that no shared frame is needed; the
robots tell their roles. Sheep are slower by `pace`, as the source's.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from swarmd.api import (
    ZERO,
    Context,
    Inputs,
    NearPoints,
    Outputs,
    Params,
    Pattern,
    Recovery,
    Scalar,
    SharePeriod,
    TopSpeed,
    TopTurn,
    Twist,
    about,
    of_threshold,
)

_CHANNEL = "role"
Vector = tuple[float, float]


class ShepherdingParams(Params, frozen=True, kw_only=True):
    """The role, the distances, the weights and the speeds."""

    role: Annotated[
        Literal["sheep", "shepherd", "goal"],
        about("sheep flee, the shepherd drives them to the goal, which stands", source="ours"),
    ] = "sheep"
    spacing: Annotated[
        float,
        about(
            "distance that sheep keep, from axle to axle",
            ge=0.02,
            le=20.0,
            unit="m",
            source="Strombom et al. 2014, r_a; the value: 0.8 times the protection threshold",
            derived=of_threshold(0.8),
        ),
    ]
    flight: Annotated[
        float,
        about(
            "sheep flee a shepherd that is nearer, in multiples of `spacing`",
            ge=1.0,
            le=100.0,
            source="Strombom et al. 2014, r_s / r_a = 32.5; the value: ours, for a room",
        ),
    ] = 6.0
    nearest: Annotated[
        int,
        about(
            "sheep go to the centre of so many others",
            ge=1,
            le=1000,
            unit="robots",
            source="Strombom et al. 2014, n: above 0.53 N",
        ),
    ] = 20
    cohesion: Annotated[
        float,
        about("weight of that centre", ge=0.0, le=10.0, source="Strombom et al. 2014, c"),
    ] = 1.05
    pace: Annotated[
        float,
        about(
            "speed of sheep as a share of `speed`",
            ge=0.0,
            le=1.0,
            source="Strombom et al. 2014: 1 by 1.5",
        ),
    ] = 0.67
    arrived: Annotated[
        float,
        about(
            "the herd is there where its centre is as near to the goal",
            ge=0.05,
            le=100.0,
            unit="m",
            source="ours",
        ),
    ] = 1.0
    speed: TopSpeed
    turn: TopTurn
    share_period: SharePeriod = 1.0
    recovery: Recovery = False


class Shepherding(Pattern[ShepherdingParams]):
    """Flees, drives or stands, by its role."""

    group = "move together"
    params_type = ShepherdingParams
    needs = frozenset({"neighbors.distance", "neighbors.bearing"})
    channels = {_CHANNEL: str}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: ShepherdingParams, context: Context) -> None:
        super().__init__(params, context)
        self._roles: dict[str, str] = {}
        self._share_at = 0.0

    def step(self, inputs: Inputs) -> Outputs:
        """The command of the role, and the role for others."""
        params = self.params
        for message in inputs.messages:
            if message.channel == _CHANNEL and isinstance(message.value, str):
                self._roles[message.sender] = message.value[:16]
        places: dict[str, list[Vector]] = {"sheep": [], "shepherd": [], "goal": []}
        for one in inputs.neighbors:
            role = self._roles.get(one.id, "")
            if role in places and one.distance is not None and one.bearing is not None:
                x, y = one.distance * math.cos(one.bearing), one.distance * math.sin(one.bearing)
                places[role].append((x, y))
        self._roles = {one.id: self._roles.get(one.id, "") for one in inputs.neighbors}
        report: dict[str, Scalar] = {"role": params.role}
        twist = ZERO
        if params.role == "sheep":
            twist = self._steer(self._flee(places["sheep"], places["shepherd"]), params.pace)
        elif params.role == "shepherd" and places["sheep"] and places["goal"]:
            way, report["state"] = self._herd(places["sheep"], places["goal"][0])
            twist = self._steer(way, 1.0)
        if inputs.now < self._share_at:
            return Outputs(twist, report=report)
        self._share_at = inputs.now + params.share_period
        return Outputs(twist, {_CHANNEL: params.role}, report)

    def _flee(self, sheep: list[Vector], shepherds: list[Vector]) -> Vector:
        """The way of a sheep: from others that are too near, with the herd, from shepherds."""
        params = self.params
        x = y = 0.0
        for other in sheep:
            if math.hypot(*other) < params.spacing:
                unit = _unit(other)
                x, y = x - 2.0 * unit[0], y - 2.0 * unit[1]
        threats = [one for one in shepherds if math.hypot(*one) < params.flight * params.spacing]
        if threats:
            near = sorted(sheep, key=lambda one: math.hypot(*one))[: params.nearest]
            center = _unit(_mean(near)) if near else (0.0, 0.0)
            away = _unit(_mean([_unit(one) for one in threats]))
            x += params.cohesion * center[0] - away[0]
            y += params.cohesion * center[1] - away[1]
        return x, y

    def _herd(self, sheep: list[Vector], goal: Vector) -> tuple[Vector, str]:
        """The way of the shepherd: to behind the farthest sheep, or behind the herd."""
        params, count = self.params, len(sheep)
        center = _mean(sheep)
        if math.dist(center, goal) <= params.arrived:
            return (0.0, 0.0), "arrived"
        if min(math.hypot(*one) for one in sheep) < 1.5 * params.spacing:
            return (0.0, 0.0), "wait"  # the source: 3 r_a
        farthest = max(sheep, key=lambda one: math.dist(one, center))
        if math.dist(farthest, center) > params.spacing * count ** (2.0 / 3.0):
            behind, what, state = params.spacing, farthest, "collect"
            away = _unit((farthest[0] - center[0], farthest[1] - center[1]))
        else:
            behind, what, state = params.spacing * math.sqrt(count), center, "drive"
            away = _unit((center[0] - goal[0], center[1] - goal[1]))
        return (what[0] + behind * away[0], what[1] + behind * away[1]), state

    def _steer(self, way: Vector, share: float) -> Twist:
        x, y = way
        if math.hypot(x, y) < 1e-6:
            return ZERO
        unit = _unit(way)
        params = self.params
        return NearPoints(()).steer(
            unit[0], unit[1], share * params.speed, params.turn, spacing=0.0, brake=1.0
        )


def _unit(one: Vector) -> Vector:
    length = math.hypot(*one)
    return (one[0] / length, one[1] / length) if length > 0.0 else (0.0, 0.0)


def _mean(some: list[Vector]) -> Vector:
    return sum(x for x, _ in some) / len(some), sum(y for _, y in some) / len(some)
