"""Shepherding: a robot, the shepherd, drives a herd of robots, the sheep, to a goal.

Source: Strombom, Mann, Wilson, Hailes, Morton, Sumpter and King, "Solving the shepherding problem:
heuristics for herding autonomous, interacting agents", J. Royal Society Interface 11, 2014. With N
sheep, a sheep is astray if it is farther than r_a N^(2/3) from the herd's centre. The shepherd goes
to the far side of such a sheep, at the distance r_a, so that the sheep flees back. If no sheep is
astray, the shepherd drives the herd from behind its centre, at the distance r_a sqrt(N). A sheep
keeps r_a from other sheep. A sheep flees a shepherd that is nearer than r_s, and then also goes to
the centre of its nearest sheep. The weights are those of the source.

Ours: a robot with a third role, the goal, stands at the goal, so that no shared frame is needed.
The robots send their roles. Sheep are slower by the factor `pace`, as in the source.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

from swarmd.api import (
    ZERO,
    Context,
    Inputs,
    NearPoints,
    Neighbor,
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
# The shepherd stands while a sheep is nearer than this multiple of the spacing; the source: 3 r_a.
_WAIT = 1.5
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
        """Flee as a sheep, drive the herd as the shepherd, or stand as the goal; send the role.

        A shepherd that senses no sheep or no goal stands.
        """
        params = self.params
        self._hear(inputs)
        places = self._places(inputs.neighbors)
        report: dict[str, Scalar] = {"role": params.role}
        twist = ZERO
        if params.role == "sheep":
            twist = self._steer(self._flee(places["sheep"], places["shepherd"]), params.pace)
        elif params.role == "shepherd" and places["sheep"] and places["goal"]:
            direction, report["state"] = self._herd(places["sheep"], places["goal"][0])
            twist = self._steer(direction, 1.0)
        if inputs.now < self._share_at:
            return Outputs(twist, report=report)
        self._share_at = inputs.now + params.share_period
        return Outputs(twist, {_CHANNEL: params.role}, report)

    def _hear(self, inputs: Inputs) -> None:
        """Set `_roles`: the last role that each neighbour has sent; empty without any."""
        for message in inputs.messages:
            if message.channel == _CHANNEL and isinstance(message.value, str):
                self._roles[message.sender] = message.value[:16]
        # Robots that are no neighbours any more are forgotten, so that the table is bounded.
        self._roles = {
            neighbor.id: self._roles.get(neighbor.id, "") for neighbor in inputs.neighbors
        }

    def _places(self, neighbors: Sequence[Neighbor]) -> dict[str, list[Vector]]:
        """The places of the sensed neighbours in m in the base frame, by their roles."""
        places: dict[str, list[Vector]] = {"sheep": [], "shepherd": [], "goal": []}
        for neighbor in neighbors:
            role = self._roles[neighbor.id]
            distance = neighbor.distance
            bearing = neighbor.bearing
            if role in places and distance is not None and bearing is not None:
                places[role].append((distance * math.cos(bearing), distance * math.sin(bearing)))
        return places

    def _flee(self, sheep: list[Vector], shepherds: list[Vector]) -> Vector:
        """The way of a sheep: away from sheep that are too near, to the herd, from shepherds."""
        params = self.params
        x = 0.0
        y = 0.0
        for neighbor in sheep:
            if math.hypot(*neighbor) < params.spacing:
                unit = _unit(neighbor)
                x = x - 2.0 * unit[0]
                y = y - 2.0 * unit[1]
        reach = params.flight * params.spacing
        threats = [shepherd for shepherd in shepherds if math.hypot(*shepherd) < reach]
        if threats:
            near = sorted(sheep, key=lambda place: math.hypot(*place))[: params.nearest]
            center = _unit(_mean(near)) if near else (0.0, 0.0)
            away = _unit(_mean([_unit(threat) for threat in threats]))
            x += params.cohesion * center[0] - away[0]
            y += params.cohesion * center[1] - away[1]
        return x, y

    def _herd(self, sheep: list[Vector], goal: Vector) -> tuple[Vector, str]:
        """The way of the shepherd: to behind the farthest sheep, or behind the herd."""
        params = self.params
        count = len(sheep)
        center = _mean(sheep)
        if math.dist(center, goal) <= params.arrived:
            return (0.0, 0.0), "arrived"
        if min(math.hypot(*place) for place in sheep) < _WAIT * params.spacing:
            return (0.0, 0.0), "wait"
        farthest = max(sheep, key=lambda place: math.dist(place, center))
        if math.dist(farthest, center) > params.spacing * count ** (2.0 / 3.0):
            state = "collect"
            pushed = farthest
            behind = params.spacing
            away = _unit((farthest[0] - center[0], farthest[1] - center[1]))
        else:
            state = "drive"
            pushed = center
            behind = params.spacing * math.sqrt(count)
            away = _unit((center[0] - goal[0], center[1] - goal[1]))
        return (pushed[0] + behind * away[0], pushed[1] + behind * away[1]), state

    def _steer(self, direction: Vector, speed_share: float) -> Twist:
        """The command to drive along `direction` at this share of `speed`; zero for (0, 0)."""
        x, y = direction
        if math.hypot(x, y) < 1e-6:
            return ZERO
        unit = _unit(direction)
        params = self.params
        return NearPoints(()).steer(
            unit[0], unit[1], speed_share * params.speed, params.turn, spacing=0.0, brake=1.0
        )


def _unit(vector: Vector) -> Vector:
    length = math.hypot(*vector)
    return (vector[0] / length, vector[1] / length) if length > 0.0 else (0.0, 0.0)


def _mean(vectors: list[Vector]) -> Vector:
    return sum(x for x, _ in vectors) / len(vectors), sum(y for _, y in vectors) / len(vectors)
