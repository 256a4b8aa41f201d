"""Drives, then takes all the memory that it gets."""

from __future__ import annotations

import numpy as np

from swarmd.api import Inputs, MovementPattern, Params, Twist


class Hoarder(MovementPattern[Params]):
    """Its fifth step allocates without end."""

    count = 0

    def drive(self, inputs: Inputs) -> Twist:
        self.count += 1
        hoard = []
        while self.count == 5:
            hoard.append(np.empty(1 << 24, np.uint8))  # never touched, so that it is quick
        return Twist(0.1)
