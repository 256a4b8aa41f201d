"""Random commands for random times, also backwards, which no reasonable pattern would request."""

from __future__ import annotations

from typing import Annotated

from swarmd.api import Context, Inputs, MovementPattern, Params, Twist, about


class RandomTwistsParams(Params, frozen=True):
    """How long a command is held."""

    shortest: Annotated[float, about("at least", ge=0.05, le=60.0, unit="s")] = 0.5
    longest: Annotated[float, about("at most", ge=0.05, le=60.0, unit="s")] = 4.0


class RandomTwists(MovementPattern[RandomTwistsParams]):
    """A uniformly drawn command within the limits; one in three goes straight, one in six spins."""

    params_type = RandomTwistsParams
    needs = frozenset[str]()

    def __init__(self, params: RandomTwistsParams, context: Context) -> None:
        super().__init__(params, context)
        self._twist = Twist()
        self._until = 0.0

    def drive(self, inputs: Inputs) -> Twist:
        """The present command, until its time is over."""
        if inputs.now >= self._until:
            rng, limits = self.context.rng, self.context.platform.limits
            linear = float(rng.uniform(-limits.linear, limits.linear))
            angular = float(rng.uniform(-limits.angular, limits.angular))
            kind = int(rng.integers(6))
            lateral = float(rng.uniform(-limits.lateral, limits.lateral)) if limits.lateral else 0.0
            self._twist = Twist(
                0.0 if kind == 0 else linear, 0.0 if kind in (1, 2) else angular, lateral
            )
            lasts = float(rng.uniform(self.params.shortest, self.params.longest))
            self._until = inputs.now + lasts
        return self._twist
