"""Drives, and writes whatever comes to it to its standard output and error."""

from __future__ import annotations

import os

from swarmd.api import Inputs, MovementPattern, Params, Twist


class Talker(MovementPattern[Params]):
    """Says something at every step, and it is not even text."""

    def drive(self, inputs: Inputs) -> Twist:
        print("hello from a pattern", flush=True)
        os.write(1, b"\xff\x00\x93\x01" * 50 + b"\n")
        os.write(2, b"\x1b[31m\xc3\x28\n")
        return Twist(0.1)
