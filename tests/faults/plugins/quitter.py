"""Drives, then ends its process without a word."""

from __future__ import annotations

import os

from swarmd.api import Inputs, MovementPattern, Params, Twist


class Quitter(MovementPattern[Params]):
    """Its fifth step is the process's last, and a success."""

    count = 0

    def drive(self, inputs: Inputs) -> Twist:
        self.count += 1
        if self.count == 5:
            os._exit(0)
        return Twist(0.1)
