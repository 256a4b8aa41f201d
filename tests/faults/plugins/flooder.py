"""Drives, and in a thread floods the daemon with well-formed messages that have no receiver."""

from __future__ import annotations

import contextlib
import os
import stat
import threading

import msgpack

from swarmd.api import Inputs, MovementPattern, Params, Twist

FRAME: bytes = msgpack.packb(["failed", 0, "of a generation that never was"])


class Flooder(MovementPattern[Params]):
    """The flood begins with its fifth step."""

    count = 0

    def drive(self, inputs: Inputs) -> Twist:
        self.count += 1
        if self.count == 5:
            threading.Thread(target=self.flood, daemon=True).start()
        return Twist(0.1)

    def flood(self) -> None:
        """Write to every socket that is open, the daemon's among them."""
        sockets = []
        for name in os.listdir("/proc/self/fd"):
            with contextlib.suppress(OSError):
                if int(name) > 2 and stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                    sockets.append(int(name))
        while True:
            for descriptor in sockets:
                os.write(descriptor, FRAME)
