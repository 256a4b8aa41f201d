"""Shelter choice: the robots gather under one of several equal shelters, as cockroaches do.

Source: Ame, Halloy, Rivault, Detrain and Deneubourg, "Collegial decision making based on social
amplification leads to optimal group formation", PNAS 103, 2006; with robots: Garnier, Jost,
Jeanson, Gautrais, Asadpour, Caprari and Theraulaz, "The embodiment of cockroach aggregation
behavior in a group of micro-robots", Artificial Life 14, 2008. A shelter holds S animals, of which
x rest there. A resting animal leaves at the rate theta / (1 + rho (x / S)^n). A walking animal
stops there at a rate that falls as 1 - x / S. So resting animals attract more animals, and one of
two equal shelters wins if each has room for all.

Ours: robots that rest send messages, and x counts the near robots that sent such a message, and the
robot itself. Robots find shelters by the pattern random_walk, and stop under a shelter at the rate
`stop`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from swarmd.api import (
    ZERO,
    CombinedPattern,
    Context,
    Inputs,
    Outputs,
    Params,
    Pattern,
    Recovery,
    Scalar,
    SharePeriod,
    TopSpeed,
    Value,
    WalkClearance,
    about,
)

_CHANNEL = "rest"
_WALK = "walk"


class ShelterChoiceParams(Params, frozen=True, kw_only=True):
    """The rates, the shelter and the walk."""

    leave: Annotated[
        float,
        about(
            "rate at which a robot that rests alone leaves",
            ge=0.0,
            le=10.0,
            unit="1/s",
            source="Ame et al. 2006, theta; the value: ours, an hour is some minutes here",
        ),
    ] = 0.1
    social: Annotated[
        float,
        about(
            "how much a full shelter holds robots; 0: the others do not matter",
            ge=0.0,
            le=1e5,
            source="Ame et al. 2006, rho; the value: ours",
        ),
    ] = 200.0
    exponent: Annotated[
        float,
        about("power of the share that rests", ge=0.0, le=5.0, source="Ame et al. 2006, n = 2"),
    ] = 2.0
    capacity: Annotated[
        int,
        about(
            "robots that a shelter holds",
            ge=1,
            le=1000,
            unit="robots",
            source="Ame et al. 2006, S; the value: ours",
        ),
    ] = 20
    stop: Annotated[
        float,
        about(
            "rate at which a walking robot stops under a shelter",
            ge=0.0,
            le=10.0,
            unit="1/s",
            source="ours: within a body's length",
        ),
    ] = 1.0
    away: Annotated[
        float,
        about(
            "time after a rest in which it does not stop, to leave the shelter",
            ge=0.0,
            le=600.0,
            unit="s",
            source="ours: the way across a shelter",
        ),
    ] = 10.0
    near: Annotated[
        float,
        about(
            "robots that rest farther away are not under the same shelter",
            ge=0.1,
            le=100.0,
            unit="m",
            source="ours: the width of a shelter",
        ),
    ] = 1.5
    dark: Annotated[
        float,
        about("the floor is a shelter's below", ge=0.0, le=1e6, source="ours: halfway to white"),
    ] = 0.5
    share_period: SharePeriod = 1.0
    speed: TopSpeed
    clearance: WalkClearance
    recovery: Recovery = False


class ShelterChoice(CombinedPattern[ShelterChoiceParams]):
    """Walks, rests under a shelter, and leaves the sooner the fewer rest there."""

    group = "gather"
    params_type = ShelterChoiceParams
    needs = frozenset({"scan", "reading:ground", "neighbors.distance"})
    channels = {_CHANNEL: bool}  # noqa: RUF012 - a Mapping, as in the base

    def __init__(self, params: ShelterChoiceParams, context: Context) -> None:
        super().__init__(params, context)
        self._is_resting = False
        self._walk_until = 0.0
        self._share_at = 0.0
        self._rest_heard_at: dict[str, float] = {}  # s of the last message of rest, by neighbour

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        """The walk."""
        speed = self.params.speed
        clearance = self.params.clearance
        walk = self.context.make("random_walk", part=_WALK, speed=speed, clearance=clearance)
        return {_WALK: walk}

    def step(self, inputs: Inputs) -> Outputs:
        """Walk, or rest under a shelter; the robot stops and leaves at random, at two rates.

        A shelter is a dark floor. The rate of leaving falls with the number of robots that rest
        there, and the rate of stopping falls as the shelter fills (Ame et al. 2006). A robot that
        has left walks for `away` s before it may stop again.
        """
        now = inputs.now
        params = self.params
        for message in inputs.messages:
            if message.channel == _CHANNEL and message.value is True:
                self._rest_heard_at[message.sender] = now - message.age
        if inputs.scan is None or "ground" not in inputs.readings:
            return Outputs(report={"state": "walk", "count": 0})
        is_dark = inputs.readings["ground"] < params.dark
        resting = self._resting_neighbors(inputs) + self._is_resting
        filled = resting / params.capacity
        if self._is_resting:
            leave_rate = params.leave / (1.0 + params.social * filled**params.exponent)
            if not is_dark or self._happens(leave_rate, inputs.dt):
                self._is_resting = False
                self._walk_until = now + params.away
        elif is_dark and now >= self._walk_until:
            self._is_resting = self._happens(params.stop * (1.0 - filled), inputs.dt)
            self._share_at = now
        state = "rest" if self._is_resting else "walk"
        report: dict[str, Scalar] = {"state": state, "count": resting}
        if not self._is_resting:
            return Outputs(self.step_part(_WALK, inputs).twist, report=report)
        messages: dict[str, Value] = {}
        if now >= self._share_at:
            self._share_at = now + params.share_period
            messages[_CHANNEL] = True
        return Outputs(ZERO, messages, report)

    def _happens(self, rate: float, dt: float) -> bool:
        """Draw whether an event of this rate in 1/s happens within `dt` s."""
        return float(self.context.rng.random()) < rate * dt

    def _resting_neighbors(self, inputs: Inputs) -> int:
        """The number of neighbours within `near` whose message of rest is still valid."""
        oldest = inputs.now - 3.0 * self.params.share_period
        self._rest_heard_at = {
            name: heard_at for name, heard_at in self._rest_heard_at.items() if heard_at >= oldest
        }
        return sum(
            neighbor.id in self._rest_heard_at
            and neighbor.distance is not None
            and neighbor.distance <= self.params.near
            for neighbor in inputs.neighbors
        )
