"""Drives, then reads where there is nothing."""

from __future__ import annotations

import ctypes

from swarmd.api import Inputs, MovementPattern, Params, Twist


class Crasher(MovementPattern[Params]):
    """Its fifth step is a segmentation fault, as of an extension written in C."""

    count = 0

    def drive(self, inputs: Inputs) -> Twist:
        self.count += 1
        if self.count == 5:
            ctypes.string_at(0)
        return Twist(0.1)
