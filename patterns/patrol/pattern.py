"""Patrol: the robots visit places again and again, so that no place is left alone for long.

Source: Machado, Ramalho, Zucker and Drogoul, "Multi-agent patrolling: an empirical analysis of
alternative architectures", MABS 2002, LNAI 2581, 2003: the conscientious reactive agent goes to the
adjacent place that the agent has not visited for longest. Idleness is the time since the last visit
of any robot.

Ours: robots send each other their visits and their targets. A robot takes the target of another
robot only if all adjacent places are targets. Places within `reach` of each other are adjacent.

Needs the robot's pose in a frame that the robots share, as from a camera above or a localisation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

from swarmd.api import (
    Context,
    Inputs,
    Lease,
    Message,
    NearPoints,
    Outputs,
    Params,
    Pattern,
    Scalar,
    SharePeriod,
    TopSpeed,
    TopTurn,
    Value,
    about,
)

_CHANNEL = "patrol"
_BRAKE = 0.3  # m before a place over which the speed falls
_MIN_SPEED_SHARE = 0.3  # of `speed`, at a place
_NEVER = 1e9  # s: the sent age of a visit that did not happen
_MAX_PLACES = 50


class PatrolParams(Params, frozen=True, kw_only=True):
    """The places, the messages and the speeds."""

    places: Annotated[
        str,
        about("places to visit, x y in m, with commas between them", source="ours: a square"),
    ] = "0 0, 1 0, 1 1, 0 1"
    reach: Annotated[
        float,
        about(
            "farther places are not adjacent; 0: all are",
            ge=0.0,
            le=1000.0,
            unit="m",
            source="Machado et al. 2003, the edges of the graph; the value: ours",
        ),
    ] = 0.0
    arrival: Annotated[
        float,
        about("a nearer place is visited", ge=0.01, le=10.0, unit="m", source="ours: a body"),
    ] = 0.2
    share_period: SharePeriod = 0.5
    lease: Lease = 5.0
    speed: TopSpeed
    turn: TopTurn

    def __post_init__(self) -> None:
        """Check the places."""
        places_of(self.places)


class Patrol(Pattern[PatrolParams]):
    """Drives to the adjacent place that was left alone for longest."""

    group = "spread"
    params_type = PatrolParams
    needs = frozenset({"pose"})
    channels = {_CHANNEL: list}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: PatrolParams, context: Context) -> None:
        super().__init__(params, context)
        self._target = -1
        self._share_at = 0.0
        self._begin(params)

    def _begin(self, params: PatrolParams) -> None:
        self._places = places_of(params.places)
        self._visited_at = [-math.inf] * len(self._places)  # s, of each place, by any robot
        self._claims: dict[str, tuple[float, int]] = {}  # time and place, by robot

    def update(self, params: PatrolParams) -> None:
        """Apply changed parameters; a memory of other places is of no use."""
        if params.places != self.params.places:
            self._target = -1
            self._begin(params)
        super().update(params)

    def step(self, inputs: Inputs) -> Outputs:
        """Drive to the target place; send the target and the ages of all visits.

        `_target` is the index of a place, -1 before the first target. Without a pose the robot
        stands and sends nothing. The age of a visit is the time in s since a robot was at a place.
        """
        now = inputs.now
        params = self.params
        for message in inputs.messages:
            self._hear(message, now - message.age)
        pose = inputs.pose
        if pose is None:
            return Outputs()
        # 1. On arrival, and at the start, the next target, which is sent at once.
        distances = [math.hypot(x - pose.x, y - pose.y) for x, y in self._places]
        if self._target < 0 or distances[self._target] <= params.arrival:
            if self._target >= 0:
                self._visited_at[self._target] = now
            self._target = self._choose(now, distances)
            self._share_at = now
        # 2. The command, slower near the target.
        x, y = self._places[self._target]
        bearing = math.atan2(y - pose.y, x - pose.x) - pose.yaw
        speed_share = min(1.0, max(distances[self._target] / _BRAKE, _MIN_SPEED_SHARE))
        twist = NearPoints(()).steer(
            speed_share * math.cos(bearing),
            speed_share * math.sin(bearing),
            params.speed,
            params.turn,
            spacing=0.0,
            brake=_BRAKE,
        )
        # 3. The message.
        report: Mapping[str, Scalar] = {"target": self._target}
        if now < self._share_at:
            return Outputs(twist, report=report)
        self._share_at = now + params.share_period
        ages: list[Value] = [min(now - visited, _NEVER) for visited in self._visited_at]
        return Outputs(twist, {_CHANNEL: [self._target, *ages]}, report)

    def _choose(self, now: float, distances: list[float]) -> int:
        """The index of the place to visit next; `distances`: from the robot to each place in m.

        Candidates are the places adjacent to the robot's place that no other robot has as target.
        If each adjacent place is a target of a robot, all adjacent places are candidates. The robot
        takes the candidate with the oldest visit, and a random candidate among equals.
        """
        params = self.params
        rng = self.context.rng
        nearest = min(range(len(distances)), key=distances.__getitem__)
        origin = self._target if self._target >= 0 else nearest
        x, y = self._places[origin]
        adjacent = [
            index
            for index, (place_x, place_y) in enumerate(self._places)
            if index != origin
            and (not params.reach or math.hypot(place_x - x, place_y - y) <= params.reach)
        ] or [origin]
        oldest_claim = now - params.lease
        claimed = {index for heard_at, index in self._claims.values() if heard_at >= oldest_claim}
        candidates = [index for index in adjacent if index not in claimed] or adjacent
        oldest = min(self._visited_at[index] for index in candidates)
        best = [index for index in candidates if self._visited_at[index] <= oldest + 1e-9]
        return best[int(rng.integers(len(best)))]

    def _hear(self, message: Message, sent_at: float) -> None:
        """Take over later visits, and the sender's target; ignore a message of another form."""
        value = message.value
        if message.channel != _CHANNEL or not isinstance(value, list):
            return
        if len(value) != 1 + len(self._places):
            return
        target, *ages = value
        if not isinstance(target, int) or not 0 <= target < len(self._places):
            return
        self._claims[message.sender] = sent_at, target
        for index, age in enumerate(ages):
            if isinstance(age, (int, float)) and 0.0 <= age < _NEVER:
                self._visited_at[index] = max(self._visited_at[index], sent_at - age)


def places_of(text: str) -> list[tuple[float, float]]:
    """The places of the parameter; ValueError if the text is of another form."""
    places = []
    for words in text.split(","):
        try:
            x, y = map(float, words.split())
        except ValueError:
            raise ValueError(f"places has {words.strip()!r}; expected x y in m") from None
        places.append((x, y))
    is_finite = all(math.isfinite(x) and math.isfinite(y) for x, y in places)
    if not 2 <= len(places) <= _MAX_PLACES or not is_finite:
        text = f"places has {len(places)} places; expected 2 to {_MAX_PLACES}, all finite"
        raise ValueError(text)
    return places
