"""Drives, then leaves a child that holds all its files open, and dies."""

from __future__ import annotations

import os
import signal

from swarmd.api import Inputs, MovementPattern, Params, Twist


class Forker(MovementPattern[Params]):
    """Its fifth step forks; the log names the child."""

    count = 0

    def drive(self, inputs: Inputs) -> Twist:
        self.count += 1
        if self.count == 5:
            child = os.fork()
            while child == 0:
                signal.pause()
            print(f"left a child: {child}", flush=True)
            os._exit(3)
        return Twist(0.1)
