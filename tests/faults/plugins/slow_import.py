"""Its import takes a second, as that of a large library."""

from __future__ import annotations

import threading

from swarmd.api import Inputs, MovementPattern, Params, Twist

threading.Event().wait(1.0)


class SlowImport(MovementPattern[Params]):
    """Drives, once it is there."""

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.1)
