"""Its import never ends."""

from __future__ import annotations

import threading

from swarmd.api import Inputs, MovementPattern, Params, Twist

threading.Event().wait()


class EndlessImport(MovementPattern[Params]):
    """Never gets this far."""

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.1)
