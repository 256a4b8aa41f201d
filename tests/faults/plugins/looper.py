"""Drives, then thinks for ever."""

from __future__ import annotations

from swarmd.api import Inputs, MovementPattern, Params, Twist


class Looper(MovementPattern[Params]):
    """Its fifth step never ends."""

    count = 0

    def drive(self, inputs: Inputs) -> Twist:
        self.count += 1
        while self.count == 5:
            pass
        return Twist(0.1)
