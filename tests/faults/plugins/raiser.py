"""Drives, and raises at every third step."""

from __future__ import annotations

from swarmd.api import Inputs, MovementPattern, Params, Twist


class Raiser(MovementPattern[Params]):
    """Its third step divides by zero."""

    count = 0

    def drive(self, inputs: Inputs) -> Twist:
        self.count += 1
        return Twist(0.1 / (self.count % 3 and 1))
