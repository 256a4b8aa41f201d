"""How late and how slowly bases follow: a delay line, then caps on acceleration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swarmd.sim.world.realism import Actuation
from swarmd.values import Array, Platform


class Actuators:
    """What n bases are driven with: what they were told, late and within the accelerations.

    The bodies' own limits and ramps come after it, in `Drives`; these only tighten them. Ideal
    actuation passes on what it is told, whatever it is.
    """

    def __init__(self, actuation: Actuation, platforms: Sequence[Platform], dt: float) -> None:
        """`platforms` (n,) in the order of rows; the delay is rounded to whole steps of `dt` s."""
        n = len(platforms)
        self.delay_steps = round(actuation.delay / dt)
        self._line = [np.zeros((n, 3))] * (self.delay_steps + 1)
        self._step = 0
        linear, angular = actuation.linear_acceleration, actuation.angular_acceleration
        self._is_capped = linear is not None or angular is not None
        caps = [np.inf if cap is None else cap * dt for cap in (linear, angular, linear)]
        self._gains = np.array(caps)
        limits = [(p.limits.linear, p.limits.angular, p.limits.lateral) for p in platforms]
        self._limits = np.array(limits).reshape(n, 3)
        self._told, self._driven = np.zeros((n, 3)), np.zeros((n, 3))

    def put(self, commands: Array) -> None:
        """What the bases are told from now on: (n, 3) linear, angular, lateral."""
        self._told = commands.copy()

    def now(self) -> Array:
        """What drives the bases in this step (n, 3); ask once a step."""
        length = len(self._line)
        self._line[self._step % length] = self._told
        self._step += 1
        late = self._line[self._step % length]  # the oldest: what was told `delay_steps` ago
        if not self._is_capped:
            return late
        # A ramp towards what the base can never reach would lag behind once it turns around.
        wanted = np.clip(np.where(np.isfinite(late), late, 0.0), -self._limits, self._limits)
        self._driven = self._driven + np.clip(wanted - self._driven, -self._gains, self._gains)
        return self._driven
