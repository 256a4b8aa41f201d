"""The base of patterns whose states end after a time, such as a rest or a turn."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from swarmd.core.values import Scalar
from swarmd.kit.behavior import Context, MovementPattern
from swarmd.kit.params import P


class TimedPattern(MovementPattern[P]):
    """A movement pattern with a state, which `drive` reads by `state` and changes by `begin`.

    The pattern is in `default_state` unless `begin` has started timed states. The pattern reports
    its state.
    """

    default_state: ClassVar[str] = "drive"

    def __init__(self, params: P, context: Context) -> None:
        super().__init__(params, context)
        self._timed: tuple[tuple[str, float], ...] = ()
        self._now = -math.inf

    def begin(self, now: float, **seconds: float) -> None:
        """Enter timed states one after the other, each for its number of s, then `default_state`.

        `begin(inputs.now, wait=20.0, turn=1.5)` enters `wait` until `now + 20`, then `turn` until
        `now + 21.5`. The new states replace the timed states of an earlier call.
        """
        timed = []
        for name, length in seconds.items():
            now += length
            timed.append((name, now))
        self._timed = tuple(timed)

    def state(self, now: float) -> str:
        """The state at the time `now` in s, that of the step."""
        self._now = now
        return next((name for name, end in self._timed if now < end), self.default_state)

    def report(self) -> Mapping[str, Scalar]:
        """Its state at the end of the step."""
        return {"state": self.state(self._now)}
