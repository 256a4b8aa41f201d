"""Drives, then writes into every socket that it finds open: the daemon's among them."""

from __future__ import annotations

import contextlib
import os
import stat

from swarmd.api import Inputs, MovementPattern, Params, Twist


class Babbler(MovementPattern[Params]):
    """From its fifth step on it says what the daemon cannot read."""

    count = 0

    def drive(self, inputs: Inputs) -> Twist:
        self.count += 1
        for name in os.listdir("/proc/self/fd") if self.count >= 5 else ():
            with contextlib.suppress(OSError):
                if int(name) > 2 and stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                    os.write(int(name), b"\xc1garbage")
        return Twist(0.1)
