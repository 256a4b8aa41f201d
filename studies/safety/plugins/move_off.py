"""Stands for a time, moves off at an even speed, stands again, and moves back.

It regards nothing around it: a door, a train of robots that departs, a box that is pushed.
"""

from __future__ import annotations

from typing import Annotated

from swarmd.api import ZERO, Context, Inputs, MovementPattern, Params, Twist, about


class MoveOffParams(Params, frozen=True):
    """How long it stands and moves, and how it moves."""

    rests: Annotated[float, about("how long it stands", ge=0.1, le=3600.0, unit="s")] = 60.0
    moves: Annotated[float, about("how long it then moves", ge=0.1, le=60.0, unit="s")] = 3.0
    linear: Annotated[float, about("speed ahead", ge=-5.0, le=5.0, unit="m/s")] = 0.0
    lateral: Annotated[float, about("speed to the left", ge=-5.0, le=5.0, unit="m/s")] = 0.0
    angular: Annotated[float, about("turn rate to the left", ge=-5.0, le=5.0, unit="rad/s")] = 0.0


class MoveOff(MovementPattern[MoveOffParams]):
    """Moves there and back, with a rest before each way."""

    params_type = MoveOffParams
    needs = frozenset[str]()

    def __init__(self, params: MoveOffParams, context: Context) -> None:
        super().__init__(params, context)
        self._begun: float | None = None

    def drive(self, inputs: Inputs) -> Twist:
        """The command of the present part of the round."""
        if self._begun is None:
            self._begun = inputs.now
        params = self.params
        part, since = divmod(inputs.now - self._begun, params.rests + params.moves)
        if since < params.rests:
            return ZERO
        sign = -1.0 if int(part) % 2 else 1.0
        return Twist(sign * params.linear, sign * params.angular, sign * params.lateral)
