"""Requests that no pattern should make: endless ones and full flips.

All are finite: a robot takes a twist that is not for a fault of the pattern, and stands.
"""

from __future__ import annotations

from swarmd.api import Context, Inputs, MovementPattern, Params, Twist

_WILD = (0.0, 1e300, -1e300)
_LASTS = 2.0  # s of one kind of misuse
_ROUND = 4  # kinds


class Misuse(MovementPattern[Params]):
    """Wild values, flips between the limits at each step, the limits, and spins, in turn."""

    params_type = Params
    needs = frozenset[str]()

    def __init__(self, params: Params, context: Context) -> None:
        super().__init__(params, context)
        self._sign = 1.0

    def drive(self, inputs: Inputs) -> Twist:
        """The request of this step."""
        limits, rng = self.context.platform.limits, self.context.rng
        self._sign = -self._sign
        match int(inputs.now / _LASTS) % _ROUND:
            case 0:
                return Twist(float(rng.choice(_WILD)), float(rng.choice(_WILD)))
            case 1:
                return Twist(
                    self._sign * limits.linear, -self._sign * limits.angular, limits.lateral
                )
            case 2:
                return Twist(1e300, float(rng.normal(0.0, limits.angular)))
            case _:
                return Twist(limits.linear, limits.angular, -limits.lateral)
