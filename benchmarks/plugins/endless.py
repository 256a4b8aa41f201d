"""A pattern whose step never returns: what protection must live beside."""

from __future__ import annotations

from swarmd.api import MovementPattern, Params, Twist
from swarmd.core.values import Inputs


class EndlessParams(Params, frozen=True):
    """None."""


class Endless(MovementPattern[EndlessParams]):
    """Loops for ever in its first step."""

    params_type = EndlessParams

    def drive(self, inputs: Inputs) -> Twist:
        """Never returns."""
        while True:
            pass
